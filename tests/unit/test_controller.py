"""The tick: a pure function of the moment, the world as seen and the memory."""

from dataclasses import replace
from datetime import datetime

import pytest

from plugd import soc
from plugd.controller import Controller
from plugd.domain import (
    DayRule,
    Fault,
    Household,
    Memory,
    Mode,
    Nights,
    Observation,
    Overrides,
    Presence,
    Reading,
    RelayRules,
    SetHorizon,
    SetMinimum,
    SetMode,
    Setpoint,
    SetSoc,
    Status,
    Switching,
)
from plugd.planner.exact import Exact
from plugd.units import hours
from tests.unit.deciding import CHARGER, EVENING, HOME, NIGHT, READY_BY, Counted, at, forecast, home, knows, minutes

SEEN = Observation(forecast=forecast(NIGHT))


def tick(
    memory: Memory, household: Household = HOME, seen: Observation = SEEN, now: datetime = NIGHT, seed: str = "a"
) -> Memory:
    return Controller(household, Exact(), seed).tick(now, seen, memory).memory


def ons(memory: Memory) -> list[tuple[datetime, bool]]:
    assert isinstance(memory.orders, Switching)
    return [(switch.at, switch.on) for switch in memory.orders.switches]


def on_h(memory: Memory) -> float:
    """Hours the relay is on tonight."""
    switches = ons(memory)
    return sum(hours(off - on) for (on, _), (off, _) in zip(switches[::2], switches[1::2], strict=True))


def tonight_kwh(memory: Memory) -> float:
    assert memory.plan
    return memory.plan.sessions[0].energy_kwh


def test_the_same_is_decided_of_the_same() -> None:
    controller = Controller(HOME, Exact())
    reading = Reading(NIGHT, True, 2.1, 4.0, NIGHT, changed_by_other=True)
    seen = Observation(reading, SEEN.forecast, commands=(SetSoc(0.4), SetMode(Mode.SMART)))
    memory = knows(0.6)
    assert controller.tick(NIGHT, seen, memory) == Controller(HOME, Exact()).tick(NIGHT, seen, memory)
    assert memory == knows(0.6)


def test_the_plan_is_for_the_clean_hours_and_becomes_the_relays_orders() -> None:
    memory = tick(knows(0.6))
    assert memory.plan
    assert memory.plan.made_at == NIGHT
    assert ons(memory) == [(at(2, day=3), True), (at(5, day=3), False)]
    assert memory.orders
    assert memory.orders.until == READY_BY


CLEAN_TONIGHT = Observation(forecast=forecast(NIGHT, level=lambda start: 10.0 if start < READY_BY else 500.0))


@pytest.mark.parametrize("household", [HOME, CHARGER])
@pytest.mark.parametrize("sd", [0.005, 0.05, 0.1])
def test_the_battery_is_not_filled_beyond_its_ceiling_because_little_is_known_of_it(
    household: Household, sd: float
) -> None:
    memory = tick(knows(0.6, sd=sd), household, CLEAN_TONIGHT)
    assert memory.plan
    reached = 0.6 + memory.plan.sessions[0].energy_kwh * household.car.efficiency / household.car.capacity_kwh
    assert reached <= 0.8 + soc.AS_KNOWN + 1e-6
    assert sd > 0.05 or reached >= 0.8
    if household is HOME:
        # In the stretch that the guard could claim a relay gives more than is counted on.
        flows_kwh = on_h(memory) * household.capability.power_max_kw * household.car.efficiency
        assert 0.6 + flows_kwh / household.car.capacity_kwh <= 0.8 + soc.AS_KNOWN + 0.01


def test_the_minimum_comes_before_the_ceiling() -> None:
    memory = tick(knows(0.6, sd=0.2), CHARGER, CLEAN_TONIGHT)
    assert memory.plan
    assert memory.plan.sessions[0].soc_end == pytest.approx(0.5)
    assert memory.plan.sessions[0].shortfall_kwh == 0.0


