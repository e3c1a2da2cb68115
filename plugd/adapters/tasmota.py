"""A plug with Tasmota firmware over MQTT, with its timer as dead-man.

With `PowerOnState 5` the firmware restarts PulseTime at every OFF, and switches ON when it has run out (its
SetPulseTimer): an OFF that is not repeated ends by itself. PowerOnState must be 5 before PulseTime is set: else
the same timer switches off. Both are flash writes, made only where they differ.
"""

from collections.abc import Callable
from datetime import datetime, timedelta

from plugd.adapters.mqtt import MqttConnection, Retained
from plugd.adapters.tasmota_memory import DAWN, PlugMemory
from plugd.adapters.tasmota_words import hear, pulse_for
from plugd.domain import Capability, Fault, Reading, Relay, Wanted
from plugd.errors import PlugFault, PlugRefused, PlugTimeout
from plugd.ports import Clock
from plugd.units import iso

TRIES = 3
PATIENCE_S = 1.5
"""How long an answer may take before it is asked for again: three of them are under 5 s."""
CONFIRM_TRIES = 2
CONFIRM_S = 2.0
RENEWALS = 6
"""OFF is sent this many times in the dead-man's time; five times as often while it stays unanswered."""
INVERTED_PULSE = 5
Commands = tuple[tuple[str, str], ...]


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
        self._mqtt = connection
        self._clock = clock
        self._topic = topic
        self._capability = Capability(power_max_kw, dead_man=True)
        self._pulse_wanted = pulse_for(dead_man_s)
        self._plug = PlugMemory(dead_man_s)
        self._mail = connection.subscribe(
            (f"stat/{topic}/+", Retained.LIVE),
            (f"tele/{topic}/STATE", Retained.LIVE),
            (f"tele/{topic}/SENSOR", Retained.LIVE),
            (f"tele/{topic}/LWT", Retained.REPLAYED),
            (f"cmnd/{topic}/POWER", Retained.WATCHED),
        )
        self._session = 0
        self._last_word = "never seen"
        self._ghost = False
        self._wanted: Relay | None = None
        self._armed_s = DAWN
        self._arm_tries = 0
        self._silent = False

    # -- the port ---------------------------------------------------------------------------------

    @property
    def capability(self) -> Capability:
        """On and off, with a dead-man."""
        return self._capability

    def read(self) -> Reading:
        """The last word on relay and meter; asks where it is older than a minute. Raises PlugTimeout."""
        self._listen()
        if not self._fresh():
            status = (("Status", "11"), ("Status", "8"))
            self._exchange(status, self._fresh, 1 if self._silent else TRIES, PATIENCE_S)
        reading = self._plug.reading(self._clock.monotonic())
        self._silent = reading is None
        if reading is None:
            raise self._silence()
        return reading

    def set(self, wanted: Wanted) -> None:
        """Switch, and wait for the plug to say so. Raises PlugRefused, PlugTimeout, PlugFault.

        An OFF with the dead-man is sent only once the plug's timer is known to be right.
        """
        if not isinstance(wanted, Relay):
            raise PlugRefused(f"plug {self._topic} knows on and off only, not {wanted.power_kw:g} kW")
        self._listen()
        plug, self._wanted = self._plug, wanted
        plug.held = wanted.held and not wanted.on
        if plug.held:
            plug.pulse = None  # to be heard anew
        elif not wanted.on:
            self._arm_now()
        answers = plug.answers

        def done() -> bool:
            return plug.answers > answers and plug.on is wanted.on and (not plug.held or plug.pulse == 0)

        plug.order(wanted.on, self._clock.monotonic())
        if self._exchange((_command(wanted),), done, CONFIRM_TRIES, CONFIRM_S):
            return
        if plug.answers > answers and plug.on is not wanted.on:
            state = "ON" if plug.on else "OFF"
            raise PlugRefused(f"plug {self._topic} answers but stays {state}; is it locked (PowerLock)?")
        raise self._silence()

    def due(self) -> datetime | None:
        """When the timer has to be set or an OFF repeated. None while there is nothing or nobody to tell."""
        moment_s = min(self._arming_s(), self._renewal_s())
        if self._wanted is None or moment_s == -DAWN or not self._mqtt.connected:
            return None
        return self._clock.now() + timedelta(seconds=max(moment_s - self._clock.monotonic(), 0.0))

    def tend(self, now: datetime) -> None:
        """Repeat an OFF, or look after the timer, where due; waits for no answer. Raises PlugTimeout."""
        self._listen()
        due = self.due()
        if due is None or now + timedelta(milliseconds=1) < due:
            return
        by_now_s = self._clock.monotonic() + 0.001
        if self._arming_s() <= by_now_s:
            self._send(self._settings())
        if self._renewal_s() <= by_now_s:
            self._plug.order(on=False, now_s=self._clock.monotonic())
            self._send((_command(Relay(on=False)),))

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What a person should mend."""
        found = []
        command = f"cmnd/{self._topic}/POWER"
        if self._ghost:
            text = f"a retained {command} switches the plug at every reconnect"
            found.append(Fault("plug_retained_command", f"{text}; mosquitto_pub -rnt {command} clears it"))
        if self._arm_tries > TRIES:
            settings = f"PowerOnState {INVERTED_PULSE} and PulseTime {self._target()}"
            text = f"plug {self._topic} does not keep {settings}; without them it stays off when plugd stops"
            found.append(Fault("plug_dead_man", text))
        return tuple(found)

    @property
    def nonsense(self) -> int:
        """How many values it has told that could not be."""
        return self._plug.nonsense

    # -- listening --------------------------------------------------------------------------------

    def _listen(self) -> None:
        if self._mqtt.session != self._session:
            if self._session:
                self._back()
            self._session, self._ghost = self._mqtt.session, False
        for message in self._mail.take():
            kind, tail = message.topic.split("/", 1)[0], message.topic.rsplit("/", 1)[-1]
            if kind == "cmnd":
                self._ghost = bool(message.payload) if message.retain else self._ghost
            elif tail == "LWT":
                self._last_word = message.payload.decode("utf-8", "replace")[:16]
                if self._last_word == "Online" and not message.retain:
                    self._back()
            elif not message.retain:  # a kept copy says nothing of now
                answer = tail in ("RESULT", "POWER", "POWER1")
                heard = hear(message.payload)
                self._plug.absorb(heard, answer, self._clock.now(), self._clock.monotonic())
        if self._armed():
            self._arm_tries = 0

    def _back(self) -> None:
        self._plug.back()
        self._armed_s = DAWN

    def _fresh(self) -> bool:
        return self._plug.fresh(self._clock.monotonic())

    # -- speaking ---------------------------------------------------------------------------------

    def _send(self, commands: Commands) -> None:
        for command, payload in commands:
            if not self._mqtt.publish(f"cmnd/{self._topic}/{command}", payload.encode(), qos=1):
                why = self._mqtt.refusal or "not connected yet"
                raise PlugTimeout(f"plug {self._topic} is out of reach: no broker ({why})")

    def _exchange(self, commands: Commands, done: Callable[[], bool], tries: int, patience_s: float) -> bool:
        """Say it until it is done. Raises PlugTimeout when the broker is away."""
        for _ in range(tries):
            self._send(commands)
            until_s = self._clock.monotonic() + patience_s
            while (left_s := until_s - self._clock.monotonic()) > 0.0 and self._mqtt.connected:
                self._clock.wait(self._clock.now() + timedelta(seconds=left_s), self._mail)
                self._listen()
                if done():
                    return True
        return False

    def _silence(self) -> PlugTimeout:
        at = self._plug.on_at
        heard = f"silent since {iso(at)}" if at else "has not answered yet"
        topic = f"cmnd/{self._topic}/Status"
        objection = self._mqtt.objections.get(topic)
        why = f"; {topic}: {objection}" if objection else ""
        broker = "connected" if self._mqtt.connected else "away"
        return PlugTimeout(f"plug {self._topic} {heard} ({self._last_word}; broker {broker}){why}")

    # -- the dead-man -----------------------------------------------------------------------------

    def _target(self) -> int:
        return 0 if self._plug.held else self._pulse_wanted

    def _armed(self) -> bool:
        return self._plug.power_on_state == INVERTED_PULSE and self._plug.pulse == self._target()

    def _arming_s(self) -> float:
        """When to look after the timer's setting; never (infinity) where it is right."""
        return -DAWN if self._armed() else self._armed_s + CONFIRM_S

    def _renewal_s(self) -> float:
        """When to repeat OFF; never where it is on (the next decision acts) or off on a person's word."""
        plug, wanted = self._plug, self._wanted
        if wanted is None or wanted.on or wanted.held or plug.on is not False:
            return -DAWN
        share = RENEWALS if plug.off_s >= plug.off_sent_s else 5 * RENEWALS
        return plug.off_sent_s + plug.dead_man_s / share

    def _settings(self) -> Commands:
        """Asks how the timer is set, or sets it where the answer was not as it should be."""
        self._armed_s = self._clock.monotonic()
        if not self._plug.known():
            return ("PowerOnState", ""), ("PulseTime1", "")
        self._arm_tries += 1
        self._plug.pulse = None  # what is set is heard anew
        if self._plug.power_on_state == INVERTED_PULSE:
            return (("PulseTime1", str(self._target())),)
        self._plug.power_on_state = None
        return (("Backlog", f"PowerOnState {INVERTED_PULSE}; PulseTime1 {self._target()}"),)

    def _arm_now(self) -> None:
        """Until the timer is right. Raises PlugFault where it stays wrong, PlugTimeout without an answer."""
        for _ in range(TRIES):
            if self._armed():
                return
            self._exchange(self._settings(), self._plug.known, 1, PATIENCE_S)
        if not self._armed():
            if self._plug.known():
                raise PlugFault(f"plug {self._topic} does not take its timer, so it is not switched off")
            raise self._silence()


def _command(wanted: Relay) -> tuple[str, str]:
    """A held OFF disarms the timer first, in one message."""
    if wanted.held and not wanted.on:
        return "Backlog", "PulseTime1 0; POWER OFF"
    return "POWER", "ON" if wanted.on else "OFF"
