"""A synthetic year of carbon intensity, like Great Britain's but of our own making: nobody measured it.

Demand has a day, a week and a season; wind comes and goes over days (a first-order autoregressive process,
time constant 40 h) and ripples within hours (another, 3 h). Mean near 150 g/kWh, never outside 40 to 300.
"""

import math
import random
from datetime import UTC, datetime
from itertools import pairwise
from zoneinfo import ZoneInfo

from plugd.series import IntensitySeries
from plugd.units import HALF_HOUR, SLOT_H, slot_start, within

START = datetime(2023, 1, 1, tzinfo=UTC)
LOW_G_PER_KWH, MEAN_G_PER_KWH, HIGH_G_PER_KWH = 40.0, 150.0, 300.0

DAY_G_PER_KWH = (
    (0, -22.0), (4, -30.0), (6, -12.0), (8, 12.0), (11, 2.0),
    (14, -2.0), (17, 28.0), (19, 32.0), (21, 12.0), (24, -22.0),
)  # fmt: skip
"""(local hour, deviation from the day's mean), linear between them: low at night, high in the evening."""
WEEKEND_G_PER_KWH = -12.0
SEASON_G_PER_KWH = 14.0
"""Half the difference between midwinter and midsummer."""
WIND_G_PER_KWH, WIND_H = 50.0, 40.0
RIPPLE_G_PER_KWH, RIPPLE_H = 9.0, 3.0
"""Standard deviations and time constants of the two random parts."""


def synthetic_year(seed: int = 0, start: datetime = START, days: int = 365) -> IntensitySeries:
    """Half-hourly synthetic intensity from the half hour that holds `start`, the same for the same seed.

    Only `actual` is filled: there is no forecast to tell apart from it.
    """
    dice = random.Random(f"synthetic year {seed}")
    first = slot_start(start)
    zone = ZoneInfo("Europe/London")
    wind, ripple = dice.gauss(0.0, 1.0), dice.gauss(0.0, 1.0)
    values: list[float | None] = []
    for k in range(days * 48):
        demand = _demand_g_per_kwh((first + k * HALF_HOUR).astimezone(zone))
        value = MEAN_G_PER_KWH + demand + WIND_G_PER_KWH * wind + RIPPLE_G_PER_KWH * ripple
        values.append(float(round(within(LOW_G_PER_KWH, value, HIGH_G_PER_KWH))))
        wind = _next(wind, WIND_H, dice)
        ripple = _next(ripple, RIPPLE_H, dice)
    return IntensitySeries(start=first, actual=tuple(values), forecast=(None,) * len(values))


def _demand_g_per_kwh(local: datetime) -> float:
    """Season, weekday and time of day, as a deviation from the year's mean."""
    season = SEASON_G_PER_KWH * math.cos(2.0 * math.pi * (local.timetuple().tm_yday - 15) / 365.25)
    weekend = WEEKEND_G_PER_KWH * (5.0 / 7.0 if local.weekday() >= 5 else -2.0 / 7.0)
    hour = local.hour + local.minute / 60.0
    (left_h, left), (right_h, right) = next(pair for pair in pairwise(DAY_G_PER_KWH) if pair[0][0] <= hour < pair[1][0])
    return season + weekend + left + (right - left) * (hour - left_h) / (right_h - left_h)


def _next(value: float, constant_h: float, dice: random.Random) -> float:
    """One half hour on of an autoregressive process with mean 0 and standard deviation 1."""
    keep = math.exp(-SLOT_H / constant_h)
    return keep * value + math.sqrt(1.0 - keep * keep) * dice.gauss(0.0, 1.0)
