"""What people have set outlives the database."""

import itertools
import random
import sqlite3
from dataclasses import replace
from datetime import time, timedelta
from pathlib import Path

import pytest

from plugd.adapters import kept_twice
from plugd.adapters.kept_twice import COPY, OLDER, KeptTwice
from plugd.adapters.store_file import FILE
from plugd.domain import Memory, Mode, Overrides, Trip
from plugd.errors import StoreError
from tests.unit.deciding import EVENING, NIGHT, knows, plan, planned, session

SET = replace(
    knows(0.42), overrides=Overrides(mode=Mode.OFF, minimum=0.7, ready_by=time(6), trips=(Trip(NIGHT.date()),))
)


def kept(folder: Path, *memories: Memory) -> None:
    """A daemon that saves these and ends."""
    with KeptTwice(folder) as store:
        for memory in memories:
            store.save(memory)


def loaded(folder: Path) -> tuple[Memory | None, bool]:
    """What the next one begins with, and whether it is the copy."""
    with KeptTwice(folder) as store:
        return store.load(), store.fell_back


def test_the_database_is_what_counts(tmp_path: Path) -> None:
    assert loaded(tmp_path) == (None, False)
    kept(tmp_path, SET)
    assert loaded(tmp_path) == (SET, False)


@pytest.mark.parametrize("seed", range(8))
def test_a_damaged_database_loses_nothing_that_was_set(seed: int, tmp_path: Path) -> None:
    kept(tmp_path, SET)
    path = tmp_path / FILE
    dice = random.Random(seed)
    body = bytearray(path.read_bytes())
    for _ in range(400):
        body[dice.randrange(len(body))] ^= dice.randrange(1, 256)
    path.write_bytes(bytes(body[: dice.randrange(len(body))] if seed % 2 else body))
    assert loaded(tmp_path)[0] == SET


def test_a_missing_database_loses_nothing_either(tmp_path: Path) -> None:
    kept(tmp_path, SET)
    (tmp_path / FILE).unlink()
    assert loaded(tmp_path) == (SET, True)


@pytest.mark.parametrize("torn", [b"", b"\0" * 500, b"deadbeef\n{}"])
def test_a_torn_copy_is_passed_over_for_the_older_one(torn: bytes, tmp_path: Path) -> None:
    older = replace(SET, overrides=Overrides(minimum=0.6))
    kept(tmp_path, older, SET)
    (tmp_path / FILE).unlink()
    (tmp_path / COPY).write_bytes(torn)
    assert loaded(tmp_path) == (older, True)
    (tmp_path / OLDER).write_bytes(torn)
    (tmp_path / FILE).unlink()
    assert loaded(tmp_path) == (None, False)


def test_every_cut_of_the_copy_is_noticed(tmp_path: Path) -> None:
    kept(tmp_path, SET)
    whole = (tmp_path / COPY).read_bytes()
    for length in range(0, len(whole), 7):
        (tmp_path / COPY).write_bytes(whole[:length])
        assert kept_twice.opened(tmp_path / COPY) is None
    (tmp_path / COPY).write_bytes(whole)
    assert kept_twice.opened(tmp_path / COPY) is not None


def test_a_plan_is_copied_every_two_hours_and_a_word_at_once(tmp_path: Path) -> None:
    copies = []
    with KeptTwice(tmp_path) as store:
        for k in range(48):
            made = plan(planned(session()), made_at=EVENING + k * timedelta(minutes=30))
            mode = Mode.OFF if k == 5 else Mode.SMART
            store.save(replace(SET, plan=made, overrides=Overrides(mode=mode)))
            copies.append((tmp_path / COPY).read_bytes())
    changes = sum(a != b for a, b in itertools.pairwise(copies))
    assert 12 <= changes <= 14


def test_a_copy_that_cannot_be_written_is_said_and_the_database_has_it(tmp_path: Path) -> None:
    with KeptTwice(tmp_path) as store:
        (tmp_path / COPY).mkdir()
        (tmp_path / (COPY + ".new")).mkdir()
        with pytest.raises(StoreError, match=r"memory\.json"):
            store.save(SET)
        assert store.load() == SET


def test_a_memory_that_cannot_be_read_is_taken_from_the_copy(tmp_path: Path) -> None:
    kept(tmp_path, SET)
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute("UPDATE memory SET body = x'00'")
    db.close()
    assert loaded(tmp_path) == (SET, True)
    (tmp_path / COPY).unlink()
    with KeptTwice(tmp_path) as store, pytest.raises(StoreError, match="cannot be read"):
        store.load()
