"""Every few seconds: who has the last word on the relay now, and when that may change.

An electrical cut comes before everything; then a person's off, the guard, the reserve, a person's on, and last the
plan. A car that takes nothing, whoever switched it on, is once switched off to wake it.

An off goes with the time by which the plug's own timer has to be over, should plugd die: the last safe start. Where
that timer is fixed and would end later, no off is begun.
"""

from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum
from functools import partial

from plugd import contest, flow, sessions, soc
from plugd.domain import Household, Memory, Mode, Relay, Session, Setpoint, SocEstimate, Switching, Wanted
from plugd.guard import Need, Verdict, guard
from plugd.planner.nights import MET_KWH
from plugd.planner.taper import flat_kwh

WATCH = timedelta(seconds=60)
"""While something other than the plan holds the relay on, its end is looked for this often."""
TIMER_SLACK = timedelta(seconds=60)
"""A timer that ends so much after the last safe start still ends in time."""
LEASE = 2 * WATCH
"""How long a setpoint of such a holder counts: renewed at every look, it does not run out before the next."""
RENEWED = 0.5 * LEASE
"""A setpoint that is renewed at every look is told again when half its time is over."""


class Cause(StrEnum):
    """Whose word it is."""

    CUT = "cut"
    PERSON_OFF = "person_off"
    GUARD = "guard"
    RESERVE = "reserve"
    PERSON_ON = "person_on"
    WAKE = "wake"
    TIMER = "timer"
    ABSENT = "absent"
    CONTESTED = "contested"
    PLAN = "plan"


TIMED = (Cause.PLAN, Cause.ABSENT, Cause.CONTESTED)
"""Whose off ends by itself in time."""


@dataclass(frozen=True, slots=True)
class Action:
    """What the plug is told now, on whose word, and the moment to look again at the latest."""

    wanted: Wanted
    cause: Cause
    memory: Memory
    verdict: Verdict
    until: datetime | None
    session: Session | None = None
    """Of the stay under way, as far as known."""

    @property
    def on(self) -> bool:
        """Whether power may flow."""
        return is_on(self.wanted)


def is_on(wanted: Wanted) -> bool:
    """Whether power may flow under these orders."""
    return wanted.on if isinstance(wanted, Relay) else wanted.power_kw > 0.0


def is_same(told: Wanted, wanted: Wanted) -> bool:
    """Whether telling the plug again would say nothing new. A setpoint is renewed before its time is over."""
    if isinstance(told, Relay) or isinstance(wanted, Relay):
        return told == wanted and not _moved(told, wanted)
    return told.power_kw == wanted.power_kw and told.until > wanted.until - RENEWED


def _moved(told: Wanted, wanted: Wanted) -> bool:
    """Whether the timer of an off has to be over at another time than was told."""
    if not (isinstance(told, Relay) and isinstance(wanted, Relay)) or told.on_by == wanted.on_by:
        return False
    return told.on_by is None or wanted.on_by is None or abs(told.on_by - wanted.on_by) > TIMER_SLACK


def is_off_again(told: Wanted | None, wanted: Wanted) -> bool:
    """Whether both are the same kind of off: by when its timer has to be over does not matter here."""
    if told is None or is_on(told) or is_on(wanted):
        return False
    return not (isinstance(told, Relay) and isinstance(wanted, Relay)) or told.held is wanted.held


def soc_at(moment: datetime, memory: Memory, household: Household) -> SocEstimate:
    """The estimate as it will be at a moment: what is driven until then taken off."""
    coming = sessions.drives(household, memory.overrides, memory.presence, memory.soc.driven_to, moment)
    return soc.driven(memory.soc, coming, household.car)


def cautious_soc(moment: datetime, memory: Memory, household: Household) -> float:
    """The SOC that promises are made on, as it will be at a moment."""
    return soc.cautious(soc_at(moment, memory, household))


def next_plug_in(now: datetime, memory: Memory, household: Household) -> datetime | None:
    """When the next stay is expected to begin. None where no night at home is."""
    stay = sessions.next_stay(now, household, memory.overrides)
    return None if stay is None else stay.session.start


def _next_watch(now: datetime, memory: Memory, household: Household) -> datetime | None:
    """When the next stay is expected to begin at the earliest, and from then on: what is at stake changes."""
    stay = sessions.next_stay(now, household, memory.overrides)
    if stay is None:
        return None
    return stay.early_plug_in if stay.early_plug_in > now else stay.session.start


def _at_stake(now: datetime, memory: Memory, household: Household) -> tuple[Session | None, Need | None]:
    """The session whose morning is at stake, and what is missing to it.

    That of the stay under way; once nothing is missing there, the coming one, from the early plug-in on: a car that
    came home early and has far to go must not wait for the time it was expected.
    """
    stay = sessions.under_way(now, household, memory.overrides, memory.presence)
    session = None if stay is None else stay.session
    need = _missing(now, session, memory, household)
    if need is not None and need.energy_kwh > 0.0:
        return session, need
    coming = sessions.coming_home(now, household, memory.overrides, memory.presence)
    if coming is None:
        return session, need
    return coming.session, _missing(now, coming.session, memory, household)


def _missing(now: datetime, session: Session | None, memory: Memory, household: Household) -> Need | None:
    """What a session still lacks for its morning, by the cautious SOC. None where there is no session."""
    if session is None:
        return None
    if memory.presence.connected is False and now >= session.end:
        return None  # told to be gone, and its morning is over: nothing is left to save
    car = household.car
    has_kwh = cautious_soc(session.start, memory, household) * car.capacity_kwh
    wants_kwh = session.minimum * car.capacity_kwh
    return Need(session.end, flat_kwh(car, has_kwh, wants_kwh) if wants_kwh - has_kwh >= MET_KWH else 0.0)


