"""What commands do to memory, and what is answered."""

from collections.abc import Callable
from dataclasses import replace
from datetime import date, datetime, timedelta
from typing import Any

from plugd import flow, habits, sessions, soc
from plugd.domain import (
    Answer,
    ClearTrip,
    Command,
    Household,
    Memory,
    Mode,
    Overrides,
    Presence,
    Replan,
    SetConnected,
    SetHorizon,
    SetMinimum,
    SetMode,
    SetReadyBy,
    SetSoc,
    SetTrip,
    SetWeek,
)
from plugd.units import to_pct

MAX_TRIPS = 31
FURTHEST_DAYS = 366
"""How far ahead a trip may lie."""

Outcome = tuple[Memory, Answer]


def _mode(command: SetMode, memory: Memory, household: Household, now: datetime) -> Outcome:
    """A person's word also ends whatever a press at the plug asked for.

    After an electrical cut only "off" is obeyed: whoever says it has seen that the plug is off, and ends the cut.
    With the battery at its ceiling "now" would be over at once: it is "smart", and the answer says why.
    """
    cut = memory.flow.cut
    if cut is not None and command.mode is not Mode.OFF:
        return memory, Answer("mode", False, f"the plug was cut: {flow.cut_text(cut, household)}")
    full = command.mode is Mode.NOW and memory.soc.mean >= household.car.soc_max
    mode = Mode.SMART if full else command.mode
    why = _full(memory, household) if full else "" if cut is None else ", and the cut is over"
    memory = replace(
        memory,
        flow=replace(memory.flow, cut=None),
        overrides=replace(memory.overrides, mode=mode),
        press=None,
        guarding=memory.guarding and command.mode is not Mode.OFF,
    )
    return memory, Answer("mode", True, f"mode is {mode}{why}")


def _full(memory: Memory, household: Household) -> str:
    return (
        f": the battery is at {to_pct(memory.soc.mean, 0):g} %, and now ends at soc_max "
        f"{to_pct(household.car.soc_max):g} %; say how full it is if that is wrong, or set a trip for more"
    )


def _soc(command: SetSoc, memory: Memory, household: Household, now: datetime) -> Outcome:
    if command.source == soc.CAR:
        heard = soc.heard(memory.soc, command.soc, now)
        memory = replace(memory, soc=heard)
        if abs(heard.mean - command.soc) > soc.FROZEN:
            why = f"the car says {to_pct(command.soc):g} % where {to_pct(heard.mean):g} % was expected"
            remedy = "; believed if it still does in a minute" if heard.doubted is not None else ", and does not move"
            return memory, Answer("soc", False, why + remedy)
    else:
        memory = replace(memory, soc=soc.told(memory.soc, command.soc, now, command.source))
    return memory, Answer("soc", True, f"the battery is at {to_pct(command.soc):g} %")


def _minimum(command: SetMinimum, memory: Memory, household: Household, now: datetime) -> Outcome:
    low, high = household.car.soc_min, household.car.soc_max
    if not low <= command.minimum <= high:
        reason = (
            f"a morning minimum of {to_pct(command.minimum):g} % is outside soc_min {to_pct(low):g} % "
            f"to soc_max {to_pct(high):g} %; choose one within"
        )
        return memory, Answer("minimum", False, reason)
    memory = replace(memory, overrides=replace(memory.overrides, minimum=command.minimum))
    return memory, Answer("minimum", True, f"every morning has at least {to_pct(command.minimum):g} %")


def _ready_by(command: SetReadyBy, memory: Memory, household: Household, now: datetime) -> Outcome:
    overrides = replace(memory.overrides, ready_by=command.ready_by)
    if command.ready_by is not None and (wrong := _wrong_times(_next_days(now, household), overrides, household)):
        return memory, Answer("ready_by", False, wrong)
    memory = replace(memory, overrides=overrides)
    said = f"ready by {command.ready_by:%H:%M}" if command.ready_by else "ready by the configured time"
    return memory, Answer("ready_by", True, said)


def _next_days(now: datetime, household: Household) -> tuple[date, ...]:
    """The mornings of a week."""
    first = sessions.today(now, household)
    return tuple(first + timedelta(days=k) for k in range(1, 8))


def _wrong_times(days: tuple[date, ...], overrides: Overrides, household: Household) -> str:
    """Why the car cannot be ready when it is asked to be; empty where it can."""
    for day in days:
        rule = sessions.rule_of(day, household.nights, overrides)
        if rule.away or rule.ready_by is None:
            continue
        stay, following = (sessions.stay_of(d, household, overrides) for d in (day, day + timedelta(days=1)))
        if stay is None or (following is not None and following.session.start < stay.session.end):
            evening = f"{household.nights.plug_in:%H:%M}"
            return (
                f"ready by {rule.ready_by:%H:%M} is not between one plug-in and the next, expected about {evening}; "
                "choose a time within"
            )
    return ""


