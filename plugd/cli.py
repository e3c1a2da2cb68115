"""The commands. Each is thin: it reads arguments, calls one function, prints, and turns errors into exit codes."""

import argparse
import json
import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from datetime import date
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from plugd import __version__
from plugd.errors import AlreadyRunning, ConfigError, PlugdError, UsageError

if TYPE_CHECKING:
    from plugd.config import Config
    from plugd.series import IntensitySeries

DEFAULT_CONFIG = Path("/etc/plugd/plugd.toml")
EXIT_CODES: tuple[tuple[type[PlugdError], int], ...] = (
    (ConfigError, 78),
    (AlreadyRunning, 75),
    (UsageError, 2),
    (PlugdError, 1),
)


class Parser(argparse.ArgumentParser):
    """argparse with the one line of every other error."""

    def error(self, message: str) -> NoReturn:
        """Say it on one line and end with 2."""
        print(f"{self.prog}: {message}; {self.prog} --help tells more", file=sys.stderr)
        raise SystemExit(2)


def _config_path(options: argparse.Namespace) -> Path:
    return Path(options.config or os.environ.get("PLUGD_CONFIG") or DEFAULT_CONFIG)


def _run(options: argparse.Namespace) -> int:
    from plugd import daemon
    from plugd.adapters.clock import SystemClock
    from plugd.config import load

    clock = SystemClock()
    try:
        daemon.run(load(_config_path(options)), clock)
    finally:
        clock.close()
    return 0


def _plan(options: argparse.Namespace) -> int:
    if options.problem is not None:
        return _plan_problem(options)
    from plugd.adapters.hub import planned
    from plugd.config import load
    from plugd.explanation import document, lines
    from plugd.inspection import decision_now, explained_now

    config = load(_config_path(options))
    decision, why = explained_now(config) if options.explain else (decision_now(config), None)
    slots = planned(decision)
    for fault in decision.faults:
        print(f"plugd: {fault.text}", file=sys.stderr)
    if options.json:
        whys = {"explain": document(*why)} if why else {}
        print(json.dumps({"reason": decision.reason, "plan": slots, **whys}))
        return 0
    print(decision.reason)
    for slot in slots:
        print(f"{slot['start']}  {slot['power_kw']:.2f} kW  {slot['intensity_g_per_kwh']:.0f} g/kWh")
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


def _check(options: argparse.Namespace) -> int:
    from plugd.config import load
    from plugd.inspection import check

    path = _config_path(options)
    config = load(path)
    print(f"ok    configuration: {path}")
    good = True
    for finding in check(config, click=options.click):
        good = good and finding.ok
        print(f"{'ok   ' if finding.ok else 'MEND '} {finding.what}: {finding.text}")
    return 0 if good else 1


def _report(options: argparse.Namespace) -> int:
    from plugd import report
    from plugd.config import load

    def progress(words: str) -> None:
        if sys.stderr.isatty():
            print(words, file=sys.stderr)

    if options.days < 1:
        raise UsageError(f"--days {options.days}: choose at least 1")
    config = load(_config_path(options))
    whole = options.json or options.out is not None
    horizons = report.HORIZONS if options.horizons is None and whole else options.horizons or ()
    found = report.gathered(config, options.days, horizons, progress)
    if options.out is not None:
        from plugd.report_page import page

        try:
            options.out.write_text(page(found), encoding="utf-8")
        except OSError as error:
            raise PlugdError(f"{options.out}: cannot be written ({error.strerror}); name another with --out") from error
        if not options.json:
            print(f"{options.out}: {report.headline(found)}")
    if options.json:
        print(json.dumps(report.document(found), allow_nan=False))
    elif options.csv:
        print(report.table(found), end="")
    elif options.out is None:
        print("\n".join(report.lines(found)))
    return 0


def _counts(text: str) -> tuple[int, ...]:
    """Horizons from "1,2,4"."""
    found = tuple(int(part) for part in text.split(","))
    if not all(1 <= count <= 7 for count in found):
        raise ValueError(text)
    return found


def _plug(options: argparse.Namespace) -> int:
    from plugd.config import load
    from plugd.inspection import switch

    print(switch(load(_config_path(options)), options.do, getattr(options, "amps", None)))
    return 0


def _history(options: argparse.Namespace) -> int:
    from plugd import history

    if options.do == "show":
        config = _configured(options)
        if config is None:
            raise UsageError("history show: there is no configuration; name it with -c")
        print("\n".join(history.shown(config)))
        return 0
    print(history.fetch(_configured(options), options.region, options.since, options.until, options.out, _progress))
    return 0


def _configured(options: argparse.Namespace) -> "Config | None":
    """The configuration, where there is one; one that was named must be there."""
    from plugd.config import load

    path = _config_path(options)
    named = options.config or os.environ.get("PLUGD_CONFIG")
    return load(path) if named or path.exists() else None


def _progress(words: str) -> None:
    if sys.stderr.isatty():
        print(words, file=sys.stderr)


