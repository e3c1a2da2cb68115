"""The hold rule: what runs, or is about to, is left only for slots that are cleaner by more than the threshold."""

from dataclasses import replace

import pytest

from plugd.controller import Controller
from plugd.domain import Household, Memory, Nights, Observation, Switching
from plugd.planner.exact import Exact
from tests.unit.deciding import CHARGER, HOME, at, forecast, knows, minutes

SHORT = replace(HOME, nights=Nights(horizon=1), end_value=False)
"""One night and no more than its minimum."""
NOW = at(23)
NEED = 0.4793
"""SOC that leaves one half hour's charge to the minimum."""


def tick(levels: dict[tuple[int, int], float], memory: Memory, household: Household, now_min: float = 0.0) -> Memory:
    """A tick with these intensities by (hour, minute), 300 g/kWh elsewhere."""
    now = NOW + minutes(now_min)
    told = forecast(now, level=lambda start: levels.get((start.hour, start.minute), 300.0))
    return Controller(household, Exact()).tick(now, Observation(forecast=told), memory).memory


def begins(memory: Memory) -> tuple[int, int]:
    """Hour and minute of the first switch-on, or of the first slot with power."""
    if isinstance(memory.orders, Switching):
        at_first = memory.orders.switches[0].at
    else:
        assert memory.plan
        at_first = next(slot.start for slot in memory.plan.slots() if slot.power_kw > 0.01)
    return at_first.hour, at_first.minute


def moved(household: Household, was: tuple[int, int], to: tuple[int, int], saving_g: float) -> bool:
    """Whether the plan leaves `was` for `to` when that turns out cleaner by so much."""
    first = tick({was: 100.0}, knows(NEED), household)
    assert begins(first) == was
    second = tick({was: 100.0, to: 100.0 - saving_g}, first, household)
    assert begins(second) in (was, to)
    return begins(second) == to


@pytest.mark.parametrize("was", [(23, 0), (23, 30)], ids=["the slot under way", "the next"])
def test_a_slot_at_hand_is_left_for_one_that_saves_more_than_the_threshold(was: tuple[int, int]) -> None:
    threshold = SHORT.relay.hold_g_per_kwh
    assert threshold > 0.0
    assert not moved(SHORT, was, (3, 0), threshold - 0.1)
    assert moved(SHORT, was, (3, 0), threshold + 0.1)


def test_a_later_slot_is_left_for_anything_cleaner() -> None:
    assert moved(SHORT, (0, 30), (3, 0), 0.1)


def test_without_a_threshold_and_for_a_charger_nothing_is_held() -> None:
    restless = replace(SHORT, relay=replace(SHORT.relay, hold_g_per_kwh=0.0))
    assert moved(restless, (23, 0), (3, 0), 0.1)
    assert moved(replace(SHORT, capability=replace(CHARGER.capability, power_max_kw=2.3)), (23, 0), (3, 0), 0.1)


def test_a_slot_at_hand_that_was_hardly_used_is_not_held() -> None:
    """A tenth of a slot is what the minimum left over, not something that runs."""
    first = tick({(23, 30): 101.0, (3, 0): 100.0}, knows(NEED - 0.004), SHORT)
    assert first.plan
    assert {slot.start.hour for slot in first.plan.slots() if slot.power_kw > 0.01} == {23, 3}
    second = tick({(23, 30): 101.0, (3, 0): 100.0, (3, 30): 100.5}, first, SHORT)
    assert second.plan
    assert {slot.start.hour for slot in second.plan.slots() if slot.power_kw > 0.01} == {3}


def test_ties_go_to_the_earlier_slot() -> None:
    assert begins(tick({(2, 0): 100.0, (3, 0): 100.0}, knows(NEED), SHORT)) == (2, 0)


def test_what_is_told_of_a_held_plan_is_its_real_intensity() -> None:
    first = tick({(23, 0): 100.0}, knows(NEED), SHORT)
    second = tick({(23, 0): 100.0}, first, SHORT)
    assert first.plan
    assert second.plan
    assert second.plan.carbon_g == pytest.approx(first.plan.carbon_g)
    assert {slot.intensity_g_per_kwh for slot in second.plan.slots()} == {100.0, 300.0}
