"""An experiment is a list of independent runs: each frozen, complete in itself, and simulated wherever there is room.

`perform` hands them to any `concurrent.futures` executor. A run that fails comes back as a Failure that names its
parameters; the others go on.
"""

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any, TypeVar

from plugd.domain import Capability, Car, Household
from plugd.planner.exact import Exact
from plugd.planner.problem import Solver
from plugd.study.engine import Account, World, simulate
from plugd.study.forecasts import PAPER_GROWTH, Delayed, Forecasts, Noise, Synthetic
from plugd.study.issued import Issues, Replayed
from plugd.study.measured import Measured
from plugd.study.strategies import strategy
from plugd.study.world import Driver

PAPER = Household(
    timezone="UTC",
    car=Car(efficiency=1.0),
    capability=Capability(power_max_kw=10.0, modulating=True),
    guard_margin_s=0.0,
    planner_slack_s=0.0,
)
"""The paper's section IV: 50 kWh, 20 to 80 %, 10 kW, no losses, nobody but the plan at the plug."""
PLANNING = ("mpc", "perfect")
"""Strategies that have a horizon."""


Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Run:
    """One strategy in one world. Everything that the outcome depends on."""

    strategy: str
    world: World
    found: Measured = field(repr=False)
    noise: Noise = Noise.TARGET
    growth: float = PAPER_GROWTH
    solver: str = "exact"
    issues: Issues | None = field(default=None, repr=False)
    """Forecasts as they were issued, instead of the synthetic one."""
    corrected: bool = True
    """Whether the outlook learns from how wrong those were."""
    issue_seed: int | None = None
    """Of the forecast errors, where cars with seeds of their own see the same forecast."""
    delay_h: float = 0.0
    """The most by which a night's plan is put off at random."""

    @property
    def horizon(self) -> int | None:
        """Sessions planned together; None where nothing is planned."""
        return self.world.household.nights.horizon if self.strategy in PLANNING else None

    @property
    def seed(self) -> int:
        """Of driver and forecast errors."""
        return self.world.driver.seed

    def __str__(self) -> str:
        """Its parameters on one line."""
        horizon = f" N={self.horizon}" if self.horizon else ""
        late = f", delayed up to {self.delay_h:g} h" if self.delay_h else ""
        world, value = self.world, "on" if self.world.household.end_value else "off"
        noise = (
            f"noise {self.noise}"
            if self.issues is None
            else f"forecasts as issued{', corrected' if self.corrected else ''}"
        )
        return (
            f"{self.strategy}{horizon}, {self.found.name} {world.start:%Y-%m-%d} to {world.end:%Y-%m-%d}, "
            f"seed {self.seed}{late}, {noise}, end value {value}, solver {self.solver}"
        )


@dataclass(frozen=True, slots=True)
class Failure:
    """A run that came to nothing, and why."""

    run: Run
    why: str

    def __str__(self) -> str:
        """One line for a person."""
        return f"run failed: {self.run}: {self.why}"


def paper_run(
    name: str,
    found: Measured,
    start: datetime,
    end: datetime,
    *,
    horizon: int | None = None,
    seed: int = 0,
    noise: Noise = Noise.TARGET,
    end_value: bool = True,
    solver: str = "exact",
    growth: float = PAPER_GROWTH,
    household: Household = PAPER,
    learn: bool = False,
) -> Run:
    """A strategy in the paper's world, or in that of another household. `learn`: the driver's habits."""
    house = replace(household, nights=replace(household.nights, horizon=horizon or 1, learn=learn), end_value=end_value)
    noise = Noise.NONE if name == "perfect" else noise
    world = World(house, Driver(timezone=house.timezone, seed=seed), start, end)
    return Run(name, world, found, noise, growth, solver)


def simulated(run: Run) -> Account:
    """What comes of a run."""
    solver = _solver(run.solver)
    household = run.world.household
    # Only OSQP, which begins from it, and a relay, whose slots are held, have a use for the plan before.
    previous = run.solver != "exact" or not household.capability.modulating
    chosen = strategy(run.strategy, household, _forecasts(run), solver, previous=previous)
    return simulate(run.world, chosen, run.found)


def _forecasts(run: Run) -> Forecasts:
    if run.issues is not None and run.strategy != "perfect":
        return Replayed(run.issues, corrected=run.corrected)
    seed = run.seed if run.issue_seed is None else run.issue_seed
    found = Synthetic(run.found, run.noise, seed, run.world.start, run.growth)
    return Delayed(found, run.seed, run.delay_h) if run.delay_h else found


def _solver(name: str) -> Solver:
    if name == "exact":
        return Exact()
    from plugd.planner.qp import Qp  # noqa: PLC0415 - numpy and OSQP only where they are asked for

    return Qp()


Told = Callable[[int, int], None]
"""Is told how many of how many runs are done."""


class Here(Executor):
    """One worker: this process, without the second that another takes to begin."""

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Done when it returns."""
        future: Future[Result] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 - whatever it is, the future has it, as any executor's
            future.set_exception(error)
        return future


def pool(workers: int) -> Executor:
    """A process pool. Workers begin afresh: nothing of the parent's threads or random numbers leaks into them."""
    if workers == 1:
        return Here()
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, context, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_DFL))


def perform(
    runs: Sequence[Run], make: Callable[[], Executor], told: Told = lambda done, of: None
) -> list[Account | Failure]:
    """All runs on an executor; outcomes in the order of `runs`.

    A worker that dies takes its pool along: the runs lost with it are tried again, each in a pool of its own.
    """
    told(0, len(runs))
    found: dict[int, Account | Failure] = {}
    lost = _passed(runs, range(len(runs)), make, found, told)
    for k in lost:
        for again in _passed(runs, (k,), make, found, told):
            found[again] = Failure(runs[again], "its worker died; is there enough memory?")
            told(len(found), len(runs))
    return [found[k] for k in range(len(runs))]


def _passed(
    runs: Sequence[Run],
    chosen: Iterable[int],
    make: Callable[[], Executor],
    found: dict[int, Account | Failure],
    told: Told,
) -> list[int]:
    """Run the chosen ones on a new executor, fill `found`, and return those lost with a worker."""
    lost = []
    executor = make()
    try:
        futures: dict[Future[Account], int] = {}
        for k in chosen:
            try:
                futures[executor.submit(simulated, runs[k])] = k
            except BrokenExecutor:
                lost.append(k)
        for future in as_completed(futures):
            k, error = futures[future], future.exception()
            if isinstance(error, BrokenExecutor):
                lost.append(k)
                continue
            found[k] = future.result() if error is None else Failure(runs[k], f"{type(error).__name__}: {error}")
            told(len(found), len(runs))
    finally:
        executor.shutdown(cancel_futures=True)
    return lost
