"""A Shelly plug of the second generation (Plus Plug) as a state machine without I/O: RPC over MQTT, firmware 1.x.

Shapes after the vendor's API pages: RPC protocol, MQTT, Switch, Sys. As shipped: `rpc_ntf` on, `status_ntf` off.
"""

import json
from datetime import datetime, timedelta
from typing import Any

from plugd.units import to_w
from plugd_hil.outlet import Said
from plugd_hil.socket import Socket

VOLTAGE_V = 230.0
SETTLE = timedelta(seconds=1)
"""From a change of load to its notification."""
INVALID, UNKNOWN, NO_SUCH = -103, 404, -105
Call = dict[str, Any]


class Refused(Exception):
    """An error reply."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Shelly2Plug:
    """Implements `plugd_hil.socket.Plug`."""

    def __init__(self, topic: str, board: Socket, *, initial_state: str = "on", energy_period_s: float = 60.0) -> None:
        """It connects to its broker when told so by `connected`."""
        self.topic = topic
        self.muted = False
        self.board = board
        self._initial_state = initial_state
        self._period = timedelta(seconds=energy_period_s)
        self._source = "init"
        self._timer: tuple[datetime, float] | None = None
        self._told_w = 0.0
        self._minute_kwh = self.board.total_kwh
        self._by_minute_mwh = [0.0, 0.0, 0.0]
        self._errors: list[str] = []

    @property
    def listens(self) -> tuple[str, ...]:
        """RPC, and the plain commands."""
        return f"{self.topic}/rpc", f"{self.topic}/command/switch:0"

    @property
    def will(self) -> Said:
        """Its last will."""
        return Said(f"{self.topic}/online", "false", retain=True)

    # -- broker, mains, hands ---------------------------------------------------------------------

    def connected(self) -> list[Said]:
        """The network lets it reach its broker again."""
        return self._online_again() if self.board.powered else []

    def _online_again(self) -> list[Said]:
        self.board.online = True
        self.board.soon(self._period, self._minute)
        self.load_changed()
        return self._say(self.will.topic, "true", retain=True)

    def cut(self, length: timedelta = timedelta(seconds=5)) -> list[Said]:
        """The mains fail; `initial_state` says how it comes back."""
        self._timer, self._source, self._errors = None, "init", []
        state = {"on": True, "off": False}.get(self._initial_state)
        will = self.will
        return self.board.cut(
            length, self._online_again, lambda: [will], lambda saved: saved if state is None else state
        )

    def press(self) -> list[Said]:
        """A person presses the button; a running timer ends."""
        return self._switch(not self.board.on, "button", None)

    def overpower(self) -> list[Said]:
        """It protects itself."""
        self._errors = ["overpower"]
        self.board.switch(False)
        self._timer = None
        return self._notify(id=0, output=False, errors=self._errors, source="overpower")

    # -- the relay --------------------------------------------------------------------------------

    def _switch(self, on: bool, source: str, timer_s: float | None) -> list[Said]:
        moved = self.board.switch(on)
        self._source, self._errors = source, []
        self._timer = None if timer_s is None else (self.board.now, timer_s)
        self.board.after(None if timer_s is None else timedelta(seconds=timer_s), self._timer_over)
        self.load_changed()
        return self._notify(id=0, output=self.board.on, source=source, **self._timing()) if moved or self._timer else []

    def _timer_over(self) -> list[Said]:
        return self._switch(not self.board.on, "timer", None)

    def _timing(self) -> dict[str, float]:
        if self._timer is None:
            return {}
        return {"timer_started_at": round(self._timer[0].timestamp(), 2), "timer_duration": self._timer[1]}

    def load_changed(self) -> list[Said]:
        """Power is told a second after it has changed."""
        until = self.board.steady_until()
        self.board.after(until - self.board.now if until else None, self.load_changed)
        if abs(to_w(self.board.draws_kw()) - self._told_w) > 0.05:
            self.board.soon(SETTLE, self._tell_power)
        return []

    def _tell_power(self) -> list[Said]:
        self._told_w = to_w(self.board.draws_kw())
        return self._notify(id=0, apower=self._told_w, current=round(self._told_w / VOLTAGE_V, 3))

    def _minute(self) -> list[Said]:
        """While something flows, the energy of each minute is told."""
        self.board.after(self._period, self._minute)
        gone_mwh = 1e6 * (self.board.total_kwh - self._minute_kwh)
        self._minute_kwh = self.board.total_kwh
        before = self._by_minute_mwh
        self._by_minute_mwh = [round(gone_mwh, 3), *before[:2]]
        return self._notify(id=0, aenergy=self._energy()) if gone_mwh or before[0] else []

    # -- what it says -----------------------------------------------------------------------------

    def _energy(self) -> dict[str, Any]:
        total_wh, minute = round(1000.0 * self.board.total_kwh, 3), int(self.board.now.timestamp()) // 60 * 60
        return {
            "total": total_wh,
            "by_minute": self._by_minute_mwh,
            "minute_ts": minute,
        }

    def _status(self) -> dict[str, Any]:
        power_w = to_w(self.board.draws_kw())
        errors = {"errors": self._errors} if self._errors else {}
        return {
            "id": 0, "source": self._source, "output": self.board.on, **self._timing(), "apower": power_w,
            "voltage": VOLTAGE_V, "current": round(power_w / VOLTAGE_V, 3), "freq": 50.0, "aenergy": self._energy(),
            "temperature": {"tC": 41.2, "tF": 106.2}, **errors,
        }  # fmt: skip

    def _say(self, topic: str, text: str, retain: bool = False) -> list[Said]:
        return [] if self.muted or not self.board.online else [Said(topic, text, retain)]

    def _notify(self, **changed: Any) -> list[Said]:
        params = {"ts": round(self.board.now.timestamp(), 2), "switch:0": changed}
        frame = {"src": self.topic, "dst": f"{self.topic}/events", "method": "NotifyStatus", "params": params}
        return self._say(f"{self.topic}/events/rpc", json.dumps(frame))

    # -- what it is told --------------------------------------------------------------------------

    def handle(self, topic: str, payload: bytes) -> list[Said]:
        """A call, or a plain command."""
        if self.muted or not self.board.online:
            return []
        if topic.endswith("/command/switch:0"):
            word = payload.decode("utf-8", "replace")
            wanted = {"on": True, "off": False, "toggle": not self.board.on}.get(word)
            return [] if wanted is None else self._switch(wanted, "MQTT", None)
        try:
            call = json.loads(payload)
            number, source, method = call["id"], call["src"], call["method"]
        except (ValueError, TypeError, KeyError):
            return []
        frame = {"id": number, "src": self.topic, "dst": source}
        try:
            said, result = self._called(method, call.get("params") or {})
            answer = {**frame, "result": result}
        except Refused as refused:
            said, answer = [], {**frame, "error": {"code": refused.code, "message": str(refused)}}
        return [*self._say(f"{source}/rpc", json.dumps(answer)), *said]

    def _called(self, method: str, params: Call) -> tuple[list[Said], Call]:
        if method == "Sys.GetStatus":
            return [], {"mac": "A8032ABE54DC", "restart_required": False, "uptime": self.board.uptime_s()}
        if method not in ("Switch.GetStatus", "Switch.Set", "Switch.Toggle"):
            raise Refused(UNKNOWN, f"No handler for {method}")
        if params.get("id") != 0:
            raise Refused(NO_SUCH, f"Argument 'id', value {params.get('id')} not found!")
        if method == "Switch.GetStatus":
            return [], self._status()
        on, after = params.get("on", not self.board.on), params.get("toggle_after")
        if not isinstance(on, bool):
            raise Refused(INVALID, "Invalid argument 'on'!")
        if after is not None and (isinstance(after, bool) or not isinstance(after, int | float) or after < 0):
            raise Refused(INVALID, "Invalid argument 'toggle_after'!")
        was_on = self.board.on
        return self._switch(on, "MQTT", after or None), {"was_on": was_on}
