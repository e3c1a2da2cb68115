"""Intensity series from files: columns, gaps, hours held for both halves, and errors that say where."""

import gzip
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from plugd.errors import UsageError
from plugd.series import IntensitySeries, load, load_regions
from plugd.units import HALF_HOUR

T0 = datetime(2023, 1, 31, 18, 0, tzinfo=UTC)


def written(folder: Path, text: str, name: str = "series.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_half_hourly_rows_are_looked_up_by_the_moment_they_hold(tmp_path: Path) -> None:
    path = written(tmp_path, "from,forecast,actual\n2023-01-31T18:00Z,110,100\n2023-01-31T18:30Z,130,120.5\n")
    series = load(path)
    assert series.start == T0
    assert series.end == T0 + 2 * HALF_HOUR
    assert series.actual_at(T0 + timedelta(minutes=29)) == 100.0
    assert series.actual_at(T0 + HALF_HOUR) == 120.5
    assert series.forecast_at(T0) == 110.0
    assert series.actual_at(T0 - timedelta(seconds=1)) is None
    assert series.actual_at(series.end) is None


def test_missing_and_empty_half_hours_stay_missing_and_a_zero_stays_zero(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "from,actual\n2023-01-31T18:00Z,0\n2023-01-31T18:30Z,\n2023-01-31T19:30Z,null\n2023-01-31T20:00Z,90\n",
    )
    assert load(path).actual == (0.0, None, None, None, 90.0)


def test_hours_are_held_for_both_halves(tmp_path: Path) -> None:
    path = written(tmp_path, "from,actual\n2023-01-31T18:00Z,100\n2023-01-31T20:00Z,200\n")
    assert load(path).actual == (100.0, 100.0, None, None, 200.0, 200.0)


def test_rows_may_be_unsorted_and_of_two_for_one_half_hour_the_last_counts(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "actual,from\n3,2023-01-31T19:00Z\n1,2023-01-31T18:00Z\n2,2023-01-31T18:30Z\n4,2023-01-31T18:00Z\n",
    )
    assert load(path).actual == (4.0, 2.0, 3.0)


def test_other_offsets_become_utc(tmp_path: Path) -> None:
    path = written(tmp_path, "from,actual\n2023-01-31T19:00+01:00,100\n2023-01-31T18:30:00Z,120\n")
    assert load(path).start == T0


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("DATETIME,GAS,CARBON_INTENSITY,LOW_CARBON", "2023-01-31T18:00:00,12000,100,9000"),
        ("DATETIME,GAS,CARBON_INTENSITY,LOW_CARBON", "2023-01-31 18:00:00,12000,100,9000"),
        (
            "Datetime (UTC),Actual Carbon Intensity (gCO2/kWh),Forecast Carbon Intensity (gCO2/kWh),Index",
            "2023-01-31T18:00Z,100,90,low",
        ),
    ],
)
def test_nesos_own_downloads_are_understood(tmp_path: Path, header: str, row: str) -> None:
    series = load(written(tmp_path, f"\ufeff{header}\n{row}\n"))
    assert series.start == T0
    assert series.actual[0] == 100.0
    assert series.forecast[0] == (90.0 if "Forecast" in header else None)


def test_a_packed_file_is_read_like_the_plain_one(tmp_path: Path) -> None:
    text = "from,actual\n2023-01-31T18:00Z,100\n2023-01-31T18:30Z,120\n"
    packed = tmp_path / "series.csv.gz"
    packed.write_bytes(gzip.compress(text.encode()))
    assert load(packed) == load(written(tmp_path, text))


def test_regions_are_told_apart_and_one_must_be_chosen(tmp_path: Path) -> None:
    path = written(tmp_path, "from,regionid,forecast\n2023-01-31T18:00Z,1,0\n2023-01-31T18:00Z,13,150\n")
    assert load_regions(path).keys() == {1, 13}
    assert load(path, 1).forecast[0] == 0.0
    with pytest.raises(UsageError, match="several regions; choose one of: 1, 13"):
        load(path)
    with pytest.raises(UsageError, match="no region 5; choose one of: 1, 13"):
        load(path, 5)


def test_held_fills_gaps_with_the_last_value_and_the_beginning_with_the_first() -> None:
    series = IntensitySeries(T0, (None, 100.0, None, None, 0.0, None), (50.0,) * 6)
    assert series.held().actual == (100.0, 100.0, 100.0, 100.0, 0.0, 0.0)
    assert series.held().forecast == series.forecast


def test_held_takes_the_forecast_where_a_region_has_no_actual() -> None:
    assert IntensitySeries(T0, (None, None), (80.0, None)).held().actual == (80.0, 80.0)
    with pytest.raises(UsageError, match="holds no value"):
        IntensitySeries(T0, (None,), (None,)).held()


def test_expected_is_the_forecast_or_else_the_actual() -> None:
    series = IntensitySeries(T0, (100.0, 90.0, None), (None, 0.0, None))
    assert [series.expected_at(moment) for moment in series.times()] == [100.0, 0.0, None]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "line 1: needs the columns"),
        ("from,price\n2023-01-31T18:00Z,3\n", "line 1: needs the columns"),
        ("from,actual\n", "holds no rows"),
        ("from,actual,actual\n2023-01-31T18:00Z,3,4\n", "line 1: two columns hold 'actual'"),
        ("from,actual\n2023-01-31T18:00Z,3\nnow,4\n", "line 3, column from: 'now' is not a time"),
        ("from,actual\n2023-01-31T18:00,3\n", "line 2, column from: '2023-01-31T18:00' has no time zone"),
        ("from,actual\n2023-01-31T18:10Z,3\n", "line 2, column from: .* does not begin a half hour"),
        ("from,actual\n2023-01-31T18:00Z,much\n", "line 2, column actual: 'much' is no number"),
        ("from,actual\n2023-01-31T18:00Z,-3\n", "line 2, column actual: '-3' is no number"),
        ("from,actual\n2023-01-31T18:00Z,1e999\n", "line 2, column actual: '1e999' is no number"),
        ("from,actual\n2023-01-31T18:00Z\n", "line 2: 1 of 2 columns"),
        ("from,regionid,actual\n2023-01-31T18:00Z,north,3\n", "line 2, column regionid: 'north'"),
        ("from,actual\n0023-01-31T18:00Z,1\n2023-01-31T18:00Z,1\n", "is too long"),
        ("from,actual\n0001-01-01T00:00+05:00,1\n", "line 2, column from: .* out of range"),
    ],
)
def test_an_unusable_file_is_told_by_name_line_and_column(tmp_path: Path, text: str, says: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UsageError, match=says) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv.gz", b"from,actual\n"),
        ("b.csv.gz", gzip.compress(b"from,actual\n" * 99, mtime=0)[:-20]),
        ("c.csv", b"\xff\xfe\x00"),
    ],
)
def test_a_file_that_is_not_text_is_told(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(UsageError, match=name):
        load(path)


def test_a_missing_file_and_a_folder_are_told(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(UsageError, match="cannot be read"):
            load(path)


def test_a_series_off_the_grid_or_of_two_lengths_cannot_be() -> None:
    with pytest.raises(ValueError, match="half-hour grid"):
        IntensitySeries(T0 + timedelta(minutes=1), (1.0,), (1.0,))
    with pytest.raises(ValueError, match="1 actual and 2 forecast"):
        IntensitySeries(T0, (1.0,), (1.0, 2.0))
