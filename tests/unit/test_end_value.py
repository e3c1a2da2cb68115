"""The worth of energy left: finite, never negative, never rising, and moved by use, room and power as it should be."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugd import outlook, sessions
from plugd.domain import Household, Intensity, Overrides, Presence
from plugd.planner import end_value, exact, nights
from plugd.planner.problem import Problem, ProblemSession

NOON = datetime(2023, 3, 2, 12, tzinfo=UTC)
HOUSE = Household()
MIXED = ((50.0, 60.0, 90.0, 120.0), (150.0, 160.0, 170.0, 180.0), (100.0, 110.0, 130.0, 90.0))

some_nights = st.lists(
    st.lists(st.floats(-50.0, 1000.0), max_size=22).map(tuple), max_size=6
).map(tuple)  # fmt: skip


def worth_g(found: end_value.Steps) -> float:
    return sum(width_kwh * worth for width_kwh, worth in found)


@settings(max_examples=60)
@given(
    known=some_nights,
    slot_kwh=st.floats(0.0, 6.0),
    use_kwh=st.floats(0.0, 40.0),
    room_kwh=st.floats(-5.0, 60.0),
    efficiency=st.floats(0.5, 1.0),
)
def test_any_worth_is_finite_never_negative_never_rising_and_no_dearer_than_the_dearest_slot(
    known: tuple[tuple[float, ...], ...], slot_kwh: float, use_kwh: float, room_kwh: float, efficiency: float
) -> None:
    found = end_value.steps(known, slot_kwh, use_kwh, room_kwh, efficiency)
    Problem(20.0, 10.0, efficiency, one_session(), end_value=found)  # refuses what is not finite, negative or rising
    dearest = max((g for night in known for g in night), default=0.0)
    assert all(worth <= max(0.0, dearest) / efficiency + 1e-6 for _, worth in found)
    assert sum(width for width, _ in found) == pytest.approx(room_kwh if found else 0.0)


def one_session() -> tuple[ProblemSession, ...]:
    return (ProblemSession((100.0,), (0.5,), (10.0,), 25.0, 40.0, 5.8),)


@settings(max_examples=60)
@given(known=some_nights, low=st.floats(0.0, 20.0), more=st.floats(0.0, 10.0))
def test_who_drives_more_never_values_a_kwh_less(known: tuple[tuple[float, ...], ...], low: float, more: float) -> None:
    less_used = end_value.steps(known, 5.0, low, 15.0, 1.0)
    more_used = end_value.steps(known, 5.0, low + more, 15.0, 1.0)
    assert all(b >= a - 1e-6 for (_, a), (_, b) in zip(less_used, more_used, strict=True))


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_the_worth_grows_with_the_prices(factor: float) -> None:
    dirtier = tuple(tuple(factor * g for g in night) for night in MIXED)
    plain = end_value.steps(MIXED, 5.0, 5.8, 15.0, 0.9)
    scaled = end_value.steps(dirtier, 5.0, 5.8, 15.0, 0.9)
    assert [worth for _, worth in scaled] == pytest.approx([factor * worth for _, worth in plain])


def test_nights_that_are_all_the_same_save_one_price() -> None:
    """Whatever is left replaces what would be charged at that price, through the loss."""
    found = end_value.steps(((90.0,) * 20,), 5.0, 5.8, 15.0, 0.9)
    assert [worth for _, worth in found] == pytest.approx([100.0] * end_value.STEPS)


def test_a_car_that_is_never_driven_saves_nothing() -> None:
    assert worth_g(end_value.steps(MIXED, 5.0, 0.0, 15.0, 1.0)) == 0.0


def test_without_room_or_nights_there_is_no_value() -> None:
    assert end_value.steps(MIXED, 5.0, 5.8, 0.0, 1.0) == ()
    assert end_value.steps((), 5.0, 5.8, 15.0, 1.0) == ()
    assert end_value.steps(((),), 5.0, 5.8, 15.0, 1.0) == ()


def test_one_night_worked_out_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """15 kWh in cells of 1, one night beyond: what is in hand saves the dearest of the 6 kWh that must be bought."""
    monkeypatch.setattr(end_value, "NIGHTS_BEYOND", 1)
    end_value.steps.cache_clear()
    found = end_value.steps(((10.0, 70.0, 40.0, 20.0, 60.0, 50.0),), 1.0, 6.0, 15.0, 1.0)
    end_value.steps.cache_clear()
    assert [worth for _, worth in found] == pytest.approx(
        [(70.0 + 60.0 + 50.0) / 3, (40.0 + 20.0 + 10.0) / 3, 0.0, 0.0, 0.0]
    )


def test_the_worth_is_the_slope_of_the_least_expected_carbon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the dynamic programme itself, solved on totals by trying every purchase."""
    monkeypatch.setattr(end_value, "NIGHTS_BEYOND", 4)
    end_value.steps.cache_clear()
    found = end_value.steps(MIXED, 4.0, 6.0, 15.0, 1.0)
    end_value.steps.cache_clear()
    cost = [0.0] * 16  # least expected carbon by cells in stock at a session's end
    for _ in range(4):
        cost = [sum(_least(night, stock - 6, cost) for night in MIXED) / len(MIXED) for stock in range(16)]
    slopes = [before - after for before, after in pairwise(cost)]
    means = [sum(slopes[k : k + 3]) / 3 for k in range(0, 15, 3)]
    assert [worth for _, worth in found] == pytest.approx(means)


