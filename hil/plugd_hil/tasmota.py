"""A Tasmota plug as a state machine without I/O: topics, JSON, timers and habits of firmware 12 and later.

Taken from the firmware's own source: SetPowerOnState, ExecuteCommandPower, SetPulseTimer, CmndPulsetime,
CmndBacklog, CmndStatus, MqttConnected, MqttShowState, EnergyMarginCheck.
"""

import json
import random
from datetime import timedelta
from functools import partial
from typing import Any

from plugd_hil.outlet import Said
from plugd_hil.socket import Socket
from plugd_hil.tasmota_documents import pulse_left, pulse_span, sensor_document, state_document

FIRST_TELEMETRY = timedelta(seconds=5)
BACKLOG_STEP = timedelta(milliseconds=200)
NO_OTHERS, WORDS = [0] * 7, ("OFF", "ON")
STATES = {"0": 0, "OFF": 0, "FALSE": 0, "1": 1, "ON": 1, "TRUE": 1, "2": 2, "TOGGLE": 2}
ALWAYS_ON, INVERTED_PULSE = 4, 5


class TasmotaPlug:
    """Implements `plugd_hil.socket.Plug`: one relay with a meter."""

    def __init__(
        self, topic: str, board: Socket, *, seed: int = 0, tele_period_s: int = 300, power_delta: int = 10
    ) -> None:
        """It connects to its broker when told so by `connected`."""
        self.topic = topic
        self.muted = False
        self.board = board
        self._dice = random.Random(f"{seed}/plug")
        self._reported_kw = 0.0
        self._power_on_state = 3
        self._pulse = 0
        self._tele_period_s = tele_period_s
        self._power_delta = power_delta
        self._told_boot = False
        self._backlog_until = board.now

    @property
    def listens(self) -> tuple[str, ...]:
        """Its commands."""
        return (f"cmnd/{self.topic}/+",)

    @property
    def will(self) -> Said:
        """Its last will."""
        return Said(f"tele/{self.topic}/LWT", "Offline", retain=True)

    # -- broker and mains -------------------------------------------------------------------------

    def connected(self) -> list[Said]:
        """The network lets it reach its broker again."""
        return self._online_again() if self.board.powered else []

    def _online_again(self) -> list[Said]:
        """After booting it tells more than after a lost connection."""
        self.board.online = True
        said = self._say("tele", "LWT", "Online", retain=True) + self._say("cmnd", "POWER", "")
        if not self._told_boot:
            self._told_boot = True
            said += self._say("tele", "INFO1", {"Info1": {"Module": "Generic", "Version": "14.2.0(tasmota)"}})
            said += self._say("tele", "INFO2", {"Info2": {"WebServerMode": "Admin", "Hostname": self.topic}})
            said += self._say("tele", "INFO3", {"Info3": {"RestartReason": "Power On", "BootCount": 7}})
            said += self._show()
            self.board.after(FIRST_TELEMETRY, self._telemetry)
        self.load_changed()
        return said

    def cut(self, length: timedelta = timedelta(seconds=5)) -> list[Said]:
        """The mains fail, and are back after `length`. The broker notices by its own means."""
        self._backlog_until = self.board.now
        return self.board.cut(length, self._online_again, lambda: [self.will], self._on_power)

    def _on_power(self, saved: bool) -> bool:
        """The relay when the mains are back."""
        self._told_boot = False
        on = (False, True, not saved, saved, True, False)[self._power_on_state]
        self._count(on or self._power_on_state == INVERTED_PULSE)
        return on

    def press(self) -> list[Said]:
        """A person presses the button."""
        return self._switch(not self.board.on)

    # -- the relay --------------------------------------------------------------------------------

    def _switch(self, on: bool) -> list[Said]:
        self.board.switch(on or self._power_on_state == ALWAYS_ON)
        self._count(self.board.on is not (self._power_on_state == INVERTED_PULSE))
        self.load_changed()
        return self._show()

    def _count(self, counting: bool) -> None:
        """Start PulseTime anew, or stop it."""
        self.board.after(pulse_span(self._pulse) if counting and self._pulse else None, self._pulse_over)

    def _pulse_over(self) -> list[Said]:
        return self._switch(self._power_on_state == INVERTED_PULSE)

    def load_changed(self) -> list[Said]:
        """Power that differs from the last report by PowerDelta is told in 2 to 5 s; off is not told."""
        board, draws_kw = self.board, self.board.draws_kw()
        until = board.steady_until()
        board.after(until - board.now if until else None, self.load_changed)
        if not board.on:
            self._reported_kw = 0.0
        least_kw = max(min(draws_kw, self._reported_kw), 0.001)
        differs = abs(draws_kw - self._reported_kw) * 100.0 >= max(self._power_delta, 1) * least_kw
        if not board.on or not self._power_delta or not differs:
            board.after(None, self._report)
        elif not board.runs(self._report):
            board.after(timedelta(seconds=self._dice.uniform(2.0, 5.0)), self._report)
        return []

    def _report(self) -> list[Said]:
        before_kw, self._reported_kw = self._reported_kw, self.board.draws_kw()
        margins = {"MARGINS": {"PowerDelta": round(1000.0 * (self._reported_kw - before_kw))}}
        return self._say("tele", "MARGINS", margins) + self._say("tele", "SENSOR", self._sensors())

    # -- what it says -----------------------------------------------------------------------------

    def _say(self, prefix: str, tail: str, said: str | dict[str, Any], retain: bool = False) -> list[Said]:
        if self.muted or not self.board.online:
            return []
        text = said if isinstance(said, str) else json.dumps(said, separators=(",", ":"))
        return [Said(f"{prefix}/{self.topic}/{tail}", text, retain)]

    def _result(self, **said: Any) -> list[Said]:
        return self._say("stat", "RESULT", said)

    def _show(self) -> list[Said]:
        return self._result(POWER=WORDS[self.board.on]) + self._say("stat", "POWER", WORDS[self.board.on])

    def _telemetry(self) -> list[Said]:
        self.board.after(timedelta(seconds=self._tele_period_s), self._telemetry)
        return self._say("tele", "STATE", self._state()) + self._say("tele", "SENSOR", self._sensors())

    def _state(self) -> dict[str, Any]:
        return state_document(
            self.board.now.astimezone(self.board.zone), self.board.now - self.board.booted, self.board.on
        )

    def _sensors(self) -> dict[str, Any]:
        return sensor_document(self.board.meter, 1000.0 * self.board.draws_kw(), self.board.zone)

    # -- what it is told --------------------------------------------------------------------------

    def handle(self, topic: str, payload: bytes) -> list[Said]:
        """A message on `cmnd/<topic>/<command>`."""
        if self.muted or not self.board.online:
            return []
        return self._command(topic.rsplit("/", 1)[-1], payload.decode("utf-8", "replace"))

    def _command(self, command: str, payload: str) -> list[Said]:
        name = command.upper().rstrip("0123456789")
        index, said = command[len(name) :], payload.strip()
        if name == "BACKLOG":
            return self._backlog(index, said)
        action = {
            "POWER": self._cmnd_power, "STATUS": self._cmnd_status, "STATE": self._cmnd_state,
            "PULSETIME": self._cmnd_pulse_time, "POWERONSTATE": self._cmnd_power_on_state,
            "TELEPERIOD": self._cmnd_tele_period, "POWERDELTA": self._cmnd_power_delta,
            "POWERLOCK": self._cmnd_power_lock,
        }.get(name)  # fmt: skip
        return action(index, "" if said == "?" else said) if action else self._result(Command="Unknown")

    def _backlog(self, index: str, payload: str) -> list[Said]:
        """The first at once, each further one 200 ms later; Backlog0 all at once."""
        step, now = timedelta(0) if index == "0" else BACKLOG_STEP, self.board.now
        start = self._backlog_until + step if self._backlog_until > now else now
        for i, command in enumerate(c.strip() for c in payload.split(";") if c.strip()):
            self._backlog_until = start + i * step
            self.board.after(self._backlog_until - now, partial(self._command, *command.partition(" ")[::2]))
        return self.board.advance(now)

    def _cmnd_power(self, _index: str, payload: str) -> list[Said]:
        wanted = STATES.get(payload.upper())
        if wanted is None:
            return self._show()
        return self._switch(not self.board.on if wanted == 2 else bool(wanted))

    def _cmnd_status(self, _index: str, payload: str) -> list[Said]:
        documents = {
            "": ("STATUS", {"Status": {"Topic": self.topic, "Power": str(int(self.board.on)),
                                       "PowerOnState": self._power_on_state}}),
            "8": ("STATUS8", {"StatusSNS": self._sensors()}),
            "10": ("STATUS10", {"StatusSNS": self._sensors()}),
            "11": ("STATUS11", {"StatusSTS": self._state()}),
        }  # fmt: skip
        asked = ("", "10", "11") if payload == "0" else (payload if payload in documents else "",)
        return [said for key in asked for said in self._say("stat", *documents[key])]

    def _cmnd_state(self, _index: str, _payload: str) -> list[Said]:
        return self._say("stat", "RESULT", self._state())

    def _cmnd_pulse_time(self, index: str, payload: str) -> list[Said]:
        if payload.isdigit() and int(payload) < 65536:
            self._pulse = int(payload)
            self._count(True)
        left = pulse_left(self.board.left(self._pulse_over))
        if index or payload:
            return self._result(PulseTime1={"Set": self._pulse, "Remaining": left})
        return self._result(PulseTime={"Set": [self._pulse, *NO_OTHERS], "Remaining": [left, *NO_OTHERS]})

    def _cmnd_power_on_state(self, _index: str, payload: str) -> list[Said]:
        said: list[Said] = []
        if payload in ("0", "1", "2", "3", "4", "5"):
            self._power_on_state = int(payload)
            said = self._switch(True) if self._power_on_state == ALWAYS_ON else said
        return said + self._result(PowerOnState=self._power_on_state)

    def _cmnd_tele_period(self, _index: str, payload: str) -> list[Said]:
        if payload.isdigit() and int(payload) <= 3600:
            self._tele_period_s = 300 if int(payload) == 1 else max(10, int(payload))
            self.board.after(timedelta(seconds=self._tele_period_s), self._telemetry)
        return self._result(TelePeriod=self._tele_period_s)

    def _cmnd_power_delta(self, _index: str, payload: str) -> list[Said]:
        if payload.isdigit() and int(payload) <= 100:
            self._power_delta = int(payload)
            self.load_changed()
        return self._result(PowerDelta1=self._power_delta)

    def _cmnd_power_lock(self, _index: str, payload: str) -> list[Said]:
        if payload in ("0", "1"):
            self.board.jammed = payload == "1"
        return self._result(PowerLock1=str(int(self.board.jammed)))
