"""Learning the household: when the car comes home, when it leaves and what it uses, from what was seen of them.

**What is seen.** Times only where somebody tells that the car is plugged in: a plug whose relay is off sees nothing,
and when power flows is plugd's own choice. Use only between two words on how full the battery is (car, hub, charger),
each said when the car was home for the night, a day apart, with what flowed in between counted by the meter; where
nobody ever says a number, between two nights after which the car had stopped by itself. Days of a trip were announced
and say nothing about the others.

**What is learned.** With `n` nights x_1 ... x_n and the configured normal distribution Phi((x - m) / s) the next one is
expected below x with the probability

    F(x) = (n0 Phi((x - m) / s) + sum of Phi((x - x_i) / h)) / (n0 + n),    h = s sqrt(n1 / (n1 + n)).

The configured distribution counts as `n0` nights, and its spread as that of `n1`: each night stands for others like it,
of the width h. That widens what was seen by about as much as a quantile of few nights is too narrow: of nights drawn
from the configured distribution one in fifty lies beyond the quantile learned from 28 of them at 0.98, as it should.
Nothing is assumed about the shape, a later night is never a smaller quantile, and without nights F is what is
configured. Promises are made on F's quantile at `nights.confidence`. A departure moves the guard, so it is taken as
later than configured only if that holds at `FIRM` of the risk: then in nine households of ten hardly more than the
whole of it are left early.

Until `LEAST_NIGHTS` are seen the configured figures count. Weekdays and weekends are learned apart once as many of
either are seen, and until then the more cautious of its own nights and of all nights counts for a kind of day. The
morning minimum is nobody's habit, and is never learned.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import date, datetime, timedelta
from functools import lru_cache
from math import erf, sqrt
from zoneinfo import ZoneInfo

from plugd import sessions
from plugd.domain import ByKind, Habits, Household, Learned, Memory, Presence, Range, SeenNight, SocEstimate
from plugd.sessions import DAY
from plugd.soc import flowed_kwh

LEAST_NIGHTS = 28
SPAN = timedelta(days=112)
"""How far back habits reach: 80 weekdays, and as many weekend days as are needed to learn them."""
AHEAD = timedelta(days=7)
"""A night further ahead than this was seen by a clock that went wrong."""
PRIOR_NIGHTS = 0.5
SPREAD_NIGHTS = 7.0
FIRM = 0.4
GLITCH = timedelta(minutes=15)
"""An unplugging no longer than this is none: hubs restart."""
NIGHT_SHARE = 0.5
"""Of the usual stay: a stay that covers less is not the night's."""
MOST_NIGHTS_AWAY = 14
"""Of a stay that lasts longer, the last nights are looked at."""
STEPS = 18
"""Halvings in the search for a quantile: to a hundredth of a minute."""
FULL = "full"


# -- what is learned ------------------------------------------------------------------------------


def quantile(share: float, seen: Sequence[float], mean: float, sd: float) -> float:
    """The smallest x with F(x) >= `share` (module docstring); the configured quantile where nothing was seen."""
    width = sd * sqrt(SPREAD_NIGHTS / (SPREAD_NIGHTS + len(seen)))
    reach = sessions.z_score(max(share, 1.0 - share)) + 1.0
    low = min(mean - reach * sd, *(x - reach * width for x in seen), mean)
    high = max(mean + reach * sd, *(x + reach * width for x in seen), mean)
    for _ in range(STEPS):
        middle = (low + high) / 2.0
        below = PRIOR_NIGHTS * _normal(middle - mean, sd) + sum(_normal(middle - x, width) for x in seen)
        if below >= share * (PRIOR_NIGHTS + len(seen)):
            high = middle
        else:
            low = middle
    return high


def _normal(off: float, sd: float) -> float:
    """The normal distribution function; a step without spread."""
    if sd <= 0.0:
        return 1.0 if off >= 0.0 else 0.0
    return 0.5 * (1.0 + erf(off / (sd * sqrt(2.0))))


def late(seen: Sequence[float], mean: float, sd: float, confidence: float) -> Range:
    """A quantity that is promised to be no more than its high: arrivals, use."""
    middle = (PRIOR_NIGHTS * mean + sum(seen)) / (PRIOR_NIGHTS + len(seen))
    return Range(min(seen, default=middle), middle, max(middle, quantile(confidence, seen, mean, sd)))


def early(seen: Sequence[float], mean: float, sd: float, confidence: float) -> Range:
    """A quantity that is promised to be no less than its low: departures."""
    mirrored, configured = [-x for x in seen], mean - sessions.z_score(confidence) * sd
    low = -quantile(1.0 - FIRM * (1.0 - confidence), mirrored, -mean, sd)
    if low <= configured:
        low = min(configured, -quantile(confidence, mirrored, -mean, sd))
    middle = (PRIOR_NIGHTS * mean + sum(seen)) / (PRIOR_NIGHTS + len(seen))
    return Range(min(low, middle), middle, max(seen, default=middle))


