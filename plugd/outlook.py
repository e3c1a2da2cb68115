"""One expected intensity for every half hour to the end of the last session, wherever it has to come from."""

import math
from collections import defaultdict
from datetime import UTC, datetime

from plugd.domain import Forecast, Intensity, Outlook, OutlookSlot, SlotSource
from plugd.units import HALF_HOUR, slot_start

TYPICAL_G_PER_KWH = 150.0
TYPICAL_WEIGHT = 3.0
"""The built-in day counts like this many days of own history."""
FORECAST_SD_SHARE_48H, SLOTS_48H = 0.2, 96
TAIL_SD_SHARE = 0.35


def typical_g_per_kwh(moment: datetime) -> float:
    """A day of the GB grid without any history: clean before dawn, a morning shoulder, a dirty evening.

    A smooth curve through the usual shape, not a measurement; own history replaces it within days.
    """
    hour = moment.hour + moment.minute / 60.0
    evening = math.exp(-(((hour - 18.0) / 2.5) ** 2))
    morning = math.exp(-(((hour - 7.5) / 2.0) ** 2))
    night = math.exp(-(((hour - 3.0) / 3.0) ** 2)) + math.exp(-(((hour - 27.0) / 3.0) ** 2))
    noon = math.exp(-(((hour - 13.0) / 2.0) ** 2))
    return TYPICAL_G_PER_KWH * (1.0 + 0.20 * evening + 0.05 * morning - 0.15 * night - 0.05 * noon)


def _profile(history: tuple[Intensity, ...]) -> dict[tuple[int, int], float]:
    """Mean by half hour of the day (UTC), leaning on the built-in day while the history is short."""
    seen: dict[tuple[int, int], list[float]] = defaultdict(list)
    for value in history:
        seen[(value.start.hour, value.start.minute)].append(value.g_per_kwh)
    every = [g for values in seen.values() for g in values]
    level = (sum(every) / len(every) if every else TYPICAL_G_PER_KWH) / TYPICAL_G_PER_KWH
    profile = {}
    for half_hour in range(48):
        key = (half_hour // 2, 30 * (half_hour % 2))
        prior = level * typical_g_per_kwh(datetime(2000, 1, 1, *key, tzinfo=UTC))
        values = seen.get(key, [])
        profile[key] = (sum(values) + TYPICAL_WEIGHT * prior) / (len(values) + TYPICAL_WEIGHT)
    return profile


def extend(forecast: Forecast | None, history: tuple[Intensity, ...], now: datetime, until: datetime) -> Outlook:
    """The expected intensity from the half hour under way to `until`, without a gap.

    A forecast counts for the half hours it covers, however old it is. What it leaves out, inside or beyond
    its end, is the mean of the same half hour in `history`; never 0.
    """
    known = {} if forecast is None else {row.start: row.g_per_kwh for row in forecast.expected}
    profile = _profile(history)
    slots = []
    start, share = slot_start(now), 0.0
    while start < until:
        if start in known:
            g_per_kwh, source, sd_share = known[start], SlotSource.NESO, share
        else:
            g_per_kwh, source, sd_share = profile[(start.hour, start.minute)], SlotSource.TAIL, TAIL_SD_SHARE
        slots.append(OutlookSlot(start, g_per_kwh, sd_share * g_per_kwh, source))
        start += HALF_HOUR
        share = min(share + FORECAST_SD_SHARE_48H / SLOTS_48H, FORECAST_SD_SHARE_48H)
    covered = [start for start in known if start + HALF_HOUR > now]
    return Outlook(tuple(slots), max(covered) + HALF_HOUR if covered else None)
