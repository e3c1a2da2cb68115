"""How full the car is: told now and then, carried on by the meter, lowered by driving in between."""

from dataclasses import replace
from datetime import datetime, timedelta

from plugd.domain import Car, Reading, SocEstimate
from plugd.units import hours, within

CAUTION_SD = 2.05
"""Standard deviations below the mean that promises are made on: one night in fifty."""
UNKNOWN_MEAN, UNKNOWN_SD = 0.5, 0.2
"""Before anybody said anything: promises count on 9 %."""
AS_KNOWN = 0.03
"""Between mean and promise after a night that began with a told SOC. Not worth a lower ceiling."""
ASSUMED = "assumed"
TOLD_SD = 0.005
FULL_SD = 0.02
METER_SHARE = 0.02
"""Growth of the standard deviation per metered energy: meter and efficiency are not exact."""
FLOWING_KW = 0.05
TAPERED_SHARE = 0.6
"""A car that is full lets its power fall before it stops; one that is unplugged does not."""
UNCOUNTED_KWH = 0.3
"""More than this by the power, and nothing by the total: the total is not believed."""
LENT_SHARE = 0.1
"""Growth of the standard deviation per energy reckoned as power x time."""
LONGEST_SPAN = timedelta(minutes=36)
"""A power counts for no longer than this."""
RESET_KWH = 1.0
"""A meter that starts anew shows less than this; anything else that falls is a fault of the meter."""

CAR, CARRIED_ON = "car", "meter"
"""Who says it: the car itself, or nobody for so long that the meter's count is what is left."""
JUMP, JUMP_PER_MIN = 0.05, 0.05
"""How far a word of the car may be from the estimate, at once and for each minute since the last word."""
CERTAIN_SD = 3.0
"""Upwards no time explains a jump, only what was not known: energy that flowed here is in the mean."""
CONFIRMED_AFTER = timedelta(seconds=60)
FROZEN = 0.04
"""What may have flowed while the car says exactly what it said before: it may count in whole points."""
LEAST_SAID = 0.01
SAME, SAID_OFTEN, SAID_AGAIN = 0.02, timedelta(minutes=1), timedelta(minutes=5)
"""A car may speak every second: within the first time no word is news, and one much the same not within the second."""


def unknown(now: datetime) -> SocEstimate:
    """The estimate at the first start."""
    return SocEstimate(mean=UNKNOWN_MEAN, sd=UNKNOWN_SD, source=ASSUMED, told_at=None, driven_to=now)


def cautious(estimate: SocEstimate) -> float:
    """The SOC that promises are made on, as a fraction."""
    return within(0.0, estimate.mean - CAUTION_SD * estimate.sd, 1.0)


def unsure(estimate: SocEstimate) -> float:
    """How far the mean lies above what promises are made on, beyond what no battery is known better, as a fraction."""
    return max(0.0, estimate.mean - cautious(estimate) - AS_KNOWN)


def told(estimate: SocEstimate, soc: float, now: datetime, source: str) -> SocEstimate:
    """Somebody who knows says how full the car is now."""
    return replace(
        estimate,
        mean=within(0.0, soc, 1.0),
        sd=TOLD_SD,
        source=source,
        told_at=now,
        driven_to=now,
        peak_kw=0.0,
        last_kw=0.0,
        car_said=soc if source == CAR else None,
        doubted=None,
        doubted_at=None,
    )


def heard(estimate: SocEstimate, soc: float, now: datetime) -> SocEstimate:
    """The car says how full it is. A jump is believed once it says so again; see `doubts`.

    The very word it said before does not take back what has flowed since. Where too much has, it repeats an old
    word, or nothing reaches the battery: then promises are made on what it says, and the mean stays the meter's.
    """
    if soc == estimate.car_said and estimate.mean >= soc:
        if estimate.mean - soc <= FROZEN:
            return replace(estimate, source=CAR, told_at=now, doubted=None, doubted_at=None)
        return replace(estimate, sd=max(estimate.sd, (estimate.mean - soc) / CAUTION_SD))
    if not doubts(estimate, soc, now):
        return told(estimate, soc, now, CAR)
    if estimate.doubted is not None and estimate.doubted_at is not None and abs(soc - estimate.doubted) <= JUMP:
        if now - estimate.doubted_at >= CONFIRMED_AFTER:
            return told(estimate, soc, now, CAR)
        if now >= estimate.doubted_at:
            return estimate
    return replace(estimate, doubted=soc, doubted_at=now)


