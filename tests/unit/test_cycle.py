"""The cycle: what it does when, and that no port's failure stops it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from itertools import pairwise

import pytest

from plugd.actuator import RETRY_S
from plugd.cycle import FETCH_RETRY_S
from plugd.domain import (
    Answer,
    Command,
    Intensity,
    Memory,
    Mode,
    Overrides,
    Presence,
    Relay,
    SessionPlan,
    SetConnected,
    SetMode,
    Setpoint,
    SetSoc,
    SetTrip,
    SlotSource,
    Status,
    Trip,
)
from plugd.errors import (
    ForecastLate,
    ForecastMalformed,
    ForecastUnavailable,
    PlugFault,
    PlugRefused,
    PlugTimeout,
    SolveError,
    StoreError,
)
from plugd.past import LATE
from plugd.perception import fresh
from plugd.planner.problem import Problem, Solution
from plugd.retry import Retry
from plugd.study.house import SimHub
from plugd.units import next_slot, slot_start
from tests.unit.deciding import CHARGER, EVENING, EXPECTED, NIGHT, READY_BY, Room, at, forecast, knows, minutes

ON, OFF, HELD = Relay(True), Relay(False), Relay(False, held=True)
PLENTY, SOME, LITTLE = 0.75, 0.6, 0.3


def room(soc: float = SOME, start: datetime = EVENING) -> Room:
    return Room(start, knows(soc, start))


def waiting(start: datetime = NIGHT) -> Room:
    """In the evening, with a plan for the clean hours after 2, the relay off."""
    found = room(start=start)
    found.step()
    assert found.plug.told == [OFF]
    return found


def sessions_of(house: Room) -> tuple[SessionPlan, ...]:
    plan = house.cycle.memory.plan
    return plan.sessions if plan else ()


def seconds(moments: list[datetime]) -> list[float]:
    return [(later - earlier).total_seconds() for earlier, later in pairwise(moments)]


# -- when it ticks --------------------------------------------------------------------------------


def test_it_plans_at_every_half_hour_and_not_in_between() -> None:
    house = room(PLENTY)
    for minute in (0, 3, 17, 29, 30, 31, 59, 60, 61):
        house.step(EVENING + minutes(minute))
    assert house.solver.calls == 3
    assert [record.at for record in house.disk.ram.records] == [EVENING, EVENING + minutes(30), EVENING + minutes(60)]


@pytest.mark.parametrize("command", [SetMode(Mode.NOW), SetSoc(0.3), SetConnected(True)])
def test_it_plans_at_once_on_a_command(command: Command) -> None:
    house = waiting()
    house.hub.said.append(command)
    house.step(NIGHT + minutes(7))
    assert house.solver.calls == 2
    assert [answer.ok for answer in house.hub.answers] == [True]
    house.step(NIGHT + minutes(8))
    assert house.solver.calls == 2


def test_a_car_that_says_the_same_every_second_makes_no_plan_of_every_word() -> None:
    house = room()
    house.step()
    solved, saved = house.solver.calls, house.disk.saves
    for second in range(1, 600):
        house.hub.said.append(SetSoc(0.601, source="car"))
        house.step(EVENING + timedelta(seconds=second))
    assert (house.solver.calls - solved, house.disk.saves - saved) == (2, 2)
    assert (house.cycle.memory.soc.mean, house.cycle.memory.soc.source) == (0.601, "car")


def test_a_car_that_falls_silent_is_no_longer_the_one_who_says_it() -> None:
    house = room()
    house.hub.said.append(SetSoc(0.6, source="car"))
    house.step()
    house.run(EVENING + minutes(29))
    assert house.cycle.memory.soc.source == "car"
    house.run(EVENING + minutes(61))
    assert house.cycle.memory.soc.source == "meter"


def test_a_trip_is_planned_for_at_once() -> None:
    house = waiting()
    before = {s.session.end: s.session.minimum for s in sessions_of(house)}
    trip = Trip(READY_BY.date() + timedelta(days=1), minimum=0.75)
    house.hub.said.append(SetTrip(trip))
    house.step(NIGHT + minutes(1))
    after = {s.session.end: s.session.minimum for s in sessions_of(house)}
    assert after == {end: 0.75 if end.date() == trip.day else minimum for end, minimum in before.items()}
    assert 0.75 in after.values()


def test_it_plans_at_once_on_a_press() -> None:
    house = waiting()
    house.plug.press()
    house.step(NIGHT + minutes(7))
    house.step(NIGHT + minutes(8))
    assert house.solver.calls == 2
    assert house.hub.decision
    assert house.hub.decision.status is Status.BOOSTING


def test_a_night_step_by_step_ends_and_charges_what_was_planned() -> None:
    house = room()
    steps = house.run(READY_BY)
    assert len(steps) < 60
    assert {slot_start(s) for s in steps} == {EVENING + k * minutes(30) for k in range(26)}
    assert house.cycle.memory.soc.mean == pytest.approx(0.6 + 3 * 2.3 * 0.9 / 50, abs=0.001)
    assert house.cycle.memory.guard_count == 0
    assert house.plug.told == [OFF, ON, OFF]


@pytest.mark.parametrize("second", [0, 1, 599, 1799])
def test_the_next_step_is_always_ahead(second: int) -> None:
    house = waiting()
    now = NIGHT + timedelta(seconds=second)
    house.plug.due_at = now
    assert now < house.step(now) <= next_slot(now)


def test_the_next_step_is_when_the_plug_or_the_plan_asks_for_one() -> None:
    house = waiting()
    assert house.step() == at(23, 30)
    house.plug.due_at = at(23, 10)
    assert house.step() == at(23, 10)
    house.plug.due_at = None
    assert house.step(at(1, 45, day=3)) == at(2, day=3)


def test_the_plugs_timer_is_looked_after_in_every_step() -> None:
    house = waiting()
    house.step(NIGHT + minutes(1))
    assert house.plug.tended == [NIGHT, NIGHT + minutes(1)]


# -- the forecast ---------------------------------------------------------------------------------


def test_a_forecast_is_fetched_once_a_half_hour_and_kept() -> None:
    house = room()
    for minute in (0, 5, 30):
        house.hub.said.append(SetSoc(SOME))
        house.step(EVENING + minutes(minute))
    assert house.source.asked == [EVENING, EVENING + minutes(30)]
    assert EVENING in house.disk.ram.seen


def test_a_command_does_not_wait_for_the_network() -> None:
    house = room(PLENTY)
    house.source.error = ForecastUnavailable("HTTP 500")
    house.step(NIGHT)
    house.hub.said.append(SetMode(Mode.NOW))
    house.step(NIGHT + minutes(0.5))
    assert house.source.asked == [NIGHT]
    assert house.plug.on


@pytest.mark.parametrize("error", [ForecastUnavailable("HTTP 500"), ForecastMalformed("no rows")])
def test_a_source_that_fails_is_tried_again_later_and_later(error: ForecastUnavailable | ForecastMalformed) -> None:
    house = room(PLENTY)
    house.source.error = error
    house.run(EVENING + minutes(150))
    pauses = seconds(house.source.asked)
    # A half hour in between does not hurry it.
    assert pauses[:6] == list(FETCH_RETRY_S) == [60.0, 120.0, 240.0, 480.0, 960.0, 1800.0]
    assert set(pauses[6:]) == {1800.0}
    assert house.faults()["forecast"] == f"{error}; planning with the usual day until it comes back"


def test_the_pauses_are_spread_among_households() -> None:
    retry = Retry(FETCH_RETRY_S)
    retry.failed(EVENING, spread=1.0)
    assert retry.at == EVENING + timedelta(seconds=90)


def test_a_source_that_comes_back_clears_the_fault() -> None:
    house = room(PLENTY)
    house.source.error = ForecastUnavailable("HTTP 500")
    house.run(EVENING + minutes(5))
    house.source.error = None
    house.run(EVENING + minutes(16))
    assert house.faults() == {}
    assert house.source.asked[-1] == EVENING + minutes(7)
    house.run(EVENING + minutes(31))
    assert seconds(house.source.asked)[-1] == minutes(23).total_seconds()


def test_the_last_forecast_is_used_for_the_hours_it_covers() -> None:
    house = room(PLENTY)
    house.source.slots = 10
    house.step()
    house.source.error = ForecastUnavailable("HTTP 500")
    house.step(EVENING + minutes(90))
    assert "planning with the forecast of 1.5 h ago" in house.faults()["forecast"]
    assert house.hub.decision
    outlook = house.hub.decision.outlook
    assert outlook
    assert outlook.forecast_until == EVENING + minutes(300)
    assert [slot.source for slot in outlook.slots[:9]] == [SlotSource.NESO] * 7 + [SlotSource.TAIL] * 2


def test_without_any_forecast_it_still_plans() -> None:
    house = room(LITTLE)
    house.source.error = ForecastUnavailable("no route")
    house.run(READY_BY)
    assert house.cycle.memory.soc.mean >= 0.5
    assert house.cycle.memory.guard_count == 0
    assert house.hub.decision
    assert house.hub.decision.outlook
    assert house.hub.decision.outlook.forecast_until is None


def test_a_clock_set_back_does_not_put_retries_off() -> None:
    house = room(PLENTY, at(18, day=20))
    house.source.error = ForecastUnavailable("certificate not valid yet")
    house.plug.refuses = PlugRefused("no")
    house.step()
    tries = len(house.plug.tries)
    house.step(at(18))
    assert house.source.asked[-1] == at(18)
    assert len(house.plug.tries) == tries + 1


# -- the plug -------------------------------------------------------------------------------------


def charging() -> Room:
    house = room(LITTLE, at(2, day=3))
    house.step()
    assert house.plug.told == [ON]
    return house


@pytest.mark.parametrize("error", [PlugTimeout("silent"), PlugRefused("stays OFF"), PlugFault("no timer")])
def test_a_plug_that_does_not_switch_is_told_again_and_again(error: PlugTimeout | PlugRefused | PlugFault) -> None:
    house = room(LITTLE, at(2, day=3))
    house.plug.refuses = error
    house.run(at(2, 10, day=3))
    pauses = seconds(house.plug.tries)
    assert pauses[:3] == list(RETRY_S) == [5.0, 15.0, 60.0]
    assert set(pauses[3:]) == {60.0}
    assert house.faults() == {"plug_refuses": str(error)}
    assert house.hub.decision
    assert house.hub.decision.status is Status.FAULT
    house.plug.refuses = None
    house.run(at(2, 12, day=3))
    assert house.plug.told == [ON]
    assert house.faults() == {}


def test_a_plug_is_left_alone_until_its_next_try_is_due() -> None:
    house = room(LITTLE, at(2, day=3))
    house.plug.refuses = PlugRefused("stays OFF")
    for second in range(20):
        house.step(at(2, day=3) + timedelta(seconds=second))
    assert [moment.second for moment in house.plug.tries] == [0, 5]


def test_a_silent_plug_is_still_told_to_charge() -> None:
    house = room(LITTLE, at(2, day=3))
    house.plug.silent = house.plug.refuses = PlugTimeout("silent since 01:50")
    house.run(at(2, 5, day=3))
    assert house.faults() == {"plug_silent": "silent since 01:50"}, "who hears nothing refuses nothing"
    assert len(house.plug.tries) == 7
    house.plug.refuses = None
    house.run(at(2, 7, day=3))
    assert house.plug.told[0] == ON
    assert list(house.faults()) == ["plug_silent"]
    house.plug.silent = None
    house.run(at(2, 8, day=3))
    assert house.faults() == {}


def test_a_refusal_is_over_where_the_plug_falls_silent_and_stands_again_where_it_still_refuses() -> None:
    house = room(LITTLE, at(2, day=3))
    house.plug.refuses = PlugTimeout("no answer")
    house.run(at(2, 2, day=3))
    assert house.faults() == {"plug_refuses": "no answer"}
    house.plug.silent = PlugTimeout("silent")
    house.run(at(2, 4, day=3))
    assert house.faults() == {"plug_silent": "silent"}
    house.plug.silent = None
    house.run(at(2, 6, day=3))
    assert house.faults() == {"plug_refuses": "no answer"}


def test_what_a_silent_plug_still_refuses_is_said() -> None:
    house = room(LITTLE, at(2, day=3))
    house.plug.silent, house.plug.refuses = PlugTimeout("silent"), PlugRefused("locked")
    house.step(at(2, day=3))
    assert house.faults() == {"plug_silent": "silent", "plug_refuses": "locked"}


def test_people_read_their_own_time_in_a_fault() -> None:
    house = room(LITTLE, at(2, day=3))
    house.plug.silent = PlugTimeout("silent since 2023-07-02T23:50:07Z (broker connected)")
    house.step(at(2, day=3))
    assert house.faults() == {"plug_silent": "silent since Mon 3 Jul 2023, 00:50 (broker connected)"}


def test_a_plug_that_cannot_be_tended_is_a_fault_and_no_more() -> None:
    house = waiting()
    house.plug.tend_fails = PlugTimeout("no broker")
    house.step(NIGHT + minutes(1))
    assert house.faults() == {"plug_silent": "no broker"}
    house.plug.tend_fails = None
    house.step(NIGHT + minutes(2))
    assert house.faults() == {}


def test_a_new_wish_does_not_wait_for_a_retry() -> None:
    house = waiting()
    house.hub.said.append(SetMode(Mode.NOW))
    house.plug.refuses = PlugRefused("stays OFF")
    house.step(NIGHT + minutes(1))
    house.hub.said.append(SetMode(Mode.OFF))
    house.plug.refuses = None
    house.step(NIGHT + timedelta(seconds=61))
    assert house.plug.told == [OFF, HELD]


def test_an_off_that_was_never_confirmed_is_not_taken_for_done() -> None:
    """The relay is off by a person's hand, the timer still runs: the plug has to take the held off."""
    house = charging()
    house.plug.press()
    house.plug.refuses = PlugTimeout("no answer")
    house.run(at(2, 1, day=3))
    assert len(house.plug.tries) == 4
    assert "plug_refuses" in house.faults()
    house.plug.refuses = None
    house.run(at(2, 2, day=3))
    assert house.plug.told == [ON, HELD]


