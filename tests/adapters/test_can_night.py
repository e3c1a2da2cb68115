"""A night of the whole cycle with the charger on CAN: every second of it, in one process."""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest

from plugd import perception
from plugd.adapters.can_soc import soc_signal
from plugd.controller import Controller
from plugd.cycle import LOOK_S, Cycle
from plugd.domain import Capability, Household, Setpoint
from plugd.planner.exact import Exact
from plugd.study.house import FunctionSource, RamStore, SimHub
from plugd.study.world import Battery, Stay
from plugd_hil.car import CarAtHome
from plugd_hil.elcon import Rating
from tests.can_world import LIMITS, CanWorld
from tests.fakes import FakeClock, FakePlug

EVENING = datetime(2023, 1, 2, 17, 30, tzinfo=UTC)
CHARGER = Capability(2.3, modulating=True, power_min_kw=1.38)


class Quiet:
    """An inbox in which nothing arrives."""

    def __init__(self, full: bool = False) -> None:
        self.full = full
        self.waited = 0

    def pending(self) -> bool:
        return self.full

    def wait(self, timeout_s: float) -> None:
        self.waited += 1

    def wake(self) -> None:
        pass

    def flush(self) -> None:
        pass


def stays() -> Iterator[Stay]:
    yield Stay(EVENING + timedelta(minutes=30), EVENING + timedelta(hours=15), 6.0)
    yield Stay(EVENING + timedelta(days=300), EVENING + timedelta(days=301), 6.0)


def world(soc: float, tells: str) -> CanWorld:
    car = CarAtHome(Battery(energy_kwh=50.0 * soc), False, stays(), EVENING)
    made = CanWorld(EVENING, car, Rating(2.3), tells)

    def happen(now: datetime) -> None:
        due = car.due()
        if due is None or due > now:
            return
        if car.connected:
            car.leave()
        else:
            car.arrive()
        made.charger.load_changed()

    made.happens = happen
    return made


def cycle_in(made: CanWorld) -> Cycle:
    plug = made.plug(CHARGER, soc=soc_signal("pylontech", None, None))
    return Cycle(
        clock=made,
        source=FunctionSource(lambda _, start: 100.0 + start.hour * 7 % 50),
        plug=plug,
        hub=SimHub(),
        store=RamStore(),
        controller=Controller(Household(capability=CHARGER), Exact()),
        memory=perception.fresh(made.at),
        spread=lambda: 0.0,
    )


def test_a_night_on_can_ends_with_the_minimum_and_no_frame_above_the_limits() -> None:
    made = world(0.41, "arrival")
    cycle = cycle_in(made)
    while made.at < EVENING + timedelta(hours=13.5):  # 07:00
        cycle.rest(cycle.step(), Quiet(), lambda: False)
    asked = made.charger.asked
    assert made.car.battery.soc >= 0.5
    assert cycle.memory.soc.mean == pytest.approx(made.car.battery.soc, abs=0.02)
    assert cycle.memory.guard_count <= 1, "only before the battery had told how full it is"
    assert (asked.voltage_v, asked.current_a <= LIMITS.current_a) == (LIMITS.voltage_v, True)
    assert (asked.invalid, asked.opened_under_load) == (0, 0)
    assert asked.longest_silence_s <= 2.0
    assert not cycle.plug.warnings
    made.bus.shutdown()


def test_while_it_rests_the_charger_is_told_and_the_rest_is_looked_at_every_few_seconds() -> None:
    made = world(0.5, "never")
    cycle = cycle_in(made)
    due = cycle.step()
    at, told = made.at, len(made.commands)
    assert due > at + timedelta(seconds=LOOK_S), "the charger's seconds are no reason to plan"
    cycle.rest(due, Quiet(), lambda: False)
    assert made.at - at == timedelta(seconds=LOOK_S)
    assert len(made.commands) - told == LOOK_S
    made.bus.shutdown()


def test_a_message_ends_the_rest_at_the_next_word_and_a_signal_too() -> None:
    made = world(0.5, "never")
    cycle = cycle_in(made)
    due = cycle.step()
    at = made.at
    cycle.rest(due, Quiet(full=True), lambda: False)
    assert made.at == at
    cycle.rest(due, Quiet(), lambda: made.at >= at + timedelta(seconds=3.0))
    assert made.at <= at + timedelta(seconds=4.0)
    made.bus.shutdown()


def test_any_other_plug_rests_until_something_is_due() -> None:
    made = world(0.5, "never")
    cycle = cycle_in(made)
    clock = FakeClock()
    cycle.clock, cycle.plug = clock, FakePlug(clock)
    cycle.rest(clock.at + timedelta(minutes=20), Quiet(), lambda: False)
    assert clock.monotonic() == 1200.0


def test_a_charger_held_on_by_the_guard_is_on_without_a_gap() -> None:
    made = world(0.1, "arrival")
    cycle = cycle_in(made)
    while made.at < EVENING + timedelta(minutes=50):
        cycle.rest(cycle.step(), Quiet(), lambda: False)
    offs: list[datetime] = []
    before = made.happens

    def watch(now: datetime) -> None:
        before(now)
        offs.extend(() if made.charger.on else (now,))

    made.happens = watch
    while made.at < EVENING + timedelta(hours=2):
        cycle.rest(cycle.step(), Quiet(), lambda: False)
    assert isinstance(cycle.actuator.told, Setpoint)
    assert cycle.actuator.told.power_kw == CHARGER.power_max_kw
    assert not offs
    made.bus.shutdown()