def _week(command: SetWeek, memory: Memory, household: Household, now: datetime) -> Outcome:
    def refused(why: str) -> Outcome:
        return memory, Answer("week", False, why)

    overrides = replace(memory.overrides, week=command.week)
    low, high = household.car.soc_min, household.car.soc_max
    rules = [rule for _, rule in command.week or ()]
    if any(rule.minimum is not None and not low <= rule.minimum <= high for rule in rules):
        return refused(f"a minimum is outside soc_min {to_pct(low):g} % to soc_max {to_pct(high):g} %; choose within")
    if len(rules) == 7 and all(rule.away for rule in rules):
        return refused("the car is away on every day; leave one out, or set the mode to off")
    if wrong := _wrong_times(_next_days(now, household), replace(overrides, trips=()), household):
        return refused(wrong)
    memory = replace(memory, overrides=overrides)
    if command.week is None:
        return memory, Answer("week", True, "the week is the configured one")
    differ = len(rules)
    return memory, Answer("week", True, f"{differ} day{'' if differ == 1 else 's'} of the week differ")


def _trip(command: SetTrip, memory: Memory, household: Household, now: datetime) -> Outcome:
    def refused(why: str) -> Outcome:
        return memory, Answer("trip", False, f"{trip.day}: {why}")

    trip, first = command.trip, sessions.today(now, household)
    others = tuple(t for t in memory.overrides.trips if t.day != trip.day)
    overrides = replace(memory.overrides, trips=tuple(sorted((*others, trip), key=lambda t: t.day)))
    if not first <= trip.day <= first + timedelta(days=FURTHEST_DAYS):
        return refused(f"is not in the year to come; send a morning from {first} on")
    if len(overrides.trips) > MAX_TRIPS:
        return refused(f"{MAX_TRIPS} trips are set already; clear one first")
    low = household.car.soc_min
    if trip.minimum is not None and trip.minimum < low:
        return refused(f"a minimum of {to_pct(trip.minimum):g} % is below soc_min {to_pct(low):g} %; choose more")
    if wrong := _wrong_times((trip.day,), overrides, household):
        return refused(wrong)
    stay = sessions.stay_of(trip.day, household, overrides)
    if stay is not None and stay.session.end <= now:
        return refused("that morning is over; send a later one")
    asks = "away" if trip.away or stay is None else f"at least {to_pct(stay.session.minimum):g} %"
    by = f" by {trip.ready_by:%H:%M}" if trip.ready_by else ""
    return replace(memory, overrides=overrides), Answer("trip", True, f"{trip.day}: {asks}{by}")


def _clear_trip(command: ClearTrip, memory: Memory, household: Household, now: datetime) -> Outcome:
    trips = tuple(t for t in memory.overrides.trips if command.day not in (None, t.day))
    memory = replace(memory, overrides=replace(memory.overrides, trips=trips))
    return memory, Answer("trip", True, f"{command.day}: as any other day" if command.day else "no trips are set")


def _horizon(command: SetHorizon, memory: Memory, household: Household, now: datetime) -> Outcome:
    memory = replace(memory, overrides=replace(memory.overrides, horizon=command.sessions))
    return memory, Answer("horizon", True, f"{command.sessions} nights are planned together")


def plugged_in(memory: Memory, now: datetime) -> Memory:
    """The car has just been plugged in: whatever was asked of the stay before is over."""
    mode = Mode.SMART if memory.overrides.mode is Mode.OFF else memory.overrides.mode
    return replace(
        flow.anew(memory),
        presence=Presence(True, now),
        overrides=replace(memory.overrides, mode=mode),
        press=None,
        guarding=False,
    )


def unplugged(memory: Memory, now: datetime) -> Memory:
    """The car has just left: a boost or a press at the plug is over."""
    mode = Mode.SMART if memory.overrides.mode is Mode.NOW else memory.overrides.mode
    return replace(
        memory,
        presence=Presence(False, now),
        overrides=replace(memory.overrides, mode=mode),
        press=None if memory.press and memory.press.on else memory.press,
        guarding=False,
    )


def _connected(command: SetConnected, memory: Memory, household: Household, now: datetime) -> Outcome:
    here = memory.presence.connected
    if command.connected and here is not True:
        # Nobody having said before, this is news of a stay under way, and no reason to drop a person's off.
        memory = plugged_in(memory, now) if here is False else replace(memory, presence=Presence(True, now))
    elif not command.connected and here is not False:
        memory = unplugged(memory, now)
    return memory, Answer("connected", True, f"the car is {'here' if command.connected else 'not here'}")


def _replan(command: Replan, memory: Memory, household: Household, now: datetime) -> Outcome:
    return memory, Answer("replan", True, "planned anew")


_APPLY: dict[type, Callable[[Any, Memory, Household, datetime], Outcome]] = {
    SetMode: _mode,
    SetSoc: _soc,
    SetMinimum: _minimum,
    SetReadyBy: _ready_by,
    SetWeek: _week,
    SetTrip: _trip,
    ClearTrip: _clear_trip,
    SetHorizon: _horizon,
    SetConnected: _connected,
    Replan: _replan,
}


def is_news(command: Command, memory: Memory, now: datetime) -> bool:
    """Whether a command is worth a decision; only a car that goes on saying the same is not."""
    return not isinstance(command, SetSoc) or command.source != soc.CAR or soc.is_news(memory.soc, command.soc, now)


def apply(
    commands: tuple[Command, ...], memory: Memory, household: Household, now: datetime
) -> tuple[Memory, tuple[Answer, ...]]:
    """Apply commands in order. Each sets, none toggles, so that one that comes twice does no harm."""
    answers = []
    for command in commands:
        obeyed, answer = _APPLY[type(command)](command, memory, household, now)
        memory = habits.observed(now, memory, obeyed, household)
        answers.append(answer)
    return memory, tuple(answers)
