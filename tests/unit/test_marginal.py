"""The prices of the bounds against solving again with the bound moved; the marginal slots; what was moved."""

import random
import sys
from dataclasses import replace
from math import inf

import pytest

from plugd.planner import exact
from plugd.planner.bounds import chain, end_value_g, session_charges_kwh
from plugd.planner.marginal import USED_KWH, Explanation, MarginalSlot, Move, Price, explain
from plugd.planner.prices import binding, common, end_worth_g_per_kwh
from plugd.planner.problem import Problem, ProblemSession
from plugd.planner.qp import Qp
from tests.unit import planner_problems as make

STEP_KWH = 1e-3


def with_floor(asked: Problem, s: int, step_kwh: float) -> tuple[Problem, float]:
    """The problem with the minimum of session `s` moved, the end value left where it was; and what that takes off
    the value told.
    """
    own = asked.sessions[s]
    moved = replace(own, minimum_kwh=own.minimum_kwh + step_kwh)
    sessions = (*asked.sessions[:s], moved, *asked.sessions[s + 1 :])
    steps, taken_g = asked.end_value, 0.0
    if s == len(sessions) - 1 and steps:
        if step_kwh < 0:
            steps, taken_g = ((-step_kwh, steps[0][1]), *steps), step_kwh * steps[0][1]
        else:
            taken_g = end_value_g(asked, step_kwh)
            left, cut = [], step_kwh
            for width_kwh, worth in steps:
                off_kwh = min(cut, width_kwh)
                cut -= off_kwh
                if width_kwh > off_kwh:
                    left.append((width_kwh - off_kwh, worth))
            steps = tuple(left)
    return replace(asked, sessions=sessions, end_value=steps), taken_g


def with_ceiling(asked: Problem, s: int, step_kwh: float) -> Problem:
    own = asked.sessions[s]
    moved = replace(own, ceiling_kwh=own.ceiling_kwh + step_kwh)
    return replace(asked, sessions=(*asked.sessions[:s], moved, *asked.sessions[s + 1 :]))


def keeps(asked: Problem) -> bool:
    """Whether every bound can be kept as it stands."""
    solution = exact.solve(asked)
    return not (any(short > 1e-7 for short in solution.shortfall_kwh) or chain(asked).lifted)


def with_end(asked: Problem, rng: random.Random) -> Problem:
    return replace(asked, end_value=make.end_value(rng))


def told(asked: Problem) -> Explanation:
    return explain(asked, exact.solve(asked))


def test_the_price_of_a_minimum_lies_between_the_differences_of_solving_again() -> None:
    rng = random.Random(29)
    priced = tight = impossible = 0
    for number in range(500):
        asked = make.as_repaired(make.problem(rng) if number % 2 else with_end(make.everyday(rng), rng))
        base_g = exact.solve(asked).bound_g
        for s, margin in enumerate(told(asked).margins):
            price = margin.floor_price
            assert margin.floor == "minimum"
            less, taken_g = with_floor(asked, s, -STEP_KWH)
            saved = (base_g - (exact.solve(less).bound_g - taken_g)) / STEP_KWH
            assert saved <= price.less_saves + 1e-3
            more, taken_g = with_floor(asked, s, STEP_KWH)
            if not keeps(more):
                impossible += price.more_costs is None
                continue
            cost = (exact.solve(more).bound_g - taken_g - base_g) / STEP_KWH
            assert price.more_costs is not None
            assert price.less_saves <= price.more_costs + 1e-6
            assert price.more_costs <= cost + 1e-3
            priced += price.more_costs > 0
            tight += (
                price.more_costs > 0 and abs(cost - price.more_costs) < 1e-3 and abs(saved - price.less_saves) < 1e-3
            )
    sys.stdout.write(
        f"{priced} minima with a price, {tight} equal to both differences; {impossible} not to be raised\n"
    )
    assert priced > 200
    assert tight > 0.98 * priced
    assert impossible > 50


def test_what_a_ceiling_costs_lies_between_the_differences_of_solving_again() -> None:
    rng = random.Random(31)
    priced = equal = 0
    for _ in range(500):
        asked = make.as_repaired(make.problem(rng))
        base_g = exact.solve(asked).bound_g
        for s, margin in enumerate(told(asked).margins):
            saved = (base_g - exact.solve(with_ceiling(asked, s, STEP_KWH)).bound_g) / STEP_KWH
            assert saved <= margin.ceiling_saves + 1e-3
            lower = with_ceiling(asked, s, -STEP_KWH)
            if keeps(lower):
                assert margin.ceiling_saves <= (exact.solve(lower).bound_g - base_g) / STEP_KWH + 1e-3
            priced += margin.ceiling_saves > 0
            equal += margin.ceiling_saves > 0 and abs(saved - margin.ceiling_saves) < 1e-3
    sys.stdout.write(f"{priced} ceilings with a price, {equal} equal to the difference\n")
    assert priced > 150
    assert equal > 0.9 * priced


