"""The planner beside its peers: `make bench`, or `python bench/planner.py --help`.

One process, one thread. Every solver gets the same `Problem` and gives a `Solution`; repairing the bounds and putting
the answer together is plugd's code for all and is timed with each. OSQP's plans drive the household. Every figure is
processor time of this process, so that a busy machine does not count as slowness; only CBC, a process of its own, and
the years are on the wall clock.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import argparse
import gc
import json
import platform
import random
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, perf_counter_ns, process_time, process_time_ns
from typing import Any

from peers.footprint import footprint
from peers.general import available
from peers.highs import Highs, arrays
from peers.instances import CAPACITY_KWH, Case, Household, jumps
from plugd.planner.bounds import chain
from plugd.planner.exact import Exact
from plugd.planner.problem import Problem, Solution, Solver
from plugd.planner.qp import MAX_GAP, Qp

POWERS_KW, HORIZONS = (10.0, 2.3), (1, 2, 4, 7)
END_VALUE = ((6.0, 140.0), (6.0, 110.0), (6.0, 90.0), (8.0, 60.0))
YARDSTICK = "HiGHS, warm"
SLOW_TICKS = {
    "OSQP, cold": 440,
    "HiGHS, new model": 440,
    "scipy linprog": 110,
    "CVXPY, parametrised": 110,
    "CVXPY, rebuilt": 66,
    "PuLP and CBC, rebuilt": 44,
}
SOME = max(SLOW_TICKS.values())
Table = dict[str, dict[str, float]]


class Cold:
    """A new solver for every tick."""

    def __init__(self, make: Callable[[], Solver]) -> None:
        self._make = make

    def solve(self, problem: Problem) -> Solution:
        """See plugd's Solver."""
        return self._make().solve(problem)


class Tally:
    """What is wrong with a solver's answers, if anything: gaps, fallbacks, second passes, bounds."""

    def __init__(self) -> None:
        self._gaps: list[float] = []
        self._fallbacks = self._seconds = 0
        self._worst_kwh = 0.0

    def add(self, problem: Problem, solution: Solution) -> None:
        """Count one answer; the bounds are checked on the powers, not on what the solution says of itself."""
        self._gaps.append(solution.gap)
        self._fallbacks += solution.status == "fallback"
        self._seconds += solution.status == "fallback" or solution.raw_gap > MAX_GAP
        links, total_kwh = chain(problem), 0.0
        bounds = zip(problem.sessions, solution.power_kw, links.lower_kwh, links.upper_kwh, strict=True)
        for session, power_kw, lower, upper in bounds:
            total_kwh += problem.efficiency * sum(map(float.__mul__, power_kw, session.slot_h))
            self._worst_kwh = max(self._worst_kwh, lower - total_kwh, total_kwh - upper)

    def figures(self) -> dict[str, float]:
        """Percent, points of SOC, counts."""
        return {
            "ticks": len(self._gaps),
            "gap_mean_pct": 100 * sum(self._gaps) / len(self._gaps),
            "gap_p99_pct": 100 * quantile(self._gaps, 0.99),
            "fallbacks": self._fallbacks,
            "second_passes": self._seconds,
            "bound_off_points": 100 * self._worst_kwh / CAPACITY_KWH,
        }


def quantile(numbers: list[float], share: float) -> float:
    """The value that `share` of the numbers do not exceed."""
    return sorted(numbers)[min(len(numbers) - 1, int(share * len(numbers)))]


def median_p99(times_ns: list[float]) -> dict[str, float]:
    """In us, and of how many ticks."""
    found = {"ticks": float(len(times_ns))}
    return {**found, "median_us": quantile(times_ns, 0.5) / 1e3, "p99_us": quantile(times_ns, 0.99) / 1e3}