def test_a_relay_that_is_moved_is_told_again() -> None:
    house = waiting()
    house.plug.on = True
    house.step(NIGHT + minutes(1))
    house.step(NIGHT + minutes(2))
    assert house.plug.told == [OFF, OFF]


def test_a_plug_that_was_away_is_told_off_again() -> None:
    house = waiting()
    house.hub.said.append(SetMode(Mode.OFF))
    house.step(NIGHT + minutes(1))
    house.plug.came_back = True
    house.step(NIGHT + minutes(2))
    house.step(NIGHT + minutes(3))
    assert house.plug.told == [OFF, HELD, HELD]


def test_what_is_as_wanted_is_not_told_again() -> None:
    house = charging()
    for minute in range(1, 30):
        house.step(at(2, minute, day=3))
    assert house.plug.told == [ON]


def test_a_setpoint_is_renewed_before_it_ends() -> None:
    house = Room(NIGHT, replace(knows(LITTLE), overrides=Overrides(mode=Mode.NOW)), CHARGER)
    house.run(NIGHT + minutes(10))
    ends = [wanted.until for wanted in house.plug.told if isinstance(wanted, Setpoint)]
    assert len(ends) == len(house.plug.told) == 10
    assert all(later - house.plug.tries[k + 1] == minutes(2) for k, later in enumerate(ends[1:]))
    assert house.disk.saves < 4, "a renewal moves no relay"


