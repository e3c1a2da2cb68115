"""Random and nearly valid input at everything that plugd reads and others write: it answers, or refuses in one line.

Forecasts, commands, problem files and the configuration here; stored state in `fuzz_stored.py`, the page in
`fuzz_page.py`; payloads of plugs and frames have programs of their own (`fuzz_plugs.py`, `fuzz_can.py`).

    python -m tests.fuzz_parsers [--inputs 100000] [--seed N] [--only NAME ...]
"""

import argparse
import json
import random
import re
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from plugd.adapters.neso_body import MOST_G_PER_KWH, NATIONAL, error_message, parse_past
from plugd.adapters.neso_body import parse as parse_forecast
from plugd.command_words import PARSERS, Refused, car_soc
from plugd.command_words import parse as parse_command
from plugd.config import doubts, household, known_keys
from plugd.config import parse as parse_config
from plugd.daemon import capability_of
from plugd.domain import SetMinimum, SetSoc
from plugd.errors import ConfigError, ForecastMalformed, UsageError
from plugd.explanation import document, numbered
from plugd.planner.exact import Exact
from plugd.planner.marginal import explain
from plugd.planner.qp import Qp
from plugd.problem_file import answer, read
from plugd.units import HALF_HOUR, is_number
from tests.fuzz_page import throw_requests
from tests.fuzz_plugs import mutated, swapped
from tests.fuzz_stored import throw_stored
from tests.fuzz_words import Count, readable

NOW = datetime(2026, 9, 6, 8, 13, 20, tzinfo=UTC)
FIRST = datetime(2026, 9, 6, 8, tzinfo=UTC)
EXAMPLE = Path("etc/plugd.toml")


# -- forecasts ------------------------------------------------------------------------------------


def _row(k: int) -> dict[str, object]:
    start = FIRST + k * HALF_HOUR
    return {
        "from": f"{start:%Y-%m-%dT%H:%MZ}",
        "to": f"{start + HALF_HOUR:%Y-%m-%dT%H:%MZ}",
        "intensity": {"forecast": 100 + k, "actual": 90 if k < 0 else None, "index": "low"},
    }


BODIES: tuple[tuple[str, object], ...] = (
    (NATIONAL, {"data": [_row(k) for k in range(-3, 12)]}),
    (NATIONAL, {"data": [_row(k) for k in range(4)]}),
    ("13", {"data": {"regionid": 13, "shortname": "London", "data": [_row(k) for k in range(6)]}}),
    ("13", {"data": [{"regionid": 13, "data": [_row(k) for k in range(6)]}]}),
    ("SW1", {"data": [{"regionid": 13, "postcode": "SW1", "data": [_row(k) for k in range(6)]}]}),
    (NATIONAL, {"error": {"code": "500 Internal Server Error", "message": "There was an internal error."}}),
)


def throw_forecasts(dice: random.Random, inputs: int) -> Count:
    """Bodies of the API."""
    count = Count()
    for _ in range(inputs):
        region, said = dice.choice(BODIES)
        body = mutated(dice, swapped(dice, said) if dice.random() < 0.3 else said)
        count.tried += 1
        try:
            found = parse_forecast(body, NOW, region)
            past = parse_past(body, FIRST - 3 * HALF_HOUR, FIRST, region)
            count.taken += 1
        except ForecastMalformed as error:
            readable(error, body)
            count.refused += 1
            continue
        finally:
            if not error_message(body).isprintable():
                raise AssertionError(f"{error_message(body)!r} is quoted of {body!r}")
        values = [row.g_per_kwh for row in (*found.expected, *found.actual)]
        values += [value for row in past for value in (row.forecast, row.actual) if value is not None]
        if not found.expected or not all(0.0 <= value <= MOST_G_PER_KWH for value in values):
            raise AssertionError(f"{found} of {body!r}")
        for series in (found.expected, found.actual):
            starts = [row.start for row in series]
            if starts != sorted(set(starts)):
                raise AssertionError(f"half hours out of order, or twice, of {body!r}")
    return count


# -- commands -------------------------------------------------------------------------------------

