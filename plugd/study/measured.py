"""The intensity of a simulated world: what was measured, and how wrong the stored one-step forecasts were."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from pathlib import Path

from plugd import series
from plugd.domain import Series
from plugd.errors import UsageError
from plugd.series import IntensitySeries
from plugd.units import HALF_HOUR

NOON, MIDNIGHT = time(12), time(0)
LEAST_G_PER_KWH = 1.0
"""What a relative error is divided by at the least: an intensity of 0 exists."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One value a half hour from `start` on, without a gap. Both series: (T,)."""

    name: str
    start: datetime
    actual: Series
    """Carbon intensity, g/kWh."""
    error: Series
    """Relative error of the one-step forecast, with its sign (paper eq. forecast_errors); 0 where unknown."""

    @property
    def end(self) -> datetime:
        """End of the last half hour."""
        return self.start + len(self.actual) * HALF_HOUR

    def index(self, moment: datetime) -> int:
        """Of the half hour that holds `moment`."""
        return (moment - self.start) // HALF_HOUR

    def slots(self) -> Iterator[datetime]:
        """The start of every half hour."""
        return (self.start + k * HALF_HOUR for k in range(len(self.actual)))


def errors(found: IntensitySeries) -> dict[datetime, float]:
    """Relative errors of the stored forecasts, where both numbers are known."""
    pairs = zip(found.times(), found.actual, found.forecast, strict=True)
    return {at: (f - g) / max(g, LEAST_G_PER_KWH) for at, g, f in pairs if g is not None and f is not None}


def measured(name: str, found: IntensitySeries, error_from: IntensitySeries | None = None) -> Measured:
    """A series as a world: gaps held, with its own errors or those of another year's same half hour.

    Raises UsageError where the series holds no value.
    """
    held = tuple(g or 0.0 for g in found.held().actual)
    own = errors(found)
    if error_from is None:
        return Measured(name, found.start, held, tuple(own.get(at, 0.0) for at in found.times()))
    others = {_of_the_year(at): e for at, e in errors(error_from).items()}
    series_errors = tuple(others.get(_of_the_year(at), 0.0) for at in found.times())
    return Measured(name, found.start, held, series_errors)


def _of_the_year(moment: datetime) -> tuple[int, int, int, int]:
    """Which half hour of the year; the 29th of February is another 28th."""
    day = 28 if (moment.month, moment.day) == (2, 29) else moment.day
    return moment.month, day, moment.hour, moment.minute


def span(found: Measured, year: int | None) -> tuple[datetime, datetime]:
    """From the first noon to the end, of the series or of one year of it. Raises UsageError."""
    start, end = found.start, found.end
    if year is not None:
        start, end = max(start, datetime(year, 1, 1, tzinfo=UTC)), min(end, datetime(year + 1, 1, 1, tzinfo=UTC))
        if start >= end:
            raise UsageError(f"--year {year}: {found.name} goes from {found.start:%Y-%m-%d} to {found.end:%Y-%m-%d}")
    noon = start.replace(hour=12, minute=0)
    return max(noon, start), end


def between(found: Measured, since: date | None, until: date | None) -> tuple[datetime, datetime]:
    """From the noon of one day to the midnight before another, where the series has them. Raises UsageError."""
    start, end = span(found, None)
    if since is not None:
        start = max(start, datetime.combine(since, NOON, UTC))
    if until is not None:
        end = min(end, datetime.combine(until, MIDNIGHT, UTC))
    if start >= end:
        raise UsageError(f"--from, --to: {found.name} goes from {found.start:%Y-%m-%d} to {found.end:%Y-%m-%d}")
    return start, end


def load(path: Path, error_from: Path | None = None) -> Measured:
    """A file as a world. Raises UsageError, naming file, line and remedy."""
    return measured(path.name, series.load(path), None if error_from is None else series.load(error_from))


def load_regions(path: Path, error_from: Path | None = None) -> dict[int, Measured]:
    """Every region of a file as a world, by its id. Raises UsageError."""
    regions = series.load_regions(path)
    other = None if error_from is None else series.load(error_from)
    if None in regions:
        raise UsageError(f"{path}: has no column regionid; give a file with one line per half hour and region")
    return {
        region: measured(f"{path.name}, region {region}", found, other)
        for region, found in sorted((r, f) for r, f in regions.items() if r is not None)
    }
