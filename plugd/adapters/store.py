"""What survives a restart, in one SQLite file: memory, log, forecasts as issued, intensities seen.

A saved memory is on the card when `save` returns; log lines and forecasts survive a kill at once, and a power
cut from the next save on. Forecasts are kept as issued for 13 months, packed.
"""

import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import date, datetime
from pathlib import Path
from typing import Any, Self, TypeVar

from plugd.adapters import frozen_json, store_past
from plugd.adapters.sound import MOST_NUMBER, objection
from plugd.adapters.store_file import StoreFile
from plugd.adapters.store_past import Day, Past, epoch_s, moment
from plugd.domain import Forecast, Intensity, Memory, Outlook, PastRow, Record
from plugd.errors import StoreError
from plugd.ledger import HalfHour
from plugd.ports import Tally
from plugd.units import is_number

MOST_RECORDS = 400 * 96
"""About 13 months. Counted in rows, not by date: a clock years ahead must not empty the store."""

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
    store_past.TABLES,
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
_NEVER_NULL = ("kwh", "g_per_kwh", "soc", "switch_ons", "limit_kw")
_NUMBERS = (*_NEVER_NULL, "final_g_per_kwh", "minimum", "meter_kwh")

Found = TypeVar("Found")


def remembered(body: bytes) -> Memory:
    """A memory as it was saved. Raises ValueError for what cannot have been."""
    memory = frozen_json.read(Memory, body)
    if wrong := objection(memory):
        raise ValueError(wrong)
    return memory


