"""Whether a memory that was read can have been saved: a damaged card holds values that no plugd ever wrote.

What has the shape of a memory may still say that it is the year 9999, that the battery holds -3, or a time without a
zone. Nothing behind this door looks again.
"""

from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from typing import Any

from plugd.units import is_number

EARLIEST, LATEST = datetime(1800, 1, 1, tzinfo=UTC), datetime(2200, 1, 1, tzinfo=UTC)
"""A clock that ran ahead by up to all of this and is set right takes what was long ago along, see `wall.shifted`."""
MOST_NUMBER, MOST_ITEMS = 1e9, 2000
WITHIN = {
    **dict.fromkeys(("mean", "minimum", "car_said", "doubted"), (-0.001, 1.001)),
    **dict.fromkeys(("power_kw", "peak_kw", "last_kw"), (-0.001, 10_000.0)),
    "observed_kw": (0.01, 10_000.0),
    "horizon": (1, 7),
}
"""What some numbers must lie within, wherever they stand, if they are not 0. A plan's `soc_end` is none of them: where
more is driven than can be charged, its later nights end below empty."""


def objection(value: Any, name: str = "memory") -> str | None:
    """What cannot be, in words; None where nothing is amiss."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        low, high = WITHIN.get(name, (-MOST_NUMBER, MOST_NUMBER))
        fits = value == 0 or (is_number(value) and low <= value <= high)
        return None if fits else f"{name} cannot be that"
    if isinstance(value, datetime):
        zoned = value.tzinfo is not None and EARLIEST <= value < LATEST
        return None if zoned else f"{name} is no time"
    if isinstance(value, tuple):
        if len(value) > MOST_ITEMS:
            return f"{name} has {len(value)} items"
        return next((found for one in value if (found := objection(one, name))), None)
    if is_dataclass(value):
        named = ((f.name, getattr(value, f.name)) for f in fields(value))
        return next((found for key, part in named if (found := objection(part, key))), None)
    return None
