"""The exact chain solver against HiGHS, and what must hold for any problem."""

import random
import subprocess
import sys
from dataclasses import replace
from math import inf, isfinite

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugd.planner import exact
from plugd.planner.bounds import chain
from plugd.planner.problem import Problem, ProblemSession, Solution
from tests.unit import planner_problems as make


def one(intensity: tuple[float, ...], energy_kwh: float, minimum_kwh: float) -> Problem:
    """One session of half hours at 10 kW into 50 kWh, ceiling 40."""
    own = ProblemSession(intensity, (0.5,) * len(intensity), (10.0,) * len(intensity), minimum_kwh, 40.0, 0.0)
    return Problem(energy_kwh, 10.0, 1.0, (own,))


def test_the_optimum_is_that_of_highs_on_5000_random_problems() -> None:
    rng = random.Random(20230102)
    infeasible = 0
    for number in range(5000):
        asked = make.problem(rng)
        solution = exact.solve(asked)
        best_g = make.oracle_g(asked)
        repaired = best_g is None
        if best_g is None:
            infeasible += 1
            best_g = make.oracle_g(make.as_repaired(asked))
        assert best_g is not None, number
        end_g = solution.carbon_g - solution.bound_g
        assert solution.bound_g == pytest.approx(best_g, rel=1e-8, abs=1e-6), number
        assert (solution.status == "repaired") == repaired, number
        assert end_g >= -1e-9, number
        assert make.faults(asked, solution) == [], number
        assert make.dearer_before_cheaper(asked, solution.power_kw) == [], number
        assert solution.gap == solution.raw_gap == solution.iterations == 0
    sys.stdout.write(f"5000 problems, {infeasible} of them repaired\n")
    assert 1500 < infeasible < 3500  # both kinds are there


@settings(max_examples=300)
@given(st.randoms(use_true_random=False))
def test_any_problem_has_a_sound_finite_plan(rng: random.Random) -> None:
    asked = make.problem(rng)
    solution = exact.solve(asked)
    assert make.faults(asked, solution) == []
    assert make.dearer_before_cheaper(asked, solution.power_kw) == []
    assert all(isfinite(x) for x in (*flat(solution), solution.carbon_g, solution.bound_g))
    for own, ends, short in zip(asked.sessions, solution.energy_kwh, solution.shortfall_kwh, strict=True):
        assert short == pytest.approx(max(0.0, own.minimum_kwh - ends), abs=1e-8)
    arrivals = zip(asked.sessions, solution.energy_kwh, solution.reserve_short_kwh, strict=True)
    for own, ends, short in list(arrivals)[:-1]:
        assert short == pytest.approx(max(0.0, asked.reserve_kwh + own.daily_use_kwh - ends), abs=1e-8)
    assert solution.reserve_short_kwh[-1] == 0
    short_at_all = any(solution.shortfall_kwh) or any(solution.reserve_short_kwh) or chain(asked).lifted
    assert (solution.status == "repaired") == short_at_all


def flat(solution: Solution) -> list[float]:
    powers = [p for power_kw in solution.power_kw for p in power_kw]
    return [*powers, *solution.energy_kwh, *solution.shortfall_kwh, *solution.reserve_short_kwh]


@settings(max_examples=200)
@given(st.randoms(use_true_random=False), st.floats(0.1, 20))
def test_more_energy_now_never_costs_carbon(rng: random.Random, more_kwh: float) -> None:
    asked = make.everyday(rng)
    richer = replace(asked, energy_kwh=min(asked.energy_kwh + more_kwh, 40.0))
    assert exact.solve(richer).carbon_g <= exact.solve(asked).carbon_g + 1e-6


def test_the_cheapest_slots_first_and_a_part_of_the_last() -> None:
    solution = exact.solve(one((300.0, 100.0, 200.0), 20.0, 27.0))
    assert solution.power_kw == ((0.0, 10.0, 4.0),)
    assert solution.energy_kwh == (27.0,)
    assert solution.carbon_g == pytest.approx(5 * 100 + 2 * 200)