def _day(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no date; write it as 2023-01-31") from error


def _demo(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    """Hand over to the bench, which is a program of its own."""
    missing = [name for name in ("plugd_hil", "rich") if find_spec(name) is None]
    if missing:
        raise PlugdError(f"the demo needs {' and '.join(missing)}: pip install 'plugd[demo]'")
    os.execv(sys.executable, [sys.executable, "-m", "plugd_hil.demo", *arguments])


def _study(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    from plugd.study import command

    def regions(since: date, until: date) -> dict[int, "IntensitySeries"]:
        from plugd import history
        from plugd.adapters.clock import SystemClock

        with closing(SystemClock()) as clock:
            return history.regions(_configured(options), since, until, clock, _progress)

    parser = Parser(prog="plugd study", description="The paper's experiments, and ours.")
    return command.main(parser, arguments, regions)


HANDED_OVER = {"demo": _demo, "study": _study}
"""Commands that read their own arguments."""


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="plugd",
        description="Charge an electric car when the grid is cleanest, over several nights at once.",
    )
    parser.add_argument("-c", "--config", metavar="FILE", help=f"default: $PLUGD_CONFIG, else {DEFAULT_CONFIG}")
    parser.add_argument("-v", "--verbose", action="store_true", help="say more on stderr")
    parser.add_argument("--version", action="version", version=f"plugd {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, does: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=text)
        command.set_defaults(does=does)
        return command

    add("run", _run, "the daemon")
    commands.add_parser("demo", add_help=False, help="the daemon against a stub plug, a week in a minute")
    commands.add_parser("study", add_help=False, help="the paper's experiments and ours; `plugd study -h` lists them")
    check = add("check", _check, "configuration, broker, plug, forecast, clock, disk: ok, or what to mend")
    check.add_argument("--click", action="store_true", help="also switch on, look at the power, switch off")
    plan = add("plan", _plan, "the plan now, or the plan of a problem file")
    plan.add_argument("--json", action="store_true", help="one JSON document")
    plan.add_argument("--problem", type=Path, metavar="FILE", help="needs no configuration")
    plan.add_argument("--solver", choices=("osqp", "exact"), default="osqp")
    plan.add_argument("--explain", action="store_true", help="why these slots, and what each bound costs")
    past = commands.add_parser("history", help="past carbon intensity: fetch it, or show what is known")
    does = past.add_subparsers(dest="do", required=True, metavar="fetch|show")
    past.set_defaults(does=_history)
    fetch = does.add_parser("fetch", help="from the API into the store, or a CSV file")
    fetch.add_argument("--from", dest="since", type=_day, required=True, metavar="DATE")
    fetch.add_argument("--to", dest="until", type=_day, required=True, metavar="DATE", help="not included")
    fetch.add_argument("--region", type=int, metavar="ID", help="1 to 17; default: the configured place, or the nation")
    fetch.add_argument("--out", type=Path, metavar="CSV", help="instead of the store; needs no configuration")
    does.add_parser("show", help="what the store knows")
    report = add("report", _report, "what was charged, how clean it was, and what it is compared with")
    report.add_argument("--days", type=int, default=30, help="how many nights (default 30)")
    report.add_argument("--out", type=Path, metavar="FILE", help="an HTML page that needs nothing else")
    as_text = report.add_mutually_exclusive_group()
    as_text.add_argument("--json", action="store_true", help="one JSON document")
    as_text.add_argument("--csv", action="store_true", help="one line a night")
    report.add_argument(
        "--horizons", type=_counts, metavar="N,N", help="replay with these; a page and JSON have 1,2,4,7 by themselves"
    )
    plug = add("plug", _plug, "the plug by hand")
    by_hand = plug.add_subparsers(dest="do", required=True, metavar="DO")
    for name, text in (("show", "how it is"), ("on", "switch it on"), ("off", "switch it off, and leave it so")):
        by_hand.add_parser(name, help=text, description=text)
    amps = by_hand.add_parser("amps", help="a charger's current", description="A charger's current; 0 pauses it.")
    amps.add_argument("amps", type=float, metavar="N", help="amperes")
    return parser


def _commanded(given: Sequence[str]) -> int:
    parser = _parser()
    options, rest = parser.parse_known_args(given)
    if options.command in HANDED_OVER:
        return HANDED_OVER[options.command](options, rest)
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    # Only the daemon's log is read by somebody; the other commands say all that matters themselves.
    level = logging.INFO if options.command == "run" else logging.ERROR
    logging.basicConfig(
        level=logging.DEBUG if options.verbose else level,
        format="%(levelname)s %(name)s: %(message)s",
    )
    logging.getLogger("apscheduler").setLevel(logging.WARNING)
    code: int = options.does(options)
    return code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Returns the exit code; errors are one line on stderr."""
    try:
        try:
            return _commanded(list(sys.argv[1:] if arguments is None else arguments))
        finally:
            sys.stdout.flush()  # here, where a closed pipe is expected, and not at the interpreter's end
    except PlugdError as error:
        print(f"plugd: {error}", file=sys.stderr)
        return next(code for kind, code in EXIT_CODES if isinstance(error, kind))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        with suppress(OSError):
            sys.stdout.close()
        return 1
