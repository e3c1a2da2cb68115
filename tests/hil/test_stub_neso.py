"""The stub NESO server: the API's shapes, forecast errors as specified, recorded forecasts moved to now."""

import json
import math
import signal
import socketserver
import statistics
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import requests

from plugd.adapters.neso import Neso
from plugd.errors import UsageError
from plugd.series import IntensitySeries, load
from plugd.units import HALF_HOUR, slot_start
from plugd_hil.neso import serve
from plugd_hil.neso_answers import Refused, answer_to
from plugd_hil.neso_faults import NAMES, rows_in
from plugd_hil.neso_source import (
    Replay,
    SeriesSource,
    Shifted,
    Snapshot,
    Source,
    forecast_error,
    from_file,
    from_folder,
    shift_to,
)
from plugd_hil.synthetic import synthetic_year

ROOT = Path(__file__).parents[2]
T0 = datetime(2023, 1, 9, 12, 0, tzinfo=UTC)
FORECAST = tuple(float(100 + k % 48) for k in range(480))
ACTUAL = tuple(float(300 + k % 48) for k in range(480))
SERIES = IntensitySeries(T0 - 96 * HALF_HOUR, ACTUAL, FORECAST)
SOURCE = SeriesSource({None: SERIES}, seed=3)
Q48 = "/intensity/2023-01-09T12:00Z/fw48h"


def asked(path: str, now: datetime = T0, source: Source = SOURCE, boundary: bool = False) -> list[dict[str, Any]]:
    return rows_in(answer_to(path, source, now, boundary))


def stamps(rows: list[dict[str, Any]]) -> tuple[str, str, int]:
    return rows[0]["from"], rows[-1]["to"], len(rows)


# -- endpoints and shapes -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "first", "last", "count"),
    [
        (Q48, "2023-01-09T12:00Z", "2023-01-11T12:00Z", 96),
        ("/intensity/2023-01-09T12:13Z/fw48h", "2023-01-09T12:00Z", "2023-01-11T12:00Z", 96),
        ("/intensity/2023-01-09T12:00Z/fw24h", "2023-01-09T12:00Z", "2023-01-10T12:00Z", 48),
        ("/intensity/2023-01-09T12:00Z/pt24h", "2023-01-08T12:00Z", "2023-01-09T12:00Z", 48),
        ("/intensity/2023-01-09T12:00Z", "2023-01-09T12:00Z", "2023-01-09T12:30Z", 1),
        ("/intensity", "2023-01-09T11:30Z", "2023-01-09T12:00Z", 1),
        ("/intensity/2023-01-08T00:00Z/2023-01-09T00:00Z", "2023-01-08T00:00Z", "2023-01-09T00:00Z", 48),
        ("/intensity/date", "2023-01-09T00:00Z", "2023-01-10T00:00Z", 48),
        ("/intensity/date/2023-01-08", "2023-01-08T00:00Z", "2023-01-09T00:00Z", 48),
        ("/intensity/date/2023-01-08/3", "2023-01-08T01:00Z", "2023-01-08T01:30Z", 1),
    ],
)
def test_every_national_endpoint_gives_its_half_hours(path: str, first: str, last: str, count: int) -> None:
    assert stamps(asked(path)) == (first, last, count)


def test_a_national_row_has_the_apis_shape() -> None:
    (row,) = asked("/intensity/2023-01-09T10:00Z")
    assert row == {
        "from": "2023-01-09T10:00Z",
        "to": "2023-01-09T10:30Z",
        "intensity": {"forecast": 144, "actual": 344, "index": "moderate"},
    }


def test_a_region_is_an_object_without_actual() -> None:
    path = "/regional/intensity/2023-01-09T12:00Z/fw48h/regionid/13"
    answer = answer_to(path, SOURCE, T0)["data"]
    assert {key: answer[key] for key in ("regionid", "dnoregion", "shortname")} == {
        "regionid": 13,
        "dnoregion": "UKPN London",
        "shortname": "London",
    }
    assert len(answer["data"]) == 96
    assert answer["data"][0].keys() == {"from", "to", "intensity", "generationmix"}
    assert answer["data"][0]["intensity"].keys() == {"forecast", "index"}
    place = answer_to("/regional/intensity/2023-01-09T12:00Z/fw24h/postcode/SW1", SOURCE, T0)["data"]
    assert place["postcode"] == "SW1"
    assert len(place["data"]) == 48


