"""HiGHS called as fast as highspy can be: one model for all ticks, warm basis, simplex, no presolve, one thread.

The model is plugd's own condensed one: a column a slot, N rows on the cumulative charge. A tick changes the costs in
one call and the rows' bounds in another. Slots gone by keep their bounds and get a cost that nobody pays, which
measured faster than closing them. Presolve, pruning, primal simplex and more threads measured slower.
"""

import highspy
import numpy as np

from plugd.planner.answer import account, answer
from plugd.planner.bounds import Chain, chain
from plugd.planner.problem import Problem, Solution

CLOSED_G_PER_KWH = 2000.0


class Highs:
    """A Solver for problems of full slots of one size, with or without slots gone by, and no end value."""

    def __init__(self) -> None:
        self._model: highspy.Highs | None = None

    def solve(self, problem: Problem) -> Solution:
        """See plugd's Solver: bounds repaired by the same code before, the answer put together by the same after."""
        links = chain(problem)
        charge_kwh = [max(0.0, x) for x in self.columns(links, arrays(links))]
        return answer(problem, links, account(problem, links, charge_kwh))

    def columns(self, links: Chain, given: tuple[np.ndarray, np.ndarray, np.ndarray]) -> list[float]:
        """HiGHS's part alone: battery kWh per slot for `arrays(links)`."""
        if self._model is None:
            self._model = model(links)
            self._slots = np.arange(len(links.room_kwh), dtype=np.int32)
            self._rows = np.arange(len(links.lower_kwh), dtype=np.int32)
        found, (cost, lower, upper) = self._model, given
        found.changeColsCost(len(self._slots), self._slots, cost)
        found.changeRowsBounds(len(self._rows), self._rows, lower, upper)
        found.run()
        if found.getModelStatus() != highspy.HighsModelStatus.kOptimal:
            raise RuntimeError(f"HiGHS: {found.getModelStatus()}")
        charge_kwh: list[float] = found.getSolution().col_value
        return charge_kwh


def arrays(links: Chain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs and row bounds. A slot without room costs more than any energy is worth."""
    if links.room_kwh[0]:
        cost = np.array(links.intensity_g_per_kwh)
    else:
        cost = np.where(np.array(links.room_kwh) > 0.0, links.intensity_g_per_kwh, CLOSED_G_PER_KWH)
    return cost, np.array(links.lower_kwh), np.array(links.upper_kwh)


def model(links: Chain) -> highspy.Highs:
    """The model, its costs and row bounds still to come."""
    found = highspy.Highs()
    options = {"output_flag": False, "presolve": "off", "solver": "simplex", "threads": 1}
    for name, value in options.items():
        found.setOptionValue(name, value)
    rows = len(links.lower_kwh)
    infinite = highspy.kHighsInf
    for _ in range(rows):
        found.addRow(-infinite, infinite, 0, [], [])
    full_kwh = max(links.room_kwh)
    for s in range(rows):
        below = np.arange(s, rows, dtype=np.int32)
        for _ in range(links.starts[s], links.starts[s + 1]):
            found.addCol(0.0, 0.0, full_kwh, len(below), below, np.ones(len(below)))
    return found
