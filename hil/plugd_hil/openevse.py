"""An OpenEVSE charger as a state machine without I/O: its WiFi gateway over MQTT, with claims and a manual override.

Shapes after the ESP32 firmware: `docs/mqtt.md`, `mqtt.cpp`, `input.cpp`: one topic a value every 30 s and some of them
on a change of state; `amp` in mA, `wh` in Wh; the claim and the override retained; a retained announcement with a will.
"""

import json
from datetime import timedelta
from typing import Any

from plugd_hil.outlet import Said
from plugd_hil.socket import Socket

VOLTAGE_V = 230.0
LEAST_A = 6
NOT_CONNECTED, CONNECTED, CHARGING, ASLEEP = 1, 2, 3, 254
FLOWING_KW = 0.05
DEVICE = "c44f330d55ad"
SETTLE = timedelta(seconds=2)
"""A car follows the pilot in a few seconds; the load here does at once, and is told then."""


class OpenEvseCharger:
    """Implements `plugd_hil.socket.Plug`."""

    def __init__(self, topic: str, board: Socket, *, period_s: float = 30.0) -> None:
        """Its own limit is what the board offers, in whole amperes. On a board that is on, nobody has claimed it."""
        self.topic = topic
        self.muted = False
        self._max_a = int(board.meter.power_kw * 1000.0 / VOLTAGE_V + 1e-6)
        self.board = board
        self._period = timedelta(seconds=period_s)
        self._settle = min(SETTLE, self._period)
        self._claim: dict[str, Any] | None = None if board.on else {"state": "disabled", "auto_release": False}
        self._override: dict[str, Any] | None = None
        self._session_kwh = 0.0
        self._state = self._now_state()
        self._obey()

    @property
    def listens(self) -> tuple[str, ...]:
        """Claims and overrides."""
        return f"{self.topic}/claim/set", f"{self.topic}/override/set"

    @property
    def will(self) -> Said:
        """Its last will: it names the device, not the base topic."""
        return self._announcement("disconnected")

    def _announcement(self, state: str, **more: str) -> Said:
        said = {"state": state, "id": DEVICE, "name": "openevse-55ad", **more}
        return Said("openevse/announce/55ad", json.dumps(said), retain=True)

    # -- broker, mains, hands ---------------------------------------------------------------------

    def connected(self) -> list[Said]:
        """The network lets it reach its broker again."""
        return self._online_again() if self.board.powered else []

    def _online_again(self) -> list[Said]:
        self.board.online = True
        self.board.soon(self._period, self._telemetry)
        self._obey()
        birth = self._announcement("connected", mqtt=self.topic, http="http://192.168.1.43/")
        return [] if self.muted else [birth, *self._claims()]

    def cut(self, length: timedelta = timedelta(seconds=5)) -> list[Said]:
        """The mains fail: claim and override are forgotten, and it charges."""
        self._claim = self._override = None
        will = self.will
        return self.board.cut(length, self._online_again, lambda: [will], lambda _: True)

    def press(self) -> list[Said]:
        """A person presses its button: a manual override, the other way round."""
        state = "disabled" if self.board.on else "active"
        self._override = {"state": state, "auto_release": True}
        return self._obey() + self._claims()

    # -- what flows -------------------------------------------------------------------------------

    def _obey(self) -> list[Said]:
        """The override counts, else the claim, else it charges; a change of state is told at once."""
        word = self._override or self._claim or {"state": "active"}
        amps = min(word.get("charge_current", self._max_a), self._max_a)
        self.board.meter.power_kw = max(amps, LEAST_A) * VOLTAGE_V / 1000.0
        self.board.switch(word.get("state") == "active")
        return self.load_changed()

    def load_changed(self) -> list[Said]:
        """The car comes, goes, follows the pilot or stops taking power."""
        until = self.board.steady_until()
        self.board.after(until - self.board.now if until else None, self.load_changed)
        self.board.soon(self._settle, self._settled)
        before, self._state = self._state, self._now_state()
        if before == self._state:
            return []
        if before == NOT_CONNECTED:
            self._session_kwh = self.board.total_kwh
        return self._say("state", "flags", "vehicle", "status", "amp", "voltage", "manual_override")

    def _settled(self) -> list[Said]:
        return self._say("amp", "voltage", "pilot", "wh", "session_energy", "total_energy")

    def _now_state(self) -> int:
        offered_kw = self.board.meter.power_kw
        if not self.board.on:
            return ASLEEP
        if self.board.draws_kw() > FLOWING_KW:
            return CHARGING
        return CONNECTED if self.board.meter.load.draws_kw(offered_kw) > 0.0 else NOT_CONNECTED

    # -- what it says and is told -----------------------------------------------------------------

    def _telemetry(self) -> list[Said]:
        self.board.after(self._period, self._telemetry)
        return self._say(*self._values())

    def _values(self) -> dict[str, Any]:
        power_kw = self.board.draws_kw()
        return {
            "amp": round(1e6 * power_kw / VOLTAGE_V, 1), "voltage": VOLTAGE_V,
            "pilot": round(1000.0 * self.board.meter.power_kw / VOLTAGE_V),
            "wh": round(1000.0 * self.board.total_kwh, 3),
            "session_energy": round(1000.0 * (self.board.total_kwh - self._session_kwh), 1),
            "total_energy": round(self.board.total_kwh, 6), "temp": 284, "temp1": 284, "temp2": "false",
            "state": self._state, "status": "active" if self.board.on else "disabled", "flags": 256,
            "vehicle": int(self._state in (CONNECTED, CHARGING)), "colour": 6,
            "manual_override": int(self._override is not None), "freeram": 167436, "divertmode": 1, "srssi": -61,
        }  # fmt: skip

    def _say(self, *names: str) -> list[Said]:
        if self.muted or not self.board.online:
            return []
        values = self._values()
        return [Said(f"{self.topic}/{name}", str(values[name])) for name in names]

    def _claims(self) -> list[Said]:
        if self.muted or not self.board.online:
            return []
        held = {"claim": self._claim, "override": self._override}
        return [Said(f"{self.topic}/{n}", json.dumps(c or {"state": "null"}), retain=True) for n, c in held.items()]

    def handle(self, topic: str, payload: bytes) -> list[Said]:
        """A claim, an override, or the end of one."""
        if self.muted or not self.board.online:
            return []
        word, name = payload.decode("utf-8", "replace"), topic.split("/")[-2]
        before = self._claim if name == "claim" else self._override
        if word in ("release", "clear"):
            after = None
        else:
            try:
                said = json.loads(word)
            except ValueError:
                return []
            if not isinstance(said, dict):
                return []
            after = {**(before or {}), **said}
        if name == "claim":
            self._claim = after
        else:
            self._override = after
        return self._claims() + self._obey() if after != before else []