def test_asked_on_the_half_hour_the_boundary_fault_adds_the_one_before() -> None:
    assert stamps(asked(Q48, boundary=True)) == ("2023-01-09T11:30Z", "2023-01-11T12:00Z", 97)
    assert len(asked("/intensity/2023-01-09T12:13Z/fw48h", boundary=True)) == 96


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("/intensity/today/fw48h", "valid datetime in ISO8601"),
        ("/intensity/2023-01-01T00:00Z/2023-01-16T00:00Z", "14 days"),
        ("/intensity/2023-01-02T00:00Z/2023-01-01T00:00Z", "14 days"),
        ("/regional/intensity/2023-01-09T12:00Z/fw48h/regionid/99", "region ID"),
        ("/regional/intensity/2023-01-09T12:00Z/fw48h/regionid/x", "region ID"),
        ("/regional/intensity/2023-01-09T12:00Z/fw48h/postcode/SW1A1AA", "No postcode match"),
        ("/intensity/date/2023-13-01", "valid datetime"),
        ("/nothing", "not found"),
    ],
)
def test_a_bad_question_is_refused_in_the_apis_words(path: str, says: str) -> None:
    with pytest.raises(Refused, match=says):
        answer_to(path, SOURCE, T0)


def test_a_bare_date_is_answered_with_nothing() -> None:
    assert answer_to("/intensity/2023-01-09/fw48h", SOURCE, T0) == {}


def test_errors_have_the_apis_body_and_status() -> None:
    server = serve(SOURCE, lambda: T0)
    try:
        refused = requests.get(f"{server.url}/intensity/x", timeout=5)
        assert refused.status_code == 400
        assert refused.json()["error"]["code"] == "400 Bad Request"
        server.fault = "500"
        outage = requests.get(f"{server.url}{Q48}", timeout=5)
        assert outage.status_code == 500
        assert outage.json()["error"]["message"] == "Requested resource not found."
    finally:
        server.close()


# -- what is told when ----------------------------------------------------------------------------


def test_an_actual_appears_an_hour_after_its_half_hour() -> None:
    path = "/intensity/2023-01-09T12:00Z"
    end = T0 + HALF_HOUR
    assert asked(path, end + timedelta(minutes=59))[0]["intensity"]["actual"] is None
    assert asked(path, end + timedelta(minutes=60))[0]["intensity"]["actual"] == 300


def test_no_actual_of_the_future_is_told() -> None:
    assert all(row["intensity"]["actual"] is None for row in asked(Q48))


def test_the_half_hour_under_way_and_the_past_are_as_the_file_has_them() -> None:
    assert asked(Q48)[0]["intensity"]["forecast"] == 100
    past = asked("/intensity/2023-01-09T12:00Z/pt24h")
    assert [row["intensity"]["forecast"] for row in past] == [round(100.0 + k % 48) for k in range(48)]


def test_nothing_is_known_beyond_48_hours() -> None:
    assert stamps(asked("/intensity/2023-01-10T12:00Z/fw48h")) == ("2023-01-10T12:00Z", "2023-01-11T12:00Z", 48)


def test_half_hours_missing_in_the_file_are_missing_in_the_answer() -> None:
    holes = [None if 100 <= k < 104 else value for k, value in enumerate(FORECAST)]
    source = SeriesSource({None: IntensitySeries(SERIES.start, tuple(holes), tuple(holes))})
    rows = asked(Q48, source=source)
    assert len(rows) == 92
    assert "2023-01-09T14:00Z" not in {row["from"] for row in rows}


def test_where_the_file_has_no_forecast_its_actual_is_used() -> None:
    source = SeriesSource({None: IntensitySeries(SERIES.start, ACTUAL, (None,) * len(ACTUAL))})
    assert asked(Q48, source=source)[0]["intensity"]["forecast"] == 300


def test_the_same_question_at_the_same_time_gives_the_same_bytes_and_another_seed_others() -> None:
    again = SeriesSource({None: SERIES}, seed=3)
    assert asked(Q48) == asked(Q48, T0 + timedelta(minutes=29), again)
    assert asked(Q48) != asked(Q48, source=SeriesSource({None: SERIES}, seed=4))


def test_the_forecast_error_grows_from_nothing_to_a_fifth_at_48_hours() -> None:
    def sd(lead: int) -> float:
        return statistics.pstdev(forecast_error(f"{seed}/None", T0, T0 + lead * HALF_HOUR) for seed in range(1500))

    assert sd(0) == 0.0
    assert 0.02 < sd(1) < sd(8) < sd(30)
    assert sd(96) == pytest.approx(0.2, rel=0.08)


def test_the_forecast_error_keeps_97_percent_of_itself_per_half_hour() -> None:
    pairs = [
        (
            forecast_error(f"{seed}/None", T0, T0 + 95 * HALF_HOUR),
            forecast_error(f"{seed}/None", T0, T0 + 96 * HALF_HOUR),
        )
        for seed in range(1500)
    ]
    assert statistics.correlation([a for a, _ in pairs], [b for _, b in pairs]) == pytest.approx(0.97, abs=0.01)


