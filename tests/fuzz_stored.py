"""What a start reads, damaged: memory and its copy, every table's cells, the file's bytes, the list of starts.

Whatever it finds, plugd starts (or says in one line why not) and goes round; what only looks is told in one line too.
"""

import json
import random
import shutil
import sqlite3
import tempfile
import time
import zlib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TypeVar

from plugd.adapters.kept_twice import COPY, OLDER, KeptTwice, sealed
from plugd.adapters.starts import FILE as STARTS
from plugd.adapters.starts import Starts
from plugd.adapters.store import SqliteStore
from plugd.adapters.store_file import FILE
from plugd.book import Book
from plugd.domain import Household, SetMinimum, SetTrip, Trip
from plugd.errors import StoreError
from plugd.outlook import Learned
from plugd.planner.exact import Exact
from plugd.scoring import Scoring
from plugd.study.house import FunctionSource, House
from plugd.study.world import Driver
from plugd.units import HALF_HOUR
from tests.fuzz_plugs import WILD, mutated, swapped
from tests.fuzz_words import Count, readable

START = datetime(2023, 3, 6, 12, tzinfo=UTC)
LIVED = timedelta(days=2)
Found = TypeVar("Found")
AFTERWARDS = timedelta(minutes=70)
MOST_S = 20.0
"""Of processor, for one of them: whoever walks through centuries half hour by half hour is stuck."""


def _level(issued: datetime, start: datetime) -> float:
    return 100.0 + 10.0 * start.hour


def _house(store: KeptTwice, at: datetime) -> House:
    home = Household()
    house = House(home, Exact(), FunctionSource(_level, slots=8), Driver(seed=1).stays(at), at)
    house.cycle.store, house.cycle.book, house.cycle.learned = store, Book(store, home), Learned()
    house.cycle.errands = (Scoring(store),)
    return house


def _lived(folder: Path) -> None:
    """A store as it is after two days."""
    with KeptTwice(folder) as store:
        Starts(folder).begun(START)
        house = _house(store, START)
        house.hub.said += [SetMinimum(0.6), SetTrip(Trip(START.date() + timedelta(days=9), minimum=0.7))]
        house.run(START + LIVED)
        store.score(START.date(), Scoring(store)._of(START.date()))
        store._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")


# -- damage ---------------------------------------------------------------------------------------


def _memory(dice: random.Random, folder: Path) -> None:
    """Other values in the memory; often in both places."""
    with sqlite3.connect(folder / FILE) as db:
        body = zlib.decompress(db.execute("SELECT body FROM memory").fetchone()[0])
        wrong = _document(dice, body)
        packed = zlib.compress(wrong) if dice.random() < 0.9 else wrong
        db.execute("UPDATE memory SET body = ?", [packed])
    db.close()
    if dice.random() < 0.5:
        (folder / COPY).write_bytes(sealed(wrong))
        (folder / OLDER).unlink(missing_ok=True)


def _document(dice: random.Random, body: bytes) -> bytes:
    said = json.loads(body)
    for _ in range(dice.randrange(1, 4)):
        said = swapped(dice, said) if dice.random() < 0.5 else _nudged(dice, said)
    return json.dumps(said).encode("utf-8", "surrogatepass") if dice.random() < 0.9 else mutated(dice, said)


def _nudged(dice: random.Random, said: object) -> object:
    """Another value of the same kind, somewhere within."""
    if isinstance(said, dict) and said:
        key = dice.choice(list(said))
        return {**said, key: _nudged(dice, said[key])}
    if isinstance(said, list) and said:
        at = dice.randrange(len(said))
        if dice.random() < 0.2:
            return dice.choice((said[:at], said * 50, said[::-1]))
        return [*said[:at], _nudged(dice, said[at]), *said[at + 1 :]]
    if isinstance(said, bool):
        return not said
    if isinstance(said, int | float):
        return dice.choice((0.0, -1.0, 1e-9, 0.5, 1.0, 2.0, 1e9, 1e300, -said, 1000.0 * said))
    if isinstance(said, str) and said[4:5] == "-":
        return dice.choice(MOMENTS)
    return dice.choice(WILD)


MOMENTS = (
    "0001-01-01T00:00:00Z", "1970-01-01T00:00:00Z", "2023-03-06T12:00:00", "2023-03-08T23:30:00+14:00",
    "9999-12-31T23:59:59.999999Z", "2123-03-06T12:00:00Z", "2023-03-08T12:17:03Z", "2023-03-06", "12:00:00",
)  # fmt: skip


