"""The commands of the experiments with a figure, and of those that go beyond the paper."""

import argparse
import time
from datetime import datetime, timedelta
from itertools import takewhile
from pathlib import Path
from statistics import fmean
from typing import Any

from plugd import series
from plugd.errors import UsageError
from plugd.study import crowd, drawing, flexibility, measured, table, variants, week
from plugd.study.crowd import Crowd
from plugd.study.engine import Account
from plugd.study.forecasts import Noise, Synthetic
from plugd.study.measured import Measured
from plugd.study.runs import Failure
from plugd.study.telling import answers, code, columns, day, horizons, performed, positive, shared, since, tell
from plugd.units import HALF_HOUR, iso

DRAWN = "the figure as PNG and SVG, its numbers as CSV and JSON"
COLUMNS = ("stay", "length_h", "use_kwh", "carbon_g_per_kwh")


def add(experiments: "argparse._SubParsersAction[Any]") -> None:
    """All of them."""
    one = experiments.add_parser("week", help="state of charge and carbon over a week (Figures 2 and 3)")
    _world(one, days=7, first="a week after the file's first noon")
    one.add_argument("--seed", type=int, default=0, metavar="N")
    shared(one, DRAWN)
    one.set_defaults(does=_week)
    for name, does, told in (
        ("flexibility", _flexibility, "carbon by stay at the plug and daily use (Figure 4)"),
        ("credits", _credits, "what each of Figure 4's drivers would sell or buy in a market of credits"),
    ):
        one = experiments.add_parser(name, help=told)
        _world(one, days=31, first="the file's first noon")
        if does is _credits:
            one.add_argument("--threshold", type=float, metavar="G", help="g/kWh; default: what makes the pool even")
        shared(one, DRAWN)
        one.set_defaults(does=does)
    one = experiments.add_parser("forecast", help="the synthetic long-range forecast of a week (Figure 1)")
    _world(one, days=7, first="the file's first noon", end_value=False)
    one.add_argument("--seed", type=int, default=0, metavar="N")
    answers(one, DRAWN)
    one.set_defaults(does=_forecast)
    one = experiments.add_parser("variants", help="charger or relay, with and without the end value")
    _world(one, days=365, first="the file's first noon", end_value=False)
    one.add_argument("--horizons", type=horizons, default=(1, 2, 4), metavar="LIST", help="default 1,2,4")
    one.add_argument("--seeds", type=positive, default=1, metavar="N", help="default 1")
    shared(one)
    one.set_defaults(does=_variants)
    one = experiments.add_parser("crowd", help="what is left of the saving when many choose the same half hours")
    _world(one, days=28, first="the file's first noon")
    usual = Crowd()
    one.add_argument("--fleet", type=float, default=usual.fleet, metavar="CARS", help=f"default {usual.fleet:g}")
    one.add_argument("--slope", type=float, default=usual.slope_g_per_kwh_gw, metavar="G",
                     help=f"g/kWh per GW of load, an assumption (default {usual.slope_g_per_kwh_gw:g})")  # fmt: skip
    one.add_argument("--cars", type=positive, default=usual.cars, metavar="N",
                     help=f"that stand for the fleet (default {usual.cars})")  # fmt: skip
    shared(one, DRAWN)
    one.set_defaults(does=_crowd)


def _world(parser: argparse.ArgumentParser, *, days: int, first: str, end_value: bool = True) -> None:
    """Which time of which series, and what is known of it."""
    add = parser.add_argument
    add("--actual", type=Path, required=True, metavar="CSV", help="measured intensity: from, actual and forecast")
    add("--error-from", type=Path, metavar="CSV", help="one-step errors of this file, same half hour of the year")
    add("--from", dest="since", type=day, metavar="DATE", help=f"from its noon (default: {first})")
    add("--days", type=positive, default=days, metavar="N", help=f"default {days}")
    add("--noise", choices=[kind.value for kind in Noise], default=Noise.TARGET.value, help="default target")
    if end_value:
        add("--end-value", choices=("on", "off"), default="on", help="default on")


def _loaded(options: argparse.Namespace, after: timedelta = timedelta(0)) -> tuple[Measured, datetime, datetime]:
    """The world, and the time asked for, begun `after` the first noon where nothing is said. Raises UsageError."""
    found = measured.load(options.actual, options.error_from)
    if options.noise != Noise.NONE.value and not any(found.error):
        raise UsageError(
            f"--noise {options.noise}: {options.actual} has no forecast beside its actual; "
            "name a file that has both with --error-from, or say --noise none"
        )
    start, end = measured.between(found, options.since, None)
    start = start if options.since else start + after
    if start >= end:
        raise UsageError(f"{options.actual}: ends before {start:%Y-%m-%d %H:%M}; give a longer file or another --from")
    return found, start, min(end, start + timedelta(days=options.days))


