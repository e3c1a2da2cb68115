"""What forecasts got wrong is learned as it becomes known, believed by its evidence, and from nothing later."""

import math
import random
import weakref
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from plugd import outlook
from plugd.domain import Forecast, Intensity, SlotSource
from plugd.outlook import Learned, replayed
from plugd.outlook.learned import EVERY, LATE
from plugd.outlook.tables import Fit
from plugd.units import HALF_HOUR

START = datetime(2023, 1, 2, tzinfo=UTC)
DAYS = 20
NOW = START + timedelta(days=DAYS)


def true_g_per_kwh(k: int) -> float:
    """A day's shape on weather that takes days to change. `k` counts half hours from the start."""
    return 200.0 + 40.0 * math.sin(2.0 * math.pi * k / 48.0) + 60.0 * math.sin(2.0 * math.pi * k / 250.0)


ACTUALS = tuple(Intensity(START + k * HALF_HOUR, true_g_per_kwh(k)) for k in range(48 * (DAYS + 5)))


def jitter(k: int) -> float:
    """Of forecasts: 30 g/kWh with a sign drawn for every half hour."""
    return 30.0 if random.Random(k).random() < 0.5 else -30.0


def issued(day: int, bias: float = 25.0, noise: float = 0.0) -> Forecast:
    """96 hours from a day's midnight, too high by `bias`."""
    first = 48 * day
    rows = tuple(
        Intensity(START + k * HALF_HOUR, true_g_per_kwh(k) + bias + noise * jitter(1000 * day + k))
        for k in range(first, first + 192)
    )
    return Forecast(START + day * timedelta(days=1), "national", rows)


def error(learned: Learned, now: datetime, hours: int) -> float:
    """Mean absolute error of the outlook over the next `hours`, g/kWh."""
    found = outlook.extend(None, (), now, now + timedelta(hours=hours), learned).slots
    first = (now - START) // HALF_HOUR
    return sum(abs(slot.g_per_kwh - true_g_per_kwh(first + k)) for k, slot in enumerate(found)) / len(found)


def test_a_bias_that_persists_is_taken_off() -> None:
    forecasts = tuple(issued(day) for day in range(DAYS))
    assert error(replayed(forecasts, ACTUALS, NOW), NOW, 48) < 8.0


def test_what_forecasts_say_within_the_day_counts_as_far_as_it_came_true() -> None:
    good = replayed(tuple(issued(day) for day in range(DAYS)), ACTUALS, NOW)
    poor = replayed(tuple(issued(day, noise=1.0) for day in range(DAYS)), ACTUALS, NOW)
    assert all(fast > 0.4 for _, fast, _ in good.weights())
    assert all(fast < 0.35 for _, fast, _ in poor.weights())
    assert all(0.9 < slow < 1.1 for slow, _, _ in poor.weights())
    assert error(poor, NOW, 48) < 12.0


def test_thin_evidence_changes_little_and_none_nothing() -> None:
    forecast = issued(0, bias=60.0)
    now = START + timedelta(hours=1)
    found = outlook.extend(forecast, (), now, now + timedelta(hours=24), Learned())
    assert {slot.source for slot in found.slots} == {SlotSource.NESO}
    assert [slot.g_per_kwh for slot in found.slots] == [row.g_per_kwh for row in forecast.expected[2:50]]


def test_it_is_the_same_however_it_was_fed() -> None:
    """Every half hour with all that is known, as the daemon does, or at the moments that matter with what is new."""
    forecasts = tuple(issued(day) for day in range(4))
    now = START + timedelta(days=3, hours=20)
    learned = Learned()
    for k in range(1, 48 * 4 - 7):
        moment = START + k * HALF_HOUR
        known = tuple(value for value in ACTUALS if value.start + HALF_HOUR + LATE <= moment)
        learned = learned.advanced(moment, [f for f in forecasts if f.issued_at <= moment][-1:], known)
    assert error(learned, now, 48) == pytest.approx(error(replayed(forecasts, ACTUALS, now), now, 48), abs=2.0)
    assert learned == learned.advanced(now, forecasts, known)


def test_nothing_later_is_touched() -> None:
    """Later values are poisoned: they may not change a number, and no number may turn into none."""
    now = NOW - timedelta(days=3, hours=-4)
    forecasts = tuple(issued(day) for day in range(DAYS))
    nan = math.nan
    actuals = tuple(v if v.start + HALF_HOUR + LATE <= now else replace(v, g_per_kwh=nan) for v in ACTUALS)
    poisoned = tuple(
        f if f.issued_at <= now else replace(f, expected=tuple(replace(row, g_per_kwh=nan) for row in f.expected))
        for f in forecasts
    )
    until = now + timedelta(hours=100)
    found = outlook.extend(None, (), now, until, replayed(poisoned, actuals, now))
    assert found == outlook.extend(None, (), now, until, replayed(forecasts, ACTUALS, now))
    assert all(math.isfinite(slot.g_per_kwh) and math.isfinite(slot.sd_g_per_kwh) for slot in found.slots)