WORDS: tuple[tuple[str, object], ...] = (
    ("mode", "smart"), ("mode", "off"), ("soc", "63.5"), ("minimum", "60"), ("connected", "ON"), ("ready_by", "07:30"),
    ("horizon", "4"), ("replan", "PRESS"), ("trip", {"date": "2027-01-04", "minimum_pct": 90, "ready_by": "05:30"}),
    ("trip", {"date": "2027-01-04", "clear": True}), ("trip", {"clear": True}), ("trip", {"date": "2027-01-04",
    "away": True}), ("week", {"sat": {"ready_by": "10:00", "minimum_pct": 60}, "sun": {"away": True}}), ("nothing", ""),
)  # fmt: skip
CAR: tuple[tuple[object, str | None, bool], ...] = (
    ("63.5", None, False), ("0.63", None, True), ({"battery": {"soc": 63.5}, "odo": 1}, "battery.soc", False),
    ({"soc": None}, "soc", False), ("unavailable", None, False),
)  # fmt: skip


def throw_commands(dice: random.Random, inputs: int) -> Count:
    """Payloads of commands, and of the car's own topic."""
    count = Count()
    for _ in range(inputs):
        count.tried += 1
        try:
            if dice.random() < 0.25:
                said, key, fraction = dice.choice(CAR)
                payload = mutated(dice, said)
                soc = car_soc(payload, key, fraction)
            else:
                name, said = dice.choice(WORDS)
                name = dice.choice(list(PARSERS)) if dice.random() < 0.1 else name
                payload = mutated(dice, said)
                command = parse_command(name, payload)
                soc = command.soc if isinstance(command, SetSoc) else 0.0
                soc = command.minimum if isinstance(command, SetMinimum) else soc
            count.taken += 1
        except Refused as error:
            readable(error, payload)
            count.refused += 1
            continue
        if not 0.0 <= soc <= 1.0:
            raise AssertionError(f"{soc} of {payload!r}")
    return count


# -- problem files --------------------------------------------------------------------------------

PROBLEM: dict[str, object] = {
    "slot_h": 0.5, "power_max_kw": 10.0, "capacity_kwh": 50.0, "efficiency": 1.0, "soc_pct": 43.0, "soc_min_pct": 20.0,
    "soc_max_pct": 80.0, "end_value_g_per_kwh": [[4.0, 120.0], [8.0, 60.0]], "previous_power_kw": None,
    "sessions": [
        {"intensity": [212.0, 198.0, 150.0], "morning_minimum_pct": 50.0, "daily_use_kwh": 11.28},
        {"intensity": [100, 300], "morning_minimum_pct": 35.0, "daily_use_kwh": 11.28, "power_min_kw": 1.4,
         "slot_h": [0.5, 0.25], "power_max_kw": [10.0, 0.0], "soc_max_pct": 90.0},
    ],
}  # fmt: skip
NUMBERS = (0.0, -0.0, 1e-9, 1e-300, 0.01, 1.0, 20.0, 50.0, 80.0, 99.999999, 100.0, 1e6, 1e7, -1.0, 1e300)


def _another_number(dice: random.Random, said: object) -> object:
    """A document of nearly the same shape, in which some numbers are others that might be, and lists have lost some."""
    if isinstance(said, dict):
        return {key: _another_number(dice, value) for key, value in said.items()}
    if isinstance(said, list):
        kept = said[: dice.randrange(len(said))] if said and dice.random() < 0.05 else said
        return [_another_number(dice, value) for value in kept]
    return dice.choice(NUMBERS) if is_number(said) and dice.random() < 0.1 else said


def throw_problems(dice: random.Random, inputs: int) -> Count:
    """Problem files; what can be read is planned and explained too."""
    count = Count()
    with tempfile.TemporaryDirectory(prefix="plugd-fuzz-") as folder:
        file = Path(folder, "problem.json")
        for _ in range(inputs):
            count.tried += 1
            whole = _another_number(dice, PROBLEM) if dice.random() < 0.6 else PROBLEM
            file.write_bytes(json.dumps(whole).encode() if dice.random() < 0.4 else mutated(dice, whole))
            try:
                problem, echo = read(file)
            except UsageError as error:
                if not readable(error, file.read_bytes()).startswith(f"{file}: "):
                    raise AssertionError(f"{error} does not name the file") from error
                count.refused += 1
                continue
            count.taken += 1
            solution = (Qp() if dice.random() < 0.5 else Exact()).solve(problem)
            explained = explain(problem, solution)
            json.dumps(answer(echo, solution, 0.0), allow_nan=False)
            json.dumps(document(explained, echo.capacity_kwh, numbered(explained)), allow_nan=False)
    return count


# -- the configuration ----------------------------------------------------------------------------