def _cell(dice: random.Random, folder: Path) -> None:
    """Another value in some cell of some table."""
    with sqlite3.connect(folder / FILE) as db:
        tables = [name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for _ in range(dice.choice((1, 1, 5))):
            table = dice.choice(tables)
            columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})")]
            column = dice.choice(columns)
            rows = db.execute(f"SELECT rowid, {column} FROM {table}").fetchall() if (
                table not in ("seen", "day", "score", "scored")
            ) else ()  # fmt: skip
            found = dice.choice(rows) if rows else None
            was = found[1] if found else db.execute(f"SELECT {column} FROM {table} LIMIT 1").fetchone()
            where = f"rowid = {found[0]}" if found else "1"
            try:
                db.execute(f"UPDATE OR IGNORE {table} SET {column} = ? WHERE {where}", [_value(dice, was)])
            except (sqlite3.IntegrityError, OverflowError):
                continue  # SQLite itself refuses that
    db.close()


def _value(dice: random.Random, was: object) -> object:
    if isinstance(was, bytes) and dice.random() < 0.8:
        try:
            return zlib.compress(_document(dice, zlib.decompress(was)))
        except zlib.error:
            return dice.randbytes(20)
    if isinstance(was, str) and was.startswith("{"):
        return _document(dice, was.encode()).decode("utf-8", "replace")
    return dice.choice(
        (None, "", "x", "2023-99-99", b"", b"\xff", 0, -1, 1e300, float("inf"), -(2**63), 2**63 - 1, 1e12, -1e12)
    )


def _bytes(dice: random.Random, folder: Path) -> None:
    """The card: bytes that are others, a page of zeros, a file cut off."""
    path = folder / dice.choice((FILE, FILE, FILE, COPY, STARTS))
    body = bytearray(path.read_bytes())
    kind = dice.random()
    if kind < 0.6:
        for _ in range(dice.choice((1, 3, 50))):
            body[dice.randrange(len(body))] = dice.getrandbits(8)
    elif kind < 0.8:
        at = 4096 * dice.randrange(1 + len(body) // 4096)
        body[at : at + 4096] = bytes(len(body[at : at + 4096]))
    else:
        del body[dice.randrange(len(body)) :]
    path.write_bytes(body)


def _starts(dice: random.Random, folder: Path) -> None:
    (folder / STARTS).write_bytes(mutated(dice, [START.timestamp(), (START + LIVED).timestamp()]))


DAMAGE: tuple[Callable[[random.Random, Path], None], ...] = (_memory, _memory, _cell, _cell, _bytes, _starts)


# -- the start ------------------------------------------------------------------------------------


def _begin(folder: Path) -> bool:
    """As the daemon: whether it took the memory it found. Raises StoreError where it says that it cannot start."""
    at = START + LIVED
    safe = Starts(folder).begun(at)
    with KeptTwice(folder) as store:
        house = _house(store, at)
        memory, forecast = _read(store.load, folder), _read(store.latest_forecast, folder)
        house.cycle.memory, house.cycle.forecast = memory or house.cycle.memory, forecast
        house.cycle.__post_init__()
        house.cycle.controller.safe = safe
        house.run(at + AFTERWARDS)
    return memory is not None


def _read(read: Callable[[], Found | None], folder: Path) -> Found | None:
    """Each by itself: what one table has lost is no reason to do without the other."""
    try:
        return read()
    except StoreError as error:
        readable(error, folder)
        return None


def _looked(folder: Path) -> None:
    """What the commands that only look read."""
    since = START - timedelta(days=400)
    reads: tuple[Callable[[SqliteStore], object], ...] = (
        lambda store: store.records(since),
        lambda store: store.half_hours(),
        lambda store: tuple(store.issued(since)),
        lambda store: store.history(since),
        lambda store: store.measured(since),
        lambda store: [store.outlook(START + k * HALF_HOUR) for k in range(96)],
        lambda store: store.tallies(since.date()),
        lambda store: (store.past(), store.days(), store.scored(), store.latest_forecast()),
    )
    with SqliteStore(folder, hold=False) as store:
        for read in reads:
            try:
                read(store)
            except StoreError as error:
                readable(error, folder)


def throw_stored(dice: random.Random, inputs: int) -> Count:
    """Damage a store of two days, look at it, and start on it. Raises what comes of it."""
    count = Count()
    with tempfile.TemporaryDirectory(prefix="plugd-stored-") as name:
        sound, folder = Path(name, "sound"), Path(name, "damaged")
        _lived(sound)
        for number in range(inputs):
            count.tried += 1
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(sound, folder)
            damage, began = dice.choice(DAMAGE), time.process_time()
            damage(dice, folder)
            spared = (folder / COPY).read_bytes() == (sound / COPY).read_bytes()
            try:
                _looked(folder)
                taken = _begin(folder)
                if spared and not taken:
                    raise LookupError("the copy is whole, and was not read")
                if time.process_time() - began > MOST_S:
                    raise TimeoutError("plugd is stuck")
            except StoreError as error:
                readable(error, damage)
                taken = False
            except Exception as error:
                kept = Path(tempfile.mkdtemp(prefix="plugd-damaged-"))
                shutil.copytree(folder, kept, dirs_exist_ok=True)
                raise AssertionError(f"input {number}, {damage.__name__}: left in {kept}") from error
            count.taken += taken
            count.refused += not taken
    return count