def test_a_charger_is_told_anew_when_the_slot_of_its_setpoint_ends() -> None:
    """The session begins inside a half hour, at 20:03, and the night's cleanest hour with it."""
    house = Room(EVENING, knows(LITTLE), CHARGER)
    house.plug.power_kw = 7.4
    house.source.level = lambda start: 50.0 if start.hour == 20 else 200.0
    house.run(at(20, 40))
    told = [(when, wanted) for when, wanted in zip(house.plug.tries, house.plug.told, strict=True) if when >= EXPECTED]
    assert [when for when, _ in told] == [EXPECTED, at(20, 30)]
    assert [wanted for _, wanted in told] == [Setpoint(7.4, at(20, 30)), Setpoint(7.4, at(21))]


def test_a_setpoint_run_out_while_another_holds_is_made_anew_once() -> None:
    house = Room(at(20), replace(knows(LITTLE), overrides=Overrides(mode=Mode.NOW)), CHARGER)
    house.run(at(20, 10))
    assert house.solver.calls == 2


# -- relay bookkeeping ----------------------------------------------------------------------------


def test_switch_ons_of_the_plan_are_counted_with_their_time() -> None:
    house = waiting()
    house.run(at(2, 10, day=3))
    memory = house.cycle.memory
    assert (memory.relay_on, memory.relay_since, memory.switch_ons) == (True, at(2, day=3), (at(2, day=3),))


