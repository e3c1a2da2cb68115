"""The real clock: APScheduler rings, whoever waits looks again."""

import time
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

from apscheduler.events import EVENT_JOB_ERROR, JobExecutionEvent
from apscheduler.executors.pool import ThreadPoolExecutor
from apscheduler.jobstores.base import JobLookupError
from apscheduler.schedulers.background import BackgroundScheduler
from apscheduler.triggers.cron import CronTrigger
from apscheduler.triggers.date import DateTrigger
from apscheduler.triggers.interval import IntervalTrigger

from plugd.adapters.bell import Bell
from plugd.errors import PlugdError
from plugd.ports import Inbox
from plugd.wall import PATIENCE_S

BEAT_S = 10
"""No wait lasts longer: wall time may step under a sleeper, and the guard looks this often."""


TOLD = Path("/run/systemd/timesync/synchronized")
"""Touched by systemd-timesyncd whenever it has heard the time: systemd-timesyncd.service(8)."""


def unset(told: Path = TOLD) -> bool:
    """Whether nobody has told this machine the time since it was switched on, as far as systemd-timesyncd knows.

    A clock without a battery then shows when the machine was switched off. Who keeps the time otherwise is believed,
    and after a day whatever it shows.
    """
    return told.parent.is_dir() and not told.exists() and time.monotonic() < PATIENCE_S


def utc_now() -> datetime:
    """Wall time of this machine, aware UTC."""
    return datetime.now(UTC)


class SystemClock:
    """Wall and monotonic time of this machine. Rings at every half hour, every 10 s, and when asked."""

    def __init__(self) -> None:
        self._bell = Bell()
        self._waiting: Inbox = self._bell
        self._broken: BaseException | None = None
        self._scheduler = BackgroundScheduler(
            timezone=UTC,
            executors={"default": ThreadPoolExecutor(1)},
            job_defaults={"coalesce": True, "misfire_grace_time": None, "max_instances": 1},
        )
        self._scheduler.add_listener(self._job_failed, EVENT_JOB_ERROR)
        self._scheduler.add_job(self._ring, CronTrigger(minute="0,30", timezone=UTC), id="half_hour")
        self._scheduler.add_job(self._ring, IntervalTrigger(seconds=BEAT_S, timezone=UTC), id="beat")
        self._scheduler.start()

    def now(self) -> datetime:
        """Aware UTC."""
        return utc_now()

    def monotonic(self) -> float:
        """Seconds that only grow."""
        return time.monotonic()

    def wait(self, until: datetime, woken_by: Inbox | None = None) -> None:
        """At most one beat, less when something arrives or `until` comes. Raises what broke the scheduler."""
        if self._broken is not None:
            raise PlugdError(f"the scheduler failed: {self._broken}") from self._broken
        inbox = woken_by or self._bell
        left_s = (until - self.now()).total_seconds()
        if left_s <= 0.0 or inbox.pending():
            return
        self._waiting = inbox
        if left_s < BEAT_S:
            due = DateTrigger(self.now() + timedelta(seconds=left_s), timezone=UTC)
            self._scheduler.add_job(self._ring, due, id="due", replace_existing=True)
        # The alarms end the wait; the time-out is for the day the scheduler's thread has died.
        inbox.wait(2.0 * BEAT_S)
        self._waiting = self._bell

    def close(self) -> None:
        """Stop ringing."""
        self._scheduler.pause()  # a one-shot alarm that rings now would look for itself in a stopped scheduler
        with suppress(JobLookupError):
            self._scheduler.remove_job("due")
        self._scheduler.shutdown(wait=False)

    def _ring(self) -> None:
        self._waiting.wake()

    def _job_failed(self, event: JobExecutionEvent) -> None:
        self._broken = event.exception
        self._waiting.wake()
