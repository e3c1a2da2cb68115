"""OSQP gets three slots a session: what that can cost, against the same quadratic problem over all of them."""

import random
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import osqp
import pytest
import scipy.sparse

from plugd.planner import exact
from plugd.planner.answer import account
from plugd.planner.bounds import Chain, chain
from plugd.planner.condensed import TYPICAL_G_PER_KWH
from plugd.planner.problem import Problem, Series
from plugd.planner.qp import FIRST, MAX_GAP, SOLVED, Qp
from tests.unit import planner_problems as make

KINDS = ("flat", "tied", "whole numbers", "nearly tied", "within the proximal term's reach", "spread")


def prices(rng: random.Random, kind: str) -> Series:
    """22 intensities."""
    draw: dict[str, Callable[[], float]] = {
        "flat": lambda: 120.0,
        "tied": lambda: float(rng.randrange(50, 250, 50)),
        "whole numbers": lambda: float(rng.randrange(100, 140)),
        "nearly tied": lambda: 150 + rng.uniform(-0.3, 0.3),
        "within the proximal term's reach": lambda: 150 + rng.uniform(-1.5, 1.5),
        "spread": lambda: rng.uniform(20, 350),
    }
    return tuple(draw[kind]() for _ in range(22))


def stated(rng: random.Random, kind: str) -> Problem:
    """An everyday problem with such prices, half of them with a plan before."""
    power_kw = rng.choice((10.0, 3.6, 2.3))
    asked = make.everyday(rng, power_kw=power_kw, sessions=rng.choice((1, 2, 4)), elapsed=rng.randrange(22))
    sessions = tuple(replace(own, intensity_g_per_kwh=prices(rng, kind)) for own in asked.sessions)
    before: tuple[Series, ...] | None = None
    if rng.random() < 0.5:
        before = tuple(tuple(rng.choice((0.0, 0.0, 0.0, power_kw)) for _ in range(22)) for _ in sessions)
    return replace(asked, sessions=sessions, previous_power_kw=before)


def kwh(asked: Problem, power_kw: tuple[Series, ...]) -> list[float]:
    """Battery kWh per slot."""
    return [
        asked.efficiency * p * h
        for own, powers in zip(asked.sessions, power_kw, strict=True)
        for p, h in zip(powers, own.slot_h, strict=True)
    ]


def terms(asked: Problem, links: Chain) -> tuple[np.ndarray, float]:
    """Cost of a full slot, the pull of the plan before included, in typical slots; battery kWh of a full slot."""
    full_kwh = max(links.room_kwh)
    before = kwh(asked, asked.previous_power_kw) if asked.previous_power_kw else [0.0] * len(links.room_kwh)
    return np.array(links.intensity_g_per_kwh) / TYPICAL_G_PER_KWH - FIRST.epsilon * np.array(
        before
    ) / full_kwh, full_kwh


def quadratic(asked: Problem, links: Chain, charge_kwh: list[float]) -> float:
    """What the quadratic problem makes of a plan."""
    cost, full_kwh = terms(asked, links)
    x = np.array(charge_kwh) / full_kwh
    return float(cost @ x + FIRST.epsilon / 2 * x @ x)


def over_all_slots(asked: Problem, links: Chain) -> list[float] | None:
    """Battery kWh per slot of the quadratic problem's optimum over every column, by OSQP from nothing; None where it
    does not get there.
    """
    cost, full_kwh = terms(asked, links)
    n = len(cost)
    sums = np.array([[1.0] * end + [0.0] * (n - end) for end in links.starts[1:]])
    solver = osqp.OSQP(algebra="builtin")
    solver.setup(
        scipy.sparse.csc_matrix(scipy.sparse.diags([FIRST.epsilon] * n)),
        cost,
        scipy.sparse.csc_matrix(np.vstack([np.eye(n), sums])),
        np.concatenate([np.zeros(n), np.array(links.lower_kwh) / full_kwh]),
        np.concatenate([links.room_kwh, links.upper_kwh]) / full_kwh,
        verbose=False,
        eps_abs=1e-6,
        eps_rel=1e-6,
        max_iter=20_000,
    )
    found = solver.solve(raise_error=False)
    return [float(x) * full_kwh for x in found.x] if found.info.status_val == SOLVED else None


def linear_g(asked: Problem, links: Chain, charge_kwh: list[float]) -> float:
    return account(asked, links, charge_kwh).objective_g


@pytest.mark.parametrize("kind", KINDS)
def test_three_slots_cost_no_carbon_and_no_more_than_the_width_of_a_near_tie(kind: str) -> None:
    """The plan's carbon is at most the whole problem's; its quadratic objective can only be off by what the proximal
    term itself weighs: epsilon for half the plan and for what the plan before pulls at.
    """
    rng = random.Random(f"window {kind}")
    compared, same, worst_g, worst = 0, 0, 0.0, 0.0
    for number in range(100):
        asked = stated(rng, kind)
        links = chain(asked)
        whole_kwh = over_all_slots(asked, links)
        if whole_kwh is None:
            continue
        solution = Qp().solve(asked)
        plan_kwh, full_kwh = kwh(asked, solution.power_kw), max(links.room_kwh)
        dearer_g = linear_g(asked, links, plan_kwh) - linear_g(asked, links, whole_kwh)
        off = quadratic(asked, links, plan_kwh) - quadratic(asked, links, whole_kwh)
        before_kwh = kwh(asked, asked.previous_power_kw) if asked.previous_power_kw else []
        assert solution.solver == "osqp", number
        assert dearer_g <= MAX_GAP * max(1.0, abs(solution.bound_g)), number
        assert -1e-4 <= off <= FIRST.epsilon * (sum(plan_kwh) / 2 + sum(before_kwh)) / full_kwh + 1e-4, number
        compared += 1
        same += off < 1e-4
        worst_g, worst = max(worst_g, dearer_g), max(worst, off)
    sys.stdout.write(
        f"{kind}: of {compared} {same} are the whole problem's; at worst {worst_g:.3f} g, {worst:.4f} off\n"
    )
    assert compared > 90


def test_of_equal_slots_some_are_filled_instead_of_all_a_little() -> None:
    """Of flat prices any order is as good: the whole problem spreads the charge, the plan keeps full slots."""
    asked = stated(random.Random(1), "flat")
    asked = replace(asked, previous_power_kw=None)
    links = chain(asked)
    used = sum(x > 1e-3 for x in kwh(asked, Qp().solve(asked).power_kw))
    assert used < sum(x > 1e-3 for x in over_all_slots(asked, links) or ())
    assert Qp().solve(asked).carbon_g == pytest.approx(exact.solve(asked).carbon_g, rel=MAX_GAP)
