"""OSQP on the condensed problem: the paper's objective with a proximal term to the plan before, certified.

The only module that imports OSQP, numpy and scipy: import it where OSQP is wanted, not before. The exact
optimum is computed beside every solve. A plan from OSQP leaves this module only when OSQP says SOLVED, every
bound is kept and the objective lies within 0.05 % of that optimum. Else a second, tighter pass; else the
exact plan, with status `fallback`.

**What OSQP decides.** The exact plan fills each session from its cheapest slot on and has one edge in each. OSQP gets
the three slots at each edge, all sessions together; every other slot stays full or empty as the exact plan has it.
So the answer is the optimum of the quadratic problem over those slots, not over all: where more than three slots of a
session lie within the proximal term's reach of its edge (0.45 g/kWh), or the plan before used slots that near but
further down the order, they are left as they are. That cannot cost carbon: the certificate is against the linear
optimum over all slots. It can cost stillness among near ties, by no more than the proximal term weighs; of equal slots
those of the plan before come first in the order.

OSQP starts at the exact plan and its prices and mostly confirms it in five iterations; there is nothing to roll at a
session's end, and a fresh workspace answers as well as an old one.
The second pass takes a smaller proximal term than the first: at 0.001 two slots of different nights within
0.15 g/kWh still share, which is more than 0.05 % where little is charged.

Why not trust more than the status (osqp 1.1): an infeasible problem fills x with 2143289344.0, which is
finite; an update with some l > u prints an error, keeps the old numbers and the next solve says "solved" for
them; a short vector is read past its end; a NaN poisons the solver until it is warm-started with zeros. The
extension is called directly: its update returns the code that the wrapper drops, and the wrapper costs 12 to
35 us a tick.
"""

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from operator import le
from typing import Any, Protocol

import numpy as np
import osqp
import scipy.sparse

from plugd.planner.answer import Account, Made, account, answer, gap, within_bounds
from plugd.planner.bounds import Chain, chain
from plugd.planner.condensed import (
    OPEN,
    OVERRUN_SLOTS,
    Condensed,
    Shape,
    charges_kwh,
    condense,
    confirmed,
    overrun_slots,
)
from plugd.planner.exact import optimum
from plugd.planner.least_power import honoured
from plugd.planner.problem import Problem, Solution
from plugd.planner.ranking import Ranking, ranked

MAX_GAP = 5e-4
TIME_LIMIT_S = 1.0
"""A pass that takes longer is given up: it takes a millisecond in health."""
MAX_SESSIONS = 400
"""Above it the condensed form, whose matrix grows with the square, is no longer the right one: the exact plan is
given.
"""
SOLVED = 1
RHO = 0.03
"""ADMM's step size at the start of every solve."""

Vector = np.ndarray[tuple[int], np.dtype[np.float64]]


@dataclass(frozen=True, slots=True)
class Pass:
    """Settings of one attempt. `epsilon`, `tolerance` and `hair_slots` in full slots and typical costs."""

    epsilon: float
    tolerance: float
    max_iter: int
    hair_slots: float
    """A total this near to a bound or to the edge of a slot is put there."""


FIRST = Pass(epsilon=0.003, tolerance=1e-4, max_iter=1500, hair_slots=1e-3)
SECOND = Pass(epsilon=1e-4, tolerance=1e-7, max_iter=5000, hair_slots=1e-5)


@dataclass(frozen=True, slots=True)
class Attempt:
    """What a workspace answered. `x`, in full slots, means nothing unless `status` is SOLVED."""

    status: int
    iterations: int
    x: Sequence[float]


UNSOUND = Attempt(0, 0, ())


class Workspace(Protocol):
    """A solver set up for one Shape and Pass."""

    def solve(self, form: Condensed) -> Attempt:
        """Solve `form`, in the shape the workspace was made for, from its start."""


