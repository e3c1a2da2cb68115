"""The limits of the real world in a problem file: each is read, planned by both solvers, and kept."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from plugd.planner import exact
from plugd.planner.exact import Exact
from plugd.planner.problem import Problem, Solution, Solver
from plugd.planner.qp import Qp
from plugd.problem_file import read
from tests.unit import planner_problems as make

Ask = Callable[..., tuple[Problem, Solution]]


@pytest.fixture(params=[Exact, Qp])
def ask(request: pytest.FixtureRequest, tmp_path: Path) -> Ask:
    """Plan a problem file of these sessions."""
    solver: Solver = request.param()

    def asked(*sessions: dict[str, Any], **changes: Any) -> tuple[Problem, Solution]:
        document = {
            "slot_h": 0.5, "power_max_kw": 10.0, "capacity_kwh": 50.0, "efficiency": 1.0, "soc_pct": 40.0,
            "soc_min_pct": 20.0, "soc_max_pct": 80.0, "sessions": sessions, **changes,
        }  # fmt: skip
        path = tmp_path / "problem.json"
        path.write_text(json.dumps(document))
        problem, _ = read(path)
        solution = solver.solve(problem)
        assert solution.bound_g == pytest.approx(exact.solve(problem).bound_g)
        return problem, solution

    return asked


def night(intensity: list[float], minimum_pct: float = 50.0, use_kwh: float = 5.0, **own: Any) -> dict[str, Any]:
    return {"intensity": intensity, "morning_minimum_pct": minimum_pct, "daily_use_kwh": use_kwh, **own}


def test_a_taper_is_a_list_of_powers(ask: Ask) -> None:
    problem, solution = ask(night([100.0, 90.0, 80.0, 70.0], 70.0, power_max_kw=[10.0, 10.0, 8.0, 5.0]))
    assert solution.power_kw[0] == pytest.approx((7.0, 10.0, 8.0, 5.0), abs=0.01)
    assert make.faults(problem, solution) == []


def test_a_chargers_least_power(ask: Ask) -> None:
    _, solution = ask(night([100.0, 200.0, 300.0], 61.0, power_min_kw=4.0))
    assert solution.power_kw[0] == pytest.approx((10.0, 7.0, 4.0), abs=0.01)
    assert all(p == 0 or p >= 4.0 for p in solution.power_kw[0])
    assert solution.gap > 0.05  # honest: the relaxed bound has 10, 10 and 1 kW


def test_two_sessions_in_one_day_with_nothing_driven_between(ask: Ask) -> None:
    noon, evening = night([50.0, 60.0], 0.0, 0.0), night([200.0, 190.0, 180.0], 60.0)
    problem, solution = ask(noon, evening, night([100.0] * 4))
    assert solution.energy_kwh[:2] == pytest.approx((30.0, 30.0), abs=0.01)
    assert solution.power_kw[1] == pytest.approx((0.0,) * 3, abs=0.01)
    assert make.faults(problem, solution) == []


def test_sessions_of_unequal_length_and_slots(ask: Ask) -> None:
    quarter = night([90.0, 10.0, 80.0], 45.0, slot_h=0.25)
    mixed = night([100.0, 50.0], 50.0, slot_h=[1.0, 0.1])
    problem, solution = ask(quarter, mixed)
    assert [len(power_kw) for power_kw in solution.power_kw] == [3, 2]
    assert solution.power_kw[0] == pytest.approx((10.0, 10.0, 10.0), abs=0.01)  # 7.5 kWh, all below 100 g/kWh
    assert solution.power_kw[1] == pytest.approx((1.5, 10.0), abs=0.01)
    assert make.faults(problem, solution) == []


def test_a_day_without_a_session_is_charged_for_before(ask: Ask) -> None:
    problem, solution = ask(night([100.0] * 6, 50.0, 10.0), night([], 35.0, 10.0), night([10.0] * 6, 30.0))
    assert solution.power_kw[1] == ()
    # the empty day keeps its own minimum of 35 %, and the reserve on coming home from it
    assert solution.energy_kwh[0] == pytest.approx(30.0, abs=0.01)
    assert solution.shortfall_kwh == (0.0, 0.0, 0.0)
    assert make.faults(problem, solution) == []


def test_a_trips_own_minimum_above_the_ceiling_ends_at_the_ceiling_and_is_told(ask: Ask) -> None:
    problem, solution = ask(night([100.0] * 8, 90.0))
    assert solution.status == "repaired"
    assert solution.energy_kwh == pytest.approx((40.0,))
    assert solution.shortfall_kwh == pytest.approx((5.0,))
    assert make.faults(problem, solution) == []


def test_a_trip_with_a_ceiling_of_its_own_and_a_lower_one_after_it(ask: Ask) -> None:
    trip, after = night([100.0] * 8, 90.0, 2.0, soc_max_pct=90.0), night([1.0] * 8, 50.0)
    problem, solution = ask(trip, after)  # comes home at 86 %, above the ceiling of 80
    assert solution.energy_kwh == pytest.approx((45.0, 43.0))
    assert solution.power_kw[1] == (0.0,) * 8
    assert solution.shortfall_kwh == (0.0, 0.0)
    assert solution.status == "repaired"
    assert make.faults(problem, solution) == []


def test_ceilings_that_fall_from_night_to_night_hold_the_clean_first_one_back(ask: Ask) -> None:
    clean, later = night([10.0] * 8, 40.0, 0.0), night([200.0] * 8, 50.0, soc_max_pct=55.0)
    problem, solution = ask(clean, later, end_value_g_per_kwh=100.0)
    assert solution.energy_kwh == pytest.approx((27.5, 27.5), abs=0.01)
    assert make.faults(problem, solution) == []
