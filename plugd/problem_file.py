"""A problem file read into a Problem, and a Solution written as its answer (`plugd plan --problem`).

SOC in percent and one file of JSON outside; kWh and the frozen values of `plugd.planner` inside. Every number
that cannot be used is refused with the file, its key and the remedy, in one line.
"""

import json
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Any

from plugd.errors import UsageError
from plugd.planner.problem import Problem, ProblemSession, Series, Solution

MAX_BYTES = 8_000_000
MAX_SLOTS = 20_000
LIMIT = 1e6
"""Larger than any power, capacity, intensity or time there is; keeps every product finite."""
MIN_EFFICIENCY = 0.01
MAX_STEPS = 1000

REQUIRED = {
    *("slot_h", "power_max_kw", "capacity_kwh", "efficiency", "sessions"),
    *("soc_pct", "soc_min_pct", "soc_max_pct"),
}
OPTIONAL = {"end_value_g_per_kwh", "previous_power_kw"}
SESSION_REQUIRED = {"intensity", "morning_minimum_pct", "daily_use_kwh"}
SESSION_OPTIONAL = {"slot_h", "power_max_kw", "power_min_kw", "soc_max_pct"}

Object = dict[str, Any]


class _Unfit(Exception):
    """What is wrong, where in the file, and what would be right; the file's name is put before it."""


@dataclass(frozen=True, slots=True)
class Echo:
    """What the answer needs of the file beyond the Problem."""

    capacity_kwh: float


def read(path: Path) -> tuple[Problem, Echo]:
    """The problem in a file. Raises UsageError, one line that names file and key."""
    try:
        return _problem(_document(path))
    except _Unfit as unfit:
        raise UsageError(f"{path}: {unfit}") from None


def answer(echo: Echo, solution: Solution, solve_ms: float) -> Object:
    """The answer as `plan --problem --json` prints it; only finite numbers, rounded to nine places."""
    return {
        "status": solution.status,
        "solver": solution.solver,
        "power_kw": [_rounded(power_kw) for power_kw in solution.power_kw],
        "soc_pct": _rounded(tuple(100 * kwh / echo.capacity_kwh for kwh in solution.energy_kwh)),
        "shortfall_kwh": _rounded(solution.shortfall_kwh),
        "reserve_short_kwh": _rounded(solution.reserve_short_kwh),
        **{
            name: _round(value)
            for name, value in (
                ("carbon_g", solution.carbon_g),
                ("bound_g", solution.bound_g),
                ("gap", solution.gap),
                ("raw_gap", solution.raw_gap),
            )
        },
        "iterations": solution.iterations,
        "solve_ms": _round(solve_ms),
    }


def _round(value: float) -> float:
    return round(value, 9) + 0.0  # no -0.0


def _rounded(series: Series) -> list[float]:
    return [_round(value) for value in series]


# -- the document -----------------------------------------------------------------------------------


def _document(path: Path) -> Any:
    """The file's JSON, every number a float."""
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _Unfit(f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(raw) > MAX_BYTES:
        raise _Unfit(f"is larger than {MAX_BYTES // 1_000_000} MB; give a problem of at most {MAX_SLOTS} slots")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _Unfit(f"is not UTF-8 (byte {error.start}); save it as UTF-8") from None
    if not text.strip():
        raise _Unfit("is empty; write one JSON object")
    try:
        # whole numbers as floats too: int refuses 5,000 digits without a key, float makes them infinite
        return json.loads(text, parse_int=float, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        raise _Unfit(f"line {error.lineno}, column {error.colno}: {error.msg}; write one JSON object") from None
    except RecursionError:
        raise _Unfit("is nested too deeply; the deepest list is a number in a session's series") from None


def _unique(pairs: list[tuple[str, Any]]) -> Object:
    found: Object = {}
    for key, value in pairs:
        if key in found:
            raise _Unfit(f"{_shown(key)} is given twice in one object; keep one")
        found[key] = value
    return found


def _shown(value: Any) -> str:
    """A value as it would stand in the file, short, in ASCII."""
    kinds = {dict: "an object", list: "a list", type(None): "null"}
    if type(value) in kinds:
        return kinds[type(value)]
    if isinstance(value, float) and isfinite(value):
        return f"{value:.15g}"
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:36]}..."


