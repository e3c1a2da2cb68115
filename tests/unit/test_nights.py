"""From sessions to the solver's problem and back: the deadline before the guard's, and one plan with times."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import pytest

from plugd import outlook, sessions
from plugd.domain import Household, Overrides, Plan, Presence
from plugd.planner import exact, nights, taper
from plugd.units import hours

NOON = datetime(2023, 1, 2, 12, tzinfo=UTC)
HOUSE = Household()
POWER_KW = HOUSE.capability.power_max_kw


def planned(now: datetime = NOON, soc: float = 0.4, n: int = 4, house: Household = HOUSE) -> tuple[Plan, list[float]]:
    """The plan at `now`, and the limits of its problem's columns."""
    coming = sessions.expected(now, house, Overrides(), Presence(), n)
    energy_kwh = soc * house.car.capacity_kwh
    parts = nights.layout(coming, now, energy_kwh, POWER_KW, house)
    found = outlook.extend(None, (), now, coming[-1].end)
    stated = nights.problem(parts, found, energy_kwh, None, house)
    plan = nights.plan(now, parts, stated, exact.solve(stated), house)
    return plan, [kw for session in stated.sessions for kw in session.power_max_kw]


def test_sessions_come_back_whole_and_in_order() -> None:
    plan, _ = planned()
    coming = sessions.expected(NOON, HOUSE, Overrides(), Presence(), 4)
    assert [s.session for s in plan.sessions] == list(coming)
    for part in plan.sessions:
        assert part.slots[0].start == part.session.start
        assert part.slots[-1].end == part.session.end
        assert all(a.end == b.start for a, b in pairwise(part.slots))


def test_the_minimum_is_reached_an_hour_before_the_session_end_at_nine_tenths_of_the_power() -> None:
    plan, _ = planned(soc=0.3)
    tonight = plan.sessions[0]
    deadline = tonight.session.end - timedelta(seconds=HOUSE.guard_margin_s + HOUSE.planner_slack_s)
    before = [s for s in tonight.slots if s.end <= deadline]
    charged_kwh = sum(s.power_kw * hours(s.end - s.start) for s in before) * HOUSE.car.efficiency
    assert 0.3 * 50 + charged_kwh >= 0.5 * 50 - 1e-6
    need_h = 0.2 * 50 / (0.9 * POWER_KW * HOUSE.car.efficiency)
    for slot in before:
        in_stretch = slot.end > deadline - timedelta(hours=need_h)
        assert slot.limit_kw == pytest.approx(POWER_KW * (0.9 if in_stretch else 1.0))


def test_the_stretch_that_the_guard_could_claim_is_longer_where_the_car_takes_less_as_it_fills() -> None:
    house = replace(HOUSE, car=replace(HOUSE.car, taper_from=0.4, taper_share=0.2))
    plan, _ = planned(soc=0.3, house=house)
    tonight = plan.sessions[0]
    deadline = tonight.session.end - timedelta(seconds=house.guard_margin_s + house.planner_slack_s)
    need_h = taper.flat_kwh(house.car, 15.0, 25.0) / (0.9 * POWER_KW * house.car.efficiency)
    assert need_h > 1.03 * 10.0 / (0.9 * POWER_KW * house.car.efficiency)
    for slot in tonight.slots:
        if slot.end <= deadline:
            in_stretch = slot.end > deadline - timedelta(hours=need_h)
            assert slot.limit_kw == pytest.approx(POWER_KW * (0.9 if in_stretch else 1.0))


def test_nothing_needed_is_nothing_derated() -> None:
    plan, _ = planned(soc=0.6)
    assert {slot.limit_kw for slot in plan.slots()} == {POWER_KW}


def test_the_study_without_a_guard_plans_to_the_session_end() -> None:
    house = Household(guard_margin_s=0.0, planner_slack_s=0.0)
    plan, limits = planned(soc=0.3, house=house)
    assert set(limits) == {POWER_KW}
    assert plan.sessions[0].soc_end >= 0.5 - 1e-9


@pytest.mark.parametrize("margin_s", [0.0, 2400.0])
def test_the_day_after_every_session_is_driven_whatever_the_margin(margin_s: float) -> None:
    house = Household(guard_margin_s=margin_s, planner_slack_s=0.0)
    coming = sessions.expected(NOON, house, Overrides(), Presence(), 3)
    parts = nights.layout(coming, NOON, 20.0, POWER_KW, house)
    assert sum(part.daily_use_kwh for part in parts) == sum(session.daily_use_kwh for session in coming)


def test_elapsed_slots_stay_in_the_problem_without_power_and_out_of_the_plan() -> None:
    midnight = datetime(2023, 1, 3, 0, 10, tzinfo=UTC)
    plan, limits = planned(midnight)
    assert limits[:9] == [0.0] * 8 + [POWER_KW]
    assert plan.sessions[0].slots[0].start == midnight
    assert len(planned(midnight + timedelta(hours=2))[1]) == len(limits)


def test_a_minimum_missed_by_less_than_can_be_measured_is_met() -> None:
    plan, limits = planned(soc=0.5 - 0.9 * nights.MET_KWH / 50)
    assert set(limits) == {POWER_KW}
    assert plan.sessions[0].shortfall_kwh == 0.0


def test_past_the_deadline_the_plan_goes_on_to_the_minimum() -> None:
    late = datetime(2023, 1, 3, 6, 15, tzinfo=UTC)
    plan, _ = planned(late, soc=0.4)
    tonight = plan.sessions[0]
    assert all(slot.power_kw == pytest.approx(slot.limit_kw) for slot in tonight.slots)
    assert tonight.shortfall_kwh == pytest.approx(0.1 * 50 - 0.7 * 0.9 * POWER_KW * 0.9, abs=1e-6)
