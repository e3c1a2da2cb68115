"""The half-hour grid, the guard on time zones, and the only conversions of units."""

import math
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import TypeGuard
from zoneinfo import ZoneInfo

HALF_HOUR = timedelta(minutes=30)
SLOT_H = 0.5
ISO = re.compile(r"\b[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}Z")
"""A time as `iso` writes it."""


def require_utc(moment: datetime) -> datetime:
    """The same moment, in UTC. Raises ValueError for a naive one: inside plugd every time is aware."""
    if moment.tzinfo is None:
        raise ValueError(f"{moment.isoformat()} has no time zone; plugd's times are aware")
    return moment.astimezone(UTC)


def slot_start(moment: datetime) -> datetime:
    """Start of the half-open half hour that holds `moment`."""
    if moment.tzinfo is not UTC:
        moment = require_utc(moment)
    return moment.replace(minute=moment.minute - moment.minute % 30, second=0, microsecond=0)


def next_slot(moment: datetime) -> datetime:
    """Start of the first half hour after the one that holds `moment`."""
    return slot_start(moment) + HALF_HOUR


def pieces(start: datetime, end: datetime) -> Iterator[tuple[datetime, datetime]]:
    """The half hours of [start, end), the first and the last possibly partial."""
    while start < end:
        stop = min(next_slot(start), end)
        yield start, stop
        start = stop


def hours(length: timedelta) -> float:
    """A time span in hours."""
    return length.total_seconds() / 3600.0


def span_h(length_h: float) -> timedelta:
    """A length in hours as a time span."""
    return timedelta(hours=length_h)


def from_pct(percent: float) -> float:
    """Percent, as people and topics write it, to the fraction used inside."""
    return percent / 100.0


def to_pct(fraction: float, digits: int = 1) -> float:
    """A fraction as percent, rounded for people."""
    return round(fraction * 100.0, digits)


def from_w(power_w: float) -> float:
    """Watts to kW."""
    return power_w / 1000.0


def from_wh(energy_wh: float) -> float:
    """Watt-hours to kWh."""
    return energy_wh / 1000.0


def from_wmin(energy_wmin: float) -> float:
    """Watt-minutes to kWh."""
    return energy_wmin / 60000.0


def to_w(power_kw: float) -> float:
    """kW to watts, rounded to a tenth."""
    return round(power_kw * 1000.0, 1)


def kw_of(current_a: float, voltage_v: float) -> float:
    """Power of a current at a voltage, one phase or direct current."""
    return current_a * voltage_v / 1000.0


def amps_of(power_kw: float, voltage_v: float) -> float:
    """Current that carries a power at a voltage above zero, one phase or direct current."""
    return power_kw * 1000.0 / voltage_v


def within(low: float, value: float, high: float) -> float:
    """`value`, held between `low` and `high`."""
    return min(max(value, low), high)


def is_number(value: object) -> TypeGuard[float]:
    """Whether a parsed JSON value is a finite number (a JSON true is none)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # JSON's integers have no end
        return False


def iso(moment: datetime) -> str:
    """ISO 8601 in UTC to the second, ending in Z: how plugd writes times for programs."""
    return require_utc(moment).strftime("%Y-%m-%dT%H:%M:%SZ")


def in_local_time(words: str, timezone: str) -> str:
    """Words in which every time as `iso` writes it is one for people, in their own zone."""

    def local(found: re.Match[str]) -> str:
        return f"{datetime.fromisoformat(found[0]).astimezone(ZoneInfo(timezone)):%a %-d %b %Y, %H:%M}"

    return ISO.sub(local, words)


def grams(value: float) -> str:
    """Grams for people: kg from a kilogram on."""
    return f"{value / 1000:.1f} kg" if abs(value) >= 999.5 else f"{value:.0f} g"


def rounded(value: float | None, digits: int) -> float | None:
    """Rounded for people; None stays None."""
    return None if value is None else round(value, digits)