def test_a_measured_value_that_is_revised_counts_as_it_was_last_published() -> None:
    now = START + timedelta(hours=30)
    known = tuple(value for value in ACTUALS if value.start < now - LATE)
    revised = (*known[:-1], replace(known[-1], g_per_kwh=known[-1].g_per_kwh + 80.0))
    learned = Learned().advanced(now, (issued(0, 0.0),), known)
    again = learned.advanced(now, (), revised)
    (before,), (after,) = (outlook.extend(None, (), now, now + HALF_HOUR, x).slots for x in (learned, again))
    assert after.g_per_kwh > before.g_per_kwh + 1.0
    assert again.advanced(now, (), known) == learned


def test_a_measured_value_of_another_order_of_magnitude_is_left_out() -> None:
    known = ACTUALS[: 48 * DAYS - 3]
    learned = Learned().advanced(NOW, (), known)
    wrong = (*known[:-1], replace(known[-1], g_per_kwh=20.0 * known[-1].g_per_kwh))
    assert Learned().advanced(NOW, (), wrong).recent == learned.recent[:-1]


def test_many_forecasts_at_once_are_those_one_after_the_other() -> None:
    whole, next_one = issued(0), issued(1)
    holed = replace(next_one, expected=(*next_one.expected[:10], *next_one.expected[20:60]))
    at = (START - datetime(1970, 1, 1, tzinfo=UTC)) // HALF_HOUR
    apart = Learned().with_forecasts(at, (whole,)).with_forecasts(at, (holed,))
    assert Learned().with_forecasts(at, (whole, holed)) == apart
    says = {row.at: row.g_per_kwh for row in apart.said}
    assert says[at + 48 + 15] == whole.expected[48 + 15].g_per_kwh
    assert says[at + 48 + 20] == next_one.expected[20].g_per_kwh
    assert says[at + 48 + 60] == whole.expected[48 + 60].g_per_kwh


def test_it_says_when_the_past_has_grown() -> None:
    known = ACTUALS[48 : 48 * DAYS]
    learned = Learned().advanced(NOW, (), known)
    assert Learned().lacks(known)
    assert not learned.lacks(known[1:])
    assert learned.lacks(ACTUALS[: 48 * DAYS])
    assert not learned.lacks(())


def test_a_region_that_is_nearly_clean_is_believed() -> None:
    clean = replace(issued(0), expected=tuple(replace(row, g_per_kwh=0.0) for row in issued(0).expected))
    found = outlook.extend(clean, (), START, START + timedelta(hours=24), Learned())
    assert {slot.g_per_kwh for slot in found.slots} == {0.0}


def test_the_spread_grows_with_the_lead_and_learns_from_what_came() -> None:
    fresh = [Learned().sd_g_per_kwh(k, 200.0) for k in (0, 20, 60, 100, 180)]
    assert fresh == sorted(fresh)
    learned = replayed(tuple(issued(day) for day in range(DAYS)), ACTUALS, NOW)
    assert learned.sd_g_per_kwh(60, 200.0) < fresh[2]


def test_the_weights_solve_the_normal_equations() -> None:
    rows = [(math.sin(k), math.cos(3 * k), math.sin(5 * k + 1)) for k in range(200)]
    exact = Fit().with_pairs([(x, y, z, 0.9 * x + 0.4 * y - 0.2 * z) for x, y, z in rows])
    assert exact.weights((0.0, 0.0, 0.0), 1e-6) == pytest.approx((0.9, 0.4, -0.2), abs=1e-4)
    assert exact.weights((0.5, 0.5, 0.5), 1e9) == pytest.approx((0.5, 0.5, 0.5), abs=1e-3)
    assert Fit().weights((0.5, 0.6, 0.7), 10.0) == (0.5, 0.6, 0.7)


class Watched(Forecast):
    """A forecast of which it is known whether anybody still holds it."""


def test_a_start_holds_a_page_of_the_kept_forecasts_at_a_time() -> None:
    """Eight weeks of them are 40 MB, and what is once taken for them the daemon keeps for good."""
    days = [issued(day).expected for day in range(4)]
    seen: list[weakref.ref[Watched]] = []
    held: list[int] = []

    def kept() -> Iterator[Forecast]:
        for k in range(48 * 4):
            forecast = Watched(START + k * HALF_HOUR, "national", days[k // 48][k % 48 :][:96])
            seen.append(weakref.ref(forecast))
            held.append(sum(ref() is not None for ref in seen))
            yield forecast

    replayed(kept(), ACTUALS, START + timedelta(days=4))
    assert len(held) == 48 * 4
    assert max(held) <= EVERY + 2
