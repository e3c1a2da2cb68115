"""What people and programs may send, and what it means: text or JSON in, a command out, or a refusal in words.

Everything here was written by somebody else: it is bounded before it is read, and no bad text gets any further.
"""

import json
import math
from collections.abc import Callable
from datetime import date, datetime, time
from typing import Any

from plugd.domain import (
    ClearTrip,
    Command,
    DayRule,
    Mode,
    Replan,
    SetConnected,
    SetHorizon,
    SetMinimum,
    SetMode,
    SetReadyBy,
    SetSoc,
    SetTrip,
    SetWeek,
    Trip,
)
from plugd.units import from_pct, is_number

MAX_BYTES = 4096
"""Of a command, or of a message of the car's own topic."""
MAX_NESTING = 16
"""Brackets in a command: a week has eight pairs of them."""
MAX_CAR_NESTING = 256
"""Brackets in a car's message, which may tell much else."""
QUOTED = 40
"""How much of what somebody sent is said back."""
NOTHING = ("", "unavailable", "unknown", "none", "null")
"""What hubs publish where they know nothing. It is no word of the car, and no fault either."""
WEEKDAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


class Refused(ValueError):
    """A command that says nothing plugd can do; the text tells what would be right."""


class NotKnown(Refused):
    """The car's topic says that it does not know."""


class NoSuchKey(NotKnown):
    """A message of the car's topic without the key: it tells something else, or the key is a wrong one."""


def _quote(said: object) -> str:
    text = said if isinstance(said, str) else json.dumps(said)
    return repr(text if len(text) <= QUOTED else text[:QUOTED] + "…")


# -- values ---------------------------------------------------------------------------------------


def _within(value: float, low: float, high: float, unit: str) -> float:
    if not low <= value <= high:  # also where it is not a number
        raise Refused(f"{value:.6g} is outside {low:g} to {high:g}{unit}")
    return value


