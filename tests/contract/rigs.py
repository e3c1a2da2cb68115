"""The implementations of `plugd.ports.Plug` under test, each with the hands to do to it what the world does."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import timedelta
from functools import partial
from typing import Protocol

from plugd import daemon
from plugd.adapters.clock import SystemClock
from plugd.adapters.mqtt import Broker, MqttConnection
from plugd.config import parse
from plugd.domain import Reading, Relay, Setpoint, Wanted
from plugd.errors import PlugTimeout
from plugd.ports import Clock, Plug
from plugd_hil.broker import Mosquitto
from plugd_hil.plug import parser as stub_parser
from plugd_hil.plug import plug_at
from tests.contract.can_rig import can_slcan
from tests.fakes import FakeCharger, FakeClock, FakePlug
from tests.programs import environment
from tests.wire import Wire, WireClock

KINDS = ("tasmota", "shelly2", "openevse", "mqtt", "shelly1", "zigbee2mqtt", "esphome")
POWER_KW = 50.0
"""Then a second of charging shows on a meter that counts in Wh."""
DEAD_MAN_S = 1.0
"""Short enough to be lived through, long enough for an answer."""


class Rig(Protocol):
    """A plug with the world around it. The car is connected, half full."""

    plug: Plug
    clock: Clock
    dead_man_s: float
    metered: bool
    """Whether it tells power and energy."""

    def press(self) -> None:
        """A person presses the button."""

    def cut(self) -> None:
        """The mains fail for a moment."""

    def mute(self) -> None:
        """It says nothing any more."""

    def jam(self) -> None:
        """It answers, and does not do as told."""

    def pause(self, until: Callable[[], bool], longest_s: float) -> None:
        """Let time pass until something is so, or the time is over."""


def order(rig: Rig, on: bool, held: bool = False) -> Wanted:
    """On at full power, or off, in this plug's own words."""
    capability = rig.plug.capability
    if not capability.modulating:
        return Relay(on, held)
    return Setpoint(capability.power_max_kw if on else 0.0, rig.clock.now() + timedelta(hours=1))


def eventually(rig: Rig, so: Callable[[Reading], bool], longest_s: float) -> Reading:
    """The first reading that is so; the last one where none is. Silence meanwhile is only that."""
    readings: list[Reading] = []

    def look() -> bool:
        try:
            readings.append(rig.plug.read())
        except PlugTimeout:  # it is away, or has only come back
            return False
        return so(readings[-1])

    if not look():
        rig.pause(look, longest_s)
    return readings[-1]


class FakeRig:
    """A fake on a fake clock."""

    def __init__(self, fake: FakePlug | FakeCharger, clock: FakeClock) -> None:
        self.plug: Plug = fake
        self.clock: Clock = clock
        self.dead_man_s = 3600.0
        self.metered = True
        self._fake = fake

    def press(self) -> None:
        """Plugs have a button."""
        if isinstance(self._fake, FakePlug):
            self._fake.press()

    def cut(self) -> None:
        """Plugs tell."""
        if isinstance(self._fake, FakePlug):
            self._fake.cut()

    def mute(self) -> None:
        """Say nothing."""
        self._fake.silent = True

    def jam(self) -> None:
        """Do nothing."""
        self._fake.stuck = True

    def pause(self, until: Callable[[], bool], longest_s: float) -> None:
        """A hundred steps."""
        for _ in range(100):
            self.clock.wait(self.clock.now() + timedelta(seconds=longest_s / 100.0))
            if until():
                return


