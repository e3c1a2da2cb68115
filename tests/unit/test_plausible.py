"""Answers off by a factor are doubted; the grid's real swings never are."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from plugd import series
from plugd.domain import Forecast, Intensity
from plugd.errors import ForecastMalformed
from plugd.plausible import believed, doubt
from plugd.units import HALF_HOUR

START = datetime(2023, 1, 2, tzinfo=UTC)
USUAL = tuple(Intensity(START + k * HALF_HOUR, 150.0 + 60.0 * (k % 48 > 32)) for k in range(56 * 48))


@pytest.mark.parametrize(
    ("level", "believable"),
    [(150.0, True), (60.0, True), (400.0, True), (1500.0, False), (650.0, False), (15.0, False), (0.0, False)],
)
def test_an_answer_out_by_a_factor_and_out_of_all_that_was_seen_is_doubted(level: float, believable: bool) -> None:
    assert (doubt([level] * 96, USUAL) is None) is believable


def test_where_zero_is_nothing_rare_nothing_is_too_low_and_one_that_is_a_glitch_changes_nothing() -> None:
    often = tuple(replace(row, g_per_kwh=0.0) if k % 7 == 0 else row for k, row in enumerate(USUAL))
    assert doubt([0.0] * 96, often) is None
    once = (*USUAL[:-1], replace(USUAL[-1], g_per_kwh=0.0))
    assert doubt([15.0] * 96, once) is not None


@pytest.mark.parametrize(("level", "believable"), [(20.0, True), (440.0, True), (900.0, False)])
def test_without_history_only_far_too_much_is_told(level: float, believable: bool) -> None:
    assert (doubt([level] * 96, ()) is None) is believable


def test_it_is_said_in_one_line_and_nothing_at_all_is_not_doubted() -> None:
    tens = Forecast(START, "national", tuple(Intensity(row.start, 900.0) for row in USUAL[:96]))
    with pytest.raises(
        ForecastMalformed, match=r"is not used: it says 900 g/kWh, where 177 is usual and 210 nearly the most"
    ):
        believed(tens, USUAL)
    assert doubt([], USUAL) is None


def test_no_48_hours_of_four_years_of_gb_are_doubted_and_ten_times_or_a_tenth_of_them_always(neso_data: Path) -> None:
    actual = series.load(neso_data / "gb_actual_hourly_2020_2023.csv").held()
    rows = tuple(
        Intensity(at, value) for at, value in zip(actual.times(), actual.actual, strict=True) if value is not None
    )
    weeks, days = 56 * 48, 2 * 48
    for k in range(weeks, len(rows) - days, 389):
        history, coming = rows[k - weeks : k], [row.g_per_kwh for row in rows[k : k + days]]
        assert doubt(coming, history) is None, rows[k].start
        assert doubt([10.0 * value for value in coming], history) is not None
        assert doubt([0.1 * value for value in coming], history) is not None
