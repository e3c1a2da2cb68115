"""A relay over MQTT whose dialect is a set of words: how to ask, how to switch, what a message says."""

from datetime import datetime, timedelta
from typing import Protocol

from plugd.adapters.mqtt import Message, MqttConnection, Retained
from plugd.adapters.plug_line import CONFIRM_S, CONFIRM_TRIES, Commands, PlugLine
from plugd.adapters.plug_memory import TRIFLE_S, PlugMemory
from plugd.adapters.plug_words import Heard
from plugd.domain import Capability, Fault, Reading, Relay, Wanted
from plugd.errors import PlugError, PlugFault, PlugRefused
from plugd.ports import Clock


class Dialect(Protocol):
    """The words of one kind of plug. Parsing is bounded and never raises."""

    @property
    def dead_man(self) -> bool:
        """Whether an OFF can be sent with a timer that switches on again."""

    @property
    def tells_uptime(self) -> bool:
        """Whether it says how long it has been up."""

    @property
    def on_change(self) -> bool:
        """It tells its relay's state when that changes, and does not answer to commands that change nothing."""

    @property
    def meter(self) -> bool:
        """Whether there is one."""

    def filters(self) -> tuple[tuple[str, Retained], ...]:
        """What to listen to."""

    def hear(self, message: Message) -> Heard:
        """What a message says."""

    def status(self) -> Commands:
        """What asks for relay and meter; nothing where it cannot be asked."""

    def switch(self, on: bool, timer_s: float | None) -> Commands:
        """What switches, with a timer that switches over again where one is wanted."""


class SwitchedPlug:
    """Implements `plugd.ports.Plug`."""

    def __init__(
        self,
        connection: MqttConnection,
        clock: Clock,
        name: str,
        dialect: Dialect,
        power_max_kw: float = 2.3,
        dead_man_s: float = 3600.0,
    ) -> None:
        """`name` is what people are told of it. `dead_man_s` counts where the dialect has a timer."""
        self._dialect = dialect
        self._capability = Capability(power_max_kw, dead_man=dialect.dead_man)
        self._plug = PlugMemory(dead_man_s if dialect.dead_man else None, dialect.tells_uptime)
        self._line = PlugLine(
            connection, clock, f"plug {name}", dialect.filters(), self._plug, self._hear, self._plug.back
        )
        self._online: bool | None = None
        self._kept: Heard | None = None
        self._wanted: Relay | None = None

    # -- the port ---------------------------------------------------------------------------------

    @property
    def capability(self) -> Capability:
        """On and off."""
        return self._capability

    def read(self) -> Reading:
        """The last word on relay and meter; asks where it is older than a minute. Raises PlugTimeout."""
        return self._line.reading(self._dialect.status(), self._dialect.meter)

    def set(self, wanted: Wanted) -> None:
        """Switch, and wait for the plug to say so. Raises PlugRefused, PlugTimeout, PlugFault."""
        line, plug = self._line, self._plug
        if not isinstance(wanted, Relay):
            raise PlugRefused(f"{line.name} knows on and off only, not {wanted.power_kw:g} kW")
        line.listen()
        now_s = line.now()[1]
        if wanted.on and plug.protects(now_s):
            raise PlugFault(f"{line.name} {self._protection()}; it is left off for ten minutes")
        self._wanted = wanted
        plug.promise(wanted, *line.now())
        plug.held = wanted.held and not wanted.on
        answers = plug.answers

        def obeyed() -> bool:
            answered = self._dialect.on_change or plug.answers > answers
            return answered and plug.on is wanted.on and not (plug.held and plug.timer)

        as_wanted = plug.on is wanted.on and plug.fresh(now_s, meter=False)
        plug.order(wanted.on, now_s)
        commands = self._command(wanted)
        if self._dialect.on_change and as_wanted:
            line.send(commands)  # it will not answer: nothing changes
            return
        if line.exchange(commands, lambda: obeyed() or plug.refusal is not None, CONFIRM_TRIES, CONFIRM_S):
            if plug.refusal is not None:
                raise PlugRefused(f"{line.name} refuses: {plug.refusal}")
            return
        raise self._disobedience(wanted, answers, now_s, commands)

    def _disobedience(self, wanted: Relay, answers: int, since_s: float, commands: Commands) -> PlugError:
        """Whether it does otherwise, or says nothing at all."""
        plug = self._plug
        alive = plug.on_s > since_s if self._dialect.on_change else plug.answers > answers
        if not alive:
            return self._line.silence(self._dialect.status() or commands)
        if plug.on is wanted.on:
            return PlugRefused(f"{self._line.name} is off, and keeps a timer that will switch it on")
        return PlugRefused(f"{self._line.name} answers but stays {'ON' if plug.on else 'OFF'}; is it locked?")

    def due(self) -> datetime | None:
        """When an OFF has to be repeated. None without a dead-man."""
        return self._line.at(self._plug.renewal_s(self._wanted))

    def tend(self, now: datetime) -> None:
        """Repeat an OFF where due; waits for no answer. Raises PlugTimeout."""
        self._line.listen()
        due = self.due()
        if due is None or now + timedelta(seconds=TRIFLE_S) < due:
            return
        self._plug.order(on=False, now_s=self._line.now()[1])
        self._line.send(self._command(Relay(on=False)))

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What a person should mend."""
        found = []
        if self._plug.errors:
            found.append(Fault("plug_protects", f"{self._line.name} {self._protection()}"))
        if not self._dialect.meter or self._line.meterless:
            text = f"{self._line.name} tells no energy, so what the car takes cannot be counted"
            found.append(Fault("plug_meter", text))
        off = self._wanted is not None and not self._wanted.on and not self._plug.held
        if self._dialect.dead_man and off and self._plug.on is False and self._plug.timer is False:
            text = f"{self._line.name} does not keep the timer of an off; it stays off when plugd stops"
            found.append(Fault("plug_dead_man", text))
        return tuple(found)

    @property
    def nonsense(self) -> int:
        """How many values it has told that could not be."""
        return self._plug.nonsense

    # -- listening and speaking -------------------------------------------------------------------

    def _hear(self, message: Message) -> None:
        heard = self._dialect.hear(message)
        if heard.online is not None:
            self._presence(heard.online, message.retain)
        if heard.kept:
            self._kept = heard
        elif not message.retain:
            now, now_s = self._line.now()
            if self._dialect.on_change:
                self._plug.alive(now, now_s)
            self._plug.absorb(heard, now, now_s)
        # What the broker keeps counts while the plug is online, until it says something itself.
        if self._kept is not None and self._online and self._plug.on is None:
            self._plug.absorb(self._kept, *self._line.now())

    def _presence(self, online: bool, kept: bool) -> None:
        self._online, self._line.last_word = online, "online" if online else "offline"
        if not online:
            self._kept = None
            self._plug.stale()
        elif not kept:
            self._plug.back()

    def _command(self, wanted: Relay) -> Commands:
        timed = self._dialect.dead_man and not wanted.on and not wanted.held
        return self._dialect.switch(wanted.on, self._plug.timer_s(self._line.now()[1]) if timed else None)

    def _protection(self) -> str:
        why = ", ".join(self._plug.errors) or "overload"
        return f"has switched itself off ({why})"
