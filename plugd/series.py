"""Recorded carbon intensity from CSV files, on the half-hour grid.

Columns, in any order: `from` (ISO 8601, Z), `actual` or `forecast` or both, `regionid` for several regions;
or as NESO's own downloads name them. Hourly files are held for both halves. What is missing stays missing.
"""

import csv
import gzip
import math
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from io import TextIOWrapper
from itertools import accumulate
from pathlib import Path
from typing import TextIO

from plugd.errors import UsageError
from plugd.units import HALF_HOUR, require_utc, slot_start

Values = tuple[float | None, ...]

COLUMNS = {
    "from": "from",
    "actual": "actual",
    "forecast": "forecast",
    "regionid": "regionid",
    # historic generation mix
    "datetime": "from utc",
    "carbon_intensity": "actual",
    # carbon intensity dashboard
    "datetime (utc)": "from utc",
    "actual carbon intensity (gco2/kwh)": "actual",
    "forecast carbon intensity (gco2/kwh)": "forecast",
}
"""Column names in lower case, and what they hold. `from utc` may lack its time zone: NESO's are in UTC."""

NO_VALUE = ("", "null", "none", "nan", "na", "n/a")
MOST_G_PER_KWH = 2000.0
LONGEST = timedelta(days=40 * 366)


@dataclass(frozen=True, slots=True)
class IntensitySeries:
    """Carbon intensity per half hour from `start` on, in g/kWh; None where it is missing."""

    start: datetime
    actual: Values
    forecast: Values

    def __post_init__(self) -> None:
        if slot_start(self.start) != self.start:
            raise ValueError(f"{self.start.isoformat()} is not on the half-hour grid")
        if len(self.actual) != len(self.forecast):
            raise ValueError(f"{len(self.actual)} actual and {len(self.forecast)} forecast values")

    @property
    def end(self) -> datetime:
        """End of the last half hour."""
        return self.start + len(self.actual) * HALF_HOUR

    def times(self) -> Iterator[datetime]:
        """The start of every half hour."""
        return (self.start + k * HALF_HOUR for k in range(len(self.actual)))

    def actual_at(self, moment: datetime) -> float | None:
        """What was measured in the half hour that holds `moment`; None where missing or outside."""
        k = self._index(moment)
        return None if k is None else self.actual[k]

    def forecast_at(self, moment: datetime) -> float | None:
        """What was forecast for the half hour that holds `moment`; None where missing or outside."""
        k = self._index(moment)
        return None if k is None else self.forecast[k]

    def expected_at(self, moment: datetime) -> float | None:
        """The forecast, or what was measured where there is none."""
        k = self._index(moment)
        if k is None:
            return None
        value = self.forecast[k]
        return self.actual[k] if value is None else value

    def held(self) -> "IntensitySeries":
        """The same with an actual in every half hour: a gap holds the last one, the beginning the first.

        A series without any actual (the regions have none) takes its forecasts for them.
        Raises UsageError where there is no value at all.
        """
        known = self.actual if any(value is not None for value in self.actual) else self.forecast
        first = next((value for value in known if value is not None), None)
        if first is None:
            raise UsageError("the intensity series holds no value; fill in actual or forecast")
        filled = accumulate(known, lambda last, value: last if value is None else value, initial=first)
        return replace(self, actual=tuple(filled)[1:])

    def _index(self, moment: datetime) -> int | None:
        k = (require_utc(moment) - self.start) // HALF_HOUR
        return k if 0 <= k < len(self.actual) else None


@dataclass(frozen=True, slots=True)
class _Row:
    start: datetime
    actual: float | None
    forecast: float | None
    region: int | None


def load(path: Path, region_id: int | None = None) -> IntensitySeries:
    """The series in a .csv or .csv.gz file; of one region where the file has several.

    Raises UsageError, naming file, line, column and remedy.
    """
    regions = load_regions(path)
    if region_id is None and len(regions) == 1:
        return next(iter(regions.values()))
    if region_id in regions:
        return regions[region_id]
    names = ", ".join("without regionid" if name is None else str(name) for name in regions)
    asked = "several regions" if region_id is None else f"no region {region_id}"
    raise UsageError(f"{path}: the file has {asked}; choose one of: {names}")


