"""What is known of the grid and of its forecasts at a moment: a fold over forecasts as issued and measured values as
published. A frozen value that can be made again from the store at any time, and so is stored nowhere."""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from heapq import merge
from math import exp, sqrt

from plugd.domain import Forecast, Intensity, Series
from plugd.outlook.tables import (
    BIAS_KEEPS,
    DAY,
    LEAD_DAYS,
    PROFILE_KEEPS,
    WEIGHT_KEEPS,
    Fit,
    Means,
    biases,
    trust,
    usual_day,
)
from plugd.units import HALF_HOUR

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
LATE = timedelta(hours=1)
"""From a half hour's end until its measured value is published."""
REVISED = 5
"""Half hours until a measured value is final and learned from. Until then the newest counts."""
SPAN = 24
"""A forecast's slow part is its mean over as many half hours before and after: a day."""
LATEST = 4
"""Half hours of measured values that say how wrong the forecast is now."""
EVERY = 12
"""Half hours from one outlook that is kept and later compared with what came to the next."""
AT_ONCE = timedelta(seconds=5)
"""A forecast asked for as a half hour begins is there a moment later."""
AHEAD = 192
"""Half hours of it that are kept."""
EDGES = (12, 24, 72, 120)
"""Where one stretch of looking ahead ends and the next begins: 6, 12, 36, 60 hours."""
PRIOR = ((0.95, 0.7, 0.5), (0.95, 0.7, 0.4), (0.9, 0.7, 0.3), (0.9, 0.6, 0.2), (0.85, 0.5, 0.1))
"""Weights of a forecast's slow part, its fast part, and of how wrong it is now, in each stretch."""
PRIOR_DAYS = 6.0
PRIOR_SD = (0.10, 0.14, 0.19, 0.24, 0.28)
"""Share of the usual day that is the standard deviation in each stretch, without evidence."""
PRIOR_SD_DAYS = 2.0
TAIL_H = 24.0
"""Beyond a forecast's end its deviation from the usual day falls to 1/e in this time. Measured: docs/outlook.md."""
MOST_OFF = 6.0
"""A measured value as many times the dirtiest usual half hour is an error, not weather."""


def at_of(moment: datetime) -> int:
    """The half hour that holds a moment, counted from 1970."""
    return (moment - EPOCH) // HALF_HOUR


