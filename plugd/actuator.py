"""The plug as the cycle knows it: what it was told, what it does instead, and when to tell it again."""

from dataclasses import dataclass, field, replace
from datetime import datetime

from plugd import flow
from plugd.beat import Action, Cause, is_off_again, is_on, is_same
from plugd.domain import Memory, Reading, Relay, Wanted
from plugd.errors import PlugError, PlugRefused
from plugd.ports import Plug
from plugd.register import Register
from plugd.retry import Retry

RETRY_S = (5.0, 15.0, 60.0)
MOST_OFFS = 3
"""A relay that stays on is told off so often, and then left alone: moving it more would only wear it."""


@dataclass(slots=True)
class Actuator:
    """Tells the plug where it is not as wanted, and no more often than does it good."""

    plug: Plug
    faults: Register
    told: Wanted | None = None
    retry: Retry = field(default_factory=lambda: Retry(RETRY_S))
    offs: int = 0
    """How often the relay was told off in a row, and stayed on."""

    def read(self) -> Reading | None:
        """What it says; None and a fault where it says nothing."""
        try:
            reading = self.plug.read()
        except PlugError as error:
            self.faults.stand("plug_silent", str(error))
            self.faults.end("plug_refuses")  # whether it would do what it does not hear, nobody knows
            return None
        self.faults.end("plug_silent")
        if reading.came_back:
            self.told = None  # whatever it was told, it may have forgotten
        obeys_late = self._unheeded is not None and reading.changed_by_other is self._unheeded
        return replace(reading, changed_by_other=None) if obeys_late else reading  # nobody pressed

    @property
    def _unheeded(self) -> bool | None:
        """On or off, as it was last told and has not been seen to do."""
        return is_on(self.told) if self.told is not None and self.retry.failures > 0 else None

    def tend(self, now: datetime) -> None:
        """Repeat what has to be repeated."""
        try:
            self.plug.tend(now)
        except PlugError as error:
            self.faults.stand("plug_silent", str(error))

    def apply(
        self, now: datetime, action: Action, reading: Reading | None, memory: Memory, was_on: bool | None
    ) -> tuple[Memory, bool]:
        """The memory after what was done, and whether the relay was moved. `was_on`: before this look."""
        wanted = action.wanted
        same = self.told is not None and is_same(self.told, wanted)
        stays_on = self._stays_on(reading, wanted, memory)
        as_wanted = reading is not None and reading.on is is_on(wanted) and not stays_on
        # An "on" that is already on needs no word, unless an "off" may have had its way unseen (one whose timer ends in
        # time needs none either); an "off" has to be taken once, to arm or disarm its timer.
        needless = wanted == Relay(True) and (self._unheeded is not False or action.cause is Cause.TIMER)
        if as_wanted and (needless or (same and self.retry.failures == 0)):
            obeyed = same and self.retry.failures > 0 and not was_on  # without an answer, as is seen only now
            self.told = self.told if same else wanted  # a setpoint told earlier ends when it was told to
            self._taken()
            return (_counted(now, action, memory), True) if obeyed else (memory, False)
        again = stays_on and is_off_again(self.told, wanted)
        if (same or again) and not self.retry.due(now):
            return memory, False
        if not again:
            self.offs = MOST_OFFS - 1 if self.faults.stands("relay_stuck") else 0  # known to be stuck: one more try
        if self.offs >= MOST_OFFS and self._gives_up(reading, wanted, memory):
            return memory, False
        return self._order(now, action, reading, memory, stays_on)

    def _order(
        self, now: datetime, action: Action, reading: Reading | None, memory: Memory, stays_on: bool
    ) -> tuple[Memory, bool]:
        """Tell it, once."""
        self.told = action.wanted
        try:
            self.plug.set(action.wanted)
        except PlugError as error:
            self.retry.failed(now)
            if reading is not None or isinstance(error, PlugRefused):
                self.faults.stand("plug_refuses", str(error))
            self.offs += int(stays_on and isinstance(error, PlugRefused))  # else it may not have heard
            if self.offs >= MOST_OFFS:
                self._gives_up(reading, action.wanted, memory)
            return memory, False
        self._taken()
        self.offs += int(stays_on)
        if self.offs > 1:
            self.retry.failed(now)
        return _moved(now, action, memory)

    def _taken(self) -> None:
        self.retry.succeeded()
        self.faults.end("plug_refuses")

    def _stays_on(self, reading: Reading | None, wanted: Wanted, memory: Memory) -> bool:
        """Whether power may flow, or does, though it should not; that it no longer does ends the fault."""
        if reading is None:
            return False
        leak, unmetered = memory.flow.leak, reading.power_kw is None and reading.energy_kwh is not None
        if not (reading.on or leak or unmetered):
            self.offs = 0
            self.faults.end("relay_stuck")
        return not is_on(wanted) and (reading.on or flow.leaks(leak))

    def _gives_up(self, reading: Reading | None, wanted: Wanted, memory: Memory) -> bool:
        """Says that the relay is stuck. Whether to say no more to it: a charger wants its word all the same."""
        leak = memory.flow.leak
        text = f"the plug stays on though it was told off {MOST_OFFS} times"
        if leak is not None and reading is not None and not reading.on:
            text = f"{leak.power_kw:.1f} kW flows though the relay was told off {MOST_OFFS} times and says that it is"
        self.faults.stand("relay_stuck", text)
        self.faults.end("plug_refuses")
        return isinstance(wanted, Relay)


def _moved(now: datetime, action: Action, memory: Memory) -> tuple[Memory, bool]:
    """Whether the relay has moved; if so, remembered for the dwell times and the switch budget."""
    if memory.relay_on is action.on:
        return memory, False
    anew = replace(memory.flow, idle_since=None, flowed=False)  # whatever flowed, did so before
    return _counted(now, action, replace(memory, relay_on=action.on, relay_since=now, flow=anew)), True


def _counted(now: datetime, action: Action, memory: Memory) -> Memory:
    """A switch-on by the plan is on its budget; one that ends the waking of a car is not."""
    if action.on and action.cause is Cause.PLAN and memory.flow.wake_until is None:
        return replace(memory, switch_ons=(*memory.switch_ons, now))
    return memory
