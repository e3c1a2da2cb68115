"""The battery that takes less as it fills: the closed form, and a plan that never counts on more than it takes."""

import random
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from plugd import outlook, sessions
from plugd.domain import Car, Household, Overrides, Presence
from plugd.planner import exact, nights, taper
from plugd.planner.exact import Exact
from plugd.planner.problem import Problem, ProblemSession, Solution
from plugd.planner.qp import Qp
from tests.unit import planner_problems as make

CAR = Car(capacity_kwh=50.0, efficiency=0.9, taper_from=0.7, taper_share=0.2)


def stepped_kwh(car: Car, energy_kwh: float, power_kw: float, for_h: float) -> float:
    """The same by 20,000 small steps, from the words alone."""
    for _ in range(20_000):
        over = (energy_kwh / car.capacity_kwh - car.taper_from) / (1.0 - car.taper_from)
        share = 1.0 - (1.0 - car.taper_share) * min(max(over, 0.0), 1.0)
        energy_kwh += car.efficiency * power_kw * share * for_h / 20_000
    return energy_kwh


@pytest.mark.parametrize("energy_kwh", [10.0, 33.0, 35.0, 36.5, 49.0])
@pytest.mark.parametrize("for_h", [0.1, 0.5, 3.0])
def test_the_closed_form_is_what_small_steps_come_to(energy_kwh: float, for_h: float) -> None:
    wanted_kwh = stepped_kwh(CAR, energy_kwh, 7.4, for_h)
    if wanted_kwh <= CAR.capacity_kwh:
        assert taper.reached_kwh(CAR, energy_kwh, 7.4, for_h) == pytest.approx(wanted_kwh, abs=2e-3)


def test_without_a_taper_the_whole_power_flows_to_the_end() -> None:
    for car in (replace(CAR, taper_from=1.0), replace(CAR, taper_share=1.0)):
        assert taper.reached_kwh(car, 45.0, 10.0, 0.5) == pytest.approx(49.5)
    assert taper.reached_kwh(CAR, 45.0, 0.0, 0.5) == 45.0
    assert taper.reached_kwh(CAR, 45.0, 10.0, 0.0) == 45.0


def test_an_estimate_above_full_still_has_the_last_share_and_never_a_power_below_none() -> None:
    gained_kwh = taper.reached_kwh(CAR, 52.0, 10.0, 0.01) - 52.0
    assert gained_kwh == pytest.approx(0.2 * 9.0 * 0.01, rel=0.05)


@pytest.mark.parametrize(("energy_kwh", "target_kwh"), [(20.0, 34.0), (20.0, 45.0), (36.0, 50.0), (34.9, 35.1)])
@pytest.mark.parametrize("power_kw", [2.3, 10.0])
def test_the_time_to_a_target_is_that_of_its_energy_at_full_power(
    energy_kwh: float, target_kwh: float, power_kw: float
) -> None:
    for_h = taper.flat_kwh(CAR, energy_kwh, target_kwh) / (CAR.efficiency * power_kw)
    assert taper.reached_kwh(CAR, energy_kwh, power_kw, for_h) == pytest.approx(target_kwh, abs=1e-6)


def test_without_a_taper_and_with_nothing_missing_energy_is_what_it_is() -> None:
    for car in (replace(CAR, taper_from=1.0), replace(CAR, taper_share=1.0)):
        assert taper.flat_kwh(car, 20.0, 45.0) == 25.0
    assert taper.flat_kwh(CAR, 20.0, 35.0) == 15.0
    assert taper.flat_kwh(CAR, 45.0, 45.0) == 0.0
    assert taper.flat_kwh(CAR, 45.0, 40.0) < 0.0


def taken(car: Car, asked: Problem, solution: Solution) -> list[float]:
    """How much less the car takes than each session's powers ask, battery kWh."""
    energy_kwh, less = asked.energy_kwh, []
    for own, powers in zip(asked.sessions, solution.power_kw, strict=True):
        less.append(0.0)
        for p, most, h in zip(powers, own.power_max_kw, own.slot_h, strict=True):
            could_kwh = taper.reached_kwh(car, energy_kwh, most, h) - energy_kwh
            wanted_kwh = car.efficiency * p * h
            less[-1] += max(0.0, wanted_kwh - could_kwh)
            energy_kwh += min(wanted_kwh, could_kwh)
        energy_kwh -= own.daily_use_kwh
    return less