def test_the_next_issue_has_the_same_error_less_what_became_known() -> None:
    target = T0 + 40 * HALF_HOUR
    one = forecast_error("0/None", T0, T0 + HALF_HOUR)
    expected = forecast_error("0/None", T0, target) - 0.97**39 * one
    assert forecast_error("0/None", T0 + HALF_HOUR, target) == pytest.approx(expected)


# -- recorded forecasts ---------------------------------------------------------------------------

STAMP = datetime(2023, 3, 14, 3, 31, tzinfo=UTC)  # a Tuesday


def snapshot(stamp: datetime, count: int, value: float) -> Snapshot:
    values = (value,) * count
    return Snapshot(stamp, {None: IntensitySeries(slot_start(stamp), (None,) * count, values)})


REPLAY = Replay((snapshot(STAMP, 96, 100.0), snapshot(STAMP + timedelta(hours=3), 29, 200.0)))


def test_a_replay_gives_the_newest_forecast_not_younger_than_now_and_leaves_short_lists_short() -> None:
    early, late = STAMP + timedelta(minutes=5), STAMP + timedelta(hours=3, minutes=5)
    rows = asked("/intensity/2023-03-14T03:30Z/fw48h", early, REPLAY)
    assert len(rows) == 96
    assert {row["intensity"]["forecast"] for row in rows} == {100}
    rows = asked("/intensity/2023-03-14T06:30Z/fw48h", late, REPLAY)
    assert len(rows) == 29
    assert {row["intensity"]["forecast"] for row in rows} == {200}
    assert asked("/intensity/2023-03-14T03:00Z/fw48h", STAMP - timedelta(minutes=5), REPLAY) == []


@pytest.mark.parametrize("days", [0, 1, 7, 8, 364, 1348, -6])
def test_a_record_is_moved_so_that_it_covers_now(days: int) -> None:
    now = STAMP + timedelta(days=days, hours=5)
    shift = shift_to(REPLAY.span(), now)
    assert shift % timedelta(days=1) == timedelta(0)
    moved = Shifted(REPLAY, shift)
    first, last = moved.span()
    assert first <= now < last
    rows = asked(f"/intensity/{slot_start(now):%Y-%m-%dT%H:%MZ}/fw48h", now, moved)
    assert rows[0]["from"] == f"{slot_start(now):%Y-%m-%dT%H:%MZ}"


@pytest.mark.parametrize("weeks", [1, 5, 51, 52, 191])
def test_on_the_records_own_weekday_weekday_and_time_agree(weeks: int) -> None:
    now = STAMP + timedelta(weeks=weeks, hours=9)
    assert shift_to(REPLAY.span(), now) == timedelta(weeks=weeks)


def test_a_year_is_moved_by_years_and_a_minute_cannot_be() -> None:
    year = (T0, T0 + timedelta(days=365))
    assert shift_to(year, T0 + timedelta(days=1200)) == timedelta(weeks=156)
    with pytest.raises(UsageError, match="under a day"):
        shift_to((T0, T0 + HALF_HOUR), T0 + timedelta(days=3, hours=5))


def test_a_folder_of_recorded_forecasts_is_read(tmp_path: Path) -> None:
    (tmp_path / "2023-03-14T0331Z.csv").write_text("from,forecast\n2023-03-14T03:30Z,69\n", encoding="ascii")
    (tmp_path / "regional_2023-03-14T0401Z.csv").write_text(
        "from,regionid,forecast\n2023-03-14T04:00Z,13,7\n", encoding="ascii"
    )
    (tmp_path / "notes.csv").write_text("?", encoding="ascii")
    replay = from_folder(tmp_path)
    now = STAMP + timedelta(hours=1)
    assert [snapshot.stamp for snapshot in replay.snapshots] == [STAMP, STAMP + HALF_HOUR]
    assert replay.row(None, STAMP - timedelta(minutes=1), now) is not None
    assert replay.row(13, STAMP.replace(hour=4, minute=0), now) is not None
    assert not replay.knows(12)
    with pytest.raises(UsageError, match="holds no recorded forecast"):
        from_folder(tmp_path / "none")


def test_the_measured_snapshots_and_year_can_be_served(neso_data: Path) -> None:
    replay = from_folder(neso_data / "neso_fw48h")
    now = datetime(2023, 3, 14, 17, 5, tzinfo=UTC)
    rows = asked("/intensity/2023-03-14T17:00Z/fw48h", now, replay)
    assert (len(rows), rows[0]["intensity"]["forecast"]) == (96, 176)
    year = from_file(neso_data / "neso_national_2023.csv", seed=0)
    recorded = load(neso_data / "neso_national_2023.csv")
    rows = asked("/intensity/2023-01-02T12:00Z/fw48h", datetime(2023, 1, 2, 12, 0, tzinfo=UTC), year)
    known = [recorded.expected_at(datetime.fromisoformat(row["from"])) for row in rows]
    assert None not in known
    assert len(rows) == 96


