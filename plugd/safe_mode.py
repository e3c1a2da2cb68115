"""What is done when plugd has ended too often to be trusted with a plan: the default window, and the guard. Pure."""

from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

from plugd import sessions, soc
from plugd.domain import Fault, Flow, Household, Memory, Switch, Switching

LASTS_S = 3600.0
"""After so long without an end it plans again."""
LOOKED_AHEAD = timedelta(days=2)


def begun(now: datetime, kept: Memory) -> Memory:
    """What is taken over of the last run's memory: what people said, and an electrical cut. The rest may be what ends
    it."""
    cut = Flow(cut=kept.flow.cut)
    return Memory(soc.unknown(now), overrides=kept.overrides, presence=kept.presence, press=kept.press, flow=cut)


def orders(now: datetime, memory: Memory, household: Household) -> Switching:
    """On in the default window, unless the battery is known to be at its limit."""
    begin, end = household.nights.default_window
    zone, until = ZoneInfo(household.timezone), now + LOOKED_AHEAD
    full = memory.soc.mean >= household.car.soc_max
    switches = []
    for k in range(-1, 2):
        day = sessions.today(now, household) + timedelta(days=k)
        last = day + timedelta(days=1) if end <= begin else day
        switches += [Switch(sessions.to_utc(day, begin, zone), True), Switch(sessions.to_utc(last, end, zone), False)]
    return Switching(tuple(switches) if not full else (), until)


def faults(household: Household) -> tuple[Fault, ...]:
    """What is said meanwhile."""
    begin, end = household.nights.default_window
    text = (
        f"plugd has ended again and again: for an hour nothing is planned, fetched or kept; it charges from "
        f"{begin:%H:%M} to {end:%H:%M}, and from the last safe start on; the log says what ended it"
    )
    return (Fault("safe_mode", text),)
