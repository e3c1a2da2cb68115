"""Forecasts as they were really issued, replayed: what could be known at a moment, and no more.

A file has the columns `issued,lead_h,forecast,actual`, one zone a file, one line an hour ahead. A forecast is visible
from its stamp on, an actual one hour after its hour is over. Beyond the forecast's end the outlook is the daemon's own.
"""

import csv
import gzip
import math
import zlib
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from io import TextIOWrapper
from pathlib import Path
from typing import TextIO

from plugd import outlook
from plugd.domain import Forecast, Intensity, Series
from plugd.errors import UsageError
from plugd.outlook import Learned, moments
from plugd.past import HISTORY
from plugd.study.measured import Measured
from plugd.units import HALF_HOUR, require_utc, slot_start

HOUR = timedelta(hours=1)
LATE = timedelta(hours=1)
"""From an hour's end until its actual is visible."""
LONGEST = timedelta(days=40 * 366)
COLUMNS = ("issued", "lead_h", "forecast", "actual")


@dataclass(frozen=True, slots=True)
class Issues:
    """One zone's forecasts with what came true. Everything a replay needs, in values that travel to any worker."""

    found: Measured
    """What came true, half-hourly."""
    issued: tuple[datetime, ...]
    """When each forecast was issued, in order."""
    expected: tuple[Series, ...] = field(repr=False)
    """What each said of its half hours, the first of which begins at its stamp; NaN where it said nothing."""


class Replayed:
    """What was known at each moment, and the daemon's own outlook from it. Implements `Forecasts`.

    It is asked about moments in order, and gives what it learned no value before that was published. Without
    `corrected` the last forecast counts as it is.
    """

    def __init__(self, issues: Issues, *, corrected: bool = True) -> None:
        self._issues, self._corrected = issues, corrected
        found = issues.found
        self._actual = tuple(Intensity(at, g) for at, g in zip(found.slots(), found.actual, strict=True))
        self._learned = Learned()
        self._at = issues.issued[0]
        self._told = self._published = 0
        """How many of the forecasts and of the actuals have been given to it."""

    def expected(self, now: datetime, slots: Sequence[datetime]) -> list[float]:
        """See Forecasts. What the daemon would expect."""
        if self._corrected:
            for moment in moments(self._at, now):
                self._learn(moment)
            self._at = now
        until = max(slots) + HALF_HOUR
        if self._corrected:
            extended = outlook.extend(None, (), now, until, self._learned)
        else:
            latest = bisect_right(self._issues.issued, now) - 1
            forecast = self._forecast(latest) if latest >= 0 else None
            extended = outlook.extend(forecast, self.history(now), now, until)
        known = {slot.start: slot.g_per_kwh for slot in extended.slots}
        return [known[at] for at in slots]

    def history(self, now: datetime) -> tuple[Intensity, ...]:
        """The actuals of the hours that were over an hour ago."""
        return self._actual[max(0, self._issues.found.index(now - HISTORY)) : self._visible(now)]

    def _visible(self, now: datetime) -> int:
        """How many actuals are published: the two halves of an hour appear together."""
        return max(0, self._issues.found.index(slot_start(now - LATE).replace(minute=0)))

    def _learn(self, now: datetime) -> None:
        told, published = bisect_right(self._issues.issued, now), self._visible(now)
        forecasts = [self._forecast(k) for k in range(self._told, told)]
        self._learned = self._learned.advanced(now, forecasts, self._actual[self._published : published])
        self._told, self._published = told, published

    def _forecast(self, k: int) -> Forecast:
        at = self._issues.issued[k]
        rows = (Intensity(at + j * HALF_HOUR, g) for j, g in enumerate(self._issues.expected[k]) if not math.isnan(g))
        return Forecast(at, self._issues.found.name, tuple(rows))


def lines(path: Path, columns: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """The numbered lines of a .csv or .csv.gz file that has these columns. Raises UsageError."""
    try:
        with _open(path) as text:
            reader = csv.DictReader(text)
            if missing := [name for name in columns if name not in (reader.fieldnames or ())]:
                raise UsageError(f"{path}: line 1: has no column {missing[0]}; give {','.join(COLUMNS)}")
            for line in reader:
                yield reader.line_num, line
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: cannot be read ({reason}); give a .csv or .csv.gz file") from error


def _open(path: Path) -> TextIO:
    """The file's text; the caller closes it."""
    if path.suffix == ".gz":
        return TextIOWrapper(gzip.GzipFile(path), encoding="utf-8-sig", newline="")
    return path.open(encoding="utf-8-sig", newline="")


def numbers(path: Path, number: int, line: dict[str, str]) -> tuple[int, float, float]:
    """(lead in hours, forecast, actual) of a line. Raises UsageError."""
    try:
        lead_h, forecast, actual = int(line["lead_h"]), float(line["forecast"]), float(line["actual"])
    except (TypeError, ValueError) as error:
        raise UsageError(f"{path}: line {number}: {error}; complete or delete the line") from error
    if not (math.isfinite(forecast) and math.isfinite(actual)):
        raise UsageError(f"{path}: line {number}: no number; complete or delete the line")
    return lead_h, forecast, actual


def load(path: Path) -> Issues:
    """A file of issued forecasts. Gaps in what came true hold the last value. Raises UsageError."""
    forecasts: dict[datetime, dict[int, float]] = {}
    came: dict[datetime, float] = {}
    for number, line in lines(path, COLUMNS):
        lead_h, forecast, actual = numbers(path, number, line)
        at = _stamp(path, number, line["issued"])
        if lead_h < 0:
            raise UsageError(f"{path}: line {number}: lead_h {lead_h} is over; delete the line")
        forecasts.setdefault(at, {})[lead_h] = forecast
        came[at + lead_h * HOUR] = actual
    if not came:
        raise UsageError(f"{path}: holds no forecasts; give {','.join(COLUMNS)}")
    first, last = min(came), max(came)
    if last - first > LONGEST:
        raise UsageError(f"{path}: from {first:%Y-%m-%d} to {last:%Y-%m-%d} is too long; mend the wrong one")
    hours = [came.get(first + k * HOUR, math.nan) for k in range((last - first) // HOUR + 1)]
    actual_series: list[float] = []
    for value in hours:
        actual_series += 2 * ([value] if not math.isnan(value) else actual_series[-1:])
    issued = tuple(sorted(forecasts))
    return Issues(
        Measured(path.name, first, tuple(actual_series), (0.0,) * len(actual_series)),
        issued,
        tuple(_held(forecasts[at]) for at in issued),
    )


def _held(forecast: dict[int, float]) -> Series:
    """Half hours from hours."""
    return tuple(forecast.get(lead_h, math.nan) for lead_h in range(max(forecast) + 1) for _ in range(2))


def _stamp(path: Path, number: int, text: str) -> datetime:
    try:
        moment = require_utc(datetime.fromisoformat(text))
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{path}: line {number}: {text!r} is not a time; write 2021-07-01T00:00Z") from error
    if moment != moment.replace(minute=0, second=0, microsecond=0):
        raise UsageError(f"{path}: line {number}: {text!r} is not a whole hour; write 2021-07-01T00:00Z")
    return moment
