"""From charge per slot to the answer: powers, energies, shortfalls and objective, the same for every
solver.
"""

from dataclasses import dataclass
from itertools import compress
from operator import mul

from plugd.planner.bounds import DUST_KWH, Chain, end_value_g, powers_kw, session_charges_kwh
from plugd.planner.problem import Problem, Solution

ROUNDING_KWH = 1e-7
"""What a plan may miss a bound by: sums of many slots."""


@dataclass(frozen=True, slots=True)
class Account:
    """A plan and what it comes to."""

    charge_kwh: list[float]
    """Battery kWh per slot of all sessions, (n,)."""
    session_kwh: list[float]
    """Charged per session, (N,)."""
    carbon_g: float
    objective_g: float
    """carbon_g - end value, without the proximal term."""


def account(problem: Problem, links: Chain, charge_kwh: list[float]) -> Account:
    """The account of battery kWh per slot of all sessions, (n,). Carbon is paper eq. 2: at the plug."""
    session_kwh = session_charges_kwh(links, charge_kwh)
    carbon_g = sum(map(mul, links.intensity_g_per_kwh, charge_kwh)) / problem.efficiency
    end_g = end_value_g(problem, sum(session_kwh) - links.lower_kwh[-1]) if problem.end_value else 0.0
    return Account(charge_kwh, session_kwh, carbon_g, carbon_g - end_g)


def gap(objective: float, bound_g: float) -> float:
    """How far an objective lies above the exact optimum, as a fraction of it (of 1 g where it is smaller)."""
    return (objective - bound_g) / max(abs(bound_g), 1.0)


def within_bounds(links: Chain, plan: Account) -> bool:
    """Whether a plan keeps every slot's room and every repaired bound."""
    charge, room, total_kwh = plan.charge_kwh, links.room_kwh, 0.0
    for slot in compress(range(len(charge)), charge):
        if not 0.0 < charge[slot] <= room[slot] + DUST_KWH:  # a NaN is not. Powers are cut at their limit
            return False
    for lower, charged_kwh, upper in zip(links.lower_kwh, plan.session_kwh, links.upper_kwh, strict=True):
        total_kwh += charged_kwh
        if not lower - ROUNDING_KWH <= total_kwh <= upper + ROUNDING_KWH:
            return False
    return True


@dataclass(frozen=True, slots=True)
class Made:
    """How OSQP came to its plan, or failed to."""

    bound_g: float
    raw_gap: float
    iterations: int


def answer(
    problem: Problem, links: Chain, plan: Account, made: Made | None = None, *, fallback: bool = False
) -> Solution:
    """The Solution for a plan.

    It is the exact solver's own, and so its own bound, without `made` and as the `fallback` of OSQP.
    """
    bound_g = made.bound_g if made else plan.objective_g
    energies, shorts, reserve_shorts = [], [], []
    energy_kwh, last = problem.energy_kwh, len(problem.sessions) - 1
    for s, (session, charged) in enumerate(zip(problem.sessions, plan.session_kwh, strict=True)):
        energy_kwh += charged
        energies.append(energy_kwh)
        shorts.append(_short_kwh(session.minimum_kwh, energy_kwh))
        energy_kwh -= session.daily_use_kwh
        reserve_shorts.append(_short_kwh(problem.reserve_kwh, energy_kwh) if s < last else 0.0)
    repaired = links.lifted or any(shorts) or any(reserve_shorts)
    return Solution(
        status="fallback" if fallback else "repaired" if repaired else "solved",
        solver="osqp" if made and not fallback else "exact",
        power_kw=powers_kw(problem, plan.charge_kwh),
        energy_kwh=tuple(energies),
        shortfall_kwh=tuple(shorts),
        reserve_short_kwh=tuple(reserve_shorts),
        carbon_g=plan.carbon_g,
        bound_g=bound_g,
        gap=gap(plan.objective_g, bound_g),
        raw_gap=made.raw_gap if made else 0.0,
        iterations=made.iterations if made else 0,
    )


def _short_kwh(wanted_kwh: float, energy_kwh: float) -> float:
    short_kwh = wanted_kwh - energy_kwh
    return short_kwh if short_kwh > DUST_KWH else 0.0