def _week(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    found, start, end = _loaded(options, week.WARM_UP)
    noise, value = Noise(options.noise), options.end_value == "on"
    outcomes = performed(week.runs(found, start, end, noise, options.seed, end_value=value), options)
    shown = week.week(found, start, end, outcomes)
    rows = list(week.rows(shown))
    totals: list[dict[str, Any]] = [
        {"strategy": c.name, "horizon": c.horizon, "carbon_g": round(of[-1], 1), "soc_pct": round(100 * soc[-1], 1)}
        for (c, of), soc in zip(shown.carbon_g.items(), shown.soc.values(), strict=True)
    ]
    stays = [{"arrival": iso(arrival), "departure": iso(departure)} for arrival, departure in shown.stays]
    if options.out is not None and shown.soc:
        drawing.week(options.out, shown)
    lines = columns([("", "kg CO2", "SOC % at the end"), *(
        (table.name(table.Choice(t["strategy"], t["horizon"])), f"{t['carbon_g'] / 1000:.2f}", t["soc_pct"])
        for t in totals
    )])  # fmt: skip
    tell(options, "week", {"rows": rows, "totals": totals, "stays": stays, "wall_s": since(began)}, lines, rows)
    return code(outcomes)


def _flexible(options: argparse.Namespace) -> tuple[list[dict[str, Any]], list[Account | Failure]]:
    found, start, end = _loaded(options)
    noise, value = Noise(options.noise), options.end_value == "on"
    runs = [flexibility.run(profile, found, start, end, noise, end_value=value) for profile in flexibility.PROFILES]
    outcomes = performed(runs, options)
    return flexibility.rows(zip(flexibility.PROFILES, outcomes, strict=True)), outcomes


def _flexibility(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    rows, outcomes = _flexible(options)
    if options.out is not None:
        drawing.flexibility(options.out, rows)
    lines = columns([COLUMNS, *([row[key] for key in COLUMNS] for row in rows)])
    tell(options, "flexibility", {"rows": rows, "wall_s": since(began)}, lines, rows)
    return code(outcomes)


def _credits(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    rows, outcomes = _flexible(options)
    threshold = flexibility.even_g_per_kwh(rows) if options.threshold is None else options.threshold
    credited = flexibility.credited(rows, threshold)
    pool = flexibility.pool(credited)
    if options.out is not None:
        drawing.credits_by_driver(options.out, credited, threshold)
    keys = (*COLUMNS, "credit_g_per_kwh", "credit_g")
    lines = columns([keys, *([row[key] for key in keys] for row in credited)])
    lines += ["", f"threshold {threshold:.1f} g/kWh", *(f"{key} {value:g}" for key, value in pool.items())]
    document = {"threshold_g_per_kwh": round(threshold, 3), "rows": credited, "pool": pool, "wall_s": since(began)}
    tell(options, "credits", document, lines, credited)
    return code(outcomes)


def _forecast(options: argparse.Namespace) -> int:
    found, start, end = _loaded(options)
    recorded = series.load(options.actual)
    slots = list(takewhile(lambda at: at < end, (start + k * HALF_HOUR for k in range(found.index(end)))))
    issued = Synthetic(found, Noise(options.noise), options.seed, start)
    expected = issued.expected(start, slots)
    curves = (
        ("Measured", [found.actual[found.index(at)] for at in slots]),
        ("One step ahead", [recorded.forecast_at(at) for at in slots]),
        ("Issued at the start", expected),
    )
    rows = [
        {"at": iso(at), "actual_g_per_kwh": actual, "one_step_g_per_kwh": one, "forecast_g_per_kwh": round(g, 2)}
        for at, actual, one, g in zip(slots, *(values for _, values in curves), strict=True)
    ]
    if options.out is not None:
        drawing.forecast(options.out, slots, curves)
    errors = [abs(r["forecast_g_per_kwh"] / max(r["actual_g_per_kwh"], 1.0) - 1.0) for r in rows]
    whole_days = [errors[k : k + 48] for k in range(0, len(errors) - 47, 48)]
    off = [{"day": k + 1, "mape_pct": round(100 * fmean(of), 2)} for k, of in enumerate(whole_days)]
    lines = columns([("day", "MAPE %"), *((row["day"], row["mape_pct"]) for row in off)])
    tell(options, "forecast", {"rows": rows, "days": off}, lines, rows)
    return 0


def _variants(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    found, start, end = _loaded(options)
    asked = list(variants.runs(found, start, end, options.horizons, Noise(options.noise), options.seeds))
    outcomes = performed([run for _, run in asked], options)
    rows = variants.rows((variant, run, of) for (variant, run), of in zip(asked, outcomes, strict=True))
    keys = ("plug", "power_kw", "end_value", "horizon", "carbon_g_per_kwh", "reduction_pct", "missed_mornings",
            "switch_ons_per_night")  # fmt: skip
    lines = columns([keys, *([row[key] for key in keys] for row in rows)])
    tell(options, "variants", {"rows": rows, "wall_s": since(began)}, lines, rows)
    return code(outcomes)


def _crowd(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    found, start, end = _loaded(options)
    asked = Crowd(fleet=options.fleet, slope_g_per_kwh_gw=options.slope, cars=options.cars)
    runs = list(crowd.runs(asked, found, start, end, Noise(options.noise), end_value=options.end_value == "on"))
    outcomes = performed([run for _, run in runs], options)
    pairs = zip(runs, outcomes, strict=True)
    rows = crowd.rows(asked, found, ((delay, of) for (delay, _), of in pairs if isinstance(of, Account)))
    if options.out is not None:
        drawing.crowd(options.out, rows)
    keys = ("delay_h", "share_pct", "cars", "carbon_g_per_kwh", "reduction_pct", "peak_gw")
    lines = columns([keys, *([row[key] for key in keys] for row in rows)])
    terms = {"fleet": asked.fleet, "slope_g_per_kwh_gw": asked.slope_g_per_kwh_gw, "cars": asked.cars}
    tell(options, "crowd", {**terms, "rows": rows, "wall_s": since(began)}, lines, rows)
    return code(outcomes)
