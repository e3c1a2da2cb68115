"""What stub plugs are made of, whatever they speak: a relay, a meter behind it, timers, mains that may fail."""

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Protocol
from zoneinfo import ZoneInfo

from plugd_hil.outlet import Load, Meter, Said

BOOT = timedelta(seconds=3)
"""From power to the broker."""
WILL_AFTER = timedelta(seconds=45)
"""A broker notices a silent client after one and a half keep-alives of 30 s."""
Does = Callable[[], list[Said]]


class Board(Protocol):
    """Relay, meter and time. `advance` it to now before anything else; calls return what the plug says."""

    jammed: bool
    """The relay does not move, whoever says so."""

    @property
    def on(self) -> bool:
        """The relay."""

    @property
    def now(self) -> datetime:
        """Up to when it has been advanced."""

    @property
    def total_kwh(self) -> float:
        """The meter, unrounded and never reset."""

    def due(self) -> datetime | None:
        """When it next does something by itself."""

    def advance(self, to: datetime) -> list[Said]:
        """Let time pass."""


class Plug(Protocol):
    """A stub plug as the program around it sees it: a state machine without I/O."""

    muted: bool
    """It says nothing any more, and hears nothing."""

    @property
    def board(self) -> Board:
        """What it switches and counts with."""

    @property
    def listens(self) -> tuple[str, ...]:
        """The topic filters it subscribes to."""

    @property
    def will(self) -> Said:
        """What the broker says when it is gone."""

    def connected(self) -> list[Said]:
        """The network lets it reach its broker again."""

    def handle(self, topic: str, payload: bytes) -> list[Said]:
        """A message on what it listens to."""

    def press(self) -> list[Said]:
        """A person presses the button."""

    def cut(self, length: timedelta = timedelta(seconds=5)) -> list[Said]:
        """The mains fail, and are back after `length`."""

    def load_changed(self) -> list[Said]:
        """A car has come or gone, or takes another power."""


class Socket:
    """Implements `Board`, with timers and mains for the plug around it."""

    def __init__(
        self, load: Load, now: datetime, power_kw: float = 2.3, on: bool = False, timezone: str = "Europe/London"
    ) -> None:
        """`power_kw`: what the socket offers. What is plugged in has been up for a day."""
        self.zone = ZoneInfo(timezone)
        self.meter = Meter(load, power_kw, self.zone, now)
        self.on = on
        self.jammed = False
        self.powered = True
        self.online = False
        self.booted = now - timedelta(days=1)
        self._saved_on = on
        self._timers: dict[Does, datetime] = {}

    @property
    def now(self) -> datetime:
        """Up to when it has been advanced."""
        return self.meter.now

    @property
    def total_kwh(self) -> float:
        """The meter, unrounded."""
        return self.meter.total_kwh

    def due(self) -> datetime | None:
        """When the next timer runs out."""
        return min(self._timers.values(), default=None)

    def advance(self, to: datetime) -> list[Said]:
        """Let time pass; timers that run out on the way do so in their order."""
        said: list[Said] = []
        while (due := self.due()) is not None and due <= to:
            self.meter.run(due, self.on)
            action = next(a for a, at in self._timers.items() if at == due)
            del self._timers[action]
            said += action()
        self.meter.run(to, self.on)
        return said

    def after(self, wait: timedelta | None, action: Does) -> None:
        """Start a timer anew, or stop it."""
        self._timers.pop(action, None)
        if wait is not None:
            self._timers[action] = self.now + wait

    def soon(self, wait: timedelta, action: Does) -> None:
        """Start a timer unless it runs."""
        if action not in self._timers:
            self.after(wait, action)

    def runs(self, action: Does) -> bool:
        """Whether that timer runs."""
        return action in self._timers

    def left(self, action: Does) -> timedelta:
        """Until that timer runs out; nothing where it does not run."""
        return self._timers.get(action, self.now) - self.now

    def switch(self, on: bool) -> bool:
        """Move the relay; returns whether it has moved."""
        moves = on is not self.on and not self.jammed and self.powered
        self.on = on if moves else self.on
        return moves

    def draws_kw(self) -> float:
        """What flows."""
        return self.meter.load.draws_kw(self.meter.power_kw) if self.on else 0.0

    def steady_until(self) -> datetime | None:
        """Until when that stays so; None where nothing will change by itself."""
        return self.meter.load.steady_until(self.now, self.meter.power_kw) if self.on else None

    def uptime_s(self) -> int:
        """Since it booted."""
        return int((self.now - self.booted).total_seconds())

    def cut(self, length: timedelta, booted: Does, will: Does, on_power: Callable[[bool], bool]) -> list[Said]:
        """The mains fail: `on_power(saved)` is the relay when they are back, `booted` runs once at the broker."""
        self._saved_on = self.on if self.powered else self._saved_on
        self.on = self.powered = self.online = False
        self._timers.clear()

        def powered() -> list[Said]:
            self.powered, self.booted = True, self.now
            self.on = on_power(self._saved_on)
            self.after(BOOT, booted)
            return []

        self.after(length, powered)
        self.after(min(WILL_AFTER, length + BOOT), will)
        return []
