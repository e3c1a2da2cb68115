"""A charger's least power: kept in every slot, every bound too, and near the mixed-integer optimum by HiGHS."""

import random
import statistics
import sys
import time
from dataclasses import replace
from math import ceil, floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, milp

from plugd.planner import exact
from plugd.planner.answer import account
from plugd.planner.bounds import Chain, chain, repair
from plugd.planner.exact import Exact
from plugd.planner.least_power import honoured
from plugd.planner.problem import Problem, ProblemSession, Solution, Solver
from plugd.planner.qp import Qp
from tests.unit import planner_problems as make


def with_least(asked: Problem, rng: random.Random) -> Problem:
    """The same with a charger's least power, often another one per session, sometimes above a slot's most."""
    return replace(
        asked,
        sessions=tuple(
            replace(own, power_min_kw=rng.choice((1.4, 1.4, 0.0, 4.1, rng.uniform(0, 10)))) for own in asked.sessions
        ),
    )


def relaxed(asked: Problem) -> Solution:
    """The exact plan without a least power."""
    return exact.solve(replace(asked, sessions=tuple(replace(own, power_min_kw=0.0) for own in asked.sessions)))


def unkept(asked: Problem, solution: Solution) -> list[str]:
    """Where a slot has more than 0 and less than the least power, or more than it can."""
    return [
        f"session {s}: {p} kW"
        for s, (own, power_kw) in enumerate(zip(asked.sessions, solution.power_kw, strict=True))
        for p, most in zip(power_kw, own.power_max_kw, strict=True)
        if 0 < p < own.power_min_kw or not 0 <= p <= most + 1e-9
    ]


def over_ceiling(asked: Problem, solution: Solution) -> list[int]:
    """Sessions that end above the repaired ceiling, or elsewhere than the powers lead."""
    level_kwh, found = asked.energy_kwh, []
    for s, (own, bound) in enumerate(zip(asked.sessions, make.as_repaired(asked).sessions, strict=True)):
        level_kwh += asked.efficiency * sum(p * h for p, h in zip(solution.power_kw[s], own.slot_h, strict=True))
        if level_kwh > bound.ceiling_kwh + 1e-6 or abs(level_kwh - solution.energy_kwh[s]) > 1e-6:
            found.append(s)
        level_kwh -= own.daily_use_kwh
    return found


def short_kwh(asked: Problem, solution: Solution) -> float:
    """By how much the repaired minima are missed in all."""
    bounds = make.as_repaired(asked).sessions
    return sum(max(0.0, own.minimum_kwh - ends) for own, ends in zip(bounds, solution.energy_kwh, strict=True))


def milp_g(asked: Problem) -> float | None:
    """The optimum with least powers by HiGHS, on the repaired bounds; None where none keeps them.

    Variables: battery kWh of every slot, whether it is used, what each step of the end value holds.
    """
    links = chain(asked)
    n, steps = len(links.room_kwh), len(asked.end_value)
    least = [asked.efficiency * own.power_min_kw * h for own in asked.sessions for h in own.slot_h]
    cost = np.array(
        [*(g / asked.efficiency for g in links.intensity_g_per_kwh), *[0.0] * n, *(-w for _, w in asked.end_value)]
    )
    sums = np.zeros((len(links.lower_kwh), len(cost)))
    for s in range(len(links.lower_kwh)):
        sums[s, : links.starts[s + 1]] = 1.0
    used = np.hstack([np.eye(n), -np.diag(links.room_kwh), np.zeros((n, steps))])
    open_ = np.hstack([np.eye(n), -np.diag(least), np.zeros((n, steps))])
    limits = [
        LinearConstraint(sums, links.lower_kwh, links.upper_kwh),
        LinearConstraint(used, -np.inf, 0.0),
        LinearConstraint(open_, 0.0, np.inf),
    ]
    if steps:
        held = np.concatenate([-np.ones(n), np.zeros(n), np.ones(steps)])
        limits.append(LinearConstraint(held, -np.inf, -links.lower_kwh[-1]))
    most = np.array([*links.room_kwh, *[1.0] * n, *(width for width, _ in asked.end_value)])
    found = milp(
        cost,
        integrality=np.array([0] * n + [1] * n + [0] * steps),
        bounds=(np.zeros(len(cost)), most),
        constraints=limits,
        options={"mip_rel_gap": 1e-7},
    )
    return None if found.x is None else float(found.fun)


