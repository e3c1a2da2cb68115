"""`plugd study ...`: arguments to runs, runs to numbers on stdout and in `--out`."""

import argparse
import csv
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from datetime import date
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any

from plugd import series
from plugd.errors import PlugdError, UsageError
from plugd.series import IntensitySeries
from plugd.study import measured, table
from plugd.study.engine import Account
from plugd.study.forecasts import PAPER_GROWTH, Noise
from plugd.study.growth import growth_per_half_hour
from plugd.study.runs import Failure, Run, perform, pool
from plugd.study.table import Choice, Terms

NAMED = ("uncontrolled", "latest-start", "cheapest-tonight")
MAX_HORIZON = 7
BAR = 30


Regions = Callable[[date, date], dict[int, IntensitySeries]]
"""Fetches every region of the days between two dates: the study itself knows no network."""


def main(parser: argparse.ArgumentParser, arguments: Sequence[str], regions: Regions | None = None) -> int:
    """Run an experiment. Returns the exit code; raises PlugdError for one line on stderr."""
    options = _arguments(parser).parse_args(arguments)
    options.fetched = regions
    code: int = options.does(options)
    return code


def _arguments(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    experiments = parser.add_subparsers(dest="experiment", required=True, metavar="EXPERIMENT")
    one = experiments.add_parser("table", help="carbon and reduction by strategy over a year (the paper's Table I)")
    one.add_argument("--year", type=int, metavar="YYYY", help="one year of the file; default: all of it")
    _common(one, strategies="uncontrolled,1,2,4,7", noise=Noise.TARGET, end_value="on", seeds=5)
    one.set_defaults(does=_table)
    all_regions = experiments.add_parser("regions", help="the same in every region of a file (the paper's Figure 5)")
    days: dict[str, Any] = {"type": date.fromisoformat, "metavar": "DATE"}
    all_regions.add_argument("--from", dest="since", default=date(2023, 1, 1), **days,
                             help="without --actual: what to fetch from the API (default 2023-01-01)")  # fmt: skip
    all_regions.add_argument("--to", dest="until", default=date(2023, 2, 1), **days,
                             help="not included (default 2023-02-01)")  # fmt: skip
    _common(all_regions, strategies="uncontrolled,1,2,4", noise=Noise.NONE, end_value="off", seeds=5)
    all_regions.set_defaults(does=_regions)
    return parser


def _common(parser: argparse.ArgumentParser, *, strategies: str, noise: Noise, end_value: str, seeds: int) -> None:
    add = parser.add_argument
    add("--actual", type=Path, required=parser.get_default("since") is None, metavar="CSV",
        help="measured intensity: from, actual and forecast")  # fmt: skip
    add("--noise", choices=[kind.value for kind in Noise], default=noise.value,
        help=f"whose one-step error the long forecast grows from (default {noise.value})")  # fmt: skip
    add("--error-from", type=Path, metavar="CSV", help="one-step errors of this file, same half hour of the year")
    add("--growth-from", type=Path, nargs="+", metavar="CSV",
        help=f"growth of the error from these issued forecasts (default {PAPER_GROWTH:g} a half hour)")  # fmt: skip
    add("--strategies", type=_strategies, default=_strategies(strategies), metavar="LIST",
        help=f"nights planned together (1 to 7), {', '.join(NAMED)} (default {strategies})")  # fmt: skip
    add("--end-value", choices=("on", "off"), default=end_value,
        help=f"whether energy left at the horizon's end is worth something (default {end_value})")  # fmt: skip
    add("--solver", choices=("exact", "osqp"), default="exact")
    add("--seeds", type=_positive, default=seeds, metavar="N", help=f"default {seeds}")
    add("--workers", type=_positive, default=min(2, os.cpu_count() or 1), metavar="N", help="processes")
    add("--json", action="store_true", help="one JSON document")
    add("--out", type=Path, metavar="DIR", help="also write the numbers there, as CSV and JSON")


def _strategies(text: str) -> tuple[Choice, ...]:
    chosen = []
    for word in filter(None, (part.strip() for part in text.split(","))):
        if word in NAMED:
            chosen.append(Choice(word))
        elif word.isdecimal() and 1 <= int(word) <= MAX_HORIZON:
            chosen.append(Choice("mpc", int(word)))
        else:
            raise argparse.ArgumentTypeError(f"{word!r} is none of {', '.join(NAMED)} or 1 to {MAX_HORIZON} nights")
    if not chosen:
        raise argparse.ArgumentTypeError("name at least one strategy")
    return tuple(chosen)


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return int(text)


def _terms(options: argparse.Namespace) -> Terms:
    growth = growth_per_half_hour(options.growth_from) if options.growth_from else PAPER_GROWTH
    return Terms(Noise(options.noise), options.end_value == "on", options.solver, options.seeds, growth)


def _table(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    found = measured.load(options.actual, options.error_from)
    _check_errors(options, [found])
    runs = table.runs(found, *measured.span(found, options.year), options.strategies, _terms(options))
    outcomes = performed(runs, options.workers)
    rows = table.tabulated(runs, outcomes)
    _tell(options, "table", {**table.document(rows), "wall_s": _since(began)}, table.lines(rows))
    return _code(outcomes)


def _regions(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    regions = _regions_of(options)
    _check_errors(options, regions.values())
    terms = _terms(options)
    lists = {
        region: table.runs(found, *measured.span(found, None), options.strategies, terms)
        for region, found in regions.items()
    }
    outcomes = performed([run for runs in lists.values() for run in runs], options.workers)
    left, document, shown = iter(outcomes), _empty(), []
    every: dict[Choice, list[float]] = {}
    for region, runs in lists.items():
        rows = table.tabulated(runs, [next(left) for _ in runs])
        for key, values in table.document(rows).items():
            document[key] += [{"regionid": region, **value} for value in values]
        for row in rows:
            if row.reduction_pct is not None:
                every.setdefault(row.choice, []).append(row.reduction_pct)
        shown += [f"region {region}", *table.lines(rows), ""]
    means = [
        {
            "strategy": choice.name,
            "horizon": choice.horizon,
            "reduction_pct": round(fmean(cuts), 3),
            "regions": len(cuts),
        }
        for choice, cuts in every.items()
    ]
    shown += [
        f"{table.name(choice)}: mean of {len(cuts)} regions {fmean(cuts):.2f} %" for choice, cuts in every.items()
    ]
    _tell(options, "regions", {**document, "means": means, "wall_s": _since(began)}, shown)
    return _code(outcomes)


def _regions_of(options: argparse.Namespace) -> dict[int, measured.Measured]:
    """The regions of the file, or of the API where none is named."""
    if options.actual is not None:
        return measured.load_regions(options.actual, options.error_from)
    if options.fetched is None:
        raise UsageError("study regions: name a file with --actual")
    other = None if options.error_from is None else series.load(options.error_from)
    found = options.fetched(options.since, options.until)
    return {region: measured.measured(f"NESO, region {region}", one, other) for region, one in found.items()}


def _empty() -> dict[str, list[dict[str, Any]]]:
    return {"rows": [], "perfect": []}


def _check_errors(options: argparse.Namespace, found: Iterable[measured.Measured]) -> None:
    """Noise needs errors to grow from."""
    if options.noise != Noise.NONE.value and not any(any(world.error) for world in found):
        raise UsageError(
            f"--noise {options.noise}: {options.actual or 'the API'} has no forecast beside its actual; "
            "name a file that has both with --error-from, or say --noise none"
        )


def performed(runs: Sequence[Run], workers: int) -> list[Account | Failure]:
    """All runs on a process pool, with a bar on stderr where somebody looks; failures are told there."""
    outcomes = perform(runs, partial(pool, min(workers, len(runs))), _bar if sys.stderr.isatty() else _silent)
    for outcome in outcomes:
        if isinstance(outcome, Failure):
            print(f"plugd: {outcome}", file=sys.stderr)
    return outcomes


def _bar(done: int, of: int) -> None:
    full = BAR * done // max(1, of)
    print(
        f"\r[{'#' * full}{'.' * (BAR - full)}] {done} of {of} runs",
        end="" if done < of else "\n",
        file=sys.stderr,
        flush=True,
    )


def _silent(done: int, of: int) -> None:
    """Nobody looks."""


def _code(outcomes: Sequence[Account | Failure]) -> int:
    return int(any(isinstance(outcome, Failure) for outcome in outcomes))


def _since(began: float) -> float:
    return round(time.perf_counter() - began, 2)


def _tell(options: argparse.Namespace, name: str, document: dict[str, Any], shown: Sequence[str]) -> None:
    """Numbers to stdout, and to files where asked."""
    if options.out is not None:
        written(options.out, name, document)
    if options.json:
        print(json.dumps(document, allow_nan=False))
        return
    for line in shown:
        print(line)


def written(folder: Path, name: str, document: dict[str, Any]) -> None:
    """`name`.json with all of a document, `name`.csv with its rows. Raises PlugdError."""
    rows: list[dict[str, Any]] = [*document["rows"], *({"strategy": "perfect", **row} for row in document["perfect"])]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.json").write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
        with (folder / f"{name}.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise PlugdError(f"--out {folder}: cannot be written ({error.strerror}); name another folder") from error
