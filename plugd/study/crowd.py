"""What is left of the saving when many cars choose the same half hours (the paper's section V), and what delay gives.

Some cars stand for all. The measured intensity is taken to hold a fleet that charges without control. A share of it
that plans takes its energy elsewhere, and the intensity follows the load in a straight line:

    C'[l] = max(0, C[l] + slope · share · fleet · (planned[l] − uncontrolled[l]))

with the loads in GW a car and the slope in g/kWh per GW. Everybody plans with the same forecast, which knows nothing
of the others. The delay is drawn a car and night, whole half hours from none to the most: the car sees the intensity
that much later than it is, so that its mornings stay safe.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from plugd.study.engine import Account
from plugd.study.forecasts import Noise
from plugd.study.measured import Measured
from plugd.study.runs import Run, paper_run
from plugd.units import SLOT_H

HORIZON = 4
KW_A_GW = 1e6


@dataclass(frozen=True, slots=True)
class Crowd:
    """A fleet, and how the grid answers it."""

    fleet: float = 2e6
    slope_g_per_kwh_gw: float = 5.0
    shares: tuple[float, ...] = (0.0, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
    delays_h: tuple[float, ...] = (0.0, 1.0, 2.0, 4.0)
    cars: int = 20
    """That stand for the fleet."""


def runs(
    crowd: Crowd, found: Measured, start: datetime, end: datetime, noise: Noise, *, end_value: bool
) -> Iterator[tuple[float | None, Run]]:
    """One run a car without control (None), and one a car and delay. All cars see the same forecast errors."""
    for car in range(crowd.cars):
        plain = paper_run("uncontrolled", found, start, end, seed=car)
        planned = paper_run("mpc", found, start, end, horizon=HORIZON, seed=car, noise=noise, end_value=end_value)
        yield None, plain
        for delay_h in crowd.delays_h:
            yield delay_h, replace(planned, issue_seed=0, delay_h=delay_h)


def rows(crowd: Crowd, found: Measured, outcomes: Iterable[tuple[float | None, Account]]) -> list[dict[str, Any]]:
    """A row a delay and share: the planning cars' carbon, and what it is less than without any control."""
    accounts: dict[float | None, list[Account]] = defaultdict(list)
    for delay_h, account in outcomes:
        accounts[delay_h].append(account)
    loads = {delay_h: _load_kwh(of, found) for delay_h, of in accounts.items()}
    plain = loads.pop(None)
    before = _carbon(plain, dict(enumerate(found.actual)))
    shown = []
    for delay_h, load in loads.items():
        for share in crowd.shares:
            g_per_kwh = dict(enumerate(found.actual))
            gw_a_kwh = share * crowd.fleet / SLOT_H / KW_A_GW
            moved_gw = {k: gw_a_kwh * (load.get(k, 0.0) - plain.get(k, 0.0)) for k in {*load, *plain}}
            for k, gw in moved_gw.items():
                g_per_kwh[k] = max(0.0, g_per_kwh[k] + crowd.slope_g_per_kwh_gw * gw)
            carbon = _carbon(load, g_per_kwh)
            shown.append(
                {
                    "delay_h": delay_h,
                    "share_pct": round(100.0 * share, 3),
                    "cars": round(share * crowd.fleet),
                    "carbon_g_per_kwh": round(carbon, 3),
                    "reduction_pct": round(100.0 * (1.0 - carbon / before), 3) if before else None,
                    "peak_gw": round(gw_a_kwh * max(load.values(), default=0.0), 3),
                }
            )
    return shown


def _load_kwh(accounts: Sequence[Account], found: Measured) -> dict[int, float]:
    """Mean energy a car by half hour, numbered from the series' first."""
    load: dict[int, float] = defaultdict(float)
    for account in accounts:
        for flow in account.flows:
            load[found.index(flow.start)] += flow.kwh / len(accounts)
    return dict(load)


def _carbon(load: dict[int, float], g_per_kwh: dict[int, float]) -> float:
    """Mean intensity of a load, g/kWh."""
    energy_kwh = sum(load.values())
    return sum(kwh * g_per_kwh[k] for k, kwh in load.items()) / energy_kwh if energy_kwh else 0.0
