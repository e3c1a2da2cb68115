"""The intensities in the store: forecasts as issued, what was expected and measured of each half hour, its days.

What is measured is published about an hour late and revised for a day. A forecast is kept with what was new of it
then, so that the forecasts in order tell the past as it came to be known; `seen` holds what is known now.
"""

import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass, replace
from datetime import UTC, date, datetime
from typing import NamedTuple

from plugd.adapters.store_pack import MOST_G_PER_KWH, pack, unpack
from plugd.domain import Forecast, Intensity, Outlook, PastRow
from plugd.ports import Tally
from plugd.units import HALF_HOUR, require_utc, slot_start

MOST_FORECASTS = 400 * 48
MOST_SEEN = 400 * 48
"""About 13 months of each. Counted in rows, not by date: a clock years ahead must not empty the store."""
MOST_OUTLOOKS = 35 * 48
"""What plugd itself expected is kept until it is scored."""
SCORED_SLOTS = 2 * 96
"""As far ahead as an outlook is scored."""
SWEPT_EVERY = 48
"""Forecasts from one sweeping out to the next."""

TABLES = """
    CREATE TABLE day (
        region TEXT NOT NULL, day TEXT NOT NULL, half_hours INTEGER NOT NULL, mean REAL NOT NULL, low REAL NOT NULL,
        high REAL NOT NULL, PRIMARY KEY (region, day)
    ) WITHOUT ROWID;
    CREATE TABLE outlook (start INTEGER PRIMARY KEY, rows BLOB NOT NULL);
    CREATE TABLE score (
        day TEXT NOT NULL, who TEXT NOT NULL, from_h INTEGER NOT NULL, to_h INTEGER NOT NULL,
        half_hours INTEGER NOT NULL, absolute REAL NOT NULL, signed REAL NOT NULL, level REAL NOT NULL,
        PRIMARY KEY (day, who, from_h)
    ) WITHOUT ROWID;
    CREATE TABLE scored (day TEXT PRIMARY KEY) WITHOUT ROWID;
"""
"""What came to the tables `forecast` and `seen` of the store's first version."""

UNREADABLE = (zlib.error, ValueError, LookupError, TypeError, OverflowError, OSError, RecursionError)
"""What unpacking raises for what was never packed, and a moment for what is none."""
_REGION = (
    "coalesce((SELECT region FROM forecast ORDER BY id DESC LIMIT 1), (SELECT region FROM seen ORDER BY start DESC "
    "LIMIT 1))"
)
"""Of the last forecast; where there never was one, of what is known of the past."""
_TRUE = f"g BETWEEN 0 AND {MOST_G_PER_KWH:.0f} AND start < 253402300800"
"""No other cell was written by plugd: to SQLite a text is more than any number, and 9999 is the last year."""


@dataclass(frozen=True, slots=True)
class Past:
    """How much is known of a region's intensity: from the first to the last half hour."""

    region: str
    first: datetime
    last: datetime
    known: int
    measured: int
    mean_g_per_kwh: float


class Day(NamedTuple):
    """A day (UTC) longer ago than the half hours that are kept."""

    region: str
    day: str
    half_hours: int
    mean_g_per_kwh: float
    low_g_per_kwh: float
    high_g_per_kwh: float


# Every function works within a transaction of the caller's and lets SQLite's errors through.


def keep(db: sqlite3.Connection, forecast: Forecast) -> None:
    """A forecast as issued, and what it tells of half hours that are over or under way."""
    try:
        before = latest(db, forecast.region)
    except UNREADABLE:
        before = None
    news = _news(db, forecast)
    _see(db, forecast.region, "expected", _expected(before, forecast))
    _see(db, forecast.region, "actual", news)
    row = db.execute(
        "INSERT INTO forecast (issued_at, region, rows) VALUES (?, ?, ?)",
        [epoch_s(forecast.issued_at), forecast.region, pack(replace(forecast, actual=news))],
    )
    if (row.lastrowid or 0) % SWEPT_EVERY == 0:
        db.execute("DELETE FROM forecast WHERE id <= ?", [(row.lastrowid or 0) - MOST_FORECASTS])
        _sweep(db)


