"""The file under the store: opened, locked, migrated, set aside when damaged; its errors in words."""

import fcntl
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from plugd.errors import AlreadyRunning, StoreError

FILE = "plugd.db"
LOCK = "lock"
BUSY_S = 5.0
MOST_QUOTED = 100
"""Of SQLite's words: they may hold what stands in a damaged file."""
CACHE_KIB = 256
"""Of pages in memory. SQLite's own 2 MB would fill over a month, and what is read is read once a half hour."""

REMEDIES = {
    sqlite3.SQLITE_FULL: "the disk is full; make room",
    sqlite3.SQLITE_READONLY: "it may not be written; check its owner, and whether the card is read-only",
    sqlite3.SQLITE_IOERR: "reading or writing failed; check the card",
    sqlite3.SQLITE_CANTOPEN: "it cannot be opened; check the folder and its owner",
    sqlite3.SQLITE_BUSY: "another program holds it; end that one",
    sqlite3.SQLITE_CORRUPT: "it is damaged; restart plugd, which sets it aside and begins anew",
    sqlite3.SQLITE_NOTADB: "it is no database; restart plugd, which sets it aside and begins anew",
}
"""What to do about SQLite's primary result codes."""
NOT_TEXT = "SQLite's own words on it quote what is no text"
"""Where a damaged schema stands in the message, Python cannot make an error of it."""
DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


class StoreFile:
    """An open SQLite file in a folder, with a write-ahead log."""

    def __init__(self, folder: Path, migrations: tuple[str, ...], hold: bool) -> None:
        """`hold`: take the folder's lock, and set a damaged file aside. Raises StoreError, AlreadyRunning."""
        self.path = folder / FILE
        self.notices: tuple[str, ...] = ()
        self._migrations = migrations
        self._lock = _hold(folder) if hold else None
        # Who only looks makes no file: as another user's it would keep the daemon out.
        self._target = str(self.path) if hold or self.path.exists() else ":memory:"
        try:
            self.db = self._opened(may_set_aside=hold)
        except BaseException:
            self._release()
            raise

    def close(self) -> None:
        """Let go of file and folder."""
        self.db.close()
        self._release()

    @contextmanager
    def writing(self, synchronous: str) -> Iterator[None]:
        """One transaction, all of it or nothing. FULL: on the card at its end; NORMAL: safe from a kill."""
        with self.told():
            self.db.execute(f"PRAGMA synchronous = {synchronous}")
            self.db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self.db.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):  # a full disk has rolled it back already
                    self.db.execute("ROLLBACK")
                raise

    @contextmanager
    def told(self) -> Iterator[None]:
        """SQLite's errors as StoreError."""
        try:
            yield
        except UnicodeDecodeError as error:
            raise self._error(_Damaged(NOT_TEXT)) from error
        except sqlite3.Error as error:
            raise self._error(error) from error

    def _opened(self, may_set_aside: bool) -> sqlite3.Connection:
        """The database, sound and of this version; a damaged one is set aside and a new one begun."""
        try:
            return self._connected()
        except sqlite3.Error as error:
            if not may_set_aside or _code(error) not in DAMAGE:
                raise self._error(error) from error
        aside = self._set_aside()
        self.notices = (f"the store was damaged, so a new one is begun; the old one is {aside}",)
        with self.told():
            return self._connected()

    def _connected(self) -> sqlite3.Connection:
        # The daemon opens the store in its main thread and uses it in the scheduler's.
        db = sqlite3.connect(self._target, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
        try:
            db.execute("PRAGMA journal_mode = WAL")
            db.execute(f"PRAGMA cache_size = -{CACHE_KIB}")
            found = [row[0] for row in db.execute("PRAGMA quick_check(1)")]
            if found != ["ok"]:
                raise _Damaged(found[0])
            self._migrate(db)
        except UnicodeDecodeError as error:
            db.close()
            raise _Damaged(NOT_TEXT) from error
        except BaseException:
            db.close()
            raise
        return db

    def _migrate(self, db: sqlite3.Connection) -> None:
        """Bring the file to this version, in one transaction. Raises StoreError for one of a newer plugd."""
        version = db.execute("PRAGMA user_version").fetchone()[0]
        if version > len(self._migrations):
            raise StoreError(f"{self.path}: was written by a newer plugd; install that, or move the file away")
        if version < len(self._migrations):
            steps = "".join(self._migrations[version:])
            db.executescript(f"BEGIN IMMEDIATE; {steps} PRAGMA user_version = {len(self._migrations)}; COMMIT;")

    def _set_aside(self) -> Path:
        """Rename the damaged file and what belongs to it."""
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        aside = self.path.with_name(f"{FILE}.corrupt.{stamp}")
        try:
            for suffix in ("-wal", "-shm", ""):
                with suppress(FileNotFoundError):
                    self.path.with_name(FILE + suffix).rename(aside.with_name(aside.name + suffix))
        except OSError as error:
            raise StoreError(f"{self.path}: is damaged and cannot be set aside ({error.strerror})") from error
        return aside

    def _error(self, error: sqlite3.Error) -> StoreError:
        said = "".join(c if c.isprintable() else "?" for c in str(error)[:MOST_QUOTED])
        remedy = REMEDIES.get(_code(error), f"SQLite says: {said}")
        return StoreError(f"{self.path}: {remedy}")

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.close()


class _Damaged(sqlite3.DatabaseError):
    """The check at the start found damage."""

    sqlite_errorcode = sqlite3.SQLITE_CORRUPT


def _hold(folder: Path) -> IO[str]:
    """The folder, made if need be, and its lock, held until it is closed or this process ends."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be created ({error.strerror}); check state.dir") from error
    path = folder / LOCK
    try:
        lock = path.open("a+", encoding="ascii", errors="replace")
    except OSError as error:
        raise StoreError(f"{path}: cannot be opened ({error.strerror}); check state.dir and its owner") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.seek(0)
        holder = lock.read(20).strip()
        lock.close()
        who = f" (process {holder})" if holder.isdecimal() else ""
        raise AlreadyRunning(f"{folder}: another plugd{who} works with this folder; end it first") from error
    with suppress(OSError):  # whose it is is a courtesy: a full disk must not keep plugd from starting
        os.ftruncate(lock.fileno(), 0)
        os.write(lock.fileno(), str(os.getpid()).encode())
    return lock


def _code(error: sqlite3.Error) -> int:
    """SQLite's primary result code."""
    return int(getattr(error, "sqlite_errorcode", 0)) & 0xFF
