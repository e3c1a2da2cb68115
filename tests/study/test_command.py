"""`plugd study table` and `regions`: numbers, files, and words for whoever asked for something impossible."""

import csv
import json
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from plugd.cli import main
from plugd_hil.synthetic import synthetic_year
from tests.study.files import written

WALL = ("wall_s",)


@pytest.fixture(scope="module")
def year(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("study") / "six_days.csv", days=6)


@pytest.fixture(scope="module")
def areas(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four days of two regions, the second without any carbon."""
    path = tmp_path_factory.mktemp("study") / "areas.csv"
    found = synthetic_year(days=4)
    rows = (
        f"{at:%Y-%m-%dT%H:%MZ},{region},{(g or 0) * (2 - region)}"
        for at, g in zip(found.times(), found.actual, strict=True)
        for region in (1, 2)
    )
    path.write_text("\n".join(["from,regionid,forecast", *rows]))
    return path


def asked(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    assert main(["study", *map(str, arguments), "--workers", "1", "--json"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def test_the_table_has_a_row_a_strategy_and_perfect_foresight(year: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = asked(capsys, "table", "--actual", year, "--strategies", "uncontrolled,1,2,latest-start", "--seeds", 2)
    assert set(found) == {"rows", "perfect", "wall_s"}
    assert [(row["strategy"], row["horizon"]) for row in found["rows"]] == [
        ("uncontrolled", None), ("mpc", 1), ("mpc", 2), ("latest-start", None),
    ]  # fmt: skip
    assert [row["horizon"] for row in found["perfect"]] == [1, 2]
    assert set(found["perfect"][0]) == {"horizon", "carbon_g_per_kwh", "reduction_pct"}
    base, one, two, _ = found["rows"]
    assert set(base) == {
        "strategy", "horizon", "carbon_g_per_kwh", "sd", "reduction_pct", "energy_kwh", "mornings", "missed_mornings",
        "switch_ons_per_night", "reduction_ci95_pct", "regret_g_per_kwh", "missed_by_pct",
    }  # fmt: skip
    assert base["reduction_pct"] == 0.0
    assert base["mornings"] == 10
    assert one["missed_mornings"] == two["missed_mornings"] == 0
    assert 0.0 < one["reduction_pct"] < 60.0
    assert found["perfect"][1]["carbon_g_per_kwh"] <= two["carbon_g_per_kwh"]


def test_the_same_seeds_give_the_same_bytes_whoever_works(year: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def text(workers: int) -> str:
        arguments = ("--actual", str(year), "--strategies", "uncontrolled", "--seeds", "2", "--workers", str(workers))
        assert main(["study", "table", *arguments, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        found.pop("wall_s")
        return json.dumps(found)

    assert text(1) == text(2)


def test_without_noise_planning_is_perfect_foresight(year: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = asked(capsys, "table", "--actual", year, "--strategies", "2", "--seeds", 1, "--noise", "none")
    (row,) = [row for row in found["rows"] if row["strategy"] == "mpc"]
    assert row["carbon_g_per_kwh"] == found["perfect"][0]["carbon_g_per_kwh"]
    assert row["sd"] is None


def test_people_get_a_table_and_files(year: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "folder"
    assert main(["study", "table", "--actual", str(year), "--strategies", "1", "--seeds", "1", "--workers", "1",
                 "--out", str(out)]) == 0  # fmt: skip
    captured = capsys.readouterr()
    assert captured.err == ""  # nobody looks: no bar
    assert [line.split()[0] for line in captured.out.splitlines()] == ["strategy", "uncontrolled", "mpc", "perfect"]
    document = json.loads((out / "table.json").read_text())
    with (out / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["strategy"] for row in rows] == ["uncontrolled", "mpc", "perfect"]
    assert float(rows[1]["carbon_g_per_kwh"]) == document["rows"][1]["carbon_g_per_kwh"]


def test_regions_each_have_their_rows_and_a_mean(areas: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = asked(capsys, "regions", "--actual", areas, "--strategies", "1", "--seeds", 1)
    assert [(row["regionid"], row["strategy"]) for row in found["rows"]] == [
        (1, "uncontrolled"), (1, "mpc"), (2, "uncontrolled"), (2, "mpc"),
    ]  # fmt: skip
    assert found["rows"][3]["carbon_g_per_kwh"] == 0.0
    assert found["rows"][3]["reduction_pct"] is None  # of nothing
    (mean,) = [mean for mean in found["means"] if mean["strategy"] == "mpc"]
    assert mean == {"strategy": "mpc", "horizon": 1, "reduction_pct": found["rows"][1]["reduction_pct"], "regions": 1}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("table",), "plugd study table: the following arguments are required: --actual"),
        (("table", "--actual", "nowhere.csv"), "nowhere.csv: cannot be read"),
        (("table", "--actual", "YEAR", "--strategies", "8"), "'8' is none of"),
        (("table", "--actual", "YEAR", "--strategies", ","), "name at least one strategy"),
        (("table", "--actual", "YEAR", "--seeds", "0"), "'0' is not a whole number above 0"),
        (("table", "--actual", "YEAR", "--noise", "loud"), "invalid choice: 'loud'"),
        (
            ("table", "--actual", "YEAR", "--year", "2022"),
            "--year 2022: six_days.csv goes from 2023-01-01 to 2023-01-07",
        ),
        (("table", "--actual", "AREAS"), "the file has several regions"),
        (("regions", "--actual", "YEAR"), "has no column regionid"),
        (("regions", "--actual", "AREAS", "--noise", "target"), "name a file that has both with --error-from"),
        (("table", "--actual", "YEAR", "--growth-from", "YEAR"), "line 1: has no column lead_h"),
        ((), "required: EXPERIMENT"),
    ],
)
def test_what_cannot_be_done_is_said_on_one_line(
    arguments: tuple[str, ...], said: str, year: Path, areas: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [{"YEAR": str(year), "AREAS": str(areas)}.get(word, word) for word in arguments]
    try:
        code = main(["study", *given])
    except SystemExit as end:
        code = int(end.code or 0)
    captured = capsys.readouterr()
    assert code == 2
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""


def test_a_folder_that_cannot_be_written_is_a_failure(
    year: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    out = str(tmp_path / "file" / "below")
    assert (
        main(["study", "table", "--actual", str(year), "--strategies", "uncontrolled", "--seeds", "1", "--out", out])
        == 1
    )
    assert f"--out {out}: cannot be written" in capsys.readouterr().err


def test_the_reference_figures_in_small(neso_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """January 2023 as measured: the order of the paper's table, no morning missed."""
    lines = (neso_data / "neso_national_2023.csv").read_text().splitlines()
    path = tmp_path / "january.csv"
    path.write_text("\n".join(islice(lines, 1 + 31 * 48)))
    found = asked(capsys, "table", "--actual", path, "--strategies", "1,2,4", "--seeds", 1, "--end-value", "off")
    cuts = [row["reduction_pct"] for row in found["rows"]]
    assert cuts == sorted(cuts)
    assert cuts[-1] > 30.0
    assert sum(row["missed_mornings"] for row in found["rows"]) == 0
