"""A charger that speaks the Elcon / TC protocol on CAN. Implements `plugd.ports.Plug` and `plugd.ports.Tended`.

Every second it is told how much it may give; 5 s without, and it stops by itself. So its dead-man points at OFF: a dead
plugd leaves it off, and what plugd tells is sent from the control loop only, so that a hung one does too.

It measures on the battery's side. What is read here is at the plug, as everywhere: divided by the efficiency.
"""

from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta

from plugd.adapters.can_link import CanLink
from plugd.adapters.can_soc import SocSignal
from plugd.adapters.elcon_memory import IDLE_A, PATIENCE, STOPPED_BY, ChargerMemory
from plugd.adapters.elcon_words import BATTERY, COMMAND_ID, DEAF, STATUS_ID, Limits, Words, is_command, is_status
from plugd.domain import Capability, Fault, Reading, Relay, Wanted
from plugd.errors import PlugError, PlugFault, PlugRefused, PlugTimeout
from plugd.ports import Clock
from plugd.units import amps_of, iso

SETTLED = 3
"""Words from either side after which a charger is believed that gives another current: a full battery takes none."""
NEAR = 0.02
KNOWN_SHARE = (0.7, 1.05)
"""Of the battery's voltage limit: outside it what the charger measures is not the battery's voltage."""
FAR = datetime.max.replace(tzinfo=UTC) - timedelta(days=2)
EARLY_S = 0.005
"""A command may go out this much before its time: wall time and monotonic time do not agree to the microsecond."""
NEVER_S = float("-inf")
OTHER_S = 60.0
"""So long a command of somebody else's is spoken of."""


def identifiers(soc: SocSignal | None) -> tuple[tuple[int, bool], ...]:
    """What is worth hearing: (identifier, whether it has 29 bits)."""
    ours = ((STATUS_ID, True), (COMMAND_ID, True))
    return ours if soc is None else (*ours, (soc.frame_id, soc.extended))


