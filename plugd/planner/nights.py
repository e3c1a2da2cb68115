"""From sessions, outlook and SOC to the solver's problem, and from its answer back to a plan with times."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import lru_cache

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
    ceiling_kwh: float
    daily_use_kwh: float
    slots: tuple[datetime, ...]
    """The half hour that holds each piece."""
    slot_h: Series
    limit_kw: Series


def _part(session: Session, found: tuple[Piece, ...], bounds_kwh: tuple[float, float], daily_use_kwh: float) -> Part:
    """A row with its columns in the solver's terms. `bounds_kwh`: its minimum and its ceiling."""
    return Part(
        session,
        found,
        *bounds_kwh,
        daily_use_kwh,
        slots=tuple(slot_start(p.start) for p in found),
        slot_h=tuple(hours(p.end - p.start) for p in found),
        limit_kw=tuple(p.limit_kw for p in found),
    )


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
    session: Session, now: datetime, energy_kwh: float, unsure_kwh: float, power_kw: float, household: Household
) -> tuple[Part, ...]:
    """The first session, with its minimum due before the guard would act (design: deadline).

    Its minimum is held by the cautious SOC, its ceiling by the mean, to `soc.AS_KNOWN`: the battery is not to be fuller
    because little is known of it. What must be there in the morning or on the next arrival comes first.
    """
    car = household.car
    minimum_kwh = session.minimum * car.capacity_kwh
    most_kwh = session.ceiling * car.capacity_kwh
    must_kwh = max(minimum_kwh, car.soc_min * car.capacity_kwh + session.daily_use_kwh)
    ceiling_kwh = min(most_kwh, max(most_kwh - unsure_kwh, must_kwh))
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
    whole = _part(session, after or before, (minimum_kwh, ceiling_kwh), session.daily_use_kwh)
    if not (before and after):  # without a margin there is one row, and the day's driving comes after it
        return (whole,)
    return _part(session, before, (0.0 if passed else minimum_kwh, ceiling_kwh), 0.0), whole


def layout(
    sessions: tuple[Session, ...],
    now: datetime,
    energy_kwh: float,
    power_kw: float,
    household: Household,
    *,
    unsure_kwh: float = 0.0,
) -> tuple[Part, ...]:
    """The rows and columns for these sessions. `energy_kwh`: in the battery; `power_kw`: what the car takes.

    `unsure_kwh`: how much more than `energy_kwh` the battery may hold (`soc.unsure`).
    """
    parts: list[Part] = []
    for session in sessions:
        if not parts:
            parts.extend(_tonight(session, now, energy_kwh, unsure_kwh, power_kw, household))
        else:
            parts.append(_later(session, power_kw, household.car.capacity_kwh))
    return tuple(parts)


@lru_cache(maxsize=32)
def _later(session: Session, power_kw: float, capacity_kwh: float) -> Part:
    """A session that has not begun: the same at every tick before it."""
    found = tuple(_cut(session.start, session.end, session.start, power_kw))
    bounds_kwh = (session.minimum * capacity_kwh, session.ceiling * capacity_kwh)
    return _part(session, found, bounds_kwh, session.daily_use_kwh)


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
    worth = end_worth(
        tuple(dict.fromkeys(part.session for part in parts)),
        g_per_kwh,
        history,
        household,
        max((kw for part in parts for kw in part.limit_kw), default=0.0),
    )
    return stated(parts, g_per_kwh, energy_kwh, previous, household, worth)


def stated(
    parts: tuple[Part, ...],
    g_per_kwh: Mapping[datetime, float],
    energy_kwh: float,
    previous: Plan | None,
    household: Household,
    worth: end_value.Steps,
) -> Problem:
    """The solver's problem from the intensity of each half hour to come and the worth of energy left at the end."""
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
                intensity_g_per_kwh=tuple(g_per_kwh.get(slot, typical) for slot in part.slots),
                slot_h=part.slot_h,
                power_max_kw=part.limit_kw,
                minimum_kwh=part.minimum_kwh,
                ceiling_kwh=part.ceiling_kwh,
                daily_use_kwh=part.daily_use_kwh,
                # A car seen to take less than the charger's least is no reason to give it nothing.
                power_min_kw=min(
                    household.capability.power_min_kw,
                    min((kw for kw in part.limit_kw if kw > 0.0), default=0.0),
                ),
            )
            for part in parts
        ),
        end_value=worth,
        previous_power_kw=tuple(
            tuple(min(before.get(slot, 0.0), kw) for slot, kw in zip(part.slots, part.limit_kw, strict=True))
            for part in parts
        )
        if before
        else None,
    )


def end_worth(
    sessions: tuple[Session, ...],
    outlook: Mapping[datetime, float],
    history: tuple[Intensity, ...],
    household: Household,
    power_kw: float,
) -> end_value.Steps:
    """The worth of energy above the last session's minimum, from nights like the recent ones.

    `power_kw`: what the car takes. From four nights on there is usually none, and nothing to work out: what the
    plan is too cautious about fills the room.
    """
    car, last = household.car, sessions[-1]
    room_kwh = (last.ceiling - last.minimum) * car.capacity_kwh
    spare_kwh = max(0.0, cautious_use_kwh(car, household.nights.confidence) - car.daily_use_kwh) * (len(sessions) - 1)
    if not household.end_value or spare_kwh >= room_kwh:
        return ()
    past = {value.start: value.g_per_kwh for value in history}
    tonight = sessions[0]
    known = [_night(past, tonight.start - n * DAY, tonight.end - n * DAY) for n in range(1, PAST_NIGHTS + 1)]
    if sum(map(bool, known)) < ENOUGH_NIGHTS:
        known += [_night(outlook, session.start, session.end) for session in sessions]
    found = end_value.steps(
        tuple(filter(None, known)),
        slot_kwh=power_kw * SLOT_H * car.efficiency,
        use_kwh=car.daily_use_kwh,
        room_kwh=room_kwh,
        efficiency=car.efficiency,
    )
    return end_value.beyond(found, spare_kwh)


def _night(g_per_kwh: Mapping[datetime, float], start: datetime, end: datetime) -> Series:
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
    """The solution with its times."""
    found = tuple(session_plans(now, parts, stated, solution, household))
    return Plan(now, found, solution.status, solution.solver, solution.carbon_g, solution.gap)


def session_plans(
    now: datetime, parts: tuple[Part, ...], stated: Problem, solution: Solution, household: Household
) -> Iterator[SessionPlan]:
    """The sessions of a plan, the one under way first; the two parts of the first session are one again."""
    found: SessionPlan | None = None
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
        if found is not None and found.session is part.session:
            slots = found.slots + slots
        elif found is not None:
            yield found
        soc_end = end_kwh / household.car.capacity_kwh
        found = SessionPlan(part.session, slots, soc_end, short_kwh if short_kwh >= MET_KWH else 0.0)
    if found is not None:
        yield found
