"""Answers off by a factor are doubted; the grid's real swings never are."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from plugd import series
from plugd.domain import Forecast, Intensity
from plugd.errors import ForecastMalformed
from plugd.plausible import believed, doubt
from plugd.units import HALF_HOUR

START = datetime(2023, 1, 2, tzinfo=UTC)
USUAL = tuple(Intensity(START + k * HALF_HOUR, 150.0 + 60.0 * (k % 48 > 32)) for k in range(56 * 48))


def flat(level: float, start: datetime = USUAL[-1].start + HALF_HOUR) -> list[Intensity]:
    return [Intensity(start + k * HALF_HOUR, level) for k in range(96)]


@pytest.mark.parametrize(
    ("level", "believable"),
    [(200.0, True), (60.0, True), (500.0, False), (1500.0, False), (650.0, False), (15.0, False), (0.0, False)],
)
@pytest.mark.parametrize("late_h", [0.0, 30.0])
def test_an_answer_out_by_a_factor_is_doubted(level: float, late_h: float, believable: bool) -> None:
    told = flat(level, USUAL[-1].start + HALF_HOUR + timedelta(hours=late_h))
    assert (doubt(told, USUAL) is None) is believable


@pytest.mark.parametrize(("before", "after", "believable"), [(30.0, 300.0, False), (30.0, 120.0, True), (3, 35, True)])
def test_a_windy_day_ten_times_too_high_is_a_jump(before: float, after: float, believable: bool) -> None:
    """Within what was seen in these weeks, but not right after so little."""
    history = (*USUAL[:-96], *(replace(row, g_per_kwh=before) for row in USUAL[-96:]))
    assert (doubt(flat(after), history) is None) is believable
    later = flat(after, USUAL[-1].start + timedelta(hours=9))
    assert doubt(later, history) is None


def test_where_zero_is_nothing_rare_nothing_is_too_low_and_one_that_is_a_glitch_changes_nothing() -> None:
    often = tuple(replace(row, g_per_kwh=0.0) if k % 7 == 0 else row for k, row in enumerate(USUAL))
    later = USUAL[-1].start + timedelta(hours=9)
    assert doubt(flat(0.0, later), often) is None
    once = (*USUAL[:-1], replace(USUAL[-1], g_per_kwh=0.0))
    assert doubt(flat(15.0, later), once) is not None


@pytest.mark.parametrize(("level", "believable"), [(20.0, True), (370.0, True), (900.0, False)])
def test_without_history_only_far_too_much_is_told(level: float, believable: bool) -> None:
    assert (doubt(flat(level), ()) is None) is believable


def test_it_is_said_in_one_line_and_nothing_at_all_is_not_doubted() -> None:
    with pytest.raises(ForecastMalformed, match=r"is not used: it says 900 g/kWh, right after 210$"):
        believed(Forecast(START, "national", tuple(flat(900.0))), USUAL)
    assert doubt([], USUAL) is None


@pytest.mark.parametrize(("days", "believable"), [(0, True), (1, True), (3652, False)])
def test_an_answer_that_is_over_already_says_that_the_clock_may_be_wrong(days: int, believable: bool) -> None:
    here = USUAL[-1].start + HALF_HOUR + timedelta(days=days)
    forecast = Forecast(here, "national", tuple(flat(200.0)))
    if believable:
        assert believed(forecast, USUAL) is forecast
        return
    with pytest.raises(ForecastMalformed, match=r"it ends on 2023-02-28 at 23:30 UTC.*is the clock right\?"):
        believed(forecast, USUAL)


def test_no_48_hours_of_four_years_of_gb_are_doubted_and_ten_times_or_a_tenth_of_them_always(neso_data: Path) -> None:
    actual = series.load(neso_data / "gb_actual_hourly_2020_2023.csv").held()
    rows = tuple(
        Intensity(at, value) for at, value in zip(actual.times(), actual.actual, strict=True) if value is not None
    )
    weeks, days, unpublished = 56 * 48, 2 * 48, 3
    for k in range(weeks, len(rows) - days, 389):
        history, coming = rows[k - weeks : k - unpublished], rows[k : k + days]
        assert doubt(coming, history) is None, rows[k].start
        for factor in (10.0, 0.1):
            assert doubt([replace(row, g_per_kwh=factor * row.g_per_kwh) for row in coming], history) is not None