@pytest.mark.parametrize("osqp", [False, True])
def test_no_plan_counts_on_more_than_the_car_will_take(osqp: bool) -> None:
    rng = random.Random(17)
    solver = Qp() if osqp else Exact()
    tapered = 0
    for _ in range(60):
        asked = make.everyday(rng, power_kw=rng.choice((3.6, 7.4, 10.0)))
        own = tuple(replace(s, minimum_kwh=rng.uniform(25, 46), ceiling_kwh=48.0) for s in asked.sessions)
        asked = replace(asked, sessions=own)
        stated, solution = taper.solve(solver, asked, CAR)
        tapered += stated is not asked
        assert sum(taken(CAR, asked, solution)) < 0.02  # a fiftieth of a kWh, of four nights
        assert make.faults(stated, solution) == []
    assert tapered > 30


def night(slots: int, minimum_kwh: float, energy_kwh: float = 25.0) -> Problem:
    own = ProblemSession(
        tuple(100.0 + k for k in range(slots)), (0.5,) * slots, (10.0,) * slots, minimum_kwh, 50.0, 0.0
    )
    return Problem(energy_kwh, 10.0, 0.9, (own,))


def test_the_slots_above_the_knee_have_less_and_more_of_them_are_used() -> None:
    _, solution = taper.solve(Exact(), night(20, 45.0), CAR)
    without = exact.solve(night(20, 45.0))
    used = [p for p in solution.power_kw[0] if p > 0]
    assert used[0] == 10.0
    assert used == sorted(used, reverse=True)
    assert len(used) > sum(p > 0 for p in without.power_kw[0])
    assert solution.energy_kwh[0] == pytest.approx(45.0)
    own = taper.limits_kw(CAR, night(20, 45.0), solution.power_kw)[0]
    assert all(p <= most + taper.REST_KW for p, most in zip(solution.power_kw[0], own, strict=True))
    assert own[-1] == pytest.approx((taper.reached_kwh(CAR, 45.0, 10.0, 0.5) - 45.0) / 0.45)


def test_a_minimum_out_of_reach_is_approached_flat_out_and_the_honest_rest_told() -> None:
    _, solution = taper.solve(Exact(), night(6, 48.0), CAR)
    reached = taper.reached_kwh(CAR, 25.0, 10.0, 3.0)
    assert solution.energy_kwh[0] == pytest.approx(reached, abs=1e-6)
    assert solution.shortfall_kwh[0] == pytest.approx(48.0 - reached, abs=1e-6)


def test_below_the_knee_nothing_changes_and_nothing_is_planned_twice() -> None:
    asked = night(8, 30.0)
    stated, solution = taper.solve(Exact(), asked, CAR)
    assert stated is asked
    assert solution == exact.solve(asked)


def test_a_charger_whose_least_power_is_more_than_the_full_car_takes_still_fills_it() -> None:
    asked = night(24, 49.0)
    asked = replace(asked, sessions=(replace(asked.sessions[0], power_min_kw=4.1),))
    _, solution = taper.solve(Exact(), asked, CAR)
    assert solution.energy_kwh[0] == pytest.approx(49.0, abs=1e-6)


def test_the_limits_can_be_written_in_the_words_of_a_problem() -> None:
    asked = night(20, 45.0)
    stated, solution = taper.solve(Exact(), asked, CAR)
    same = replace(asked, sessions=(replace(asked.sessions[0], power_max_kw=stated.sessions[0].power_max_kw),))
    assert exact.solve(same).power_kw == solution.power_kw


def test_the_plan_of_a_house_shows_the_limits_of_the_taper() -> None:
    house = Household(car=replace(CAR, soc_max=0.95))
    now = datetime(2023, 1, 2, 12, tzinfo=UTC)
    coming = sessions.expected(now, house, Overrides(), Presence(), 2)
    coming = tuple(replace(session, minimum=0.9) for session in coming)
    power_kw, energy_kwh = 10.0, 30.0
    parts = nights.layout(coming, now, energy_kwh, power_kw, house)
    found = outlook.extend(None, (), now, coming[-1].end)
    asked = nights.problem(parts, found, energy_kwh, None, house)
    stated, solution = taper.solve(Exact(), asked, house.car)
    plan = nights.plan(now, parts, stated, solution, house)
    limits = [slot.limit_kw for slot in plan.sessions[0].slots]
    assert plan.sessions[0].soc_end == pytest.approx(0.9)
    assert limits[0] == pytest.approx(10.0)
    assert min(limits) < 5.0
    assert all(slot.power_kw <= slot.limit_kw + 1e-9 for slot in plan.slots())