def test_equal_slots_go_to_the_earlier() -> None:
    assert exact.solve(one((100.0,) * 3, 20.0, 27.0)).power_kw == ((10.0, 4.0, 0.0),)


def test_of_equal_slots_in_two_sessions_the_earlier_is_used() -> None:
    own = one((100.0, 100.0), 20.0, 20.0).sessions[0]
    asked = Problem(20.0, 0.0, 1.0, (own, replace(own, minimum_kwh=27.0)))
    assert exact.solve(asked).power_kw == ((10.0, 4.0), (0.0, 0.0))


def test_charge_waits_for_a_cleaner_night_but_no_longer_than_the_reserve_allows() -> None:
    dirty = ProblemSession((200.0,) * 4, (0.5,) * 4, (10.0,) * 4, 0.0, 40.0, 11.0)
    clean = replace(dirty, intensity_g_per_kwh=(50.0,) * 4, minimum_kwh=25.0)
    solution = exact.solve(Problem(20.0, 10.0, 1.0, (dirty, clean)))
    assert solution.energy_kwh == (21.0, 25.0)  # 10 on arrival: the reserve, no more


def test_no_reserve_after_the_last_session() -> None:
    own = ProblemSession((200.0,), (0.5,), (10.0,), 0.0, 40.0, 30.0)
    assert exact.solve(Problem(20.0, 10.0, 1.0, (own,))).power_kw == ((0.0,),)


def test_efficiency_stands_between_plug_and_battery() -> None:
    solution = exact.solve(replace(one((100.0, 200.0), 20.0, 24.0), efficiency=0.8))
    assert solution.power_kw == ((10.0, 0.0),)
    assert solution.carbon_g == pytest.approx(500)


def test_an_unreachable_minimum_is_approached_and_the_shortfall_told() -> None:
    solution = exact.solve(one((300.0, 100.0), 20.0, 35.0))
    assert solution.status == "repaired"
    assert solution.power_kw == ((10.0, 10.0),)
    assert solution.shortfall_kwh == (5.0,)


def test_a_minimum_above_the_ceiling_ends_at_the_ceiling() -> None:
    solution = exact.solve(one((100.0,) * 10, 20.0, 45.0))
    assert solution.energy_kwh == (40.0,)
    assert solution.shortfall_kwh == (5.0,)


def test_a_battery_above_its_ceiling_takes_nothing_and_the_bound_is_lifted() -> None:
    solution = exact.solve(one((-50.0,) * 3, 45.0, 25.0))
    assert solution.status == "repaired"
    assert solution.power_kw == ((0.0,) * 3,)
    assert solution.shortfall_kwh == (0.0,)


def test_negative_intensity_is_taken_up_to_the_ceiling() -> None:
    assert exact.solve(one((-50.0, 100.0, -10.0), 33.0, 25.0)).power_kw == ((10.0, 0.0, 4.0),)


def test_free_energy_is_not_taken_without_a_reason() -> None:
    assert exact.solve(one((0.0, 0.0), 30.0, 25.0)).power_kw == ((0.0, 0.0),)


def test_energy_left_is_charged_while_it_is_worth_more_than_it_costs() -> None:
    asked = replace(one((100.0, 120.0, 140.0), 25.0, 25.0), end_value=((7.0, 130.0), (50.0, 110.0)))
    solution = exact.solve(asked)
    assert solution.power_kw == ((10.0, 4.0, 0.0),)
    assert solution.bound_g == pytest.approx(5 * 100 + 2 * 120 - 7 * 130)


def test_the_end_value_counts_from_the_last_minimum_even_below_what_is_there() -> None:
    asked = replace(one((100.0, 100.0), 28.0, 25.0), end_value=((5.0, 130.0),))
    solution = exact.solve(asked)  # 3 of the 5 kWh are in the battery already
    assert solution.power_kw == ((4.0, 0.0),)
    assert solution.bound_g == pytest.approx(2 * 100 - 5 * 130)


def test_the_end_value_counts_from_what_can_be_reached_of_the_last_minimum() -> None:
    asked = replace(one((100.0,), 25.0, 38.0), end_value=((5.0, 130.0),))
    solution = exact.solve(asked)
    assert solution.shortfall_kwh == (8.0,)
    assert solution.bound_g == pytest.approx(5 * 100)


