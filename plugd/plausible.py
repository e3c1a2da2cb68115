"""Whether an answer of the source may be true: values off by a factor of ten would make plugd wait, or not wait.

Its level (the median) is held against the own history, its level of the last eight weeks and of the last hours. An
answer is doubted only where it is out by a factor *and* outside nearly all that was seen in those weeks: of GB's
actuals of 2020 to 2023 no 48 hours are, and ten times or a tenth of them always is. Where 0 is nothing rare nothing is
too low.
"""

from collections.abc import Sequence
from datetime import timedelta
from math import sqrt
from statistics import median

from plugd.domain import Forecast, Intensity
from plugd.errors import ForecastMalformed
from plugd.outlook import TYPICAL_G_PER_KWH

FACTOR = 3.0
LEAST_G_PER_KWH = 10.0
"""Levels below count as this: a factor between two of them says nothing."""
RECENT = timedelta(hours=6)
RARE = 0.01
"""Share of the history at either end that may be glitches: actuals of 0 are among NESO's."""
ENOUGH = 96
"""Half hours of history from which on it is believed; before, only far too much is told from the usual level."""


def doubt(values_g_per_kwh: Sequence[float], history: Sequence[Intensity]) -> str | None:
    """What is wrong with the level of these values, None where nothing is. `history` in order of time."""
    if not values_g_per_kwh:
        return None
    level = median(values_g_per_kwh)
    known = [value.g_per_kwh for value in history]
    if len(known) < ENOUGH:
        usual, least, most = TYPICAL_G_PER_KWH, 0.0, FACTOR * TYPICAL_G_PER_KWH
    else:
        known.sort()
        rare = int(RARE * len(known))
        least, most = known[rare], known[-1 - rare]
        if least <= level <= most:
            return None
        recent = median(value.g_per_kwh for value in history if value.start > history[-1].start - RECENT)
        usual = sqrt(max(median(known), LEAST_G_PER_KWH) * max(recent, LEAST_G_PER_KWH))
    if level > FACTOR * usual and level > most:
        return f"{level:.0f} g/kWh, where {usual:.0f} is usual and {most:.0f} nearly the most of the last weeks"
    if level < usual / FACTOR and level < least:
        return f"{level:.0f} g/kWh, where {usual:.0f} is usual and {least:.0f} nearly the least of the last weeks"
    return None


def believed(forecast: Forecast, history: Sequence[Intensity]) -> Forecast:
    """The forecast. Raises ForecastMalformed for one whose level cannot be true."""
    why = doubt([row.g_per_kwh for row in forecast.expected], history)
    if why is not None:
        raise ForecastMalformed(f"NESO's answer is not used: it says {why}")
    return forecast
