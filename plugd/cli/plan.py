"""`plugd plan`."""

import argparse
import json
import sys
import time
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

from plugd.cli.parsing import Commands, config_path


def add(commands: Commands) -> None:
    """The plan now, or of a problem file."""
    plan = commands.add("plan", _plan, "the plan now, or the plan of a problem file")
    plan.add_argument("--json", action="store_true", help="one JSON document")
    plan.add_argument("--problem", type=Path, metavar="FILE", help="needs no configuration")
    plan.add_argument("--solver", choices=("osqp", "exact"), default="osqp")
    plan.add_argument("--explain", action="store_true", help="why these slots, and what each bound costs")


def _plan(options: argparse.Namespace) -> int:
    if options.problem is not None:
        return _plan_problem(options)
    from plugd.adapters.hub import planned
    from plugd.config import load
    from plugd.explanation import document, lines
    from plugd.inspection import decision_now, explained_now

    config = load(config_path(options))
    decision, why = explained_now(config) if options.explain else (decision_now(config), None)
    slots = planned(decision)
    for fault in decision.faults:
        print(f"plugd: {fault.text}", file=sys.stderr)
    if options.json:
        whys = {"explain": document(*why)} if why else {}
        print(json.dumps({"reason": decision.reason, "plan": slots, **whys}))
        return 0
    print(decision.reason)
    zone = ZoneInfo(config.home.timezone)
    for slot in slots:
        start = datetime.fromisoformat(slot["start"]).astimezone(zone)
        print(f"{start:%a %d %b %H:%M}  {slot['power_kw']:5.2f} kW  {slot['intensity_g_per_kwh']:3.0f} g/kWh")
    for line in lines(*why) if why else ():
        print(line)
    return 0


def _plan_problem(options: argparse.Namespace) -> int:
    from plugd import explanation
    from plugd.planner.exact import Exact
    from plugd.planner.marginal import explain
    from plugd.planner.problem import Solver
    from plugd.problem_file import answer, read

    problem, echo = read(options.problem)
    solver: Solver
    if options.solver == "exact":
        solver = Exact()
    else:
        from plugd.planner.qp import Qp

        solver = Qp()
    began = time.perf_counter()
    solution = solver.solve(problem)
    document = answer(echo, solution, 1000.0 * (time.perf_counter() - began))
    why = None
    if options.explain:
        explained = explain(problem, solution)
        why = explained, echo.capacity_kwh, explanation.numbered(explained)
        document["explain"] = explanation.document(*why)
    if options.json:
        print(json.dumps(document, allow_nan=False))
        return 0
    for number, (end_kwh, short_kwh) in enumerate(
        zip(solution.energy_kwh, solution.shortfall_kwh, strict=True), start=1
    ):
        short = f", {short_kwh:.2f} kWh short of its minimum" if short_kwh > 0.005 else ""
        print(f"session {number}: ends at {100 * end_kwh / echo.capacity_kwh:.1f} %{short}")
    print(f"{solution.status} by {solution.solver}: {solution.carbon_g:.1f} g, gap {solution.gap:.2g}")
    for line in explanation.lines(*why) if why else ():
        print(line)
    return 0
