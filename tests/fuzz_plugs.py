"""Payloads at everything that a plug may say: valid ones, changed ones, and noise. `make fuzz`, or a few in a test.

Checked after each: nothing raised; power, energy and uptime are within what a plug can be; what the memory holds can
be read; and whatever was said, a command to the plug is one of the few that plugd knows, within its limits.
"""

import argparse
import json
import random
import resource
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta

from plugd.adapters.mailbox import Message, Retained
from plugd.adapters.mqtt import Broker, Mailbox, MqttConnection
from plugd.adapters.openevse import OpenEvse
from plugd.adapters.plain import PRESETS, Plain, Words
from plugd.adapters.plug_words import MAX_ENERGY_KWH, MAX_POWER_KW
from plugd.adapters.shelly2 import Shelly2
from plugd.adapters.switched import SwitchedPlug
from plugd.adapters.tasmota import Tasmota
from plugd.domain import Capability, Relay, Setpoint
from plugd.errors import PlugError
from plugd.ports import Plug
from tests.fakes import FakeClock

SWITCH = {
    "id": 0, "source": "MQTT", "output": True, "timer_started_at": 1690000000.5, "timer_duration": 3600,
    "apower": 2300.1, "voltage": 231.4, "aenergy": {"total": 1234.5, "by_minute": [1.0, 2.0, 3.0], "minute_ts": 16900},
    "errors": ["overpower"], "temperature": {"tC": 40.1},
}  # fmt: skip
SENSOR = {"Time": "2026-11-22T03:00:00", "ENERGY": {"Total": 12.5, "Power": 2300, "Voltage": 231, "Current": 9.9}}
STATE = {"Time": "2026-11-22T03:00:00", "Uptime": "3T04:05:06", "UptimeSec": 273906, "POWER": "ON"}
CORPUS: dict[str, tuple[tuple[str, object], ...]] = {
    "tasmota": (
        ("tele/p/SENSOR", SENSOR), ("tele/p/STATE", STATE), ("stat/p/STATUS8", {"StatusSNS": SENSOR}),
        ("stat/p/STATUS11", {"StatusSTS": STATE}), ("stat/p/RESULT", {"POWER": "OFF"}), ("stat/p/POWER", "ON"),
        ("stat/p/RESULT", {"PulseTime1": {"Set": 3700, "Remaining": 12}}), ("stat/p/RESULT", {"PowerOnState": 5}),
        ("tele/p/LWT", "Online"), ("cmnd/p/POWER", "ON"),
    ),
    "shelly2": (
        ("me/rpc", {"id": 1, "src": "p", "dst": "me", "result": SWITCH}),
        ("me/rpc", {"id": 2, "src": "p", "dst": "me", "result": {"uptime": 77}}),
        ("me/rpc", {"id": 3, "src": "p", "dst": "me", "error": {"code": -103, "message": "Invalid argument 'on'!"}}),
        ("p/events/rpc", {"src": "p", "method": "NotifyStatus", "params": {"ts": 1.5, "switch:0": SWITCH}}),
        ("p/events/rpc", {"src": "p", "method": "NotifyFullStatus", "params": {"sys": {"uptime": 5}}}),
        ("p/online", "true"),
    ),
    "openevse": (
        ("p/state", "3"), ("p/amp", "9984.5"), ("p/voltage", "231"), ("p/wh", "1234.5"), ("p/manual_override", "0"),
        ("p/claim", {"state": "active", "charge_current": 8, "auto_release": False}), ("p/claim", {"state": "null"}),
        ("openevse/announce/55ad", {"state": "connected", "id": "c44f", "name": "openevse-55ad", "mqtt": "p"}),
        ("openevse/announce/55ad", {"state": "disconnected", "id": "c44f", "name": "openevse-55ad"}),
    ),
    "shelly1": (
        ("shellies/p/relay/0", "on"), ("shellies/p/relay/0", "overpower"), ("shellies/p/relay/0/power", "2300.10"),
        ("shellies/p/relay/0/energy", "123456"), ("shellies/p/online", "true"),
    ),
    "zigbee2mqtt": (
        ("p", {"state": "ON", "power": 2300, "energy": 12.5, "voltage": 231, "current": 9.9, "linkquality": 120}),
        ("p/availability", {"state": "online"}), ("p/availability", "offline"),
    ),
    "esphome": (
        ("p/switch/relay/state", "OFF"), ("p/sensor/power/state", "2300.1"), ("p/sensor/energy/state", "12.5"),
        ("p/sensor/power/state", "nan"), ("p/status", "online"),
    ),
    "mqtt": (
        ("p/state", {"relay": {"is": "on"}, "meter": {"W": 2300, "kWh": 12.5}}), ("p/availability", "online"),
    ),
}  # fmt: skip
NESTED = Words(
    state_key="relay.is", state_on="on", state_off="off", power_topic="{topic}/state", power_key="meter.W",
    energy_topic="{topic}/state", energy_key="meter.kWh",
)  # fmt: skip
WILD: tuple[object, ...] = (
    None, True, False, -1, 0, 1e308, -0.0, 1e-300, 10**30, "", "NaN", "ON", "\x00", "\ud800", "9" * 400, [], {}, [[]],
    {"a": {"b": {}}}, float("nan"), float("inf"), "1e999", "-5", "0x10", "１２", "true",
)  # fmt: skip
LIMITS_S = timedelta(hours=1)


