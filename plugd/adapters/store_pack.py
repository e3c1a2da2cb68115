"""A forecast's rows as a few hundred bytes: times as differences, compressed."""

import json
import zlib
from datetime import UTC, datetime, timedelta
from itertools import accumulate, pairwise
from math import isfinite
from operator import add

from plugd.domain import Forecast, Intensity
from plugd.units import HALF_HOUR

MOST_G_PER_KWH = 10_000.0
"""Where a card has damaged a value it may be anything. No source says a tenth of this."""


def pack(forecast: Forecast) -> bytes:
    """Its rows and what was dropped. Moment and region are kept beside it."""
    rows = {
        "expected": _columns(forecast.expected),
        "actual": _columns(forecast.actual),
        "dropped": forecast.dropped,
    }
    return zlib.compress(json.dumps(rows, separators=(",", ":")).encode(), level=9)


def unpack(issued_at: datetime, region: str, packed: bytes) -> Forecast:
    """The forecast again, as it was. Raises what is no pack of ours: TypeError, ValueError and more."""
    rows = json.loads(zlib.decompress(packed))
    return Forecast(
        issued_at=issued_at,
        region=region,
        expected=_intensities(*rows["expected"]),
        actual=_intensities(*rows["actual"]),
        dropped=tuple(map(str, rows["dropped"])),
    )


def _columns(values: tuple[Intensity, ...]) -> tuple[list[float], list[float]]:
    """(first time in epoch seconds and the differences after it, values)."""
    times = [value.start.timestamp() for value in values]
    steps = [later - earlier for earlier, later in pairwise(times)]
    return times[:1] + steps, [value.g_per_kwh for value in values]


def _intensities(steps: list[float], values: list[float]) -> tuple[Intensity, ...]:
    if not steps:
        return ()
    if not {type(value) for value in values} <= {int, float} or not isfinite(sum(values)):
        raise TypeError("an intensity that is no number")
    if min(values) < 0.0 or max(values) > MOST_G_PER_KWH:
        raise ValueError("an intensity that cannot be")
    # Thousands are unpacked at a start: the next half hour is found far sooner than a moment from its seconds.
    apart = (HALF_HOUR if step == 1800.0 else timedelta(seconds=step) for step in steps[1:])
    times = accumulate(apart, add, initial=datetime.fromtimestamp(steps[0], UTC))
    return tuple(Intensity(start, value) for start, value in zip(times, values, strict=True))
