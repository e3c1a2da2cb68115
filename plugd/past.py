"""What the store lacks of the last eight weeks: asked for in pages, newest first, beside the cycle.

At the first start that is all of it, after an outage what was missed. Nothing is remembered of how far it came but
what is in the store, so it goes on after a restart where it was.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from plugd.domain import Intensity, PastRow
from plugd.errors import ForecastError, ForecastLate, ForecastMalformed
from plugd.plausible import doubt
from plugd.ports import Archive, PastSource
from plugd.retry import Retry, waits
from plugd.units import slot_start

HISTORY = timedelta(days=56)
"""What the outlook learns from."""
PAGE = timedelta(days=14)
"""The API answers no longer question about the past."""
PAUSE = timedelta(seconds=1)
"""Between two questions about the past, at least."""
LATE = timedelta(seconds=5)
"""After this it is looked again whether an answer has come that was not there at once."""
LOOK_AGAIN = timedelta(hours=1)
RECENT = timedelta(hours=2)
"""So new that it may not be measured yet."""
RETRY_S = (60.0, 600.0, 3600.0, 21600.0)
LONGEST_PAUSE = 1.5 * timedelta(seconds=RETRY_S[-1])
_GRID = datetime(2020, 1, 1, tzinfo=UTC)

Page = tuple[datetime, datetime]


def pages(start: datetime, end: datetime, page: timedelta = PAGE) -> Iterator[Page]:
    """The questions that cover [start, end)."""
    while start < end:
        yield start, min(start + page, end)
        start += page


@dataclass(slots=True)
class CatchUp:
    """Fills the store from the source, a page a call. It never waits longer than the source does."""

    source: PastSource
    store: Archive
    spread: Callable[[], float]
    """A number in 0..1 for pauses between retries."""
    at: datetime | None = None
    """When it has something to do next."""
    waiting: list[Page] = field(default_factory=list)
    """What is still to be asked for, the next one last."""
    answered: dict[datetime, int] = field(default_factory=dict)
    """Half hours that the source did not know of a page, by its place on the grid: not asked for again."""
    retry: Retry = field(default_factory=lambda: Retry(RETRY_S))

    def step(self, now: datetime, wait: bool = False) -> None:
        """Ask for one page where one is due; with `wait` a moment later. Raises StoreError."""
        if self.at is None or (wait and self.at <= now):
            self.at = now + PAUSE
        if waits(now, self.at, LONGEST_PAUSE):
            return
        self.at = now + LOOK_AGAIN
        if not self.waiting:
            self.waiting = self._lacking(now)
        if self.waiting:
            self._ask(now, *self.waiting[-1])

    def _ask(self, now: datetime, start: datetime, end: datetime) -> None:
        try:
            rows = self.source.past(start, end)
            self._believe(rows, now)
        except ForecastLate:
            self.at = now + LATE
            return
        except ForecastError:
            # What is wrong the forecast's own fault says. Perhaps only this page is: the others come first.
            self.retry.failed(now, self.spread())
            self.at = self.retry.at
            self.waiting.insert(0, self.waiting.pop())
            return
        self.retry.succeeded()
        self.waiting.pop()
        self.store.keep_past(self.source.region, rows)
        self.answered[_place(start)] = self._lacks(start, end, now)
        self.at = now + (PAUSE if self.waiting else LOOK_AGAIN)

    def _believe(self, rows: Sequence[PastRow], now: datetime) -> None:
        """Raises ForecastMalformed for values that cannot be true."""
        told = ((row.start, row.forecast if row.actual is None else row.actual) for row in rows)
        why = doubt([Intensity(start, g) for start, g in told if g is not None], self.store.history(now - HISTORY))
        if why is not None:
            raise ForecastMalformed(f"NESO's answer is not used: it says {why}")

    def _lacking(self, now: datetime) -> list[Page]:
        end = slot_start(now)
        first = end - HISTORY
        grid = pages(_place(first), end)
        asked = ((max(start, first), last) for start, last in grid)
        return [
            (start, last)
            for start, last in asked
            if self._lacks(start, last, now) > self.answered.get(_place(start), 0)
        ]

    def _lacks(self, start: datetime, end: datetime, now: datetime) -> int:
        return self.store.lacks(self.source.region, start, min(end, slot_start(now) - RECENT), self.source.measures)


def _place(moment: datetime) -> datetime:
    """Where the page that holds a moment begins on the grid, so that a page has the same name every day."""
    return _GRID + (moment - _GRID) // PAGE * PAGE
