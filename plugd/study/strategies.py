"""How the car is charged: what a strategy is asked, and those that the paper and other chargers have.

`Planned` is the daemon's own planning (sessions, nights, planner, relay); on a forecast without error it is perfect
foresight. The others charge to the ceiling every night, as chargers without a second night in mind do.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Protocol

from plugd import controller, soc
from plugd.domain import Household, Orders, Plan, Session, SessionPlan, Setpoint, SocEstimate, Switching
from plugd.errors import UsageError
from plugd.guard import Need, last_safe_start
from plugd.planner import hold, nights, taper
from plugd.planner.end_value import Steps
from plugd.planner.problem import Solver
from plugd.relay import RelayHistory
from plugd.study.forecasts import Forecasts
from plugd.units import HALF_HOUR, next_slot, pieces, slot_start, span_h

FOR_GOOD = timedelta(days=7)
"""Longer than any stay: nothing more to say in this one."""
SETTLED = 48 * 9
"""Half hours of history from which on what nights are like changes from one night to the next only."""
SOON = timedelta(minutes=1)


class Strategy(Protocol):
    """Charges one car. It is asked at plug-in, when what it last said runs out, and at the session's end."""

    def plugged_in(self, now: datetime, coming: tuple[Session, ...], household: Household) -> None:
        """A stay begins. `coming`: the sessions expected from now on; `household`: with what was learned of it."""

    def orders(self, now: datetime, estimate: SocEstimate) -> Orders:
        """What the plug is told until `until`."""


@dataclass(slots=True)
class Uncontrolled:
    """Full power from plug-in to the ceiling."""

    household: Household

    def plugged_in(self, now: datetime, coming: tuple[Session, ...], household: Household) -> None:
        """Nothing to prepare."""

    def orders(self, now: datetime, estimate: SocEstimate) -> Orders:
        """See Strategy."""
        return _full(now, self.household, self.household.car.soc_max - estimate.mean)


@dataclass(slots=True)
class LatestStart:
    """Full power so late that the ceiling is just reached at the session's end."""

    household: Household
    end: datetime | None = None

    def plugged_in(self, now: datetime, coming: tuple[Session, ...], household: Household) -> None:
        """Remember when to be ready."""
        self.end = coming[0].end

    def orders(self, now: datetime, estimate: SocEstimate) -> Orders:
        """See Strategy."""
        room = self.household.car.soc_max - estimate.mean
        start = now if self.end is None else self.end - _length(self.household, room)
        return Setpoint(0.0, start) if start > now else _full(now, self.household, room)


def _length(household: Household, room: float) -> timedelta:
    """How long full power takes to charge `room`, a fraction of the battery."""
    car = household.car
    return span_h(max(0.0, room) * car.capacity_kwh / (household.capability.power_max_kw * car.efficiency))


def _full(now: datetime, household: Household, room: float) -> Setpoint:
    length = _length(household, room)
    if length <= timedelta(seconds=1):
        return Setpoint(0.0, now + FOR_GOOD)
    return Setpoint(household.capability.power_max_kw, now + length)