def doubts(estimate: SocEstimate, soc: float, now: datetime) -> bool:
    """Whether a word is further from the estimate than a battery gets in the time since the last word.

    Upwards it is doubted sooner: believed at once, one wrong word would leave somebody without a car.
    """
    if estimate.told_at is None:
        return False
    minutes = max(0.0, (now - estimate.told_at).total_seconds() / 60.0)
    if soc > estimate.mean:
        return soc - estimate.mean > JUMP + min(JUMP_PER_MIN * minutes, CERTAIN_SD * estimate.sd)
    return estimate.mean - soc > JUMP + JUMP_PER_MIN * minutes


def is_news(estimate: SocEstimate, soc: float, now: datetime) -> bool:
    """Whether a word of the car is worth a decision of its own."""
    if soc == estimate.car_said and estimate.mean - soc > FROZEN:
        return cautious(estimate) > soc + SAME
    if estimate.told_at is None or now < estimate.told_at or estimate.source != CAR:
        return True
    if doubts(estimate, soc, now):
        again = estimate.doubted is not None and abs(soc - estimate.doubted) <= JUMP
        return not (again and estimate.doubted_at is not None and now - estimate.doubted_at < CONFIRMED_AFTER)
    return now - estimate.told_at >= (SAID_AGAIN if abs(soc - estimate.mean) < SAME else SAID_OFTEN)


def aged(estimate: SocEstimate, now: datetime, car: Car) -> SocEstimate:
    """With an old word of the car's no longer called the car's."""
    old = estimate.told_at is not None and (now - estimate.told_at).total_seconds() > car.soc_max_age_s
    return replace(estimate, source=CARRIED_ON) if estimate.source == CAR and old else estimate


def is_stale(estimate: SocEstimate, now: datetime, car: Car) -> bool:
    """Whether the car used to say how full it is, and has not since a drive; or says the same while it is charged.

    Nobody has to tell, and a car that tells when it comes home need not tell again before it has left.
    """
    oldest = now - timedelta(seconds=car.soc_max_age_s)
    if estimate.car_said is None or estimate.told_at is None or estimate.told_at >= oldest:
        return False
    driven = estimate.told_at < estimate.driven_to < oldest
    repeats = estimate.mean - estimate.car_said > FROZEN and cautious(estimate) <= estimate.car_said + SAME
    return driven or repeats  # see `heard`: promises are made on a word that is repeated


def is_no_percentage(estimate: SocEstimate) -> bool:
    """Whether the car's word may be a fraction that was taken for a percentage: nobody drives home on 1 %."""
    return estimate.car_said is not None and 0.0 < estimate.car_said <= LEAST_SAID


def driven(estimate: SocEstimate, drives: tuple[tuple[datetime, int], ...], car: Car) -> SocEstimate:
    """Take off the daily use for each homecoming (when, days), and trust the number less."""
    for home_at, days in drives:
        mean = max(0.0, estimate.mean - days * car.daily_use_kwh / car.capacity_kwh)
        variance = estimate.sd**2 + days * (car.daily_use_sd_kwh / car.capacity_kwh) ** 2
        estimate = replace(estimate, mean=mean, sd=variance**0.5, driven_to=home_at)
    return estimate


def charged(estimate: SocEstimate, flowed_kwh: float, car: Car) -> SocEstimate:
    """Add what flowed at the plug, and trust the number a little less."""
    gain = flowed_kwh * car.efficiency / car.capacity_kwh
    mean = within(0.0, estimate.mean + gain, 1.0)
    return replace(estimate, mean=mean, sd=estimate.sd + METER_SHARE * gain)


