"""A clock that is not set, or steps, does no harm."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import pytest

from plugd import wall
from plugd.domain import Mode, Plan, Relay, SetMode, Setpoint, Status, Trip
from plugd.wall import Wall, newest, shifted
from tests.fakes import FakeClock
from tests.unit.deciding import CHARGER, EVENING, EXPECTED, HOME, NIGHT, Room, knows, minutes

AT_BOOT = datetime(1970, 1, 1, 0, 0, 20, tzinfo=UTC)
YEARS = timedelta(days=3652)


def looked(known: datetime, *shown: tuple[float, datetime]) -> tuple[Wall, list[datetime]]:
    """After looks at (monotonic seconds, what the clock shows)."""
    found = Wall(known)
    return found, [found.look(at, now_s) for now_s, at in shown]


# -- what is believed -----------------------------------------------------------------------------


@pytest.mark.parametrize("known", [wall.BUILT, NIGHT, NIGHT + minutes(119)])
def test_a_clock_that_can_be_is_believed(known: datetime) -> None:
    found, times = looked(known, (5.0, NIGHT), (15.0, NIGHT + timedelta(seconds=10)))
    assert (found.believed, found.faults(), found.jumped) == (True, (), timedelta(0))
    assert times == [NIGHT, NIGHT + timedelta(seconds=10)]


@pytest.mark.parametrize("shown", [AT_BOOT, datetime(1999, 12, 31, tzinfo=UTC), NIGHT - minutes(150)])
def test_one_behind_what_was_stored_is_not_and_own_time_goes_on(shown: datetime) -> None:
    found, times = looked(NIGHT, (3.0, shown), (63.0, shown + minutes(1)))
    assert not found.believed
    assert times == [NIGHT, NIGHT + minutes(1)]
    (fault,) = found.faults()
    assert fault.code == "clock"
    assert f"{shown:%Y-%m-%d}" in fault.text


def test_without_anything_stored_no_clock_before_the_first_plugd_is_believed() -> None:
    assert not looked(wall.BUILT, (0.0, AT_BOOT))[0].believed


def test_once_it_is_set_it_is_believed_and_time_has_just_passed() -> None:
    found, times = looked(NIGHT, (0.0, AT_BOOT), (60.0, NIGHT + minutes(30)))
    assert (found.believed, times[-1], found.jumped) == (True, NIGHT + minutes(30), timedelta(0))


def test_a_clock_that_nobody_corrects_for_a_day_is_believed() -> None:
    day = timedelta(days=1)
    found, times = looked(
        NIGHT + YEARS, (0.0, NIGHT), (86_399.0, NIGHT + day - timedelta(seconds=1)), (86_400.0, NIGHT + day)
    )
    assert times[1] == NIGHT + YEARS + day - timedelta(seconds=1)
    assert (found.believed, times[2]) == (True, NIGHT + day)
    assert found.jumped == -YEARS, "what was stored is from a clock that ran ahead"


def test_one_that_nobody_has_told_the_time_is_not_believed_until_somebody_does() -> None:
    found = Wall(NIGHT)
    assert found.look(NIGHT + minutes(5), 0.0, unset=True) == NIGHT + minutes(5)
    assert found.look(NIGHT + minutes(65), 3600.0, unset=True) == NIGHT + minutes(65)
    assert not found.believed
    five_hours_on = NIGHT + timedelta(hours=5)
    assert found.look(five_hours_on, 3610.0) == five_hours_on
    assert (found.believed, found.jumped) == (True, timedelta(0)), "time has just passed"


def test_what_was_told_once_stays_told() -> None:
    found = Wall(NIGHT)
    found.look(NIGHT, 0.0)
    found.look(NIGHT + minutes(1), 60.0, unset=True)
    assert found.believed


def test_one_that_was_right_all_along_is_believed_once_that_is_known() -> None:
    found = Wall(NIGHT)
    found.look(NIGHT, 0.0, unset=True)
    assert found.look(NIGHT + minutes(1), 60.0) == NIGHT + minutes(1)
    assert (found.believed, found.jumped) == (True, timedelta(0))


@pytest.mark.parametrize("by", [timedelta(hours=1), timedelta(hours=-1), YEARS, timedelta(seconds=31)])
def test_a_step_is_noticed_once(by: timedelta) -> None:
    found = Wall()
    found.look(NIGHT, 0.0)
    found.look(NIGHT + minutes(1) + by, 60.0)
    assert found.jumped == by
    found.look(NIGHT + minutes(2) + by, 120.0)
    assert found.jumped == timedelta(0)


def test_a_clock_that_is_slewed_has_not_stepped() -> None:
    found = Wall()
    found.look(NIGHT, 0.0)
    found.look(NIGHT + timedelta(seconds=89), 60.0)
    assert found.jumped == timedelta(0)


def test_a_step_to_before_the_first_plugd_is_no_time_at_all() -> None:
    found, times = looked(wall.BUILT, (0.0, NIGHT), (60.0, NIGHT - YEARS), (120.0, NIGHT - YEARS + minutes(1)))
    assert times == [NIGHT, NIGHT + minutes(1), NIGHT + minutes(2)]
    assert found.look(NIGHT + minutes(3), 180.0) == NIGHT + minutes(3)
    assert (found.believed, found.jumped) == (True, timedelta(0))


# -- what is remembered ---------------------------------------------------------------------------


def test_after_a_step_everything_is_as_long_ago_as_before() -> None:
    memory = replace(knows(0.5), relay_since=NIGHT, switch_ons=(NIGHT, NIGHT + minutes(1)), moved=(NIGHT,))
    memory = replace(memory, overrides=replace(memory.overrides, trips=(Trip(NIGHT.date()),)))
    after = shifted(memory, YEARS, EVENING)
    assert (after.relay_since, after.switch_ons, after.moved) == (
        NIGHT + YEARS, (NIGHT + YEARS, NIGHT + YEARS + minutes(1)), (NIGHT + YEARS,),
    )  # fmt: skip
    assert after.soc.driven_to == memory.soc.driven_to + YEARS
    assert after.soc.mean == memory.soc.mean
    assert after.overrides == memory.overrides, "days stay days"
    assert shifted(after, -YEARS, EVENING) == memory


def test_the_newest_moment_is_that_of_the_last_plan_or_meter_reading() -> None:
    memory = knows(0.5)
    assert newest(memory) == EVENING
    planned = replace(memory, plan=Plan(NIGHT, (), "solved", "exact", 0.0, 0.0))
    assert newest(planned) == NIGHT


# -- what is done ---------------------------------------------------------------------------------


def test_without_a_clock_it_holds_for_ten_minutes_and_then_charges_and_enters_nothing() -> None:
    house = Room(NIGHT, knows(0.6))
    house.run(NIGHT + minutes(10))
    assert house.plug.told == [Relay(False)]
    house.begin(house.cycle.memory)
    entered, asked = len(house.disk.ram.records), len(house.source.asked)
    house.clock.at = boot = datetime(2023, 1, 2, 0, 30, tzinfo=UTC)  # a day behind: it stood still
    house.step()
    assert "the clock is not set" in house.faults()["clock"]
    assert house.hub.decision
    assert house.hub.decision.status is Status.FAULT
    house.step(boot + minutes(9))
    assert house.plug.told[-1] == Relay(False)
    house.step(boot + minutes(10))
    assert house.plug.told[-1] == Relay(True)
    house.run(boot + minutes(90))
    assert house.plug.told[-1] == Relay(True)
    assert (len(house.disk.ram.records), len(house.source.asked)) == (entered, asked)
    house.hub.said.append(SetMode(Mode.OFF))
    house.step()
    assert house.plug.told[-1] == Relay(False, held=True), "a person's off counts without a clock too"


@dataclass(slots=True)
class Stepping(FakeClock):
    """A wall clock that is off by so much."""

    off: timedelta = timedelta(0)

    def now(self) -> datetime:
        """What it shows."""
        return self.at + self.off


def test_a_step_costs_at_most_one_switch_and_the_homecomings_are_counted_right() -> None:
    house = Room(EXPECTED, knows(0.6, EXPECTED))
    clock = house.clock = house.plug.clock = Stepping(EXPECTED)
    cycle = house.begin(house.cycle.memory)
    for off in (timedelta(0), YEARS, timedelta(0), timedelta(hours=1), timedelta(0)):
        clock.off = off
        before = len(house.plug.told)
        for _ in range(6):
            cycle.step()
            clock.at += minutes(5)
        assert len(house.plug.told) - before <= 1
    assert cycle.memory.soc.driven_to == EXPECTED
    assert cycle.memory.soc.sd < 0.01


def test_what_was_before_the_clock_stood_still_stays() -> None:
    """The mains were away for five hours, and a clock without a battery goes on from where it stood."""
    noon = EVENING - timedelta(hours=6)
    memory = knows(0.6, noon)
    house = Room(EVENING, replace(memory, soc=replace(memory.soc, driven_to=noon)))
    clock = house.clock = house.plug.clock = Stepping(EVENING, timedelta(hours=-5))
    cycle = house.begin(house.cycle.memory)
    cycle.step()
    clock.at, clock.off = EVENING + minutes(5), timedelta(0)
    cycle.step()
    assert cycle.memory.soc.driven_to == noon
    clock.at = EXPECTED
    cycle.step()
    assert cycle.memory.soc.mean == pytest.approx(0.6 - HOME.car.daily_use_kwh / HOME.car.capacity_kwh)


def test_since_when_it_runs_is_told_by_the_clock_as_it_is_now() -> None:
    house = Room(EVENING, knows(0.6))
    clock = house.clock = house.plug.clock = Stepping(EVENING)
    cycle = house.begin(house.cycle.memory)
    for off in (timedelta(0), timedelta(hours=1), YEARS):
        clock.off = off
        clock.at += minutes(5)
        cycle.step()
        assert cycle.shown is not None
        assert cycle.shown.running_since == EVENING + minutes(5) + off


def test_a_charger_is_given_all_it_may_have() -> None:
    found, _ = looked(NIGHT, (0.0, AT_BOOT))
    told = Setpoint(0.0, NIGHT)
    assert found.wanted(told, False, 599.0, CHARGER.capability.power_max_kw) == told
    assert found.wanted(told, False, 600.0, CHARGER.capability.power_max_kw) == Setpoint(7.4, NIGHT)