class OsqpWorkspace:
    """One OSQP set-up: the sparsity is fixed, a tick moves costs and bounds only.

    After an answer that is not SOLVED it is to be dropped: its step size may be left anywhere.
    """

    def __init__(self, shape: Shape, settings: Pass) -> None:
        self._shape, self._settings = shape, settings
        self._columns = OPEN * shape.sessions + shape.steps
        self._rows = self._columns + shape.sessions + (shape.steps > 0)
        self._raw: Any = None  # the extension's solver

    def solve(self, form: Condensed) -> Attempt:
        """See Workspace."""
        n, m = self._columns, self._rows
        if not (len(form.cost) == len(form.x) == n and len(form.lower) == len(form.upper) == len(form.y) == m):
            return UNSOUND
        numbers = array("d", form.cost + form.lower + form.upper + form.x + form.y)  # a third of np.array's time
        if not (isfinite(sum(numbers)) and all(map(le, form.lower, form.upper))):
            return UNSOUND
        vector = np.frombuffer(numbers)
        cost, lower, upper = vector[:n], vector[n : n + m], vector[n + m : n + 2 * m]
        from_x, from_y = vector[n + 2 * m : 2 * (n + m)], vector[2 * (n + m) :]
        if self._raw is None:
            try:
                self._raw = self._set_up(cost, lower, upper)
            except osqp.OSQPException:
                return UNSOUND
        elif self._raw.update_data_vec(q=cost, l=lower, u=upper):
            return UNSOUND
        self._raw.warm_start(from_x, from_y)
        self._raw.solve()
        info = self._raw.info
        attempt = Attempt(info.status_val, info.iter, self._raw.solution.x.tolist())
        if info.rho_updates:  # else the next solve would start from this one's step size, and may never end
            self._raw.update_rho(RHO)
        return attempt

    def _set_up(self, cost: Vector, lower: Vector, upper: Vector) -> Any:
        solver = osqp.OSQP(algebra="builtin")  # naming the algebra saves two failing imports, 0.1 ms
        solver.setup(
            self._proximal(),
            cost,
            self._constraints(),
            lower,
            upper,
            verbose=False,
            eps_abs=self._settings.tolerance,
            eps_rel=self._settings.tolerance,
            max_iter=self._settings.max_iter,
            rho=RHO,
            adaptive_rho=True,  # a fixed one takes 20,000 iterations on rare ticks
            adaptive_rho_interval=200,  # at the default 50 it swings to and fro on degenerate ticks
            check_termination=5,
            check_dualgap=True,
            eps_prim_inf=1e-9,  # repaired bounds are feasible; at 1e-4 a tight one is taken for a contradiction
            time_limit=TIME_LIMIT_S,
            polishing=False,  # fails on a third of the ticks, which are degenerate, and gains nothing
        )
        return solver._solver  # noqa: SLF001 - see the module's docstring

    def _proximal(self) -> scipy.sparse.csc_matrix:
        weights = [self._settings.epsilon] * (OPEN * self._shape.sessions) + [0.0] * self._shape.steps
        return scipy.sparse.csc_matrix(scipy.sparse.diags(weights, format="csc"))

    def _constraints(self) -> scipy.sparse.csc_matrix:
        """Box, cumulative sums, and what the end value's steps are paid for: ones, -1 for steps."""
        rows = np.zeros((self._rows - self._columns, self._columns))
        for s in range(self._shape.sessions):
            rows[s:, OPEN * s : OPEN * (s + 1)] = 1.0
        if self._shape.steps:
            rows[-1, OPEN * self._shape.sessions :] = -1.0
        return scipy.sparse.csc_matrix(scipy.sparse.vstack([scipy.sparse.identity(self._columns), rows]))


class Qp:
    """The OSQP planner as a `Solver`. Its workspace is a cache: without, a solve takes 0.3 ms more."""

    def __init__(self, make: Callable[[Shape, Pass], Workspace] = OsqpWorkspace) -> None:
        self._make = make
        self._kept: dict[Pass, tuple[Shape, Workspace]] = {}

    def solve(self, problem: Problem) -> Solution:
        """The plan of least carbon_g - end value, near `previous_power_kw` among near ties."""
        return honoured(problem, self._relaxed(problem), optimum)

    def _relaxed(self, problem: Problem) -> Solution:
        """The plan without the charger's least power."""
        links = chain(problem)
        if len(problem.sessions) > MAX_SESSIONS:
            return answer(problem, links, account(problem, links, optimum(problem, links)), fallback=True)
        ranking = ranked(links, problem.previous_power_kw)
        best = account(problem, links, optimum(problem, links, ranking))
        if not any(ranking):  # nothing can be charged: nothing to solve
            return answer(problem, links, best)
        iterations, raw_gap = 0, 0.0
        for settings in (FIRST, SECOND):
            plan, tried = self._attempt(problem, links, ranking, best, settings)
            iterations += tried
            if plan is None or not within_bounds(links, plan):
                continue
            off = gap(plan.objective_g, best.objective_g)
            raw_gap = off if settings is FIRST else raw_gap
            if off <= MAX_GAP:
                return answer(problem, links, plan, Made(best.objective_g, raw_gap, iterations))
        made = Made(best.objective_g, raw_gap, iterations)
        exact = account(problem, links, optimum(problem, links))  # as the exact solver gives it
        return answer(problem, links, exact, made, fallback=True)

    def _attempt(
        self, problem: Problem, links: Chain, ranking: list[Ranking], best: Account, settings: Pass
    ) -> tuple[Account | None, int]:
        """One pass: the plan, or None where OSQP's answer cannot be used; iterations."""
        form = condense(problem, links, ranking, best, settings.epsilon)
        try:
            attempt = self._prepared(form.shape, settings).solve(form)
        except (osqp.OSQPException, RuntimeError, ArithmeticError, ValueError, MemoryError):
            attempt = UNSOUND  # the extension is C: whatever it fell over, there is a plan without it
        if attempt.status != SOLVED or len(attempt.x) != len(form.cost):
            self._kept.pop(settings, None)
            return None, attempt.iterations
        if confirmed(form, attempt.x, settings.hair_slots):
            return best, attempt.iterations
        if not overrun_slots(form, attempt.x) <= OVERRUN_SLOTS:  # a NaN is not
            return None, attempt.iterations
        charge_kwh = charges_kwh(links, best, form, attempt.x, settings.hair_slots)
        return account(problem, links, charge_kwh), attempt.iterations

    def _prepared(self, need: Shape, settings: Pass) -> Workspace:
        """The pass's kept workspace where it fits, else a new one."""
        kept = self._kept.get(settings)
        if kept is None or kept[0] != need:
            kept = self._kept[settings] = need, self._make(need, settings)
        return kept[1]