def moments(since: datetime, now: datetime) -> Iterator[datetime]:
    """When to look between two moments, so that no outlook is left out that is kept to learn from; `now` last."""
    first = at_of(since) // EVERY + 1
    yield from (EPOCH + k * EVERY * HALF_HOUR for k in range(first, at_of(now) // EVERY + 1))
    yield now


def stretch(ahead: int) -> int:
    """Which stretch of looking ahead a half hour is in."""
    return bisect_right(EDGES, ahead)


@dataclass(frozen=True, slots=True)
class Said:
    """A forecast of one half hour: the last one, whatever was measured since."""

    at: int
    g_per_kwh: float
    days_ahead: int


@dataclass(frozen=True, slots=True)
class Sight:
    """One look ahead from half hour `first`. Series: (T,), and (known,) for those that need a forecast."""

    first: int
    usual: Series
    said: tuple[Said | None, ...]
    slow: Series
    fast: Series
    late: float
    """How much more is measured than was forecast, just now, g/kWh."""
    mean: Series


NO_DAY, NO_BIAS = Means.none(DAY), Means.none(LEAD_DAYS * DAY)


@dataclass(frozen=True, slots=True)
class Learned:
    """Everything learned so far; as good as nothing at first."""

    day: int = 0
    first: int | None = None
    """The earliest measured value that it knows of."""
    final: int = 0
    """Half hour up to which measured values are learned. One that comes later than its successors is left out."""
    recent: tuple[tuple[int, float], ...] = ()
    """Measured values that may still be revised."""
    said: tuple[Said, ...] = ()
    issued_at: datetime | None = None
    profile: Means = NO_DAY
    bias: Means = NO_BIAS
    fits: tuple[Fit, ...] = (Fit(),) * (len(EDGES) + 1)
    sights: tuple[Sight, ...] = ()
    """Kept to be compared with what comes."""

    def advanced(
        self, now: datetime, forecasts: Iterable[Forecast] = (), actuals: Sequence[Intensity] = ()
    ) -> "Learned":
        """With what became known by `now`. Both sorted; what was known before may be among them."""
        at = at_of(now)
        found = self.aged(at // DAY).with_measured(at, actuals)
        newer = [f for f in forecasts if found.issued_at is None or f.issued_at > found.issued_at]
        if newer:
            found = found.with_forecasts(at, newer)
        if found.said and (not found.sights or at // EVERY > found.sights[-1].first // EVERY):
            found = replace(found, sights=(*found.sights, found.sight(at, AHEAD)))
        return found

    def lacks(self, actuals: Sequence[Intensity]) -> bool:
        """Whether older values have turned up than it began with, so that it is better learned anew."""
        return bool(actuals) and (self.first is None or at_of(actuals[0].start) < self.first)

    def sight(self, first: int, count: int) -> Sight:
        """What is expected of `count` half hours from `first` on."""
        usual = usual_day(self.profile, first)
        bias = biases(self.bias)
        known = {row.at: row for row in self.said}
        said = [known.get(first + k) for k in range(-SPAN, count + SPAN)]
        off = [
            None if row is None else row.g_per_kwh + bias[DAY * row.days_ahead + row.at % DAY] - usual[row.at % DAY]
            for row in said
        ]
        slow = _smooth(off)
        late, now_off = self._late(first, off, usual)
        here = said[SPAN : SPAN + count]
        fast = tuple(0.0 if x is None else x - s for x, s in zip(off[SPAN : SPAN + count], slow, strict=True))
        ahead_usual = tuple(usual[(first + k) % DAY] for k in range(count))
        mean, last, since = [], now_off, 0
        weights = self.weights()
        for k, row in enumerate(here):
            if row is None:
                deviation = last * exp(-(k - since) / (2.0 * TAIL_H))
            else:
                a, b, c = weights[stretch(k)]
                deviation = last = a * slow[k] + b * fast[k] + c * late
                since = k
            mean.append(max(0.0, ahead_usual[k] + deviation))
        return Sight(first, ahead_usual, tuple(here), slow, fast, late, tuple(mean))

    def weights(self) -> tuple[Series, ...]:
        """Of slow, fast, late in each stretch. Without any history the forecast is taken as it is."""
        believed = trust(self.profile)
        found = []
        for fit, prior, length in zip(self.fits, PRIOR, _LENGTHS, strict=True):
            start = (1.0 + believed * (prior[0] - 1.0), 1.0 + believed * (prior[1] - 1.0), believed * prior[2])
            found.append(fit.weights(start, PRIOR_DAYS * length * DAY / EVERY))
        return tuple(found)

    def sd_g_per_kwh(self, ahead: int, usual: float) -> float:
        """The standard deviation of what is said `ahead` half hours ahead."""
        k = stretch(ahead)
        fit, prior_said = self.fits[k], PRIOR_SD_DAYS * _LENGTHS[k] * DAY / EVERY
        prior = PRIOR_SD[k] * usual
        return sqrt((fit.squares + prior_said * prior * prior) / (fit.said + prior_said))

    def _late(self, first: int, off: list[float | None], usual: Series) -> tuple[float, float]:
        """(measured less forecast, measured less usual) over the last measured half hours; 0 where unknown."""
        # What is newer than that was not measured yet, but forecast.
        measured = [(at, g) for at, g in self.recent if first - SPAN <= at < first - LATE // HALF_HOUR]
        rows = [(at, g - usual[at % DAY]) for at, g in measured[-LATEST:]]
        both = [(y, off[at - first + SPAN]) for at, y in rows]
        errors = [y - x for y, x in both if x is not None]
        return (
            sum(errors) / len(errors) if errors else 0.0,
            sum(y for _, y in rows) / len(rows) if rows else 0.0,
        )

    def aged(self, day: int) -> "Learned":
        """On a later day, when less of it still counts."""
        days = day - self.day
        if self.day == 0 or days <= 0:
            return replace(self, day=max(day, self.day))
        return replace(
            self,
            day=day,
            profile=self.profile.aged(PROFILE_KEEPS**days),
            bias=self.bias.aged(BIAS_KEEPS**days),
            fits=tuple(fit.aged(WEIGHT_KEEPS**days) for fit in self.fits),
        )

    def with_measured(self, at: int, actuals: Sequence[Intensity]) -> "Learned":
        """With measured values: the newest are kept until they are final, then learned."""
        newest = dict(self.recent)
        most = MOST_OFF * max(usual_day(self.profile, at))
        for value in reversed(actuals):
            start = at_of(value.start)
            if start < self.final:
                break
            if value.g_per_kwh <= most:
                newest[start] = value.g_per_kwh
        known = sorted(newest.items())
        first = self.first if self.first is not None or not known else known[0][0]
        settled = [row for row in known if row[0] < at - REVISED]
        final = settled[-1][0] + 1 if settled else self.final
        found = self._compared(settled)
        return replace(found, first=first, final=final, recent=tuple(row for row in known if row[0] >= at - REVISED))

    def _compared(self, values: list[tuple[int, float]]) -> "Learned":
        """With final values: the usual day, the bias, the weights and the spread from them."""
        if not values:
            return self
        pairs: dict[int, list[tuple[float, float, float, float]]] = defaultdict(list)
        errors: dict[int, list[float]] = defaultdict(list)
        off: list[tuple[int, float]] = []
        for sight in self.sights:
            for at, g in values:
                k = at - sight.first
                if not 0 <= k < AHEAD:
                    continue
                row, place = sight.said[k], stretch(k)
                errors[place].append(g - sight.mean[k])
                if row is not None:
                    off.append((DAY * row.days_ahead + at % DAY, g - row.g_per_kwh))
                    pairs[place].append((sight.slow[k], sight.fast[k], sight.late, g - sight.usual[k]))
        last = values[-1][0]
        return replace(
            self,
            profile=self.profile.with_values([(at % DAY, g) for at, g in values]),
            bias=self.bias.with_values(off),
            fits=tuple(
                fit.with_pairs(pairs[k]).with_errors(errors[k]) if k in errors else fit
                for k, fit in enumerate(self.fits)
            ),
            sights=tuple(sight for sight in self.sights if sight.first + AHEAD > last + 1),
        )

    def with_forecasts(self, at: int, forecasts: Sequence[Forecast]) -> "Learned":
        """With newer forecasts, sorted. Older ones still count for what the newest leave out."""
        told: dict[int, Said] = {}
        for forecast in reversed(forecasts):  # after a start there are many, most of whose rows never come to count
            issued = at_of(forecast.issued_at)
            for row in forecast.expected:
                start = at_of(row.start)
                if start not in told:
                    days_ahead = min(max(0, start - issued) // DAY, LEAD_DAYS - 1)
                    told[start] = Said(start, row.g_per_kwh, days_ahead)
        known = {row.at: row for row in self.said if row.at >= at - SPAN} | told
        return replace(self, said=tuple(known[start] for start in sorted(known)), issued_at=forecasts[-1].issued_at)


def replayed(issued: Iterable[Forecast], actuals: Sequence[Intensity], now: datetime) -> Learned:
    """What is known at `now`, learned from the store as it would have been learned day by day. Both sorted.

    Of the forecasts a page is held at a time: eight weeks of them together are 40 MB.
    """
    waiting = iter(issued)
    ahead = next(waiting, None)
    learned, published = Learned(), 0
    begun = [] if ahead is None else [ahead.issued_at]  # with the first one the first outlook was kept
    first = min([now, *(value.start for value in actuals[:1]), *begun])
    for moment in merge(begun, moments(first, now)):
        page = []
        while ahead is not None and ahead.issued_at <= moment + AT_ONCE:
            page.append(ahead)
            ahead = next(waiting, None)
        over = bisect_right(actuals, moment - LATE - HALF_HOUR, key=lambda value: value.start)
        learned = learned.advanced(moment, page, actuals[published:over])
        published = over
    return learned


_LENGTHS = tuple(end - start for start, end in zip((0, *EDGES), (*EDGES, AHEAD), strict=True))


def _smooth(off: list[float | None]) -> Series:
    """Means over the known half hours around each one; 0 where there is none. (T + 2 SPAN,) to (T,)."""
    totals, counts = [0.0], [0]
    for x in off:
        totals.append(totals[-1] + (x or 0.0))
        counts.append(counts[-1] + (x is not None))
    found = []
    for k in range(len(off) - 2 * SPAN):
        end = k + 2 * SPAN + 1
        count = counts[end] - counts[k]
        found.append((totals[end] - totals[k]) / count if count else 0.0)
    return tuple(found)
