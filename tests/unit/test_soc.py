"""What the meter, people and the passing of days make of the state of charge."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd import soc
from plugd.domain import Car, Reading, SocEstimate

NOW = datetime(2023, 1, 2, 22, tzinfo=UTC)
CAR = Car()
POWER_KW = 2.3


def reading(minutes: float, kwh: float | None, kw: float | None = POWER_KW, on: bool = True) -> Reading:
    at = NOW + timedelta(minutes=minutes)
    return Reading(at, on, kw, kwh, at)


def known(mean: float = 0.5) -> SocEstimate:
    return soc.metered(soc.told(soc.unknown(NOW), mean, NOW, "car"), reading(0, 100.0), CAR, POWER_KW)


def test_nobody_said_anything_so_promises_count_on_nearly_nothing() -> None:
    assert soc.cautious(soc.unknown(NOW)) == pytest.approx(0.09)


def test_metered_energy_counts_with_the_efficiency() -> None:
    estimate = soc.metered(known(), reading(60, 102.3), CAR, POWER_KW)
    assert estimate.mean == pytest.approx(0.5 + 2.3 * 0.9 / 50)


def test_the_same_reading_twice_counts_once() -> None:
    once = soc.metered(known(), reading(60, 102.3), CAR, POWER_KW)
    assert soc.metered(once, reading(60, 102.3), CAR, POWER_KW) == once


@pytest.mark.parametrize(
    ("shows_kwh", "gain_kwh"),
    [(0.4, 0.4), (50.0, 0.0), (1e6, 0.0), (None, 0.0)],
    ids=["reset", "backwards", "absurd", "silent"],
)
def test_a_meter_that_resets_jumps_or_is_silent_never_invents_energy(shows_kwh: float | None, gain_kwh: float) -> None:
    estimate = soc.metered(known(), reading(60, shows_kwh), CAR, POWER_KW)
    assert estimate.mean == pytest.approx(0.5 + gain_kwh * 0.9 / 50)


def test_driving_lowers_the_mean_and_widens_the_doubt() -> None:
    after = soc.driven(known(0.8), ((NOW, 1), (NOW + timedelta(days=1), 2)), CAR)
    assert after.mean == pytest.approx(0.8 - 3 * 5.8 / 50)
    assert after.sd == pytest.approx((soc.TOLD_SD**2 + 3 * (2.67 / 50) ** 2) ** 0.5)
    assert after.driven_to == NOW + timedelta(days=1)


def test_power_that_tapers_and_stops_means_full_and_one_that_is_cut_does_not() -> None:
    def after(*powers_kw: float) -> SocEstimate:
        estimate = soc.driven(known(0.5), ((NOW, 9),), CAR)
        for minute, kw in enumerate(powers_kw, start=1):
            estimate = soc.metered(estimate, reading(minute, 100.0, kw), CAR, POWER_KW)
        return estimate

    tapered, cut = after(2.3, 1.8, 1.0, 0.0), after(2.3, 2.3, 0.0)
    assert (tapered.source, tapered.mean) == ("full", CAR.soc_max)
    assert soc.cautious(tapered) > 0.75
    assert cut.source == "car"
    assert soc.cautious(cut) < 0.2


def test_a_relay_that_goes_off_is_no_sign_of_a_full_car() -> None:
    estimate = known()
    for minute, (kw, on) in enumerate([(2.3, True), (1.0, True), (0.0, False), (0.0, True)], start=1):
        estimate = soc.metered(estimate, reading(minute, 100.0, kw, on), CAR, POWER_KW)
    assert estimate.source == "car"


@given(
    st.lists(
        st.tuples(st.floats(0, 120), st.floats(-1, 1e7) | st.none(), st.floats(0, 10) | st.none(), st.booleans()),
        max_size=30,
    )
)
def test_whatever_the_meter_says_the_estimate_stays_a_state_of_charge(
    said: list[tuple[float, float | None, float | None, bool]],
) -> None:
    estimate, minute = known(), 0.0
    for step, kwh, kw, on in said:
        minute += step
        before = estimate
        estimate = soc.metered(estimate, reading(minute, kwh, kw, on), CAR, POWER_KW)
        assert 0.0 <= soc.cautious(estimate) <= estimate.mean <= 1.0
        if estimate.source == before.source:
            most_kwh = 1.5 * POWER_KW * step / 60 + 0.1 + 1e-9
            assert 0.0 <= (estimate.mean - before.mean) * 50 / 0.9 <= max(most_kwh, soc.RESET_KWH)


def test_a_told_soc_ends_the_doubt() -> None:
    estimate = soc.told(soc.driven(known(), ((NOW, 30),), CAR), 0.62, NOW, "hub")
    assert replace(estimate, meter_kwh=None, metered_at=None) == SocEstimate(0.62, soc.TOLD_SD, "hub", NOW, NOW)
