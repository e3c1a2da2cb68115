"""A Shelly of the second generation or later, by RPC over MQTT, with `toggle_after` as dead-man.

`Switch.Set {"on": false, "toggle_after": N}` is "off, and on again by itself after N s"; each one starts the timer
anew, and one without `toggle_after` ends it. Nothing is written to flash. Status notifications name only what has
changed; energy is in Wh (by the minute in mWh, which is not used).
"""

import json
from collections import deque
from itertools import count
from typing import Any

from plugd.adapters.mqtt import Message, Retained
from plugd.adapters.plug_line import Commands
from plugd.adapters.plug_words import MAX_CURRENT_A, MAX_ENERGY_KWH, MAX_POWER_KW, Heard, bounded, document
from plugd.units import from_w, from_wh

PENDING = 32
"""As many replies are waited for; an older question is not answered any more."""
SETTING, ASKING_RELAY, ASKING_UPTIME = "Switch.Set", "Switch.GetStatus", "Sys.GetStatus"
ONLINE = {b"true": True, b"false": False}
MAX_REASON = 80


class Shelly2:
    """Implements `plugd.adapters.switched.Dialect`."""

    dead_man = True
    tells_uptime = True
    on_change = False
    meter = True

    def __init__(self, topic: str, reply_topic: str) -> None:
        """`topic` is its MQTT prefix; it answers below `reply_topic`, which must be plugd's alone."""
        self._topic = topic
        self._source = reply_topic
        self._ids = count(1)
        self._asked: deque[tuple[int, str]] = deque(maxlen=PENDING)

    def filters(self) -> tuple[tuple[str, Retained], ...]:
        """Replies to us, what it notifies everybody of, and whether it is there."""
        return (
            (f"{self._source}/rpc", Retained.LIVE),
            (f"{self._topic}/events/rpc", Retained.LIVE),
            (f"{self._topic}/online", Retained.REPLAYED),
        )

    def status(self) -> Commands:
        """Relay, meter and timer; and the uptime."""
        return self._call(ASKING_RELAY, id=0), self._call(ASKING_UPTIME)

    def switch(self, on: bool, timer_s: float | None) -> Commands:
        """Switch, then ask how it is."""
        timer = {} if timer_s is None else {"toggle_after": timer_s}
        return self._call(SETTING, id=0, on=on, **timer), self._call(ASKING_RELAY, id=0)

    def _call(self, method: str, **parameters: Any) -> tuple[str, str]:
        number = next(self._ids)
        self._asked.append((number, method))
        call = {"id": number, "src": self._source, "method": method, "params": parameters}
        return f"{self._topic}/rpc", json.dumps(call)

    def hear(self, message: Message) -> Heard:
        """A reply, a notification, or whether it is there."""
        if message.topic == f"{self._topic}/online":
            return Heard(online=ONLINE.get(message.payload.strip().lower()))
        said = document(message.payload)
        if said is None or message.retain:
            return Heard()
        if message.topic == f"{self._source}/rpc":
            return self._reply(said)
        if said.get("method") in ("NotifyStatus", "NotifyFullStatus"):
            return _notified(said.get("params"))
        return Heard()

    def _reply(self, said: dict[str, Any]) -> Heard:
        """Only to what was asked; an answer of the relay's state counts if nothing was sent after its question."""
        number = said.get("id")
        method = next((m for n, m in self._asked if n == number and not isinstance(number, bool)), None)
        if method is None:
            return Heard()
        error, result = said.get("error"), said.get("result")
        if isinstance(error, dict):
            return Heard(refusal=_reason(error)) if method == SETTING else Heard()
        if not isinstance(result, dict):
            return Heard()
        if method == ASKING_UPTIME:
            return Heard(uptime_s=_uptime(result))
        if method != ASKING_RELAY:
            return Heard()
        newest = max(n for n, m in self._asked if m == ASKING_RELAY)
        return _switch(result, whole=True, answer=number == newest)


def _notified(parameters: object) -> Heard:
    """The changed fields of the relay, where some have."""
    if not isinstance(parameters, dict):
        return Heard()
    switch, system = parameters.get("switch:0"), parameters.get("sys")
    uptime_s = _uptime(system) if isinstance(system, dict) else None
    if not isinstance(switch, dict):
        return Heard(uptime_s=uptime_s)
    return _switch(switch, whole=False, answer=False, uptime_s=uptime_s)


def _switch(status: dict[str, Any], *, whole: bool, answer: bool, uptime_s: float | None = None) -> Heard:
    """The status of a switch component; `whole`: what it does not name is not there."""
    on = status.get("output")
    energy = status.get("aenergy")
    total = energy.get("total") if isinstance(energy, dict) else None
    power_w, bad_power = bounded(status["apower"], 1000.0 * MAX_POWER_KW) if "apower" in status else (None, 0)
    energy_wh, bad_energy = bounded(total, 1000.0 * MAX_ENERGY_KWH) if total is not None else (None, 0)
    current_a, bad_current = bounded(status["current"], MAX_CURRENT_A) if "current" in status else (None, 0)
    timed = "timer_duration" in status
    return Heard(
        on=on if isinstance(on, bool) else None,
        metered=whole or "apower" in status or total is not None,
        partial=not whole,
        power_kw=None if power_w is None else from_w(power_w),
        energy_kwh=None if energy_wh is None else from_wh(energy_wh),
        current_a=current_a,
        uptime_s=uptime_s,
        answer=answer and isinstance(on, bool),
        timer=timed if whole or timed else None,
        by_timer=status.get("source") == "timer",
        errors=_errors(status.get("errors")) if whole or "errors" in status else None,
        nonsense=bad_power + bad_energy + bad_current,
    )


def _errors(said: object) -> tuple[str, ...]:
    listed = said if isinstance(said, list) else []
    return tuple(word[:MAX_REASON] for word in listed[:4] if isinstance(word, str) and word.isidentifier())


def _uptime(system: dict[str, Any]) -> float | None:
    return bounded(system.get("uptime"), 1e10)[0]


def _reason(error: dict[str, Any]) -> str:
    text = "".join(c for c in str(error.get("message", "")) if c.isprintable())[:MAX_REASON]
    code = error.get("code")
    return f"{text or 'no reason given'} ({code if isinstance(code, int) and abs(code) < 100000 else '?'})"