@settings(max_examples=100)
@given(st.randoms(use_true_random=False), st.booleans())
def test_it_is_kept_by_both_solvers_on_any_problem_and_no_ceiling_is_passed(rng: random.Random, osqp: bool) -> None:
    asked = with_least(make.problem(rng), rng)
    solver: Solver = Qp() if osqp else Exact()
    solution = solver.solve(asked)
    assert unkept(asked, solution) == []
    assert over_ceiling(asked, solution) == []
    assert solution.bound_g == pytest.approx(relaxed(asked).bound_g)
    for own, ends, short in zip(asked.sessions, solution.energy_kwh, solution.shortfall_kwh, strict=True):
        assert short == pytest.approx(max(0.0, own.minimum_kwh - ends), abs=1e-8)
    if short_kwh(asked, solution) < 1e-6:
        assert solution.gap >= -1e-9


def on_or_off(rng: random.Random) -> Problem:
    """Equal slots, each wholly on or off."""
    power_kw = rng.choice((10.0, 7.4, 3.6, 2.3))
    asked = make.everyday(rng, power_kw=power_kw, sessions=rng.choice((1, 2, 4)), elapsed=rng.randrange(22))
    sessions = tuple(
        replace(
            own,
            intensity_g_per_kwh=make.prices(rng, 22),
            power_min_kw=power_kw,
            minimum_kwh=rng.choice((25.0, rng.uniform(5, 40))),
            ceiling_kwh=rng.choice((40.0, rng.uniform(25, 50))),
            daily_use_kwh=rng.choice((11.28, rng.uniform(0, 20))),
        )
        for own in asked.sessions
    )
    return replace(asked, sessions=sessions)


def whole_slots(asked: Problem, links: Chain) -> Chain | None:
    """Bounds that count whole slots, None where they cross: what the chain solver then gives is whole slots."""
    full_kwh = max(links.room_kwh)
    lower = [full_kwh * ceil(kwh / full_kwh - 1e-9) for kwh in links.lower_kwh]
    upper = [full_kwh * floor(kwh / full_kwh + 1e-9) for kwh in links.upper_kwh]
    low, high = repair(lower, upper, links.session_room_kwh)
    if any(abs(kept - wanted) > 1e-9 for kept, wanted in zip((*low, *high), (*lower, *upper), strict=True)):
        return None
    return replace(links, lower_kwh=low, upper_kwh=high)


def test_on_or_off_is_highs_s_optimum_on_300_random_problems() -> None:
    """By the chain solver alone, its bounds rounded to whole slots: then every slot of its plan is whole."""
    rng = random.Random(12)
    compared = impossible = 0
    while compared < 300:
        asked = on_or_off(rng)
        links = chain(asked)
        best_g, rounded = milp_g(asked), whole_slots(asked, links)
        assert (best_g is None) == (rounded is None), compared
        if best_g is None or rounded is None:
            impossible += 1
            continue
        compared += 1
        charge_kwh = exact.optimum(asked, rounded)
        assert all(x < 1e-9 or x > room - 1e-9 for x, room in zip(charge_kwh, links.room_kwh, strict=True)), compared
        assert account(asked, links, charge_kwh).objective_g == pytest.approx(best_g, rel=1e-6, abs=1e-4), compared
    sys.stdout.write(f"{compared} compared, {impossible} without any such plan\n")
    assert impossible > 10


@pytest.mark.parametrize("solver", [Exact(), Qp()])
def test_on_or_off_no_minimum_is_missed_that_whole_slots_can_keep(solver: Solver) -> None:
    rng = random.Random(14)
    missed, losses = [], []
    for number in range(150):
        asked = on_or_off(rng)
        links = chain(asked)
        rounded = whole_slots(asked, links)
        solution = solver.solve(asked)
        assert unkept(asked, solution) == []
        assert over_ceiling(asked, solution) == []
        if rounded is None:
            continue
        if short_kwh(asked, solution) > 1e-6:
            missed.append(number)
        best_g = account(asked, links, exact.optimum(asked, rounded)).objective_g
        objective_g = solution.bound_g + solution.gap * max(abs(solution.bound_g), 1.0)
        losses.append((objective_g - best_g) / max(abs(best_g), 1.0))
    sys.stdout.write(f"{len(losses)} compared, {len(missed)} missed, worst {100 * max(losses):.3f} %\n")
    assert missed == []
    assert max(losses) < 5e-3


