"""Relays that differ in nothing but their words: topics, payloads, JSON keys, units. A table of presets.

Sources: Shelly Gen1 API pages (MQTT: relay, announce); zigbee2mqtt.io (MQTT topics and messages); esphome.io (MQTT
client, switch, sensor). None of the three has a timer over MQTT that switches ON again: Zigbee's `on_time` and
`off_wait_time` only ever switch off.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from plugd.adapters.mqtt import Message, Retained
from plugd.adapters.plug_line import Commands
from plugd.adapters.plug_words import MAX_ENERGY_KWH, MAX_POWER_KW, Heard, bounded, document, number
from plugd.units import from_w, from_wh, from_wmin

KW: dict[str, Callable[[float], float]] = {"W": from_w, "kW": float}
KWH: dict[str, Callable[[float], float]] = {"kWh": float, "Wh": from_wh, "Wmin": from_wmin}


@dataclass(frozen=True, slots=True)
class Words:
    """What one kind of plug says and is told, and where; `{topic}` is its own. Empty: it has none of that.

    A key names a value in a JSON object, with dots for objects within; without one the payload is the value.
    """

    command_topic: str = "{topic}/set"
    command_on: str = "ON"
    command_off: str = "OFF"
    state_topic: str = "{topic}/state"
    state_key: str = ""
    state_on: str = "ON"
    state_off: str = "OFF"
    power_topic: str = "{topic}/power"
    power_key: str = ""
    power_unit: str = "W"
    energy_topic: str = "{topic}/energy"
    energy_key: str = ""
    energy_unit: str = "kWh"
    availability_topic: str = "{topic}/availability"
    online: str = "online"
    offline: str = "offline"
    ask_topic: str = ""
    ask_payload: str = ""
    on_change: bool = True
    """It tells its relay's state when that changes, retained or not, and not in answer to every command."""


UNKNOWN = ("", "nan", "NaN")
MAX_RAW = 1e15
TRIPPED = {"overpower": False}
"""A state by which a plug says that it has switched itself off."""
PRESETS = {
    "mqtt": Words(),
    "shelly1": Words(
        command_topic="shellies/{topic}/relay/0/command",
        command_on="on",
        command_off="off",
        state_topic="shellies/{topic}/relay/0",
        state_on="on",
        state_off="off",
        power_topic="shellies/{topic}/relay/0/power",
        energy_topic="shellies/{topic}/relay/0/energy",
        energy_unit="Wmin",
        availability_topic="shellies/{topic}/online",
        online="true",
        offline="false",
        ask_topic="shellies/{topic}/command",
        ask_payload="update",
        on_change=False,
    ),
    "zigbee2mqtt": Words(
        command_topic="{topic}/set",
        command_on='{"state":"ON"}',
        command_off='{"state":"OFF"}',
        state_topic="{topic}",
        state_key="state",
        power_topic="{topic}",
        power_key="power",
        energy_topic="{topic}",
        energy_key="energy",
        ask_topic="{topic}/get",
        ask_payload='{"state":""}',
        on_change=False,
    ),
    "esphome": Words(
        command_topic="{topic}/switch/relay/command",
        state_topic="{topic}/switch/relay/state",
        power_topic="{topic}/sensor/power/state",
        energy_topic="{topic}/sensor/energy/state",
        availability_topic="{topic}/status",
    ),
}


class Plain:
    """Implements `plugd.adapters.switched.Dialect`."""

    dead_man = False
    tells_uptime = False

    def __init__(self, topic: str, words: Words) -> None:
        """`topic` is the plug's own."""
        self._words = words
        self._at = {
            name: getattr(words, f"{name}_topic").replace("{topic}", topic)
            for name in ("command", "state", "power", "energy", "availability", "ask")
        }

    @property
    def on_change(self) -> bool:
        """Whether it tells its relay's state when that changes, and only then."""
        return self._words.on_change

    @property
    def meter(self) -> bool:
        """Whether it counts energy."""
        return bool(self._at["energy"])

    def filters(self) -> tuple[tuple[str, Retained], ...]:
        """Each topic once; what the broker keeps of those that count while it is online."""
        kept = {self._at["availability"], self._at["state"] if self.on_change else ""}
        told = dict.fromkeys(self._at[name] for name in ("state", "power", "energy", "availability") if self._at[name])
        return tuple((topic, Retained.REPLAYED if topic in kept else Retained.LIVE) for topic in told)

    def status(self) -> Commands:
        """What asks for everything, where something does."""
        return ((self._at["ask"], self._words.ask_payload),) if self._at["ask"] else ()

    def switch(self, on: bool, timer_s: float | None) -> Commands:
        """It has no timer."""
        return ((self._at["command"], self._words.command_on if on else self._words.command_off),)

    def hear(self, message: Message) -> Heard:
        """Each part of a message that is known by its topic."""
        words, topic = self._words, message.topic
        if topic == self._at["availability"]:
            return Heard(online=self._online(message.payload))
        kept = message.retain and self.on_change and topic == self._at["state"]
        if message.retain and not kept:
            return Heard()
        said = _Said(message.payload)
        power_kw, energy_kwh, nonsense = None, None, 0
        if topic == self._at["power"]:
            power_kw, nonsense = said.measured(words.power_key, KW[words.power_unit], MAX_POWER_KW)
        if topic == self._at["energy"]:
            energy_kwh, bad = said.measured(words.energy_key, KWH[words.energy_unit], MAX_ENERGY_KWH)
            nonsense += bad
        state = said.word(words.state_key) if topic == self._at["state"] else ""
        on = {words.state_on: True, words.state_off: False, **TRIPPED}.get(state)
        return Heard(
            on=on,
            metered=power_kw is not None or energy_kwh is not None or nonsense > 0,
            partial=power_kw is None or energy_kwh is None,
            power_kw=power_kw,
            energy_kwh=energy_kwh,
            answer=on is not None,
            errors=None if on is None else ("overpower",) if state in TRIPPED else (),
            kept=kept,
            nonsense=nonsense,
        )

    def _online(self, payload: bytes) -> bool | None:
        """A word, or (Zigbee2MQTT from 1.34 on) a JSON object with it."""
        said = _Said(payload)
        word = said.word("") if said.json is None else said.word("state")
        return {self._words.online: True, self._words.offline: False}.get(word)


class _Said:
    """A payload, as a plain word and as JSON."""

    def __init__(self, payload: bytes) -> None:
        self._text = payload.decode("utf-8", "replace").strip()
        self.json = document(payload) if self._text.startswith("{") else None

    def _value(self, key: str) -> Any:
        """What stands under a dotted key, None where nothing does."""
        found: Any = self.json
        for part in key.split("."):
            found = found.get(part) if isinstance(found, dict) else None
        return found

    def word(self, key: str) -> str:
        """A word; empty where there is none."""
        value = self._value(key) if key else self._text
        return value if isinstance(value, str) else str(value).lower() if isinstance(value, bool | int) else ""

    def measured(self, key: str, convert: Callable[[float], float], most: float) -> tuple[float | None, int]:
        """A number, converted, and 1 where it cannot be. Not known yet (`nan`, null, missing) is no nonsense."""
        value = self._value(key) if key else self._text
        if value is None or value in UNKNOWN:
            return None, 0
        found, bad = bounded(number(value) if isinstance(value, str) else value, MAX_RAW)
        return (None, bad) if found is None else bounded(convert(found), most)
