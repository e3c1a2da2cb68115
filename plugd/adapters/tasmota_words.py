"""What a Tasmota plug says, made out of untrusted bytes. Pure."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from plugd.adapters import plug_words
from plugd.adapters.plug_words import MAX_CURRENT_A, MAX_ENERGY_KWH, MAX_POWER_KW, bounded, document
from plugd.units import from_w, is_number

WORDS = {"ON": True, "OFF": False}
Found = TypeVar("Found")
UPTIME = re.compile(r"(\d{1,6})T(\d\d):(\d\d):(\d\d)")


@dataclass(frozen=True, slots=True)
class Heard(plug_words.Heard):
    """A plug's message, with how its timer is set."""

    power_on_state: int | None = None
    pulse: int | None = None


def pulse_for(seconds: float) -> int:
    """The PulseTime of a span: 1..111 are tenths of a second, 112 and more are seconds + 100."""
    if not 0.1 <= seconds <= 64800.0:
        raise ValueError(f"a Tasmota plug cannot count {seconds:g} s; from 0.1 s to 64800 s (18 h)")
    return round(seconds * 10.0) if seconds <= 11.0 else max(112, round(seconds) + 100)


def hear(payload: bytes, answer: bool = False) -> Heard:
    """A plain `ON` or `OFF`, or one of the JSON documents. What is not understood is an empty Heard."""
    text = payload.strip().upper()
    if text in (b"ON", b"OFF"):
        return Heard(on=text == b"ON", answer=answer)
    said = document(payload)
    if said is None:
        return Heard()
    sensors = said.get("StatusSNS", said)
    said = said.get("StatusSTS", said)
    if not isinstance(sensors, dict) or not isinstance(said, dict):
        return Heard()
    meter = sensors.get("ENERGY")
    power_w, bad_power = _metered(meter, "Power", 1000.0 * MAX_POWER_KW)
    energy_kwh, bad_energy = _metered(meter, "Total", MAX_ENERGY_KWH)
    current_a, bad_current = _metered(meter, "Current", MAX_CURRENT_A)
    return Heard(
        on=_first(said, ("POWER", "POWER1"), lambda v: WORDS.get(str(v).upper())),
        metered="StatusSNS" in said or "ENERGY" in sensors,
        power_kw=None if power_w is None else from_w(power_w),
        energy_kwh=energy_kwh,
        current_a=current_a,
        answer=answer,
        uptime_s=_first(said, ("UptimeSec", "Uptime"), _uptime),
        power_on_state=_first(said, ("PowerOnState",), _whole),
        pulse=_first(said, ("PulseTime1", "PulseTime"), _pulse),
        nonsense=bad_power + bad_energy + bad_current,
    )


def _metered(meter: object, key: str, most: float) -> tuple[float | None, int]:
    """A value within 0 and `most`, and 1 where it is nonsense."""
    return bounded(meter[key], most) if isinstance(meter, dict) and key in meter else (None, 0)


def _first(said: dict[str, Any], keys: tuple[str, ...], make: Callable[[Any], Found | None]) -> Found | None:
    return next((made for key in keys if key in said and (made := make(said[key])) is not None), None)


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 65536 else None


def _uptime(value: object) -> float | None:
    """Seconds, or `3T04:05:06` of firmware without UptimeSec."""
    if is_number(value):
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