def load_regions(path: Path) -> dict[int | None, IntensitySeries]:
    """Every region's series by its id; a file without `regionid` has one, under None. Raises UsageError."""
    rows: dict[int | None, list[_Row]] = {}
    try:
        with _open(path) as lines:
            for row in _rows(path, lines):
                rows.setdefault(row.region, []).append(row)
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: cannot be read ({reason}); give a .csv or .csv.gz file") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: is not UTF-8 text; give a .csv or .csv.gz file") from error
    except csv.Error as error:
        raise UsageError(f"{path}: is not a CSV file ({error}); give a .csv or .csv.gz file") from error
    if not rows:
        raise UsageError(f"{path}: holds no rows; give a file with one line a half hour")
    return {region: _series(path, found) for region, found in rows.items()}


def _open(path: Path) -> TextIO:
    """The file's text; the caller closes it."""
    if path.suffix == ".gz":
        return TextIOWrapper(gzip.GzipFile(path), encoding="utf-8-sig", newline="")
    return path.open(encoding="utf-8-sig", newline="")


def _rows(path: Path, lines: Iterable[str]) -> Iterator[_Row]:
    reader = csv.reader(lines)
    header = next(reader, [])
    columns = _columns(path, header)
    for cells in reader:
        if not any(cell.strip() for cell in cells):
            continue
        place = f"{path}: line {reader.line_num}"
        if len(cells) < len(header):
            raise UsageError(f"{place}: {len(cells)} of {len(header)} columns; complete or delete the line")
        found = {kind: cells[k].strip() for kind, k in columns.items()}
        name, text = ("from", found["from"]) if "from" in found else ("from utc", found["from utc"])
        yield _Row(
            start=_time(f"{place}, column {header[columns[name]]}", text, naive_is_utc=name == "from utc"),
            actual=_value(f"{place}, column actual", found.get("actual", "")),
            forecast=_value(f"{place}, column forecast", found.get("forecast", "")),
            region=_region(f"{place}, column regionid", found["regionid"]) if "regionid" in found else None,
        )


def _columns(path: Path, header: list[str]) -> dict[str, int]:
    """Which column holds what."""
    columns: dict[str, int] = {}
    for k, name in enumerate(header):
        kind = COLUMNS.get(name.strip().lower())
        if kind is not None and columns.setdefault(kind, k) != k:
            raise UsageError(f"{path}: line 1: two columns hold {kind!r}; delete one of them")
    if not columns.keys() & {"from", "from utc"} or not columns.keys() & {"actual", "forecast"}:
        raise UsageError(f"{path}: line 1: needs the columns `from` and `actual` or `forecast`")
    return columns


def _time(place: str, text: str, *, naive_is_utc: bool) -> datetime:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise UsageError(f"{place}: {text!r} is not a time; write it as 2023-01-31T18:30Z") from error
    if moment.tzinfo is None:
        if not naive_is_utc:
            raise UsageError(f"{place}: {text!r} has no time zone; write it as 2023-01-31T18:30Z")
        moment = moment.replace(tzinfo=UTC)
    try:
        moment = require_utc(moment)
    except OverflowError as error:
        raise UsageError(f"{place}: {text!r} is out of range; write it as 2023-01-31T18:30Z") from error
    if slot_start(moment) != moment:
        raise UsageError(f"{place}: {text!r} does not begin a half hour; give an hourly or half-hourly file")
    return moment


def _value(place: str, text: str) -> float | None:
    """A number, None where there is none."""
    if text.lower() in NO_VALUE:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= MOST_G_PER_KWH:
        raise UsageError(f"{place}: {text!r} is no number of g/kWh from 0 to 2000; leave it empty if unknown")
    return value


def _region(place: str, text: str) -> int:
    try:
        return int(text)
    except ValueError as error:
        raise UsageError(f"{place}: {text!r} is not a region's number; NESO's are 1 to 18") from error


def _series(path: Path, rows: list[_Row]) -> IntensitySeries:
    """Rows in any order to one value a half hour; of two for the same one the last counts, as in the feed."""
    by_start = {row.start: row for row in rows}
    start, last = min(by_start), max(by_start)
    if last - start > LONGEST:
        raise UsageError(f"{path}: from {start:%Y-%m-%d} to {last:%Y-%m-%d} is too long; mend the wrong one")
    if all(moment.minute == 0 for moment in by_start):
        by_start |= {moment + HALF_HOUR: row for moment, row in by_start.items()}
        last += HALF_HOUR
    grid = [by_start.get(start + k * HALF_HOUR) for k in range((last - start) // HALF_HOUR + 1)]
    return IntensitySeries(
        start=start,
        actual=tuple(None if row is None else row.actual for row in grid),
        forecast=tuple(None if row is None else row.forecast for row in grid),
    )