def test_where_both_sides_agree_it_is_the_dual_of_the_exact_plan() -> None:
    rng = random.Random(37)
    compared = 0
    for _ in range(200):
        asked = make.everyday(rng)
        links = chain(asked)
        charge = exact.optimum(asked, links)
        totals = session_charges_kwh(links, charge)
        above_kwh = sum(totals) - links.lower_kwh[-1]
        end_g = end_worth_g_per_kwh(asked, above_kwh) * asked.efficiency
        margins = []
        for a, b in zip(links.starts, links.starts[1:], strict=False):
            own = [(links.intensity_g_per_kwh[i], charge[i], links.room_kwh[i]) for i in range(a, b)]
            used = max((g for g, x, _ in own if x > 1e-9), default=-inf)
            margins.append((used, min((g for g, x, room in own if x < room - 1e-9), default=inf)))
        dual = common(margins, binding(links, totals), end_g)
        later = [*dual[1:], end_g]
        for here, after, margin in zip(dual, later, told(asked).margins, strict=True):
            price = margin.floor_price
            if price.more_costs is not None and 0 < price.more_costs == pytest.approx(price.less_saves):
                compared += 1
                assert price.less_saves == pytest.approx((here - after) / asked.efficiency)
    assert compared > 100


def session(intensity: tuple[float, ...], minimum_kwh: float, use_kwh: float = 5.0) -> ProblemSession:
    n = len(intensity)
    return ProblemSession(intensity, (0.5,) * n, (10.0,) * n, minimum_kwh, 40.0, use_kwh)


def test_the_marginal_slots_of_a_session_and_the_price_of_its_minimum() -> None:
    margin = told(Problem(20.0, 10.0, 1.0, (session((300.0, 100.0, 200.0), 27.0),))).margins[0]
    assert margin.dearest_used == MarginalSlot(2, 200.0)
    assert margin.cheapest_unused == MarginalSlot(0, 300.0)
    assert margin.charged_kwh == 7.0
    assert margin.floor_price == Price(200.0, 200.0)
    assert margin.ends_at == "minimum"


def test_whole_slots_have_a_price_on_either_side() -> None:
    margin = told(Problem(20.0, 10.0, 0.8, (session((300.0, 100.0, 200.0), 28.0),))).margins[0]
    price = margin.floor_price
    assert price.less_saves == pytest.approx(250.0)
    assert price.more_costs == pytest.approx(375.0)


def test_a_minimum_met_anyway_costs_nothing_and_one_out_of_reach_cannot_be_raised() -> None:
    assert told(Problem(30.0, 10.0, 1.0, (session((100.0,), 25.0),))).margins[0].floor_price == Price()
    short = told(Problem(20.0, 10.0, 1.0, (session((100.0,), 27.0),))).margins[0]
    assert short.short_kwh == 2.0
    assert short.floor_price == Price(100.0, None)


def test_a_minimum_costs_the_difference_to_the_night_that_would_charge_instead() -> None:
    nights = (session((200.0,) * 4, 25.0), session((50.0,) * 4, 25.0))
    found = told(Problem(24.0, 10.0, 1.0, nights))
    assert found.margins[0].floor_price == Price(150.0, 150.0)
    assert found.margins[1].floor_price == Price(50.0, 50.0)
    assert found.moves == ()


def test_the_reserve_is_named_where_it_asks_for_more() -> None:
    nights = (session((200.0,) * 4, 11.0, 9.0), session((50.0,) * 4, 15.0))
    margin = told(Problem(15.0, 10.0, 1.0, nights)).margins[0]
    assert (margin.floor, margin.ends_at) == ("reserve", "reserve")
    assert margin.floor_price.less_saves == 150.0


def test_a_ceiling_has_a_price_where_a_clean_night_would_take_more() -> None:
    own = replace(session((50.0,) * 8, 25.0, 15.0), ceiling_kwh=30.0)
    margin = told(Problem(25.0, 10.0, 1.0, (own, session((200.0,) * 8, 25.0)))).margins[0]
    assert margin.ends_at == "ceiling"
    assert margin.ceiling_saves == 150.0


def test_energy_charged_early_is_told_with_both_intensities() -> None:
    nights = (session((50.0, 60.0, 70.0), 25.0), session((150.0, 190.0, 250.0), 25.0))
    assert told(Problem(25.0, 10.0, 1.0, nights)).moves == (Move(5.0, 0, 1, 50.0, 150.0),)


def test_energy_that_no_minimum_needs_is_told_with_the_end_value() -> None:
    asked = replace(Problem(25.0, 10.0, 1.0, (session((50.0, 90.0), 25.0),)), end_value=((20.0, 80.0),))
    assert told(asked).moves == (Move(5.0, 0, None, 50.0, 80.0),)


def test_every_plan_of_either_solver_can_be_explained_and_moves_add_up() -> None:
    rng = random.Random(41)
    for _ in range(150):
        asked = make.problem(rng)
        solution = Qp().solve(asked)
        found = explain(asked, solution)
        assert len(found.margins) == len(asked.sessions)
        for margin, own, power_kw in zip(found.margins, asked.sessions, solution.power_kw, strict=True):
            assert margin.charged_kwh == pytest.approx(
                sum(p * h for p, h in zip(power_kw, own.slot_h, strict=True)), abs=1e-6
            )
            if margin.cheapest_unused is not None:
                slot = margin.cheapest_unused.slot
                assert asked.efficiency * power_kw[slot] * own.slot_h[slot] <= USED_KWH + 1e-9
            if margin.dearest_used is not None:
                assert power_kw[margin.dearest_used.slot] > 0
        for move in found.moves:
            assert move.battery_kwh > 0
            assert move.needed is None or move.needed > move.charged
