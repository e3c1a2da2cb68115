"""What any plug may say, made out of untrusted bytes. Pure."""

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from plugd.units import is_number

MAX_POWER_KW = 100.0
MAX_ENERGY_KWH = 1e7
MAX_CURRENT_A = 500.0
MAX_DIGITS = 15
NUMBER = re.compile(r"[+-]?\d{1,15}(\.\d{1,15})?([eE][+-]?\d{1,2})?", re.ASCII)


@dataclass(frozen=True, slots=True)
class Heard:
    """One message, as far as plugd understands it. None: it says nothing of that."""

    on: bool | None = None
    metered: bool = False
    """It is from the meter, or says that there is none."""
    partial: bool = False
    """What it does not name of the meter has not changed."""
    power_kw: float | None = None
    energy_kwh: float | None = None
    current_a: float | None = None
    uptime_s: float | None = None
    answer: bool = False
    """It tells the relay's state in answer to a command."""
    timer: bool | None = None
    """Whether a timer runs that will switch the relay over."""
    by_timer: bool = False
    """The relay's state is the timer's doing."""
    errors: tuple[str, ...] | None = None
    """Why the plug has switched itself off (overpower, overtemperature): empty where all is well."""
    refusal: str | None = None
    """It does not do as told, and says why."""
    online: bool | None = None
    kept: bool = False
    """The broker's copy of its last word: worth something only while it is online."""
    nonsense: int = 0
    """Values that cannot be."""


def document(payload: bytes) -> dict[str, Any] | None:
    """A JSON object without NaN, doubled keys or endless numbers; None for anything else."""
    try:
        said = json.loads(
            payload.decode("utf-8", "replace"), parse_int=_int, parse_constant=_refuse, object_pairs_hook=_no_doubles
        )
    except (ValueError, RecursionError):
        return None
    return said if isinstance(said, dict) else None


def number(text: str) -> float | None:
    """A plain number as a device prints it; None for anything else, `nan` included."""
    return float(text) if NUMBER.fullmatch(text) else None


def bounded(value: object, most: float) -> tuple[float | None, int]:
    """The value where it is a number within 0 and `most`; else None, and 1 for one nonsense."""
    return (float(value), 0) if is_number(value) and 0.0 <= value <= most else (None, 1)


def _int(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise ValueError("no plug counts that far")
    return int(digits)


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is no JSON")


def _no_doubles(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    said = list(pairs)
    found = dict(said)
    if len(found) != len(said):
        raise ValueError("a key is there twice")
    return found
