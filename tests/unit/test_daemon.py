"""What the daemon starts with, and what it says in the log."""

import logging
import sqlite3
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from plugd import daemon
from plugd.adapters.house_mark import FILE, house_mark
from plugd.adapters.mqtt import Broker, MqttConnection
from plugd.adapters.store import SqliteStore
from plugd.cli.log import LogLine
from plugd.config import parse
from plugd.cycle import LOSS_TOLD_S
from plugd.domain import Answer, Decision, Fault, Forecast, Intensity, Memory, Status
from plugd.journal import Journal, is_news
from plugd.remedies import KNOWN
from plugd.soc import unknown
from tests.fakes import FakeClock

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


def test_a_store_that_was_damaged_is_said_for_a_day(tmp_path: Path) -> None:
    (tmp_path / "plugd.db").write_bytes(b"no database at all" * 500)
    config = parse(f'{PLUG}[state]\ndir = "{tmp_path}"\n')
    with SqliteStore(tmp_path) as store:
        cycle = daemon.cycle_for(config, FakeClock(NOW), MqttConnection(Broker(), "test"), store)
        (said,) = cycle.losses
        assert said.code == "history"
        assert "a new one is begun; the old one is" in said.text
        assert [fault.code for fault in cycle._seen(None).faults] == ["history"]
        cycle.began_s -= LOSS_TOLD_S
        assert cycle._seen(None).faults == ()
    with SqliteStore(tmp_path) as store:
        assert daemon.cycle_for(config, FakeClock(NOW), MqttConnection(Broker(), "test"), store).losses == ()


def test_houses_set_up_alike_start_at_other_times_and_each_keeps_its_own_over_restarts(tmp_path: Path) -> None:
    def seed(folder: Path) -> str:
        config = parse(f'{PLUG}[state]\ndir = "{folder}"\n')
        with SqliteStore(folder) as store:
            return daemon.cycle_for(config, FakeClock(NOW), MqttConnection(Broker(), "test"), store).controller.seed

    mine, yours = tmp_path / "mine", tmp_path / "yours"
    assert seed(mine) == seed(mine) != seed(yours) == seed(yours)
    (mine / FILE).write_bytes(b"torn")
    assert seed(mine) == seed(mine) != "torn"
    assert house_mark(Path("/dev/null")) != house_mark(Path("/dev/null")), "nothing is kept there, and nothing fails"


def test_the_log_says_why_and_what_fails_and_each_only_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="plugd")
    journal = Journal()
    silent = Fault("plug_silent", "plug ev-plug is silent")
    for decision in (
        None,
        DECISION,
        DECISION,
        replace(DECISION, faults=(silent,)),
        replace(
            DECISION, faults=(silent,), answers=(Answer("mode", True, "mode is now"), Answer("trip", False, "no date"))
        ),
        replace(DECISION, reason="Charging."),
    ):
        journal.note(decision)
    assert [(r.levelname, r.message) for r in caplog.records] == [
        ("INFO", "Waiting until 03:00."),
        ("WARNING", f"plug_silent: plug ev-plug is silent. {KNOWN['plug_silent'].remedy}"),
        ("INFO", "command mode: mode is now"),
        ("INFO", "command trip refused: no date"),
        ("INFO", "plug_silent: works again"),
        ("INFO", "Charging."),
    ]


@pytest.mark.parametrize(
    ("reason", "news"),
    [
        ("Waiting until 03:00: 120 g/kWh then, among the cleanest of 4 nights.", False),
        ("Waiting until 03:30: 88 g/kWh then, among the cleanest of 4 nights.", False),
        ("Waiting until 02:01: 88 g/kWh then, among the cleanest of 4 nights.", False),
        ("Waiting until 04:00: 120 g/kWh then, among the cleanest of 4 nights.", True),
        ("Waiting until 23:30: 120 g/kWh then, among the cleanest of 4 nights.", True),
        ("Charging until 03:00 at 120 g/kWh, among the cleanest of 4 nights.", True),
        ("Waiting until 03:00: 120 g/kWh then, among the cleanest of 4 nights. 06:57: 41 %, 9 % short.", True),
        ("Off.", True),
    ],
)
def test_other_figures_alone_are_no_news_but_another_hour_is(reason: str, news: bool) -> None:
    assert is_news(reason, "Waiting until 03:00: 131.5 g/kWh then, among the cleanest of 4 nights.") is news


def test_midnight_is_not_a_day_away() -> None:
    assert not is_news("Waiting until 00:20.", "Waiting until 23:50.")


def test_figures_that_creep_are_said_once_they_have_moved_an_hour(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="plugd")
    journal = Journal()
    for minute in range(0, 130, 13):
        journal.note(replace(DECISION, reason=f"Waiting until {2 + minute // 60:02}:{minute % 60:02}."))
    assert [record.message for record in caplog.records] == [
        "Waiting until 02:00.",
        "Waiting until 03:05.",
    ]


@pytest.mark.parametrize(
    ("level", "name", "plain", "journal"),
    [
        (logging.INFO, "plugd.adapters.mqtt", "said", "<6>said"),
        (logging.WARNING, "plugd", "WARNING: said", "<4>said"),
        (logging.ERROR, "uvicorn", "ERROR: uvicorn: said", "<3>uvicorn: said"),
        (logging.DEBUG, "plugd", "DEBUG: said", "<7>said"),
    ],
)
def test_a_line_of_the_log(level: int, name: str, plain: str, journal: str) -> None:
    record = logging.LogRecord(name, level, "", 0, "%s", ("said",), None)
    day, clock, line = LogLine(journal=False, named=False).format(record).split(" ", 2)
    assert datetime.fromisoformat(f"{day} {clock}").timestamp() == int(record.created)
    assert line == plain
    assert LogLine(journal=True, named=False).format(record) == journal
    assert LogLine(journal=True, named=True).format(record) == f"{journal[:3]}{name}: said"


def test_a_loop_without_a_decision_or_without_its_thread_is_ill() -> None:
    connection = MqttConnection(Broker("127.0.0.1", 1), "plugd-test")
    assert daemon.ailment(DECISION, connection) == "the thread of the broker's connection has ended"
    connection.start()
    assert daemon.ailment(DECISION, connection) is None
    assert daemon.ailment(None, connection) == "nothing could be decided"
    connection.close()
    assert daemon.ailment(DECISION, connection) == "the thread of the broker's connection has ended"