def _below_reserve(session: Session | None, memory: Memory, household: Household) -> bool:
    """Connected, told so or else expected to be, and emptier than the reserve."""
    told = memory.presence.connected
    here = session is not None if told is None else told
    return here and soc.cautious(memory.soc) < household.car.soc_min


def _planned(now: datetime, memory: Memory, household: Household) -> tuple[Wanted, datetime | None]:
    """The plan's word now, and when it next changes."""
    orders = memory.orders
    if isinstance(orders, Setpoint) and now < orders.until:
        return orders, orders.until
    if isinstance(orders, Switching):
        on = orders.state(now) and now < orders.until
        return Relay(on), orders.next(now, not on)
    return _off(now, household, held=False), None


def _off(now: datetime, household: Household, held: bool) -> Wanted:
    return Setpoint(0.0, now + LEASE) if household.capability.modulating else Relay(False, held)


def _full_on(now: datetime, household: Household) -> Wanted:
    capability = household.capability
    return Setpoint(capability.power_max_kw, now + LEASE) if capability.modulating else Relay(True)


def decide(now: datetime, memory: Memory, household: Household) -> Action:
    """Who wins now. Pure; `memory` comes back with whether the guard holds, a car is being woken, a timer runs."""
    action = _timed(now, _woken(now, _decided(now, memory, household), household), household)
    look = flow.next_look(now, action.memory.flow, household)
    until = min((moment for moment in (action.until, look) if moment is not None), default=None)
    return replace(action, until=until)


def _woken(now: datetime, action: Action, household: Household) -> Action:
    """A car that takes nothing is switched off for a while, once a session, and then on again."""
    memory = action.memory
    if not action.on or household.capability.modulating or action.cause is Cause.CONTESTED:
        return action
    if flow.sleeps(now, action.session, memory, household):
        memory = flow.wake(now, action.session, memory, household)
    if not flow.waking(now, memory.flow):
        return action
    until = memory.flow.wake_until
    return replace(action, wanted=Relay(False, on_by=until), cause=Cause.WAKE, memory=memory, until=until)


def _timed(now: datetime, action: Action, household: Household) -> Action:
    """An off with the time by which its timer has to be over. A fixed timer that would end later: on instead.

    Where somebody else has just switched the plug neither goes on with the fight: it has to be quiet first.
    """
    capability, memory, start = household.capability, action.memory, action.verdict.last_safe_start
    off = isinstance(action.wanted, Relay) and not action.on and action.cause in TIMED
    if not (off and capability.dead_man) or start is None:
        return action if memory.on_by is None else replace(action, memory=replace(memory, on_by=None))
    quiet_at = contest.quiet_at(now, memory) if action.cause is Cause.CONTESTED else None
    if capability.fixed_timer_s is None:
        return replace(action, wanted=Relay(False, on_by=max(start, quiet_at or start)))
    if now + timedelta(seconds=capability.fixed_timer_s) <= start:
        on_by = start
    elif memory.relay_on is False and memory.on_by is not None and memory.on_by <= start + TIMER_SLACK:
        on_by = memory.on_by  # the timer that runs ends in time: it is not begun anew
    elif quiet_at is not None:
        on_by = now + timedelta(seconds=capability.fixed_timer_s)
    else:
        return replace(
            action, wanted=Relay(True), cause=Cause.TIMER, memory=replace(memory, on_by=None), until=now + WATCH
        )
    return replace(action, wanted=Relay(False, on_by=on_by), memory=replace(memory, on_by=on_by))


def _decided(now: datetime, memory: Memory, household: Household) -> Action:
    """Who wins, whatever flows and however the plug's timer stands."""
    session, need = _at_stake(now, memory, household)
    verdict = guard(
        now,
        need,
        observed_kw=memory.observed_kw,
        nominal_kw=household.capability.power_max_kw,
        efficiency=household.car.efficiency,
        margin_s=household.guard_margin_s,
        guarding=memory.guarding,
    )
    press = memory.press
    off_by_person = memory.overrides.mode is Mode.OFF or (press is not None and not press.on)
    cut = memory.flow.cut is not None
    quiet_at = contest.quiet_at(now, memory)
    fired = verdict.on and not (off_by_person or cut or quiet_at)
    fresh = fired and not memory.guarding
    memory = replace(memory, guarding=fired, guard_count=memory.guard_count + int(fresh))
    act = partial(Action, memory=memory, verdict=verdict, session=session)
    if cut:
        return act(_off(now, household, held=True), Cause.CUT, until=None)
    if off_by_person:
        ends = None if press is None else press.until
        return act(_off(now, household, held=True), Cause.PERSON_OFF, until=ends)
    if contest.fought(now, memory) and not fired:
        moments = (quiet_at, memory.contested_until, verdict.last_safe_start)
        until = min((m for m in moments if m is not None and m > now), default=None)
        left = _full_on(now, household) if memory.relay_on else _off(now, household, held=False)
        return act(left, Cause.CONTESTED, until=until)
    for holds, cause in (
        (fired, Cause.GUARD),
        (_below_reserve(session, memory, household), Cause.RESERVE),
        (memory.overrides.mode is Mode.NOW or press is not None, Cause.PERSON_ON),
    ):
        if holds:
            return act(_full_on(now, household), cause, until=now + WATCH)
    wanted, changes = _planned(now, memory, household)
    moments = (changes, verdict.last_safe_start, _next_watch(now, memory, household))
    until = min((m for m in moments if m is not None and m > now), default=None)
    if memory.presence.connected is False:
        return act(_off(now, household, held=False), Cause.ABSENT, until=until)
    return act(wanted, Cause.PLAN, until=until)
