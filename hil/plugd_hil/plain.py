"""Relays of three houses and one of no house, as a state machine without I/O: what each says, when, and how.

Shelly Gen1 (firmware 1.x): plain values on topics of their own, energy in Watt-minutes since boot, all of it every
30 s and on `update`. Zigbee2MQTT: one JSON object for everything, on every change, `set` and `get`, with availability
switched on. ESPHome: retained states on topics of their own, the relay's only when it changes, `nan` for a
sensor that has not measured yet. `mqtt`: a plain device of somebody's own, not retained, some words every 30 s.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from typing import NamedTuple

from plugd.units import to_w
from plugd_hil.outlet import Said
from plugd_hil.socket import Socket

VOLTAGE_V = 230.0


class Told(NamedTuple):
    """What there is to tell. `energy_kwh`: as its meter counts."""

    on: bool
    power_w: float
    energy_kwh: float


@dataclass(frozen=True, slots=True)
class Habits:
    """One kind of plug. Topics are below `{t}`; `relay` and `meter` make messages (tail, payload) of what there is."""

    commands: str
    asks: dict[str, str]
    """By tail: the payload that asks for everything; empty: any."""
    orders: dict[str, str]
    """By payload: on, off or toggle."""
    relay: Callable[[Told], tuple[tuple[str, str], ...]]
    meter: Callable[[Told], tuple[tuple[str, str], ...]]
    presence: tuple[str, str, str]
    """(tail, online, offline), retained."""
    period_s: float | None = 30.0
    settle_s: float = 1.0
    """From a change of load to its message."""
    repeats: bool = True
    """It tells the relay's state after a command that changes nothing, and every period."""
    retains: bool = False
    counts_since_boot: bool = False


def _one_object(told: Told) -> tuple[tuple[str, str], ...]:
    said = {
        "state": _word(told), "power": round(told.power_w, 1), "energy": round(told.energy_kwh, 3),
        "voltage": VOLTAGE_V, "current": round(told.power_w / VOLTAGE_V, 2), "linkquality": 120,
    }  # fmt: skip
    return (("", json.dumps(said)),)


def _word(told: Told) -> str:
    return "ON" if told.on else "OFF"


PLAIN_ORDERS = {"ON": "on", "OFF": "off", "TOGGLE": "toggle"}
HABITS = {
    "shelly1": Habits(
        commands="/relay/0/command",
        asks={"/command": "update"},
        orders={"on": "on", "off": "off", "toggle": "toggle"},
        relay=lambda told: (("/relay/0", "on" if told.on else "off"),),
        meter=lambda told: (
            ("/relay/0/power", f"{told.power_w:.2f}"),
            ("/relay/0/energy", str(int(60000.0 * told.energy_kwh))),
        ),
        presence=("/online", "true", "false"),
        counts_since_boot=True,
    ),
    "zigbee2mqtt": Habits(
        commands="/set",
        asks={"/get": ""},
        orders={json.dumps({"state": word}, separators=(",", ":")): order for word, order in PLAIN_ORDERS.items()},
        relay=_one_object,
        meter=_one_object,
        presence=("/availability", '{"state":"online"}', '{"state":"offline"}'),
        period_s=None,
        settle_s=5.0,
    ),
    "esphome": Habits(
        commands="/switch/relay/command",
        asks={},
        orders=PLAIN_ORDERS,
        relay=lambda told: (("/switch/relay/state", _word(told)),),
        meter=lambda told: (
            ("/sensor/power/state", f"{told.power_w:.1f}"),
            ("/sensor/energy/state", f"{told.energy_kwh:.3f}"),
        ),
        presence=("/status", "online", "offline"),
        repeats=False,
        retains=True,
    ),
    "mqtt": Habits(
        commands="/set",
        asks={},
        orders=PLAIN_ORDERS,
        relay=lambda told: (("/state", _word(told)),),
        meter=lambda told: (("/power", f"{told.power_w:.1f}"), ("/energy", f"{told.energy_kwh:.3f}")),
        presence=("/availability", "online", "offline"),
    ),
}
PREFIXES = {"shelly1": "shellies/"}