def test_an_endless_step_fills_to_the_ceiling() -> None:
    asked = replace(one((100.0,) * 10, 25.0, 25.0), end_value=((inf, 101.0),))
    assert exact.solve(asked).energy_kwh == (40.0,)


def test_efficiency_counts_against_the_end_value() -> None:
    asked = replace(one((100.0,), 25.0, 25.0), end_value=((inf, 105.0),), efficiency=0.9)
    assert exact.solve(asked).power_kw == ((0.0,),)  # 100 / 0.9 = 111 g for a battery kWh worth 105


def test_a_night_to_come_may_charge_for_days_without_a_session() -> None:
    night = ProblemSession((90.0,) * 6, (0.5,) * 6, (10.0,) * 6, 20.0, 40.0, 8.0)
    away = ProblemSession((), (), (), 20.0, 40.0, 8.0)
    cleaner = replace(night, intensity_g_per_kwh=(50.0,) * 6, minimum_kwh=15.0)
    solution = exact.solve(Problem(15.0, 10.0, 1.0, (night, away, cleaner)))
    assert solution.status == "solved"
    assert solution.power_kw[1] == ()
    assert solution.energy_kwh[:2] == (28.0, 20.0)


def test_a_partial_first_slot_takes_its_part() -> None:
    own = ProblemSession((50.0, 100.0), (0.2, 0.5), (10.0, 10.0), 25.0, 40.0, 0.0)
    assert exact.solve(Problem(20.0, 10.0, 1.0, (own,))).power_kw == ((10.0, 6.0),)


def test_elapsed_slots_stay_off_however_cheap() -> None:
    own = ProblemSession((-9.0, 100.0), (0.5, 0.5), (0.0, 10.0), 24.0, 40.0, 0.0)
    assert exact.solve(Problem(20.0, 10.0, 1.0, (own,))).power_kw == ((0.0, 8.0),)


def test_it_needs_no_numpy() -> None:
    program = (
        "import sys\n"
        "sys.modules.update(dict.fromkeys(('numpy', 'scipy', 'osqp')))\n"
        "from plugd.planner import exact\n"
        "from plugd.planner.problem import Problem, ProblemSession\n"
        "own = ProblemSession((100.0,), (0.5,), (10.0,), 24.0, 40.0, 0.0)\n"
        "print(exact.Exact().solve(Problem(20.0, 10.0, 1.0, (own,))).power_kw)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("((8.0,),)\n", "")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"slot_h": (0.5,)}, "length"),
        ({"intensity_g_per_kwh": (float("nan"), 1.0)}, "intensity_g_per_kwh"),
        ({"power_max_kw": (-1.0, 1.0)}, "power_max_kw"),
        ({"daily_use_kwh": -1.0}, "daily_use_kwh"),
        ({"minimum_kwh": inf}, "minimum_kwh"),
    ],
)
def test_a_session_that_makes_no_sense_cannot_be_built(change: dict[str, object], text: str) -> None:
    whole = ProblemSession((1.0, 2.0), (0.5, 0.5), (1.0, 1.0), 1.0, 2.0, 0.0)
    with pytest.raises(ValueError, match=text):
        replace(whole, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"efficiency": 0.0}, "efficiency"),
        ({"efficiency": 1.1}, "efficiency"),
        ({"energy_kwh": float("nan")}, "energy_kwh"),
        ({"sessions": ()}, "session"),
        ({"end_value": ((1.0, 5.0), (1.0, 6.0))}, "end_value"),
        ({"end_value": ((1.0, -5.0),)}, "end_value"),
        ({"end_value": ((float("nan"), 5.0),)}, "end_value"),
        ({"previous_power_kw": ((1.0, 2.0),)}, "previous_power_kw"),
        ({"previous_power_kw": ((inf,),)}, "previous_power_kw"),
    ],
)
def test_a_problem_that_makes_no_sense_cannot_be_built(change: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        replace(one((100.0,), 20.0, 25.0), **change)  # type: ignore[arg-type]