class SqliteStore:
    """The store in a folder of its own. One thread at a time; `close` when done.

    The daemon holds the folder (`hold=True`): a second one raises AlreadyRunning. Commands that only look
    open it beside the daemon with `hold=False`. `notices` says what was found damaged and set aside.
    """

    def __init__(self, folder: Path, hold: bool = True) -> None:
        """Raises StoreError, AlreadyRunning."""
        self._file = StoreFile(folder, MIGRATIONS, hold)
        self._db = self._file.db
        self._saved: Memory | None = None

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
            memory = remembered(zlib.decompress(row[0]))
        except (zlib.error, TypeError, ValueError) as error:
            raise StoreError(f"{self._file.path}: the saved memory cannot be read; plugd begins without it") from error
        self._saved = memory
        return memory

    def save(self, memory: Memory) -> None:
        """Keep the memory, on the card when this returns; one unchanged costs no write. Raises StoreError."""
        if memory == self._saved:
            return
        body = worded(memory)
        with self._file.writing("FULL"):
            self._db.execute("INSERT OR REPLACE INTO memory VALUES (1, ?)", [zlib.compress(body)])
        self._saved = memory

    def append(self, record: Record) -> None:
        """Add a line to the log. Raises StoreError."""
        try:
            body = frozen_json.dump(record).decode()
        except ValueError as error:
            raise StoreError("a line of the log holds a value that cannot be saved; it is left out") from error
        with self._file.writing("NORMAL"):
            row = self._db.execute("INSERT INTO record (at, body) VALUES (?, ?)", [epoch_s(record.at), body])
            self._db.execute("DELETE FROM record WHERE id <= ?", [(row.lastrowid or 0) - MOST_RECORDS])

    def records(self, since: datetime) -> tuple[Record, ...]:
        """The log's lines from `since` on, oldest first. Raises StoreError."""
        with self._file.told():
            rows = self._db.execute(
                "SELECT body FROM record WHERE at >= ? ORDER BY at, id", [epoch_s(since)]
            ).fetchall()
        try:
            return tuple(frozen_json.read(Record, body) for (body,) in rows)
        except ValueError as error:
            raise StoreError(f"{self._file.path}: the log cannot be read; it was written by another plugd") from error

    def keep(self, forecast: Forecast) -> None:
        """Keep a forecast as issued, and what is new in it of the past. Raises StoreError."""
        with self._file.writing("NORMAL"):
            store_past.keep(self._db, forecast)

    def keep_past(self, region: str, rows: Iterable[PastRow]) -> None:
        """Keep half hours that are over; an expectation that is known already stays. Raises StoreError."""
        with self._file.writing("NORMAL"):
            store_past.keep_past(self._db, region, rows)

    def expect(self, at: datetime, outlook: Outlook) -> None:
        """Keep what was expected at `at`, to be scored later. Raises StoreError."""
        with self._file.writing("NORMAL"):
            store_past.expect(self._db, at, outlook)

    def score(self, day: date, found: Sequence[Tally]) -> None:
        """Keep a day's score. Raises StoreError."""
        with self._file.writing("NORMAL"):
            store_past.score(self._db, day, found)

    def latest_forecast(self) -> Forecast | None:
        """The last one kept, None where there is none. Raises StoreError."""
        return self._told(lambda: store_past.latest(self._db))

    def issued(self, since: datetime) -> Iterator[Forecast]:
        """Every forecast kept that was issued from `since` on, in order, of the present region. Raises StoreError."""
        forecasts = self._told(lambda: store_past.issued(self._db, since))
        while (forecast := self._told(lambda: next(forecasts, None))) is not None:
            yield forecast

    def history(self, since: datetime) -> tuple[Intensity, ...]:
        """Half hours from `since` on that are over: measured where published, else last expected. Raises StoreError."""
        return self._told(lambda: store_past.history(self._db, since))

    def measured(self, since: datetime) -> tuple[Intensity, ...]:
        """What was measured from `since` on, of the present region. Raises StoreError."""
        return self._told(lambda: store_past.measured(self._db, since))

    def lacks(self, region: str, start: datetime, end: datetime, measured: bool) -> int:
        """Half hours in [start, end) of which nothing is known, or nothing measured. Raises StoreError."""
        return self._told(lambda: store_past.lacks(self._db, region, start, end, measured))

    def past(self) -> tuple[Past, ...]:
        """What is known of the past, a line a region. Raises StoreError."""
        return self._told(lambda: store_past.past(self._db))

    def days(self) -> tuple[Day, ...]:
        """Older days than the half hours that are kept. Raises StoreError."""
        return self._told(lambda: store_past.days(self._db))

    def outlook(self, at: datetime) -> dict[datetime, float]:
        """What was expected of each half hour in the one that began at `at`. Raises StoreError."""
        return self._told(lambda: store_past.outlook(self._db, at))

    def scored(self) -> date | None:
        """The last day that is scored. Raises StoreError."""
        return self._told(lambda: store_past.scored(self._db))

    def tallies(self, since: date) -> tuple[Tally, ...]:
        """The scores of the days from `since` on. Raises StoreError."""
        return self._told(lambda: store_past.tallies(self._db, since))

    def half_hours(self, since: datetime | None = None) -> tuple[HalfHour, ...]:
        """The ledger from `since` on, in order of time. Raises StoreError."""
        with self._file.told():
            rows = self._db.execute(
                f"SELECT {LEDGER} FROM half_hour WHERE start >= ? ORDER BY start",
                [0.0 if since is None else epoch_s(since)],
            ).fetchall()
        return tuple(found for row in rows if (found := _half_hour(*row)) is not None)

    def enter(self, rows: Sequence[HalfHour]) -> None:
        """Keep half hours of the ledger, in place of what was kept of them. Raises StoreError."""
        with self._file.writing("NORMAL"):
            self._db.executemany(
                f"INSERT OR REPLACE INTO half_hour ({LEDGER}) VALUES ({', '.join('?' * len(LEDGER_COLUMNS))})",
                [_ledger_row(row) for row in rows],
            )
            oldest = "SELECT start FROM half_hour ORDER BY start DESC LIMIT 1 OFFSET ?"
            self._db.execute(f"DELETE FROM half_hour WHERE start <= ({oldest})", [MOST_HALF_HOURS])

    def _told(self, read: Callable[[], Found]) -> Found:
        """What is read. SQLite's errors, and what cannot be unpacked, as StoreError."""
        try:
            with self._file.told():
                return read()
        except store_past.UNREADABLE as error:
            raise StoreError(f"{self._file.path}: a kept forecast cannot be read; the next one will do") from error


def worded(memory: Memory) -> bytes:
    """As JSON. Raises StoreError where the next start could not read it: the last good one is to stay."""
    try:
        body = frozen_json.dump(memory)
        same = remembered(body) == memory
    except ValueError:  # not-a-number, say
        same = False
    if not same:
        raise StoreError("the memory holds a value that cannot be saved; the last saved one is kept")
    return body


def _ledger_row(row: HalfHour) -> list[object]:
    """A half hour's values, in the order of the columns."""
    values = {name: getattr(row, name) for name in LEDGER_COLUMNS}
    values |= {name: epoch_s(values[name]) for name in _TIMES if values[name] is not None}
    return list((values | {"night": row.night.isoformat(), "start": int(epoch_s(row.start))}).values())


def _half_hour(*columns: Any) -> HalfHour | None:
    """A row of the ledger; None where a damaged card holds what was never entered."""
    values = dict(zip(LEDGER_COLUMNS, columns, strict=True))
    try:
        values |= {name: moment(values[name]) for name in _TIMES if values[name] is not None}
        values |= {"night": date.fromisoformat(values["night"]), "arrival_told": bool(values["arrival_told"])}
    except store_past.UNREADABLE:
        return None
    numbers = [values[name] for name in _NUMBERS if values[name] is not None or name in _NEVER_NULL]
    return HalfHour(**values) if all(is_number(value) and abs(value) < MOST_NUMBER for value in numbers) else None