def test_a_switch_on_that_was_obeyed_without_an_answer_is_counted_when_it_is_seen() -> None:
    house = waiting()
    house.plug.refuses = PlugTimeout("no answer")
    house.step(at(2, day=3))
    assert house.cycle.memory.switch_ons == ()
    house.plug.on = True
    seen = at(2, day=3, second=3)
    for second in (3, 5, 20):
        house.step(at(2, day=3, second=second))
    memory = house.cycle.memory
    assert (memory.relay_on, memory.relay_since, memory.switch_ons) == (True, seen, (seen,))
    saved = house.disk.load()
    assert saved
    assert saved.switch_ons == memory.switch_ons
    assert house.faults() == {}


def test_an_off_that_failed_and_is_no_longer_wanted_is_no_switch_on() -> None:
    house = room(SOME, at(2, day=3))
    house.step()
    house.plug.refuses = PlugTimeout("no answer")
    house.hub.said.append(SetMode(Mode.OFF))
    house.step(at(2, 1, day=3))
    house.hub.said.append(SetMode(Mode.SMART))
    house.step(at(2, 2, day=3))
    assert house.plug.on
    assert house.cycle.memory.switch_ons == (at(2, day=3),)


def test_a_relay_that_was_on_all_along_is_not_counted_again() -> None:
    house = room(SOME, at(2, day=3))
    house.step()
    house.plug.silent = house.plug.refuses = PlugTimeout("no answer")
    house.plug.came_back = True
    house.cycle.actuator.told = None
    house.step(at(2, 1, day=3))
    house.plug.silent = None
    house.step(at(2, 1, day=3, second=3))
    assert house.faults() == {}
    assert house.cycle.memory.switch_ons == (at(2, day=3),)


