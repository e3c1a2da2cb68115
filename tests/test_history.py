"""Past intensity from the API: in pages, politely, into a file, the store or a study."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from plugd import history, series
from plugd.adapters.neso import Neso
from plugd.adapters.store import SqliteStore
from plugd.cli import Parser, main
from plugd.config import load
from plugd.domain import Forecast, Intensity, PastRow
from plugd.errors import ConfigError, ForecastError, ForecastUnavailable, UsageError
from plugd.study import command
from plugd.units import HALF_HOUR
from plugd_hil.neso import StubNeso, serve
from plugd_hil.neso_source import SeriesSource
from plugd_hil.synthetic import synthetic_year
from tests.fakes import FakeClock, configured

YEAR = synthetic_year(days=60)
NOW = datetime(2023, 3, 1, tzinfo=UTC)


@pytest.fixture
def neso() -> Iterator[StubNeso]:
    server = serve(SeriesSource({None: YEAR}), lambda: NOW)
    yield server
    server.close()


@pytest.fixture
def config(neso: StubNeso, tmp_path: Path) -> Path:
    return configured(neso.url, tmp_path)


def quiet(words: str) -> None:
    """Nobody looks."""


def test_days_are_asked_for_in_pages_of_a_fortnight_one_a_second(neso: StubNeso) -> None:
    clock = FakeClock()
    began = clock.now()
    start, end = history.span(date(2023, 1, 3), date(2023, 2, 1))
    found = [row for page in history.fetched(Neso(neso.url, None, None), start, end, clock, quiet) for row in page]
    assert [path.split("/")[-2:] for path in neso.asked] == [
        ["2023-01-03T00:00Z", "2023-01-17T00:00Z"],
        ["2023-01-17T00:00Z", "2023-01-31T00:00Z"],
        ["2023-01-31T00:00Z", "2023-02-01T00:00Z"],
    ]
    assert clock.now() - began == timedelta(seconds=2)
    assert [row.start for row in found] == [start + k * HALF_HOUR for k in range(29 * 48)]
    assert all(row.actual == round(YEAR.actual_at(row.start) or 0.0) for row in found)


@pytest.mark.parametrize("fault", ["boundary", None])
def test_a_half_hour_outside_the_days_is_left_out(neso: StubNeso, fault: str | None) -> None:
    neso.fault = fault  # the API often answers from the half hour before on
    start = datetime(2023, 1, 3, tzinfo=UTC)
    found = Neso(neso.url, 13, None).past(start, start + timedelta(days=1))
    assert (found[0].start, found[-1].start) == (start, start + timedelta(hours=23.5))
    assert all(row.actual is None and row.forecast is not None for row in found)  # nobody measures a region


@dataclass(slots=True)
class Failing:
    """A source that fails some times first."""

    failures: list[Exception]
    region: str = "national"
    asked: list[datetime] = field(default_factory=list)

    def past(self, start: datetime, end: datetime) -> tuple[PastRow, ...]:
        self.asked.append(start)
        if self.failures:
            raise self.failures.pop(0)
        return (PastRow(start, 100.0, 90.0),)


def rows(source: Any, clock: FakeClock) -> list[tuple[PastRow, ...]]:
    start = datetime(2023, 1, 3, tzinfo=UTC)
    return list(history.fetched(source, start, start + timedelta(days=1), clock, quiet))


def test_an_outage_is_waited_out_with_longer_pauses_and_then_told() -> None:
    clock, source = FakeClock(), Failing([ForecastUnavailable("no answer")] * 3)
    began = clock.now()
    assert len(rows(source, clock)) == 1
    assert clock.now() - began == sum(history.RETRIES, timedelta())
    with pytest.raises(ForecastUnavailable):
        rows(Failing([ForecastUnavailable("no answer")] * 4), FakeClock())


def test_a_question_that_was_refused_is_not_asked_again() -> None:
    source = Failing([ForecastUnavailable("NESO answered 400: no such region; check home.region_id")])
    with pytest.raises(ForecastUnavailable):
        rows(source, FakeClock())
    assert len(source.asked) == 1


def test_a_csv_file_is_what_the_study_reads(config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "past.csv"
    asked = ("history", "fetch", "--from", "2023-01-03", "--to", "2023-01-06", "--out", str(out))
    assert main(["-c", str(config), *asked]) == 0
    assert capsys.readouterr().out == "region national: 144 half hours, 0 missing\n"
    found = series.load(out)
    assert (found.start, len(found.actual)) == (datetime(2023, 1, 3, tzinfo=UTC), 144)
    assert main(["-c", str(config), *asked, "--region", "7"]) == 0
    with out.open(newline="") as file:
        assert {row["regionid"] for row in csv.DictReader(file)} == {"7"}
    assert not (tmp_path / "state").exists()


def test_the_store_learns_what_it_did_not_know(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = datetime(2023, 1, 5, tzinfo=UTC)
    forecast = Forecast(start, "national", tuple(Intensity(start + k * HALF_HOUR, 77.0) for k in range(96)))
    folder = Path(load(config).state.dir)
    with SqliteStore(folder) as store:
        store.keep(forecast)
    asked = ("history", "fetch", "--from", "2023-01-03", "--to", "2023-01-06")
    assert main(["-c", str(config), *asked]) == 0
    capsys.readouterr()
    assert main(["-c", str(config), "history", "show"]) == 0
    line = capsys.readouterr().out
    assert line.startswith(
        "region national: 2023-01-03 00:00 to 2023-01-05 23:30 UTC, 144 half hours, 144 measured, 0 missing, mean "
    )
    with SqliteStore(folder) as store:
        seen = {value.start: value.g_per_kwh for value in store.history(start - timedelta(days=9))}
    first = datetime(2023, 1, 3, tzinfo=UTC)
    assert seen[first] == round(YEAR.actual_at(first) or 0.0)
    assert len(seen) == 144


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("fetch", "--from", "2023-01-03", "--to", "2023-01-03"), 2, "is not after --from"),
        (("fetch", "--from", "yesterday", "--to", "2023-01-03"), 2, "'yesterday' is no date"),
        (("fetch", "--from", "2023-01-03", "--to", "2023-01-04", "--region", "44"), 78, "NESO's regions are 1 to 17"),
        (("fetch", "--from", "2023-01-03", "--to", "2023-01-04", "--out", "/nowhere/x.csv"), 1, "cannot be written"),
        ((), 2, "required: fetch|show"),
    ],
)
def test_what_cannot_be_done_is_said_on_one_line(
    arguments: tuple[str, ...], code: int, said: str, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        ended = main(["-c", str(config), "history", *arguments])
    except SystemExit as end:
        ended = int(end.code or 0)
    captured = capsys.readouterr()
    assert ended == code
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""


def test_an_empty_store_says_how_to_fill_it(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["-c", str(config), "history", "show"]) == 0
    assert "plugd history fetch" in capsys.readouterr().out


def test_every_region_is_fetched_for_the_study(config: Path, neso: StubNeso) -> None:
    clock = FakeClock()
    began = clock.now()
    found = history.regions(load(config), date(2023, 1, 3), date(2023, 1, 4), clock, quiet)
    assert list(found) == list(range(1, 15))
    assert clock.now() - began == timedelta(seconds=13)
    assert all(len(one.forecast) == 48 and None not in one.forecast for one in found.values())
    with pytest.raises(ForecastError):
        history.regions(load(config), date(2029, 1, 3), date(2029, 1, 4), clock, quiet)


def test_the_study_of_regions_without_a_file_fetches(capsys: pytest.CaptureFixture[str]) -> None:
    asked: list[tuple[date, date]] = []

    def fetched(since: date, until: date) -> dict[int, series.IntensitySeries]:
        asked.append((since, until))
        return {3: synthetic_year(days=4)}

    arguments = ["regions", "--strategies", "uncontrolled", "--seeds", "1", "--workers", "1", "--from", "2023-02-01"]
    assert command.main(Parser(prog="plugd study"), [*arguments, "--to", "2023-02-05"], fetched) == 0
    assert asked == [(date(2023, 2, 1), date(2023, 2, 5))]
    assert "region 3" in capsys.readouterr().out
    with pytest.raises(UsageError):
        command.main(Parser(prog="plugd study"), arguments)


def test_a_region_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError):
        history.source_for(None, 18)