class StubPlug:
    """The stub plug's program, and the wire to its stdin."""

    def __init__(self, broker: Mosquitto, *options: str) -> None:
        """Returns once the stub is at the broker."""
        at = f"{broker.host}:{broker.port}"
        self._process = subprocess.Popen(
            [sys.executable, "-m", "plugd_hil.plug", "--broker", at, "--stdin", *options],
            env=environment(),  # wherever the libraries are
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._process.stdout is None or not json.loads(self._process.stdout.readline())["ready"]:
            raise RuntimeError("the stub plug is not ready")

    def tell(self, line: str) -> None:
        """Something happens in its world."""
        if self._process.stdin is None:
            raise RuntimeError("the stub plug was started without a pipe")
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()

    def close(self) -> int:
        """Ends it. Returns its exit status."""
        self._process.communicate(timeout=10.0)
        return self._process.returncode


class StubRig:
    """An adapter, a real broker, and the stub plug in a process of its own. Time is real."""

    def __init__(
        self, stub: StubPlug, plug: Plug, clock: SystemClock, connection: MqttConnection, metered: bool
    ) -> None:
        self.plug = plug
        self.metered = metered
        self.clock: Clock = clock
        self.dead_man_s = DEAD_MAN_S
        self.connection = connection
        self.stub = stub

    def press(self) -> None:
        """The button."""
        self.stub.tell("press")

    def cut(self) -> None:
        """The mains."""
        self.stub.tell("cut 0")

    def mute(self) -> None:
        """Its Wi-Fi hangs."""
        self._tell("mute")

    def jam(self) -> None:
        """Its relay is stuck, or locked."""
        self._tell("jam")

    def _tell(self, order: str) -> None:
        self.stub.tell(order)
        self.clock.wait(self.clock.now() + timedelta(seconds=0.2))

    def pause(self, until: Callable[[], bool], longest_s: float) -> None:
        """Until a message makes it so."""
        end = self.clock.now() + timedelta(seconds=longest_s)
        while self.clock.now() < end and not until():
            self.clock.wait(end, self.connection)


def fake_plug(_broker: Callable[[], Mosquitto]) -> Iterator[Rig]:
    """The fake of a plug."""
    clock = FakeClock()
    yield FakeRig(FakePlug(clock), clock)


def fake_charger(_broker: Callable[[], Mosquitto]) -> Iterator[Rig]:
    """The fake of a charger."""
    clock = FakeClock()
    yield FakeRig(FakeCharger(clock), clock)


def stubbed(kind: str, more: str = "") -> Callable[[Callable[[], Mosquitto]], Iterator[Rig]]:
    """The adapter of this kind, as the daemon builds it from a configuration with `more` keys, and its stub."""

    def rig(broker: Callable[[], Mosquitto]) -> Iterator[Rig]:
        at = broker()
        hasty_telling = () if kind == "tasmota" else ("--tele-period", "1")
        stub = StubPlug(at, "--dialect", kind, "--power", str(POWER_KW), "--soc", "50", *hasty_telling)
        clock = SystemClock()
        connection = MqttConnection(Broker(at.host, at.port), "plugd-contract")
        # The configuration asks for no dead-man of a second, which no house could live with.
        config = parse(f'[plug]\nkind = "{kind}"\ntopic = "ev-plug"\npower_kw = {POWER_KW}\n{more}')
        hasty = config.plug.model_copy(update={"dead_man_s": DEAD_MAN_S})
        adapter = daemon.plug_for(config.model_copy(update={"plug": hasty}), connection, clock)
        connection.start()
        connection.wait_connected(5.0)
        yield StubRig(stub, adapter, clock, connection, metered=not more)
        connection.close()
        clock.close()
        stub.close()

    return rig


class WireRig:
    """The same adapter and stub in one process, hand to hand: simulated time, no broker."""

    def __init__(self, wire: Wire, plug: Plug, metered: bool) -> None:
        self.plug = plug
        self.clock: Clock = WireClock(wire)
        self.dead_man_s = 3600.0
        self.metered = metered
        self._wire = wire

    def press(self) -> None:
        """The button."""
        self._wire.say(self._wire.stub.press())

    def cut(self) -> None:
        """The mains."""
        self._wire.say(self._wire.stub.cut(timedelta(0)))

    def mute(self) -> None:
        """Its Wi-Fi hangs."""
        self._wire.stub.muted = True

    def jam(self) -> None:
        """Its relay is stuck, or locked."""
        self._wire.stub.board.jammed = True

    def pause(self, until: Callable[[], bool], longest_s: float) -> None:
        """A hundred steps."""
        for _ in range(100):
            self.clock.wait(self.clock.now() + timedelta(seconds=longest_s / 100.0))
            if until():
                return


def wired(kind: str, more: str = "") -> Callable[[Callable[[], Mosquitto]], Iterator[Rig]]:
    """As `stubbed`, on a wire."""

    def rig(_broker: Callable[[], Mosquitto]) -> Iterator[Rig]:
        options = stub_parser().parse_args(["--dialect", kind, "--power", str(POWER_KW), "--tele-period", "1"])
        wire = Wire(partial(plug_at, options=options))
        config = parse(f'[plug]\nkind = "{kind}"\ntopic = "ev-plug"\npower_kw = {POWER_KW}\n{more}')
        yield WireRig(wire, daemon.plug_for(config, wire, WireClock(wire)), metered=not more)

    return rig


BARE = "a relay without a meter"
NO_METER = '[plug.mqtt]\npower_topic = ""\nenergy_topic = ""\n'
RIGS = {
    "fake plug": fake_plug,
    "fake charger": fake_charger,
    **{kind: stubbed(kind) for kind in KINDS},
    BARE: stubbed("mqtt", NO_METER),
    "can slcan": can_slcan,
    **{f"{kind} on a wire": wired(kind) for kind in KINDS},
    f"{BARE} on a wire": wired("mqtt", NO_METER),
}
WITH_DEAD_MAN = ("fake plug", "tasmota", "shelly2", "tasmota on a wire", "shelly2 on a wire")
WITHOUT_DEAD_MAN = tuple(name for name in RIGS if name not in WITH_DEAD_MAN)
WITH_BUTTON = tuple(name for name in RIGS if name not in ("fake charger", "can slcan"))
OVER_A_BROKER = (*KINDS, BARE)
SLOW = tuple(kind for kind in OVER_A_BROKER if kind != "tasmota")
"""Over a real broker in real time only with --every-plug, but for what is quick; on a wire in every run."""
