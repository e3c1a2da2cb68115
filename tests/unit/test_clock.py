"""The real clock: when a wait ends, in whose time, and what becomes of a broken scheduler."""

import logging
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest

from plugd.adapters import clock as clocks
from plugd.adapters.bell import Bell
from plugd.adapters.clock import SystemClock, utc_now
from plugd.errors import PlugdError
from plugd.units import next_slot

FAR = timedelta(days=1)
BEAT_S = 0.2
SOON_S = 5.0
"""Far longer than any of these waits, far shorter than a real beat."""


@pytest.fixture
def clock() -> Iterator[SystemClock]:
    made = SystemClock()
    yield made
    made.close()


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> Iterator[SystemClock]:
    """One with a short beat."""
    monkeypatch.setattr(clocks, "BEAT_S", BEAT_S)
    made = SystemClock()
    yield made
    made.close()


def took_s(clock: SystemClock, until: datetime, inbox: Bell | None = None) -> float:
    began_s = clock.monotonic()
    clock.wait(until, inbox)
    return clock.monotonic() - began_s


class Full(Bell):
    """An inbox in which something waits already."""

    def pending(self) -> bool:
        """There is."""
        return True


class Broken(Bell):
    """One that cannot be woken."""

    def wake(self) -> None:
        """Breaks whoever rings."""
        raise RuntimeError("the bell has no clapper")


class Interrupted(Bell):
    """One that is rung, as by a signal handler, by the thread that is about to wait and holds its lock."""

    def pending(self) -> bool:
        """Nothing but the ring."""
        self.wake()
        return False


class Cold(Bell):
    """One that tells when somebody has begun to wait."""

    def __init__(self) -> None:
        super().__init__()
        self.begun = threading.Event()

    def wait(self, timeout_s: float) -> None:
        """As the bell's."""
        self.begun.set()
        super().wait(timeout_s)


def test_it_tells_utc_and_seconds_that_grow(clock: SystemClock) -> None:
    assert clock.now().tzinfo is UTC
    assert abs(clock.now() - utc_now()) < timedelta(seconds=1)
    before_s = clock.monotonic()
    assert clock.monotonic() >= before_s


def test_a_wait_ends_when_the_inbox_is_woken(clock: SystemClock) -> None:
    inbox = Cold()

    def wake() -> None:
        inbox.begun.wait(SOON_S)
        inbox.wake()

    waker = threading.Thread(target=wake)
    waker.start()
    assert took_s(clock, clock.now() + FAR, inbox) < SOON_S
    waker.join()


def test_a_wake_before_the_wait_is_not_lost(clock: SystemClock) -> None:
    inbox = Bell()
    inbox.wake()
    assert took_s(clock, clock.now() + FAR, inbox) < SOON_S


def test_a_signal_handler_may_ring_whatever_it_has_interrupted(clock: SystemClock) -> None:
    began_s = clock.monotonic()
    Interrupted().wait(FAR.total_seconds())
    assert clock.monotonic() - began_s < SOON_S


def test_nobody_waits_with_something_in_the_inbox_or_for_the_past(clock: SystemClock) -> None:
    assert took_s(clock, clock.now() + FAR, Full()) < SOON_S
    assert took_s(clock, clock.now() - timedelta(seconds=1), Bell()) < SOON_S
    assert took_s(clock, clock.now() - FAR) < SOON_S


@pytest.mark.parametrize("inbox", [None, Bell()])
def test_a_wait_ends_at_its_moment(clock: SystemClock, inbox: Bell | None) -> None:
    for _ in range(3):  # each takes the alarm of the one before away
        until = clock.now() + timedelta(seconds=0.1)
        waited_s = took_s(clock, until, inbox)
        while clock.now() < until:  # spurious ends are allowed
            waited_s += took_s(clock, until, inbox)
        assert waited_s < SOON_S


def test_no_wait_is_longer_than_a_beat(quick: SystemClock) -> None:
    assert took_s(quick, quick.now() + FAR, Bell()) < SOON_S
    assert took_s(quick, quick.now() + FAR) < SOON_S


def test_the_beat_is_short_enough_for_the_guard() -> None:
    assert clocks.BEAT_S == 10


def test_a_wait_ends_where_the_scheduler_has_died(quick: SystemClock) -> None:
    quick._scheduler.pause()
    assert took_s(quick, quick.now() + FAR, Bell()) < SOON_S


def test_what_broke_the_scheduler_is_raised_to_who_waits(quick: SystemClock) -> None:
    quick.wait(quick.now() + FAR, Broken())
    with pytest.raises(PlugdError, match="the scheduler failed: the bell has no clapper") as raised:
        quick.wait(quick.now() + FAR, Bell())
    assert isinstance(raised.value.__cause__, RuntimeError)


@pytest.mark.parametrize("zone", ["Europe/London", "Asia/Kathmandu", "Australia/Lord_Howe"])
def test_half_hours_are_of_utc_wherever_the_machine_stands(monkeypatch: pytest.MonkeyPatch, zone: str) -> None:
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    clock = SystemClock()
    try:
        trigger = clock._scheduler.get_job("half_hour").trigger
        for now in (datetime(2023, 3, 26, 0, 59, 59, tzinfo=UTC), datetime(2023, 10, 29, 1, 10, tzinfo=UTC)):
            assert trigger.get_next_fire_time(None, now) == next_slot(now)
        assert str(clock._scheduler.timezone) == "UTC"
    finally:
        clock.close()
        monkeypatch.undo()
        time.tzset()


def test_rings_that_were_missed_become_one(clock: SystemClock) -> None:
    for job in clock._scheduler.get_jobs():
        assert job.coalesce
        assert job.misfire_grace_time is None  # however late: a laptop's lid was closed
        assert job.max_instances == 1


def test_after_the_end_no_thread_is_left() -> None:
    before = threading.active_count()
    clock = SystemClock()
    worker = clock._scheduler._thread
    clock.close()
    worker.join(SOON_S)
    assert threading.active_count() <= before + 1  # the idle worker of the pool ends with the process


def test_closing_while_an_alarm_rings_is_quiet(caplog: pytest.LogCaptureFixture) -> None:
    for early_s in (0.0, 0.0005, 0.001, 0.0015, 0.002) * 40:
        clock = SystemClock()
        woken = Bell()
        woken.wake()
        clock.wait(clock.now() + timedelta(seconds=0.001 + early_s), woken)
        clock.close()
    assert [record.message for record in caplog.records if record.levelno >= logging.ERROR] == []
