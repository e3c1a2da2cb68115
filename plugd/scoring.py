"""How good what was expected turned out, a day at a time: plugd's own outlook, the source's forecast, persistence.

All three are held to the same half hours: those that the source spoke of, and those beyond where it ever does.
Persistence is what was measured at the same time of day, the last time that was known when the forecast was issued.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from itertools import pairwise

from plugd.domain import Forecast
from plugd.ports import Scores, Tally
from plugd.retry import waits
from plugd.score import LEADS_H, LeadScore
from plugd.units import HALF_HOUR, hours, slot_start

OURS, NESO, PERSISTENCE = "ours", "neso", "persistence"
SCORED = timedelta(days=30)
SETTLED = timedelta(hours=30)
"""From the end of a day until its measured values stand."""
FARTHEST = timedelta(hours=LEADS_H[-1])
NESO_H = 48.0
"""The source never speaks of more."""
PUBLISHED = timedelta(hours=1)
"""From the end of a half hour until its measured value is known, at the earliest."""
DAY = timedelta(days=1)
FIRST_DAYS = 7
"""How many days back the first scoring looks."""
LOOK_AGAIN = timedelta(hours=6)
PAUSE = timedelta(seconds=30)

Values = Mapping[datetime, float]
STEPS = tuple(pairwise(LEADS_H))


def tallies(
    issued: Iterable[Forecast], outlook: Callable[[datetime], Values], measured: Values, day: date
) -> tuple[Tally, ...]:
    """The errors of all that was said of the half hours of `day` (UTC). `outlook`: plugd's own in a half hour."""
    first = datetime.combine(day, time(), UTC)
    sums: dict[tuple[str, int, int], list[float]] = defaultdict(lambda: [0.0] * 4)
    for forecast in issued:
        said = {row.start: row.g_per_kwh for row in forecast.expected}
        ours = outlook(slot_start(forecast.issued_at))
        for start in (first + k * HALF_HOUR for k in range(48)):
            step = _step(hours(start - slot_start(forecast.issued_at)))
            true = measured.get(start)
            if step is None or true is None or (start not in said and step[0] < NESO_H):
                continue
            words = {NESO: said.get(start), OURS: ours.get(start), PERSISTENCE: _last_day(start, forecast, measured)}
            for who, value in words.items():
                if value is not None:
                    for k, more in enumerate((1.0, abs(value - true), value - true, true)):
                        sums[who, *step][k] += more
    return tuple(
        Tally(day, who, low, high, int(count), absolute, signed, level)
        for (who, low, high), (count, absolute, signed, level) in sorted(sums.items())
    )


def _step(lead_h: float) -> tuple[int, int] | None:
    return next((step for step in STEPS if step[0] <= lead_h < step[1]), None)


def _last_day(start: datetime, forecast: Forecast, measured: Values) -> float | None:
    known_to = forecast.issued_at - PUBLISHED - HALF_HOUR
    days = max(1, -((known_to - start) // DAY))
    return measured.get(start - days * DAY)


def summed(found: Iterable[Tally]) -> dict[str, tuple[LeadScore, ...]]:
    """The score of all these days together, by whose it is, nearest first."""
    sums: dict[tuple[str, int, int], list[float]] = defaultdict(lambda: [0.0] * 4)
    for one in found:
        for k, more in enumerate((one.half_hours, one.absolute, one.signed, one.level)):
            sums[one.who, one.from_h, one.to_h][k] += more
    scores: dict[str, list[LeadScore]] = {who: [] for who in (OURS, NESO, PERSISTENCE)}
    for (who, low, high), (count, absolute, signed, level) in sorted(sums.items()):
        pct = 100.0 * absolute / level if level > 0.0 else 0.0
        scores[who].append(LeadScore(low, high, int(count), absolute / count, signed / count, pct))
    return {who: tuple(rows) for who, rows in scores.items()}


@dataclass(slots=True)
class Scoring:
    """An errand: scores a day once its measured values stand, one day a call."""

    store: Scores
    at: datetime | None = None

    def step(self, now: datetime, wait: bool = False) -> None:
        """Score one day where one is due; with `wait` a moment later. Raises StoreError."""
        if self.at is None or (wait and self.at <= now):
            self.at = now + PAUSE
        if waits(now, self.at, 2 * LOOK_AGAIN):
            return
        self.at = now + LOOK_AGAIN
        last = (now - SETTLED).date() - DAY
        done = self.store.scored()
        day = last - (FIRST_DAYS - 1) * DAY if done is None or done < last - FIRST_DAYS * DAY else done + DAY
        if day > last:
            return
        self.store.score(day, self._of(day))
        self.at = now + PAUSE

    def _of(self, day: date) -> tuple[Tally, ...]:
        first = datetime.combine(day, time(), UTC)
        since = first - FARTHEST - HALF_HOUR
        measured = {value.start: value.g_per_kwh for value in self.store.measured(since - 2 * DAY)}
        before = (forecast for forecast in self.store.issued(since) if forecast.issued_at < first + DAY)
        return tallies(before, self.store.outlook, measured, day)


def table(scores: Mapping[str, tuple[LeadScore, ...]]) -> Iterator[tuple[str, str, str, str]]:
    """Rows for people: hours ahead, and how far each was off in g/kWh, "-" where nothing is known."""
    by_step = {who: {(s.from_h, s.to_h): s.mean_abs_g_per_kwh for s in rows} for who, rows in scores.items()}
    for step in STEPS:
        cells = [by_step.get(who, {}).get(step) for who in (OURS, NESO, PERSISTENCE)]
        if any(cell is not None for cell in cells):
            ours, neso, persistence = ("-" if cell is None else f"{cell:.0f}" for cell in cells)
            yield f"{step[0]} to {step[1]} h", ours, neso, persistence


def row(score: LeadScore) -> dict[str, object]:
    """A score, for programs."""
    return {
        "from_h": score.from_h,
        "to_h": score.to_h,
        "half_hours": score.count,
        "mean_abs_g_per_kwh": round(score.mean_abs_g_per_kwh, 2),
        "bias_g_per_kwh": round(score.bias_g_per_kwh, 2),
        "mean_abs_pct": round(score.mean_abs_pct, 2),
    }


def lines(scores: Mapping[str, tuple[LeadScore, ...]]) -> list[str]:
    """The score, for people; nothing where nothing is scored."""
    rows = list(table(scores))
    if not rows:
        return []
    return [
        "",
        f"Off by so many g/kWh in the last {SCORED.days} days, on average:",
        f"  {'ahead':<11}{'plugd':>7}{'NESO':>7}{'the day before':>16}",
        *(f"  {step:<11}{ours:>7}{neso:>7}{persistence:>16}" for step, ours, neso, persistence in rows),
    ]
