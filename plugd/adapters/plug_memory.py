"""What a plug has told so far, and who moved its relay. No I/O.

Intervals are reckoned in monotonic seconds, so that a step of the wall clock does no harm.
"""

import math
from dataclasses import dataclass
from datetime import datetime

from plugd.adapters.plug_words import Heard
from plugd.domain import Reading, Relay

FRESH_S = 60.0
ORDER_LIVES_S = 60.0
"""An order may be obeyed this long after we have given up waiting for it."""
REBOOT_S = 60.0
"""The moment of booting, as reckoned from the uptime, may wander by this much between two messages."""
RENEWALS = 6
"""OFF is sent this many times in the dead-man's time; five times as often while it stays unanswered."""
LEAST_TIMER_S = 1.0
TRIFLE_S = 1e-3
"""What is due is done so much early: moments have whole microseconds, seconds do not."""
OVERHEARD_S = 10.0
"""A relay that moves so soon after somebody's command has obeyed it."""
COOL_S = 600.0
"""A plug that has switched itself off for protection is not switched on again before this."""
DAWN = -math.inf


@dataclass(slots=True)
class PlugMemory:
    """The plug as it has told itself. Grows stale with time, and at once when it or we were away."""

    dead_man_s: float | None
    """After how long of our silence its timer switches it on; None where it has none."""
    tells_uptime: bool = True
    """Whether it says how long it has been up: else every absence is a power cut, as far as we know."""
    nonsense: int = 0
    """How many values could not be."""
    nonsense_run: int = 0
    """How many words of the meter in a row had one."""
    on: bool | None = None
    on_at: datetime | None = None
    on_s: float = DAWN
    power_kw: float | None = None
    current_a: float | None = None
    """Told with the power, or not at all."""
    power_s: float = DAWN
    energy_kwh: float | None = None
    metered_at: datetime | None = None
    metered_s: float = DAWN
    uptime_s: float | None = None
    booted_s: float = DAWN
    boots: int = 0
    """How often its uptime has begun anew."""
    timer: bool | None = None
    """Whether its own timer runs, as last told."""
    answers: int = 0
    """How often it has told its relay's state in answer to a command."""
    refusal: str | None = None
    """What it last said to an order that it does not obey."""
    errors: tuple[str, ...] = ()
    """Why it has switched itself off."""
    tripped_s: float = DAWN
    ordered: tuple[bool, float] | None = None
    """The last order not yet seen to be obeyed, and when it was given."""
    held: bool = False
    """Off without a timer: nothing but a person switches it on."""
    on_by_s: float = -DAWN
    """By when the timer of an off has to be over."""
    off_sent_s: float = DAWN
    off_s: float = DAWN
    """When the last OFF that it has confirmed was sent."""
    moved: bool | None = None
    moved_over: str = ""
    """The topic on which somebody else was heard to order that."""
    overheard: tuple[str, float] = ("", DAWN)
    """A command of somebody else's: its topic, and when."""
    came_back: bool = False
    unsettled: bool = False
    """It was away, and whether it has booted since is not known yet."""

    def back(self) -> None:
        """It, or we, were away: nothing of before is believed until it is asked."""
        self.came_back = True
        self.timer = None
        if self.tells_uptime:
            self.unsettled = True
        else:
            self.on = self.moved = None
        self.stale()

    def stale(self) -> None:
        """What it last told is not believed any more."""
        self.on_s = self.power_s = self.metered_s = DAWN

    def alive(self, now: datetime, now_s: float) -> None:
        """A plug that tells every change of its relay has said something else: the relay is as it was."""
        if self.on is not None and self.on_s > DAWN:
            self.on_at, self.on_s = now, now_s

    def order(self, on: bool, now_s: float) -> None:
        """We tell it to switch."""
        self.ordered, self.refusal = (on, now_s), None
        if not on:
            self.off_sent_s = now_s

    def absorb(self, heard: Heard, now: datetime, now_s: float) -> None:
        """It has said something."""
        self.nonsense += heard.nonsense
        if heard.errors is not None:
            self.tripped_s = now_s if heard.errors and not self.errors else self.tripped_s
            self.errors = heard.errors
        if heard.refusal is not None:
            self.refusal = heard.refusal
        if heard.on is not None:
            self._who_moved_it(heard.on, heard.by_timer, now_s)
        if heard.uptime_s is not None:
            self._settle(heard.uptime_s, now_s)
        if heard.on is not None:
            self.on, self.on_at, self.on_s = heard.on, now, now_s
            self.answers += int(heard.answer)
            if heard.answer and not heard.on:
                self.off_s = self.off_sent_s
        if heard.timer is not None:
            self.timer = heard.timer
        if heard.metered:
            self._meter(heard, now, now_s)

    def _meter(self, heard: Heard, now: datetime, now_s: float) -> None:
        """Power alone does not make the total newer: what flowed is reckoned between two totals."""
        if heard.nonsense or heard.power_kw is not None or not heard.partial:
            self.nonsense_run = self.nonsense_run + 1 if heard.nonsense else 0
        if heard.power_kw is not None or heard.nonsense or not heard.partial:
            self.power_kw, self.current_a, self.power_s = heard.power_kw, heard.current_a, now_s
        if heard.energy_kwh is not None or not heard.partial:
            self.energy_kwh = self.energy_kwh if heard.energy_kwh is None else heard.energy_kwh
            self.metered_at, self.metered_s = now, now_s

    def _who_moved_it(self, on: bool, by_timer: bool, now_s: float) -> None:
        """We, the timer, its protection, or somebody else."""
        mine = self.ordered is not None and self.ordered[0] is on and now_s - self.ordered[1] <= ORDER_LIVES_S
        if mine:
            self.ordered = None
        if self.on is None or self.on is on:
            return
        self.power_kw = self.current_a = None  # measured before
        itself = self._timer_ran_out(by_timer, now_s) if on else bool(self.errors)
        if not mine and not itself:
            self.moved = on
            topic, at_s = self.overheard
            self.moved_over = topic if now_s - at_s <= OVERHEARD_S else ""

    def _timer_ran_out(self, by_timer: bool, now_s: float) -> bool:
        """Whether no OFF has reached it for the dead-man's time: then the timer has switched it on."""
        if self.dead_man_s is None:
            return False
        slack_s = min(5.0, 0.1 * self.dead_man_s)
        return not self.held and (by_timer or now_s - self.off_s >= self.dead_man_s - slack_s)

    def _settle(self, uptime_s: float, now_s: float) -> None:
        """Its uptime tells a power cut from a lost connection."""
        booted_s = now_s - uptime_s
        if self.uptime_s is not None and (uptime_s < self.uptime_s or booted_s > self.booted_s + REBOOT_S):
            self.came_back = True
            self.boots += 1
            self.timer = None
            self.moved = None  # the power cut has moved it
        self.unsettled = False
        self.uptime_s, self.booted_s = uptime_s, booted_s

    def protects(self, now_s: float) -> bool:
        """Whether it has just switched itself off, and is not to be switched on yet."""
        return now_s - self.tripped_s < COOL_S

    def renewal_s(self, wanted: Relay | None) -> float:
        """When to repeat OFF; never where it is on (the next decision acts) or off on a person's word."""
        if self.dead_man_s is None or wanted is None or wanted.on or wanted.held or self.on is not False:
            return -DAWN
        share = RENEWALS if self.off_s >= self.off_sent_s else 5 * RENEWALS
        return self.off_sent_s + self.dead_man_s / share

    def last_renewal_s(self, wanted: Relay | None) -> float:
        """As `renewal_s`, where every off runs for the whole dead-man's time: the last one is sent so long before
        `on_by_s`, and the timer then left to run. Who lives on switches on by that time anyway."""
        due_s = self.renewal_s(wanted)
        last_s = self.on_by_s - (self.dead_man_s or 0.0)
        if due_s <= last_s:
            return due_s
        return last_s if self.off_sent_s < last_s - TRIFLE_S else -DAWN

    def promise(self, wanted: Relay, now: datetime, now_s: float) -> None:
        """By when the timer of this off has to be over, in monotonic seconds."""
        self.on_by_s = -DAWN if wanted.on_by is None else now_s + (wanted.on_by - now).total_seconds()

    def timer_s(self, now_s: float) -> float | None:
        """The time to give the timer of an off sent now, where each may have its own."""
        return None if self.dead_man_s is None else min(self.dead_man_s, max(self.on_by_s - now_s, LEAST_TIMER_S))

    def fresh(self, now_s: float, meter: bool = True) -> bool:
        """Whether relay, and meter where there is one, were told within the last minute."""
        told_s = min(self.on_s, self.metered_s) if meter else self.on_s
        return not self.unsettled and now_s - told_s <= FRESH_S

    def reading(self, now_s: float) -> Reading | None:
        """The reading, each event in it once. None where the relay's state is not known, or too old."""
        if self.on is None or self.on_at is None or now_s - self.on_s > FRESH_S:
            return None
        if self.unsettled:  # it does not tell its uptime: a power cut, as far as we know
            self.unsettled, self.moved = False, None
        reading = Reading(
            at=self.on_at,
            on=self.on,
            power_kw=self.power_kw if now_s - self.power_s <= FRESH_S else None,
            energy_kwh=self.energy_kwh,
            metered_at=self.metered_at,
            changed_by_other=self.moved,
            came_back=self.came_back,
            current_a=self.current_a if now_s - self.power_s <= FRESH_S else None,
            changed_over=self.moved_over if self.moved is not None else "",
            nonsense=self.nonsense_run > 1,
        )
        self.moved, self.came_back = None, False
        return reading
