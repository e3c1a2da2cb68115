"""OSQP on the condensed problem: the paper's objective with a proximal term to the plan before, certified.

The only module that imports OSQP, numpy and scipy: import it where OSQP is wanted, not before. The exact
optimum is computed beside every solve. A plan from OSQP leaves this module only when OSQP says SOLVED, every
bound is kept and the objective lies within 0.05 % of that optimum. Else a second, tighter pass; else the
exact plan, with status `fallback`.

Every solve starts from the exact plan and its prices, not from the last tick's answer: a third of the
iterations, nothing to roll at a session's end, and a fresh workspace answers as well as an old one.
The second pass takes a smaller proximal term than the first: at 0.001 two slots of different nights within
0.15 g/kWh still share, which is more than 0.05 % where little is charged.

Why not trust more than the status (osqp 1.1): an infeasible problem fills x with 2143289344.0, which is
finite; an update with some l > u prints an error, keeps the old numbers and the next solve says "solved" for
them; a short vector is read past its end; a NaN poisons the solver until it is warm-started with zeros. The
extension is called directly: its update returns the code that the wrapper drops, and the wrapper costs 12 to
35 us a tick.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import osqp
import scipy.sparse

from plugd.planner.answer import Made, answer, gap, objective_g, within_bounds
from plugd.planner.bounds import Chain, chain
from plugd.planner.condensed import (
    SNAP_SLOTS,
    Certificate,
    Condensed,
    Ranked,
    Shape,
    charges_kwh,
    condense,
    overrun_slots,
    ranked,
    roomy,
    start,
)
from plugd.planner.exact import optimum
from plugd.planner.least_power import honoured
from plugd.planner.prices import prices
from plugd.planner.problem import Problem, Solution

MAX_GAP = 5e-4
MAX_NONZEROS = 400_000
"""Above it the condensed form is no longer the right one (hundreds of sessions): the exact plan is given."""
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
    snap: bool
    hair_slots: float
    """A total this near to a bound or to the edge of a slot is put there."""


FIRST = Pass(epsilon=0.003, tolerance=1e-4, max_iter=1500, snap=True, hair_slots=1e-3)
SECOND = Pass(epsilon=1e-4, tolerance=1e-7, max_iter=5000, snap=False, hair_slots=1e-5)


@dataclass(frozen=True, slots=True)
class Attempt:
    """What a workspace answered. `x`, in full slots, means nothing unless `status` is SOLVED."""

    status: int
    iterations: int
    x: Sequence[float]


UNSOUND = Attempt(0, 0, ())


class Workspace(Protocol):
    """A solver set up for one Shape and Pass."""

    def solve(self, form: Condensed, x: list[float], y: list[float]) -> Attempt:
        """Solve `form`, in the shape the workspace was made for, starting from `x` and multipliers `y`."""


class OsqpWorkspace:
    """One OSQP set-up: the sparsity is fixed, a tick moves costs and bounds only.

    After an answer that is not SOLVED it is to be dropped: its step size may be left anywhere.
    """

    def __init__(self, shape: Shape, settings: Pass) -> None:
        self._shape, self._settings = shape, settings
        self._columns = sum(shape.columns) + shape.steps
        self._rows = self._columns + len(shape.columns) + (shape.steps > 0)
        self._raw: Any = None  # the extension's solver

    def solve(self, form: Condensed, x: list[float], y: list[float]) -> Attempt:
        """See Workspace."""
        cost, lower, upper = np.array(form.cost), np.array(form.lower), np.array(form.upper)
        from_x, from_y = np.array(x), np.array(y)
        if not len(cost) == len(from_x) == self._columns:
            return UNSOUND
        if not len(lower) == len(upper) == len(from_y) == self._rows:
            return UNSOUND
        if not (np.isfinite(cost).all() and (lower <= upper).all()):  # a NaN is never <=
            return UNSOUND
        if not (np.isfinite(from_x).all() and np.isfinite(from_y).all()):
            return UNSOUND
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
            check_termination=25,
            check_dualgap=True,
            polishing=False,  # fails on a third of the ticks, which are degenerate, and gains nothing
        )
        return solver._solver  # noqa: SLF001 - see the module's docstring

    def _proximal(self) -> scipy.sparse.csc_matrix:
        weights = [self._settings.epsilon] * sum(self._shape.columns) + [0.0] * self._shape.steps
        return scipy.sparse.csc_matrix(scipy.sparse.diags(weights, format="csc"))

    def _constraints(self) -> scipy.sparse.csc_matrix:
        """Box, cumulative sums, and what the end value's steps are paid for: ones, -1 for steps."""
        rows = np.zeros((self._rows - self._columns, self._columns))
        first = 0
        for s, columns in enumerate(self._shape.columns):
            rows[s:, first : first + columns] = 1.0
            first += columns
        if self._shape.steps:
            rows[-1, first:] = -1.0
        return scipy.sparse.csc_matrix(scipy.sparse.vstack([scipy.sparse.identity(self._columns), rows]))


