"""The replay of issued forecasts: nothing is known before its time, and perfect forecasts capture everything."""

import csv
import json
import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import pytest

from plugd.cli import main
from plugd.errors import UsageError
from plugd.study import backtest, issued
from plugd.study.issued import Issues, Replayed
from plugd.study.runs import Run, simulated
from plugd.units import HALF_HOUR
from plugd_hil.synthetic import synthetic_year

START = datetime(2023, 1, 1, tzinfo=UTC)
ACTUAL = [g or 0.0 for g in synthetic_year(days=24).actual[::2]]
DAYS = 10


def written(path: Path, leads_h: int = 96, wrong: float = 0.1) -> Path:
    """Ten daily issues whose error changes its sign every few hours."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(issued.COLUMNS)
        for day in range(DAYS):
            at = START + timedelta(days=day)
            for lead in range(leads_h):
                actual = ACTUAL[24 * day + lead]
                off = wrong if (day + lead // 5) % 2 else -wrong
                writer.writerow((f"{at:%Y-%m-%dT%H:%MZ}", lead, round(actual * (1 + off), 2), actual))
    return path


@pytest.fixture(scope="module")
def issues(tmp_path_factory: pytest.TempPathFactory) -> Issues:
    return issued.load(written(tmp_path_factory.mktemp("issued") / "zone.csv"))


def runs(issues: Issues, *horizons: int) -> list[Run]:
    return backtest.runs(issues, START + timedelta(hours=12), issues.found.end, horizons)


def seen_at(moment: datetime) -> int:
    """How many half hours are over for an hour, both halves of an hour together."""
    return max(0, 2 * int((moment - START) / timedelta(hours=1) - 1))


def test_a_forecast_counts_from_its_stamp_and_an_actual_an_hour_after_its_hour(issues: Issues) -> None:
    replay = Replayed(issues, corrected=False)
    stamp = START + timedelta(days=3)
    (before,) = replay.expected(stamp - timedelta(seconds=1), [stamp])
    (after,) = replay.expected(stamp, [stamp])
    assert before == issues.expected[2][48]
    assert after == issues.expected[3][0]
    ten = START + timedelta(hours=10)
    assert replay.history(ten - timedelta(seconds=1))[-1].start == START + timedelta(hours=7.5)
    assert replay.history(ten)[-1].start == START + timedelta(hours=8.5)
    assert replay.history(START) == replay.history(START - HALF_HOUR) == ()


@pytest.mark.parametrize("after_h", [12.0, 30.2, 95.5, 143.99])
def test_what_is_not_yet_known_is_not_touched(issues: Issues, after_h: float) -> None:
    """Poison all that becomes known later: no number may turn into none."""
    now = START + timedelta(hours=after_h)
    known = seen_at(now)
    actual = tuple(g if k < known else math.nan for k, g in enumerate(issues.found.actual))
    later = tuple(values if at <= now else () for at, values in zip(issues.issued, issues.expected, strict=True))
    poisoned = Replayed(replace(issues, found=replace(issues.found, actual=actual), expected=later))
    first = now.replace(minute=30 * (now.minute // 30), second=0, microsecond=0)
    slots = [first + k * HALF_HOUR for k in range(48 * 7)]
    expected = poisoned.expected(now, slots)
    assert not any(math.isnan(g) for g in expected)
    assert expected == Replayed(issues).expected(now, slots)
    assert poisoned.history(now) == Replayed(issues).history(now)
    assert len(poisoned.history(now)) == known


def test_what_happens_later_changes_nothing_before(issues: Issues) -> None:
    until = START + timedelta(days=6, hours=1)
    known = seen_at(until)
    other = tuple(g if k < known else 300.0 - g for k, g in enumerate(issues.found.actual))
    expected = tuple(
        values if at <= until else tuple(300.0 - g for g in values)
        for at, values in zip(issues.issued, issues.expected, strict=True)
    )
    changed = replace(issues, found=replace(issues.found, actual=other), expected=expected)
    (run,), (again,) = (runs(which, 3)[2:] for which in (issues, changed))
    before, after = (simulated(one).flows for one in (run, again))
    assert [flow for flow in before if flow.start < until] == [flow for flow in after if flow.start < until]
    assert before != after


def test_forecasts_that_come_true_capture_everything(tmp_path: Path) -> None:
    """They reach 4 nights ahead at any hour, as perfect foresight does."""
    issues = issued.load(written(tmp_path / "true.csv", leads_h=144, wrong=0.0))
    asked = runs(issues, 1, 4)
    found = backtest.document({"true": [(run, simulated(run)) for run in asked]})
    one, four = found["files"][0]["strategies"]
    assert four["captured_pct"] == pytest.approx(100.0, abs=0.5)
    assert 0.0 < one["captured_pct"] < 100.0
    assert one["missed_mornings"] == four["missed_mornings"] == 0


def test_beyond_its_end_the_daemon_s_tail_goes_on(issues: Issues) -> None:
    now = START + timedelta(days=9)
    slots = [now + k * HALF_HOUR for k in range(48 * 5)]
    expected = Replayed(issues, corrected=False).expected(now, slots)
    assert tuple(expected[: 48 * 4]) == issues.expected[9]
    tail = expected[48 * 4 :]
    assert min(tail) > 0.0
    assert len({round(b - a, 6) for a, b in pairwise(tail)}) > 20  # a shape, not a line


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = written(tmp_path / "zone.csv"), tmp_path / "out"
    asked = [
        "study",
        "backtest",
        "--data",
        str(path),
        "--horizons",
        "1,4",
        "--from",
        "2023-01-02",
        "--to",
        "2023-01-09",
    ]
    assert main([*asked, "--json", "--workers", "1", "--out", str(out)]) == 0
    found = json.loads(capsys.readouterr().out)
    (file,) = found["files"]
    assert set(file) == {"file", "uncontrolled", "perfect", "strategies"}
    assert [set(row) for row in file["strategies"]] == 2 * [
        {"horizon", "carbon_g_per_kwh", "captured_pct", "missed_mornings"}
    ]
    for row in file["strategies"]:
        saved, possible = file["uncontrolled"] - row["carbon_g_per_kwh"], file["uncontrolled"] - file["perfect"]
        assert row["captured_pct"] == pytest.approx(100 * saved / possible, abs=0.05)
    assert [mean["captured_pct"] for mean in found["means"]] == [row["captured_pct"] for row in file["strategies"]]
    # Four weeks have to be seen before anything is learned: here it changes nothing.
    assert main([*asked, "--json", "--workers", "1", "--learn", "off"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == found["files"]
    with (out / "backtest.csv").open(newline="") as rows:
        assert [row["horizon"] for row in csv.DictReader(rows)] == ["1", "4"]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("2023-01-01T00:00Z,x,1,1", "line 2: invalid literal"),
        ("2023-01-01T00:00Z,0,nan,1", "line 2: no number"),
        ("2023-01-01T00:00Z,-1,1,1", "line 2: lead_h -1 is over"),
        ("2023-01-01T00:00,0,1,1", "line 2: '2023-01-01T00:00' is not a time"),
        ("2023-01-01T00:10Z,0,1,1", "is not a whole hour"),
        ("", "holds no forecasts"),
    ],
)
def test_a_file_that_cannot_be_meant_is_refused(tmp_path: Path, line: str, said: str) -> None:
    path = tmp_path / "zone.csv"
    path.write_text(f"issued,lead_h,forecast,actual\n{line}\n")
    with pytest.raises(UsageError, match=said):
        issued.load(path)
