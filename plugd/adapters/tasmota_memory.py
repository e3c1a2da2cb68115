"""What a Tasmota plug has told so far, and who moved its relay. No I/O.

Intervals are reckoned in monotonic seconds, so that a step of the wall clock does no harm.
"""

import math
from dataclasses import dataclass
from datetime import datetime

from plugd.adapters.tasmota_words import Heard
from plugd.domain import Reading

FRESH_S = 60.0
ORDER_LIVES_S = 60.0
"""An order may be obeyed this long after we have given up waiting for it."""
REBOOT_S = 60.0
"""The moment of booting, as reckoned from the uptime, may wander by this much between two messages."""
DAWN = -math.inf


@dataclass(slots=True)
class PlugMemory:
    """The plug as it has told itself. Grows stale with time, and at once when it or we were away."""

    dead_man_s: float
    nonsense: int = 0
    """How many values could not be."""
    on: bool | None = None
    on_at: datetime | None = None
    on_s: float = DAWN
    power_kw: float | None = None
    energy_kwh: float | None = None
    metered_at: datetime | None = None
    metered_s: float = DAWN
    uptime_s: float | None = None
    booted_s: float = DAWN
    power_on_state: int | None = None
    pulse: int | None = None
    answers: int = 0
    """How often it has told its relay's state in answer to a command."""
    ordered: tuple[bool, float] | None = None
    """The last order not yet seen to be obeyed, and when it was given."""
    held: bool = False
    """Off without a timer: nothing but a person switches it on."""
    off_sent_s: float = DAWN
    off_s: float = DAWN
    """When the last OFF that it has confirmed was sent."""
    moved: bool | None = None
    came_back: bool = False
    unsettled: bool = False
    """It was away, and whether it has booted since is not known yet."""

    def back(self) -> None:
        """It, or we, were away: nothing of before is believed until it is asked."""
        self.came_back = self.unsettled = True
        self.on_s = self.metered_s = DAWN
        self.power_on_state = self.pulse = None

    def order(self, on: bool, now_s: float) -> None:
        """We tell it to switch."""
        self.ordered = (on, now_s)
        if not on:
            self.off_sent_s = now_s

    def absorb(self, heard: Heard, answer: bool, now: datetime, now_s: float) -> None:
        """It has said something; `answer`: in answer to a command."""
        self.nonsense += heard.nonsense
        if heard.power_on_state is not None:
            self.power_on_state = heard.power_on_state
        if heard.pulse is not None:
            self.pulse = heard.pulse
        if heard.on is not None:
            self._who_moved_it(heard.on, now_s)
        if heard.uptime_s is not None:
            self._settle(heard.uptime_s, now_s)
        if heard.on is not None:
            self.on, self.on_at, self.on_s = heard.on, now, now_s
            self.answers += int(answer)
            if answer and not heard.on:
                self.off_s = self.off_sent_s
        if heard.metered:
            self.power_kw = heard.power_kw
            self.energy_kwh = self.energy_kwh if heard.energy_kwh is None else heard.energy_kwh
            self.metered_at, self.metered_s = now, now_s

    def _who_moved_it(self, on: bool, now_s: float) -> None:
        """We, the timer, or somebody else."""
        mine = self.ordered is not None and self.ordered[0] is on and now_s - self.ordered[1] <= ORDER_LIVES_S
        if mine:
            self.ordered = None
        if self.on is None or self.on is on:
            return
        self.power_kw = None  # measured before
        if not mine and not (on and self._timer_ran_out(now_s)):
            self.moved = on

    def _timer_ran_out(self, now_s: float) -> bool:
        """Whether no OFF has reached it for the dead-man's time: then the timer has switched it on."""
        return not self.held and now_s - self.off_s >= self.dead_man_s - min(5.0, 0.1 * self.dead_man_s)

    def _settle(self, uptime_s: float, now_s: float) -> None:
        """Its uptime tells a power cut from a lost connection."""
        booted_s = now_s - uptime_s
        if self.uptime_s is not None and (uptime_s < self.uptime_s or booted_s > self.booted_s + REBOOT_S):
            self.came_back = True
            self.power_on_state = self.pulse = None
            self.moved = None  # the power cut has moved it
        self.unsettled = False
        self.uptime_s, self.booted_s = uptime_s, booted_s

    def known(self) -> bool:
        """Whether it has told how its timer is set."""
        return self.power_on_state is not None and self.pulse is not None

    def fresh(self, now_s: float) -> bool:
        """Whether relay and meter were told within the last minute."""
        return not self.unsettled and now_s - min(self.on_s, self.metered_s) <= FRESH_S

    def reading(self, now_s: float) -> Reading | None:
        """The reading, each event in it once. None where the relay's state is not known, or too old."""
        if self.on is None or self.on_at is None or now_s - self.on_s > FRESH_S:
            return None
        if self.unsettled:  # it does not tell its uptime: a power cut, as far as we know
            self.unsettled, self.moved = False, None
        reading = Reading(
            at=self.on_at,
            on=self.on,
            power_kw=self.power_kw if now_s - self.metered_s <= FRESH_S else None,
            energy_kwh=self.energy_kwh,
            metered_at=self.metered_at,
            changed_by_other=self.moved,
            came_back=self.came_back,
        )
        self.moved, self.came_back = None, False
        return reading
