"""The CAN bus, through python-can: opened again when it fails, read in bounded gulps, never waited for.

python-can's own periodic tasks are not used: on socketcan the kernel runs them, and would go on telling the charger
to charge after plugd has hung.
"""

import errno
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import can
from can.interfaces.slcan import slcanBus

from plugd.adapters.bell import Bell
from plugd.ports import Clock

MOST_FRAMES = 200
"""Read at once. A bus that brings more a second is babbling; what is left is read the next time, or lost."""
MOST_ERRORS = 20
"""Unreadable frames at once that are noise; more are a bus that does not work."""
NOTHINGS = 4
"""A serial adapter confirms every command on a line of its own, which python-can takes for nothing to read."""
REOPEN_S = (1.0, 2.0, 5.0, 15.0, 60.0)
DEAD_S = 300.0
"""After so long without a single frame the bus is opened anew: an adapter may have been replugged."""
SEND_S = 0.2
FLUSH_S = 1.0
BUS_OFF, RESTARTED = 0x40, 0x100
"""Bits of an error frame's identifier (linux/can/error.h)."""
_BROKEN = (can.CanError, OSError, ValueError, IndexError)
"""What python-can raises for a bus that fails and for bytes that are no frame."""
ADVICE = {
    errno.ENOBUFS: "nobody on the bus acknowledges; is the charger on, is the bitrate its own, are wires right?",
    errno.ENETDOWN: "the interface is down: ip link set {channel} up type can bitrate {bitrate} restart-ms 100",
    errno.ENODEV: "there is no such interface; ip link shows which there are",
}


@dataclass(frozen=True, slots=True)
class Place:
    """Which bus, in python-can's words. For udp_multicast the channel is GROUP or GROUP:PORT."""

    interface: str
    channel: str
    bitrate: int
    settle_s: float = 2.0
    """Some serial adapters restart when they are opened, and need this before they listen."""


def open_bus(place: Place, identifiers: tuple[tuple[int, bool], ...]) -> can.BusABC:
    """The bus. `identifiers` (id, extended) are all that is asked of a kernel that can choose."""
    more: dict[str, Any] = {}
    channel = place.channel
    match place.interface:
        case "socketcan":
            more["can_filters"] = [
                {"can_id": number, "can_mask": 0x1FFFFFFF if extended else 0x7FF, "extended": extended}
                for number, extended in identifiers
            ]
        case "slcan":
            more = {"bitrate": place.bitrate, "sleep_after_open": place.settle_s, "timeout": 0.0}
        case "udp_multicast":
            channel, _, port = channel.partition(":")
            more = {"hop_limit": 0, "fd": False, **({"port": int(port)} if port else {})}
    return can.Bus(interface=place.interface, channel=channel, **more)


class CanLink(Bell):
    """Frames in and out. A `plugd.ports.Inbox` that no frame wakes: they are looked at once a second."""

    def __init__(
        self,
        place: Place,
        clock: Clock,
        identifiers: tuple[tuple[int, bool], ...],
        opener: Callable[[Place, tuple[tuple[int, bool], ...]], can.BusABC] = open_bus,
    ) -> None:
        super().__init__()
        self._place = place
        self._clock = clock
        self._identifiers = identifiers
        self._open = opener
        self._bus: can.BusABC | None = None
        self._failures = 0
        self._again_s = float("-inf")
        self._heard_s = 0.0
        self._unflushed = False
        self.trouble = ""
        """What is wrong with the bus, in words; empty where nothing is known to be."""
        self.babbling = False
        """At the last look there was more to read than is read."""
        self.garbled = 0
        """How many times something was read that is no frame."""

    # -- frames -----------------------------------------------------------------------------------

    def hear(self) -> tuple[can.Message, ...]:
        """All that has arrived, at most `MOST_FRAMES`."""
        if not self._ready():
            return ()
        heard: list[can.Message] = []
        errors, nothing = 0, NOTHINGS if isinstance(self._bus, slcanBus) else 1
        while nothing and len(heard) < MOST_FRAMES and errors < MOST_ERRORS and self._bus is not None:
            try:
                message = self._bus.recv(timeout=0)
            except _BROKEN as error:
                errors += 1
                self._unreadable(error)
                if errors >= MOST_ERRORS:
                    self._lost(error)
                continue
            if message is None:
                nothing -= 1
            else:
                heard.append(message)
        self.babbling = len(heard) >= MOST_FRAMES
        self._judge(heard)
        return tuple(m for m in heard if not m.is_error_frame)

    def say(self, message: can.Message) -> bool:
        """Send one frame; False where it did not go out, and then it is not kept."""
        if not self._ready() or self._bus is None:
            return False
        try:
            self._bus.send(message, timeout=SEND_S)
        except _BROKEN as error:
            if _number(error) == errno.ENOBUFS:  # the queue is full: the bus is there, and nobody listens
                self.trouble = self._told(error)
            else:
                self._lost(error)
            return False
        self._unflushed = True
        return True

    def _judge(self, heard: list[can.Message]) -> None:
        """What frames, or their absence, say of the bus."""
        now_s = self._clock.monotonic()
        for message in heard:
            if message.is_error_frame and message.arbitration_id & BUS_OFF:
                self.trouble = "bus off: too many errors; look at wires, termination and bitrate, and set restart-ms"
            elif not message.is_error_frame or message.arbitration_id & RESTARTED:
                self.trouble, self._failures = "", 0
        if heard:
            self._heard_s = now_s
        elif now_s - self._heard_s > DEAD_S and self._bus is not None:
            self._shut()

    # -- the bus ----------------------------------------------------------------------------------

    def _ready(self) -> bool:
        """Whether there is a bus; one that failed is opened again after a pause."""
        if self._bus is not None:
            return True
        now_s = self._clock.monotonic()
        if now_s < self._again_s:
            return False
        try:
            self._bus = self._open(self._place, self._identifiers)
        except _BROKEN as error:
            self._lost(error)
            return False
        self._heard_s = now_s
        return True

    def _unreadable(self, error: Exception) -> None:
        self.garbled += 1
        if isinstance(self._bus, slcanBus):  # what it could not read stays in its way
            with suppress(*_BROKEN):
                self._bus.flush()

    def _lost(self, error: Exception) -> None:
        """Close, and try again after a pause that grows."""
        self._failures += 1
        self._again_s = self._clock.monotonic() + REOPEN_S[min(self._failures, len(REOPEN_S)) - 1]
        self.trouble = self._told(error)
        self._shut()

    def _shut(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with suppress(*_BROKEN):
                bus.shutdown()

    def _told(self, error: Exception) -> str:
        """An error in one line, with what to do where that is known."""
        number = _number(error)
        place = self._place
        said = " ".join(str(error).split())[:160]
        advice = ADVICE.get(number or 0, said).format(channel=place.channel, bitrate=place.bitrate)
        return f"{place.interface} {place.channel}: {advice}"

    def flush(self) -> None:
        """Ask a serial adapter something: it answers after it has taken all that was sent. Others have no such word."""
        if self._unflushed and isinstance(self._bus, slcanBus):
            with suppress(*_BROKEN):
                self._bus.get_version(FLUSH_S)
        self._unflushed = False

    def close(self) -> None:
        """Leave the bus."""
        self._again_s = float("inf")
        self._shut()


def _number(error: BaseException | None) -> int | None:
    """The errno behind an error of python-can's."""
    while error is not None:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if isinstance(number, int):
            return number
        error = error.__cause__ or error.__context__
    return None
