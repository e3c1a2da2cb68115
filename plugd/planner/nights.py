"""From sessions, outlook and SOC to the solver's problem, and from its answer back to a plan with times."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta

from plugd.domain import Household, Intensity, Outlook, Plan, PlanSlot, Series, Session, SessionPlan
from plugd.planner import end_value, taper
from plugd.planner.problem import Problem, ProblemSession, Solution
from plugd.sessions import DAY, cautious_use_kwh
from plugd.units import HALF_HOUR, SLOT_H, hours, next_slot, pieces, slot_start, span_h

GUARD_SHARE = 0.9
"""The guard counts on this share of the power; so does the plan in the stretch the guard could claim."""
MET_KWH = 0.1
"""A morning minimum missed by less is met: a fifth of a point of the usual battery, below any measurement."""
PAST_NIGHTS, ENOUGH_NIGHTS = 28, 7
"""Nights of history that say what nights are like; with fewer than enough of them the planned ones join."""


@dataclass(frozen=True, slots=True)
class Piece:
    """One column of the problem: a half hour or a part of one, and what may flow in it."""

    start: datetime
    end: datetime
    limit_kw: float


@dataclass(frozen=True, slots=True)
class Part:
    """One row of the problem. The first session has two where the guard has a margin: to its deadline, to its end."""

    session: Session
    pieces: tuple[Piece, ...]
    minimum_kwh: float
    daily_use_kwh: float


def _cut(start: datetime, end: datetime, now: datetime, limit_kw: float) -> Iterator[Piece]:
    """The half hours of a span. Elapsed ones stay, with no power, so that the problem keeps its shape."""
    for first, last in pieces(start, end):
        if last <= now:
            yield Piece(first, last, 0.0)
        else:
            yield Piece(max(first, now), last, limit_kw)


def _derated(found: tuple[Piece, ...], since: datetime) -> tuple[Piece, ...]:
    """The same pieces, planned with the guard's share of the power from `since` on."""
    return tuple(Piece(p.start, p.end, p.limit_kw * GUARD_SHARE if p.end > since else p.limit_kw) for p in found)


def _tonight(
    session: Session, now: datetime, energy_kwh: float, power_kw: float, household: Household
) -> tuple[Part, ...]:
    """The first session, with its minimum due before the guard would act (design: deadline)."""
    car = household.car
    minimum_kwh = session.minimum * car.capacity_kwh
    if 0.0 < minimum_kwh - energy_kwh < MET_KWH:
        minimum_kwh = energy_kwh
    need_kwh = max(0.0, taper.flat_kwh(car, energy_kwh, minimum_kwh))
    early = timedelta(seconds=household.guard_margin_s + household.planner_slack_s)
    deadline = max(session.end - early, session.start)
    stretch = span_h(need_kwh / (GUARD_SHARE * power_kw * car.efficiency))
    before = tuple(_cut(session.start, deadline, now, power_kw))
    after = tuple(_cut(deadline, session.end, now, power_kw))
    if need_kwh > 0.0 and early:
        before, after = _derated(before, deadline - stretch), _derated(after, deadline)
    passed = now >= deadline or deadline == session.start
    whole = Part(session, after or before, minimum_kwh, session.daily_use_kwh)
    if not (before and after):  # without a margin there is one row, and the day's driving comes after it
        return (whole,)
    return Part(session, before, 0.0 if passed else minimum_kwh, 0.0), whole


def layout(
    sessions: tuple[Session, ...], now: datetime, energy_kwh: float, power_kw: float, household: Household
) -> tuple[Part, ...]:
    """The rows and columns for these sessions. `energy_kwh`: in the battery; `power_kw`: what the car takes."""
    parts: list[Part] = []
    for session in sessions:
        if not parts:
            parts.extend(_tonight(session, now, energy_kwh, power_kw, household))
        else:
            cut = tuple(_cut(session.start, session.end, now, power_kw))
            parts.append(Part(session, cut, session.minimum * household.car.capacity_kwh, session.daily_use_kwh))
    return tuple(parts)


