"""What a user would pick instead of plugd's own planner: general solvers and modelling languages.

Each is a Solver: bounds repaired and the answer put together by plugd's code, as for every other. Where a package is
not installed the solver is left out of `available`.
"""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from plugd.planner.answer import account, answer
from plugd.planner.bounds import Chain, chain
from plugd.planner.problem import Problem, Solution


def cumulative(links: Chain) -> np.ndarray:
    """The condensed form's matrix: row s is 1 for every slot of the sessions up to s, (N, n)."""
    rows = np.zeros((len(links.lower_kwh), len(links.room_kwh)))
    for s in range(len(rows)):
        rows[s, : links.starts[s + 1]] = 1.0
    return rows


def solved(problem: Problem, links: Chain, charge_kwh: object) -> Solution:
    """The Solution, the solver's rounding taken off."""
    kept_kwh = np.clip(np.asarray(charge_kwh, dtype=float), 0.0, links.room_kwh).tolist()
    return answer(problem, links, account(problem, links, kept_kwh))


class Linprog:
    """scipy.optimize.linprog on the condensed form."""

    def solve(self, problem: Problem) -> Solution:
        """See plugd's Solver."""
        from scipy.optimize import linprog

        links = chain(problem)
        rows = cumulative(links)
        found = linprog(
            links.intensity_g_per_kwh,
            A_ub=np.vstack([rows, -rows]),
            b_ub=np.concatenate([links.upper_kwh, -np.array(links.lower_kwh)]),
            bounds=np.column_stack([np.zeros(len(links.room_kwh)), links.room_kwh]),
            method="highs",
        )
        return solved(problem, links, found.x)


class CvxpyRebuilt:
    """CVXPY, the model written anew every tick in vectors, its default solver."""

    def solve(self, problem: Problem) -> Solution:
        """See plugd's Solver."""
        import cvxpy as cp

        links = chain(problem)
        charge = cp.Variable(len(links.room_kwh))
        total = cumulative(links) @ charge
        limits = [charge >= 0, charge <= links.room_kwh, total >= links.lower_kwh, total <= links.upper_kwh]
        cp.Problem(cp.Minimize(np.array(links.intensity_g_per_kwh) @ charge), limits).solve()
        return solved(problem, links, charge.value)


class CvxpyParametrised:
    """CVXPY with a model made once and parameters set every tick (DPP), its default solver."""

    def __init__(self) -> None:
        self._model: tuple[object, ...] | None = None

    def solve(self, problem: Problem) -> Solution:
        """See plugd's Solver."""
        import cvxpy as cp

        links = chain(problem)
        if self._model is None:
            slots, rows = len(links.room_kwh), len(links.lower_kwh)
            charge = cp.Variable(slots)
            cost, room, lower, upper = (cp.Parameter(size) for size in (slots, slots, rows, rows))
            total = cumulative(links) @ charge
            limits = [charge >= 0, charge <= room, total >= lower, total <= upper]
            self._model = charge, (cost, room, lower, upper), cp.Problem(cp.Minimize(cost @ charge), limits)
        charge, parameters, model = self._model
        values = links.intensity_g_per_kwh, links.room_kwh, links.lower_kwh, links.upper_kwh
        for parameter, value in zip(parameters, values, strict=True):
            parameter.value = np.array(value)
        model.solve()
        return solved(problem, links, charge.value)


class PulpCbc:
    """PuLP with the CBC it brings, the model built slot by slot and handed over in a file, as EMHASS does.

    PuLP is under the MIT licence, the CBC programs inside PuLP 3 under the Eclipse Public License 1.0; CBC's own
    source is under 2.0 by now. plugd neither contains nor needs them.
    """

    def solve(self, problem: Problem) -> Solution:
        """See plugd's Solver."""
        import pulp

        links = chain(problem)
        model = pulp.LpProblem("charging", pulp.LpMinimize)
        charge = [pulp.LpVariable(f"p{i}", 0, room) for i, room in enumerate(links.room_kwh)]
        model += pulp.lpSum(c * x for c, x in zip(links.intensity_g_per_kwh, charge, strict=True))
        total = pulp.LpAffineExpression()
        for s, (lower, upper) in enumerate(zip(links.lower_kwh, links.upper_kwh, strict=True)):
            total = total + pulp.lpSum(charge[links.starts[s] : links.starts[s + 1]])
            model += total >= lower
            model += total <= upper
        model.solve(pulp.PULP_CBC_CMD(msg=False, threads=1))
        return solved(problem, links, [x.varValue or 0.0 for x in charge])


GENERAL: tuple[tuple[str, str, Callable[[], Linprog | CvxpyRebuilt | CvxpyParametrised | PulpCbc]], ...] = (
    ("scipy linprog", "scipy", Linprog),
    ("CVXPY, parametrised", "cvxpy", CvxpyParametrised),
    ("CVXPY, rebuilt", "cvxpy", CvxpyRebuilt),
    ("PuLP and CBC, rebuilt", "pulp", PulpCbc),
)
"""Name, the package it needs, how to make it: fastest first."""


def available() -> dict[str, Callable[[], Linprog | CvxpyRebuilt | CvxpyParametrised | PulpCbc]]:
    """Those whose package is installed."""
    return {name: make for name, package, make in GENERAL if find_spec(package)}