class PlainPlug:
    """Implements `plugd_hil.socket.Plug`."""

    def __init__(self, kind: str, topic: str, board: Socket, *, period_s: float | None = None) -> None:
        """It connects to its broker when told so by `connected`."""
        self.muted = False
        self.board = board
        self._habits = HABITS[kind]
        self._base = f"{PREFIXES.get(kind, '')}{topic}"
        every_s = self._habits.period_s and (period_s or self._habits.period_s)
        self._period = timedelta(seconds=every_s) if every_s else None
        self._settle = timedelta(seconds=min(self._habits.settle_s, period_s or self._habits.settle_s))
        self._told_w = 0.0
        self._booted_kwh = 0.0

    @property
    def listens(self) -> tuple[str, ...]:
        """Its commands and questions."""
        return tuple(f"{self._base}{tail}" for tail in (self._habits.commands, *self._habits.asks))

    @property
    def will(self) -> Said:
        """Its last will; Zigbee2MQTT says it itself, where availability is switched on."""
        tail, _, offline = self._habits.presence
        return Said(f"{self._base}{tail}", offline, retain=True)

    # -- broker, mains, hands ---------------------------------------------------------------------

    def connected(self) -> list[Said]:
        """The network lets it reach its broker again."""
        return self._online_again() if self.board.powered else []

    def _online_again(self) -> list[Said]:
        self.board.online = True
        if self._period is not None:
            self.board.soon(self._period, self._telemetry)
        self.load_changed()
        tail, online, _ = self._habits.presence
        return [*self._say(((tail, online),), retain=True), *self._everything()]

    def cut(self, length: timedelta = timedelta(seconds=5)) -> list[Said]:
        """The mains fail; it comes back as it was."""
        if self._habits.counts_since_boot:
            self._booted_kwh = self.board.total_kwh
        will = self.will
        return self.board.cut(length, self._online_again, lambda: [will], lambda saved: saved)

    def press(self) -> list[Said]:
        """A person presses the button."""
        return self._switch(not self.board.on, repeat=False)

    # -- the relay --------------------------------------------------------------------------------

    def _switch(self, on: bool, repeat: bool) -> list[Said]:
        moved = self.board.switch(on)
        self.load_changed()
        return self._tell(self._habits.relay) if moved or repeat else []

    def load_changed(self) -> list[Said]:
        """Power is told a while after it has changed."""
        until = self.board.steady_until()
        self.board.after(until - self.board.now if until else None, self.load_changed)
        if abs(to_w(self.board.draws_kw()) - self._told_w) > 0.05:
            self.board.soon(self._settle, self._tell_power)
        return []

    def _tell_power(self) -> list[Said]:
        self._told_w = to_w(self.board.draws_kw())
        return self._tell(self._habits.meter)

    def _telemetry(self) -> list[Said]:
        self.board.after(self._period, self._telemetry)
        return self._everything() if self._habits.repeats else self._tell(self._habits.meter)

    # -- what it says and is told -----------------------------------------------------------------

    def _told(self) -> Told:
        return Told(self.board.on, to_w(self.board.draws_kw()), self.board.total_kwh - self._booted_kwh)

    def _tell(self, words: Callable[[Told], tuple[tuple[str, str], ...]]) -> list[Said]:
        return self._say(words(self._told()), self._habits.retains)

    def _everything(self) -> list[Said]:
        habits = self._habits
        return self._tell(habits.relay) + (self._tell(habits.meter) if habits.meter is not habits.relay else [])

    def _say(self, said: tuple[tuple[str, str], ...], retain: bool) -> list[Said]:
        if self.muted or not self.board.online:
            return []
        return [Said(f"{self._base}{tail}", payload, retain) for tail, payload in said]

    def handle(self, topic: str, payload: bytes) -> list[Said]:
        """A command or a question."""
        if self.muted or not self.board.online:
            return []
        tail, word = topic.removeprefix(self._base), payload.decode("utf-8", "replace")
        if tail in self._habits.asks:
            return self._everything() if self._habits.asks[tail] in ("", word) else []
        order = self._habits.orders.get(word)
        if order is None:
            return []
        return self._switch(not self.board.on if order == "toggle" else order == "on", self._habits.repeats)
