"""`plugd study ...`: arguments to runs, runs to numbers on stdout and in `--out`."""

import argparse
import time
from collections.abc import Callable, Iterable, Sequence
from datetime import date
from pathlib import Path
from statistics import fmean
from typing import Any

from plugd import series
from plugd.errors import UsageError
from plugd.series import IntensitySeries
from plugd.study import backtest, drawing, experiments, issued, measured, table
from plugd.study.forecasts import PAPER_GROWTH, Noise
from plugd.study.growth import growth_per_half_hour
from plugd.study.table import Choice, Terms
from plugd.study.telling import MAX_HORIZON, code, day, horizons, performed, positive, shared, since, tell

NAMED = ("uncontrolled", "latest-start", "cheapest-tonight")


Regions = Callable[[date, date], dict[int, IntensitySeries]]
"""Fetches every region of the days between two dates: the study itself knows no network."""


def main(parser: argparse.ArgumentParser, arguments: Sequence[str], regions: Regions | None = None) -> int:
    """Run an experiment. Returns the exit code; raises PlugdError for one line on stderr."""
    options = _arguments(parser).parse_args(arguments)
    options.fetched = regions
    code: int = options.does(options)
    return code


def _arguments(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    parsers = parser.add_subparsers(dest="experiment", required=True, metavar="EXPERIMENT")
    one = parsers.add_parser("table", help="carbon and reduction by strategy over a year (the paper's Table I)")
    one.add_argument("--year", type=int, metavar="YYYY", help="one year of the file; default: all of it")
    _common(one, strategies="uncontrolled,1,2,4,7", noise=Noise.TARGET, end_value="on", seeds=5)
    one.set_defaults(does=_table)
    all_regions = parsers.add_parser("regions", help="the same in every region of a file (the paper's Figure 5)")
    days: dict[str, Any] = {"type": day, "metavar": "DATE"}
    all_regions.add_argument("--from", dest="since", default=date(2023, 1, 1), **days,
                             help="without --actual: what to fetch from the API (default 2023-01-01)")  # fmt: skip
    all_regions.add_argument("--to", dest="until", default=date(2023, 2, 1), **days,
                             help="not included (default 2023-02-01)")  # fmt: skip
    _common(all_regions, strategies="uncontrolled,1,2,4", noise=Noise.NONE, end_value="off", seeds=5)
    all_regions.set_defaults(does=_regions)
    past = parsers.add_parser("backtest", help="what is captured with forecasts as they were really issued")
    past.add_argument("--data", type=Path, nargs="+", required=True, metavar="FILE",
                      help="one zone each: issued,lead_h,forecast,actual, as .csv or .csv.gz")  # fmt: skip
    past.add_argument("--horizons", type=horizons, default=(1, 2, 3, 4), metavar="LIST", help="default 1,2,3,4")
    past.add_argument("--from", dest="since", type=day, metavar="DATE", help="default: the first noon of each file")
    past.add_argument(
        "--to", dest="until", type=day, metavar="DATE", help="not included; default: the end of each file"
    )
    _learning(past, "on")
    past.add_argument("--forecasts", choices=("corrected", "raw"), default="corrected",
                      help="with what was learned from past errors (default), or as they are")  # fmt: skip
    shared(past)
    past.set_defaults(does=_backtest)
    experiments.add(parsers)
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
    _learning(parser, "off")
    add("--solver", choices=("exact", "osqp"), default="exact")
    add("--seeds", type=positive, default=seeds, metavar="N", help=f"default {seeds}")
    shared(parser)


def _learning(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument("--learn", choices=("on", "off"), default=default,
                        help=f"whether the driver's times and use are learned (default {default})")  # fmt: skip


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


def _terms(options: argparse.Namespace) -> Terms:
    growth = growth_per_half_hour(options.growth_from) if options.growth_from else PAPER_GROWTH
    learn = options.learn == "on"
    return Terms(Noise(options.noise), options.end_value == "on", options.solver, options.seeds, growth, learn)


def _table(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    found = measured.load(options.actual, options.error_from)
    _check_errors(options, [found])
    runs = table.runs(found, *measured.span(found, options.year), options.strategies, _terms(options))
    outcomes = performed(runs, options)
    rows = table.tabulated(runs, outcomes)
    document = table.document(rows)
    if options.out is not None:
        drawing.reductions(options.out, document["rows"], document["perfect"])
    tell(options, "table", {**document, "wall_s": since(began)}, table.lines(rows))
    return code(outcomes)


def _regions(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    regions = _regions_of(options)
    _check_errors(options, regions.values())
    terms = _terms(options)
    lists = {
        region: table.runs(found, *measured.span(found, None), options.strategies, terms)
        for region, found in regions.items()
    }
    outcomes = performed([run for runs in lists.values() for run in runs], options)
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
    if options.out is not None:
        drawing.regions(options.out, document["rows"])
    tell(options, "regions", {**document, "means": means, "wall_s": since(began)}, shown)
    return code(outcomes)


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


def _backtest(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    lists = {}
    for path in options.data:
        issues = issued.load(path)
        lists[str(path)] = backtest.runs(
            issues,
            *measured.between(issues.found, options.since, options.until),
            options.horizons,
            learn=options.learn == "on",
            corrected=options.forecasts == "corrected",
        )
    outcomes = performed([run for runs in lists.values() for run in runs], options)
    left = iter(outcomes)
    found = backtest.document({name: [(run, next(left)) for run in runs] for name, runs in lists.items()})
    tell(options, "backtest", {**found, "wall_s": since(began)}, backtest.lines(found), backtest.table(found))
    return code(outcomes)
