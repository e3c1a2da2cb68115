"""The calendar: which sessions to expect, from clock times with a spread, in the home's time zone (paper III-B)."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from functools import lru_cache
from itertools import islice
from math import sqrt
from statistics import NormalDist
from zoneinfo import ZoneInfo

from plugd.domain import Car, DayRule, Household, Nights, Overrides, Presence, Range, Session
from plugd.units import require_utc

DAY = timedelta(days=1)
SATURDAY = 5
MIDNIGHT = time(0)
MAX_AWAY_DAYS = 60
"""How far ahead a night at home is looked for when every night is marked away."""


@dataclass(frozen=True, slots=True)
class Window:
    """One expected stay in UTC. `early`/`late` are the spread of plug-in and plug-out around `session`."""

    session: Session
    early_plug_in: datetime
    late_plug_out: datetime


def z_score(confidence: float) -> float:
    """Standard normal quantile: 2.05 at 0.98."""
    return float(NormalDist().inv_cdf(confidence))


def kind(day: date) -> int:
    """What habits differ by: 0 on weekdays, 1 on Saturdays and Sundays."""
    return int(day.weekday() >= SATURDAY)


def cautious_use_kwh(car: Car, confidence: float, days: int = 1) -> float:
    """The quantile of what is driven over `days` days (paper III-C: 11.28 kWh for one, at 0.98)."""
    return car.daily_use_kwh * days + z_score(confidence) * car.daily_use_sd_kwh * sqrt(days)


def use_after_kwh(morning: date, days: int, household: Household) -> float:
    """The same for the `days` days from a morning on, each as that kind of day is where that was learned.

    Means add up, and what caution adds to them adds up as independent spreads do.
    """
    learned = household.learned.use_kwh if household.learned else None
    if learned is None:
        return cautious_use_kwh(household.car, household.nights.confidence, days)
    each = [learned[kind(morning + DAY * k)] for k in range(days)]
    return sum(use.mean for use in each) + sqrt(sum((use.high - use.mean) ** 2 for use in each))


def to_utc(day: date, clock: time, zone: ZoneInfo) -> datetime:
    """A local clock time as UTC. A time that comes twice is the first; a missing one is the next that exists."""
    local = datetime.combine(day, clock)
    while True:
        moment = require_utc(local.replace(tzinfo=zone))
        if moment.astimezone(zone).replace(tzinfo=None) == local:
            return moment
        local = local.replace(second=0, microsecond=0) + timedelta(minutes=1)


def shifted(clock: time, minutes: float) -> tuple[int, time]:
    """A clock time moved by some minutes, to the nearest whole one: (days crossed, clock time)."""
    total = round((clock.hour * 3600 + clock.minute * 60 + clock.second) / 60 + minutes)
    return total // 1440, time((total % 1440) // 60, total % 60)


def rule_of(day: date, nights: Nights, overrides: Overrides) -> DayRule:
    """What counts for the morning of `day`: a trip beats the week, the week beats the defaults."""
    default = DayRule(
        ready_by=overrides.ready_by or nights.ready_by,
        minimum=nights.minimum if overrides.minimum is None else overrides.minimum,
    )
    week = dict(nights.week if overrides.week is None else overrides.week).get(day.weekday(), DayRule())
    trip = next((t for t in overrides.trips if t.day == day), None)
    dated = DayRule(trip.ready_by, trip.minimum, trip.away) if trip else DayRule(away=week.away)
    minima = (dated.minimum, week.minimum, default.minimum)
    return DayRule(
        ready_by=dated.ready_by or week.ready_by or default.ready_by,
        minimum=next(minimum for minimum in minima if minimum is not None),
        away=dated.away,
    )


@lru_cache(maxsize=256)
def _window(day: date, household: Household, overrides: Overrides) -> Window | None:
    """The stay that ends on the local `day`; None if the car is away."""
    nights, car = household.nights, household.car
    zone = ZoneInfo(household.timezone)
    rule = rule_of(day, nights, overrides)
    if rule.away:
        return None
    arrival = evening_of(day, nights)

    def local(base: date, clock: time, minutes: float) -> datetime:
        days, moved = shifted(clock, minutes)
        return to_utc(base + DAY * days, moved, zone)

    plug_in, plug_out = _spreads(arrival, day, household)
    start = local(arrival, MIDNIGHT, plug_in.high)
    end = local(day, MIDNIGHT, plug_out.low)
    if rule.ready_by is not None:
        end = to_utc(day, rule.ready_by, zone)
    if end <= start:  # a short stay with a wide spread: better the usual times than no session at all
        start = local(arrival, MIDNIGHT, plug_in.mean)
        end = end if rule.ready_by is not None else local(day, MIDNIGHT, plug_out.mean)
    if end <= start:
        return None
    minimum = rule.minimum if rule.minimum is not None else nights.minimum
    return Window(
        session=Session(start, end, minimum, use_after_kwh(day, 1, household), max(car.soc_max, minimum)),
        early_plug_in=local(arrival, MIDNIGHT, plug_in.low),
        late_plug_out=max(end, local(day, MIDNIGHT, plug_out.high)),
    )


def evening_of(day: date, nights: Nights) -> date:
    """The local day on which the car comes home for the night that ends on `day`."""
    return day - DAY if nights.plug_in >= nights.plug_out else day


def configured(clock: time, sd_min: float, confidence: float) -> Range:
    """When the car comes or goes, as configured, in minutes after midnight."""
    mean_min, beyond_min = minutes_of(clock), z_score(confidence) * sd_min
    return Range(mean_min - beyond_min, mean_min, mean_min + beyond_min)


def minutes_of(clock: time) -> float:
    """A clock time as minutes after midnight."""
    return clock.hour * 60 + clock.minute + clock.second / 60


def _spreads(evening: date, morning: date, household: Household) -> tuple[Range, Range]:
    """When the car comes home on that evening and leaves on that morning.

    What was learned moves the promised window, but never narrows the time in which the car may be here.
    """
    nights, learned = household.nights, household.learned
    plug_in = configured(nights.plug_in, nights.plug_in_sd_min, nights.confidence)
    plug_out = configured(nights.plug_out, nights.plug_out_sd_min, nights.confidence)
    if learned is not None and learned.plug_in_min is not None:
        seen = learned.plug_in_min[kind(evening)]
        plug_in = Range(min(plug_in.low, seen.low), seen.mean, seen.high)
    if learned is not None and learned.plug_out_min is not None:
        seen = learned.plug_out_min[kind(morning)]
        plug_out = Range(seen.low, seen.mean, max(plug_out.high, seen.high))
    return plug_in, plug_out


def windows(household: Household, overrides: Overrides, since: datetime) -> Iterator[Window]:
    """All stays whose session ends after `since`, in order, without end (unless every night is away)."""
    day = require_utc(since).astimezone(ZoneInfo(household.timezone)).date()
    barren = 0
    while barren < MAX_AWAY_DAYS:
        window = _window(day, household, overrides)
        barren = barren + 1 if window is None else 0
        if window is not None and window.session.end > since:
            yield window
        day += DAY


def today(now: datetime, household: Household) -> date:
    """The local day."""
    return now.astimezone(ZoneInfo(household.timezone)).date()


def stay_of(day: date, household: Household, overrides: Overrides) -> Window | None:
    """The stay that ends on the local `day`; None if the car is away, or there is no time for one."""
    return _window(day, household, overrides)


def under_way(now: datetime, household: Household, overrides: Overrides, presence: Presence) -> Window | None:
    """The stay the car is at the plug for by now, known or assumed: from plug-in to the late plug-out.

    Told that the car is here, a stay begins then, and lasts until told otherwise or until the next one begins.
    """
    stays = windows(household, overrides, now - 2 * DAY)
    seen: Window | None = None
    for window in islice(stays, 4):
        early = _with_early_plug_in(window, seen, presence)
        if early.session.start > now:
            break
        seen = early
    if seen is None:
        return None
    still_told = presence.connected is True
    return seen if now < seen.late_plug_out or still_told else None


def _with_early_plug_in(window: Window, previous: Window | None, presence: Presence) -> Window:
    """The window begun earlier where the car was told to be plugged in before its expected time."""
    since = presence.since
    if presence.connected is not True or since is None or since >= window.session.start:
        return window
    after_last_stay = previous is None or since >= previous.session.end
    close = window.session.start - since < DAY
    if after_last_stay and close:
        return replace(window, session=replace(window.session, start=since))
    return window


def expected(
    now: datetime, household: Household, overrides: Overrides, presence: Presence, sessions: int
) -> tuple[Session, ...]:
    """The next `sessions` sessions that end after `now`, the one under way first.

    Each one's daily use covers the days to the next session's end, so a night away counts double.
    """
    previous, zone = None, ZoneInfo(household.timezone)
    for window in windows(household, overrides, now - 3 * DAY):
        if window.session.end > now:
            break
        previous = window
    coming = list(islice(windows(household, overrides, now), sessions + 1))
    if coming:
        coming[0] = _with_early_plug_in(coming[0], previous, presence)
    found = []
    for index, window in enumerate(coming[:sessions]):
        days = _days_between(window, coming[index + 1], household) if index + 1 < len(coming) else 1
        morning = window.session.end.astimezone(zone).date()
        found.append(replace(window.session, daily_use_kwh=use_after_kwh(morning, days, household)))
    return tuple(found)


def _days_between(earlier: Window, later: Window, household: Household) -> int:
    """Local days from one session's end to the next one's: the days driven in between."""
    zone = ZoneInfo(household.timezone)
    first, second = (w.session.end.astimezone(zone).date() for w in (earlier, later))
    return max(1, (second - first).days)


def drives(
    household: Household, overrides: Overrides, presence: Presence, since: datetime, now: datetime
) -> tuple[tuple[datetime, int], ...]:
    """The homecomings in (since, now]: (when, days driven), where `since` is what the SOC already includes.

    A SOC told after the early plug-in quantile of an evening is taken as told after that day's driving.
    """
    found: list[tuple[datetime, int]] = []
    previous: Window | None = None
    for window in windows(household, overrides, since - 2 * DAY):
        stay = _with_early_plug_in(window, previous, presence)
        start = stay.session.start
        if start > now:
            break
        if start > since and since < min(stay.early_plug_in, start):
            found.append((start, _days_between(previous, stay, household) if previous else 1))
        previous = stay
    return tuple(found)


def next_stay(now: datetime, household: Household, overrides: Overrides) -> Window | None:
    """The next stay that is expected to begin. None where no night at home is."""
    return next((stay for stay in windows(household, overrides, now) if stay.session.start > now), None)


def coming_home(now: datetime, household: Household, overrides: Overrides, presence: Presence) -> Window | None:
    """The next stay, once its car may be at the plug already though nobody said so: from its early plug-in on."""
    stay = next_stay(now, household, overrides)
    may_be_here = stay is not None and now >= stay.early_plug_in and presence.connected is not False
    return stay if may_be_here else None