def metered(
    estimate: SocEstimate, reading: Reading, car: Car, power_max_kw: float, *, held_back: bool = False
) -> SocEstimate:
    """Add what the meter counted since the last reading, and notice when the car has stopped taking power.

    `held_back`: a charger was told to give less than it can, so that a small power says nothing of the car.
    """
    if reading.metered_at is None or (estimate.metered_at is not None and reading.metered_at <= estimate.metered_at):
        return estimate
    counted_kwh = _flowed_kwh(estimate, reading, power_max_kw)
    estimate = _lent(charged(estimate, counted_kwh, car), counted_kwh, reading, car, power_max_kw)
    estimate = replace(
        estimate,
        meter_kwh=reading.energy_kwh if reading.energy_kwh is not None else estimate.meter_kwh,
        metered_at=reading.metered_at,
    )
    return replace(estimate, peak_kw=0.0, last_kw=0.0) if held_back else _noticed_full(estimate, reading, car)


def _lent(estimate: SocEstimate, counted_kwh: float, reading: Reading, car: Car, power_max_kw: float) -> SocEstimate:
    """Beside a total that does not move while power flows, count power x time instead of it."""
    if counted_kwh > 0.0:
        return replace(estimate, unseen_kwh=0.0, lent_kwh=0.0)
    power_kw, before = reading.power_kw, estimate.metered_at
    plausible = power_kw is not None and 0.0 < power_kw <= 1.5 * power_max_kw
    if not (plausible and reading.on and power_kw and before and reading.metered_at):
        return estimate
    span_kwh = power_kw * hours(min(reading.metered_at - before, LONGEST_SPAN))
    unseen_kwh = estimate.unseen_kwh + span_kwh
    twice = estimate.unseen_kwh > 0.0  # one total that cannot be says nothing of the next
    if estimate.lent_kwh == 0.0 and not (twice and unseen_kwh >= UNCOUNTED_KWH):
        return replace(estimate, unseen_kwh=unseen_kwh)
    # What flowed while that was in doubt is left out: a car is charged a little more rather than less.
    estimate = charged(estimate, span_kwh, car)
    sd = estimate.sd + LENT_SHARE * span_kwh * car.efficiency / car.capacity_kwh
    return replace(estimate, sd=sd, unseen_kwh=unseen_kwh, lent_kwh=estimate.lent_kwh + span_kwh)


def _flowed_kwh(estimate: SocEstimate, reading: Reading, power_max_kw: float) -> float:
    if reading.energy_kwh is None or reading.metered_at is None:
        return 0.0
    span = None if estimate.metered_at is None else reading.metered_at - estimate.metered_at
    return flowed_kwh(estimate.meter_kwh, reading.energy_kwh, span, power_max_kw)


def flowed_kwh(before_kwh: float | None, after_kwh: float, span: timedelta | None, power_max_kw: float) -> float:
    """Energy between two totals of the meter, never negative and never more than could have flowed in `span`."""
    if before_kwh is None:
        return 0.0
    flowed_kwh = after_kwh - before_kwh
    if flowed_kwh < 0.0:
        flowed_kwh = after_kwh if 0.0 <= after_kwh < RESET_KWH else 0.0
    if span is not None and flowed_kwh > 1.5 * power_max_kw * hours(span) + 0.1:
        return 0.0
    return flowed_kwh


def _noticed_full(estimate: SocEstimate, reading: Reading, car: Car) -> SocEstimate:
    """Power that fell away and then stopped, with the relay on: the car is at its own limit."""
    if not reading.on or reading.power_kw is None:
        return replace(estimate, peak_kw=0.0, last_kw=0.0) if not reading.on else estimate
    if reading.power_kw >= FLOWING_KW:
        return replace(estimate, peak_kw=max(estimate.peak_kw, reading.power_kw), last_kw=reading.power_kw)
    if estimate.peak_kw > FLOWING_KW and estimate.last_kw < TAPERED_SHARE * estimate.peak_kw:
        # Power that tapers is a nearly full battery; a car at a limit of its own stops without.
        full = max(car.soc_max, estimate.mean)
        return replace(estimate, mean=full, sd=FULL_SD, source="full", peak_kw=0.0, last_kw=0.0)
    return estimate