# -- the synthetic year ---------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_the_synthetic_year_is_like_britains(seed: int) -> None:
    series = synthetic_year(seed)
    values = [value for value in series.actual if value is not None]
    assert len(values) == 365 * 48
    assert min(values) >= 40
    assert max(values) <= 300
    assert statistics.fmean(values) == pytest.approx(150, abs=12)
    assert statistics.pstdev(values) == pytest.approx(55, abs=12)
    night = [value for moment, value in zip(series.times(), values, strict=True) if moment.hour in {2, 3}]
    evening = [value for moment, value in zip(series.times(), values, strict=True) if moment.hour in {18, 19}]
    assert statistics.fmean(evening) - statistics.fmean(night) > 30
    assert statistics.correlation(values[:-96], values[96:]) == pytest.approx(0.4, abs=0.2)
    assert statistics.correlation(values[:-1], values[1:]) > 0.95


def test_the_synthetic_year_is_the_same_for_the_same_seed_and_begins_where_wanted() -> None:
    assert synthetic_year(1, days=3) == synthetic_year(1, days=3)
    assert synthetic_year(1, days=3) != synthetic_year(2, days=3)
    assert synthetic_year(1, T0, days=2).start == T0
    assert synthetic_year(1, T0, days=2).end == T0 + timedelta(days=2)


# -- the program ----------------------------------------------------------------------------------


@contextmanager
def running(*arguments: str) -> Iterator[int]:
    """The stub as a program; yields its port."""
    command = [sys.executable, "-m", "plugd_hil.neso", *arguments]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        try:
            yield json.loads(program.stdout.readline())["port"]
        finally:
            program.send_signal(signal.SIGTERM)
            assert program.wait(10) == 0


def test_as_a_program_on_a_simulated_clock_it_answers_plugds_own_source(tmp_path: Path) -> None:
    path = tmp_path / "series.csv"
    lines = [f"{T0 + k * HALF_HOUR:%Y-%m-%dT%H:%MZ},{100 + k % 7},{100 + k % 7}" for k in range(200)]
    path.write_text("from,forecast,actual\n" + "\n".join(lines) + "\n", encoding="ascii")
    now = T0 + timedelta(minutes=11)

    class Time(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            for line in self.rfile:
                assert json.loads(line) == {"ask": "now"}
                self.wfile.write(json.dumps({"now": now.isoformat()}).encode() + b"\n")

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True

    with Server(("127.0.0.1", 0), Time) as clock:
        threading.Thread(target=clock.serve_forever, args=(0.05,), daemon=True).start()
        with running("--source", str(path), "--clock", f"127.0.0.1:{clock.server_address[1]}") as port:
            forecast = Neso(f"http://127.0.0.1:{port}", None, None).fetch(now)
        clock.shutdown()
    assert len(forecast.expected) == 96
    assert forecast.expected[0].start == T0
    assert forecast.expected[0].g_per_kwh == 100.0


@pytest.mark.parametrize("arguments", [(), ("--as-of", "2023-06-01T12:00Z"), ("--seed", "5")])
def test_as_a_program_on_the_real_clock_it_covers_now(arguments: tuple[str, ...]) -> None:
    with running(*arguments) as port:
        rows = requests.get(f"http://127.0.0.1:{port}/intensity", timeout=5).json()["data"]
        begin = datetime.fromisoformat(rows[0]["to"])
        forecast = Neso(f"http://127.0.0.1:{port}", 13, None).fetch(begin + timedelta(minutes=1))
    assert len(forecast.expected) >= 95
    assert all(math.isfinite(value.g_per_kwh) for value in forecast.expected)


def test_the_program_tells_an_unusable_source_in_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "plugd_hil.neso", "--source", str(tmp_path / "none.csv")]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.count("\n") == 1
    assert "none.csv" in ended.stderr


@pytest.mark.parametrize("fault", NAMES)
def test_every_fault_can_be_asked_for_and_ends_with_the_server(fault: str) -> None:
    server = serve(SOURCE, lambda: T0, fault=fault)
    try:
        with pytest.raises(requests.RequestException) if fault in ENDLESS else nothing():
            requests.get(f"{server.url}{Q48}", timeout=0.2, allow_redirects=False)
        assert server.asked == [Q48]
    finally:
        server.close()


ENDLESS = ("silent", "drip", "drip_head", "broken")


@contextmanager
def nothing() -> Iterator[None]:
    yield
