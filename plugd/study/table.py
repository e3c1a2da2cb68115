"""The paper's Table I: carbon per kWh and reduction by strategy, over seeds; and the same for every region."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from math import sqrt
from statistics import fmean, stdev
from typing import Any

from plugd.study.engine import Account
from plugd.study.forecasts import PAPER_GROWTH, Noise
from plugd.study.measured import Measured
from plugd.study.runs import PLANNING, Failure, Run, paper_run

BASE = "uncontrolled"
"""What reductions are against, in the same seed."""
STUDENT_975 = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228,
    2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
    2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip
"""The 97.5 % quantile of Student's t for 1, 2, ... degrees of freedom; the normal one beyond."""
NORMAL_975 = 1.960


@dataclass(frozen=True, slots=True)
class Choice:
    """One row: a strategy, with its horizon where it plans."""

    name: str
    horizon: int | None = None


@dataclass(frozen=True, slots=True)
class Terms:
    """What all rows of a table share."""

    noise: Noise = Noise.TARGET
    end_value: bool = True
    solver: str = "exact"
    seeds: int = 5
    growth: float = PAPER_GROWTH
    learn: bool = False
    """Whether planning learns the driver; perfect foresight never does."""


def rows(chosen: Iterable[Choice]) -> tuple[Choice, ...]:
    """The chosen rows, what they are compared with, and perfect foresight for each horizon among them."""
    chosen = tuple(chosen)
    horizons = (choice.horizon for choice in chosen if choice.name == "mpc")
    perfect = (Choice("perfect", horizon) for horizon in horizons)
    return tuple(dict.fromkeys((Choice(BASE), *chosen, *perfect)))


def runs(found: Measured, start: datetime, end: datetime, chosen: Iterable[Choice], terms: Terms) -> list[Run]:
    """The runs of a table, one a row and seed."""
    return [
        paper_run(
            choice.name,
            found,
            start,
            end,
            horizon=choice.horizon,
            seed=seed,
            noise=terms.noise,
            end_value=terms.end_value,
            solver=terms.solver,
            growth=terms.growth,
            learn=terms.learn and choice.name == "mpc",
        )
        for choice in rows(chosen)
        for seed in range(terms.seeds)
    ]


@dataclass(frozen=True, slots=True)
class Row:
    """A strategy over its seeds. Carbon and reductions are None where nothing was charged, or at no carbon."""

    choice: Choice
    carbon_g_per_kwh: float | None
    sd: float | None
    """Of carbon_g_per_kwh over seeds; None of a single one."""
    reduction_pct: float | None
    """Mean over seeds of the reduction against uncontrolled charging in the same seed."""
    reduction_ci95_pct: float | None
    """Half the width of its 95 % confidence interval over seeds (Student's t); None of a single one."""
    regret_g_per_kwh: float | None
    """Mean over seeds of what perfect foresight of as many nights would have saved besides."""
    energy_kwh: float
    """Mean a seed."""
    mornings: int
    """All seeds together."""
    missed_mornings: int
    missed_by_pct: float
    """How far the worst of them was missed, in points of SOC."""
    switch_ons_per_night: float


def tabulated(runs: Sequence[Run], outcomes: Sequence[Account | Failure]) -> list[Row]:
    """The rows of one world's runs, in their order. Seeds that failed are left out, and rows without any."""
    accounts: dict[Choice, dict[int, Account]] = defaultdict(dict)
    for run, outcome in zip(runs, outcomes, strict=True):
        if isinstance(outcome, Account):
            accounts[Choice(run.strategy, run.horizon)][run.seed] = outcome
    base = accounts.get(Choice(BASE), {})
    return [
        _row(choice, seeds, base, accounts.get(Choice("perfect", choice.horizon), {}))
        for choice, seeds in accounts.items()
    ]


