"""What every plug over MQTT needs: to listen, to ask, to wait for an answer, and words for its silence."""

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta

from plugd.adapters.mqtt import Message, MqttConnection, Retained
from plugd.adapters.plug_memory import DAWN, PlugMemory
from plugd.domain import Reading
from plugd.errors import PlugTimeout
from plugd.ports import Clock
from plugd.units import iso

TRIES = 3
PATIENCE_S = 1.5
"""How long an answer may take before it is asked for again: three of them are under 5 s."""
CONFIRM_TRIES = 2
CONFIRM_S = 2.0
FIRST_WORD_S = 35.0
"""How long the first word of a plug that cannot be asked is waited for, once: OpenEVSE speaks every 30 s."""
Commands = tuple[tuple[str, str], ...]
"""(topic, payload): never retained."""


class PlugLine:
    """One plug's end of the connection, and what it has told over it."""

    def __init__(
        self,
        connection: MqttConnection,
        clock: Clock,
        name: str,
        filters: tuple[tuple[str, Retained], ...],
        plug: PlugMemory,
        hear: Callable[[Message], None],
        back: Callable[[], None],
    ) -> None:
        """`hear` is given every message; `back` is called when we were away from the broker."""
        self.name = name
        self.plug = plug
        self.last_word = "never seen"
        """What it said of its own presence."""
        self._mqtt = connection
        self._clock = clock
        self._mail = connection.subscribe(*filters)
        self._hear = hear
        self._back = back
        self.meterless = False
        """It has been asked, and told of no meter."""
        self._session = 0
        self._silent = False

    @property
    def connected(self) -> bool:
        """Whether there is a broker."""
        return self._mqtt.connected

    def now(self) -> tuple[datetime, float]:
        """The clock's wall time and monotonic seconds."""
        return self._clock.now(), self._clock.monotonic()

    def listen(self) -> None:
        """Hear what has arrived."""
        if self._mqtt.session != self._session:
            if self._session:
                self._back()
            self._session = self._mqtt.session
        for message in self._mail.take():
            self._hear(message)

    def reading(self, status: Commands, meter: bool = True) -> Reading:
        """The last word on relay and meter; asks where it is older than a minute. Raises PlugTimeout."""
        self.listen()
        meter = meter and (self.plug.metered_at is not None or not self.meterless)
        if not self._fresh(meter):
            if status:
                self.exchange(status, lambda: self._fresh(meter), 1 if self._silent else TRIES, PATIENCE_S)
            elif not self._silent and (self.plug.on_at is None or (meter and self.plug.metered_at is None)):
                self.exchange((), lambda: self._fresh(meter), 1, FIRST_WORD_S)
            self.meterless = self.plug.metered_at is None and self._fresh(meter=False)
        reading = self.plug.reading(self._clock.monotonic())
        self._silent = reading is None
        if reading is None:
            raise self.silence(status)
        if reading.came_back and self._mqtt.twin.about:  # a person's off would hold until the next plug-in
            return replace(reading, changed_by_other=None, changed_over="")
        return reading

    def _fresh(self, meter: bool) -> bool:
        return self.plug.fresh(self._clock.monotonic(), meter)

    def send(self, commands: Commands) -> None:
        """Raises PlugTimeout when the broker is away."""
        for topic, payload in commands:
            if not self._mqtt.publish(topic, payload.encode(), qos=1):
                raise self._unreachable()
        if not commands and not self._mqtt.connected:
            raise self._unreachable()

    def _unreachable(self) -> PlugTimeout:
        return PlugTimeout(f"{self.name} is out of reach: no broker ({self._mqtt.refusal or 'not connected yet'})")

    def exchange(self, commands: Commands, done: Callable[[], bool], tries: int, patience_s: float) -> bool:
        """Say it until it is done. Raises PlugTimeout when the broker is away."""
        for _ in range(tries):
            self.send(commands)
            until_s = self._clock.monotonic() + patience_s
            while (left_s := until_s - self._clock.monotonic()) > 0.0 and self._mqtt.connected:
                self._clock.wait(self._clock.now() + timedelta(seconds=left_s), self._mail)
                self.listen()
                if done():
                    return True
        return False

    def silence(self, asked: Commands) -> PlugTimeout:
        """What is known of a plug that does not answer to `asked`."""
        at = self.plug.on_at
        heard = f"silent since {iso(at)}" if at else "has not answered yet" if asked else "has said nothing yet"
        objection = self._mqtt.objections.get(asked[0][0]) if asked else None
        why = f"; {asked[0][0]}: {objection}" if objection else ""
        broker = "connected" if self._mqtt.connected else "away"
        return PlugTimeout(f"{self.name} {heard} ({self.last_word}; broker {broker}){why}")

    def at(self, moment_s: float) -> datetime | None:
        """The wall time of a monotonic moment, now at the earliest; None for never, and without a broker."""
        if moment_s == -DAWN or not self._mqtt.connected:
            return None
        return self._clock.now() + timedelta(seconds=max(moment_s - self._clock.monotonic(), 0.0))
