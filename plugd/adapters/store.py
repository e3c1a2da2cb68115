"""What survives a restart, in one SQLite file: memory, log, forecasts as issued, intensities seen.

A saved memory is on the card when `save` returns; log lines and forecasts survive a kill at once, and a power
cut from the next save on. Forecasts are kept as issued for 13 months, packed.
"""

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any, Self

from pydantic import TypeAdapter, ValidationError

from plugd.adapters.store_file import StoreFile
from plugd.adapters.store_pack import pack, unpack
from plugd.domain import Forecast, Intensity, Memory, Record
from plugd.errors import StoreError
from plugd.ledger import HalfHour
from plugd.units import HALF_HOUR, require_utc, slot_start

MOST_FORECASTS = 400 * 48
MOST_RECORDS = 400 * 96
MOST_SEEN = 400 * 48
"""About 13 months of each. Counted in rows, not by date: a clock years ahead must not empty the store."""

MIGRATIONS = (
    """
    CREATE TABLE memory (id INTEGER PRIMARY KEY CHECK (id = 1), body BLOB NOT NULL);
    CREATE TABLE record (id INTEGER PRIMARY KEY, at REAL NOT NULL, body TEXT NOT NULL);
    CREATE TABLE forecast (
        id INTEGER PRIMARY KEY, issued_at REAL NOT NULL, region TEXT NOT NULL, rows BLOB NOT NULL
    );
    CREATE TABLE seen (
        region TEXT NOT NULL, start INTEGER NOT NULL, expected REAL, actual REAL, PRIMARY KEY (region, start)
    ) WITHOUT ROWID;
    """,
    """
    CREATE TABLE half_hour (
        start INTEGER PRIMARY KEY, night TEXT NOT NULL, kwh REAL NOT NULL, g_per_kwh REAL NOT NULL,
        final_g_per_kwh REAL, soc REAL NOT NULL, switch_ons INTEGER NOT NULL, arrival REAL NOT NULL,
        arrival_told INTEGER NOT NULL, limit_kw REAL NOT NULL, session_end REAL, minimum REAL,
        meter_kwh REAL, metered_at REAL
    );
    """,
)
"""Each brings a store from the version of its place to the next; `user_version` counts those done."""

MOST_HALF_HOURS = 20 * 366 * 48
"""The ledger is small, and its totals are for life."""
LEDGER_COLUMNS = (
    *("start", "night", "kwh", "g_per_kwh", "final_g_per_kwh", "soc", "switch_ons", "arrival", "arrival_told"),
    *("limit_kw", "session_end", "minimum", "meter_kwh", "metered_at"),
)
LEDGER = ", ".join(LEDGER_COLUMNS)
_TIMES = ("start", "arrival", "session_end", "metered_at")

_MEMORY = TypeAdapter(Memory)
_RECORD = TypeAdapter(Record)


@dataclass(frozen=True, slots=True)
class Past:
    """How much is known of a region's intensity: from the first to the last half hour."""

    region: str
    first: datetime
    last: datetime
    known: int
    measured: int
    mean_g_per_kwh: float