class Line(MqttConnection):
    """A connection without a broker: messages are put into its mailboxes, and what is sent is kept."""

    def __init__(self) -> None:
        super().__init__(Broker(), "me")
        self.connected, self.session = True, 1
        self.sent: list[tuple[str, str]] = []

    def subscribe(self, *filters: str | tuple[str, Retained]) -> Mailbox:
        """The one mailbox of the plug under test."""
        self.mail = super().subscribe(*filters)
        return self.mail

    def publish(self, topic: str, payload: bytes, *, qos: int = 0, retain: bool = False) -> bool:
        """Kept, and never retained."""
        if retain:
            raise AssertionError(f"a retained command on {topic}")
        self.sent.append((topic, payload.decode()))
        return True


@dataclass(frozen=True, slots=True)
class Bench:
    """An adapter on a line of its own."""

    line: Line
    clock: FakeClock
    plug: Plug
    nonsense: Callable[[], int]


def bench(kind: str) -> Bench:
    """The adapter of a kind."""
    line, clock = Line(), FakeClock()
    plug: Tasmota | SwitchedPlug | OpenEvse
    if kind == "tasmota":
        plug = Tasmota(line, clock, "p", 2.3, 3600.0)
    elif kind == "openevse":
        plug = OpenEvse(line, clock, "p", Capability(2.3, modulating=True, power_min_kw=1.38))
    else:
        words = NESTED if kind == "mqtt" else PRESETS.get(kind)
        dialect = Shelly2("p", "me") if words is None else Plain("p", words)
        plug = SwitchedPlug(line, clock, "p", dialect, 2.3, 3600.0)
    return Bench(line, clock, plug, lambda: plug.nonsense)


def mutated(dice: random.Random, said: object) -> bytes:
    """A payload that is nearly valid: a value swapped, a byte changed, cut, doubled; or noise."""
    choice = dice.random()
    if choice < 0.1:
        return dice.randbytes(dice.randrange(64))
    if choice < 0.55:
        said = swapped(dice, said)
    text = said if isinstance(said, str) else json.dumps(said)
    payload = bytearray(text.encode("utf-8", "surrogatepass"))
    if choice >= 0.5 and payload:
        for _ in range(dice.randrange(4)):
            at = dice.randrange(len(payload))
            payload[at : at + dice.randrange(3)] = dice.randbytes(dice.randrange(3))
            if not payload:
                break
        if dice.random() < 0.1:
            payload = payload[: dice.randrange(len(payload) + 1)] * dice.choice((1, 1, 2))
    if choice > 0.995:
        payload = bytearray(dice.choice((b"[" * 4000, b'{"a":' * 700, b"9" * 4000)))
    return bytes(payload)


def swapped(dice: random.Random, said: object) -> object:
    """One value, somewhere within, is another."""
    if isinstance(said, dict) and said and dice.random() < 0.85:
        key = dice.choice(list(said))
        return {**said, key: swapped(dice, said[key])}
    if isinstance(said, list) and said and dice.random() < 0.85:
        at = dice.randrange(len(said))
        return [*said[:at], swapped(dice, said[at]), *said[at + 1 :]]
    return dice.choice(WILD)


