"""Simulated time: turns, jumps, and the same order every time."""

import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta

import pytest

from plugd_hil.conductor import Conductor, Line, Participant

START = datetime(2023, 1, 2, 12, tzinfo=UTC)
SECOND = timedelta(seconds=1)


class Box:
    """An inbox that others put things into; sent is arrived at once."""

    def __init__(self) -> None:
        self.items: deque[str] = deque()

    def pending(self) -> bool:
        return bool(self.items)

    def wait(self, timeout_s: float) -> None:
        raise AssertionError("nobody waits in simulated time")

    def wake(self) -> None:
        """Nobody waits."""

    def flush(self) -> None:
        """Nothing is under way."""


def joins(conductor: Conductor, name: str, live: Callable[[Participant], None]) -> None:
    """A participant in a thread of its own, until it has lived or the conductor closes."""

    def run() -> None:
        clock = Participant("127.0.0.1", conductor.port, name)
        with suppress(ConnectionError):
            live(clock)
        clock.close()

    threading.Thread(target=run, daemon=True).start()


def test_time_jumps_to_the_earliest_due_and_messages_are_seen_at_their_moment() -> None:
    log: list[tuple[str, int]] = []
    to_b = Box()
    conductor = Conductor(START, ("a", "b"))

    def seconds(clock: Participant) -> int:
        return int((clock.now() - START) / SECOND)

    def a(clock: Participant) -> None:
        while seconds(clock) < 100:
            clock.wait(clock.now() + 40 * SECOND)
            log.append(("a", seconds(clock)))
            to_b.items.append("ring")
        clock.wait(START + timedelta(days=9))

    def b(clock: Participant) -> None:
        while True:
            clock.wait(START + 90 * SECOND if seconds(clock) < 90 else START + timedelta(days=9), to_b)
            log.append(("b " + ",".join(to_b.items), seconds(clock)))
            to_b.items.clear()

    joins(conductor, "a", a)
    joins(conductor, "b", b)
    conductor.gather()
    conductor.run_until(START + 200 * SECOND)
    conductor.close()
    assert log == [("a", 40), ("b ring", 40), ("a", 80), ("b ring", 80), ("b ", 90), ("a", 120), ("b ring", 120)]


def test_the_time_can_be_asked_without_taking_part() -> None:
    conductor = Conductor(START, ())
    line = Line(socket.create_connection(("127.0.0.1", conductor.port)))
    line.send(ask="now")
    assert line.receive() == {"now": START.isoformat()}
    conductor.now += SECOND
    line.send(ask="now")
    assert line.receive() == {"now": (START + SECOND).isoformat()}
    line.close()
    conductor.close()


def test_a_participant_that_dies_is_named_and_nobody_waits_for_it() -> None:
    conductor = Conductor(START, ("brief",))
    joins(conductor, "brief", lambda clock: clock.wait(START + SECOND))
    conductor.gather()
    with pytest.raises(ConnectionError, match="brief"):
        conductor.run_until(START + timedelta(hours=1))
    conductor.close()


def test_who_did_not_come_is_named() -> None:
    conductor = Conductor(START, ("late",))
    with pytest.raises(TimeoutError, match="late"):
        conductor.gather(patience_s=0.05)
    conductor.close()