class Qp:
    """The OSQP planner as a `Solver`. Its workspace is a cache: without, a solve takes 0.3 ms more."""

    def __init__(self, make: Callable[[Shape, Pass], Workspace] = OsqpWorkspace) -> None:
        self._make = make
        self._kept: tuple[Shape, Workspace] | None = None

    def solve(self, problem: Problem) -> Solution:
        """The plan of least carbon_g - end value, near `previous_power_kw` among near ties."""
        return honoured(problem, self._relaxed(problem), optimum)

    def _relaxed(self, problem: Problem) -> Solution:
        """The plan without the charger's least power."""
        links = chain(problem)
        best_kwh = optimum(problem, links)
        rank = ranked(problem, links)
        if rank is None:
            return answer(problem, links, best_kwh)  # nothing can be charged: nothing to solve
        if rank.need.nonzeros() > MAX_NONZEROS:
            return answer(problem, links, best_kwh, fallback=True)
        bound_g = objective_g(problem, links, best_kwh)
        exact = Certificate(best_kwh, prices(problem, links, rank.slots, best_kwh))
        iterations, raw_gap = 0, 0.0
        for settings in (FIRST, SECOND):
            charge, tried = self._attempt(problem, links, rank, exact, settings)
            iterations += tried
            if charge is None:
                continue
            off = gap(objective_g(problem, links, charge), bound_g)
            raw_gap = off if settings is FIRST else raw_gap
            if off <= MAX_GAP:
                made = Made(bound_g, raw_gap, iterations)
                return answer(problem, links, charge, made)
        made = Made(bound_g, raw_gap, iterations)
        return answer(problem, links, best_kwh, made, fallback=True)

    def _attempt(
        self, problem: Problem, links: Chain, rank: Ranked, exact: Certificate, settings: Pass
    ) -> tuple[list[float] | None, int]:
        """One pass: battery kWh per slot, or None where OSQP's answer cannot be used; iterations."""
        shape, workspace = self._prepared(problem, rank, settings)
        form = condense(problem, links, rank, shape, epsilon=settings.epsilon, snap=settings.snap)
        attempt = workspace.solve(form, *start(links, rank, form, shape, exact))
        if attempt.status != SOLVED or len(attempt.x) != len(form.cost):
            self._kept = None
            return None, attempt.iterations
        if not overrun_slots(form, shape, attempt.x) <= SNAP_SLOTS:  # a NaN is not
            return None, attempt.iterations
        charge = charges_kwh(links, rank, form, shape, attempt.x, hair_slots=settings.hair_slots)
        return charge if within_bounds(links, charge) else None, attempt.iterations

    def _prepared(self, problem: Problem, rank: Ranked, settings: Pass) -> tuple[Shape, Workspace]:
        """The kept workspace where it fits, else a new one; the second pass is rare and has its own."""
        if settings is FIRST and self._kept is not None and self._kept[0].fits(rank.need):
            return self._kept
        shape = roomy(rank.need, problem)
        made = shape, self._make(shape, settings)
        if settings is FIRST:
            self._kept = made
        return made
