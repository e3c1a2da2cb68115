"""A week seen closely: state of charge and cumulative carbon of three strategies (the paper's Figures 2 and 3)."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import takewhile
from typing import Any

from plugd.study import table
from plugd.study.engine import Account
from plugd.study.forecasts import Noise
from plugd.study.measured import Measured
from plugd.study.runs import Failure, Run, paper_run
from plugd.study.table import Choice
from plugd.units import HALF_HOUR, iso

SHOWN = (Choice("uncontrolled"), Choice("mpc", 1), Choice("mpc", 4))
WARM_UP = timedelta(days=7)
"""Simulated before what is shown, where the series has it: the first nights only fill the battery."""

Points = Sequence[tuple[datetime, float]]


@dataclass(frozen=True, slots=True)
class Week:
    """What is shown, by half hours: each curve (T,)."""

    at: tuple[datetime, ...]
    intensity: tuple[float, ...]
    stays: tuple[tuple[datetime, datetime], ...]
    soc: Mapping[Choice, tuple[float, ...]]
    carbon_g: Mapping[Choice, tuple[float, ...]]
    """Cumulative."""


def runs(found: Measured, start: datetime, end: datetime, noise: Noise, seed: int, *, end_value: bool) -> list[Run]:
    """One run a strategy, begun a week before `start` where the series allows."""
    before = max(start - WARM_UP, found.start)
    terms: dict[str, Any] = {"noise": noise, "seed": seed, "end_value": end_value}
    return [paper_run(shown.name, found, before, end, horizon=shown.horizon, **terms) for shown in SHOWN]


def week(found: Measured, start: datetime, end: datetime, outcomes: Sequence[Account | Failure]) -> Week:
    """The curves from `start` to `end`. Strategies whose run failed are left out."""
    accounts = {shown: o for shown, o in zip(SHOWN, outcomes, strict=True) if isinstance(o, Account)}
    at = tuple(takewhile(lambda moment: moment <= end, (start + k * HALF_HOUR for k in range(found.index(end) + 1))))
    nights = next(iter(accounts.values())).nights if accounts else ()
    return Week(
        at=at,
        intensity=tuple(found.actual[min(found.index(moment), len(found.actual) - 1)] for moment in at),
        stays=tuple((n.arrival, n.departure) for n in nights if n.departure > start and n.arrival < end),
        soc={shown: tuple(_between(_socs(account), m) for m in at) for shown, account in accounts.items()},
        carbon_g={shown: _since_first(_carbon(account, found), at) for shown, account in accounts.items()},
    )


def _since_first(points: Points, at: Sequence[datetime]) -> tuple[float, ...]:
    first = _between(points, at[0])
    return tuple(_between(points, moment) - first for moment in at)


def _socs(account: Account) -> Points:
    """Corners of the curve. While the car is away it is drawn as falling steadily."""
    flows = iter(account.flows)
    flow = next(flows, None)
    points = []
    for night in account.nights:
        points.append((night.arrival, night.arrival_soc))
        while flow is not None and flow.start < night.departure:
            points += [(flow.start, points[-1][1]), (flow.end, flow.soc)]
            flow = next(flows, None)
        points.append((night.departure, night.departure_soc))
    return points


def _carbon(account: Account, found: Measured) -> Points:
    points, total_g = [], 0.0
    for flow in account.flows:
        points.append((flow.start, total_g))
        total_g += flow.kwh * found.actual[found.index(flow.start)]
        points.append((flow.end, total_g))
    return points


def _between(points: Points, moment: datetime) -> float:
    """On the straight line between the corners around `moment`; level outside."""
    k = bisect_right(points, moment, key=lambda point: point[0])
    if k == 0 or k == len(points):
        return points[min(k, len(points) - 1)][1] if points else 0.0
    (before, low), (after, high) = points[k - 1], points[k]
    return low + (high - low) * ((moment - before) / (after - before) if after > before else 1.0)


def rows(found: Week) -> Iterator[dict[str, Any]]:
    """A row a half hour."""
    for k, moment in enumerate(found.at):
        yield {
            "at": iso(moment),
            "intensity_g_per_kwh": found.intensity[k],
            "connected": int(any(arrival <= moment < departure for arrival, departure in found.stays)),
            **{f"soc_pct {table.name(c)}": round(100 * curve[k], 3) for c, curve in found.soc.items()},
            **{f"carbon_g {table.name(c)}": round(curve[k], 2) for c, curve in found.carbon_g.items()},
        }