def test_on_200_random_problems_it_is_within_half_a_percent_of_highs() -> None:
    rng = random.Random(11)
    losses, gaps, missed, impossible = [], [], 0, 0
    for number in range(200):
        asked = with_least(make.problem(rng), rng)
        if not any(own.slot_h for own in asked.sessions):
            continue  # no night at all
        solution = exact.solve(asked)
        best_g = milp_g(asked)
        objective_g = solution.bound_g + solution.gap * max(abs(solution.bound_g), 1.0)
        if best_g is None:
            impossible += 1
            assert short_kwh(asked, solution) > 1e-7, number
        elif short_kwh(asked, solution) > 1e-6:
            missed += 1
        else:
            losses.append((objective_g - best_g) / max(abs(best_g), 1.0))
            gaps.append(solution.gap)
    losses.sort()
    sys.stdout.write(
        f"{len(losses)} compared: against HiGHS mean {100 * statistics.mean(losses):.4f} %, worst "
        f"{100 * losses[-1]:.3f} %; gap to the relaxed bound mean {100 * statistics.mean(gaps):.3f} %; "
        f"{impossible} without any such plan, {missed} missed\n"
    )
    assert missed == 0
    assert losses[0] > -1e-6
    assert statistics.mean(losses) < 1e-4
    assert losses[-1] < 5e-3
    assert len(losses) > 120
    assert impossible > 5


@pytest.mark.parametrize("solver", [Exact(), Qp()])
def test_an_everyday_problem_loses_little_against_the_relaxed_bound(solver: Solver) -> None:
    rng = random.Random(3)
    gaps = []
    for _ in range(60):
        asked = make.everyday(rng, power_kw=7.4)
        asked = replace(asked, sessions=tuple(replace(own, power_min_kw=1.4) for own in asked.sessions))
        solution = solver.solve(asked)
        assert unkept(asked, solution) == []
        assert make.faults(asked, solution) == []
        gaps.append(solution.gap)
    sys.stdout.write(
        f"{type(solver).__name__}: mean gap {100 * statistics.mean(gaps):.4f} %, worst {100 * max(gaps):.3f} %\n"
    )
    assert statistics.mean(gaps) < 1e-3
    assert max(gaps) < 1e-2


def one(intensity: tuple[float, ...], need_kwh: float, least_kw: float, ceiling_kwh: float = 40.0) -> Problem:
    """One session of half hours at 10 kW, 20 kWh in the battery."""
    own = ProblemSession(
        intensity, (0.5,) * len(intensity), (10.0,) * len(intensity), 20.0 + need_kwh, ceiling_kwh, 0.0, least_kw
    )
    return Problem(20.0, 10.0, 1.0, (own,))


@pytest.mark.parametrize("solver", [Exact(), Qp()])
def test_what_is_too_little_takes_from_the_dearest_slot_beside_it(solver: Solver) -> None:
    solution = solver.solve(one((100.0, 200.0, 300.0), 10.5, 4.0))  # 5 and 5 and half a kWh, where 2 are the least
    assert solution.power_kw[0] == pytest.approx((10.0, 7.0, 4.0))
    assert solution.energy_kwh == pytest.approx((30.5,))
    assert solution.gap == pytest.approx(1.5 * 100 / (500 + 1000 + 150))


def test_where_a_little_more_is_cheaper_than_moving_more_is_charged() -> None:
    solution = exact.solve(one((100.0, 900.0, 100.5), 5.5, 2.0))
    assert solution.power_kw[0] == pytest.approx((9.0, 0.0, 2.0))


def test_alone_too_little_is_raised_where_the_ceiling_allows_and_else_left_and_told() -> None:
    assert exact.solve(one((100.0,), 0.5, 4.0)).power_kw == ((4.0,),)
    below = exact.solve(one((100.0,), 0.5, 4.0, ceiling_kwh=21.0))
    assert below.power_kw == ((0.0,),)
    assert below.shortfall_kwh == (0.5,)
    assert below.status == "repaired"


def test_a_slot_weaker_than_the_least_power_takes_nothing() -> None:
    asked = one((10.0, 100.0), 3.0, 4.0)
    own = replace(asked.sessions[0], power_max_kw=(3.9, 10.0))
    assert exact.solve(replace(asked, sessions=(own,))).power_kw == ((0.0, 6.0),)


def test_a_plan_that_keeps_it_anyway_is_left_alone() -> None:
    assert exact.solve(one((100.0, 200.0), 7.0, 4.0)).power_kw == ((10.0, 4.0),)
    assert exact.solve(one((100.0, 200.0), 7.0, 4.0)) == relaxed(one((100.0, 200.0), 7.0, 4.0))


def test_without_one_nothing_is_searched() -> None:
    def never(problem: Problem, links: Chain) -> list[float]:
        raise AssertionError

    plain = one((100.0, 200.0), 5.5, 0.0)
    solution = exact.solve(plain)
    assert honoured(plain, solution, never) is solution


def test_a_week_of_22_slots_takes_less_than_a_second() -> None:
    rng = random.Random(5)
    asked = make.everyday(rng, power_kw=7.4, sessions=7)
    asked = replace(asked, sessions=tuple(replace(own, power_min_kw=4.0) for own in asked.sessions))
    began = time.process_time()
    exact.solve(asked)
    assert time.process_time() - began < 1.0
