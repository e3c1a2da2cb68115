"""The hub over MQTT: commands in, state, plan and answers out (topics under `plugd/<name>`)."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any
from zoneinfo import ZoneInfo

from plugd import __version__, soc
from plugd.adapters.mqtt import Message, MqttConnection, Retained
from plugd.domain import (
    Answer,
    Command,
    Decision,
    Household,
    Mode,
    Outlook,
    Reading,
    Replan,
    SetConnected,
    SetHorizon,
    SetMinimum,
    SetMode,
    SetReadyBy,
    SetSoc,
    Status,
    Switching,
)
from plugd.units import from_pct, iso, slot_start, to_pct, to_w

MAX_COMMAND_BYTES = 4096


QUOTED = 40
"""How much of what somebody sent is said back."""


class Refused(ValueError):
    """A command that says nothing plugd can do; the text tells what would be right."""


def _quote(text: str) -> str:
    return repr(text if len(text) <= QUOTED else text[:QUOTED] + "…")


def _number(text: str, low: float, high: float, unit: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise Refused(f"{_quote(text)} is not a number; send one from {low:g} to {high:g}{unit}") from None
    if not math.isfinite(value) or not low <= value <= high:
        raise Refused(f"{value:g} is outside {low:g} to {high:g}{unit}")
    return value


def _percent(text: str) -> float:
    value = _number(text, 0.0, 100.0, " %")
    if 0.0 < value < 1.0:
        raise Refused(f"{value:g} looks like a fraction; send percent, 0 to 100")
    return from_pct(value)


def _mode(text: str) -> Command:
    try:
        return SetMode(Mode(text.lower()))
    except ValueError:
        raise Refused(f"{_quote(text)} is no mode; send one of {', '.join(Mode)}") from None


def _connected(text: str) -> Command:
    if text.upper() not in ("ON", "OFF"):
        raise Refused(f"{_quote(text)} is neither ON nor OFF")
    return SetConnected(text.upper() == "ON")


def _ready_by(text: str) -> Command:
    if not text:
        return SetReadyBy(None)
    try:
        return SetReadyBy(datetime.strptime(text, "%H:%M").time())  # noqa: DTZ007 # a clock time, of any day
    except ValueError:
        raise Refused(f"{_quote(text)} is no time; send HH:MM, or nothing for the configured one") from None


def _horizon(text: str) -> Command:
    value = _number(text, 1, 7, " nights")
    if value != int(value):
        raise Refused(f"{value:g} is not a whole number of nights")
    return SetHorizon(int(value))


def _replan(text: str) -> Command:
    if text != "PRESS":
        raise Refused(f"{_quote(text)} is not PRESS")
    return Replan()


PARSERS: dict[str, Callable[[str], Command]] = {
    "mode": _mode,
    "soc": lambda text: SetSoc(_percent(text)),
    "minimum": lambda text: SetMinimum(_percent(text)),
    "connected": _connected,
    "ready_by": _ready_by,
    "horizon": _horizon,
    "replan": _replan,
}


def parse(name: str, payload: bytes) -> Command:
    """The command in a payload. Raises Refused, whose text goes back to the sender."""
    if name not in PARSERS:
        raise Refused(f"there is no command {_quote(name)}; there are {', '.join(PARSERS)}")
    if len(payload) > MAX_COMMAND_BYTES:
        raise Refused(f"{len(payload)} bytes are too many; at most {MAX_COMMAND_BYTES}")
    try:
        text = payload.decode("utf-8").strip()
    except UnicodeDecodeError:
        raise Refused("the payload is not UTF-8 text") from None
    return PARSERS[name](text)


def car_soc(payload: bytes, json_key: str | None) -> float:
    """The SOC in a message of the car's own topic, as a fraction. Raises Refused."""
    if len(payload) > MAX_COMMAND_BYTES:
        raise Refused("the car's message is too long")
    try:
        text = payload.decode("utf-8").strip()
        if json_key is None:
            return _percent(text)
        value = json.loads(text)
        for key in json_key.split("."):
            value = value[key]
    except (UnicodeDecodeError, ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        if isinstance(error, Refused):
            raise
        raise Refused(f"the car's message has no number under {json_key or 'it'}") from error
    return _percent(str(value))


@dataclass(frozen=True, slots=True)
class Topics:
    """Where plugd listens and speaks."""

    base: str
    soc_topic: str | None = None
    soc_json_key: str | None = None


class MqttHub:
    """Implements `plugd.ports.Hub`. State and plan are retained and told again after a reconnect."""

    def __init__(self, connection: MqttConnection, topics: Topics, household: Household) -> None:
        self._mqtt = connection
        self._topics = topics
        self._household = household
        self._commands = connection.subscribe(f"{topics.base}/+/set")
        self._car = (
            # A car's state is often published retained: only what the broker had kept is old.
            connection.subscribe((topics.soc_topic, Retained.LIVE)) if topics.soc_topic else None
        )
        self._session = -1
        self._told: dict[str, Any] = {}
        self.refused = 0

    def commands(self) -> Sequence[Command]:
        """What arrived since the last call. Retained messages are old by nature, and never obeyed."""
        found: list[Command] = []
        for message in self._commands.take():
            name = message.topic.split("/")[-2]
            if message.retain:
                self._answer(Answer(name, False, "retained commands are ignored; send it without retain"))
                continue
            try:
                found.append(parse(name, message.payload))
            except Refused as refusal:
                self._answer(Answer(name, False, str(refusal)))
        found.extend(self._car_says())
        return found

    def _car_says(self) -> list[Command]:
        messages: tuple[Message, ...] = self._car.take() if self._car else ()
        for message in reversed(messages):
            if message.retain:
                continue
            try:
                return [SetSoc(car_soc(message.payload, self._topics.soc_json_key), source="car")]
            except Refused:
                self.refused += 1
        return []

    def answer(self, answers: Sequence[Answer]) -> None:
        """Tell what became of commands on `result`."""
        for answer in answers:
            self._answer(answer, count=False)

    def _answer(self, answer: Answer, count: bool = True) -> None:
        self.refused += int(count)
        text = json.dumps({"command": answer.command, "ok": answer.ok, "message": answer.message})
        self._mqtt.publish(f"{self._topics.base}/result", text.encode(), qos=1, retain=False)

    def publish(self, decision: Decision, reading: Reading | None) -> None:
        """Tell what has changed since the last time; everything after a reconnect."""
        if not self._mqtt.connected:
            return
        if self._mqtt.session != self._session:
            session, online = self._mqtt.session, f"{self._topics.base}/availability"
            if not self._mqtt.publish(online, b"online", qos=1, retain=True):
                return
            self._session, self._told = session, {}
        self._tell("plan", planned(decision))
        self._tell("state", state(decision, reading, self._household))

    def _tell(self, name: str, value: Any) -> None:
        news = (
            {k: v for k, v in value.items() if k not in ("at", "soc_age_s", "forecast_age_min")}
            if isinstance(value, dict)
            else value
        )
        if self._told.get(name) == news:
            return
        text = json.dumps(value, allow_nan=False)
        if self._mqtt.publish(f"{self._topics.base}/{name}", text.encode(), qos=1, retain=True):
            self._told[name] = news

    def close(self) -> None:
        """Say that nobody is at the wheel any more; the plug's own timer takes over."""
        self._mqtt.publish(f"{self._topics.base}/availability", b"offline", qos=1, retain=True)


def planned(decision: Decision) -> list[dict[str, Any]]:
    """The plan as hubs read it: every slot in which something is to flow."""
    plan = decision.memory.plan
    return [
        {
            "start": iso(slot.start),
            "end": iso(slot.end),
            "power_kw": round(slot.power_kw, 3),
            "intensity_g_per_kwh": round(slot.intensity_g_per_kwh, 1),
        }
        for slot in (plan.slots() if plan else ())
        if slot.power_kw > 0.01
    ]


def _intensity_at(now: datetime, outlook: Outlook | None) -> float | None:
    slots = outlook.slots if outlook else ()
    return next((round(s.g_per_kwh, 1) for s in slots if s.start == slot_start(now)), None)


def _forecast_age_min(decision: Decision, issued_at: datetime | None) -> int | None:
    return None if issued_at is None else int((decision.at - issued_at).total_seconds() // 60)


def state(decision: Decision, reading: Reading | None, household: Household) -> dict[str, Any]:
    """The retained state document. Absent knowledge is null, never 0."""
    memory, now = decision.memory, decision.at
    tonight = memory.plan.sessions[0] if memory.plan and memory.plan.sessions else None
    outranked = decision.status in (Status.OFF, Status.DISCONNECTED, Status.BOOSTING)
    orders = memory.orders if isinstance(memory.orders, Switching) and not outranked else None
    start = orders.next(now, True) if orders else None
    stop = orders.next(now, False) if orders else None
    told_at = memory.soc.told_at
    zone = ZoneInfo(household.timezone)
    today = [at for at in memory.switch_ons if at.astimezone(zone).date() == now.astimezone(zone).date()]
    outlook = decision.outlook
    doubt = memory.soc.mean - soc.cautious(memory.soc)
    return {
        "at": iso(now),
        "mode": memory.overrides.mode.value,
        "status": decision.status.value,
        "decision": "on" if memory.relay_on else "off",
        "reason": decision.reason,
        "soc_pct": to_pct(memory.soc.mean),
        "soc_low_pct": to_pct(soc.cautious(memory.soc)),
        "soc_age_s": None if told_at is None else int((now - told_at).total_seconds()),
        "soc_source": memory.soc.source,
        "connected": memory.presence.connected,
        "power_w": None if reading is None or reading.power_kw is None else to_w(reading.power_kw),
        "energy_kwh": None if reading is None else reading.energy_kwh,
        "intensity_g_per_kwh": _intensity_at(now, outlook),
        "next_start": iso(start) if start else None,
        "next_stop": iso(stop) if stop else None,
        "ready_by": iso(tonight.session.end) if tonight else None,
        # The plan is made on the cautious SOC; what is to be expected is as much higher as the mean is now.
        "morning_soc_pct": to_pct(min(1.0, tonight.soc_end + doubt)) if tonight else None,
        "minimum_pct": to_pct(tonight.session.minimum) if tonight else None,
        "shortfall_kwh": round(tonight.shortfall_kwh, 3) if tonight else None,
        "saved_g_today": None,
        "saved_g_total": None,
        "switch_ons_today": len(today),
        "forecast_age_min": _forecast_age_min(decision, decision.forecast_issued_at),
        "forecast_until": iso(outlook.forecast_until) if outlook and outlook.forecast_until else None,
        "faults": [{"code": f.code, "text": f.text} for f in decision.faults],
        "guard_count": memory.guard_count,
        "version": __version__,
    }
