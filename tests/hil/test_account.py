"""The true account on ledgers written by hand."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from plugd.domain import Capability, Car, Household, Record, Status
from plugd.study.world import Battery, Stay
from plugd_hil.account import Line, Night, flows, foresight, nights, per_kwh, read_ledger, soc_at, uncontrolled

HOME = Household(capability=Capability(2.0, dead_man=True), car=Car(efficiency=1.0))
"""50 kWh, 2 kW, nothing lost; planned 20:03 to 06:57 in London, 50 % in the morning, at most 80 %."""
EVENING = datetime(2023, 1, 2, 18, tzinfo=UTC)
MORNING = datetime(2023, 1, 3, 6, 57, tzinfo=UTC)
LEFT = datetime(2023, 1, 3, 9, tzinfo=UTC)


def at(hour: float) -> datetime:
    """Hours after the midnight before the arrival."""
    return datetime(2023, 1, 2, tzinfo=UTC) + timedelta(hours=hour)


def line(hour: float, event: str, soc: float, energy_kwh: float, on: bool = False, connected: bool = True) -> Line:
    return Line(at(hour), event, soc, energy_kwh, on, connected)


def flat(_: datetime) -> float:
    return 100.0


def one_night(soc: float, morning: float, left: float = 33.0) -> Night:
    """A stay from 18:00 to 09:00 (or when `left` says), with `morning` reached by six."""
    ledger = (
        line(12.0, "start", soc, 0.0, connected=False),
        line(18.0, "arrive", soc, 0.0),
        line(min(left, 30.0), "slot", morning, 50 * (morning - soc)),
        line(left, "leave", morning, 50 * (morning - soc)),
        line(34.0, "slot", morning - 0.1, 50 * (morning - soc), connected=False),
    )
    (night,) = nights(ledger, (Stay(at(18.0), at(left), 5.0),), (), HOME, flat)
    return night


def test_a_ledger_is_read_as_it_was_written(tmp_path: Path) -> None:
    row = {"at": "2023-01-02T18:00:00+00:00", "event": "on", "soc": 0.5, "energy_kwh": 1.5, "on": True}
    (tmp_path / "ledger").write_text(json.dumps({**row, "connected": True}) + "\n")
    assert read_ledger(tmp_path / "ledger") == (Line(EVENING, "on", 0.5, 1.5, True, True),)


def test_energy_goes_to_the_half_hour_it_flowed_in() -> None:
    ledger = (
        line(18.25, "on", 0.5, 1.0, on=True),
        line(18.5, "slot", 0.51, 1.5, on=True),
        line(18.75, "off", 0.52, 2.0),
        line(19.0, "slot", 0.52, 2.0),
        line(19.5, "slot", 0.52, 2.0),
    )
    assert list(flows(ledger)) == [(at(18.0), 0.5), (at(18.5), 0.5)]


def test_the_soc_between_two_lines_is_on_the_straight_line() -> None:
    ledger = (line(18.0, "on", 0.4, 0.0, on=True), line(19.0, "off", 0.5, 5.0), line(20.0, "slot", 0.5, 5.0))
    assert soc_at(ledger, at(18.0)) == 0.4
    assert soc_at(ledger, at(18.25)) == pytest.approx(0.425)
    assert soc_at(ledger, at(19.5)) == 0.5
    assert soc_at(ledger, at(99.0)) == 0.5


def test_a_night_by_hand() -> None:
    on, off = line(25.5, "on", 0.4, 0.0, on=True), line(28.0, "off", 0.5, 5.0)
    slots = [line(h / 2, "slot", 0.4 + 0.04 * (h / 2 - 25.5), 2 * (h / 2 - 25.5), on=True) for h in range(52, 56)]
    ledger = (
        line(12.0, "start", 0.4, 0.0, connected=False),
        line(18.0, "arrive", 0.4, 0.0),
        on,
        *slots,
        off,
        line(33.0, "leave", 0.5, 5.0),
        line(33.5, "slot", 0.4, 5.0, connected=False),
    )
    said = (
        Record(at(17.0), 0.4, None, None, False, Status.WAITING, "before", None),
        Record(at(19.0), 0.4, None, None, False, Status.WAITING, "waiting", None),
        Record(at(26.0), 0.4, None, None, True, Status.CHARGING, "charging", None),
        Record(at(26.5), 0.4, None, None, True, Status.CHARGING, "still", None),
    )
    dear_until_two = {at(25.5): 300.0}
    (night,) = nights(
        ledger, (Stay(at(18.0), at(33.0), 5.0),), said, HOME, lambda slot: dear_until_two.get(slot, 100.0)
    )
    assert night.session_end == MORNING
    assert night.charged_kwh == pytest.approx(5.0)
    assert night.carbon_g == pytest.approx(1.0 * 300.0 + 4.0 * 100.0)
    assert (night.arrival_soc, night.morning_soc, night.minimum) == (0.4, 0.5, 0.5)
    assert night.switch_ons == 1
    assert night.reason == "charging"
    assert not night.missed


def test_without_charging_the_last_word_before_the_morning_is_the_reason() -> None:
    ledger = (line(18.0, "arrive", 0.6, 0.0), line(33.0, "leave", 0.6, 0.0), line(34.0, "slot", 0.5, 0.0))
    stay = Stay(at(18.0), at(33.0), 5.0)
    said = [Record(at(h), 0.6, None, None, False, Status.HOLDING, f"at {h}", None) for h in (19.0, 30.0, 32.0)]
    (night,) = nights(ledger, (stay,), tuple(said), HOME, flat)
    assert night.reason == "at 30.0"
    (silent,) = nights(ledger, (stay,), (), HOME, flat)
    assert silent.reason == "The daemon said nothing."


def test_a_night_that_is_not_over_is_not_in_the_account() -> None:
    ledger = (line(18.0, "arrive", 0.6, 0.0), line(30.0, "slot", 0.6, 0.0))
    assert nights(ledger, (Stay(at(18.0), at(33.0), 5.0),), (), HOME, flat) == ()


@pytest.mark.parametrize(
    ("arrival", "morning", "missed"),
    [
        (0.40, 0.500, False),
        (0.40, 0.496, False),  # half a point is forgiven
        (0.40, 0.494, True),
        (0.40, 0.400, True),
        (0.01, 0.500, False),  # 13 h at 2 kW are 26 kWh
        (0.01, 0.494, True),
    ],
)
def test_more_than_half_a_point_under_a_reachable_minimum_is_missed(
    arrival: float, morning: float, missed: bool
) -> None:
    assert one_night(soc=arrival, morning=morning).missed is missed


def test_an_unreachable_minimum_is_not_missed_by_who_charged_all_night() -> None:
    ledger = (line(27.0, "arrive", 0.3, 0.0), line(33.0, "leave", 0.54, 12.0), line(34.0, "slot", 0.4, 12.0))
    (night,) = nights(ledger, (Stay(at(27.0), at(33.0), 5.0),), (), HOME, flat)
    reachable = 0.3 + 2.0 * 3.95 / 50.0
    assert night.best_soc == pytest.approx(reachable)
    assert night.morning_soc == pytest.approx(reachable)
    assert night.morning_soc < night.minimum
    assert not night.missed


def test_what_is_reachable_counts_the_cars_own_losses() -> None:
    lossy = Household(capability=HOME.capability, car=Car(efficiency=0.5))
    ledger = (line(27.0, "arrive", 0.3, 0.0), line(33.0, "leave", 0.4, 12.0), line(34.0, "slot", 0.4, 12.0))
    (night,) = nights(ledger, (Stay(at(27.0), at(33.0), 5.0),), (), lossy, flat)
    assert night.best_soc == pytest.approx(0.3 + 0.5 * 2.0 * 3.95 / 50.0)


def test_a_car_that_left_early_is_not_missed_and_its_morning_is_when_it_left() -> None:
    night = one_night(soc=0.4, morning=0.42, left=29.0)
    assert not night.missed
    assert night.morning_soc == 0.42  # and not what driving has left of it


def test_a_relay_that_was_on_before_the_car_came_is_no_switch_on_of_the_night() -> None:
    ledger = (
        line(17.0, "on", 0.4, 0.0, on=True, connected=False),
        line(18.0, "arrive", 0.4, 0.0, on=True),
        line(20.0, "off", 0.48, 4.0),
        line(21.0, "on", 0.48, 4.0, on=True),
        line(22.0, "off", 0.52, 6.0),
        line(33.0, "leave", 0.52, 6.0),
        line(34.0, "slot", 0.4, 6.0),
    )
    (night,) = nights(ledger, (Stay(at(18.0), at(33.0), 5.0),), (), HOME, flat)
    assert night.switch_ons == 1
    assert night.charged_kwh == pytest.approx(6.0)


def test_charging_on_arrival_by_hand() -> None:
    """From 70 % to the limit of 80 % at 2 kW: 18:15 to 20:45; 4 kWh are driven; the next night 18:00 to 20:00."""

    def by_hour(slot: datetime) -> float:
        return {18: 300.0, 19: 200.0, 20: 100.0}.get(slot.hour, 1e9)

    stays = (Stay(at(18.25), at(33.0), 4.0), Stay(at(42.0), at(57.0), 4.0))
    taken_kwh, carbon_g = uncontrolled(stays, HOME, by_hour, Battery(50.0, 35.0, 1.0))
    assert taken_kwh == pytest.approx(5.0 + 4.0)
    first = 2.0 * (0.75 * 300.0 + 1.0 * 200.0 + 0.75 * 100.0)
    second = 2.0 * (1.0 * 300.0 + 1.0 * 200.0)
    assert carbon_g == pytest.approx(first + second)


def test_charging_on_arrival_loses_what_the_charger_loses_and_stops_when_the_car_leaves() -> None:
    battery = Battery(50.0, 20.0, 0.5)
    taken_kwh, carbon_g = uncontrolled((Stay(at(18.0), at(20.0), 5.0),), HOME, flat, battery)
    assert taken_kwh == pytest.approx(4.0)
    assert carbon_g == pytest.approx(400.0)
    assert battery.energy_kwh == pytest.approx(20.0 + 2.0 - 5.0)
    assert uncontrolled((Stay(at(18.0), at(20.0), 5.0),), HOME, flat, Battery(50.0, 41.0, 0.5)) == (0.0, 0.0)


def test_foresight_finds_the_clean_hours() -> None:
    """Two nights, clean from nine to six: who knows charges there and nowhere else."""

    def clean_at_night(slot: datetime) -> float:
        return 300.0 if 6 <= slot.hour < 21 else 50.0

    stays = (Stay(at(18.0), at(33.0), 5.0), Stay(at(42.0), at(57.0), 5.0), Stay(at(66.0), at(81.0), 5.0))
    kwh, grams = foresight(stays, HOME, clean_at_night, Battery(50.0, 25.0, 1.0), (at(12.0), at(57.0)))
    assert kwh > 5.0
    assert grams / kwh < 60.0  # the random delay carries a few minutes past the clean hours


def test_nothing_charged_has_no_intensity() -> None:
    assert per_kwh(0.0, 0.0) is None
    assert per_kwh(3.0, 400.0) == 133.33
