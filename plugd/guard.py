"""The guard: whatever the planner says, the relay is on from the last moment that still fills the need.

It knows nothing of forecast, plan, broker or disk, and is asked every few seconds. Whatever it cannot make
sense of means on: charging too much costs a few grams, too little leaves someone without a car.
"""

import math
from dataclasses import dataclass
from datetime import datetime, timedelta

CAUTION = 0.9
"""Share of the believed power that is counted on."""
LEAST_NEED_KWH = 0.001
"""What a plug's meter can just tell. A smaller need is rounding and counts as measured zero."""
LONGEST_LEAD_S = 366 * 24 * 3600.0
"""No charge takes longer: a number beyond it, infinite ones too, is a doubt."""


@dataclass(frozen=True, slots=True)
class Need:
    """What is missing to the morning minimum, by the cautious (lower) state of charge."""

    session_end: datetime
    energy_kwh: float
    """In the battery, or where the car takes less as it fills what the whole power would give in the time it needs.

    Zero or less: the minimum is reached."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the guard wants the relay on."""

    on: bool
    last_safe_start: datetime | None
    """None where nothing is needed, or where it cannot be told: then `on` is True."""
    late: bool = False
    """The session end has passed and the need has not."""


def believed_kw(observed_kw: float | None, nominal_kw: float) -> float:
    """Power to count with: the observed one where there is any, never above the nominal one."""
    if observed_kw is None or not math.isfinite(observed_kw) or not math.isfinite(nominal_kw):
        return nominal_kw
    return min(observed_kw, nominal_kw) if observed_kw > 0.0 else nominal_kw


def last_safe_start(need: Need, power_kw: float, efficiency: float, margin_s: float) -> datetime | None:
    """When charging must begin: session end − need / (0.9 × power × efficiency) − margin.

    Power is at the plug, need in the battery. None where the numbers give no such moment.
    """
    rate_kw = CAUTION * max(power_kw, 0.0) * efficiency
    if not (0.0 < rate_kw < math.inf and efficiency <= 1.0 and margin_s >= 0.0):
        return None
    lead_s = need.energy_kwh / rate_kw * 3600.0 + margin_s
    if not 0.0 <= lead_s <= LONGEST_LEAD_S:
        return None
    return need.session_end - timedelta(seconds=lead_s)


def guard(
    now: datetime,
    need: Need | None,
    *,
    observed_kw: float | None,
    nominal_kw: float,
    efficiency: float,
    margin_s: float,
    guarding: bool,
) -> Verdict:
    """On at and after the last safe start while anything is needed; None as need: nobody asks for anything.

    `guarding`: it had fired before. Then it holds until the need is measured as gone, even where a better
    power or a later session end moves the last safe start away. After the session end it goes on, late.
    """
    if need is None or -math.inf < need.energy_kwh < LEAST_NEED_KWH:
        return Verdict(on=False, last_safe_start=None)
    start = last_safe_start(need, believed_kw(observed_kw, nominal_kw), efficiency, margin_s)
    return Verdict(
        on=guarding or start is None or now >= start,
        last_safe_start=start,
        late=now >= need.session_end,
    )
