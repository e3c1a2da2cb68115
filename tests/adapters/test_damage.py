"""A card that damages single values: what cannot have been saved is done without, and the rest stays."""

import json
import sqlite3
import zlib
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest

from plugd.adapters.kept_twice import KeptTwice
from plugd.adapters.store import SqliteStore
from plugd.errors import StoreError
from plugd.units import HALF_HOUR
from tests.unit.deciding import EVENING, forecast, knows
from tests.unit.test_ledger import row


def changed(folder: Path, statement: str, *values: object) -> None:
    """The database, as somebody else's hand left it."""
    with closing(sqlite3.connect(folder / "plugd.db")) as db, db:
        assert db.execute(statement, values).rowcount == 1


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("soc", "driven_to"), "2023-01-02T18:00:00"),
        (("soc", "driven_to"), "9999-12-31T23:00:00Z"),
        (("soc", "mean"), -3.0),
        (("soc", "meter_kwh"), 1e300),
        (("observed_kw",), 1e-9),
        (("guard_count",), 10**400),
        (("switch_ons",), ["2023-01-02T18:00:00Z"] * 5000),
    ],
    ids=lambda part: str(part)[:20],
)
def test_a_memory_that_no_plugd_saved_is_not_believed(tmp_path: Path, where: tuple[str, ...], value: object) -> None:
    with KeptTwice(tmp_path) as store:
        store.save(knows(0.6))
    db = sqlite3.connect(tmp_path / "plugd.db")
    memory = json.loads(zlib.decompress(db.execute("SELECT body FROM memory").fetchone()[0]))
    db.close()
    inner = memory
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = value
    changed(tmp_path, "UPDATE memory SET body = ?", zlib.compress(json.dumps(memory).encode()))
    with SqliteStore(tmp_path) as store, pytest.raises(StoreError, match="cannot be read"):
        store.load()
    with KeptTwice(tmp_path) as store:
        found = store.load()
        assert store.fell_back
        assert found is not None
        assert found.soc.mean == 0.6


@pytest.mark.parametrize(("column", "value"), [("start", 1e300), ("kwh", "x"), ("night", "2023-99-99"), ("soc", None)])
def test_a_half_hour_that_was_never_entered_is_left_out(tmp_path: Path, column: str, value: object) -> None:
    rows = [row(k) for k in range(3)]
    with SqliteStore(tmp_path) as store:
        store.enter(rows)
    try:
        changed(tmp_path, f"UPDATE half_hour SET {column} = ? WHERE start = ?", value, rows[1].start.timestamp())
    except sqlite3.IntegrityError:
        return  # SQLite itself would not have it
    with SqliteStore(tmp_path) as store:
        assert store.half_hours() == (rows[0], rows[2])


@pytest.mark.parametrize("value", ["x", -5.0, float("inf"), b"\xff"])
def test_an_intensity_that_was_never_told_is_left_out(tmp_path: Path, value: object) -> None:
    with SqliteStore(tmp_path) as store:
        for k in range(4):
            store.keep(forecast(EVENING + k * HALF_HOUR))
        whole = store.history(EVENING)
    changed(tmp_path, "UPDATE seen SET expected = ? WHERE start = ?", value, whole[1].start.timestamp())
    with SqliteStore(tmp_path) as store:
        assert store.history(EVENING) == (whole[0], *whole[2:])


@pytest.mark.parametrize("rows", [b"", b"\x00", zlib.compress(b'{"expected": [[0], ["NaN"]], "actual": [[], []]}')])
def test_a_damaged_forecast_is_left_out_of_thousands(tmp_path: Path, rows: bytes) -> None:
    with SqliteStore(tmp_path) as store:
        for k in range(3):
            store.keep(forecast(EVENING + k * HALF_HOUR))
    changed(tmp_path, "UPDATE forecast SET rows = ? WHERE id = 2", rows)
    with SqliteStore(tmp_path) as store:
        assert [one.issued_at for one in store.issued(EVENING)] == [EVENING, EVENING + timedelta(hours=1)]


def test_a_schema_that_is_no_text_is_damage_as_any_other(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(knows(0.6))
    path = tmp_path / "plugd.db"
    body = path.read_bytes()
    assert b"CREATE TABLE record" in body
    path.write_bytes(body.replace(b"tablerecordrecord", b"tablerecor\xecrecord"))
    with pytest.raises(StoreError, match="damaged"), SqliteStore(tmp_path, hold=False) as store:
        store.load()
    with KeptTwice(tmp_path) as kept:
        assert "the old one is" in kept.notices[0]
        kept.save(knows(0.5))
