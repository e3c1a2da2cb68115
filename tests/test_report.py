"""`plugd report`: every number is recomputed here from the raw log, and every form says the same."""

import csv
import io
import json
import re
from collections import defaultdict
from contextlib import redirect_stdout
from dataclasses import dataclass
from datetime import datetime, timedelta
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from plugd.adapters.store import SqliteStore
from plugd.book import Book
from plugd.cli import main
from plugd.domain import PastRow, SetSoc
from plugd.past import CatchUp
from plugd.units import HALF_HOUR, slot_start
from tests.unit.deciding import HOME, Room, at, knows

START = at(13, 30)
NIGHTS = 3
CONFIG = """
[plug]
topic = "ev-plug"
[relay]
random_delay_s = 0
[home]
timezone = "Europe/London"
"""


class Grid:
    """A grid that is cleaner than forecast after midnight."""

    region = "13"
    measures = True

    def past(self, start: datetime, end: datetime) -> tuple[PastRow, ...]:
        """90 before noon, 210 after."""
        slots = (start + k * HALF_HOUR for k in range((end - start) // HALF_HOUR))
        return tuple(PastRow(slot, None, 90.0 if slot.hour < 12 else 210.0) for slot in slots)


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A configuration whose state holds three nights, driven in between."""
    folder = tmp_path_factory.mktemp("report")
    path = folder / "plugd.toml"
    path.write_text(f'{CONFIG}[state]\ndir = "{folder / "state"}"\n')
    room = Room(START, knows(0.43, START))
    with SqliteStore(folder / "state") as store:
        room.cycle.store = store
        room.cycle.book = Book(store, HOME)
        room.cycle.errands = (CatchUp(Grid(), store, lambda: 0.0),)
        for night in range(NIGHTS):
            room.hub.said.append(SetSoc(0.43 + 0.02 * night, "car"))
            room.run(START + timedelta(days=night + 1))
        room.run(START + timedelta(days=NIGHTS, hours=12))
    return path


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(list(arguments)) == 0
    return capsys.readouterr().out


@dataclass(frozen=True, slots=True)
class Made:
    """A report in JSON and HTML."""

    answer: dict[str, Any]
    html: str


@pytest.fixture(scope="module")
def made(config: Path) -> Made:
    """Both forms, of one call."""
    out = config.parent / "report.html"
    with redirect_stdout(io.StringIO()) as text:
        assert main(["-c", str(config), "report", "--json", "--out", str(out), "--horizons", "4"]) == 0
    return Made(json.loads(text.getvalue()), out.read_text(encoding="utf-8"))


def night_day(moment: datetime) -> str:
    return (moment - timedelta(hours=13, minutes=30)).date().isoformat()


def test_every_number_agrees_with_the_raw_log(config: Path, made: Made) -> None:
    """Energy from the meter's totals in the log; grams from what was measured, else from the forecast kept."""
    answer = made.answer
    with SqliteStore(config.parent / "state", hold=False) as store:
        log = store.records(START)
        final = {row.start for row in store.half_hours(START) if row.final_g_per_kwh is not None}
        measured = {value.start: value.g_per_kwh for value in store.measured(START)}
        expected = {slot_start(f.issued_at): f.expected[0].g_per_kwh for f in store.issued(START)}
    flows: dict[datetime, float] = defaultdict(float)
    for before, after in pairwise(log):
        assert before.energy_kwh is not None
        assert after.energy_kwh is not None
        flows[slot_start(before.at)] += after.energy_kwh - before.energy_kwh
    level = {slot: measured[slot] if slot in final else expected[slot] for slot in expected}
    assert len(final) > 48
    assert sum(flows.values()) > 10.0
    for night in answer["nights"]:
        slots = {s: kwh for s, kwh in flows.items() if night_day(s) == night["night"]}
        kwh = sum(slots.values())
        assert night["kwh"] == pytest.approx(kwh, abs=2e-3)
        assert night["carbon_g"] == pytest.approx(sum(k * level[s] for s, k in slots.items()), abs=0.2)
        assert night["on_arrival_g"] == pytest.approx(
            on_arrival_g(kwh, at(18, day=int(night["night"][-2:])), level), abs=0.3
        )
        assert night["saved_g"] == pytest.approx(night["on_arrival_g"] - night["carbon_g"], abs=0.15)
    whole = answer["total"]
    assert whole["nights"] == len(answer["nights"]) >= NIGHTS
    for key in ("kwh", "carbon_g", "on_arrival_g", "best_g", "saved_g", "switch_ons"):
        assert whole[key] == pytest.approx(sum(night[key] for night in answer["nights"]), abs=0.5)
        assert answer["months"][0][key] == pytest.approx(whole[key], abs=0.5)
    assert whole["switch_ons"] == sum(b.on and not a.on for a, b in pairwise(log))
    assert whole["g_per_kwh"] == pytest.approx(whole["carbon_g"] / whole["kwh"], abs=0.01)


def on_arrival_g(kwh: float, arrival: datetime, level: dict[datetime, float]) -> float:
    """The plug's 2.3 kW from arrival on, minute by minute."""
    grams, moment = 0.0, arrival
    while kwh > 0.0:
        part = min(kwh, 2.3 / 60)
        grams += part * level[slot_start(moment)]
        kwh -= part
        moment += timedelta(minutes=1)
    return grams


def test_json_and_csv_say_the_same(config: Path, made: Made, capsys: pytest.CaptureFixture[str]) -> None:
    answer = made.answer
    rows = list(csv.DictReader(io.StringIO(said(capsys, "-c", str(config), "report", "--csv"))))
    assert [float(row["carbon_g"]) for row in rows] == [night["carbon_g"] for night in answer["nights"]]
    assert set(rows[0]) == set(answer["nights"][0])
    for row, night in zip(rows, answer["nights"], strict=True):
        for key in ("arrival_told", "missed", "final"):
            assert row[key] == {True: "1", False: "0"}[night[key]], "what a spreadsheet in any language can add up"
    assert {night["final"] for night in answer["nights"]} == {True, False}
    assert answer["horizons"][0]["horizon"] == 4
    assert answer["horizons"][0]["kwh"] > 0.0
    assert answer["forecast"][0]["half_hours"] > 0


def test_the_terminal_says_the_total_and_a_line_a_night(
    config: Path, made: Made, capsys: pytest.CaptureFixture[str]
) -> None:
    text = said(capsys, "-c", str(config), "report")
    answer = made.answer
    assert f"{answer['total']['kwh']:.1f} kWh in {answer['total']['nights']} nights" in text
    for night in answer["nights"]:
        day = datetime.fromisoformat(night["night"])
        assert re.search(rf"^{day:%a %d %b}\s+{night['kwh']:.1f}\s", text, re.MULTILINE)


def test_days_counts_the_last_nights(config: Path, made: Made, capsys: pytest.CaptureFixture[str]) -> None:
    rows = list(csv.DictReader(io.StringIO(said(capsys, "-c", str(config), "report", "--csv", "--days", "2"))))
    assert [row["night"] for row in rows] == [night["night"] for night in made.answer["nights"][-2:]]


class Outside(HTMLParser):
    """Whatever a page would fetch from somewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect."""
        self.tags.append(tag)
        self.found += [f"{tag} {name}={value}" for name, value in attrs if name in ("src", "href", "action")]
        self.found += [tag] if tag in ("script", "link", "iframe", "object", "embed", "base") else []


def test_the_page_needs_nothing_else_and_has_the_totals(made: Made) -> None:
    answer, html = made.answer, made.html
    reader = Outside()
    reader.feed(html)
    assert reader.found == []
    assert reader.tags.count("svg") > 4
    assert "url(" not in html
    assert "@import" not in html
    assert f"<dd>{answer['total']['kwh']:.1f} kWh" in html
    for night in answer["nights"]:
        assert f"<td>{night['kwh']:.1f}</td>" in html
    for replay in answer["horizons"]:
        assert f"<td>{replay['kwh']:.1f}</td>" in html


def test_without_a_ledger_it_says_so_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plugd.toml"
    path.write_text(f'{CONFIG}[state]\ndir = "{tmp_path / "none"}"\n')
    assert main(["-c", str(path), "report"]) == 1
    SqliteStore(tmp_path / "none").close()
    assert main(["-c", str(path), "report"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "nothing was charged yet" in lines[0]
    assert "the ledger is empty" in lines[1]


@pytest.mark.parametrize("bad", [("--days", "0"), ("--horizons", "9"), ("--horizons", "x"), ("--json", "--csv")])
def test_impossible_wishes_are_usage_errors(config: Path, bad: tuple[str, ...]) -> None:
    try:
        code = main(["-c", str(config), "report", *bad])
    except SystemExit as end:
        code = int(str(end.code))
    assert code == 2


def test_a_replay_of_the_same_horizon_is_near_what_was_done(made: Made) -> None:
    assert made.answer["horizons"][0]["horizon"] == 4
    assert made.answer["horizons"][0]["g_per_kwh"] == pytest.approx(made.answer["total"]["g_per_kwh"], rel=0.15)
