"""Whether the wall clock can be believed, and how far it has jumped beside the clock that only counts. Pure.

A machine without a battery for its clock starts in 1970, or where it was switched off, until the network tells it the
time. Until then plugd lives on its own time: from the newest moment it knows of, by the monotonic clock. The true one
may be hours ahead of that, so nothing is put off by it.
"""

from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

from plugd.domain import Fault, Memory, Relay, Setpoint, Wanted

BUILT = datetime(2020, 1, 1, tzinfo=UTC)
"""No plugd ran before."""
TOLERANCE = timedelta(hours=2)
"""A clock no further behind what was stored than this is one that somebody has corrected."""
STEP = timedelta(seconds=30)
"""A jump by more is a step."""
HOLD_S = 600.0
"""Without a clock the relay stays as it is for so long, and then charges."""
PATIENCE_S = 24 * 3600.0
"""A clock that nobody has corrected by then is believed: what was stored is from one that ran ahead."""
LONGEST_OFF = timedelta(days=7)
"""A clock that is put forward by more than that has not stood still while the machine was off: it is wrong now."""
NONE = timedelta(0)


@dataclass(slots=True)
class Wall:
    """The clock as it is believed. `look` at every step, before anything else."""

    known: datetime = BUILT
    """The newest moment in what was stored."""
    jumped: timedelta = NONE
    """How far it has stepped since the last look."""
    _doubted_s: float | None = None
    """Since when it is not believed, by the monotonic clock."""
    _last: tuple[datetime, float] | None = None
    """What it showed at the last look, and the monotonic clock."""
    _own: tuple[datetime, float] = (BUILT, 0.0)
    """A moment of one's own time, and the monotonic clock then."""

    @property
    def believed(self) -> bool:
        """Whether it is."""
        return self._doubted_s is None

    def look(self, shown: datetime, now_s: float, unset: bool = False) -> datetime:
        """The time now: what is shown where that can be, else one's own.

        `unset`: nobody has told this machine the time since it was switched on.
        """
        last, self._last = self._last, (shown, now_s)
        step = NONE if last is None else shown - last[0] - timedelta(seconds=now_s - last[1])
        step = step if abs(step) > STEP else NONE
        if self._doubted_s is not None:
            return self._in_doubt(shown, now_s, stepped=step != NONE, unset=unset)
        unset = unset and last is None  # what was believed once has been told
        if shown >= (self.known - TOLERANCE if last is None else BUILT) and not unset:
            self.jumped = step
            return shown
        self._own = (max(self.known, shown), now_s) if last is None else last
        self._doubted_s, self.jumped = now_s, NONE
        return self._own[0] + timedelta(seconds=now_s - self._own[1])

    def _in_doubt(self, shown: datetime, now_s: float, stepped: bool, unset: bool) -> datetime:
        """One's own time, until the clock is set, has caught up, or has not been corrected for a day."""
        own = self._own[0] + timedelta(seconds=now_s - self._own[1])
        waited_s = now_s - (self._doubted_s or 0.0)
        set_right = not unset and shown >= BUILT and (stepped or shown >= self.known - TOLERANCE)
        if not (set_right or waited_s >= PATIENCE_S):
            return own
        self._doubted_s = None
        self.jumped = shown - own if own - shown > STEP else NONE  # forward, time has just passed
        return shown

    def wanted(self, wanted: Wanted, relay_on: bool | None, now_s: float, most_kw: float) -> Wanted:
        """What the plug is told without a clock, in place of what plan and guard say: nobody knows how late it is."""
        holds = self._doubted_s is not None and now_s - self._doubted_s < HOLD_S
        if isinstance(wanted, Setpoint):
            return wanted if holds else replace(wanted, power_kw=most_kw)
        return Relay(bool(relay_on)) if holds else Relay(True)

    def faults(self) -> tuple[Fault, ...]:
        """What is said of it."""
        if self.believed:
            return ()
        shown = self._last[0] if self._last else BUILT
        text = f"the clock is not set: it shows {shown:%Y-%m-%d %H:%M}; plugd charges until it is, and enters nothing"
        return (Fault("clock", f"{text}; check the network, and timedatectl"),)


def newest(memory: Memory) -> datetime:
    """The last moment that this memory knows of."""
    made_at = memory.plan.made_at if memory.plan else None
    return max(m for m in (BUILT, made_at, memory.soc.metered_at, memory.soc.told_at) if m is not None)


def shifted(memory: Memory, by: timedelta, began: datetime) -> Memory:
    """Memory after a step of the clock: what was so long ago is still so long ago. The plan is to be made anew.

    A clock may have stood still while the machine was off, and is put forward only now: what is from before this run,
    which `began` then by the clock as it is now, was right and stays.
    """
    since = began if NONE < by <= LONGEST_OFF else datetime.min.replace(tzinfo=UTC)
    moved: Memory = _moved(replace(memory, plan=None, orders=None), by, since)
    return moved


def _moved(value: Any, by: timedelta, since: datetime) -> Any:
    """The same with every moment in it moved that is not before `since` then."""
    if isinstance(value, datetime):
        return value + by if value + by >= since else value
    if isinstance(value, tuple):
        return tuple(_moved(one, by, since) for one in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{f.name: _moved(getattr(value, f.name), by, since) for f in fields(value) if f.init})
    return value
