"""The decision: what the household, the world as seen and the memory make of one moment. Pure."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from plugd import beat, commands, contest, flow, habits, reasons, safe_mode, sessions, soc
from plugd import outlook as outlooks
from plugd.domain import (
    Capability,
    Decision,
    Fault,
    Household,
    Intensity,
    Memory,
    Observation,
    Orders,
    Outlook,
    Plan,
    Reading,
    Session,
    SessionPlan,
    Setpoint,
    SocEstimate,
    Switching,
)
from plugd.errors import SolveError
from plugd.guard import believed_kw
from plugd.outlook import Learned
from plugd.perception import perceive
from plugd.planner import hold, nights, taper, window
from plugd.planner.exact import Exact
from plugd.planner.problem import Solver
from plugd.relay import RelayHistory, delay_s, realise
from plugd.units import within

LEAST_KW = 1e-3
"""Less in a slot is the solver's rounding."""
FULL_SHARE = 0.999
SIMPLE_PLAN = (
    "the solver gave no plan that could be used: the simple exact one counts, as clean but less still; nothing needs "
    "doing unless it goes on for days"
)
NO_METER = (
    "the meter's total stands still or jumps while power flows, and is not believed: energy is counted as power x "
    "time until it counts again; restart the plug, or reset its meter"
)
NO_MEASURE = (
    "the meter tells a power, or a total, that cannot be, again and again: it is left out until it makes sense; "
    "restart the plug, and see that its firmware and its units are what plugd knows"
)


@dataclass(slots=True)
class Controller:
    """Decides for one household. The solver's workspace is the only state, and only a cache."""

    household: Household
    solver: Solver
    seed: str = "plugd"
    """What sets this household's random delays apart from its neighbours'."""
    safe: bool = False
    """Nothing is planned: see `safe_mode`."""

    def tick(self, now: datetime, seen: Observation, memory: Memory, learned: Learned | None = None) -> Decision:
        """Obey commands, look at the plug, plan the next sessions, and turn tonight's plan into orders.

        `learned`: of the grid and its forecasts; without it they are taken as they are.
        """
        memory, answers = commands.apply(seen.commands, memory, self.house(memory), now)
        memory = perceive(now, seen.reading, memory, self.house(memory))
        house = self.house(memory)
        horizon = memory.overrides.horizon or house.nights.horizon
        coming = sessions.expected(now, house, memory.overrides, memory.presence, horizon)
        outlook = None
        if self.safe:
            memory = replace(memory, plan=None, orders=safe_mode.orders(now, memory, house))
        elif coming:
            outlook = outlooks.extend(seen.forecast, seen.history, now, coming[-1].end, learned)
            plan = self._plan(now, coming, outlook, seen.history, memory, house)
            memory = replace(memory, plan=plan, orders=self._orders(now, plan, memory, house))
        else:
            memory = replace(memory, plan=None, orders=None)
        decision = self.describe(now, seen, memory, outlook)
        return replace(decision, answers=answers, sessions=coming)

    def resume(self, now: datetime, seen: Observation, memory: Memory, learned: Learned | None = None) -> Decision:
        """The decision after a restart: the stored plan as it is, nothing planned anew."""
        coming = memory.plan.sessions if memory.plan else ()
        until = coming[-1].session.end if coming else now
        outlook = outlooks.extend(seen.forecast, seen.history, now, until, learned) if coming else None
        return self.describe(now, seen, memory, outlook)

    def act(self, now: datetime, seen: Observation, memory: Memory) -> beat.Action:
        """What the plug is told between ticks: the stored orders, unless somebody outranks them."""
        memory = perceive(now, seen.reading, memory, self.house(memory))
        return beat.decide(now, memory, self.house(memory))

    def house(self, memory: Memory) -> Household:
        """The household with what was learned of it."""
        return habits.informed(self.household, memory.habits)

    def describe(self, now: datetime, seen: Observation, memory: Memory, outlook: Outlook | None) -> Decision:
        """The decision as it stands, with its status and reason."""
        house = self.house(memory)
        action = beat.decide(now, memory, house)
        faults = (*seen.faults, *flow.faults(now, action.memory, house))
        faults += believed(now, seen.reading, action.memory, house)
        faults += contest.faults(now, action.memory, house) + (safe_mode.faults(house) if self.safe else ())
        status, reason = reasons.explain(now, action, action.memory, outlook, house, faults)
        planned = memory.plan.sessions if memory.plan else ()
        return Decision(
            at=now,
            memory=action.memory,
            status=status,
            reason=reason,
            sessions=tuple(s.session for s in planned),
            outlook=outlook,
            forecast_issued_at=seen.forecast.issued_at if seen.forecast else None,
            faults=faults,
        )

    def _plan(
        self,
        now: datetime,
        coming: tuple[Session, ...],
        outlook: Outlook,
        history: tuple[Intensity, ...],
        memory: Memory,
        house: Household,
    ) -> Plan:
        """Solve on the cautious SOC, with the power that the car was seen to take."""
        car = house.car
        at_home = beat.soc_at(coming[0].start, memory, house)
        energy_kwh, unsure_kwh = (of(at_home) * car.capacity_kwh for of in (soc.cautious, soc.unsure))
        power_kw = believed_kw(memory.observed_kw, house.capability.power_max_kw)
        parts = nights.layout(coming, now, energy_kwh, power_kw, house, unsure_kwh=unsure_kwh)
        asked = nights.problem(parts, outlook, energy_kwh, memory.plan, house, history)
        held = hold.held(window.preferred(asked, parts, outlook, history, house), parts, now, house)
        try:
            stated, solution = taper.solve(self.solver, held, car)
        except SolveError:
            stated, solution = taper.solve(Exact(), held, car)
            solution = replace(solution, status="fallback")
        stated, solution = hold.let_go(asked, stated, solution)
        return nights.plan(now, parts, stated, solution, house)

    def _orders(self, now: datetime, plan: Plan, memory: Memory, house: Household) -> Orders:
        """Tonight's plan in the plug's own terms."""
        tonight = plan.sessions[0]
        history = RelayHistory(
            on=bool(memory.relay_on),
            since=memory.relay_since,
            switch_ons=tuple(at for at in memory.switch_ons if at >= tonight.session.start),
            orders=memory.orders if isinstance(memory.orders, Switching) else None,
        )
        return orders(now, tonight, memory.soc, history, house, self._delay)

    def _delay(self, block_start: datetime) -> float:
        """Seconds by which a block of the plan starts later, so that neighbours do not start as one."""
        return delay_s(block_start, seed=self.seed, most_s=self.household.relay.random_delay_s)


