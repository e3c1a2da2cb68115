"""Past carbon intensity from the API: into a CSV file, the store, or a study. Polite: a page of 14 days a second."""

import csv
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path

from plugd import daemon
from plugd.adapters.clock import SystemClock
from plugd.adapters.neso import Neso
from plugd.adapters.store import SqliteStore
from plugd.config import Config
from plugd.domain import PastRow
from plugd.errors import ForecastError, ForecastUnavailable, PlugdError, UsageError
from plugd.past import PAUSE, pages
from plugd.ports import Clock
from plugd.series import IntensitySeries
from plugd.units import HALF_HOUR

BASE_URL = "https://api.carbonintensity.org.uk"
RETRIES = (timedelta(seconds=5), timedelta(seconds=20), timedelta(seconds=60))
"""Pauses before a page is asked for again; after the last it is given up."""
DNO_REGIONS = range(1, 15)
Told = Callable[[str], None]


def fetched(source: Neso, start: datetime, end: datetime, clock: Clock, told: Told) -> Iterator[tuple[PastRow, ...]]:
    """Page after page. Raises ForecastError where one does not come after all retries."""
    for first, last in pages(start, end):
        if first > start:
            _pause(clock, PAUSE)
        told(f"region {source.region}: {first:%Y-%m-%d} to {last:%Y-%m-%d}")
        yield _page(source, first, last, clock, told)


def _page(source: Neso, start: datetime, end: datetime, clock: Clock, told: Told) -> tuple[PastRow, ...]:
    for pause in RETRIES:
        try:
            return source.past(start, end)
        except ForecastUnavailable as error:
            if "answered 400" in str(error):
                raise
            told(f"{error}; again in {pause.total_seconds():.0f} s")
            _pause(clock, pause)
    return source.past(start, end)


def _pause(clock: Clock, length: timedelta) -> None:
    until = clock.now() + length
    while clock.now() < until:
        clock.wait(until)


def span(since: date, until: date) -> tuple[datetime, datetime]:
    """Days in UTC, `until` not included, as moments. Raises UsageError."""
    if until <= since:
        raise UsageError(f"--to {until}: is not after --from {since}")
    start, end = (datetime.combine(day, time(), UTC) for day in (since, until))
    return start, end


def source_for(config: Config | None, region_id: int | None) -> Neso:
    """Region `region_id`, else the configured place, else the nation. Raises ConfigError."""
    if config is None:
        return Neso(BASE_URL, region_id, None)
    return daemon.source_for(config) if region_id is None else Neso(config.forecast.base_url, region_id, None)


def to_csv(path: Path, region_id: int | None, found: Iterable[Sequence[PastRow]]) -> int:
    """Write pages as they come. Returns the rows. Raises PlugdError, ForecastError."""
    where = [] if region_id is None else [region_id]
    count = 0
    try:
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["from", *(["regionid"] if where else []), "forecast", "actual"])
            for page in found:
                for row in page:
                    writer.writerow([f"{row.start:%Y-%m-%dT%H:%MZ}", *where, row.forecast, row.actual])
                count += len(page)
    except OSError as error:
        raise PlugdError(f"{path}: cannot be written ({error.strerror}); name another with --out") from error
    return count


def to_store(config: Config, region: str, found: Iterable[Sequence[PastRow]]) -> int:
    """Keep pages as they come. Returns the rows. Raises StoreError, AlreadyRunning, ForecastError."""
    folder = daemon.state_folder(config)
    count = 0
    with SqliteStore(folder) as store:
        for page in found:
            store.keep_past(region, page)
            count += len(page)
    return count


def fetch(config: Config | None, region_id: int | None, since: date, until: date, out: Path | None, told: Told) -> str:
    """Fetch, and say what came. Raises PlugdError."""
    start, end = span(since, until)
    source, clock = source_for(config, region_id), SystemClock()
    try:
        found = fetched(source, start, end, clock, told)
        if out is not None:
            count = to_csv(out, region_id, found)
        elif config is not None:
            count = to_store(config, source.region, found)
        else:
            raise UsageError("history fetch: without a configuration there is no store; name a file with --out")
    finally:
        clock.close()
    missing = (end - start) // HALF_HOUR - count
    return f"region {source.region}: {count} half hours, {missing} missing"


def shown(config: Config) -> list[str]:
    """What the store knows of the past, a line a region. Raises StoreError."""
    with SqliteStore(daemon.state_folder(config), hold=False) as store:
        found = store.past()
    return [
        f"region {p.region}: {p.first:%Y-%m-%d %H:%M} to {p.last:%Y-%m-%d %H:%M} UTC, {p.known} half hours, "
        f"{p.measured} measured, {(p.last - p.first) // HALF_HOUR + 1 - p.known} missing, "
        f"mean {p.mean_g_per_kwh:.0f} g/kWh"
        for p in found
    ] or ["nothing yet; `plugd history fetch --from DATE --to DATE` gets it"]


def regions(config: Config | None, since: date, until: date, clock: Clock, told: Told) -> dict[int, IntensitySeries]:
    """Every DNO region of days past, for a study. Raises ForecastError, UsageError."""
    start, end = span(since, until)
    found: dict[int, IntensitySeries] = {}
    for region in DNO_REGIONS:
        if found:
            _pause(clock, PAUSE)
        answers = fetched(source_for(config, region), start, end, clock, told)
        found[region] = _series([row for page in answers for row in page], region)
    return found


def _series(rows: Sequence[PastRow], region: int) -> IntensitySeries:
    """Rows on the grid. Raises ForecastError for none."""
    if not rows:
        raise ForecastError(f"NESO knows nothing of region {region} then; choose other days")
    known = {row.start: row for row in rows}
    slots = [rows[0].start + k * HALF_HOUR for k in range((rows[-1].start - rows[0].start) // HALF_HOUR + 1)]
    return IntensitySeries(
        start=slots[0],
        actual=tuple(known[at].actual if at in known else None for at in slots),
        forecast=tuple(known[at].forecast if at in known else None for at in slots),
    )