def _row(choice: Choice, seeds: dict[int, Account], base: dict[int, Account], perfect: dict[int, Account]) -> Row:
    carbons = [g for account in seeds.values() if (g := account.carbon_g_per_kwh) is not None]
    cuts = (reduction_pct(account, base.get(seed)) for seed, account in seeds.items())
    reductions = [cut for cut in cuts if cut is not None]
    regrets = [
        ours - theirs
        for seed, account in seeds.items()
        if seed in perfect
        and (ours := account.carbon_g_per_kwh) is not None
        and (theirs := perfect[seed].carbon_g_per_kwh) is not None
    ]
    nights = sum(len(account.nights) for account in seeds.values())
    return Row(
        choice=choice,
        carbon_g_per_kwh=fmean(carbons) if carbons else None,
        sd=stdev(carbons) if len(carbons) > 1 else None,
        reduction_pct=fmean(reductions) if reductions else None,
        reduction_ci95_pct=half_width_95(reductions),
        regret_g_per_kwh=fmean(regrets) if regrets else None,
        energy_kwh=fmean(account.energy_kwh for account in seeds.values()),
        mornings=nights,
        missed_mornings=sum(account.missed for account in seeds.values()),
        missed_by_pct=max((100.0 * n.morning.missed_by for a in seeds.values() for n in a.nights), default=0.0),
        switch_ons_per_night=sum(account.switch_ons for account in seeds.values()) / max(1, nights),
    )


def half_width_95(values: Sequence[float]) -> float | None:
    """Half the width of the 95 % confidence interval of a mean; None of fewer than two values."""
    if len(values) < 2:
        return None
    degrees = len(values) - 1
    quantile = STUDENT_975[degrees - 1] if degrees <= len(STUDENT_975) else NORMAL_975
    return quantile * stdev(values) / sqrt(len(values))


def reduction_pct(account: Account, base: Account | None) -> float | None:
    """Carbon per kWh saved against `base`, in percent of it; None where there is nothing to compare."""
    ours, theirs = account.carbon_g_per_kwh, None if base is None else base.carbon_g_per_kwh
    return 100.0 * (1.0 - ours / theirs) if ours is not None and theirs else None


def document(found: Iterable[Row]) -> dict[str, list[dict[str, Any]]]:
    """Rows for programs: the strategies, and beside them perfect foresight by horizon."""
    found = list(found)
    shown = [
        {
            "strategy": row.choice.name,
            "horizon": row.choice.horizon,
            "carbon_g_per_kwh": _rounded(row.carbon_g_per_kwh, 3),
            "sd": _rounded(row.sd, 3),
            "reduction_pct": _rounded(row.reduction_pct, 3),
            "reduction_ci95_pct": _rounded(row.reduction_ci95_pct, 3),
            "regret_g_per_kwh": _rounded(row.regret_g_per_kwh, 3),
            "energy_kwh": round(row.energy_kwh, 3),
            "mornings": row.mornings,
            "missed_mornings": row.missed_mornings,
            "missed_by_pct": round(row.missed_by_pct, 3),
            "switch_ons_per_night": round(row.switch_ons_per_night, 3),
        }
        for row in found
        if row.choice.name != "perfect"
    ]
    keys = ("horizon", "carbon_g_per_kwh", "reduction_pct")
    perfect = [row for row in found if row.choice.name == "perfect"]
    values = ((r.choice.horizon, _rounded(r.carbon_g_per_kwh, 3), _rounded(r.reduction_pct, 3)) for r in perfect)
    return {"rows": shown, "perfect": [dict(zip(keys, value, strict=True)) for value in values]}


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


HEADINGS = (
    "strategy", "g/kWh", "sd", "reduction %", "± 95 %", "regret g/kWh", "kWh", "mornings", "missed", "by points",
    "switch-ons",
)  # fmt: skip


def lines(found: Iterable[Row]) -> list[str]:
    """Rows for people."""
    cells = [HEADINGS] + [
        (
            name(row.choice),
            _shown(row.carbon_g_per_kwh, 2),
            _shown(row.sd, 2),
            _shown(row.reduction_pct, 2),
            _shown(row.reduction_ci95_pct, 2),
            _shown(row.regret_g_per_kwh, 2),
            f"{row.energy_kwh:.0f}",
            str(row.mornings),
            str(row.missed_mornings),
            _shown(row.missed_by_pct, 1),
            f"{row.switch_ons_per_night:.2f}",
        )
        for row in found
    ]
    widths = [max(len(line[k]) for line in cells) for k in range(len(HEADINGS))]
    return ["  ".join(_aligned(line, widths)).rstrip() for line in cells]


def _aligned(line: tuple[str, ...], widths: list[int]) -> Iterable[str]:
    return (
        cell.ljust(width) if k == 0 else cell.rjust(width)
        for k, (cell, width) in enumerate(zip(line, widths, strict=True))
    )


def name(choice: Choice) -> str:
    """How a row is called."""
    return choice.name if choice.name not in PLANNING else f"{choice.name} N={choice.horizon}"


def _shown(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
