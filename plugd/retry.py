"""When to try again something that failed."""

from dataclasses import dataclass
from datetime import datetime, timedelta


def waits(now: datetime, at: datetime, longest: timedelta) -> bool:
    """Whether to wait until `at`. What is farther ahead than the longest wait is from before the clock was set back."""
    return now < at <= now + longest


def _nth(delays_s: tuple[float, ...], failures: int) -> timedelta:
    """The pause after the n-th failure in a row."""
    return timedelta(seconds=delays_s[min(failures, len(delays_s)) - 1])


@dataclass(slots=True)
class Retry:
    """When to try again something that failed, or that was not there yet."""

    delays_s: tuple[float, ...]
    failures: int = 0
    at: datetime | None = None

    def failed(self, now: datetime, spread: float = 0.0) -> None:
        """It failed again; `spread` in 0..1 lengthens the pause by up to half, so that not all come at once."""
        self.failures += 1
        self.at = now + _nth(self.delays_s, self.failures) * (1.0 + 0.5 * spread)

    def later(self, now: datetime, delay: timedelta) -> None:
        """It has neither failed nor succeeded yet."""
        self.at = now + delay

    def succeeded(self) -> None:
        """It worked."""
        self.failures, self.at = 0, None

    def due(self, now: datetime) -> bool:
        """Whether it may be tried now."""
        return self.at is None or not waits(now, self.at, 1.5 * _nth(self.delays_s, self.failures))
