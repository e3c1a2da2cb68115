"""What the daemon starts with, and what it says in the log."""

import logging
import sqlite3
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from plugd import daemon
from plugd.adapters.store import SqliteStore
from plugd.config import parse
from plugd.domain import Answer, Decision, Fault, Forecast, Intensity, Memory, Status
from plugd.soc import unknown

NOW = datetime(2023, 1, 2, 22, tzinfo=UTC)
PLUG = '[plug]\ntopic = "ev-plug"\n'
LONDON = PLUG + "[home]\nregion_id = 13\n"
KEPT = Forecast(NOW, "national", (Intensity(NOW, 100.0),))
DECISION = Decision(NOW, Memory(unknown(NOW)), Status.WAITING, "Waiting until 03:00.", (), None)


def test_the_kept_forecast_is_gone_on_with(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        assert daemon.kept_forecast(store, parse(PLUG)) is None
        store.keep(KEPT)
        assert daemon.kept_forecast(store, parse(PLUG)) == KEPT


def test_a_forecast_for_another_place_is_not(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.keep(KEPT)
        assert daemon.kept_forecast(store, parse(LONDON)) is None


def test_one_that_cannot_be_read_does_not_stop_the_start(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with SqliteStore(tmp_path) as store:
        store.keep(KEPT)
    with sqlite3.connect(tmp_path / "plugd.db") as db:
        db.execute("UPDATE forecast SET rows = x'00'")
    db.close()
    with SqliteStore(tmp_path) as store:
        assert daemon.kept_forecast(store, parse(PLUG)) is None
    assert "forecast" in caplog.text


def test_the_log_says_why_and_what_fails_and_each_only_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="plugd")
    journal = daemon.Journal()
    silent = Fault("plug_silent", "plug ev-plug is silent")
    for decision in (
        None,
        DECISION,
        DECISION,
        replace(DECISION, faults=(silent,)),
        replace(DECISION, faults=(silent,), answers=(Answer("mode", True, "mode is now"),)),
        replace(DECISION, reason="Charging."),
    ):
        journal.note(decision)
    assert [(r.levelname, r.message) for r in caplog.records] == [
        ("INFO", "waiting_to_start: Waiting until 03:00."),
        ("WARNING", "plug_silent: plug ev-plug is silent"),
        ("INFO", "command mode: mode is now"),
        ("INFO", "plug_silent: works again"),
        ("INFO", "waiting_to_start: Charging."),
    ]
