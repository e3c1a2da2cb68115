"""An OpenEVSE charger (WiFi gateway, firmware 4 and later) over MQTT: a claim with a charge current.

The claim stands below a person's manual override, at the charger or its page, and above its own schedule; it has no
time limit, so that a charger that plugd has paused stays paused when plugd dies: there is no dead-man. The gateway
forgets it when it restarts, and then charges. It tells everything every 30 s, its state and our claim when they change,
and cannot be asked. `amp` is in mA, `wh` in Wh (ESP32 firmware `mqtt.cpp`, `input.cpp`, `emonesp.h`).
"""

import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime

from plugd.adapters.mqtt import Message, MqttConnection, Retained
from plugd.adapters.plug_line import CONFIRM_S, CONFIRM_TRIES, PlugLine
from plugd.adapters.plug_memory import PlugMemory
from plugd.adapters.plug_words import MAX_ENERGY_KWH, MAX_POWER_KW, Heard, bounded, document, number
from plugd.domain import Capability, Fault, Reading, Relay, Setpoint, Wanted
from plugd.errors import PlugError, PlugFault, PlugRefused
from plugd.ports import Clock
from plugd.units import amps_of, from_w, from_wh, kw_of

LEAST_A = 6
"""A pilot signal can offer no less, but nothing (IEC 61851)."""
MAX_A, MAX_V = 100.0, 500.0
FOREVER = datetime.max.replace(tzinfo=UTC)
ENABLED = (1, 2, 3)
PAUSED = (0, 254, 255)
"""Starting, asleep, disabled."""
TROUBLE = {
    4: "a vent is required", 5: "the diode check failed", 6: "ground fault (GFCI)", 7: "no ground",
    8: "its relay is stuck", 9: "the ground-fault self-test failed", 10: "it is too hot", 11: "over current",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Claim:
    """What the charger holds of us: a current in whole amperes, None where it is paused."""

    amps: int | None


class OpenEvse:
    """Implements `plugd.ports.Plug`, as a charger that takes any power in steps of an ampere."""

    def __init__(
        self, connection: MqttConnection, clock: Clock, topic: str, capability: Capability, voltage_v: float = 230.0
    ) -> None:
        """`topic` is its base topic, `capability` in whole amperes (`whole_amps`) at that voltage."""
        self._topic = topic
        self._capability = capability
        self._volts = voltage_v
        self._least_a, self._most_a = (
            round(amps_of(kw, voltage_v)) for kw in (capability.power_min_kw, capability.power_max_kw)
        )
        self._plug = PlugMemory(dead_man_s=None, tells_uptime=False)
        filters = (
            *((f"{topic}/{name}", Retained.LIVE) for name in ("state", "amp", "voltage", "wh", "manual_override")),
            (f"{topic}/claim", Retained.REPLAYED),
            ("openevse/announce/+", Retained.REPLAYED),
        )
        self._line = PlugLine(connection, clock, f"charger {topic}", filters, self._plug, self._hear, self._back)
        self._device: str | None = None
        self._claim: Claim | None = None
        self._state: int | None = None
        self._measured_v = voltage_v
        self._overridden = False

    # -- the port ---------------------------------------------------------------------------------

    @property
    def capability(self) -> Capability:
        """Nothing, or from 6 A up. No dead-man."""
        return self._capability

    def read(self) -> Reading:
        """What it last told; on means that power may flow. Raises PlugTimeout after a minute of silence."""
        return self._line.reading(())

    def set(self, wanted: Wanted) -> None:
        """Claim a current, and wait for it to be taken. Raises PlugRefused, PlugTimeout, PlugFault."""
        setpoint = (
            Setpoint(self._capability.power_max_kw if wanted.on else 0.0, FOREVER)
            if isinstance(wanted, Relay)
            else wanted
        )
        claim = Claim(self._amps(setpoint.power_kw))
        line, plug = self._line, self._plug
        line.listen()
        on = claim.amps is not None

        def done() -> bool:
            return self._claim == claim and plug.on is on

        now_s = line.now()[1]
        if done() and plug.fresh(now_s):
            return
        if self._claim != claim:
            plug.power_kw = None  # what it draws is another thing from now on
        plug.order(on, now_s)
        if not line.exchange(((f"{self._topic}/claim/set", _spoken(claim)),), done, CONFIRM_TRIES, CONFIRM_S):
            raise self._disobedience(claim, now_s)

    def _amps(self, power_kw: float) -> int | None:
        """The nearest whole ampere. Raises PlugRefused for a power that it cannot give."""
        if power_kw == 0.0:
            return None
        amps = round(amps_of(power_kw, self._volts))
        # The nearest may be a little over what was asked; it never is over what is allowed.
        if power_kw < self._capability.power_min_kw - 1e-6 or power_kw > self._capability.power_max_kw + 1e-6:
            offered = f"from {self._least_a} to {self._most_a} A"
            raise PlugRefused(f"{self._line.name}: {power_kw:g} kW is not what it does ({offered}, or nothing)")
        return min(max(amps, self._least_a), self._most_a)

    def _disobedience(self, claim: Claim, since_s: float) -> PlugError:
        plug, name = self._plug, self._line.name
        if self._state in TROUBLE:
            return PlugFault(f"{name}: {TROUBLE[self._state]}; look at it before anything else")
        if not plug.fresh(self._line.now()[1], meter=False) or (self._claim != claim and plug.on_s <= since_s):
            return self._line.silence(((f"{self._topic}/claim/set", ""),))
        if self._overridden:
            return PlugRefused(f"{name} is overridden at the charger or its page; clear the override there")
        return PlugRefused(f"{name} answers but does otherwise; is a limit or another claim set there?")

    def due(self) -> datetime | None:
        """Never: a claim holds until it is changed."""
        return None

    def tend(self, now: datetime) -> None:
        """Nothing to repeat."""
        self._line.listen()

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What a person should mend."""
        trouble = TROUBLE.get(self._state) if self._state is not None else None
        return (Fault("plug_protects", f"{self._line.name}: {trouble}"),) if trouble else ()

    @property
    def nonsense(self) -> int:
        """How many values it has told that could not be."""
        return self._plug.nonsense

    # -- listening --------------------------------------------------------------------------------

    def _back(self) -> None:
        self._plug.back()
        self._claim = None

    def _hear(self, message: Message) -> None:
        tail = message.topic.rsplit("/", 1)[-1]
        if message.topic.startswith("openevse/announce/"):
            self._announced(message)
        elif tail == "claim":
            self._claim = _claimed(message.payload)
        elif not message.retain:
            self._told(tail, number(message.payload.decode("utf-8", "replace").strip()))

    def _told(self, name: str, value: float | None) -> None:
        """One of the values that it tells one by one."""
        heard = Heard()
        if name == "voltage":
            self._measured_v = bounded(value, MAX_V)[0] or self._measured_v
        elif name == "manual_override":
            self._overridden = value == 1.0
        elif name == "amp":
            amps, bad = bounded(None if value is None else value / 1000.0, MAX_A)
            power_kw = None if amps is None else min(from_w(amps * self._measured_v), MAX_POWER_KW)
            heard = Heard(metered=True, partial=True, power_kw=power_kw, nonsense=bad)
        elif name == "wh":
            energy_kwh, bad = bounded(None if value is None else from_wh(value), MAX_ENERGY_KWH)
            heard = Heard(metered=True, partial=True, energy_kwh=energy_kwh, nonsense=bad)
        elif value is not None and value in (*ENABLED, *PAUSED, *TROUBLE):
            self._state = int(value)
            heard = Heard(on=self._state in ENABLED, errors=("fault",) if self._state in TROUBLE else ())
        else:
            heard = Heard(nonsense=1)
        self._plug.absorb(heard, *self._line.now())

    def _announced(self, message: Message) -> None:
        """Its birth names its base topic; its last will only the device."""
        said = document(message.payload) or {}
        device, ours = said.get("id"), said.get("mqtt") == self._topic
        if not isinstance(device, str) or not (ours or device == self._device):
            return
        self._device = device
        connected = said.get("state") == "connected"
        self._line.last_word = "connected" if connected else "disconnected"
        if not connected:
            self._plug.stale()
        elif not message.retain:
            self._plug.back()  # the claim that it tells next is news


def whole_amps(capability: Capability, voltage_v: float) -> Capability:
    """The same in whole amperes, from 6 up: never more than it was, nor less than its least but for that."""
    most_a = max(LEAST_A, math.floor(amps_of(capability.power_max_kw, voltage_v) + 1e-6))
    least_a = min(most_a, max(LEAST_A, math.ceil(amps_of(capability.power_min_kw, voltage_v) - 1e-6)))
    most_kw, least_kw = kw_of(most_a, voltage_v), kw_of(least_a, voltage_v)
    return Capability(most_kw, modulating=True, power_min_kw=least_kw)


def _spoken(claim: Claim) -> str:
    if claim.amps is None:
        return json.dumps({"state": "disabled", "auto_release": False})
    return json.dumps({"state": "active", "charge_current": claim.amps, "auto_release": False})


def _claimed(payload: bytes) -> Claim | None:
    """Our claim as it holds it; None for none, and for one that is not of plugd's making."""
    said = document(payload) or {}
    amps = said.get("charge_current")
    if said.get("state") == "disabled":
        return Claim(None)
    if said.get("state") == "active" and isinstance(amps, int) and not isinstance(amps, bool):
        return Claim(amps)
    return None