def _number(text: str, low: float, high: float, unit: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise Refused(f"{_quote(text)} is not a number; send one from {low:g} to {high:g}{unit}") from None
    return _within(value, low, high, unit)


def _fraction(percent: float) -> float:
    if 0.0 < percent < 1.0:
        raise Refused(f"{percent:g} looks like a fraction; send percent, 0 to 100")
    return from_pct(percent)


def _percent(text: str) -> float:
    return _fraction(_number(text, 0.0, 100.0, " %"))


def _clock(text: object) -> time:
    try:
        return datetime.strptime(str(text), "%H:%M").time()  # noqa: DTZ007 # a clock time, of any day
    except ValueError:
        raise Refused(f"{_quote(text)} is no time; send HH:MM") from None


# -- JSON -----------------------------------------------------------------------------------------


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise Refused("a key comes twice; send each once")
    return found


def _no_constant(word: str) -> float:
    raise Refused(f"{word} is no JSON; send a finite number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise Refused(f"{_quote(text)} is too large")
    return value


def read_json(text: str, most_nested: int) -> Any:
    """JSON as others may send it: not deep, no key twice, every number finite. Raises Refused."""
    if text.count("[") + text.count("{") > most_nested:
        raise Refused(f"that is nested too deep; at most {most_nested} brackets")
    try:
        return json.loads(text, parse_constant=_no_constant, parse_float=_finite, object_pairs_hook=_once)
    except Refused:
        raise
    except (ValueError, RecursionError):
        raise Refused(f"{_quote(text)} is no JSON") from None


def _keys(said: object, allowed: tuple[str, ...], what: str) -> dict[str, Any]:
    if not isinstance(said, dict):
        raise Refused(f"{what} is a JSON object with {', '.join(allowed)}")
    for key in said:
        if key not in allowed:
            raise Refused(f"{what} has no {_quote(key)}; there are {', '.join(allowed)}")
    return said


def _rule(said: dict[str, Any], what: str) -> DayRule:
    """What `minimum_pct`, `ready_by` and `away` ask of a morning; null is as if it were not there."""
    percent, clock, away = (said.get(key) for key in ("minimum_pct", "ready_by", "away"))
    if percent is not None and not is_number(percent):
        raise Refused(f"minimum_pct {_quote(percent)} is not a number; send one from 0 to 100 %")
    if clock is not None and not isinstance(clock, str):
        raise Refused(f"ready_by {_quote(clock)} is no text; send HH:MM in quotes")
    if away is not None and not isinstance(away, bool):
        raise Refused(f"away {_quote(away)} is neither true nor false")
    rule = DayRule(
        ready_by=None if clock is None else _clock(clock),
        minimum=None if percent is None else _fraction(_within(percent, 0, 100, " %")),
        away=bool(away),
    )
    if rule.away and (rule.ready_by is not None or rule.minimum is not None):
        raise Refused(f"{what}: away stands beside minimum_pct or ready_by; send one or the other")
    if rule == DayRule():
        raise Refused(f"{what} asks for nothing; send minimum_pct, ready_by or away")
    return rule


# -- commands -------------------------------------------------------------------------------------


def _mode(text: str) -> Command:
    try:
        return SetMode(Mode(text.lower()))
    except ValueError:
        raise Refused(f"{_quote(text)} is no mode; send one of {', '.join(Mode)}") from None


def _connected(text: str) -> Command:
    if text.upper() not in ("ON", "OFF"):
        raise Refused(f"{_quote(text)} is neither ON nor OFF")
    return SetConnected(text.upper() == "ON")


def _ready_by(text: str) -> Command:
    if not text:
        return SetReadyBy(None)
    try:
        return SetReadyBy(_clock(text))
    except Refused as refused:
        raise Refused(f"{refused}, or nothing for the configured one") from None


def _horizon(text: str) -> Command:
    value = _number(text, 1, 7, " nights")
    if value != int(value):
        raise Refused(f"{value:g} is not a whole number of nights")
    return SetHorizon(int(value))


def _replan(text: str) -> Command:
    if text != "PRESS":
        raise Refused(f"{_quote(text)} is not PRESS")
    return Replan()


def _day(said: object) -> date:
    text = said if isinstance(said, str) and len(said) == 10 and said[7] == "-" else ""
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise Refused(f"date {_quote(said)} is no day; send the morning's, as YYYY-MM-DD") from None


def _trip(text: str) -> Command:
    said = _keys(read_json(text, MAX_NESTING), ("date", "minimum_pct", "ready_by", "away", "clear"), "a trip")
    clear = said.get("clear")
    if clear is True and len(said) == 1:
        return ClearTrip(None)
    day = _day(said.get("date"))
    if clear is not None and not isinstance(clear, bool):
        raise Refused(f"clear {_quote(clear)} is neither true nor false")
    if clear:
        if said.keys() > {"date", "clear"}:
            raise Refused("clear stands beside something else; send it with the date alone")
        return ClearTrip(day)
    rule = _rule(said, "a trip")
    return SetTrip(Trip(day, rule.ready_by, rule.minimum, rule.away))


def _week(text: str) -> Command:
    said = read_json(text, MAX_NESTING) if text else None
    if said is None:
        return SetWeek(None)
    days = _keys(said, WEEKDAYS, "a week")
    if not all(isinstance(day, dict) for day in days.values()):
        raise Refused('a day of the week is a JSON object, like {"sat": {"minimum_pct": 60}}')
    allowed = ("minimum_pct", "ready_by", "away")
    rules = ((WEEKDAYS.index(name), _rule(_keys(day, allowed, name), name)) for name, day in days.items() if day)
    return SetWeek(tuple(sorted(rules, key=lambda named: named[0])))


PARSERS: dict[str, Callable[[str], Command]] = {
    "mode": _mode,
    "soc": lambda text: SetSoc(_percent(text)),
    "minimum": lambda text: SetMinimum(_percent(text)),
    "connected": _connected,
    "ready_by": _ready_by,
    "week": _week,
    "trip": _trip,
    "horizon": _horizon,
    "replan": _replan,
}


def _text(payload: bytes) -> str:
    if len(payload) > MAX_BYTES:
        raise Refused(f"{len(payload)} bytes are too many; at most {MAX_BYTES}")
    try:
        return payload.decode("utf-8").strip()
    except UnicodeDecodeError:
        raise Refused("the payload is not UTF-8 text") from None


def parse(name: str, payload: bytes) -> Command:
    """The command in a payload. Raises Refused, whose text goes back to the sender."""
    if name not in PARSERS:
        raise Refused(f"there is no command {_quote(name)}; there are {', '.join(PARSERS)}")
    return PARSERS[name](_text(payload))


def car_soc(payload: bytes, json_key: str | None, fraction: bool = False) -> float:
    """The SOC in a message of the car's own topic, as a fraction. Raises NotKnown (and NoSuchKey), Refused.

    `json_key` is a path like `battery.soc`; `fraction`: this car counts from 0 to 1 and not to 100.
    """
    text = _text(payload)
    value: Any = text
    if json_key is not None:
        value = read_json(text, MAX_CAR_NESTING)
        for key in json_key.split("."):
            if not isinstance(value, dict) or key not in value:
                raise NoSuchKey(f"there is no {_quote(json_key)} in the car's message")
            value = value[key]
        if isinstance(value, bool | dict | list):
            raise Refused(f"the car's message has no number under {json_key}")
        value = "" if value is None else str(value)
    if value.strip().lower() in NOTHING:
        raise NotKnown("the car's topic says nothing of its state of charge")
    if fraction:
        return _number(value, 0.0, 1.0, ", a fraction as soc_unit says")
    return _percent(value)