def lawful(kind: str, topic: str, payload: str) -> bool:
    """Whether this is a command that plugd may send: of these words, and within the limits."""
    if kind == "tasmota":
        return topic.startswith("cmnd/p/") and payload in TASMOTA
    if kind == "shelly2":
        call = json.loads(payload)
        params = call["params"]
        lawful_call = call["method"] in ("Switch.Set", "Switch.GetStatus", "Sys.GetStatus")
        return topic == "p/rpc" and lawful_call and params.get("toggle_after", 3600.0) == 3600.0
    if kind == "openevse":
        claim = json.loads(payload)
        return topic == "p/claim/set" and (claim["state"] == "disabled" or 6 <= claim["charge_current"] <= 10)
    words = NESTED if kind == "mqtt" else PRESETS[kind]
    return payload in (words.command_on, words.command_off, words.ask_payload)


TASMOTA = (
    "", "ON", "OFF", "11", "8", "3700", "0", "PulseTime1 0; POWER OFF", "PowerOnState 5; PulseTime1 3700",
    "PowerOnState 5; PulseTime1 0",
)  # fmt: skip


def throw(kind: str, payloads: int, seed: int) -> int:
    """Throw them, and look. Returns how many values were nonsense; raises AssertionError for what may not be."""
    dice, under = random.Random(f"{seed}/{kind}"), bench(kind)
    topics = CORPUS[kind]
    asked = [1]
    for number in range(payloads):
        topic, said = dice.choice(topics)
        if topic == "me/rpc" and isinstance(said, dict):
            said = {**said, "id": dice.choice(asked)}
        payload = mutated(dice, said)
        under.line.mail.put(Message(topic, payload, dice.random() < 0.05))
        under.clock.at += timedelta(seconds=dice.choice((0.0, 0.1, 1.0)))
        try:
            under.plug.tend(under.clock.at)
            if number % 16 == 0:
                _look(under)
            if number % 256 == 0:
                _command(dice, under)
        except PlugError as error:
            if not str(error).isprintable() or len(str(error)) > 400:
                raise AssertionError(f"{kind}: an error no person can read after {payload!r}: {error!r}") from error
        for sent in under.line.sent:
            if not lawful(kind, *sent):
                raise AssertionError(f"{kind}: {sent} was sent after {payload!r}")
        if kind == "shelly2":
            asked = [json.loads(sent)["id"] for _, sent in under.line.sent][-4:] or asked
        under.line.sent.clear()
    return under.nonsense()


def _look(under: Bench) -> None:
    reading = under.plug.read()
    if reading.power_kw is not None and not 0.0 <= reading.power_kw <= MAX_POWER_KW:
        raise AssertionError(f"power {reading.power_kw} kW")
    if reading.energy_kwh is not None and not 0.0 <= reading.energy_kwh <= MAX_ENERGY_KWH:
        raise AssertionError(f"energy {reading.energy_kwh} kWh")
    if not all(w.text.isprintable() and len(w.text) < 400 for w in under.plug.warnings):
        raise AssertionError(f"warnings {under.plug.warnings}")


def _command(dice: random.Random, under: Bench) -> None:
    if under.plug.capability.modulating:
        amps = dice.choice((0, 6, 8, 10, 11, 400))
        under.plug.set(Setpoint(amps * 0.23, under.clock.at + LIMITS_S))
    else:
        under.plug.set(Relay(dice.random() < 0.5, held=dice.random() < 0.3))


def run(payloads: int, seed: int) -> Iterator[tuple[str, int, int, float]]:
    """Every kind in turn: (kind, payloads, nonsense values, seconds)."""
    each = payloads // len(CORPUS) + 1
    for kind in CORPUS:
        began = time.perf_counter()
        nonsense = throw(kind, each, seed)
        yield kind, each, nonsense, time.perf_counter() - began


def main() -> int:
    """The program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--payloads", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6))
    options = parser.parse_args()
    print(f"seed {options.seed}")
    total, spent_s = 0, 0.0
    for kind, each, nonsense, seconds in run(options.payloads, options.seed):
        total, spent_s = total + each, spent_s + seconds
        print(f"{kind:12} {each:8} payloads, {nonsense:7} values that cannot be, {seconds:6.1f} s", flush=True)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"{total} payloads in {spent_s:.0f} s, no crash, no command outside the limits; peak {peak_mb:.0f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