Learn = Callable[[Sequence[float], float, float, float], Range]


def by_kind(
    learn: Learn, seen: Sequence[tuple[int, float]], mean: float, sd: float, confidence: float
) -> ByKind | None:
    """A quantity on weekdays and weekends from (kind, value) of each night; None while too few were seen."""
    if len(seen) < LEAST_NIGHTS:
        return None

    def of(kind: int) -> Range:
        own = [x for k, x in seen if k == kind]
        found = learn(own, mean, sd, confidence)
        if len(own) >= LEAST_NIGHTS:
            return found
        whole = learn([x for _, x in seen], mean, sd, confidence)
        return Range(min(whole.low, found.low), found.mean, max(whole.high, found.high))

    return of(0), of(1)


def informed(household: Household, habits: Habits) -> Household:
    """The household with what was learned of it; as configured where nothing is, or where that is not wanted."""
    if not household.nights.learn or len(habits.nights) < LEAST_NIGHTS:
        return household
    return _informed(household, habits.nights)


@lru_cache(maxsize=4)
def _informed(household: Household, seen: tuple[SeenNight, ...]) -> Household:
    nights, car, sure = household.nights, household.car, household.nights.confidence
    evenings = [
        (sessions.kind(sessions.evening_of(night.day, nights)), night.plug_in_min)
        for night in seen
        if night.plug_in_min is not None
    ]
    mornings = [(sessions.kind(n.day), n.plug_out_min) for n in seen if n.plug_out_min is not None]
    uses = [(sessions.kind(n.day), n.use_kwh) for n in seen if n.use_kwh is not None]
    plug_in_min, plug_out_min = map(sessions.minutes_of, (nights.plug_in, nights.plug_out))
    learned = Learned(
        by_kind(late, evenings, plug_in_min, nights.plug_in_sd_min, sure),
        by_kind(early, mornings, plug_out_min, nights.plug_out_sd_min, sure),
        by_kind(late, uses, car.daily_use_kwh, car.daily_use_sd_kwh, sure),
    )
    if learned.use_kwh is not None:
        mean_kwh, high_kwh = (_usual(learned.use_kwh, of) for of in ("mean", "high"))
        z = sessions.z_score(nights.confidence)
        sd_kwh = (high_kwh - mean_kwh) / z if z > 0.0 else car.daily_use_sd_kwh
        car = replace(car, daily_use_kwh=mean_kwh, daily_use_sd_kwh=sd_kwh)
    return replace(household, learned=learned, car=car)


def _usual(quantity: ByKind, of: str) -> float:
    """The mean over the days of a week."""
    weekday, weekend = (float(getattr(found, of)) for found in quantity)
    return (5.0 * weekday + 2.0 * weekend) / 7.0


# -- what is seen ---------------------------------------------------------------------------------


def kept(habits: Habits, *found: SeenNight) -> Habits:
    """With these nights; what was known of them before and is not said anew stays. Old ones go."""
    known = {night.day: night for night in habits.nights}
    for night in found:
        before = known.get(night.day, night)
        known[night.day] = SeenNight(
            night.day,
            before.plug_in_min if night.plug_in_min is None else night.plug_in_min,
            before.plug_out_min if night.plug_out_min is None else night.plug_out_min,
            before.use_kwh if night.use_kwh is None else night.use_kwh,
        )
    last = max((night.day for night in found), default=date.min)
    first = last - SPAN if last > date.min + SPAN else date.min
    nights = (night for day, night in sorted(known.items()) if first < day < last + AHEAD)
    return replace(habits, nights=tuple(nights)) if found else habits


def observed(now: datetime, before: Memory, after: Memory, household: Household) -> Memory:
    """`after` with what can be learned from the step from `before` to it."""
    habits = after.habits
    if after.presence != before.presence:
        habits = _presence(before.presence, after.presence, habits, household)
    if after.soc != before.soc:
        habits = _battery(now, before.soc, after, habits, household)
    return after if habits is after.habits else replace(after, habits=habits)


def _presence(before: Presence, after: Presence, habits: Habits, household: Household) -> Habits:
    """A plug-in ends the stay before it, unless it was no unplugging at all. One not seen itself is no arrival."""
    if before.connected is None:
        return replace(habits, arrived_at=None, left_at=None)
    if after.connected is False:
        return replace(habits, left_at=after.since)
    arrived, left, since = habits.arrived_at, habits.left_at, after.since
    if left is None or since is None:
        return replace(habits, arrived_at=since, left_at=None)
    if timedelta(0) <= since - left < GLITCH:
        return replace(habits, left_at=None)
    found = () if arrived is None else tuple(nights_of(arrived, left, household))
    return replace(kept(habits, *found), arrived_at=since, left_at=None)