def test_commands_count_in_the_tick_they_came_with() -> None:
    said = (SetSoc(0.3), SetMinimum(0.6), SetHorizon(2), SetMinimum(0.9))
    decision = Controller(HOME, Exact()).tick(NIGHT, replace(SEEN, commands=said), knows(0.6))
    assert [(answer.command, answer.ok) for answer in decision.answers] == [
        ("soc", True), ("minimum", True), ("horizon", True), ("minimum", False),
    ]  # fmt: skip
    assert [night.minimum for night in decision.sessions] == [0.6, 0.6]
    assert decision.memory.soc.mean == 0.3


def test_what_was_seen_goes_into_the_decision() -> None:
    faults = (Fault("store", "full"),)
    decision = Controller(HOME, Exact()).tick(NIGHT, replace(SEEN, faults=faults), knows(0.6))
    assert (decision.at, decision.faults, decision.forecast_issued_at) == (NIGHT, faults, NIGHT)
    assert decision.outlook
    assert decision.outlook.slots[0].start == NIGHT
    assert decision.outlook.slots[-1].start >= decision.sessions[-1].end - minutes(30)
    assert len(decision.sessions) == 4


def test_promises_are_made_on_the_cautious_soc() -> None:
    one = home()
    one = replace(one, nights=replace(one.nights, horizon=1), end_value=False)  # the minimum and no more
    sure, unsure = tick(knows(0.5), one), tick(knows(0.5, sd=0.02), one)
    assert on_h(sure) == 0.0
    assert on_h(unsure) == pytest.approx(0.041 * 50 / 2.3 / 0.9, abs=0.05)


def test_a_car_that_takes_less_is_planned_longer() -> None:
    one = replace(HOME, nights=Nights(horizon=1), end_value=False)
    usual, slow = tick(knows(0.45), one), tick(replace(knows(0.45), observed_kw=1.15), one)
    assert tonight_kwh(slow) == pytest.approx(tonight_kwh(usual)) == pytest.approx(2.5 / 0.9)
    assert on_h(slow) >= 2 * on_h(usual)


def test_what_is_driven_before_the_first_session_is_reckoned_with() -> None:
    """At noon today's driving is still to come: 11.28 kWh, the cautious quantile."""
    noon = at(12)
    told = replace(knows(0.6, noon), soc=replace(knows(0.6, noon).soc, driven_to=noon))
    one = replace(HOME, nights=Nights(horizon=1))
    seen = Observation(forecast=forecast(noon))
    need_kwh = 0.5 * 50 - (0.6 * 50 - 11.28)
    assert tonight_kwh(tick(told, one, seen, noon)) == pytest.approx(need_kwh / 0.9, abs=0.01)


def test_without_a_night_at_home_nothing_is_planned() -> None:
    never = replace(HOME, nights=Nights(week=tuple((day, DayRule(away=True)) for day in range(7))))
    decision = Controller(never, Exact()).tick(NIGHT, SEEN, tick(knows(0.6)))
    assert (decision.memory.plan, decision.memory.orders, decision.sessions) == (None, None, ())
    assert decision.status is Status.READY


def test_the_guard_fires_once_in_a_tick() -> None:
    late = at(6, day=3)
    decision = Controller(HOME, Exact()).tick(late, Observation(forecast=forecast(late)), knows(0.4))
    assert (decision.memory.guarding, decision.memory.guard_count) == (True, 1)
    assert decision.status is Status.CHARGING


def test_between_ticks_the_orders_stand_and_the_solver_rests() -> None:
    solver = Counted()
    controller = Controller(HOME, solver)
    memory = controller.tick(NIGHT, SEEN, knows(0.6)).memory
    action = controller.act(at(2, 10, day=3), Observation(), memory)
    assert action.on
    assert (action.memory.plan, action.memory.orders, solver.calls) == (memory.plan, memory.orders, 1)


