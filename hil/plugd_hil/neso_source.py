"""What the stub NESO server tells: a series of intensity with forecast errors, or recorded forecasts."""

import math
import random
import re
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path
from typing import Protocol

from plugd.errors import UsageError
from plugd.series import IntensitySeries, load, load_regions
from plugd.units import HALF_HOUR, iso, slot_start

HORIZON = timedelta(hours=48)
ACTUAL_AFTER = timedelta(minutes=60)
"""From the end of a half hour until its measured value appears."""
ERROR_KEPT = 0.97
"""Of a forecast's relative error, from one half hour to the next."""
ERROR_AT_HORIZON = 0.2
"""Standard deviation of the relative error at 48 h."""
_STEPS = HORIZON // HALF_HOUR
_NEWS = ERROR_AT_HORIZON * math.sqrt((1.0 - ERROR_KEPT**2) / (1.0 - ERROR_KEPT ** (2 * _STEPS)))
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Row:
    """One half hour as the server knows it."""

    start: datetime
    forecast: float | None
    actual: float | None


class Source(Protocol):
    """Where rows come from. Region None is the whole country."""

    def knows(self, region: int | None) -> bool:
        """Whether there are rows of this region."""

    def row(self, region: int | None, start: datetime, now: datetime) -> Row | None:
        """What is told at `now` about the half hour from `start` on; None: nothing."""

    def span(self) -> tuple[datetime, datetime]:
        """From when to when there is something to tell at all."""


@lru_cache(maxsize=8192)
def _news(seed: str, step: int) -> float:
    """What becomes known in one half hour about all that follow, as a relative change of them."""
    return random.Random(f"{seed}/{step}").gauss(0.0, _NEWS)


def forecast_error(seed: str, issued: datetime, start: datetime) -> float:
    """Relative error of the forecast for the half hour `start`, issued in the half hour `issued`.

    A first-order autoregressive process along the leads of one issue: 0 for the half hour under way, kept by
    0.97 from one to the next, standard deviation 0.2 at 48 h. Its innovations belong to half hours of the
    calendar, not to issues: the next issue has the same error less what has become known since, as real ones.
    """
    first, last = (slot_start(issued) - EPOCH) // HALF_HOUR, (start - EPOCH) // HALF_HOUR
    error = 0.0
    for step in range(first + 1, last + 1):
        error = ERROR_KEPT * error + _news(seed, step)
    return error


@dataclass(frozen=True, slots=True)
class SeriesSource:
    """Forecasts made of a series: its forecast (its actual where there is none) with an error that grows."""

    regions: Mapping[int | None, IntensitySeries]
    """A series by region; None stands in for every region not named."""
    seed: int = 0

    def knows(self, region: int | None) -> bool:
        """Every region, where there is a national series."""
        return region in self.regions or None in self.regions

    def row(self, region: int | None, start: datetime, now: datetime) -> Row | None:
        """A half hour missing in the series stays missing."""
        series = self.regions.get(region, self.regions.get(None))
        if series is None or start >= slot_start(now) + HORIZON:
            return None
        expected = series.expected_at(start)
        if expected is None:
            return None
        error = forecast_error(f"{self.seed}/{region}", now, start)
        told = region is None and start + HALF_HOUR + ACTUAL_AFTER <= now
        return Row(start, max(0.0, expected * (1.0 + error)), series.actual_at(start) if told else None)

    def span(self) -> tuple[datetime, datetime]:
        """The series' own."""
        return (min(s.start for s in self.regions.values()), max(s.end for s in self.regions.values()))


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A forecast as it was once recorded."""

    stamp: datetime
    regions: Mapping[int | None, IntensitySeries]


@dataclass(frozen=True, slots=True)
class Replay:
    """Recorded forecasts: always the newest not younger than now. A short list stays short."""

    snapshots: tuple[Snapshot, ...]
    """Sorted by stamp."""

    def knows(self, region: int | None) -> bool:
        """Whether any snapshot has it."""
        return any(region in snapshot.regions for snapshot in self.snapshots)

    def row(self, region: int | None, start: datetime, now: datetime) -> Row | None:
        """From the newest snapshot that has this region."""
        of_region = [snapshot for snapshot in self.snapshots if region in snapshot.regions]
        k = bisect_right([snapshot.stamp for snapshot in of_region], now)
        forecast = of_region[k - 1].regions[region].expected_at(start) if k else None
        return None if forecast is None else Row(start, forecast, None)

    def span(self) -> tuple[datetime, datetime]:
        """From the first stamp to the end of the newest one's rows."""
        return self.snapshots[0].stamp, max(series.end for series in self.snapshots[-1].regions.values())


@dataclass(frozen=True, slots=True)
class Shifted:
    """Another source, later by `shift`."""

    source: Source
    shift: timedelta

    def knows(self, region: int | None) -> bool:
        """As the other."""
        return self.source.knows(region)

    def row(self, region: int | None, start: datetime, now: datetime) -> Row | None:
        """The other's row, moved."""
        row = self.source.row(region, start - self.shift, now - self.shift)
        return None if row is None else replace(row, start=start)

    def span(self) -> tuple[datetime, datetime]:
        """The other's, moved."""
        first, last = self.source.span()
        return first + self.shift, last + self.shift


def shift_to(span: tuple[datetime, datetime], now: datetime) -> timedelta:
    """How much later a source must be told to have something to say at `now`.

    Nothing where it already has; else whole years of 52 weeks, else whole weeks, so that time of day and
    weekday agree; else, for a record of a few days on another weekday, whole days.
    """
    first, last = span
    if first <= now < last:
        return timedelta(0)
    for step in (timedelta(weeks=52), timedelta(weeks=1), timedelta(days=1)):
        shift = (now - first) // step * step
        if first <= now - shift < last:
            return shift
    raise UsageError(f"the source, {iso(first)} to {iso(last)}, is under a day; give a longer one")


def from_file(path: Path, seed: int) -> SeriesSource:
    """A CSV file as a source. Raises UsageError."""
    return SeriesSource(load_regions(path), seed)


def from_folder(folder: Path) -> Replay:
    """Recorded forecasts `<stamp>.csv`, `regional_<stamp>.csv`, as 2023-03-14T0331Z. Raises UsageError."""
    snapshots = []
    for path in sorted(folder.glob("*.csv")):
        match = re.fullmatch(r"(regional_)?(\d{4}-\d\d-\d\dT\d{4})Z", path.stem)
        if match is None:
            continue
        stamp = datetime.strptime(match[2], "%Y-%m-%dT%H%M").replace(tzinfo=UTC)
        snapshots.append(Snapshot(stamp, load_regions(path) if match[1] else {None: load(path)}))
    if not snapshots:
        raise UsageError(f"{folder}: holds no recorded forecast; they are named like 2023-03-14T0331Z.csv")
    return Replay(tuple(sorted(snapshots, key=lambda snapshot: snapshot.stamp)))
