"""What readings and time do to memory."""

from dataclasses import replace
from datetime import datetime, timedelta

import pytest

from plugd.domain import Memory, Mode, Overrides, Presence, Press, Reading, Setpoint
from plugd.perception import fresh, perceive
from tests.unit.deciding import CHARGER, EVENING, HOME, NIGHT, NOON, at, knows, minutes


def reading(
    on: bool = True, power_kw: float | None = 2.0, energy_kwh: float | None = 5.0, now: datetime = NIGHT,
    moved: bool | None = None,
) -> Reading:  # fmt: skip
    return Reading(now, on, power_kw, energy_kwh, now, moved)


def seen(memory: Memory, *readings: Reading) -> Memory:
    for each in readings:
        memory = perceive(each.at, each, memory, HOME)
    return memory


# -- the relay and the power ----------------------------------------------------------------------


def test_a_relay_seen_for_the_first_time_owes_no_dwell() -> None:
    memory = seen(fresh(NIGHT), reading(on=False))
    assert (memory.relay_on, memory.relay_since) == (False, None)


def test_a_relay_that_moved_by_itself_is_noticed() -> None:
    memory = replace(knows(0.5), relay_on=False, relay_since=EVENING)
    assert seen(memory, reading(on=False)).relay_since == EVENING
    moved = seen(memory, reading(on=True))
    assert (moved.relay_on, moved.relay_since) == (True, NIGHT)


def test_the_power_the_car_takes_is_smoothed_once_a_reading() -> None:
    memory = seen(knows(0.5), reading(power_kw=2.0))
    assert memory.observed_kw == 2.0
    later = NIGHT + minutes(5)
    memory = seen(memory, reading(power_kw=1.0, now=later))
    assert memory.observed_kw == pytest.approx(1.8)
    assert seen(memory, reading(power_kw=1.0, now=later)).observed_kw == memory.observed_kw


@pytest.mark.parametrize(
    ("says", "soc"),
    [
        (reading(power_kw=0.6), 0.5),
        (reading(power_kw=2.9), 0.5),
        (reading(power_kw=None), 0.5),
        (reading(on=False, power_kw=2.0), 0.5),
        (reading(power_kw=1.0), 0.95),
    ],
    ids=["too little", "too much", "no meter", "off", "tapering"],
)
def test_a_power_that_says_nothing_of_the_car_is_left_out(says: Reading, soc: float) -> None:
    memory = replace(knows(soc), observed_kw=2.1)
    assert seen(memory, says).observed_kw == 2.1


def test_a_plug_configured_far_too_strong_is_seen_through() -> None:
    """No charger takes less than 6 A: 2 kW is what the car takes, however much was configured."""
    strong = replace(HOME, capability=replace(HOME.capability, power_max_kw=10.0))
    assert perceive(NIGHT, reading(power_kw=2.0), knows(0.5), strong).observed_kw == 2.0
    assert perceive(NIGHT, reading(power_kw=0.9), knows(0.5), strong).observed_kw is None


def given(setpoint_kw: float, power_kw: float, known_kw: float | None) -> float | None:
    """What is believed of a car that takes `power_kw` where the charger was told `setpoint_kw`."""
    memory = replace(knows(0.5), observed_kw=known_kw, orders=Setpoint(setpoint_kw, NIGHT + minutes(30)))
    return perceive(NIGHT, reading(power_kw=power_kw), memory, CHARGER).observed_kw


def test_a_car_that_takes_what_the_charger_gives_says_nothing_of_its_limit() -> None:
    assert given(3.0, 3.0, None) is None
    assert given(3.0, 2.95, 7.0) == 7.0
    assert given(7.4, 7.4, None) == 7.4
    # Less than it was given is its limit; more than was believed raises it.
    assert given(7.4, 5.0, None) == 5.0
    assert given(7.4, 5.0, 7.0) == pytest.approx(6.6)
    assert given(3.0, 7.4, 5.0) == pytest.approx(5.48)


def test_a_configured_taper_is_no_limit_of_the_car() -> None:
    tapers = replace(HOME, car=replace(HOME.car, taper_from=0.7))
    memory = replace(knows(0.75), observed_kw=2.3)
    assert perceive(NIGHT, reading(power_kw=1.5), memory, tapers).observed_kw == 2.3


def test_a_car_is_not_full_because_its_charger_gives_less_and_less() -> None:
    memory = replace(knows(0.5), observed_kw=2.1, orders=Setpoint(2.0, NIGHT + minutes(120)))
    memory = seen(memory, reading(power_kw=2.0))
    for after, power_kw in ((30, 1.0), (60, 0.1), (90, 0.0)):
        memory = replace(memory, orders=Setpoint(power_kw, NIGHT + minutes(120)))
        memory = seen(memory, reading(power_kw=power_kw, now=NIGHT + minutes(after)))
        assert memory.soc.source == "hub"


def test_metered_energy_is_in_the_soc() -> None:
    memory = seen(knows(0.5), reading(energy_kwh=5.0), reading(energy_kwh=7.0, now=NIGHT + minutes(60)))
    assert memory.soc.mean == pytest.approx(0.5 + 2.0 * 0.9 / 50.0)