def test_a_stored_plan_is_taken_up_without_the_solver() -> None:
    memory = tick(knows(0.6))
    solver = Counted()
    decision = Controller(HOME, solver).resume(NIGHT + minutes(10), SEEN, memory)
    assert (decision.memory.plan, decision.memory.orders, solver.calls) == (memory.plan, memory.orders, 0)
    assert decision.outlook
    assert decision.outlook.forecast_until
    assert memory.plan
    assert decision.sessions == tuple(night.session for night in memory.plan.sessions)
    assert decision.status is Status.WAITING


# -- the relay ------------------------------------------------------------------------------------


def test_only_this_sessions_switch_ons_are_on_the_budget() -> None:
    strict = replace(HOME, relay=RelayRules(max_switch_on=1, random_delay_s=0.0))
    before, tonight = at(19, 50), at(21)
    assert on_h(tick(replace(knows(0.6), switch_ons=(before,)), strict)) == pytest.approx(3.0)
    assert on_h(tick(replace(knows(0.6), switch_ons=(tonight,)), strict)) == 0.0


def test_the_budget_does_not_cut_what_the_morning_needs() -> None:
    strict = replace(HOME, nights=Nights(horizon=1), relay=RelayRules(max_switch_on=1, random_delay_s=0.0))
    started = replace(knows(0.3), relay_on=True, relay_since=at(22), switch_ons=(at(22),))
    one_block = tick(started, strict)
    assert len(ons(one_block)) == 2
    assert on_h(one_block) >= 0.2 * 50 / 2.3 / 0.9


def test_a_relay_that_has_just_gone_off_rests_first() -> None:
    now = at(2, day=3)
    seen = Observation(forecast=forecast(now))
    rested = replace(knows(0.6), relay_on=False, relay_since=at(1, 30, day=3))
    tired = replace(rested, relay_since=at(1, 55, day=3))
    assert ons(tick(rested, seen=seen, now=now))[0] == (now, True)
    assert ons(tick(tired, seen=seen, now=now))[0] == (now + minutes(5), True)


def test_the_random_delay_is_the_households_own() -> None:
    apart = replace(HOME, relay=RelayRules())
    first, again, other = (ons(tick(knows(0.6), apart, seed=seed))[0][0] for seed in ("a", "a", "b"))
    assert first == again != other
    for start in (first, other):
        assert at(2, day=3) <= start <= at(2, 10, day=3)


def test_no_more_than_soc_max_is_planned() -> None:
    memory = tick(knows(0.78))
    assert memory.plan
    assert memory.plan.sessions[0].soc_end <= 0.8 + 1e-9
    assert on_h(memory) <= 0.02 * 50 / 2.3 / 0.9 + 0.01


# -- a charger ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("now", "power_kw", "until"),
    [
        (at(2, 10, day=3), 7.4, at(2, 30, day=3)),
        (at(22), 0.0, at(22, 30)),
        (EVENING, 0.0, at(20, 3)),
    ],
    ids=["in a clean hour", "in a dirty one", "before the session"],
)
def test_a_charger_is_told_the_power_of_the_slot_under_way(now: datetime, power_kw: float, until: datetime) -> None:
    memory = tick(knows(0.4), CHARGER, Observation(forecast=forecast(now)), now)
    assert isinstance(memory.orders, Setpoint)
    assert memory.orders.power_kw == pytest.approx(power_kw, abs=1e-6)
    assert memory.orders.until == until


def test_a_slot_planned_at_all_the_car_takes_is_given_all_the_charger_has() -> None:
    """Else a car once seen to take less would never be given more again."""
    now = at(2, 10, day=3)
    memory = tick(replace(knows(0.4), observed_kw=5.0), CHARGER, Observation(forecast=forecast(now)), now)
    assert memory.plan
    assert memory.plan.sessions[0].slots[0].power_kw == pytest.approx(5.0)
    assert memory.orders == Setpoint(7.4, at(2, 30, day=3))


def test_a_persons_off_still_plans() -> None:
    off = replace(knows(0.6), overrides=Overrides(mode=Mode.OFF), presence=Presence(True, EVENING))
    decision = Controller(HOME, Exact()).tick(NIGHT, SEEN, off)
    assert decision.status is Status.OFF
    assert ons(decision.memory)