def _expected(before: Forecast | None, forecast: Forecast) -> Iterable[Intensity]:
    """What was last expected of the half hour under way, and of those since the forecast before: there was none."""
    under_way = slot_start(forecast.issued_at)
    if before is not None:
        since = slot_start(before.issued_at)
        yield from (row for row in before.expected if since < row.start < under_way)
    yield from (row for row in forecast.expected if row.start == under_way)


def _news(db: sqlite3.Connection, forecast: Forecast) -> tuple[Intensity, ...]:
    """Those of its measured values that were not known yet, or are revised."""
    if not forecast.actual:
        return ()
    first, last = forecast.actual[0].start, forecast.actual[-1].start
    known = dict(
        db.execute(
            "SELECT start, actual FROM seen WHERE region = ? AND start >= ? AND start <= ?",
            [forecast.region, epoch_s(first), epoch_s(last)],
        )
    )
    return tuple(row for row in forecast.actual if known.get(int(epoch_s(row.start))) != row.g_per_kwh)


def _see(db: sqlite3.Connection, region: str, column: str, values: Iterable[Intensity]) -> None:
    db.executemany(
        f"INSERT INTO seen (region, start, {column}) VALUES (?, ?, ?) ON CONFLICT DO UPDATE "
        f"SET {column} = excluded.{column} WHERE {column} IS NOT excluded.{column}",
        [(region, int(epoch_s(value.start)), value.g_per_kwh) for value in values],
    )


def _sweep(db: sqlite3.Connection) -> None:
    """Half hours beyond their number become part of their days; a day may be swept in two parts."""
    oldest = db.execute("SELECT start FROM seen ORDER BY start DESC LIMIT 1 OFFSET ?", [MOST_SEEN]).fetchone()
    if oldest is None:
        return
    db.execute(
        "INSERT INTO day SELECT region, date(start, 'unixepoch') AS d, count(*), avg(g), min(g), max(g) FROM "
        "(SELECT region, start, coalesce(actual, expected) AS g FROM seen WHERE start <= ?) GROUP BY region, d "
        "ON CONFLICT DO UPDATE SET mean = (mean * half_hours + excluded.mean * excluded.half_hours) / "
        "(half_hours + excluded.half_hours), half_hours = half_hours + excluded.half_hours, "
        "low = min(low, excluded.low), high = max(high, excluded.high)",
        oldest,
    )
    db.execute("DELETE FROM seen WHERE start <= ?", oldest)


def keep_past(db: sqlite3.Connection, region: str, rows: Iterable[PastRow]) -> None:
    """Half hours that are over: what is measured replaces, an expectation that is known already stays."""
    db.executemany(
        "INSERT INTO seen (region, start, expected, actual) VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE "
        "SET expected = coalesce(expected, excluded.expected), actual = coalesce(excluded.actual, actual)",
        [(region, int(epoch_s(row.start)), row.forecast, row.actual) for row in rows],
    )