def test_a_day_of_driving_is_taken_off_when_the_car_is_back() -> None:
    memory = knows(0.6)
    assert perceive(at(20, 2, day=3), None, memory, HOME).soc.mean == 0.6
    home_again = perceive(at(20, 4, day=3), None, memory, HOME)
    assert home_again.soc.mean == pytest.approx(0.6 - 5.8 / 50.0)
    assert perceive(at(20, 5, day=3), None, home_again, HOME) == home_again


def test_switch_ons_are_forgotten_after_a_day() -> None:
    memory = replace(knows(0.5), switch_ons=(NIGHT - timedelta(hours=24), NIGHT - timedelta(hours=23)))
    assert perceive(NIGHT, None, memory, HOME).switch_ons == (NIGHT - timedelta(hours=23),)


# -- the button -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pressed_at", "until"),
    [
        (NIGHT, at(11, 3, day=3)),
        (at(7, 30, day=3), at(11, 3, day=3)),
        (at(14, day=3), at(11, 3, day=4)),
    ],
    ids=["at night", "in the morning after the session end", "before the car is expected"],
)
def test_pressed_on_counts_to_the_end_of_this_stay(pressed_at: datetime, until: datetime) -> None:
    memory = seen(knows(0.5), reading(moved=True, now=pressed_at))
    assert memory.press == Press(True, until)
    assert perceive(until - minutes(1), None, memory, HOME).press == memory.press
    assert perceive(until, None, memory, HOME).press is None


@pytest.mark.parametrize(
    ("pressed_at", "until"), [(NIGHT, at(20, 3, day=3)), (at(14), at(20, 3))], ids=["at night", "at noon"]
)
def test_pressed_off_counts_to_the_expected_plug_in_where_none_is_told(pressed_at: datetime, until: datetime) -> None:
    memory = seen(knows(0.5), reading(on=False, moved=False, now=pressed_at))
    assert memory.press == Press(False, until)
    assert perceive(until - minutes(1), None, memory, HOME).press == memory.press
    assert perceive(until, None, memory, HOME).press is None


@pytest.mark.parametrize("here", [True, False])
def test_pressed_off_waits_for_the_told_plug_in_where_they_are_told(here: bool) -> None:
    memory = seen(replace(knows(0.5), presence=Presence(here, EVENING)), reading(on=False, moved=False))
    assert memory.press == Press(False, None)
    assert perceive(at(12, day=20), None, memory, HOME).press == Press(False, None)


@pytest.mark.parametrize(
    ("mode", "on", "after"),
    [
        (Mode.OFF, True, Mode.SMART),
        (Mode.OFF, False, Mode.OFF),
        (Mode.NOW, True, Mode.NOW),
        (Mode.NOW, False, Mode.SMART),
        (Mode.SMART, True, Mode.SMART),
    ],
)
def test_the_later_word_of_a_person_takes_back_the_earlier_one(mode: Mode, on: bool, after: Mode) -> None:
    memory = seen(replace(knows(0.5), overrides=Overrides(mode=mode)), reading(on=on, moved=on))
    assert memory.overrides.mode is after


def test_the_second_press_counts() -> None:
    memory = seen(knows(0.5), reading(moved=True), reading(on=False, moved=False, now=NIGHT + minutes(1)))
    assert memory.press is not None
    assert not memory.press.on


def test_a_relay_that_moved_without_a_person_is_no_press() -> None:
    assert seen(replace(knows(0.5), relay_on=False), reading(on=True)).press is None


# -- now ------------------------------------------------------------------------------------------


def test_now_lasts_until_soc_max() -> None:
    boosting = replace(knows(0.79), overrides=Overrides(mode=Mode.NOW))
    begun = seen(boosting, reading(energy_kwh=5.0))
    assert begun.overrides.mode is Mode.NOW
    full = seen(begun, reading(energy_kwh=5.6, now=NIGHT + minutes(20)))
    assert full.soc.mean > 0.8
    assert full.overrides.mode is Mode.SMART


def test_a_press_on_lasts_until_soc_max_as_now_does() -> None:
    begun = seen(knows(0.79), reading(energy_kwh=5.0, moved=True))
    assert begun.press is not None
    assert seen(begun, reading(energy_kwh=5.6, now=NIGHT + minutes(20))).press is None


def test_a_press_on_at_soc_max_is_over_at_once() -> None:
    assert seen(knows(0.8), reading(moved=True)).press is None


def test_off_does_not_end_with_a_full_battery() -> None:
    memory = replace(knows(0.9), overrides=Overrides(mode=Mode.OFF), press=Press(False, None))
    assert perceive(NIGHT, None, memory, HOME) == memory


def test_a_first_start_knows_nothing() -> None:
    memory = fresh(NOON)
    assert (memory.soc.source, memory.soc.told_at, memory.relay_on, memory.plan) == ("assumed", None, None, None)
    assert perceive(NOON, None, memory, HOME) == memory
