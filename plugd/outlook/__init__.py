"""One expected intensity for every half hour to the end of the last session, wherever it has to come from."""

from datetime import datetime

from plugd.domain import Forecast, Intensity, Outlook, OutlookSlot, SlotSource
from plugd.outlook.learned import EPOCH, Learned, at_of, moments, replayed
from plugd.outlook.typical import TYPICAL_G_PER_KWH, typical_g_per_kwh
from plugd.units import HALF_HOUR

__all__ = ["TYPICAL_G_PER_KWH", "Learned", "extend", "moments", "replayed", "typical_g_per_kwh"]


def extend(
    forecast: Forecast | None,
    history: tuple[Intensity, ...],
    now: datetime,
    until: datetime,
    learned: Learned | None = None,
) -> Outlook:
    """The expected intensity from the half hour under way to `until`, without a gap.

    `learned`: what is known of forecasts like this one; without it they are taken as they are. A forecast counts for
    the half hours it covers, however old; what it leaves out is the usual day with what is left of the last deviation.
    """
    as_it_is = learned is None
    learned = (learned or Learned()).advanced(now, () if forecast is None else (forecast,), history)
    first = at_of(now)
    count = max(0, -(-(until - EPOCH) // HALF_HOUR) - first)
    sight = learned.sight(first, count)
    as_it_is = as_it_is or not sum(learned.profile.weights)
    slots = []
    for k, (row, usual, mean) in enumerate(zip(sight.said, sight.usual, sight.mean, strict=True)):
        start = EPOCH + (first + k) * HALF_HOUR
        sd = learned.sd_g_per_kwh(k, usual)
        if row is None:
            slots.append(OutlookSlot(start, mean, sd, SlotSource.TAIL))
        elif as_it_is:
            slots.append(OutlookSlot(start, row.g_per_kwh, sd, SlotSource.NESO))
        else:
            slots.append(OutlookSlot(start, mean, sd, SlotSource.CORRECTED))
    covered = [row.at for row in learned.said if row.at >= first]
    return Outlook(tuple(slots), EPOCH + (max(covered) + 1) * HALF_HOUR if covered else None)
