"""How much of perfect foresight's saving is captured with forecasts as they were really issued.

One driver in every zone, in UTC and without randomness, so that zones and horizons differ by their forecasts alone.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, time
from statistics import fmean
from typing import Any

from plugd.domain import Nights
from plugd.study.engine import Account, World
from plugd.study.forecasts import Noise
from plugd.study.issued import Issues
from plugd.study.runs import PAPER, Failure, Run
from plugd.study.telling import columns
from plugd.study.world import Driver

HOUSE = replace(
    PAPER,
    nights=Nights(plug_in=time(20, 0), plug_in_sd_min=0.0, plug_out=time(7, 0), plug_out_sd_min=0.0),
)
"""Plans with 20:00 to 07:00 and 11.28 kWh."""
DRIVER = Driver(timezone="UTC", arrival=time(18, 0), departure=time(9, 0), sd_h=0.0, use_kwh=5.8, use_sd_kwh=0.0)
FORESIGHT = 4
"""Horizon of the perfect foresight that is 100 %."""


def runs(
    issues: Issues,
    start: datetime,
    end: datetime,
    horizons: Iterable[int],
    *,
    learn: bool = True,
    corrected: bool = True,
) -> list[Run]:
    """One zone: charging without control, perfect foresight, and every horizon on the issued forecasts.

    `learn`: these replace the planned window and use by what was seen of the driver; perfect foresight never does.
    `corrected`: the outlook learns from how wrong the forecasts were.
    """

    def run(name: str, horizon: int) -> Run:
        house = replace(HOUSE, nights=replace(HOUSE.nights, horizon=horizon, learn=learn and name == "mpc"))
        world = World(house, DRIVER, start, end)
        return Run(name, world, issues.found, Noise.NONE, issues=issues, corrected=corrected)

    return [run("uncontrolled", 1), run("perfect", FORESIGHT), *(run("mpc", horizon) for horizon in horizons)]


def document(outcomes: Mapping[str, Sequence[tuple[Run, Account | Failure]]]) -> dict[str, Any]:
    """The outcomes of each file's runs for programs, and the means over files. Runs that failed are left out."""
    files = [_file(name, found) for name, found in outcomes.items()]
    shares: dict[int, list[float]] = {}
    for strategy in (row for file in files for row in file["strategies"]):
        if strategy["captured_pct"] is not None:
            shares.setdefault(strategy["horizon"], []).append(strategy["captured_pct"])
    means = [{"horizon": n, "captured_pct": round(fmean(found), 3), "files": len(found)} for n, found in shares.items()]
    return {"files": files, "means": means}


def _file(name: str, found: Sequence[tuple[Run, Account | Failure]]) -> dict[str, Any]:
    accounts = [(run, account) for run, account in found if isinstance(account, Account)]
    by_name = {run.strategy: account.carbon_g_per_kwh for run, account in accounts}
    uncontrolled, perfect = by_name.get("uncontrolled"), by_name.get("perfect")
    return {
        "file": name,
        "uncontrolled": _rounded(uncontrolled),
        "perfect": _rounded(perfect),
        "strategies": [
            {
                "horizon": run.horizon,
                "carbon_g_per_kwh": _rounded(account.carbon_g_per_kwh),
                "captured_pct": _rounded(captured_pct(uncontrolled, account.carbon_g_per_kwh, perfect)),
                "missed_mornings": account.missed,
            }
            for run, account in accounts
            if run.strategy == "mpc"
        ],
    }


def captured_pct(uncontrolled: float | None, ours: float | None, perfect: float | None) -> float | None:
    """Our share of perfect foresight's saving; None where it saves nothing. All in g/kWh."""
    if uncontrolled is None or ours is None or perfect is None or uncontrolled <= perfect:
        return None
    return 100.0 * (uncontrolled - ours) / (uncontrolled - perfect)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def table(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row a file and horizon."""
    bounds = ("file", "uncontrolled", "perfect")
    return [{**{key: file[key] for key in bounds}, **row} for file in found["files"] for row in file["strategies"]]


def lines(found: Mapping[str, Any]) -> list[str]:
    """The same for people: a line a file, a column a horizon."""
    horizons = [mean["horizon"] for mean in found["means"]]
    rows: list[Sequence[object]] = [("captured %", "uncontrolled", "perfect", *(f"N={n}" for n in horizons))]
    for file in found["files"]:
        shares = {row["horizon"]: _shown(row["captured_pct"]) for row in file["strategies"]}
        bounds = (_shown(file["uncontrolled"]), _shown(file["perfect"]))
        rows.append((file["file"], *bounds, *(shares.get(n) for n in horizons)))
    rows.append(("mean", "", "", *(_shown(mean["captured_pct"]) for mean in found["means"])))
    return columns(rows)


def _shown(value: float | None) -> str | None:
    return None if value is None else f"{value:.1f}"