BASE = '[plug]\nkind = "{kind}"\ntopic = "ev-plug"\n'
KINDS = ("tasmota", "shelly2", "openevse", "shelly1", "zigbee2mqtt", "esphome", "mqtt", "can_elcon")
LITERALS = (
    *('""', '"x"', '"\\u0000"', '"' + "y" * 300 + '"', "'''\n'''", '"07:30"', '"23:00-06:00"', '"/"', '"\u202e"'),
    *("0", "-1", "1", "5", "7", "50", "100", "1e3", "1e308", "1e999", "-0.0", "0.5", "nan", "inf", "-inf", "true"),
    *("9" * 30, "9" * 5000, "0x10", "0b1", "[]", "{}", "[[]]", '["a", 1]', "{ a = 1 }", "07:30:00", "07:30:01.5"),
    *("1979-05-27", "1979-05-27T07:32:00Z", '"https://h/"', '"http://h"', '"127.0.0.1:80"', '"[::1]:0"', '"\\ud7ff"'),
    *("{ ready_by = 1 }", "{ away = true, minimum_pct = 5 }", "[" * 2000 + "]" * 2000, "+1_0", '"Europe/London"'),
)


@cache
def _keys() -> tuple[str, ...]:
    return known_keys()


def _document(dice: random.Random) -> tuple[str, list[str]]:
    """A TOML document with some values that are others, and the dotted keys of those."""
    lines, keys = [BASE.format(kind=dice.choice(KINDS))], []
    for _ in range(dice.randrange(1, 4)):
        key = dice.choice(_keys())
        if dice.random() < 0.1:
            key = key[: dice.randrange(1, len(key) + 1)].strip(".") + dice.choice(("", "x", "_kw"))
        keys.append(key)
        lines.append(f"{key} = {dice.choice(LITERALS)}")
    return "\n".join([*lines[1:], lines[0]]), keys


def throw_configurations(dice: random.Random, inputs: int) -> Count:
    """TOML: one value after the other replaced, and the example with bytes changed."""
    count, example = Count(), EXAMPLE.read_text(encoding="utf-8")
    halves = [line for line in example.splitlines(keepends=True) if line.strip() and not line.startswith("# ")]
    for _ in range(inputs):
        count.tried += 1
        text, keys = _document(dice)
        if dice.random() < 0.4:
            shuffled = "".join(dice.sample(halves, len(halves)) if dice.random() < 0.3 else halves)
            text, keys = mutated(dice, shuffled).decode("utf-8", "replace"), []
        try:
            config = parse_config(text)
        except ConfigError as error:
            if not _names_the_place(readable(error, text), keys):
                raise AssertionError(f"{error} names no key, after {text!r}") from error
            count.refused += 1
            continue
        count.taken += 1
        capability = capability_of(config)
        household(config, capability)
        doubts(config)
    return count


def _names_the_place(said: str, keys: list[str]) -> bool:
    """Whether a complaint begins with a key that there is, or that was written, or with a line."""
    place = re.match(r"plugd\.toml: (?:(line \d+)|not TOML|([^ :=]+))", said)
    if place is None:
        return False
    known = {part for key in (*_keys(), *keys) for part in key.split(".")}
    return place[2] is None or not keys or bool(known & set(place[2].split(".")))


# -- the program ----------------------------------------------------------------------------------

Throw = Callable[[random.Random, int], Count]
PARSERS_UNDER_TEST: dict[str, tuple[Throw, float]] = {
    "forecasts": (throw_forecasts, 0.35),
    "commands": (throw_commands, 0.45),
    "configurations": (throw_configurations, 0.1),
    "problem files": (throw_problems, 0.06),
    "requests": (throw_requests, 0.03),
    "stored state": (throw_stored, 0.004),
}
"""Each with its share of the inputs: what is slow gets fewer."""


def main() -> int:
    """The program: a line a parser. Ends with a traceback where one of them did."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6))
    parser.add_argument("--only", nargs="+", choices=tuple(PARSERS_UNDER_TEST), default=tuple(PARSERS_UNDER_TEST))
    options = parser.parse_args()
    print(f"seed {options.seed}")
    total, began = 0, time.process_time()
    for name in options.only:
        throw, share = PARSERS_UNDER_TEST[name]
        before = time.process_time()
        count = throw(random.Random(f"{options.seed}/{name}"), max(1, round(share * options.inputs)))
        total += count.tried
        spent_s = time.process_time() - before
        print(f"fuzz: {name:15} {count.tried:8}, {count.taken:7} taken, {count.refused:7} refused, {spent_s:6.1f} s",
              flush=True)  # fmt: skip
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    spent_s = time.process_time() - began
    print(f"fuzz: {total} inputs in {spent_s:.0f} s of processor, no traceback; peak {peak_mb:.0f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