def lacks(db: sqlite3.Connection, region: str, start: datetime, end: datetime, measured: bool) -> int:
    """Half hours in [start, end) of which nothing is known, or nothing measured."""
    column = "actual" if measured else "*"
    known: int = db.execute(
        f"SELECT count({column}) FROM seen WHERE region = ? AND start >= ? AND start < ?",
        [region, epoch_s(start), epoch_s(end)],
    ).fetchone()[0]
    return max(0, -((start - end) // HALF_HOUR) - known)


def past(db: sqlite3.Connection) -> tuple[Past, ...]:
    """What is known of the past, a line a region."""
    rows = db.execute(
        "SELECT region, min(start), max(start), count(*), count(actual), avg(coalesce(actual, expected)) "
        "FROM seen GROUP BY region ORDER BY region"
    )
    return tuple(Past(region, moment(first), moment(last), *rest) for region, first, last, *rest in rows)


def days(db: sqlite3.Connection) -> tuple[Day, ...]:
    """The days beyond the half hours that are kept, oldest first."""
    return tuple(Day(*row) for row in db.execute("SELECT * FROM day ORDER BY day, region"))


def latest(db: sqlite3.Connection, region: str | None = None) -> Forecast | None:
    """The last one kept (of a region), None where there is none. Raises what `unpack` raises."""
    row = db.execute(
        "SELECT issued_at, region, rows FROM forecast WHERE region = coalesce(?, region) ORDER BY id DESC LIMIT 1",
        [region],
    ).fetchone()
    return None if row is None else unpack(moment(row[0]), row[1], row[2])


def issued(db: sqlite3.Connection, since: datetime) -> Iterator[Forecast]:
    """Every forecast kept of the present region from `since` on, unpacked one by one: together they are large."""
    rows = db.execute(
        f"SELECT issued_at, region, rows FROM forecast WHERE issued_at >= ? AND region = {_REGION} ORDER BY id",
        [epoch_s(since)],
    )
    return (found for row in rows if (found := _unpacked(*row)) is not None)


def _unpacked(issued_at: float, region: str, packed: bytes) -> Forecast | None:
    """A forecast; None where its row is damaged: of thousands none is missed."""
    try:
        return unpack(moment(issued_at), region, packed)
    except UNREADABLE:
        return None


def history(db: sqlite3.Connection, since: datetime) -> tuple[Intensity, ...]:
    """Half hours from `since` on that are over as far as the source is concerned: measured, else as last expected."""
    last = db.execute("SELECT issued_at FROM forecast ORDER BY id DESC LIMIT 1").fetchone()
    over = last[0] - HALF_HOUR.total_seconds() if last else epoch_s(datetime.max.replace(tzinfo=UTC))
    rows = db.execute(
        f"SELECT start, coalesce(actual, expected) AS g FROM seen WHERE region = {_REGION} AND start >= ? "
        f"AND (actual IS NOT NULL OR start <= ?) AND {_TRUE} ORDER BY start",
        [epoch_s(since), over],
    )
    return tuple(Intensity(moment(start), value) for start, value in rows)


def expect(db: sqlite3.Connection, at: datetime, outlook: Outlook) -> None:
    """What is expected at `at`, in place of what was in the same half hour."""
    rows = tuple(Intensity(slot.start, round(slot.g_per_kwh, 1)) for slot in outlook.slots[:SCORED_SLOTS])
    start = int(epoch_s(slot_start(at)))
    db.execute("INSERT OR REPLACE INTO outlook VALUES (?, ?)", [start, pack(Forecast(at, "", rows))])
    oldest = "SELECT start FROM outlook ORDER BY start DESC LIMIT 1 OFFSET ?"
    db.execute(f"DELETE FROM outlook WHERE start <= ({oldest})", [MOST_OUTLOOKS])


def outlook(db: sqlite3.Connection, at: datetime) -> dict[datetime, float]:
    """What was expected of each half hour in the one that began at `at`. One by one: together they are 8 MB."""
    kept = db.execute("SELECT rows FROM outlook WHERE start = ?", [epoch_s(at)]).fetchone()
    found = _unpacked(epoch_s(at), "", kept[0]) if kept else None
    return {row.start: row.g_per_kwh for row in found.expected} if found else {}


def score(db: sqlite3.Connection, day: date, found: Iterable[Tally]) -> None:
    """A day's score, in place of what was kept of it."""
    db.execute("INSERT OR REPLACE INTO scored VALUES (?)", [day.isoformat()])
    db.executemany(
        "INSERT OR REPLACE INTO score VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        [(one.day.isoformat(), *astuple(one)[1:]) for one in found],
    )


def scored(db: sqlite3.Connection) -> date | None:
    """The last day with a score."""
    last = db.execute("SELECT max(day) FROM scored WHERE date(day) = day").fetchone()[0]
    return None if last is None else date.fromisoformat(last)


def tallies(db: sqlite3.Connection, since: date) -> tuple[Tally, ...]:
    """The scores of the days from `since` on."""
    rows = db.execute("SELECT * FROM score WHERE day >= ? ORDER BY day, who, from_h", [since.isoformat()])
    return tuple(Tally(date.fromisoformat(day), *rest) for day, *rest in rows)


def measured(db: sqlite3.Connection, since: datetime) -> tuple[Intensity, ...]:
    """What was measured from `since` on, of the present region."""
    rows = db.execute(
        f"SELECT start, actual AS g FROM seen WHERE start >= ? AND region = {_REGION} AND {_TRUE} ORDER BY start",
        [epoch_s(since)],
    )
    return tuple(Intensity(moment(start), value) for start, value in rows)


def epoch_s(at: datetime) -> float:
    """Seconds since 1970 (UTC)."""
    return require_utc(at).timestamp()


def moment(at_s: float) -> datetime:
    """Aware UTC."""
    return datetime.fromtimestamp(at_s, UTC)
