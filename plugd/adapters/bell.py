"""Something to wait by, whoever rings: another thread, a signal handler, an alarm."""

import threading
from collections.abc import Callable


class Doorbell:
    """Something to wait by. A ring is kept for the next wait."""

    def __init__(self) -> None:
        self._news = threading.Condition()  # its lock is re-entrant: `wake` may run in a signal handler
        self._rung = False

    def wait_for(self, arrived: Callable[[], bool], timeout_s: float) -> None:
        """Until `arrived`, a ring, or the time is over."""
        with self._news:
            self._news.wait_for(lambda: arrived() or self._rung, timeout_s)
            self._rung = False

    def hold(self, arrived: Callable[[], bool], timeout_s: float) -> bool:
        """Until `arrived` or the time is over, whoever rings. Returns whether it has arrived."""
        with self._news:
            return self._news.wait_for(arrived, timeout_s)

    def look(self) -> None:
        """Something has changed: those who wait look again."""
        with self._news:
            self._news.notify_all()

    def wake(self) -> None:
        """End a wait, this one or the next."""
        with self._news:
            self._rung = True
            self._news.notify_all()


class Bell:
    """An inbox (`plugd.ports.Inbox`) that only rings. What it is the inbox of says what is pending."""

    def __init__(self, bell: Doorbell | None = None) -> None:
        """With a `bell` it is that one's rings that end a wait."""
        self._bell = bell or Doorbell()

    def pending(self) -> bool:
        """Nothing ever arrives."""
        return False

    def wait(self, timeout_s: float) -> None:
        """Until something is here, somebody rings, or the time is over."""
        self._bell.wait_for(self.pending, timeout_s)

    def wake(self) -> None:
        """End a wait, this one or the next."""
        self._bell.wake()

    def flush(self) -> None:
        """Nothing is under way."""
