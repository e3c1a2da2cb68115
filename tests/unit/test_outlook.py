"""One intensity for every half hour, from the forecast where it says something, never from nothing."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd import outlook
from plugd.domain import Forecast, Intensity, SlotSource
from plugd.units import HALF_HOUR, slot_start

NOW = datetime(2023, 1, 2, 12, 10, tzinfo=UTC)
FIRST = slot_start(NOW)


def forecast(*values: float | None, issued: datetime = NOW) -> Forecast:
    rows = [(slot_start(issued) + k * HALF_HOUR, g) for k, g in enumerate(values)]
    return Forecast(issued, "national", tuple(Intensity(start, g) for start, g in rows if g is not None))


def test_a_forecast_counts_for_the_hours_it_covers_however_old_it_is() -> None:
    old = forecast(*range(100, 130), issued=NOW - timedelta(hours=14))
    found = outlook.extend(old, (), NOW, FIRST + timedelta(hours=3))
    assert [s.g_per_kwh for s in found.slots[:2]] == [128, 129]
    assert [s.source for s in found.slots] == [SlotSource.NESO] * 2 + [SlotSource.TAIL] * 4
    assert found.forecast_until == FIRST + timedelta(hours=1)


def test_a_hole_is_filled_and_a_genuine_zero_is_kept() -> None:
    found = outlook.extend(forecast(100.0, None, 0.0), (), NOW, FIRST + timedelta(hours=1.5))
    assert [s.source for s in found.slots] == [SlotSource.NESO, SlotSource.TAIL, SlotSource.NESO]
    assert found.slots[2].g_per_kwh == 0.0
    assert found.slots[1].g_per_kwh == pytest.approx(100.0, abs=10.0)


def test_without_any_forecast_the_usual_day_is_cleanest_at_night() -> None:
    found = outlook.extend(None, (), NOW, FIRST + timedelta(days=1))
    assert found.forecast_until is None
    cleanest, dirtiest = (pick(found.slots, key=lambda s: s.g_per_kwh).start.hour for pick in (min, max))
    assert cleanest in (2, 3)
    assert dirtiest in (17, 18)


def test_own_history_replaces_the_built_in_day() -> None:
    days = tuple(
        Intensity(FIRST - timedelta(days=d) + k * HALF_HOUR, 400.0 if k == 0 else 40.0)
        for d in range(1, 40)
        for k in range(48)
    )
    found = outlook.extend(None, days, NOW, FIRST + timedelta(days=1))
    assert found.slots[0].g_per_kwh == pytest.approx(400.0, rel=0.1)
    assert max(s.g_per_kwh for s in found.slots[1:]) < 60.0


@given(
    values=st.lists(st.none() | st.floats(0, 1000), max_size=100),
    old_h=st.floats(0, 60),
    history=st.lists(st.tuples(st.integers(1, 2000), st.floats(0, 1000)), max_size=50),
    length_h=st.floats(0, 170),
)
def test_every_half_hour_has_one_number(
    values: list[float | None], old_h: float, history: list[tuple[int, float]], length_h: float
) -> None:
    seen = tuple(Intensity(FIRST - k * HALF_HOUR, g) for k, g in history)
    until = NOW + timedelta(hours=length_h)
    issued = forecast(*values, issued=NOW - timedelta(hours=old_h))
    found = outlook.extend(issued, seen, NOW, until)
    starts = [s.start for s in found.slots]
    assert starts == [FIRST + k * HALF_HOUR for k in range(len(starts))]
    assert not starts or starts[-1] + HALF_HOUR >= until
    assert all(0.0 <= s.g_per_kwh <= 2000.0 and s.sd_g_per_kwh >= 0.0 for s in found.slots)
    told = {row.start: row.g_per_kwh for row in issued.expected}
    assert all(s.g_per_kwh == told[s.start] for s in found.slots if s.source is SlotSource.NESO)
    assert {s.start for s in found.slots if s.source is SlotSource.TAIL}.isdisjoint(told)