class SqliteStore:
    """The store in a folder of its own. One thread at a time; `close` when done.

    The daemon holds the folder (`hold=True`): a second one raises AlreadyRunning. Commands that only look
    open it beside the daemon with `hold=False`. `notices` says what was found damaged and set aside.
    """

    def __init__(self, folder: Path, hold: bool = True) -> None:
        """Raises StoreError, AlreadyRunning."""
        self._file = StoreFile(folder, MIGRATIONS, hold)
        self._db = self._file.db
        self._saved: bytes | None = None

    @property
    def notices(self) -> tuple[str, ...]:
        """What was found damaged at the start and set aside, in words for a person."""
        return self._file.notices

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of file and folder."""
        self._file.close()

    def load(self) -> Memory | None:
        """The last saved memory, None at the first start. Raises StoreError."""
        with self._file.told():
            row = self._db.execute("SELECT body FROM memory").fetchone()
        if row is None:
            return None
        try:
            body = zlib.decompress(row[0])
            memory = _MEMORY.validate_json(body)
        except (zlib.error, TypeError, ValidationError) as error:
            raise StoreError(f"{self._file.path}: the saved memory cannot be read; plugd begins without it") from error
        self._saved = body
        return memory

    def save(self, memory: Memory) -> None:
        """Keep the memory, on the card when this returns; one unchanged costs no write. Raises StoreError."""
        body = _MEMORY.dump_json(memory)
        if body == self._saved:
            return
        try:
            same = _MEMORY.validate_json(body) == memory
        except ValidationError:
            same = False
        if not same:  # not-a-number, say: the next start could not read it, so the last good one stays
            raise StoreError("the memory holds a value that cannot be saved; the last saved one is kept")
        with self._file.writing("FULL"):
            self._db.execute("INSERT OR REPLACE INTO memory VALUES (1, ?)", [zlib.compress(body)])
        self._saved = body

    def append(self, record: Record) -> None:
        """Add a line to the log. Raises StoreError."""
        body = _RECORD.dump_json(record).decode()
        with self._file.writing("NORMAL"):
            row = self._db.execute("INSERT INTO record (at, body) VALUES (?, ?)", [_epoch_s(record.at), body])
            self._db.execute("DELETE FROM record WHERE id <= ?", [(row.lastrowid or 0) - MOST_RECORDS])

    def records(self, since: datetime) -> tuple[Record, ...]:
        """The log's lines from `since` on, oldest first. Raises StoreError."""
        with self._file.told():
            rows = self._db.execute(
                "SELECT body FROM record WHERE at >= ? ORDER BY at, id", [_epoch_s(since)]
            ).fetchall()
        try:
            return tuple(_RECORD.validate_json(body) for (body,) in rows)
        except ValidationError as error:
            raise StoreError(f"{self._file.path}: the log cannot be read; it was written by another plugd") from error

    def keep(self, forecast: Forecast) -> None:
        """Keep a forecast as issued, and its rows as seen. Raises StoreError."""
        under_way = slot_start(forecast.issued_at)
        expected = [(row.start, row.g_per_kwh) for row in forecast.expected if row.start >= under_way]
        actual = [(row.start, row.g_per_kwh) for row in forecast.actual]
        with self._file.writing("NORMAL"):
            row = self._db.execute(
                "INSERT INTO forecast (issued_at, region, rows) VALUES (?, ?, ?)",
                [_epoch_s(forecast.issued_at), forecast.region, pack(forecast)],
            )
            self._db.execute("DELETE FROM forecast WHERE id <= ?", [(row.lastrowid or 0) - MOST_FORECASTS])
            for column, values in (("expected", expected), ("actual", actual)):
                self._see(forecast.region, column, values)
            oldest = "SELECT start FROM seen ORDER BY start DESC LIMIT 1 OFFSET ?"
            self._db.execute(f"DELETE FROM seen WHERE start <= ({oldest})", [MOST_SEEN])

    def keep_past(self, region: str, rows: Iterable[tuple[datetime, float | None, float | None]]) -> None:
        """Keep (start, expected, actual) of half hours long over; what is known already stays. Raises StoreError."""
        with self._file.writing("NORMAL"):
            self._db.executemany(
                "INSERT INTO seen (region, start, expected, actual) VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE "
                "SET expected = coalesce(expected, excluded.expected), actual = coalesce(excluded.actual, actual)",
                [(region, int(_epoch_s(start)), expected, actual) for start, expected, actual in rows],
            )

    def past(self) -> tuple[Past, ...]:
        """What is known of the past, a line a region. Raises StoreError."""
        with self._file.told():
            rows = self._db.execute(
                "SELECT region, min(start), max(start), count(*), count(actual), avg(coalesce(actual, expected)) "
                "FROM seen GROUP BY region ORDER BY region"
            ).fetchall()
        return tuple(Past(region, _moment(first), _moment(last), *rest) for region, first, last, *rest in rows)

    def latest_forecast(self) -> Forecast | None:
        """The last one kept, None where there is none. Raises StoreError."""
        with self._file.told():
            row = self._db.execute("SELECT issued_at, region, rows FROM forecast ORDER BY id DESC LIMIT 1").fetchone()
        return None if row is None else self._unpacked(*row)

    def forecasts(self, since: datetime) -> tuple[Forecast, ...]:
        """Every forecast kept that was issued from `since` on, in the order of keeping. Raises StoreError."""
        with self._file.told():
            rows = self._db.execute(
                "SELECT issued_at, region, rows FROM forecast WHERE issued_at >= ? ORDER BY id",
                [_epoch_s(since)],
            ).fetchall()
        return tuple(self._unpacked(*row) for row in rows)

    def history(self, since: datetime) -> tuple[Intensity, ...]:
        """Intensities of the half hours from `since` on that were over at the last forecast's issue.

        Measured where known, else what was last expected; of the last forecast's region. Raises StoreError.
        """
        with self._file.told():
            last = self._db.execute("SELECT region, issued_at FROM forecast ORDER BY id DESC LIMIT 1").fetchone()
            if last is None:
                return ()
            rows = self._db.execute(
                "SELECT start, coalesce(actual, expected) FROM seen "
                "WHERE region = ? AND start >= ? AND start <= ? ORDER BY start",
                [last[0], _epoch_s(since), last[1] - HALF_HOUR.total_seconds()],
            ).fetchall()
        return tuple(Intensity(_moment(start), value) for start, value in rows)

    def half_hours(self, since: datetime | None = None) -> tuple[HalfHour, ...]:
        """The ledger from `since` on, in order of time. Raises StoreError."""
        with self._file.told():
            rows = self._db.execute(
                f"SELECT {LEDGER} FROM half_hour WHERE start >= ? ORDER BY start",
                [0.0 if since is None else _epoch_s(since)],
            ).fetchall()
        return tuple(_half_hour(*row) for row in rows)

    def enter(self, rows: Sequence[HalfHour]) -> None:
        """Keep half hours of the ledger, in place of what was kept of them. Raises StoreError."""
        with self._file.writing("NORMAL"):
            self._db.executemany(
                f"INSERT OR REPLACE INTO half_hour ({LEDGER}) VALUES ({', '.join('?' * len(LEDGER_COLUMNS))})",
                [_ledger_row(row) for row in rows],
            )
            oldest = "SELECT start FROM half_hour ORDER BY start DESC LIMIT 1 OFFSET ?"
            self._db.execute(f"DELETE FROM half_hour WHERE start <= ({oldest})", [MOST_HALF_HOURS])

    def measure(self, region: str, values: Sequence[Intensity]) -> None:
        """Keep measured intensities of half hours that are over. Raises StoreError."""
        with self._file.writing("NORMAL"):
            self._see(region, "actual", [(value.start, value.g_per_kwh) for value in values])

    def measured(self, since: datetime) -> tuple[Intensity, ...]:
        """What was measured from `since` on, of the last forecast's region. Raises StoreError."""
        with self._file.told():
            rows = self._db.execute(
                "SELECT start, actual FROM seen WHERE actual IS NOT NULL AND start >= ? AND "
                "region = (SELECT region FROM forecast ORDER BY id DESC LIMIT 1) ORDER BY start",
                [_epoch_s(since)],
            ).fetchall()
        return tuple(Intensity(_moment(start), value) for start, value in rows)

    def _see(self, region: str, column: str, values: list[tuple[datetime, float]]) -> None:
        self._db.executemany(
            f"INSERT INTO seen (region, start, {column}) VALUES (?, ?, ?) ON CONFLICT DO UPDATE "
            f"SET {column} = excluded.{column} WHERE {column} IS NOT excluded.{column}",
            [(region, int(_epoch_s(start)), value) for start, value in values],
        )

    def _unpacked(self, issued_at: float, region: str, packed: bytes) -> Forecast:
        try:
            return unpack(_moment(issued_at), region, packed)
        except (zlib.error, ValueError, KeyError, TypeError) as error:
            raise StoreError(f"{self._file.path}: a kept forecast cannot be read; the next one will do") from error


def _ledger_row(row: HalfHour) -> list[object]:
    """A half hour's values, in the order of the columns."""
    values = {name: getattr(row, name) for name in LEDGER_COLUMNS}
    values |= {name: _epoch_s(values[name]) for name in _TIMES if values[name] is not None}
    return list((values | {"night": row.night.isoformat(), "start": int(_epoch_s(row.start))}).values())


def _half_hour(*columns: Any) -> HalfHour:
    values = dict(zip(LEDGER_COLUMNS, columns, strict=True))
    values |= {name: _moment(values[name]) for name in _TIMES if values[name] is not None}
    return HalfHour(
        **values | {"night": date.fromisoformat(values["night"]), "arrival_told": bool(values["arrival_told"])}
    )


def _epoch_s(moment: datetime) -> float:
    return require_utc(moment).timestamp()


def _moment(epoch_s: float) -> datetime:
    return datetime.fromtimestamp(epoch_s, UTC)