def _least(night: tuple[float, ...], stock: int, cost: list[float]) -> float:
    cells = [g for g in sorted(night) for _ in range(4)]
    return min(sum(cells[:y]) + cost[stock + y] for y in range(len(cells) + 1) if 0 <= stock + y <= 15)


def test_a_weak_plug_values_energy_more_for_it_cannot_catch_the_cleanest_hour() -> None:
    weak = end_value.steps(MIXED, 1.0, 3.0, 15.0, 1.0)
    strong = end_value.steps(MIXED, 5.0, 3.0, 15.0, 1.0)
    assert worth_g(weak) > worth_g(strong)


def stated(house: Household, history: tuple[Intensity, ...], n: int = 1) -> Problem:
    coming = sessions.expected(NOON, house, Overrides(), Presence(), n)
    parts = nights.layout(coming, NOON, 24.0, 2.3, house)
    found = outlook.extend(None, history, NOON, coming[-1].end)
    return nights.problem(parts, found, 24.0, None, house, history)


def history(g_per_kwh: float, days: int = 30) -> tuple[Intensity, ...]:
    first = NOON - timedelta(days=days)
    return tuple(Intensity(first + k * timedelta(minutes=30), g_per_kwh) for k in range(48 * days))


def test_the_problem_carries_the_worth_that_history_tells() -> None:
    assert {round(worth) for _, worth in stated(HOUSE, history(90.0)).end_value} == {100}
    assert {round(worth) for _, worth in stated(HOUSE, history(180.0)).end_value} == {200}


def test_switched_off_there_is_none() -> None:
    assert stated(replace(HOUSE, end_value=False), history(90.0)).end_value == ()


def test_without_history_the_planned_nights_tell() -> None:
    found = stated(HOUSE, (), n=2).end_value
    assert found
    assert found[0][1] > 50.0


def test_a_plan_over_more_nights_finds_more_left_than_it_counts_on() -> None:
    """5.5 kWh a night: what is planned at the bare minimum has the worth of what lies higher."""
    widths = [sum(width for width, _ in stated(HOUSE, history(90.0), n).end_value) for n in (1, 2, 3, 7)]
    spare_kwh = sessions.cautious_use_kwh(HOUSE.car, 0.98) - 5.8
    assert widths == pytest.approx([15.0, 15.0 - spare_kwh, 15.0 - 2 * spare_kwh, 0.0])


def test_spare_energy_takes_the_dearest_steps() -> None:
    assert end_value.beyond(((3.0, 90.0), (3.0, 60.0)), 4.0) == ((2.0, 60.0),)
    assert end_value.beyond(((3.0, 90.0), (3.0, 60.0)), 0.0) == ((3.0, 90.0), (3.0, 60.0))
    assert end_value.beyond(((3.0, 90.0),), 3.0) == ()


def test_a_trip_to_the_ceiling_leaves_nothing_to_value() -> None:
    house = replace(HOUSE, nights=replace(HOUSE.nights, minimum=0.8))
    assert stated(house, history(90.0)).end_value == ()


def test_a_night_cleaner_than_usual_is_used_beyond_the_minimum() -> None:
    dirty = history(400.0)
    for house, beyond in ((HOUSE, True), (replace(HOUSE, end_value=False), False)):
        coming = sessions.expected(NOON, house, Overrides(), Presence(), 1)
        parts = nights.layout(coming, NOON, 24.0, 2.3, house)
        tonight = outlook.extend(None, history(100.0), NOON, coming[-1].end)
        solution = exact.solve(nights.problem(parts, tonight, 24.0, None, house, dirty))
        assert (solution.energy_kwh[-1] > 30.0) is beyond


@settings(max_examples=60)
@given(known=some_nights, cells=st.integers(1, 20), more=st.integers(0, 10), use=st.integers(0, 20))
def test_more_room_never_lowers_the_worth_of_the_first_kwh(
    known: tuple[tuple[float, ...], ...], cells: int, more: int, use: int
) -> None:
    """On one grid, so that the two differ by the room alone."""
    offers = [sorted(night) for night in known if night]
    small, large = [0.0] * cells, [0.0] * (cells + more)
    for _ in range(6 if offers else 0):
        small = end_value._night_before(small, offers, use)
        large = end_value._night_before(large, offers, use)
    assert all(b >= a - 1e-6 for a, b in zip(small, large, strict=False))
