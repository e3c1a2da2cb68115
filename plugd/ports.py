"""What the cycle needs from the world. Adapters, stubs and the study implement these; nothing inherits."""

from collections.abc import Sequence
from datetime import datetime
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
        """The newest forecast. Raises ForecastUnavailable, ForecastMalformed."""


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
        """Intensities seen of half hours from `since` on: measured where known, else last expected."""


class Books(Protocol):
    """Where the ledger outlives a restart."""

    def half_hours(self, since: datetime | None = None) -> tuple[HalfHour, ...]:
        """The entries from `since` on, in order of time. Raises StoreError."""

    def enter(self, rows: Sequence[HalfHour]) -> None:
        """Keep half hours, in place of what was kept of them. Raises StoreError."""

    def measure(self, region: str, values: Sequence[Intensity]) -> None:
        """Keep measured intensities. Raises StoreError."""


class MeasuredSource(Protocol):
    """Where measured intensities come from."""

    @property
    def region(self) -> str:
        """What its forecasts call their region."""

    def measured(self, start: datetime, end: datetime) -> Sequence[Intensity]:
        """What was measured in [start, end), none where nobody measures. Raises ForecastError."""
