"""A forecast's rows as a few hundred bytes: times as differences, compressed."""

import json
import zlib
from datetime import UTC, datetime, timedelta
from itertools import accumulate, pairwise
from operator import add

from plugd.domain import Forecast, Intensity
from plugd.units import HALF_HOUR


def pack(forecast: Forecast) -> bytes:
    """Its rows and what was dropped. Moment and region are kept beside it."""
    rows = {
        "expected": _columns(forecast.expected),
        "actual": _columns(forecast.actual),
        "dropped": forecast.dropped,
    }
    return zlib.compress(json.dumps(rows, separators=(",", ":")).encode(), level=9)


def unpack(issued_at: datetime, region: str, packed: bytes) -> Forecast:
    """The forecast again, as it was."""
    rows = json.loads(zlib.decompress(packed))
    return Forecast(
        issued_at=issued_at,
        region=region,
        expected=_intensities(*rows["expected"]),
        actual=_intensities(*rows["actual"]),
        dropped=tuple(rows["dropped"]),
    )


def _columns(values: tuple[Intensity, ...]) -> tuple[list[float], list[float]]:
    """(first time in epoch seconds and the differences after it, values)."""
    times = [value.start.timestamp() for value in values]
    steps = [later - earlier for earlier, later in pairwise(times)]
    return times[:1] + steps, [value.g_per_kwh for value in values]


def _intensities(steps: list[float], values: list[float]) -> tuple[Intensity, ...]:
    if not steps:
        return ()
    # Thousands are unpacked at a start: the next half hour is found far sooner than a moment from its seconds.
    apart = (HALF_HOUR if step == 1800.0 else timedelta(seconds=step) for step in steps[1:])
    times = accumulate(apart, add, initial=datetime.fromtimestamp(steps[0], UTC))
    return tuple(Intensity(start, value) for start, value in zip(times, values, strict=True))
