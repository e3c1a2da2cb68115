"""The repair of the bounds: always feasible, never more than needed."""

import random
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd.planner.bounds import DUST_KWH, chain, end_value_g, powers_kw, repair, tube
from plugd.planner.problem import Problem, ProblemSession
from tests.unit import planner_problems as make

KWH = st.floats(-30, 60)
ROWS = st.lists(st.tuples(KWH, KWH, st.floats(0, 30)), min_size=1, max_size=7)


def reachable(lower: list[float], upper: list[float], room: list[float]) -> bool:
    """Whether some cumulative charge keeps all bounds: by stepping through the interval of what can be in."""
    low = high = 0.0
    for least, most, more in zip(lower, upper, room, strict=True):
        low, high = max(low, least), min(high + more, most)
        if low > high + 1e-9:
            return False
    return True


def columns(rows: list[tuple[float, float, float]]) -> tuple[list[float], list[float], list[float]]:
    return [r[0] for r in rows], [r[1] for r in rows], [r[2] for r in rows]


@given(ROWS)
def test_repaired_bounds_can_be_kept(rows: list[tuple[float, float, float]]) -> None:
    lower, upper, room = columns(rows)
    kept_lower, kept_upper = repair(lower, upper, room)
    assert reachable(kept_lower, kept_upper, room)


@given(ROWS)
def test_bounds_that_can_be_kept_are_left_alone(rows: list[tuple[float, float, float]]) -> None:
    lower, upper, room = columns(rows)
    kept_lower, kept_upper = repair(lower, upper, room)
    if reachable(lower, upper, room):
        assert kept_lower == pytest.approx(lower, abs=1e-9)
        assert kept_upper == pytest.approx(upper, abs=1e-9)


@given(ROWS)
def test_repair_only_lowers_minima_and_lifts_ceilings_and_twice_changes_nothing(
    rows: list[tuple[float, float, float]],
) -> None:
    lower, upper, room = columns(rows)
    kept_lower, kept_upper = repair(lower, upper, room)
    assert all(kept <= asked for kept, asked in zip(kept_lower, lower, strict=True))
    assert all(kept >= max(asked, 0) for kept, asked in zip(kept_upper, upper, strict=True))
    assert repair(kept_lower, kept_upper, room) == (kept_lower, kept_upper)


@given(ROWS)
def test_a_minimum_is_lowered_to_the_most_that_can_be_in(rows: list[tuple[float, float, float]]) -> None:
    lower, upper, room = columns(rows)
    kept_lower, kept_upper = repair(lower, upper, room)
    most = 0.0
    for asked, kept, high, more in zip(lower, kept_lower, kept_upper, room, strict=True):
        most = min(most + more, high)
        assert kept == min(asked, most)


@given(ROWS)
def test_a_lower_minimum_asked_never_raises_a_repaired_one(rows: list[tuple[float, float, float]]) -> None:
    lower, upper, room = columns(rows)
    kept, _ = repair(lower, upper, room)
    for s in range(len(lower)):
        easier, _ = repair([*lower[:s], lower[s] - 5, *lower[s + 1 :]], upper, room)
        assert all(a <= b + 1e-9 for a, b in zip(easier, kept, strict=True))


@given(ROWS)
def test_inside_the_tube_every_next_point_can_be_reached(rows: list[tuple[float, float, float]]) -> None:
    lower, upper, room = columns(rows)
    kept_lower, kept_upper = repair(lower, upper, room)
    least, most = tube(kept_lower, kept_upper, room)
    assert len(least) == len(most) == len(rows)
    before_least = before_most = 0.0
    for s, (low, high) in enumerate(zip(least, most, strict=True)):
        assert kept_lower[s] - 1e-9 <= low <= high + 1e-9
        assert high <= kept_upper[s] + 1e-9
        assert low <= before_least + room[s] + 1e-9  # the lowest path need not jump
        assert high <= before_most + room[s] + 1e-9
        assert before_least <= low + 1e-9  # and nothing ever has to be given back
        assert before_most <= high + 1e-9
        before_least, before_most = low, high


def test_a_ceiling_that_falls_below_an_earlier_minimum_is_lifted_to_it() -> None:
    assert repair([8.0, 0.0], [10.0, 5.0], [20.0, 20.0]) == ([8.0, 0.0], [10.0, 8.0])


def test_the_chain_holds_morning_minimum_reserve_and_ceiling_as_cumulative_charge() -> None:
    own = ProblemSession((1.0, 2.0), (0.5, 0.25), (10.0, 4.0), 25.0, 40.0, 20.0)
    links = chain(Problem(22.0, 10.0, 0.5, (own, replace(own, minimum_kwh=5.0))))
    assert links.lower_kwh == [
        3.0,
        3.0,
    ]  # 30 on leaving keeps the reserve of 10: 8, cut to what fits; 5 + 20 - 22
    assert links.upper_kwh == [18.0, 38.0]
    assert links.room_kwh == [2.5, 0.5, 2.5, 0.5]
    assert links.session_room_kwh == [3.0, 3.0]
    assert links.starts == [0, 2, 4]
    assert not links.lifted


def test_a_hair_above_the_ceiling_is_no_lifted_bound() -> None:
    own = ProblemSession((1.0,), (0.5,), (10.0,), 25.0, 40.0, 0.0)
    assert not chain(Problem(40.0 + 1e-12, 10.0, 1.0, (own,))).lifted
    assert chain(Problem(40.1, 10.0, 1.0, (own,))).lifted


def test_more_energy_is_never_worth_more_per_kwh() -> None:
    rng = random.Random(7)
    for _ in range(200):
        asked = make.problem(rng)
        worths = [end_value_g(asked, 0.5 * k) for k in range(100)]
        rises = [after - before for before, after in pairwise(worths)]
        assert all(later <= earlier + 1e-9 for earlier, later in pairwise(rises))
        assert min(rises) >= 0


def test_nothing_above_the_start_is_worth_nothing() -> None:
    rng = random.Random(8)
    asked = replace(make.everyday(rng), end_value=((5.0, 100.0),))
    assert [end_value_g(asked, above) for above in (-3.0, 0.0, 2.0, 9.0)] == [0.0, 0.0, 200.0, 500.0]


def test_a_step_without_width_ends_nothing() -> None:
    asked = replace(make.everyday(random.Random(8)), end_value=((0.0, 100.0), (5.0, 90.0)))
    assert end_value_g(asked, 2.0) == 180.0


def test_dust_is_no_power_and_a_slot_without_time_has_none() -> None:
    own = ProblemSession((1.0,) * 4, (0.5, 0.5, 0.0, 0.5), (10.0,) * 4, 25.0, 40.0, 0.0)
    asked = Problem(22.0, 10.0, 1.0, (own,))
    assert powers_kw(asked, [DUST_KWH / 2, DUST_KWH, 1.0, 2 * DUST_KWH]) == ((0.0, 0.0, 0.0, 4 * DUST_KWH),)