# -- values -----------------------------------------------------------------------------------------


def _object(value: Any, where: str, required: set[str], optional: set[str]) -> Object:
    """A JSON object with every required key and no unknown one. `where`: its path, with a dot."""
    if not isinstance(value, dict):
        raise _Unfit(f"{where.rstrip('.') or 'the document'} is {_shown(value)}; an object {{...}} is wanted")
    for key in value:
        if key not in required | optional:
            known = ", ".join(sorted(required | optional))
            raise _Unfit(f"{where}{key if key.isidentifier() else _shown(key)} is not known; known are {known}")
    for key in sorted(required - value.keys()):
        raise _Unfit(f"{where}{key} is missing; add it")
    return value


def _number(value: Any, where: str, least: float = 0.0, most: float = LIMIT, *, above: bool = False) -> float:
    """A finite number from `least` (or, `above`, greater) to `most`."""
    if not isinstance(value, float):  # a bool is none
        raise _Unfit(f"{where} is {_shown(value)}; a number is wanted")
    if not isfinite(value):
        raise _Unfit(f"{where} is {_shown(value)}; a finite number is wanted")
    if not (least < value if above else least <= value) or value > most:
        low = f"{'above' if above else 'from'} {_shown(least)}"
        raise _Unfit(f"{where} is {_shown(value)}; it must lie {low} {'up ' if above else ''}to {_shown(most)}")
    return value


def _series(value: Any, where: str, length: int | None, least: float = 0.0, *, above: bool = False) -> Series:
    """A list of numbers, `length` of them unless None."""
    if not isinstance(value, list):
        raise _Unfit(f"{where} is {_shown(value)}; a list of numbers is wanted, one per slot")
    if length is not None and len(value) != length:
        raise _Unfit(f"{where} has {len(value)} numbers; its session has {length} slots, give one for each")
    if len(value) > MAX_SLOTS:
        raise _Unfit(f"{where} has {len(value)} slots; at most {MAX_SLOTS} in all are planned")
    return tuple(_number(item, f"{where}[{i}]", least, above=above) for i, item in enumerate(value))


def _per_slot(value: Any, where: str, length: int, *, above: bool) -> Series:
    """A number for every slot, or a list of one each; in a list of powers 0 closes a slot."""
    if isinstance(value, list):
        return _series(value, where, length, above=above)
    return (_number(value, where, above=True),) * length


# -- the problem ------------------------------------------------------------------------------------


def _problem(document: Any) -> tuple[Problem, Echo]:
    given = _object(document, "", REQUIRED, OPTIONAL)
    for key in ("slot_h", "power_max_kw"):
        _number(given[key], key, above=True)
    capacity_kwh = _number(given["capacity_kwh"], "capacity_kwh", above=True)
    soc_min_pct = _number(given["soc_min_pct"], "soc_min_pct", most=100.0)
    _soc_max_pct(given["soc_max_pct"], "soc_max_pct", soc_min_pct)
    if not isinstance(given["sessions"], list) or not given["sessions"]:
        raise _Unfit(f"sessions is {_shown(given['sessions'])}; a list of at least one session is wanted")
    if len(given["sessions"]) > MAX_SLOTS:
        raise _Unfit(f"sessions has {len(given['sessions'])} sessions; at most {MAX_SLOTS} are planned")
    sessions = tuple(
        _session(item, f"sessions[{i}].", given, capacity_kwh, soc_min_pct) for i, item in enumerate(given["sessions"])
    )
    lengths = [len(session.slot_h) for session in sessions]
    if sum(lengths) > MAX_SLOTS:
        raise _Unfit(f"sessions has {sum(lengths)} slots in all; at most {MAX_SLOTS} are planned")
    problem = Problem(
        energy_kwh=capacity_kwh * _number(given["soc_pct"], "soc_pct", most=100.0) / 100,
        reserve_kwh=capacity_kwh * soc_min_pct / 100,
        efficiency=_number(given["efficiency"], "efficiency", MIN_EFFICIENCY, 1.0),
        sessions=sessions,
        end_value=_end_value(given.get("end_value_g_per_kwh", 0.0)),
        previous_power_kw=_previous(given.get("previous_power_kw"), lengths),
    )
    return problem, Echo(capacity_kwh)


