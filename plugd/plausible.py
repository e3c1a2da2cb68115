"""Whether an answer of the source may be true: values off by a factor of ten would make plugd wait, or not wait.

Two looks at it. Its first hours are held against the last ones that are known: the grid does not go to four times or a
quarter of itself within three hours, least of all below `QUIET_G_PER_KWH`. And its level (the median) against that of
the last eight weeks: it is doubted where it is both out by a factor and beyond nearly all that was seen in them. GB's
actuals of 2020 to 2023 pass both at every hour, and ten times or a tenth of them never does. Where 0 is nothing rare
nothing is too low.
"""

from collections.abc import Sequence
from datetime import timedelta
from statistics import median

from plugd.domain import Forecast, Intensity
from plugd.errors import ForecastMalformed
from plugd.outlook import TYPICAL_G_PER_KWH
from plugd.units import HALF_HOUR

JUMP = 4.0
QUIET_G_PER_KWH = 40.0
"""Values below count as this in a jump: a windy region goes from 3 to 30 g/kWh in no time."""
NEAR = 3
"""Half hours on either side of a jump."""
FRESH = timedelta(hours=4)
"""What was known longer ago says nothing about now."""
TOO_HIGH, TOO_LOW = 2.5, 4.0
"""Out by so much of the level of the last weeks."""
RARE = 0.01
"""Share of the history at either end that may be glitches: actuals of 0 are among NESO's."""
ENOUGH = 96
"""Half hours of history from which on it is believed; before, only far too much is told from the usual level."""


def doubt(told: Sequence[Intensity], history: Sequence[Intensity]) -> str | None:
    """What is wrong with these values, None where nothing is. Both in order of time."""
    if not told:
        return None
    level = median(row.g_per_kwh for row in told)
    known = sorted(row.g_per_kwh for row in history)
    if len(known) < ENOUGH:
        most = TOO_HIGH * TYPICAL_G_PER_KWH
        return None if level <= most else f"{level:.0f} g/kWh, where {TYPICAL_G_PER_KWH:.0f} is usual"
    if timedelta(0) <= told[0].start - history[-1].start <= FRESH:
        before, after = (max(QUIET_G_PER_KWH, _middle(part)) for part in (history[-NEAR:], told[:NEAR]))
        if not before / JUMP <= after <= JUMP * before:
            return f"{_middle(told[:NEAR]):.0f} g/kWh, right after {_middle(history[-NEAR:]):.0f}"
    rare = int(RARE * len(known))
    least, usual, most = known[rare], median(known), known[-1 - rare]
    if level > max(TOO_HIGH * usual, most):
        return f"{level:.0f} g/kWh, where {usual:.0f} is usual and hardly ever more than {most:.0f}"
    if level < min(usual / TOO_LOW, least):
        return f"{level:.0f} g/kWh, where {usual:.0f} is usual and hardly ever less than {least:.0f}"
    return None


def _middle(rows: Sequence[Intensity]) -> float:
    return median(row.g_per_kwh for row in rows)


def believed(forecast: Forecast, history: Sequence[Intensity]) -> Forecast:
    """The forecast. Raises ForecastMalformed for one that cannot be true, or is not of this time."""
    last = max((row.start for row in forecast.expected), default=forecast.issued_at)
    if last + HALF_HOUR <= forecast.issued_at:
        times = f"it ends on {last:%Y-%m-%d} at {last:%H:%M} UTC, and it is {forecast.issued_at:%Y-%m-%d %H:%M} here"
        raise ForecastMalformed(f"NESO's answer is not used: {times}; is the clock right?")
    why = doubt(forecast.expected, history)
    if why is not None:
        raise ForecastMalformed(f"NESO's answer is not used: it says {why}")
    return forecast