@pytest.mark.parametrize("by", ["person", "button", "guard"])
def test_switch_ons_by_others_are_not_counted(by: str) -> None:
    house = room(PLENTY, NIGHT)
    house.step()
    now = NIGHT + minutes(1)
    if by == "person":
        house.hub.said.append(SetMode(Mode.NOW))
    elif by == "button":
        house.plug.press()
    else:
        house.cycle.memory = replace(house.cycle.memory, soc=knows(0.21).soc)
    house.step(now)
    assert house.plug.on
    memory = house.cycle.memory
    assert (memory.relay_on, memory.relay_since, memory.switch_ons) == (True, now, ())


# -- what is seen between ticks -------------------------------------------------------------------


def test_energy_metered_between_ticks_reaches_the_guard() -> None:
    """The guard lets go as soon as the meter says that the minimum is reached, not at the next half hour."""
    house = Room(at(6, 31, day=3), replace(knows(0.498), guarding=True, relay_on=True))
    house.plug.on = True
    house.source.error = ForecastUnavailable("none, so that no hour is cheap")
    moments = house.run(at(6, 50, day=3))
    assert not house.cycle.memory.guarding
    assert house.cycle.memory.soc.mean == pytest.approx(0.498, abs=0.003)
    assert moments[-1] > at(6, 31, day=3)
    assert house.plug.told == [OFF]
    assert house.plug.tries[0] < at(6, 40, day=3)


def test_a_reading_is_counted_once_in_the_step_that_plans() -> None:
    house = charging()
    house.step(at(2, 29, day=3))
    house.plug.power_kw = 1.3
    house.step(at(2, 30, day=3))
    assert house.cycle.memory.observed_kw == pytest.approx(2.3 + 0.2 * (1.3 - 2.3))


def test_a_press_is_counted_once() -> None:
    house = charging()
    house.plug.press()
    house.step(at(2, 10, day=3))
    assert house.plug.told == [ON, HELD]
    house.hub.said.append(SetMode(Mode.SMART))
    house.step(at(2, 10, day=3) + timedelta(seconds=1))
    assert house.cycle.memory.press is None
    assert house.hub.decision
    assert house.hub.decision.status is not Status.OFF


def test_a_press_off_is_over_when_the_car_is_expected_again() -> None:
    house = charging()
    house.plug.press()
    house.run(at(20, 3, day=3))
    assert not house.plug.on
    house.cycle.memory = replace(house.cycle.memory, soc=knows(0.3, at(20, day=3)).soc)
    assert house.step() > at(20, 3, day=3)
    assert house.hub.decision
    assert house.hub.decision.status is not Status.OFF