class CanElcon:
    """One charger, one battery with its limits."""

    def __init__(
        self,
        link: CanLink,
        clock: Clock,
        capability: Capability,
        limits: Limits,
        efficiency: float,
        soc: SocSignal | None = None,
        soc_max_age_s: float = 1800.0,
        beat_s: float = 1.0,
    ) -> None:
        """`efficiency`: battery energy per energy at the plug. `beat_s`: between two commands."""
        self._link = link
        self._clock = clock
        self._capability = capability
        self._limits = limits
        self._efficiency = efficiency
        self._soc = soc
        self._soc_max_age_s = soc_max_age_s
        self._soc_at: datetime | None = None
        self._beat_s = beat_s
        self._words = Words(limits)
        self._charger = ChargerMemory(efficiency, PATIENCE * beat_s)
        self._wanted_kw: float | None = None
        self._until = FAR
        self._sent_s = NEVER_S
        self._spoken = 0
        self._sent: tuple[bytes, ...] = ()
        self._lowered_s: float | None = None
        self._other_s = NEVER_S
        self._silent = False

    # -- the port ---------------------------------------------------------------------------------

    @property
    def capability(self) -> Capability:
        """Any power from its least to its most. Nothing comes on when plugd falls silent."""
        return self._capability

    @property
    def line(self) -> CanLink:
        """What to wait by between two commands."""
        return self._link

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What it and the bus report, and what they should not."""
        return tuple(self._faults())

    def _faults(self) -> Iterator[Fault]:
        bits = self._charger.bits
        yield from (Fault(*STOPPED_BY[bit]) for bit in bits if bit in STOPPED_BY)
        if BATTERY in bits and self._power_kw() > 0.0:
            yield Fault("charger_battery", "the charger finds no battery, or a reversed one")
        if self._charger.cut:
            text = "the charger gave more than the battery's limits, and is stopped until plugd is restarted"
            yield Fault("charger_over", text)
        if self._link.trouble:
            yield Fault("can_bus", self._link.trouble)
        if self._link.babbling:
            yield Fault("can_babble", "more frames on the CAN bus than can be read")
        if self._clock.monotonic() - self._other_s < OTHER_S:
            yield Fault("charger_two_masters", "something else on the CAN bus tells the charger what to do")

    @property
    def nonsense(self) -> int:
        """How many frames of charger and battery could not be."""
        return self._charger.nonsense + (self._soc.nonsense if self._soc is not None else 0)

    def read(self) -> Reading:
        """How it is now, at the plug; waits for its first word. Raises PlugTimeout where there is none any more."""
        self._hear_first()
        charger, last = self._charger, self._charger.last
        if self._silent or last is None:
            raise self._silence()
        came_back, charger.came_back = charger.came_back, False
        soc = self._told_soc()
        return Reading(
            at=last.at,
            # As told, where it listens and has no fault; or it gives something, whatever it was told.
            on=last.status.current_a > IDLE_A or (self._power_kw() > 0.0 and not charger.stopped),
            power_kw=charger.at_plug_kw(last.status),
            energy_kwh=charger.energy_kwh,
            metered_at=last.at,
            came_back=came_back,
            soc=soc,
            soc_at=None if soc is None else self._soc_at,
        )

    def set(self, wanted: Wanted) -> None:
        """Tell it a power until a moment, and wait for it to obey. Raises PlugRefused, PlugTimeout, PlugFault."""
        if isinstance(wanted, Relay):
            power_kw, until = self._capability.power_max_kw if wanted.on else 0.0, FAR
        else:
            power_kw, until = wanted.power_kw, wanted.until
        least_kw, most_kw = self._capability.power_min_kw, self._capability.power_max_kw
        if power_kw > most_kw + 1e-6 or 0.0 < power_kw < least_kw - 1e-6:
            raise PlugRefused(f"the charger gives 0 or {least_kw:g} to {most_kw:g} kW, not {power_kw:g}")
        self._hear_first()  # its voltage, which makes a current of a power
        renewed = power_kw == self._wanted_kw and self._clock.now() < self._until
        self._wanted_kw, self._until = power_kw, until
        words = self._charger.words
        if renewed and self._objection(power_kw, -1) is None:
            return
        spoken = self._spoken
        self._speak()
        self._wait(lambda: self._settled(power_kw, words, spoken))
        if (objection := self._objection(power_kw, words)) is not None:
            raise objection

    def tend(self, now: datetime) -> None:
        """Listen, and tell it again what it may give, where that is due."""
        self._listen()
        if self._wanted_kw is not None and self._left_s() <= EARLY_S:
            self._speak()

    def due(self) -> datetime | None:
        """When it must be told again. None before the first command: who only looks says nothing."""
        if self._wanted_kw is None:
            return None
        return self._clock.now() + timedelta(seconds=max(self._left_s(), 0.0))

    def _left_s(self) -> float:
        """To the next command."""
        return self._sent_s + self._beat_s - self._clock.monotonic()

    def close(self) -> None:
        """Stop it, its current lowered first, and leave the bus. Who only looked says nothing."""
        if self._wanted_kw is not None:
            self._wanted_kw = 0.0
            self._speak()
            self._wait(lambda: not self._flowing())
            self._say(0.0, charge=False)
            self._link.flush()
        self._link.close()

    # -- speaking ---------------------------------------------------------------------------------

    def _power_kw(self) -> float:
        """What it may give now, at the plug: a setpoint whose time is over counts for nothing."""
        if self._charger.cut or self._wanted_kw is None or self._clock.now() >= self._until:
            return 0.0
        return self._wanted_kw

    def _speak(self) -> None:
        """The frame of this second. A current that flows is lowered first, and the contactor opens without load."""
        power_kw, now_s = self._power_kw(), self._clock.monotonic()
        if power_kw > 0.0:
            self._lowered_s = None
            self._say(amps_of(power_kw * self._efficiency, self._voltage_v()), charge=True)
            return
        self._lowered_s = now_s if self._lowered_s is None else self._lowered_s
        lowering = self._flowing() and now_s - self._lowered_s < PATIENCE * self._beat_s
        self._say(0.0, charge=lowering)

    def _say(self, current_a: float, charge: bool) -> None:
        frame = self._words.command(current_a, charge)
        self._sent_s = self._clock.monotonic()
        self._spoken += 1
        self._sent = (bytes(frame.data), *self._sent[:PATIENCE])
        self._link.say(frame)

    def _voltage_v(self) -> float:
        """The battery's voltage as the charger measures it; the highest there can be where it does not yet."""
        low_v, high_v = (share * self._limits.voltage_v for share in KNOWN_SHARE)
        last = self._charger.last
        if last is not None and self._fresh() and low_v <= last.status.voltage_v <= high_v:
            return last.status.voltage_v
        return self._limits.voltage_v

    # -- listening --------------------------------------------------------------------------------

    def _listen(self) -> None:
        """Take in what has arrived."""
        now, now_s = self._clock.now(), self._clock.monotonic()
        for message in self._link.hear():
            if is_status(message):
                status = self._words.status(message)
                self._charger.absorb(status, status is not None and self._words.over(status), now, now_s)
            elif is_command(message):
                if bytes(message.data) not in self._sent:  # our own come back on udp_multicast
                    self._other_s = now_s
            elif self._soc is not None and self._soc.absorb(message, now_s):
                self._soc_at = now

    def _hear_first(self) -> None:
        """Listen; where nothing was heard for a while, and it was not yet waited for in vain, wait for a word."""
        self._listen()
        if not self._fresh() and not self._silent:
            self._wait(self._fresh)
        self._silent = not self._fresh()

    def _told_soc(self) -> float | None:
        """What the battery itself last said, if that is not too long ago."""
        if self._soc is None or self._clock.monotonic() - self._soc.heard_s > self._soc_max_age_s:
            return None
        return self._soc.soc

    def _wait(self, done: Callable[[], bool]) -> None:
        """Let time pass, telling it every beat what it may give, until something is so or patience ends."""
        end_s = self._clock.monotonic() + PATIENCE * self._beat_s
        for _ in range(10 * PATIENCE):  # where somebody keeps waking us, time may not pass
            if done() or self._clock.monotonic() >= end_s:
                return
            beat = self._clock.now() + timedelta(seconds=self._beat_s)
            self._clock.wait(min(beat, self.due() or beat), self._link)
            self.tend(self._clock.now())

    # -- judging ----------------------------------------------------------------------------------

    def _fresh(self) -> bool:
        return self._charger.fresh(self._clock.monotonic())

    def _flowing(self) -> bool:
        return self._charger.flowing(self._clock.monotonic())

    def _settled(self, power_kw: float, words: int, spoken: int) -> bool:
        """Whether it does what it was told, or has had the time to: how many words were said before by either side."""
        charger, last = self._charger, self._charger.last
        if last is None or not self._fresh() or charger.words <= words:
            return False
        if power_kw <= 0.0:
            told_stop = bool(self._sent) and self._sent[0][4] != 0
            return last.status.current_a <= IDLE_A and told_stop
        near = abs(charger.at_plug_kw(last.status) - power_kw) <= NEAR * power_kw
        had_time = min(charger.words - words, self._spoken - spoken) >= SETTLED
        return (near or had_time) and DEAF not in charger.bits

    def _objection(self, power_kw: float, words: int) -> PlugError | None:
        """Why a command is not obeyed."""
        charger, last = self._charger, self._charger.last
        if last is None or not self._fresh() or charger.words <= words:
            return self._silence()
        if power_kw <= 0.0:
            if last.status.current_a <= IDLE_A:
                return None
            return PlugRefused(
                f"the charger is told to stop and still gives {last.status.current_a:g} A: switch it off"
            )
        if charger.cut:
            return PlugFault("the charger gave more than the battery's limits, and is stopped: see charger_over")
        if DEAF in charger.bits:
            return PlugRefused("the charger does not hear its commands: is it of another kind, or set up otherwise?")
        return next((PlugFault(STOPPED_BY[bit][1]) for bit in charger.bits if bit in STOPPED_BY), None)

    def _silence(self) -> PlugTimeout:
        last = self._charger.last
        heard = f"is silent since {iso(last.at)}" if last is not None else "has not said anything yet"
        trouble = f" ({self._link.trouble})" if self._link.trouble else "; has it power, and is [can] right?"
        return PlugTimeout(f"the charger on CAN {heard}{trouble}")
