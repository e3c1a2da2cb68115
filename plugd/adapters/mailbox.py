"""Where MQTT messages wait to be read: bounded, in order of arrival, and something to wait by."""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from plugd.adapters.bell import Doorbell

MAX_PAYLOAD_BYTES = 4 * 1024
"""What is looked at: nothing that plugd understands is longer."""
MAX_MESSAGES = 512
MAX_TOO_LONG = 64
"""How many topics of messages that were too long are remembered for whoever answers them."""


class Retained(Enum):
    """What a reader wants of retained messages; in MQTT 5's words (handling, as published, no local)."""

    FLAGGED = (2, True, False)
    """Not replayed; a live one is flagged. For commands, which must not be retained."""
    LIVE = (2, False, False)
    """Not replayed; what the broker kept (3.1.1 replays it) is flagged. For telemetry."""
    REPLAYED = (0, False, False)
    """Replayed, flagged; live ones are not. For last wills."""
    WATCHED = (0, True, True)
    """Replayed and live, both flagged, without what we publish ourselves."""


@dataclass(frozen=True, slots=True)
class Message:
    """What arrived. `retain`: it is, or was published as, the broker's kept copy."""

    topic: str
    payload: bytes
    retain: bool


class Line(Protocol):
    """What a mailbox needs of its connection."""

    bell: Doorbell

    def flush(self) -> None:
        """Return once all that was held for us is pending."""


class Mailbox:
    """The messages of some topic filters in order of arrival; when it is full the oldest go first.

    It is an inbox of its own (`plugd.ports.Inbox`), for waits that other mailboxes' messages must not end.
    """

    def __init__(self, line: Line, filters: dict[str, Retained]) -> None:
        self.filters = filters
        self.dropped = 0
        """How many messages were too long, or too many."""
        self._line = line
        self._messages: deque[Message] = deque()
        self._too_long: deque[str] = deque(maxlen=MAX_TOO_LONG)

    def put(self, message: Message) -> None:
        """Called by the network thread."""
        if len(message.payload) > MAX_PAYLOAD_BYTES:
            self.dropped += 1
            self._too_long.append(message.topic)
            return
        if len(self._messages) >= MAX_MESSAGES:
            self._messages.popleft()
            self.dropped += 1
        self._messages.append(message)

    def take(self) -> tuple[Message, ...]:
        """All that is here, oldest first."""
        taken = []
        while self._messages:
            taken.append(self._messages.popleft())
        return tuple(taken)

    def take_too_long(self) -> tuple[str, ...]:
        """The topics of messages that were dropped for their length since the last call. They end no wait."""
        taken = []
        while self._too_long:
            taken.append(self._too_long.popleft())
        return tuple(taken)

    def pending(self) -> bool:
        """Whether something is here."""
        return bool(self._messages)

    def wait(self, timeout_s: float) -> None:
        """Until something is here, somebody wakes us, the connection comes or goes, or the time is over."""
        self._line.bell.wait_for(self.pending, timeout_s)

    def wake(self) -> None:
        """End a wait."""
        self._line.bell.wake()

    def flush(self) -> None:
        """As the connection's."""
        self._line.flush()
