"""The experiments with a figure, and those beyond the paper: what they write, and that their numbers hold together."""

import csv
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, time, timedelta
from itertools import islice
from math import sqrt
from pathlib import Path
from typing import Any

import pytest

from plugd.cli import main
from plugd.domain import Intensity
from plugd.study import crowd, drawing, flexibility, table, variants
from plugd.study.crowd import Crowd
from plugd.study.engine import Account, Flow
from plugd.study.flexibility import Profile
from plugd.study.forecasts import Delayed, Noise
from plugd.study.measured import Measured
from plugd.study.runs import paper_run, simulated
from plugd.study.variants import Variant
from plugd.study.world import Driver
from plugd.units import HALF_HOUR
from tests.study.files import written
from tests.study.test_engine import FOUND, START

FIGURES = {
    "week": ("week_soc", "week_co2"),
    "flexibility": ("flexibility",),
    "credits": ("credits",),
    "forecast": ("forecast",),
    "crowd": ("crowd",),
    "variants": (),
}
SMALL = {"week": ("--days", "3"), "crowd": ("--cars", "1", "--days", "2"), "variants": ("--horizons", "1")}


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("study") / "series.csv", days=11)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer drivers, variants and shares than a figure shows: every run of a test costs."""
    monkeypatch.setattr(flexibility, "PROFILES", (Profile("overnight", 12, 5.0), Profile("daytime", 4, 30.0)))
    monkeypatch.setattr(variants, "VARIANTS", (Variant(2.3, True, False), Variant(2.3, False, False)))


def asked(capsys: pytest.CaptureFixture[str], name: str, series: Path, *more: str) -> dict[str, Any]:
    chosen = SMALL.get(name, ("--days", "2"))
    where = () if name == "forecast" else ("--workers", "1")
    assert main(["study", name, "--actual", str(series), *chosen, *where, "--json", *more]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    document: dict[str, Any] = json.loads(captured.out)
    return document


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("name", FIGURES)
def test_an_experiment_writes_its_numbers_and_its_figures(
    name: str, series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = asked(capsys, name, series, "--out", str(tmp_path))
    endings = {f"{figure}.{kind}" for figure in FIGURES[name] for kind in ("png", "svg")}
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.csv", f"{name}.json", *endings}
    with (tmp_path / f"{name}.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found["rows"]) > 0
    assert json.loads((tmp_path / f"{name}.json").read_text())["rows"] == found["rows"]
    for figure in FIGURES[name]:
        drawn = (tmp_path / f"{figure}.svg").read_text()
        assert "dc:date" not in drawn
        assert 'width="252pt"' in drawn  # 3.5 inches


def test_a_figure_has_the_same_bytes_every_time_and_whatever_the_style(
    series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import matplotlib as mpl  # noqa: PLC0415 - an extra

    asked(capsys, "forecast", series, "--out", str(tmp_path / "one"))
    with mpl.rc_context({"axes.facecolor": "pink", "font.size": 20.0}):
        asked(capsys, "forecast", series, "--out", str(tmp_path / "two"))
    for name in ("forecast.png", "forecast.svg", "forecast.csv", "forecast.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_without_matplotlib_the_remedy_is_said(
    series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["study", "forecast", "--actual", str(series), "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith("figures need Matplotlib; pip install 'plugd[study]'\n")


def test_the_week_s_curves_add_up(series: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = asked(capsys, "week", series)
    first, last = found["rows"][0], found["rows"][-1]
    for total in found["totals"]:
        name = table.name(table.Choice(total["strategy"], total["horizon"]))
        carbon = [row[f"carbon_g {name}"] for row in found["rows"]]
        assert carbon[0] == 0.0
        assert carbon == sorted(carbon)
        assert carbon[-1] == pytest.approx(total["carbon_g"], abs=0.1)
        charging = [(a, b) for a, b in zip(found["rows"], found["rows"][1:], strict=False)
                    if b[f"carbon_g {name}"] > a[f"carbon_g {name}"]]  # fmt: skip
        assert charging
        assert all(a["connected"] or b["connected"] for a, b in charging)
        assert all(b[f"soc_pct {name}"] > a[f"soc_pct {name}"] - 13 for a, b in charging)
    assert first["at"] == "2023-01-08T12:00:00Z"
    assert last["at"] == "2023-01-11T12:00:00Z"


def test_the_forecast_s_error_grows_from_the_one_step_error(series: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = asked(capsys, "forecast", series)["rows"]
    assert len(rows) == 96
    for k, row in enumerate(rows):
        off = abs(row["forecast_g_per_kwh"] / row["actual_g_per_kwh"] - 1)
        assert off == pytest.approx(0.05 * (1 + 9.97e-3 * k), abs=0.002)


def test_a_driver_by_day_leaves_on_the_day_of_arrival() -> None:
    driver = Driver("UTC", time(11, 0), time(15, 0), sd_h=0.0, use_kwh=5.0, use_sd_kwh=0.0)
    stays = list(islice(driver.stays(datetime(2023, 1, 1, tzinfo=UTC)), 3))
    assert [(s.arrival.day, s.arrival.hour, s.departure.day, s.departure.hour) for s in stays] == [
        (1, 11, 1, 15), (2, 11, 2, 15), (3, 11, 3, 15),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("profile", "window"),
    [
        (Profile("overnight", 20, 5.0), (time(15), time(11))),
        (Profile("overnight", 4, 5.0), (time(23), time(3))),
        (Profile("daytime", 20, 5.0), (time(3), time(23))),
        (Profile("daytime", 4, 5.0), (time(11), time(15))),
    ],
)
def test_the_stays_of_figure_4(profile: Profile, window: tuple[time, time]) -> None:
    assert profile.window == window


def test_the_driver_of_30_kwh_a_day_is_always_ready(series: Path) -> None:
    """Four hours at noon and 30 kWh a day: the battery has no room for anything but charging every day."""
    end = START + timedelta(days=6)
    run = flexibility.run(Profile("daytime", 4, 30.0), FOUND, START, end, Noise.TARGET, end_value=True)
    account = simulated(run)
    assert account.missed == 0
    assert all(night.driven_kwh == pytest.approx(30.0) for night in account.nights)
    assert [night.charged_kwh for night in account.nights[1:]] == pytest.approx([30.0] * 4, abs=1.5)


def test_credits_are_even_at_the_pool_s_own_mean() -> None:
    rows = [
        {"stay": "overnight", "length_h": 12, "use_kwh": 5.0, "carbon_g_per_kwh": 80.0, "energy_kwh": 100.0},
        {"stay": "daytime", "length_h": 4, "use_kwh": 30.0, "carbon_g_per_kwh": 140.0, "energy_kwh": 300.0},
    ]
    found = flexibility.credited(rows, 100.0)
    assert [row["credit_g_per_kwh"] for row in found] == [20.0, -40.0]
    pool = flexibility.pool(found)
    assert (pool["under_g"], pool["over_g"], pool["net_g"]) == (2000.0, 12000.0, -10000.0)
    assert pool["even_at_g_per_kwh"] == 125.0
    assert flexibility.pool(flexibility.credited(rows, 125.0))["net_g"] == 0.0


class Counting:
    """A forecast that says how many half hours past the first of 2023 a slot is."""

    def expected(self, now: datetime, slots: Sequence[datetime]) -> list[float]:
        assert min(slots) > now - HALF_HOUR  # what is over is not asked for
        return [(at - START) / HALF_HOUR for at in slots]

    def history(self, now: datetime) -> tuple[Intensity, ...]:
        return ()


def test_a_delayed_car_sees_each_intensity_later() -> None:
    night = START + timedelta(hours=8)
    slots = [night + k * HALF_HOUR for k in range(20)]
    plain = Counting().expected(night, slots)
    seen = {seed: Delayed(Counting(), seed, 3.0) for seed in range(30)}
    delays = set()
    for forecasts in seen.values():
        found = forecasts.expected(night, slots)
        delay = int(plain[-1] - found[-1])
        delays.add(delay)
        assert found[delay:] == plain[: len(plain) - delay]
        assert found[:delay] == [max(plain)] * delay  # before what it has seen, nothing is worth charging in
        later = forecasts.expected(night + 2 * HALF_HOUR, slots[2:])
        assert later[max(0, delay - 2) :] == found[max(2, delay) :]
    assert delays == set(range(7))


def test_a_delayed_car_is_ready_all_the_same() -> None:
    plain = paper_run("mpc", FOUND, START, START + timedelta(days=6), horizon=1)
    late = replace(plain, issue_seed=0, delay_h=4.0)
    before, after = simulated(plain), simulated(late)
    assert before.missed == after.missed == 0
    assert before.flows != after.flows
    assert "delayed up to 4 h" in str(late)


def test_a_crowd_raises_the_intensity_it_charges_at() -> None:
    """Two half hours: all who plan take 10 kWh in the first, all others in the second."""
    found = Measured("two", START, (100.0, 200.0), (0.0, 0.0))

    def account(slot: int) -> Account:
        moment = START + slot * HALF_HOUR
        plain = simulated(paper_run("uncontrolled", FOUND, START, START + timedelta(days=2)))
        return replace(plain, flows=(Flow(moment, moment + HALF_HOUR, 10.0, 0.5),))

    asked = Crowd(fleet=1e6, slope_g_per_kwh_gw=2.0, shares=(0.0, 0.5, 1.0))
    rows = crowd.rows(asked, found, [(None, account(1)), (0.0, account(0))])
    assert [row["carbon_g_per_kwh"] for row in rows] == [100.0, 120.0, 140.0]  # 10 kWh in half an hour: 20 GW
    assert [row["reduction_pct"] for row in rows] == [50.0, 40.0, 30.0]
    assert [row["peak_gw"] for row in rows] == [0.0, 10.0, 20.0]


def test_the_interval_of_a_mean() -> None:
    assert table.half_width_95([1.0, 2.0, 3.0]) == pytest.approx(4.303 / sqrt(3))
    assert table.half_width_95([1.0]) is None
    many = [float(k % 2) for k in range(40)]
    assert table.half_width_95(many) == pytest.approx(1.96 * 0.5064 / sqrt(40), rel=1e-3)


def test_variants_differ_in_plug_and_end_value_alone() -> None:
    houses = [variant.household for variant in variants.VARIANTS]
    assert {(house.capability.power_max_kw, house.capability.modulating) for house in houses} == {
        (10.0, True), (10.0, False), (2.3, True), (2.3, False),
    }  # fmt: skip
    asked = list(variants.runs(FOUND, START, START + timedelta(days=2), (1, 4), Noise.TARGET, 2))
    assert len(asked) == len(variants.VARIANTS) * 3 * 2
    assert all(run.world.household.end_value is variant.end_value for variant, run in asked)
    assert {replace(run.world.household.nights, horizon=1) for _, run in asked} == {
        replace(houses[0].nights, horizon=1)
    }


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("week", "--from", "2023-02-01"), "--from, --to: series.csv goes from 2023-01-01 to 2023-01-12"),
        (("week", "--from", "yesterday"), "'yesterday' is no date"),
        (("variants", "--horizons", "1,8"), "'8' is not 1 to 7 nights"),
        (("crowd", "--days", "0"), "'0' is not a whole number above 0"),
    ],
)
def test_what_cannot_be_done_is_said_on_one_line(
    arguments: tuple[str, ...], said: str, series: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(["study", *arguments, "--actual", str(series)])
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1


def test_regions_and_table_have_figures_too(tmp_path: Path, series: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = [
        {
            "regionid": region,
            "strategy": name,
            "horizon": horizon,
            "carbon_g_per_kwh": 100.0 * region / (horizon or 0.5),
        }
        for region in (1, 7, 99)
        for name, horizon in (("uncontrolled", None), ("mpc", 1), ("mpc", 4))
    ]
    drawing.regions(tmp_path, [*found, {**found[0], "regionid": 2, "carbon_g_per_kwh": None}])
    assert (tmp_path / "regions.png").stat().st_size > 10_000
    asked = ["study", "table", "--actual", str(series), "--strategies", "1", "--seeds", "1", "--workers", "1", "--json"]
    assert main([*asked, "--out", str(tmp_path)]) == 0
    assert (tmp_path / "table.svg").is_file()