def problem(
    parts: tuple[Part, ...],
    outlook: Outlook,
    energy_kwh: float,
    previous: Plan | None,
    household: Household,
    history: tuple[Intensity, ...] = (),
) -> Problem:
    """The solver's problem. Intensity comes from the outlook, which covers every slot.

    `history`: recent intensities, for what energy left at the end is worth.
    """
    g_per_kwh = {slot.start: slot.g_per_kwh for slot in outlook.slots}
    typical = sum(g_per_kwh.values()) / max(1, len(g_per_kwh))
    before = {} if previous is None else {slot_start(s.start): s.power_kw for s in previous.slots()}
    car = household.car
    return Problem(
        energy_kwh=energy_kwh,
        reserve_kwh=car.soc_min * car.capacity_kwh,
        efficiency=car.efficiency,
        sessions=tuple(
            ProblemSession(
                # An elapsed slot has no number any more; it takes no power, so any will do.
                intensity_g_per_kwh=tuple(g_per_kwh.get(slot_start(p.start), typical) for p in part.pieces),
                slot_h=tuple(hours(p.end - p.start) for p in part.pieces),
                power_max_kw=tuple(p.limit_kw for p in part.pieces),
                minimum_kwh=part.minimum_kwh,
                ceiling_kwh=part.session.ceiling * car.capacity_kwh,
                daily_use_kwh=part.daily_use_kwh,
                # A car seen to take less than the charger's least is no reason to give it nothing.
                power_min_kw=min(
                    household.capability.power_min_kw,
                    min((p.limit_kw for p in part.pieces if p.limit_kw > 0.0), default=0.0),
                ),
            )
            for part in parts
        ),
        end_value=_end_value(parts, g_per_kwh, history, household) if household.end_value else (),
        previous_power_kw=tuple(
            tuple(min(before.get(slot_start(p.start), 0.0), p.limit_kw) for p in part.pieces) for part in parts
        )
        if before
        else None,
    )


def _end_value(
    parts: tuple[Part, ...], outlook: dict[datetime, float], history: tuple[Intensity, ...], household: Household
) -> end_value.Steps:
    """The worth of energy above the last session's minimum, from nights like the recent ones."""
    car, last = household.car, parts[-1].session
    power_kw = max((piece.limit_kw for part in parts for piece in part.pieces), default=0.0)
    past = {value.start: value.g_per_kwh for value in history}
    sessions = tuple(dict.fromkeys(part.session for part in parts))  # the first one has two parts
    tonight = sessions[0]
    known = [_night(past, tonight.start - n * DAY, tonight.end - n * DAY) for n in range(1, PAST_NIGHTS + 1)]
    if sum(map(bool, known)) < ENOUGH_NIGHTS:
        known += [_night(outlook, session.start, session.end) for session in sessions]
    found = end_value.steps(
        tuple(filter(None, known)),
        slot_kwh=power_kw * SLOT_H * car.efficiency,
        use_kwh=car.daily_use_kwh,
        room_kwh=(last.ceiling - last.minimum) * car.capacity_kwh,
        efficiency=car.efficiency,
    )
    spare_kwh = cautious_use_kwh(car, household.nights.confidence) - car.daily_use_kwh
    return end_value.beyond(found, max(0.0, spare_kwh) * (len(sessions) - 1))


def _night(g_per_kwh: dict[datetime, float], start: datetime, end: datetime) -> Series:
    """The whole half hours of a night; nothing where less than half of them is known."""
    slot, slots = start if slot_start(start) == start else next_slot(start), 0
    found = []
    while slot + HALF_HOUR <= end:
        slots += 1
        if slot in g_per_kwh:
            found.append(g_per_kwh[slot])
        slot += HALF_HOUR
    return tuple(found) if 2 * len(found) >= slots else ()


def plan(now: datetime, parts: tuple[Part, ...], stated: Problem, solution: Solution, household: Household) -> Plan:
    """The solution with its times; the two parts of the first session are one again."""
    found: list[SessionPlan] = []
    for part, terms, power_kw, end_kwh, short_kwh in zip(
        parts, stated.sessions, solution.power_kw, solution.energy_kwh, solution.shortfall_kwh, strict=True
    ):
        slots = tuple(
            PlanSlot(p.start, p.end, kw, limit_kw, g)
            for p, kw, limit_kw, g in zip(
                part.pieces, power_kw, terms.power_max_kw, terms.intensity_g_per_kwh, strict=True
            )
            if p.end > now
        )
        if found and found[-1].session is part.session:
            slots = found.pop().slots + slots
        soc_end = end_kwh / household.car.capacity_kwh
        found.append(SessionPlan(part.session, slots, soc_end, short_kwh if short_kwh >= MET_KWH else 0.0))
    return Plan(now, tuple(found), solution.status, solution.solver, solution.carbon_g, solution.gap)