def believed(now: datetime, reading: Reading | None, memory: Memory, household: Household) -> tuple[Fault, ...]:
    """What of the solver, of the meter and of the car is not believed, or is missed."""
    found = []
    if memory.plan is not None and memory.plan.status == "fallback":
        found.append(Fault("solver", SIMPLE_PLAN))
    if memory.soc.lent_kwh > 0.0:
        found.append(Fault("meter", NO_METER))
    elif reading is not None and reading.nonsense:
        found.append(Fault("meter", NO_MEASURE))
    if soc.is_no_percentage(memory.soc):
        found.append(Fault("car_soc", reasons.fraction_text(memory)))
    elif soc.is_stale(memory.soc, now, household.car) and memory.presence.connected is not False:
        found.append(Fault("soc_stale", reasons.stale_text(memory, household)))
    return tuple(found)


def orders(
    now: datetime,
    tonight: SessionPlan,
    estimate: SocEstimate,
    history: RelayHistory,
    household: Household,
    delay: Callable[[datetime], float],
) -> Orders:
    """A session's plan in the plug's own terms. `history`: what its relay did, where it is one."""
    if household.capability.modulating:
        return _setpoint(now, tonight, household.capability)
    car = household.car
    ceiling_kwh = (tonight.session.ceiling - tonight.soc_end - soc.unsure(estimate)) * car.capacity_kwh
    need_kwh = (tonight.session.minimum - soc.cautious(estimate)) * car.capacity_kwh
    return realise(
        tonight,
        now,
        history,
        household.relay,
        surplus_kwh=max(0.0, ceiling_kwh) / car.efficiency,
        must_kwh=max(0.0, need_kwh) / car.efficiency,
        margin_s=household.guard_margin_s,
        delay=delay if household.relay.random_delay_s > 0.0 else None,
    )


def _setpoint(now: datetime, tonight: SessionPlan, charger: Capability) -> Setpoint:
    """The power of the slot under way in the charger's terms, or none until the session begins.

    A slot planned full is offered all there is: a car that was seen to take less may take more one day. A car that
    takes less than the charger's least is offered that least.
    """
    for slot in tonight.slots:
        if slot.start <= now < slot.end:
            if slot.power_kw <= LEAST_KW:
                return Setpoint(0.0, slot.end)
            full = slot.power_kw >= FULL_SHARE * slot.limit_kw
            power_kw = charger.power_max_kw if full else slot.power_kw
            return Setpoint(within(charger.power_min_kw, power_kw, charger.power_max_kw), slot.end)
        if slot.start > now:
            return Setpoint(0.0, slot.start)
    return Setpoint(0.0, now + timedelta(minutes=30))
