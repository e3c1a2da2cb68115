"""The exact chain solver: the linear problem solved by sorting, in pure Python, O(n log n).

Every slot of a session enters each constraint, and the end value, in the same way, so only its price tells
slots apart. Sessions are taken in order with one pool of slots still open. An upper bound that the
pool's room could break drops the dearest of it; a lower bound not yet reached commits the cheapest. What is
committed is never undone and what is dropped never needed again: both are forced by a bound that every later
choice shares. At the end the pool is taken up to the worth of energy left. It is the fallback, the oracle of
the tests and the certificate beside every OSQP plan.
"""

from dataclasses import dataclass

from plugd.planner.answer import account, answer
from plugd.planner.bounds import DUST_KWH, Chain, chain
from plugd.planner.least_power import honoured
from plugd.planner.problem import Problem, Solution
from plugd.planner.ranking import Ranking, ranked

Pool = Ranking
"""Of equal prices the earlier slot is taken first and dropped last."""


@dataclass(frozen=True, slots=True)
class Exact:
    """The exact solver as a `Solver`."""

    def solve(self, problem: Problem) -> Solution:
        """See `solve`."""
        return solve(problem)


def solve(problem: Problem) -> Solution:
    """The plan of least carbon_g - end value; Ties go to the earlier slot."""
    links = chain(problem)
    best = account(problem, links, optimum(problem, links))
    return honoured(problem, answer(problem, links, best), optimum)


def optimum(problem: Problem, links: Chain, slots: list[Ranking] | None = None) -> list[float]:
    """Battery kWh charged in each slot of all sessions, (n,), at least cost on the repaired bounds.

    `slots`: each session's ranking where ties are not to go to the earlier.
    """
    price, left = links.intensity_g_per_kwh, links.room_kwh.copy()
    charge = [0.0] * len(left)
    pool: Pool = []
    committed = possible = 0.0  # charged so far; the same with all of the pool
    for fresh, lower, upper in zip(slots or ranked(links), links.lower_kwh, links.upper_kwh, strict=True):
        pool += fresh
        pool.sort(key=price.__getitem__)  # stable: of equals the earlier session first
        possible += sum([left[slot] for slot in fresh])
        if possible > upper:
            possible -= _drop(pool, left, possible - upper)
        if committed < lower:
            committed += _commit(pool, left, charge, lower - committed)
    _take_worth(problem, links, pool, left, charge, committed - links.lower_kwh[-1])
    return charge


def _drop(pool: Pool, left: list[float], excess_kwh: float) -> float:
    """Take `excess_kwh` of room out of the pool, dearest first; return what was taken."""
    wanted_kwh = excess_kwh
    while pool:
        slot = pool[-1]
        if left[slot] > excess_kwh + DUST_KWH:
            left[slot] -= excess_kwh
            return wanted_kwh
        excess_kwh -= left[slot]
        pool.pop()
    return wanted_kwh - excess_kwh


def _commit(pool: Pool, left: list[float], charge: list[float], need_kwh: float) -> float:
    """Charge `need_kwh` from the pool, cheapest first; return what was charged."""
    wanted_kwh = need_kwh
    for taken, slot in enumerate(pool):
        if left[slot] > need_kwh:
            charge[slot] += need_kwh
            left[slot] -= need_kwh
            del pool[:taken]
            return wanted_kwh
        charge[slot] += left[slot]
        need_kwh -= left[slot]
    pool.clear()
    return wanted_kwh - need_kwh


def _take_worth(
    problem: Problem, links: Chain, pool: Pool, left: list[float], charge: list[float], above_kwh: float
) -> None:
    """Charge from the pool, cheapest first, while a slot costs less than the energy left at the end is worth.

    `above_kwh` is how much lies above the end value's start already. Beyond the last step worth is 0, so that
    a negative intensity is taken anyway.
    """
    steps = []  # what is left of each step, dearest first, and what a plug kWh is worth in it
    for width_kwh, worth in problem.end_value:
        passed_kwh = min(width_kwh, above_kwh)
        above_kwh -= passed_kwh
        if width_kwh > passed_kwh:
            steps.append((width_kwh - passed_kwh, worth * problem.efficiency))
    steps.append((float("inf"), 0.0))
    step = iter(steps)
    width_kwh, worth = next(step)
    for slot in pool:
        while left[slot] > 0:
            if links.intensity_g_per_kwh[slot] >= worth:
                return
            part_kwh = min(left[slot], width_kwh)
            charge[slot] += part_kwh
            left[slot] -= part_kwh
            width_kwh -= part_kwh
            if width_kwh <= 0:
                width_kwh, worth = next(step)