# -- the store ------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", ["save", "append", "history", "keep"])
def test_a_store_that_fails_is_a_fault_and_decisions_go_on_from_memory(part: str) -> None:
    house = room()
    house.disk.broken.add(part)
    house.run(at(2, 10, day=3))
    assert house.faults() == {"store": f"{part}: the card is full"}
    assert house.plug.told == [OFF, ON]
    house.disk.broken.clear()
    house.run(at(2, 31, day=3))
    assert house.faults() == {}


def test_two_store_failures_are_one_fault_until_both_are_mended() -> None:
    house = room()
    house.disk.broken = {"append", "keep"}
    house.step()
    assert set(house.faults()) == {"store"}
    house.disk.broken = {"append"}
    house.step(EVENING + minutes(30))
    assert house.faults() == {"store": "append: the card is full"}


def test_a_command_is_saved_before_it_is_answered() -> None:
    """Who was told that it is off must not find it on after a restart."""
    house = waiting()
    kept: list[Memory | None] = []

    class Answering(SimHub):
        def answer(self, answers: Sequence[Answer]) -> None:
            kept.extend(house.disk.load() for _ in answers)

    house.cycle.hub = Answering(said=[SetMode(Mode.OFF)])
    house.step()
    (memory,) = kept
    assert memory is not None
    assert memory.overrides.mode is Mode.OFF


def test_what_a_person_said_is_saved_at_once_and_so_is_a_moved_relay() -> None:
    house = waiting()
    house.hub.said.append(SetMode(Mode.OFF))
    house.step(NIGHT + minutes(1))
    assert house.disk.ram.memory
    assert house.disk.ram.memory.overrides.mode is Mode.OFF
    house.hub.said.append(SetMode(Mode.NOW))
    house.step(NIGHT + minutes(2))
    assert house.disk.ram.memory.relay_since == NIGHT + minutes(2)


def test_that_the_guard_holds_is_saved_though_the_relay_is_on_already() -> None:
    house = Room(at(4, 50, day=3), replace(knows(0.45), overrides=Overrides(mode=Mode.NOW)))
    house.plug.power_kw = 0.0
    house.step()
    assert not saved(house).guarding
    house.step(at(4, 57, day=3))
    assert saved(house).guarding
    assert house.plug.told == [ON]


def test_beats_in_which_nothing_happens_write_nothing() -> None:
    house = waiting()
    saves = house.disk.saves
    for second in range(10, 1800, 10):
        house.step(NIGHT + timedelta(seconds=second))
    assert house.disk.saves == saves


# -- a restart ------------------------------------------------------------------------------------


def saved(house: Room) -> Memory:
    assert house.disk.ram.memory
    return house.disk.ram.memory


def test_a_restart_within_the_half_hour_uses_the_stored_plan() -> None:
    house = charging()
    before, calls = saved(house), house.solver.calls
    house.begin(before, forecast(at(2, day=3)))
    told = house.hub.decision
    house.step(at(2, 12, day=3))
    assert house.cycle.memory.plan == before.plan
    assert (house.solver.calls, len(house.source.asked)) == (calls, 1)
    assert house.plug.told == [ON]
    assert house.hub.decision
    assert house.hub.decision is not told, "whoever listens is told at once that plugd is back"
    assert house.hub.decision.status is Status.CHARGING
    assert house.hub.decision.outlook
    assert house.hub.decision.outlook.forecast_until == at(2, day=5)
    house.step(at(2, 30, day=3))
    assert house.solver.calls == calls + 1


def test_a_restart_repeats_an_off_to_arm_the_timer() -> None:
    house = waiting()
    house.begin(saved(house))
    house.step(NIGHT + minutes(5))
    house.step(NIGHT + minutes(6))
    assert house.plug.told == [OFF, OFF]
    assert house.cycle.memory.relay_since == saved(house).relay_since


def test_a_restart_keeps_a_persons_off() -> None:
    house = charging()
    house.hub.said.append(SetMode(Mode.OFF))
    house.step(at(2, 10, day=3))
    house.begin(saved(house))
    house.step(at(2, 12, day=3))
    assert house.plug.told == [ON, HELD, HELD]


def test_an_older_plan_is_made_anew() -> None:
    house = waiting()
    calls = house.solver.calls
    house.begin(saved(house))
    house.step(NIGHT + minutes(30))
    assert house.solver.calls == calls + 1


def test_a_restart_obeys_what_was_said_meanwhile() -> None:
    house = waiting()
    house.begin(saved(house))
    house.hub.said.append(SetMode(Mode.NOW))
    house.step(NIGHT + minutes(5))
    assert house.plug.told == [OFF, ON]