def _soc_max_pct(value: Any, where: str, soc_min_pct: float) -> float:
    soc_max_pct = _number(value, where, most=100.0)
    if soc_max_pct <= soc_min_pct:
        raise _Unfit(f"{where} is {_shown(soc_max_pct)}; it must lie above soc_min_pct, {_shown(soc_min_pct)}")
    return soc_max_pct


def _session(item: Any, where: str, given: Object, capacity_kwh: float, soc_min_pct: float) -> ProblemSession:
    own = _object(item, where, SESSION_REQUIRED, SESSION_OPTIONAL)
    intensity = _series(own["intensity"], f"{where}intensity", None, -LIMIT)
    slots = len(intensity)
    slot_h = _per_slot(own.get("slot_h", given["slot_h"]), f"{where}slot_h", slots, above=True)
    power_max_kw = _per_slot(own.get("power_max_kw", given["power_max_kw"]), f"{where}power_max_kw", slots, above=False)
    power_min_kw = _number(own.get("power_min_kw", 0.0), f"{where}power_min_kw")
    if slots and power_min_kw > max(power_max_kw):
        raise _Unfit(
            f"{where}power_min_kw is {_shown(power_min_kw)}; it must not exceed power_max_kw, "
            f"{_shown(max(power_max_kw))}"
        )
    soc_max_pct = _soc_max_pct(own.get("soc_max_pct", given["soc_max_pct"]), f"{where}soc_max_pct", soc_min_pct)
    minimum_pct = _number(own["morning_minimum_pct"], f"{where}morning_minimum_pct", most=100.0)
    return ProblemSession(
        intensity_g_per_kwh=intensity,
        slot_h=slot_h,
        power_max_kw=power_max_kw,
        minimum_kwh=capacity_kwh * minimum_pct / 100,
        ceiling_kwh=capacity_kwh * soc_max_pct / 100,
        daily_use_kwh=_number(own["daily_use_kwh"], f"{where}daily_use_kwh"),
        power_min_kw=power_min_kw,
    )


def _end_value(value: Any) -> tuple[tuple[float, float], ...]:
    """A number is one endless step; steps must not rise, or the worth would not be concave."""
    where = "end_value_g_per_kwh"
    if not isinstance(value, list):
        worth = _number(value, where)
        return ((inf, worth),) if worth > 0 else ()
    steps: list[tuple[float, float]] = []
    for i, step in enumerate(value):
        if not isinstance(step, list) or len(step) != 2:
            raise _Unfit(f"{where}[{i}] is not a pair; write [kWh, g per kWh]")
        kwh = _number(step[0], f"{where}[{i}][0]", above=True)
        worth = _number(step[1], f"{where}[{i}][1]")
        if steps and worth > steps[-1][1]:
            raise _Unfit(f"{where}[{i}][1] is {_shown(worth)}, more than the step before; steps never rise")
        steps.append((kwh, worth))
    if len(steps) > MAX_STEPS:
        raise _Unfit(f"{where} has {len(steps)} steps; at most {MAX_STEPS} are planned")
    return tuple(steps)


def _previous(value: Any, lengths: list[int]) -> tuple[Series, ...] | None:
    """The plan before: one number per slot of all sessions, or a list per session."""
    where = "previous_power_kw"
    if value is None:
        return None
    if not isinstance(value, list):
        raise _Unfit(f"{where} is {_shown(value)}; null, a number per slot or a list per session is wanted")
    if not any(isinstance(item, list) for item in value):
        flat = _series(value, where, None)
        if len(flat) != sum(lengths):
            raise _Unfit(f"{where} has {len(flat)} numbers; the sessions have {sum(lengths)} slots")
        numbers = iter(flat)
        return tuple(tuple(next(numbers) for _ in range(length)) for length in lengths)
    if len(value) != len(lengths):
        raise _Unfit(f"{where} has {len(value)} lists; there are {len(lengths)} sessions")
    return tuple(_series(item, f"{where}[{i}]", lengths[i]) for i, item in enumerate(value))
