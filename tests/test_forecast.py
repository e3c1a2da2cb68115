"""`plugd forecast`: every slot says where its number is from, and a broken API is shown in its own words."""

import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import pytest

from plugd.adapters.clock import utc_now
from plugd.adapters.store import SqliteStore
from plugd.cli import main
from plugd.domain import Decision, Forecast, Intensity, PastRow, Status
from plugd.foresight import Foresight, document, lines
from plugd.perception import fresh
from plugd.ports import Tally
from plugd.units import HALF_HOUR, slot_start
from plugd_hil.neso import StubNeso, serve
from plugd_hil.neso_source import SeriesSource, Shifted, shift_to
from plugd_hil.synthetic import synthetic_year
from tests.fakes import configured

YEAR = SeriesSource({None: synthetic_year()})


@pytest.fixture
def neso() -> Iterator[StubNeso]:
    server = serve(Shifted(YEAR, shift_to(YEAR.span(), utc_now())), utc_now)
    yield server
    server.close()


@pytest.fixture
def config(neso: StubNeso, tmp_path: Path) -> Path:
    return configured(neso.url, tmp_path)


def told(config: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    assert main(["-c", str(config), "forecast", "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def drawn(config: Path, capsys: pytest.CaptureFixture[str]) -> list[str]:
    assert main(["-c", str(config), "forecast"]) == 0
    return capsys.readouterr().out.splitlines()


def test_the_plan_is_told_in_local_time(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Pago Pago is 11 hours behind all the year."""
    config.write_text(config.read_text() + '[home]\ntimezone = "Pacific/Pago_Pago"\n[car]\ndaily_use_kwh = 20\n')
    assert main(["-c", str(config), "plan", "--json"]) == 0
    slots = json.loads(capsys.readouterr().out)["plan"]
    assert main(["-c", str(config), "plan"]) == 0
    _, *said = capsys.readouterr().out.splitlines()
    starts = [datetime.fromisoformat(slot["start"]) - timedelta(hours=11) for slot in slots]
    assert starts
    assert [line[:16] for line in said] == [f"{start:%a %d %b %H:%M}" for start in starts]


def past_of(level: float) -> list[PastRow]:
    """Eight weeks up to now."""
    end = slot_start(utc_now())
    return [PastRow(end - k * HALF_HOUR, level, level) for k in range(56 * 48, 3, -1)]


def test_each_slot_has_its_number_its_spread_and_its_source_and_nights_are_marked(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = told(config, capsys)
    slots = found["slots"]
    starts = [datetime.fromisoformat(slot["start"]) for slot in slots]
    assert all(b - a == HALF_HOUR for a, b in pairwise(starts))
    assert starts[0] == slot_start(datetime.fromisoformat(found["at"]))
    until = datetime.fromisoformat(found["forecast_until"])
    for slot, start in zip(slots, starts, strict=True):
        assert (slot["source"] == "tail") is (start >= until)
        assert slot["g_per_kwh"] >= 0.0
        assert slot["sd_g_per_kwh"] >= 0.0
    sessions = [slot["session"] for slot in slots]
    assert sorted({s for s in sessions if s}) == [1, 2, 3, 4]
    assert sessions[-1] == 4
    assert found["faults"] == []


def test_with_a_history_it_is_corrected_as_the_daemon_does(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with SqliteStore(config.parent / "state") as store:
        store.keep(Forecast(utc_now() - timedelta(hours=1), "national", ()))
        store.keep_past("national", past_of(150.0))
    found = told(config, capsys)
    assert found["history_half_hours"] > 50 * 48
    assert {slot["source"] for slot in found["slots"]} == {"corrected", "tail"}


def test_the_drawing_says_the_same(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told_lines = drawn(config, capsys)
    assert told_lines[0].startswith("NESO's forecast for the nation of ")
    assert told_lines[0].endswith("then the usual day, without own history yet.")
    hours = [line for line in told_lines if " g/kWh " in line]
    slots = told(config, capsys)["slots"]
    assert len(hours) in (len(slots) // 2, len(slots) // 2 + 1)
    assert any("*" in line and "night 1" in line for line in hours)
    assert {"neso", "usual day"} <= {line.split("  ")[-1] for line in hours}


@pytest.mark.parametrize(
    ("fault", "slots", "says"),
    [
        ("short29", 29, None),
        ("lastweek", 0, "no new forecast: NESO's answer has nothing after now"),
        ("empty", 0, "no new forecast: NESO's answer holds no half hours"),
        ("500", 0, "no new forecast: NESO answered 500"),
        ("x10", 0, "no new forecast: NESO's answer is not used"),
    ],
)
def test_a_broken_api_is_shown(
    fault: str, slots: int, says: str | None, config: Path, neso: StubNeso, capsys: pytest.CaptureFixture[str]
) -> None:
    neso.fault = fault
    found = told(config, capsys)
    assert sum(slot["source"] != "tail" for slot in found["slots"]) == slots
    assert [fault["text"][: len(says or "")] for fault in found["faults"]] == ([says] if says else [])
    told_lines = drawn(config, capsys)
    assert told_lines[0].startswith(
        "NESO's forecast" if slots else "There is no forecast for the nation: this is the usual"
    )
    assert (says is None) or told_lines[1].startswith(f"  ! {says}")


def test_values_ten_times_too_low_are_held_against_the_own_history(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with SqliteStore(config.parent / "state") as store:
        store.keep_past("national", past_of(2000.0))
    found = told(config, capsys)
    assert "right after 2000" in found["faults"][0]["text"]
    assert found["history_half_hours"] > 55 * 48
    assert {slot["source"] for slot in found["slots"]} == {"tail"}


def test_after_five_days_without_an_answer_the_usual_day_is_from_the_own_history(
    config: Path, neso: StubNeso, capsys: pytest.CaptureFixture[str]
) -> None:
    old = utc_now() - timedelta(days=5)
    with SqliteStore(config.parent / "state") as store:
        rows = tuple(Intensity(slot_start(old) + k * HALF_HOUR, 150.0) for k in range(96))
        store.keep_past("national", past_of(150.0))
        store.keep(Forecast(old, "national", rows))
    neso.fault = "500"
    told_lines = drawn(config, capsys)
    assert told_lines[0] == "There is no forecast for the nation: this is the usual day, from 56 days of own history."


def test_an_old_forecast_says_its_age(config: Path, neso: StubNeso, capsys: pytest.CaptureFixture[str]) -> None:
    old = utc_now() - timedelta(hours=20)
    with SqliteStore(config.parent / "state") as store:
        rows = tuple(Intensity(slot_start(old) + k * HALF_HOUR, 150.0) for k in range(96))
        store.keep(Forecast(old, "national", rows))
    neso.fault = "500"
    assert " (20 h old) reaches " in drawn(config, capsys)[0]


def test_the_score_of_the_last_month_is_shown(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    day = utc_now().date() - timedelta(days=3)
    with SqliteStore(config.parent / "state") as store:
        store.score(day, [Tally(day, who, 0, 6, 10, 10.0 * off, 0.0, 1000.0) for who, off in WHO.items()])
        store.score(day - timedelta(days=60), [Tally(day - timedelta(days=60), "ours", 0, 6, 10, 1e4, 0.0, 1e3)])
    score = told(config, capsys)["score"]
    assert {who: rows[0]["mean_abs_g_per_kwh"] for who, rows in score.items()} == WHO
    assert drawn(config, capsys)[-1].split() == ["0", "to", "6", "h", "14", "15", "30"]


WHO = {"ours": 14.0, "neso": 15.0, "persistence": 30.0}


def test_a_terminal_without_those_letters_gets_others(config: Path) -> None:
    words = [sys.executable, "-m", "plugd", "-c", str(config), "forecast"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    ended = subprocess.run(words, env=environment, capture_output=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "####" in io.BytesIO(ended.stdout).read().decode("ascii")


def test_without_a_night_to_come_it_says_so() -> None:
    now = datetime(2023, 1, 2, 22, tzinfo=UTC)
    nothing = Decision(now, fresh(now), Status.WAITING, "", (), None)
    found = Foresight(nothing, "13", ZoneInfo("Europe/London"), (), None, {})
    assert lines(found) == [
        "There is no forecast for region 13: this is the usual day, without own history yet.",
        "No night is coming, so nothing is looked ahead for.",
    ]
    assert document(found)["slots"] == []