# -- a source that is late, or wrong ---------------------------------------------------------------


def test_a_forecast_that_is_late_is_no_fault_and_is_planned_with_once_it_is_there() -> None:
    house = room()
    house.source.error = ForecastLate("not yet")
    due = house.step()
    assert due == EVENING + LATE
    assert house.faults() == {}
    assert house.cycle.decision is not None  # planned with the usual day meanwhile
    house.source.error = None
    house.step(due)
    assert (house.solver.calls, house.source.asked) == (2, [EVENING, due])
    assert house.cycle.forecast is not None
    house.step(due + LATE)
    assert house.solver.calls == 2


def test_a_forecast_ten_times_too_high_is_not_used_and_told_until_it_is_sound_again() -> None:
    house = room()
    usual = (Intensity(EVENING - k * minutes(30), 150.0 + k % 3) for k in range(2000, 0, -1))
    house.disk.ram.seen |= {row.start: row for row in usual}
    house.step()
    good = house.cycle.forecast
    assert good is not None
    house.source.level = lambda start: 950.0
    house.run(EVENING + timedelta(hours=3))
    assert house.cycle.forecast is good
    assert "it says 950 g/kWh" in house.faults()["forecast"]
    assert "planning with the forecast of 2.5 h ago" in house.faults()["forecast"]
    house.source.level = None
    house.run(EVENING + timedelta(hours=4))
    assert house.faults() == {}


@dataclass(slots=True)
class Chore:
    """An errand that is always due."""

    calls: list[tuple[datetime, bool]] = field(default_factory=list)
    fails: bool = False
    at: datetime | None = None

    def step(self, now: datetime, wait: bool = False) -> None:
        """Remember."""
        self.calls.append((now, wait))
        self.at = now + timedelta(seconds=1)
        if self.fails:
            raise StoreError("the card is full")


def test_errands_are_run_beside_it_and_wait_where_the_source_was_asked() -> None:
    house, chore = room(), Chore()
    house.cycle.errands = (chore,)
    assert house.step() == EVENING + timedelta(seconds=1)
    house.step(EVENING + timedelta(seconds=1))
    assert chore.calls == [(EVENING, True), (EVENING + timedelta(seconds=1), False)]
    chore.fails = True
    house.step(EVENING + timedelta(seconds=2))
    house.step(EVENING + timedelta(seconds=3))
    assert "store" in house.faults()
    chore.fails = False
    house.step(EVENING + timedelta(seconds=4))
    house.step(EVENING + timedelta(seconds=5))
    assert house.faults() == {}


# -- whole stories --------------------------------------------------------------------------------


def test_a_first_start_with_everything_broken_charges() -> None:
    """Nothing is known and nothing works but the relay: the car is charged."""
    house = Room(at(21), fresh(at(21)))
    house.source.error = ForecastUnavailable("no route")
    house.disk.broken = {"save", "append", "history", "keep"}
    house.step()
    assert house.plug.told == [ON]
    assert set(house.faults()) == {"forecast", "store"}


def test_told_away_the_relay_is_off_until_the_guard_must() -> None:
    house = Room(at(2, day=3), replace(knows(0.45), presence=Presence(False, EVENING)))
    house.plug.power_kw = 0.0
    house.run(READY_BY - minutes(1))
    assert house.plug.told == [OFF, ON]
    assert house.plug.tries[1] == pytest.approx(at(4, 56, day=3), abs=minutes(1))
    house.run(READY_BY + minutes(5))
    assert house.plug.told == [OFF, ON, OFF], "the morning is over and nobody is there"


class Fallen:
    """A solver that fails."""

    def solve(self, problem: Problem) -> Solution:
        """Never."""
        raise SolveError("it fell over")


def test_without_its_solver_it_plans_with_the_simple_one_and_says_so() -> None:
    house = room()
    house.step()
    right = sessions_of(house)
    house.cycle.controller.solver = Fallen()
    house.step(EVENING + minutes(30))
    assert house.faults()["solver"].startswith("the solver gave no plan")
    assert [s.session.end for s in sessions_of(house)] == [s.session.end for s in right]
    house.cycle.controller.solver = house.solver
    house.step(EVENING + minutes(60))
    assert "solver" not in house.faults()