@dataclass(slots=True)
class Planned:
    """plugd: the next sessions planned together, anew every half hour of tonight's.

    `previous`: whether the solver cares for the plan before. `shape`: what is made of the expected sessions first.
    """

    household: Household
    forecasts: Forecasts
    solver: Solver
    previous: bool = False
    shape: Callable[[tuple[Session, ...]], tuple[Session, ...]] = lambda coming: coming
    coming: tuple[Session, ...] = ()
    slots: tuple[datetime, ...] = ()
    worth: Steps | None = None
    plan: Plan | None = None
    relay: RelayHistory = field(default_factory=RelayHistory)
    told: tuple[datetime, Switching] | None = None

    def plugged_in(self, now: datetime, coming: tuple[Session, ...], household: Household) -> None:
        """Lay out the nights: within a stay only their intensity changes."""
        self.household, self.coming = household, self.shape(coming)
        self.slots = tuple(slot_start(first) for s in self.coming for first, _ in pieces(s.start, s.end))
        self.worth, self.told, self.relay = None, None, RelayHistory()

    def orders(self, now: datetime, estimate: SocEstimate) -> Orders:
        """See Strategy."""
        tonight, reserve = self.coming[0], self.household.car.soc_min
        if soc.cautious(estimate) < reserve:
            return self._full(now, reserve - soc.cautious(estimate))
        if not tonight.start <= now < tonight.end:
            return self._outside(now, tonight, estimate)
        self._look_back(now)
        planned = self._tonight(now, estimate)
        orders = controller.orders(now, planned, estimate, self.relay, self.household, _no_delay)
        if isinstance(orders, Switching):
            self.told = now, orders
            return replace(orders, until=min(next_slot(now), tonight.end))
        return orders

    def _outside(self, now: datetime, tonight: Session, estimate: SocEstimate) -> Setpoint:
        """Before the session and after it nothing is planned, but the guard watches as it does in the daemon."""
        house, power_kw = self.household, self.household.capability.power_max_kw
        missing = tonight.minimum - soc.cautious(estimate)
        need_kwh = missing * house.car.capacity_kwh
        if need_kwh < nights.MET_KWH:
            return Setpoint(0.0, tonight.start if now < tonight.start else now + FOR_GOOD)
        if now >= tonight.end:
            return self._full(now, missing)
        safe = last_safe_start(Need(tonight.end, need_kwh), power_kw, house.car.efficiency, house.guard_margin_s)
        if safe is None or safe <= now:
            return Setpoint(power_kw, tonight.start)
        return Setpoint(0.0, min(safe, tonight.start))

    def _full(self, now: datetime, missing: float) -> Setpoint:
        """All that the plug gives until `missing`, a fraction of the battery, is there."""
        return Setpoint(self.household.capability.power_max_kw, now + max(_length(self.household, missing), SOON))

    def _tonight(self, now: datetime, estimate: SocEstimate) -> SessionPlan:
        """Plan the coming sessions, and return the first."""
        house, power_kw = self.household, self.household.capability.power_max_kw
        ahead = [at for at in self.slots if at + HALF_HOUR > now]
        g_per_kwh = dict(zip(ahead, self.forecasts.expected(now, ahead), strict=True))
        worth = self.worth
        if worth is None:
            history = self.forecasts.history(now)
            worth = nights.end_worth(self.coming, g_per_kwh, history, house, power_kw)
            self.worth = worth if len(history) >= SETTLED else None
        energy_kwh, unsure_kwh = (of(estimate) * house.car.capacity_kwh for of in (soc.cautious, soc.unsure))
        parts = nights.layout(self.coming, now, energy_kwh, power_kw, house, unsure_kwh=unsure_kwh)
        asked = nights.stated(parts, g_per_kwh, energy_kwh, self.plan, house, worth)
        stated, solution = taper.solve(self.solver, hold.held(asked, parts, now, house), house.car)
        stated, solution = hold.let_go(asked, stated, solution)
        if self.previous:
            self.plan = nights.plan(now, parts, stated, solution, house)
            return self.plan.sessions[0]
        return next(nights.session_plans(now, parts, stated, solution, house))

    def _look_back(self, now: datetime) -> None:
        """What the relay did since it was last told."""
        if self.told is None:
            return
        since, orders = self.told
        moves = [(since, orders.state(since)), *((s.at, s.on) for s in orders.switches if since < s.at < now)]
        for at, on in moves:
            if on is not self.relay.on:
                ons = (*self.relay.switch_ons, at) if on else self.relay.switch_ons
                self.relay = RelayHistory(on, at, ons, orders)


def _no_delay(_: datetime) -> float:
    """The study has no random delay."""
    return 0.0


def to_the_ceiling(coming: tuple[Session, ...]) -> tuple[Session, ...]:
    """Tonight alone, to be charged to the ceiling."""
    return (replace(coming[0], minimum=coming[0].ceiling),)


def strategy(name: str, household: Household, forecasts: Forecasts, solver: Solver, *, previous: bool) -> Strategy:
    """A strategy by its name. Raises UsageError."""
    match name:
        case "uncontrolled":
            return Uncontrolled(household)
        case "latest-start":
            return LatestStart(household)
        case "cheapest-tonight":
            return Planned(household, forecasts, solver, previous, to_the_ceiling)
        case "mpc" | "perfect":
            return Planned(household, forecasts, solver, previous)
    raise UsageError(f"{name!r} is no strategy")