def nights_of(arrived: datetime, left: datetime, household: Household) -> Iterable[SeenNight]:
    """The nights that a stay covers, with its times as far as they are that night's."""
    zone, nights = ZoneInfo(household.timezone), household.nights
    last = left.astimezone(zone).date() + DAY
    first = max(arrived.astimezone(zone).date(), last - DAY * MOST_NIGHTS_AWAY)
    days = (first + DAY * k for k in range((last - first) // DAY + 1))
    for day in days:
        evening = sessions.evening_of(day, nights)
        start, end = sessions.to_utc(evening, nights.plug_in, zone), sessions.to_utc(day, nights.plug_out, zone)
        if end > start and min(end, left) - max(start, arrived) >= NIGHT_SHARE * (end - start):
            # A car that was there since the night before, or is still there, was there in time: half a day is enough.
            came, went = max(arrived, start - DAY / 2), min(left, end + DAY / 2)
            yield SeenNight(day, _minutes(came, evening, zone), _minutes(went, day, zone))


def _minutes(moment: datetime, day: date, zone: ZoneInfo) -> float:
    """Local minutes after the midnight that `day` begins with."""
    local = moment.astimezone(zone).replace(tzinfo=None)
    return round((local - datetime.combine(day, sessions.MIDNIGHT)).total_seconds() / 60.0, 1)


def _battery(now: datetime, before: SocEstimate, after: Memory, habits: Habits, household: Household) -> Habits:
    """Count what flows, and at each word on how full the battery is what it has lost beside that."""
    estimate, car = after.soc, household.car
    level_kwh = habits.level_kwh
    if level_kwh is not None and estimate.meter_kwh is not None and estimate.metered_at != before.metered_at:
        span = estimate.metered_at - before.metered_at if estimate.metered_at and before.metered_at else None
        most_kw = household.capability.power_max_kw
        level_kwh += flowed_kwh(before.meter_kwh, estimate.meter_kwh, span, most_kw) * car.efficiency
        habits = habits if level_kwh == habits.level_kwh else replace(habits, level_kwh=level_kwh)
    told = estimate.told_at is not None and estimate.told_at != before.told_at
    full = estimate.source == FULL and before.source != FULL
    if not told and (not full or (habits.level_kwh is not None and not habits.full)):
        return habits
    return _word(now, estimate.mean * car.capacity_kwh, full and not told, after, habits, household)


def _word(now: datetime, energy_kwh: float, full: bool, memory: Memory, habits: Habits, household: Household) -> Habits:
    """Somebody says how full the battery is: `energy_kwh`. See `Habits` for what is remembered from one to the next."""
    house = replace(household, learned=None)  # what was learned must not decide what is seen
    stay = next(sessions.windows(house, memory.overrides, now), None)
    if stay is None:
        return habits
    day = sessions.today(stay.session.end, house)
    since = memory.presence.since if memory.presence.connected else None
    late = now >= stay.early_plug_in or (since is not None and since > stay.session.end - DAY)
    anew = replace(habits, level_kwh=energy_kwh, full=full, day=day, used_kwh=0.0, whole=False, late=late)
    last = habits.day
    if habits.level_kwh is None or last is None or full is not habits.full or day < last:
        return anew
    lost_kwh = habits.level_kwh - energy_kwh
    if day == last:
        return replace(anew, used_kwh=habits.used_kwh + lost_kwh, whole=habits.whole, late=habits.late or late)
    if habits.whole and habits.late:
        habits = kept(habits, SeenNight(last - DAY, use_kwh=round(max(0.0, habits.used_kwh), 3)))
    announced = any(trip.day == day - DAY for trip in memory.overrides.trips)
    whole = habits.late and day - last == DAY and not announced
    return replace(anew, nights=habits.nights, used_kwh=lost_kwh, whole=whole)


# -- told -----------------------------------------------------------------------------------------


def words(household: Household, habits: Habits) -> str:
    """What was learned, on one line for people. `household`: as configured."""
    seen, learns = len(habits.nights), household.nights.learn
    if not learns:
        return "nothing is learned: nights.learn is false"
    learned = informed(household, habits).learned or Learned()
    told = [
        *_told("home by", learned.plug_in_min, lambda x: _clock(x.high)),
        *_told("here until", learned.plug_out_min, lambda x: _clock(x.low)),
        *_told("uses at most", learned.use_kwh, lambda x: f"{x.high:.1f} kWh a day"),
    ]
    if not told:
        return f"{seen} of {LEAST_NIGHTS} nights seen; until then the configured times and daily use count"
    return f"from {seen} nights: {', '.join(told)}"


def _told(name: str, quantity: ByKind | None, tell: Callable[[Range], str]) -> Iterator[str]:
    if quantity is not None:
        weekday, weekend = map(tell, quantity)
        yield f"{name} {weekday}" if weekday == weekend else f"{name} {weekday} (weekends {weekend})"


def _clock(minutes: float) -> str:
    """Minutes after a midnight as a clock time."""
    return f"{sessions.shifted(sessions.MIDNIGHT, minutes)[1]:%H:%M}"
