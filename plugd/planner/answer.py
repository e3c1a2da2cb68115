"""From charge per slot to the answer: powers, energies, shortfalls and objective, the same for every
solver.
"""

from dataclasses import dataclass
from itertools import accumulate

from plugd.planner.bounds import DUST_KWH, Chain, end_value_g, powers_kw
from plugd.planner.problem import Problem, Solution

ROUNDING_KWH = 1e-7
"""What a plan may miss a bound by: sums of many slots."""


def session_charges_kwh(links: Chain, charge_kwh: list[float]) -> list[float]:
    """Battery kWh charged in each session, (N,)."""
    return [sum(charge_kwh[first:end]) for first, end in zip(links.starts, links.starts[1:], strict=False)]


def objective_g(problem: Problem, links: Chain, charge_kwh: list[float]) -> float:
    """carbon_g - end value of a charge per slot, battery kWh (n,), without the proximal term."""
    above_kwh = sum(charge_kwh) - links.lower_kwh[-1]
    return carbon_g(problem, links, charge_kwh) - end_value_g(problem, above_kwh)


def gap(objective: float, bound_g: float) -> float:
    """How far an objective lies above the exact optimum, as a fraction of it (of 1 g where it is smaller)."""
    return (objective - bound_g) / max(abs(bound_g), 1.0)


def within_bounds(links: Chain, charge_kwh: list[float]) -> bool:
    """Whether a charge per slot, battery kWh (n,), keeps every slot's room and every repaired bound."""
    if not all(0 <= x <= room for x, room in zip(charge_kwh, links.room_kwh, strict=True)):  # a NaN is neither
        return False
    totals_kwh = accumulate(session_charges_kwh(links, charge_kwh))
    bounds = zip(links.lower_kwh, totals_kwh, links.upper_kwh, strict=True)
    return all(lower - ROUNDING_KWH <= total <= upper + ROUNDING_KWH for lower, total, upper in bounds)


@dataclass(frozen=True, slots=True)
class Made:
    """How OSQP came to its plan, or failed to."""

    bound_g: float
    raw_gap: float
    iterations: int


def answer(
    problem: Problem,
    links: Chain,
    charge_kwh: list[float],
    made: Made | None = None,
    *,
    fallback: bool = False,
) -> Solution:
    """The Solution for battery kWh per slot of all sessions, (n,).

    It is the exact solver's own, and so its own bound, without `made` and as the `fallback` of OSQP.
    """
    objective = objective_g(problem, links, charge_kwh)
    bound_g = made.bound_g if made else objective
    energies, shorts, reserve_shorts = [], [], []
    energy_kwh, last = problem.energy_kwh, len(problem.sessions) - 1
    for s, (session, charged) in enumerate(zip(problem.sessions, session_charges_kwh(links, charge_kwh), strict=True)):
        energy_kwh += charged
        energies.append(energy_kwh)
        shorts.append(_short_kwh(session.minimum_kwh, energy_kwh))
        energy_kwh -= session.daily_use_kwh
        reserve_shorts.append(_short_kwh(problem.reserve_kwh, energy_kwh) if s < last else 0.0)
    repaired = links.lifted or any(shorts) or any(reserve_shorts)
    return Solution(
        status="fallback" if fallback else "repaired" if repaired else "solved",
        solver="osqp" if made and not fallback else "exact",
        power_kw=powers_kw(problem, charge_kwh),
        energy_kwh=tuple(energies),
        shortfall_kwh=tuple(shorts),
        reserve_short_kwh=tuple(reserve_shorts),
        carbon_g=carbon_g(problem, links, charge_kwh),
        bound_g=bound_g,
        gap=gap(objective, bound_g),
        raw_gap=made.raw_gap if made else 0.0,
        iterations=made.iterations if made else 0,
    )


def carbon_g(problem: Problem, links: Chain, charge_kwh: list[float]) -> float:
    """Carbon emitted, paper eq. 2: intensity times energy at the plug."""
    battery_g = sum(c * x for c, x in zip(links.intensity_g_per_kwh, charge_kwh, strict=True) if x)
    return battery_g / problem.efficiency


def _short_kwh(wanted_kwh: float, energy_kwh: float) -> float:
    short_kwh = wanted_kwh - energy_kwh
    return short_kwh if short_kwh > DUST_KWH else 0.0
