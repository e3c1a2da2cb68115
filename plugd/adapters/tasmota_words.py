"""What a Tasmota plug says, made out of untrusted bytes. Pure."""

import json
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

from plugd.units import from_w, is_number

MAX_POWER_W = 1e5
MAX_ENERGY_KWH = 1e7
WORDS = {"ON": True, "OFF": False}
MAX_DIGITS = 15
Found = TypeVar("Found")
UPTIME = re.compile(r"(\d{1,6})T(\d\d):(\d\d):(\d\d)")


@dataclass(frozen=True, slots=True)
class Heard:
    """One message, as far as plugd understands it. None: it says nothing of that."""

    on: bool | None = None
    metered: bool = False
    """It is from the sensors, whether or not there is a meter among them."""
    power_kw: float | None = None
    energy_kwh: float | None = None
    uptime_s: float | None = None
    power_on_state: int | None = None
    pulse: int | None = None
    nonsense: int = 0
    """Values that cannot be."""


def pulse_for(seconds: float) -> int:
    """The PulseTime of a span: 1..111 are tenths of a second, 112 and more are seconds + 100."""
    if not 0.1 <= seconds <= 64800.0:
        raise ValueError(f"a Tasmota plug cannot count {seconds:g} s; from 0.1 s to 64800 s (18 h)")
    return round(seconds * 10.0) if seconds <= 11.0 else max(112, round(seconds) + 100)


def hear(payload: bytes) -> Heard:
    """A plain `ON` or `OFF`, or one of the JSON documents. What is not understood is an empty Heard."""
    text = payload.decode("utf-8", "replace").strip()
    if text.upper() in WORDS:
        return Heard(on=WORDS[text.upper()])
    try:
        said = json.loads(text, parse_int=_int, parse_constant=_refuse, object_pairs_hook=_no_doubles)
    except (ValueError, RecursionError):
        return Heard()
    if not isinstance(said, dict):
        return Heard()
    sensors = said.get("StatusSNS", said)
    said = said.get("StatusSTS", said)
    if not isinstance(sensors, dict) or not isinstance(said, dict):
        return Heard()
    meter = sensors.get("ENERGY")
    power_w, bad_power = _bounded(meter, "Power", MAX_POWER_W)
    energy_kwh, bad_energy = _bounded(meter, "Total", MAX_ENERGY_KWH)
    return Heard(
        on=_first(said, ("POWER", "POWER1"), lambda v: WORDS.get(str(v).upper())),
        metered="StatusSNS" in said or "ENERGY" in sensors,
        power_kw=None if power_w is None else from_w(power_w),
        energy_kwh=energy_kwh,
        uptime_s=_first(said, ("UptimeSec", "Uptime"), _uptime),
        power_on_state=_first(said, ("PowerOnState",), _whole),
        pulse=_first(said, ("PulseTime1", "PulseTime"), _pulse),
        nonsense=bad_power + bad_energy,
    )


def _int(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise ValueError("no plug counts that far")
    return int(digits)


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is no JSON")


def _no_doubles(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    said = list(pairs)
    document = dict(said)
    if len(document) != len(said):
        raise ValueError("a key is there twice")
    return document


def _bounded(meter: object, key: str, most: float) -> tuple[float | None, int]:
    """A value within 0 and `most`, and 1 where it is nonsense."""
    if not isinstance(meter, dict) or key not in meter:
        return None, 0
    value = meter[key]
    if not is_number(value) or not 0.0 <= value <= most:
        return None, 1
    return float(value), 0


def _first(said: dict[str, Any], keys: tuple[str, ...], make: Callable[[Any], Found | None]) -> Found | None:
    return next((made for key in keys if key in said and (made := make(said[key])) is not None), None)


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 65536 else None


def _uptime(value: object) -> float | None:
    """Seconds, or `3T04:05:06` of firmware without UptimeSec."""
    if isinstance(value, int | float) and is_number(value):
        return float(value) if value >= 0 else None
    found = UPTIME.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        return None
    days, hours, minutes, seconds = (int(part) for part in found.groups())
    return ((days * 24.0 + hours) * 60.0 + minutes) * 60.0 + seconds


def _pulse(value: object) -> int | None:
    """`{"Set":160,"Remaining":0}`; lists of all timers; `"160 (Active 60)"` of firmware before 8."""
    if isinstance(value, dict):
        value = value.get("Set")
    if isinstance(value, list):
        value = value[0] if value else None
    if isinstance(value, str):
        head = value.split(" ", 1)[0]
        value = int(head) if head.isascii() and head.isdigit() and len(head) <= 5 else None
    return _whole(value)
