"""`plugd dump`: what is configured, what is stored, and which of the two counts."""

import json
from dataclasses import replace
from datetime import UTC, datetime, time
from pathlib import Path

import pytest

from plugd.adapters.store import SqliteStore
from plugd.cli.program import main
from plugd.domain import Forecast, Intensity, Memory, Mode, Overrides
from plugd.soc import unknown

NOW = datetime(2023, 1, 2, 22, tzinfo=UTC)


def dump(folder: Path, capsys: pytest.CaptureFixture[str], more: str = "") -> dict[str, object]:
    """The document, for a configuration in `folder`."""
    path = folder / "plugd.toml"
    path.write_text(f'[plug]\ntopic = "garage"\n[state]\ndir = "state"\n{more}')
    assert main(["-c", str(path), "dump"]) == 0
    document: dict[str, object] = json.loads(capsys.readouterr().out)
    return document


def test_it_says_what_is_configured_and_what_is_only_the_default(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = dump(tmp_path, capsys)
    configuration = document["configuration"]
    assert isinstance(configuration, dict)
    assert configuration["plug"]["topic"] == "garage"
    assert configuration["nights"]["horizon"] == 4
    defaults = document["not_in_the_file"]
    assert isinstance(defaults, list)
    assert "nights.horizon" in defaults
    assert "plug.topic" not in defaults
    assert "nothing is stored yet" in str(document["state"])
    assert not (tmp_path / "state").exists()


def test_what_hub_or_page_set_wins_and_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = Overrides(mode=Mode.OFF, minimum=0.7, ready_by=time(6, 30))
    with SqliteStore(tmp_path / "state") as store:
        store.save(replace(Memory(unknown(NOW)), overrides=said))
        store.keep(Forecast(NOW, "national", (Intensity(NOW, 100.0),)))
    document = dump(tmp_path, capsys)
    assert document["wins_over_the_file"] == {
        "mode": "off",
        "nights.morning_minimum_pct": 0.7,
        "nights.ready_by": "06:30:00",
    }
    forecast = document["forecast"]
    assert isinstance(forecast, dict)
    assert forecast["half_hours"] == 1
    assert "memory" in document


def test_nothing_is_said_to_win_where_nothing_was_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with SqliteStore(tmp_path / "state") as store:
        store.save(Memory(unknown(NOW)))
    document = dump(tmp_path, capsys)
    assert document["wins_over_the_file"] == {}
    assert document["forecast"] is None


def test_a_store_that_cannot_be_read_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "state").write_text("a file where a folder should be")
    assert "is no folder" in str(dump(tmp_path, capsys)["state"])
