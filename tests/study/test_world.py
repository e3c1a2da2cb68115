"""The battery conserves energy, and the driver is the paper's."""

from datetime import UTC, datetime, timedelta
from itertools import islice, pairwise
from statistics import fmean, stdev

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd.study.world import Battery, Driver


@given(
    soc=st.floats(0, 1),
    offered_kw=st.floats(0, 22),
    lengths_h=st.lists(st.floats(0, 12), min_size=1, max_size=6),
    efficiency=st.floats(0.5, 1),
    taper_from=st.floats(0.5, 1),
)
def test_what_the_meter_counts_arrives_times_the_efficiency(
    soc: float, offered_kw: float, lengths_h: list[float], efficiency: float, taper_from: float
) -> None:
    battery = Battery(50.0, 50.0 * soc, efficiency, taper_from)
    taken_kwh = sum(battery.charge(offered_kw, length_h) for length_h in lengths_h)
    assert battery.energy_kwh == pytest.approx(50.0 * soc + taken_kwh * efficiency, abs=1e-9)
    assert battery.soc <= 1.0 + 1e-9
    assert taken_kwh <= offered_kw * sum(lengths_h) + 1e-9


def test_power_tapers_near_full_and_stops() -> None:
    battery = Battery(50.0, 47.5)
    assert battery.takes_kw(2.3) == 2.3
    battery.charge(2.3, 1.0)
    assert 0.0 < battery.takes_kw(2.3) < 1.5
    battery.charge(2.3, 100.0)
    assert battery.takes_kw(2.3) == 0.0
    assert battery.soc > 0.998


def test_a_battery_cannot_be_driven_below_empty() -> None:
    battery = Battery(50.0, 3.0)
    assert battery.drive(10.0) == 3.0
    assert battery.energy_kwh == 0.0


def test_the_driver_is_the_papers() -> None:
    start = datetime(2023, 1, 1, 12, tzinfo=UTC)
    stays = [s for s in islice(Driver(timezone="UTC").stays(start), 3000) if s.arrival > start]
    arrival_h = [s.arrival.hour + s.arrival.minute / 60 for s in stays]
    departure_h = [s.departure.hour + s.departure.minute / 60 for s in stays]
    assert fmean(arrival_h) == pytest.approx(18.0, abs=0.1)
    assert fmean(departure_h) == pytest.approx(9.0, abs=0.1)
    assert stdev(arrival_h) == pytest.approx(1.0, abs=0.1)
    assert fmean(s.use_kwh for s in stays) == pytest.approx(5.83, abs=0.2)
    assert min(s.use_kwh for s in stays) == 0.0
    assert all(a.departure < b.arrival for a, b in pairwise(stays))


def test_the_same_seed_and_day_is_the_same_stay_wherever_one_begins() -> None:
    start = datetime(2023, 1, 1, 12, tzinfo=UTC)
    from_the_first = list(islice(Driver(seed=4).stays(start), 10))
    from_the_third = list(islice(Driver(seed=4).stays(start + timedelta(days=3)), 7))
    assert from_the_first[-7:] == from_the_third
    assert from_the_first != list(islice(Driver(seed=5).stays(start), 10))
