"""Between the cycle and the page: a hub that also takes the page's commands, and shows what was last decided.

The cycle's thread publishes values that nobody changes afterwards; the page's thread reads the last one. Neither
waits for the other.
"""

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from plugd.domain import Answer, Command, Decision, Fault, Household, Reading
from plugd.ledger import HalfHour, Night
from plugd.ports import Hub, Inbox

MOST_WAITING = 32
"""Commands that wait for the cycle; more are refused."""

Known = tuple[tuple[HalfHour, ...], tuple[Night, ...]]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What there is to see, at one moment."""

    version: int
    at_s: float
    """When it was published, on the monotonic clock."""
    decision: Decision
    reading: Reading | None
    household: Household
    rows: tuple[HalfHour, ...]
    nights: tuple[Night, ...]


@dataclass(slots=True)
class Desk:
    """Implements `plugd.ports.Hub` around another one."""

    hub: Hub
    household: Household
    known: Callable[[], Known]
    """The ledger's half hours and nights at hand."""
    monotonic: Callable[[], float]
    snapshot: Snapshot | None = None
    _asked: deque[tuple[str, Command, "Future[Answer]"]] = field(default_factory=deque)
    _taken: list[tuple[str, "Future[Answer]"]] = field(default_factory=list)
    _answered: list[tuple["Future[Answer]", Answer]] = field(default_factory=list)

    @property
    def warnings(self) -> Sequence[Fault]:
        """The hub's own."""
        return self.hub.warnings

    def ask(self, name: str, command: Command) -> "Future[Answer] | None":
        """Hand in a command from any thread; None where too many wait already."""
        if len(self._asked) >= MOST_WAITING:
            return None
        future: Future[Answer] = Future()
        self._asked.append((name, command, future))
        return future

    def waiting(self) -> bool:
        """Whether a command waits to be taken."""
        return bool(self._asked)

    def commands(self) -> Sequence[Command]:
        """The hub's commands, then the page's."""
        found = list(self.hub.commands())
        while self._asked:
            name, command, future = self._asked.popleft()
            if future.set_running_or_notify_cancel():  # not of somebody who has gone away meanwhile
                self._taken.append((name, future))
                found.append(command)
        return found

    def answer(self, answers: Sequence[Answer]) -> None:
        """Tell the hub; whoever asked on the page is told once there is something to see of it."""
        self.hub.answer(answers)
        left = list(answers)
        for name, future in reversed(self._taken):  # the page's commands came last
            found = next((answer for answer in reversed(left) if answer.command == name), None)
            if found is not None:
                left.remove(found)
            self._answered.append((future, found or Answer(name, True, "done")))
        self._taken.clear()

    def publish(self, decision: Decision, reading: Reading | None) -> None:
        """Tell the hub, and put it on the desk."""
        self.hub.publish(decision, reading)
        rows, nights = self.known()
        version = self.snapshot.version + 1 if self.snapshot else 1
        self.snapshot = Snapshot(version, self.monotonic(), decision, reading, self.household, rows, nights)
        for future, answer in self._answered:
            future.set_result(answer)
        self._answered.clear()


@dataclass(slots=True)
class Letterbox:
    """An inbox in which the page's commands arrive too (`plugd.ports.Inbox`)."""

    inbox: Inbox
    desk: Desk

    def pending(self) -> bool:
        """Whether anything waits to be taken."""
        return self.desk.waiting() or self.inbox.pending()

    def wait(self, timeout_s: float) -> None:
        """As the inbox. A command of the page wakes it."""
        if not self.desk.waiting():
            self.inbox.wait(timeout_s)

    def wake(self) -> None:
        """End a wait."""
        self.inbox.wake()

    def flush(self) -> None:
        """As the inbox."""
        self.inbox.flush()


State = Callable[[Decision, Reading | None, Household], dict[str, Any]]
"""The state document, the same one that the hub publishes."""
