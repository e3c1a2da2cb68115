"""What the cycle needs from the world. Adapters, stubs and the study implement these; nothing inherits."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from typing import Protocol, runtime_checkable

from plugd.domain import (
    Answer,
    Capability,
    Command,
    Decision,
    Fault,
    Forecast,
    Intensity,
    Memory,
    Outlook,
    PastRow,
    Reading,
    Record,
    Wanted,
)
from plugd.ledger import HalfHour


class Inbox(Protocol):
    """Where messages arrive. A clock watches it, so that waiting ends early when one does."""

    def pending(self) -> bool:
        """Whether something waits to be taken."""

    def wait(self, timeout_s: float) -> None:
        """Return when something is pending or the time is over, whichever is first."""

    def wake(self) -> None:
        """End a wait at once: for alarms and signals. Safe from any thread and from a signal handler."""

    def flush(self) -> None:
        """Return once all that was sent has reached the other side and all it held for us is pending."""


class Clock(Protocol):
    """Time. Nobody waits anywhere else."""

    def now(self) -> datetime:
        """Wall time, aware UTC. It may step."""

    def monotonic(self) -> float:
        """Seconds that only grow, for intervals."""

    def wait(self, until: datetime, woken_by: Inbox | None = None) -> None:
        """Return at `until`, or earlier: when a message arrives, or for no reason. Callers look again."""


class ForecastSource(Protocol):
    """Where the intensity forecast comes from."""

    def fetch(self, now: datetime) -> Forecast:
        """The newest forecast. Raises ForecastLate, ForecastUnavailable, ForecastMalformed.

        Waits 2 s at most; what comes later a later call returns.
        """


class Plug(Protocol):
    """Something that takes power when told to. One behaviour suite runs against every implementation."""

    @property
    def capability(self) -> Capability:
        """What it can be told."""

    @property
    def warnings(self) -> Sequence[Fault]:
        """What a person should mend at the plug, though it works."""

    def read(self) -> Reading:
        """Latest reading, at most 60 s old: an older one is asked for anew. Raises PlugTimeout."""

    def set(self, wanted: Wanted) -> None:
        """Command, and confirm by reading back. Raises PlugRefused, PlugTimeout, PlugFault."""

    def tend(self, now: datetime) -> None:
        """Renew the dead-man's timer where one is due."""

    def due(self) -> datetime | None:
        """When `tend` has something to do."""


@runtime_checkable
class Tended(Protocol):
    """What a plug has besides where it stops unless it is told something every second (a CAN charger).

    The loop tends it, when `due` says so, while it waits for anything else: never a thread or a kernel's timer, which
    would go on telling when the loop hangs.
    """

    @property
    def line(self) -> Inbox:
        """What to wait by between two words."""

    def close(self) -> None:
        """The last word, and the end."""


class Hub(Protocol):
    """Whoever commands plugd and wants to know."""

    @property
    def warnings(self) -> Sequence[Fault]:
        """What a person should mend at the hub's end, though plugd works."""

    def commands(self) -> Sequence[Command]:
        """What arrived since the last call, oldest first. Refused ones are answered and not in it."""

    def publish(self, decision: Decision, reading: Reading | None) -> None:
        """Tell the state, the plan and the answers. Never raises for a lost connection."""

    def answer(self, answers: Sequence[Answer]) -> None:
        """Tell what became of commands."""


class Store(Protocol):
    """What survives a restart."""

    def load(self) -> Memory | None:
        """The last saved memory, None at the first start. Raises StoreError."""

    def save(self, memory: Memory) -> None:
        """Keep the memory. Raises StoreError."""

    def append(self, record: Record) -> None:
        """Add a line to the log. Raises StoreError."""

    def keep(self, forecast: Forecast) -> None:
        """Keep a forecast as issued. Raises StoreError."""

    def latest_forecast(self) -> Forecast | None:
        """The last one kept."""

    def history(self, since: datetime) -> tuple[Intensity, ...]:
        """Intensities known of half hours from `since` on: measured where published, else last expected."""

    def issued(self, since: datetime) -> Iterable[Forecast]:
        """Every forecast kept from `since` on, oldest first, each with what was newly published by then.

        So the fold over them sees the past as it came to be known. Raises StoreError.
        """

    def expect(self, at: datetime, outlook: Outlook) -> None:
        """Keep what was expected at `at`, to be scored later. Raises StoreError."""


class Errand(Protocol):
    """Something that is done beside the cycle when there is time, a little at a call."""

    @property
    def at(self) -> datetime | None:
        """When there is something to do next."""

    def step(self, now: datetime, wait: bool = False) -> None:
        """Do a little of it where it is due; with `wait` a moment later. Raises StoreError."""


@dataclass(frozen=True, slots=True)
class Tally:
    """Errors (expected less measured) at a day's half hours of one who said what to expect, `from_h` to `to_h` ahead.

    Sums over `half_hours`, in g/kWh: their absolute values, themselves, and what was measured.
    """

    day: date
    who: str
    from_h: int
    to_h: int
    half_hours: int
    absolute: float
    signed: float
    level: float


class Scores(Protocol):
    """Where scores outlive a restart, and what they are made of. Every call raises StoreError."""

    def issued(self, since: datetime) -> Iterable[Forecast]:
        """As the store's."""

    def measured(self, since: datetime) -> tuple[Intensity, ...]:
        """What was measured from `since` on, as far as published."""

    def outlook(self, at: datetime) -> Mapping[datetime, float]:
        """What plugd expected of each half hour, in the half hour that began at `at`; nothing where nothing is kept."""

    def scored(self) -> date | None:
        """The last day that is scored."""

    def score(self, day: date, found: Sequence[Tally]) -> None:
        """Keep a day's score; a day without any counts as scored too."""


class Archive(Protocol):
    """Where past intensities outlive a restart."""

    def history(self, since: datetime) -> tuple[Intensity, ...]:
        """As the store's."""

    def keep_past(self, region: str, rows: Iterable[PastRow]) -> None:
        """Keep half hours that are over; an expectation known already stays. Raises StoreError."""

    def lacks(self, region: str, start: datetime, end: datetime, measured: bool) -> int:
        """Half hours in [start, end) of which nothing is known, or nothing measured. Raises StoreError."""


class Books(Protocol):
    """Where the ledger outlives a restart."""

    def half_hours(self, since: datetime | None = None) -> tuple[HalfHour, ...]:
        """The entries from `since` on, in order of time. Raises StoreError."""

    def enter(self, rows: Sequence[HalfHour]) -> None:
        """Keep half hours, in place of what was kept of them. Raises StoreError."""

    def measured(self, since: datetime) -> tuple[Intensity, ...]:
        """What was measured from `since` on, as far as published. Raises StoreError."""


class PastSource(Protocol):
    """Where past intensities come from."""

    @property
    def region(self) -> str:
        """What its forecasts call their region."""

    @property
    def measures(self) -> bool:
        """Whether it tells what was measured."""

    def past(self, start: datetime, end: datetime) -> Sequence[PastRow]:
        """What is known of [start, end). Raises ForecastLate, ForecastUnavailable, ForecastMalformed."""
