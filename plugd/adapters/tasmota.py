"""A plug with Tasmota firmware over MQTT, with its timer as dead-man.

With `PowerOnState 5` the firmware restarts PulseTime at every OFF, and switches ON when it has run out (its
SetPulseTimer): an OFF that is not repeated ends by itself. PowerOnState must be 5 before PulseTime is set: else
the same timer switches off. Both are flash writes, made only where they differ: so every OFF runs for the same time,
and one that has to end by the last safe start is not repeated within that time before it.
"""

from datetime import datetime, timedelta

from plugd.adapters.mqtt import Message, MqttConnection, Retained
from plugd.adapters.plug_line import CONFIRM_S, CONFIRM_TRIES, PATIENCE_S, TRIES, Commands, PlugLine
from plugd.adapters.plug_memory import DAWN, TRIFLE_S, PlugMemory
from plugd.adapters.tasmota_words import hear, pulse_for
from plugd.domain import Capability, Fault, Reading, Relay, Wanted
from plugd.errors import PlugFault, PlugRefused
from plugd.ports import Clock

INVERTED_PULSE = 5
PRESENCE = {b"Online": "Online", b"Offline": "Offline"}


class Tasmota:
    """Implements `plugd.ports.Plug`."""

    def __init__(
        self,
        connection: MqttConnection,
        clock: Clock,
        topic: str,
        power_max_kw: float = 2.3,
        dead_man_s: float = 3600.0,
    ) -> None:
        """`topic` is the plug's own (%topic%). Raises ValueError for a dead-man time that it cannot count."""
        self._topic = topic
        self._capability = Capability(power_max_kw, dead_man=True, fixed_timer_s=dead_man_s)
        self._pulse_wanted = pulse_for(dead_man_s)
        self._plug = PlugMemory(dead_man_s)
        filters = (
            (f"stat/{topic}/+", Retained.LIVE),
            (f"tele/{topic}/STATE", Retained.LIVE),
            (f"tele/{topic}/SENSOR", Retained.LIVE),
            (f"tele/{topic}/LWT", Retained.REPLAYED),
            (f"cmnd/{topic}/POWER", Retained.WATCHED),
        )
        self._line = PlugLine(connection, clock, f"plug {topic}", filters, self._plug, self._hear, self._returned)
        self._ghost = False
        self._wanted: Relay | None = None
        self._power_on_state: int | None = None
        self._pulse: int | None = None
        self._armed_s = DAWN
        self._arm_tries = 0

    # -- the port ---------------------------------------------------------------------------------

    @property
    def capability(self) -> Capability:
        """On and off, with a dead-man."""
        return self._capability

    def read(self) -> Reading:
        """The last word on relay and meter; asks where it is older than a minute. Raises PlugTimeout."""
        return self._line.reading(self._status())

    def set(self, wanted: Wanted) -> None:
        """Switch, and wait for the plug to say so. Raises PlugRefused, PlugTimeout, PlugFault.

        An OFF with the dead-man is sent only once the plug's timer is known to be right.
        """
        if not isinstance(wanted, Relay):
            raise PlugRefused(f"{self._line.name} knows on and off only, not {wanted.power_kw:g} kW")
        self._line.listen()
        plug, self._wanted = self._plug, wanted
        plug.promise(wanted, *self._line.now())
        plug.held = wanted.held and not wanted.on
        if plug.held:
            self._pulse = None  # to be heard anew
        elif not wanted.on:
            self._arm_now()
        answers = plug.answers

        def done() -> bool:
            return plug.answers > answers and plug.on is wanted.on and (not plug.held or self._pulse == 0)

        plug.order(wanted.on, self._line.now()[1])
        if self._line.exchange((self._command(wanted),), done, CONFIRM_TRIES, CONFIRM_S):
            return
        if plug.answers > answers and plug.on is not wanted.on:
            state = "ON" if plug.on else "OFF"
            raise PlugRefused(f"{self._line.name} answers but stays {state}; is it locked (PowerLock)?")
        raise self._line.silence(self._status())

    def due(self) -> datetime | None:
        """When the timer has to be set or an OFF repeated. None while there is nothing or nobody to tell."""
        if self._wanted is None:
            return None
        return self._line.at(min(self._arming_s(), self._plug.last_renewal_s(self._wanted)))

    def tend(self, now: datetime) -> None:
        """Repeat an OFF, or look after the timer, where due; waits for no answer. Raises PlugTimeout."""
        self._line.listen()
        due = self.due()
        if due is None or now + timedelta(seconds=TRIFLE_S) < due:
            return
        now_s = self._line.now()[1]
        if self._arming_s() <= now_s + TRIFLE_S:
            self._line.send(self._settings())
        if self._plug.last_renewal_s(self._wanted) <= now_s + TRIFLE_S:
            self._plug.order(on=False, now_s=now_s)
            self._line.send((self._command(Relay(on=False)),))

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What a person should mend."""
        found = []
        command = f"cmnd/{self._topic}/POWER"
        if self._ghost:
            text = f"a retained {command} switches the plug at every reconnect"
            found.append(Fault("plug_retained_command", text))
        if self._arm_tries > TRIES:
            settings = f"PowerOnState {INVERTED_PULSE} and PulseTime {self._target()}"
            text = f"{self._line.name} does not keep {settings}; without them it stays off when plugd stops"
            found.append(Fault("plug_dead_man", text))
        return tuple(found)

    @property
    def nonsense(self) -> int:
        """How many values it has told that could not be."""
        return self._plug.nonsense

    # -- listening and speaking -------------------------------------------------------------------

    def _hear(self, message: Message) -> None:
        kind, tail = message.topic.split("/", 1)[0], message.topic.rsplit("/", 1)[-1]
        if kind == "cmnd":
            self._ghost = bool(message.payload) if message.retain else self._ghost
            if message.payload:
                self._plug.overheard = (message.topic, self._line.now()[1])
        elif tail == "LWT":
            self._line.last_word = PRESENCE.get(message.payload, "says something else")
            if message.payload == b"Online" and not message.retain:
                self._back()
        elif not message.retain:  # a kept copy says nothing of now
            heard = hear(message.payload, answer=tail in ("RESULT", "POWER", "POWER1"))
            boots = self._plug.boots
            self._plug.absorb(heard, *self._line.now())
            if self._plug.boots != boots:
                self._power_on_state = self._pulse = None
            if heard.power_on_state is not None:
                self._power_on_state = heard.power_on_state
            if heard.pulse is not None:
                self._pulse = heard.pulse
        if self._armed():
            self._arm_tries = 0

    def _returned(self) -> None:
        """We were away; what the broker keeps for the plug is told anew."""
        self._back()
        self._ghost = False

    def _back(self) -> None:
        self._plug.back()
        self._power_on_state = self._pulse = None
        self._armed_s = DAWN

    def _to(self, command: str, payload: str) -> tuple[str, str]:
        return f"cmnd/{self._topic}/{command}", payload

    def _status(self) -> Commands:
        return self._to("Status", "11"), self._to("Status", "8")

    def _command(self, wanted: Relay) -> tuple[str, str]:
        """A held OFF disarms the timer first, in one message."""
        if wanted.held and not wanted.on:
            return self._to("Backlog", "PulseTime1 0; POWER OFF")
        return self._to("POWER", "ON" if wanted.on else "OFF")

    # -- the dead-man -----------------------------------------------------------------------------

    def _target(self) -> int:
        return 0 if self._plug.held else self._pulse_wanted

    def _known(self) -> bool:
        """Whether it has told how its timer is set."""
        return self._power_on_state is not None and self._pulse is not None

    def _armed(self) -> bool:
        return self._power_on_state == INVERTED_PULSE and self._pulse == self._target()

    def _arming_s(self) -> float:
        """When to look after the timer's setting; never (infinity) where it is right."""
        return -DAWN if self._armed() else self._armed_s + CONFIRM_S

    def _settings(self) -> Commands:
        """Asks how the timer is set, or sets it where the answer was not as it should be."""
        self._armed_s = self._line.now()[1]
        if not self._known():
            return self._to("PowerOnState", ""), self._to("PulseTime1", "")
        self._arm_tries += 1
        self._pulse = None  # what is set is heard anew
        if self._power_on_state == INVERTED_PULSE:
            return (self._to("PulseTime1", str(self._target())),)
        self._power_on_state = None
        return (self._to("Backlog", f"PowerOnState {INVERTED_PULSE}; PulseTime1 {self._target()}"),)

    def _arm_now(self) -> None:
        """Until the timer is right. Raises PlugFault where it stays wrong, PlugTimeout without an answer."""
        for _ in range(TRIES):
            if self._armed():
                return
            self._line.exchange(self._settings(), self._known, 1, PATIENCE_S)
        if not self._armed():
            if self._known():
                raise PlugFault(f"{self._line.name} does not take its timer, so it is not switched off")
            raise self._line.silence(self._status())