def closed_loop(case: Case, ticks: int) -> tuple[Table, dict[str, float], list[Problem]]:
    """The warm solvers on every tick, in an order drawn anew each time: their times, OSQP's answers, some problems."""
    solvers: dict[str, Solver] = {"OSQP, warm": Qp(), "exact": Exact()}
    if not case.end_value:
        solvers[YARDSTICK] = Highs()
    times: dict[str, list[float]] = {name: [] for name in solvers}
    household, tally, problems = Household(case, ticks, 2, only_plugged=True), Tally(), []
    order, rng, step = list(solvers), random.Random(5), max(1, ticks // SOME)
    gc.collect()
    for tick in range(ticks):
        problem, found = household.problem(), {}
        if tick % step == 0:
            problems.append(problem)
        rng.shuffle(order)
        for name in order:
            start_ns = process_time_ns()
            found[name] = solvers[name].solve(problem)
            times[name].append(process_time_ns() - start_ns)
        agree(found)
        tally.add(problem, found["OSQP, warm"])
        household.live(found["OSQP, warm"])
    return {name: median_p99(took) for name, took in times.items()}, tally.figures(), problems


def agree(found: dict[str, Solution]) -> None:
    """Every solver gives the exact optimum (what it says of its own objective), or the problems are not the same."""
    bound_g = found["exact"].bound_g
    for name, solution in found.items():
        if abs(solution.bound_g - bound_g) > 1e-4 * max(1.0, abs(bound_g)):
            raise RuntimeError(f"{name} gives {solution.bound_g} g, the exact solver {bound_g} g")


def others(problems: list[Problem], share: int) -> Table:
    """Everything else on some of the same problems, one solver after the other; a `share`-th of SLOW_TICKS."""
    made: dict[str, Solver] = {"OSQP, cold": Cold(Qp), "HiGHS, new model": Cold(Highs)}
    made |= {name: make() for name, make in available().items()}
    found: Table = {}
    for name, solver in made.items():
        ticks = max(2, SLOW_TICKS[name] // share)
        chosen, times = problems[:: max(1, len(problems) // ticks)][:ticks], []
        solver.solve(chosen[0])  # imports
        clock = perf_counter_ns if "CBC" in name else process_time_ns
        for problem in chosen:
            start_ns = clock()
            solution = solver.solve(problem)
            times.append(clock() - start_ns)
            agree({name: solution, "exact": Exact().solve(problem)})
        found[name] = median_p99(times)
    return found | {"HiGHS's own calls alone": bare(problems)}


def bare(problems: list[Problem]) -> dict[str, float]:
    """HiGHS warm, without stating the problem before or putting an answer together after."""
    highs, times = Highs(), []
    for problem in problems:
        links = chain(problem)
        given = arrays(links)
        start_ns = process_time_ns()
        highs.columns(links, given)
        times.append(process_time_ns() - start_ns)
    return median_p99(times)


def year(make: Callable[[], Solver], power_kw: float, ticks: int) -> dict[str, float]:
    """A solver's own closed loop, four nights planned every half hour of a year."""
    solver, tally = make(), Tally()
    household, answered = Household(Case(power_kw, 4), ticks, 3, only_plugged=False), []
    started_s, used_s, solving_ns = perf_counter(), process_time(), 0
    for _ in range(ticks):
        problem = household.problem()
        start_ns = process_time_ns()
        solution = solver.solve(problem)
        solving_ns += process_time_ns() - start_ns
        answered.append((problem, solution))
        household.live(solution)
    took = {"wall_s": perf_counter() - started_s, "cpu_s": process_time() - used_s, "solving_s": solving_ns / 1e9}
    for problem, solution in answered:
        tally.add(problem, solution)
    return took | tally.figures()


def jumped(case: Case, count: int) -> dict[str, float]:
    """OSQP on unrelated states, one workspace throughout."""
    solver, tally, times = Qp(), Tally(), []
    for problem in jumps(case, count, 4):
        start_ns = process_time_ns()
        solution = solver.solve(problem)
        times.append(process_time_ns() - start_ns)
        tally.add(problem, solution)
    return median_p99(times) | tally.figures()


def rows(title: str, table: Table) -> None:
    """Print times and their ratios to warm HiGHS."""
    print(f"\n{title}\n{'':26}{'ticks':>7}{'median us':>11}{'p99 us':>9}{'to warm HiGHS: median':>24}{'p99':>7}")
    yard = table.get(YARDSTICK)
    for name, row in table.items():
        ratio = ""
        if yard:
            ratio = f"{row['median_us'] / yard['median_us']:24.2f}{row['p99_us'] / yard['p99_us']:7.2f}"
        print(f"{name:26}{row['ticks']:7.0f}{row['median_us']:11.1f}{row['p99_us']:9.1f}{ratio}")


def quality(what: str, row: dict[str, float]) -> None:
    """Print what a solver's answers are worth."""
    print(
        f"{what}: gap mean {row['gap_mean_pct']:.4f} %, p99 {row['gap_p99_pct']:.4f} %; "
        f"{row['fallbacks']:.0f} fallbacks, {row['second_passes']:.0f} second passes in {row['ticks']:.0f} ticks; "
        f"no bound off by more than {row['bound_off_points']:.6f} points of SOC"
    )


def readme(found: dict[str, dict[str, Any]]) -> None:
    """Print the README's tables."""
    print("\n| median us (to warm HiGHS) | 10 kW | 2.3 kW |\n|---|---|---|")
    tables = [found[f"{power_kw:g} kW, N = 4"]["times"] for power_kw in POWERS_KW]
    for name in sorted(tables[0], key=lambda name: float(tables[0][name]["median_us"])):
        cells = [
            f"{t[name]['median_us']:,.0f} ({t[name]['median_us'] / t[YARDSTICK]['median_us']:.2f})" for t in tables
        ]
        print(f"| {name} | {' | '.join(cells)} |")
    print("\n| OSQP to warm HiGHS: median, p99 | " + " | ".join(f"N = {n}" for n in HORIZONS) + " |")
    print("|---" * (1 + len(HORIZONS)) + "|")
    for power_kw in POWERS_KW:
        cells = []
        for n in HORIZONS:
            times = found[f"{power_kw:g} kW, N = {n}"]["times"]
            ratios = [times["OSQP, warm"][of] / times[YARDSTICK][of] for of in ("median_us", "p99_us")]
            cells.append(", ".join(f"{ratio:.2f}" for ratio in ratios))
        print(f"| {power_kw:g} kW | {' | '.join(cells)} |")


def run(quick: bool) -> dict[str, dict[str, Any]]:
    """Everything, printed as it comes; all figures by name."""
    found: dict[str, dict[str, Any]] = {}
    ticks = 22 if quick else 2002
    for power_kw in POWERS_KW:
        for sessions in HORIZONS:
            case = Case(power_kw, sessions)
            table, osqp, problems = closed_loop(case, ticks)
            table |= others(problems, 220 if quick else 1)
            rows(f"{power_kw:g} kW, N = {sessions}", table)
            quality("OSQP, warm", osqp)
            found[f"{power_kw:g} kW, N = {sessions}"] = {"times": table, "osqp": osqp}
        table, osqp, _ = closed_loop(Case(power_kw, 4, END_VALUE), ticks)
        rows(f"{power_kw:g} kW, N = 4, energy left worth something in four steps", table)
        quality("OSQP, warm", osqp)
        found[f"{power_kw:g} kW, N = 4, end value"] = {"times": table, "osqp": osqp}
    print("\nA year in closed loop, N = 4, a plan every half hour")
    for power_kw in POWERS_KW:
        for name, make in {"OSQP": Qp, "exact": Exact}.items():
            row = year(make, power_kw, 96 if quick else 17_520)
            took = f"{row['wall_s']:.2f} s wall, {row['cpu_s']:.2f} s processor, {row['solving_s']:.2f} s of it solving"
            quality(f"{power_kw:g} kW, {name}: {took}", row)
            found[f"year, {power_kw:g} kW, {name}"] = row
    print("\nRandom jumps of SOC and plug-in, N = 4")
    for power_kw in POWERS_KW:
        row = jumped(Case(power_kw, 4), 50 if quick else 3000)
        quality(f"{power_kw:g} kW, OSQP: median {row['median_us']:.0f} us, p99 {row['p99_us']:.0f} us", row)
        found[f"jumps, {power_kw:g} kW"] = row
    sizes = footprint(1 if quick else 5)
    print(f"\n{'in a process of its own':26}{'import ms':>11}{'MiB':>7}")
    for name, (took_ms, memory_mib) in sizes.items():
        print(f"{name:26}{took_ms:11.0f}{memory_mib:7.0f}")
    readme(found)
    found["footprint"] = {name: {"import_ms": ms, "memory_mib": mib} for name, (ms, mib) in sizes.items()}
    return found


def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(description="The planner beside its peers. Prints tables, writes nothing.")
    parser.add_argument("--quick", action="store_true", help="a few ticks of everything: that it runs, not how fast")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there too")
    arguments = parser.parse_args()
    print(f"Python {platform.python_version()}, {platform.machine()}, load {os.getloadavg()[0]:.1f}")
    found = run(arguments.quick)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
