"""The hub over MQTT: commands in, state, plan and answers out (topics under `plugd/<name>`)."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any
from zoneinfo import ZoneInfo

from plugd import __version__, habits, reasons, remedies, sessions, soc
from plugd.adapters import homeassistant
from plugd.adapters.mqtt import Message, MqttConnection, Retained
from plugd.command_words import MAX_BYTES, WEEKDAYS, NoSuchKey, NotKnown, Refused, car_soc, parse
from plugd.domain import (
    Answer,
    Command,
    DayRule,
    Decision,
    Fault,
    Household,
    Memory,
    Outlook,
    Overrides,
    Reading,
    SessionPlan,
    SetSoc,
    Status,
    Switching,
    Trip,
)
from plugd.units import iso, slot_start, to_pct, to_w

AGES = ("at", "soc_age_s", "forecast_age_min")
"""What grows by itself: no reason to tell the state anew."""
OUTLOOK_SPAN = timedelta(days=7)
"""How much of the outlook is told: with nights away the last session may be weeks off."""


@dataclass(frozen=True, slots=True)
class Topics:
    """Where plugd listens and speaks."""

    base: str
    soc_topic: str | None = None
    soc_json_key: str | None = None
    soc_fraction: bool = False
    discovery_prefix: str | None = None
    """Where Home Assistant looks; empty: plugd takes back what it once announced; None: it says nothing there."""


class MqttHub:
    """Implements `plugd.ports.Hub`. What is retained is told again after a reconnect and on a hub's birth."""

    def __init__(self, connection: MqttConnection, topics: Topics, household: Household) -> None:
        self._mqtt = connection
        self._topics = topics
        self._household = household
        self._commands = connection.subscribe(f"{topics.base}/+/set")
        self._car = (
            # A car's state is often published retained: only what the broker had kept is old.
            connection.subscribe((topics.soc_topic, Retained.LIVE)) if topics.soc_topic else None
        )
        prefix = topics.discovery_prefix
        self._births = connection.subscribe((f"{prefix}/status", Retained.LIVE)) if prefix else None
        self._announcement = _announcement(topics, household)
        self._session = -1
        self._told: dict[str, Any] = {}
        self._car_unheard: Fault | None = None
        self._car_heard = False
        self.refused = 0

    @property
    def warnings(self) -> Sequence[Fault]:
        """What a person should mend at the hub's end, though plugd works."""
        found = [self._car_unheard] if self._car_unheard else []
        if self._mqtt.twin.pushed_out:
            text = f"another program calls itself {self._mqtt.name} at the broker: each pushes the other out"
            found.append(Fault("taken_over", f"{text}, and this one stays away for ever longer"))
        return tuple(found)

    def commands(self) -> Sequence[Command]:
        """What arrived since the last call. Retained messages are old by nature, and never obeyed."""
        if self._births is not None and any(message.payload == b"online" for message in self._births.take()):
            self._told = {}  # a hub that starts has heard nothing yet
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
        for topic in self._commands.take_too_long():
            self._answer(Answer(topic.split("/")[-2], False, f"too many bytes; at most {MAX_BYTES}"))
        found.extend(self._car_says())
        return found

    def _car_says(self) -> list[Command]:
        """The car's last good word. A topic that goes on saying what cannot be its SOC is a fault."""
        messages: tuple[Message, ...] = self._car.take() if self._car else ()
        wrong: Fault | None = None
        for message in reversed(messages):
            if message.retain:
                continue
            try:
                said = car_soc(message.payload, self._topics.soc_json_key, self._topics.soc_fraction)
            except Refused as refusal:
                # A topic may tell of the SOC in some of its messages only; if in none, the key is a wrong one.
                if isinstance(refusal, NotKnown) and (self._car_heard or not isinstance(refusal, NoSuchKey)):
                    continue
                self.refused += 1
                wrong = wrong or Fault("car_soc", f"{self._topics.soc_topic}: {refusal}")
                continue
            self._car_unheard, self._car_heard = None, True
            return [SetSoc(said, source="car")]
        self._car_unheard = wrong or self._car_unheard
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
        base = self._topics.base
        if self._mqtt.session != self._session:
            session = self._mqtt.session
            if not self._mqtt.publish(f"{base}/availability", b"online", qos=1, retain=True):
                return
            self._session, self._told = session, {}
        for topic, document in self._announcement:
            self._tell(topic, document)
        self._tell(f"{base}/plan", planned(decision))
        self._tell(f"{base}/outlook", foreseen(decision))
        self._tell(f"{base}/state", state(decision, reading, self._household))

    def _tell(self, topic: str, document: Any) -> None:
        """Where it is news. None is told as nothing at all: the broker forgets the topic."""
        news = {k: v for k, v in document.items() if k not in AGES} if isinstance(document, dict) else document
        if topic in self._told and self._told[topic] == news:
            return
        text = "" if document is None else json.dumps(document, allow_nan=False)
        if self._mqtt.publish(topic, text.encode(), qos=1, retain=True):
            self._told[topic] = news

    def close(self) -> None:
        """Say that nobody is at the wheel any more; the plug's own timer takes over."""
        self._mqtt.publish(f"{self._topics.base}/availability", b"offline", qos=1, retain=True)


def _announcement(topics: Topics, household: Household) -> tuple[tuple[str, Any], ...]:
    """(topic, document) by which Home Assistant gets to know us, or forgets us."""
    prefix = topics.discovery_prefix
    if prefix is None:
        return ()
    if not prefix:
        return ((homeassistant.topic(homeassistant.USUAL_PREFIX, topics.base), None),)
    return ((homeassistant.topic(prefix, topics.base), homeassistant.device(topics.base, household)),)


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


def foreseen(decision: Decision) -> list[dict[str, Any]]:
    """The outlook as hubs read it: the half hours to come, a week at most."""
    return [
        {
            "start": iso(slot.start),
            "g_per_kwh": round(slot.g_per_kwh, 1),
            "sd_g_per_kwh": round(slot.sd_g_per_kwh, 1),
            "source": slot.source.value,
        }
        for slot in (decision.outlook.slots if decision.outlook else ())
        if slot.start < decision.at + OUTLOOK_SPAN
    ]


def _rule(rule: DayRule | Trip) -> dict[str, Any]:
    """What a trip or a weekday asks, in the words in which it was sent."""
    asked = {
        "minimum_pct": None if rule.minimum is None else to_pct(rule.minimum),
        "ready_by": f"{rule.ready_by:%H:%M}" if rule.ready_by else None,
        "away": True if rule.away else None,
    }
    return {key: value for key, value in asked.items() if value is not None}


def settings(overrides: Overrides, household: Household) -> dict[str, Any]:
    """What is asked of plugd now, by command or configuration; `trips` in order of their days."""
    nights = household.nights
    ready_by = overrides.ready_by or nights.ready_by
    week = nights.week if overrides.week is None else overrides.week
    return {
        "minimum_pct": to_pct(nights.minimum if overrides.minimum is None else overrides.minimum),
        "ready_by": f"{ready_by:%H:%M}" if ready_by else None,
        "horizon": overrides.horizon or nights.horizon,
        "week": {WEEKDAYS[day]: _rule(rule) for day, rule in week},
        "trips": [{"date": trip.day.isoformat(), **_rule(trip)} for trip in overrides.trips],
    }


def _intensity_at(now: datetime, outlook: Outlook | None) -> float | None:
    slots = outlook.slots if outlook else ()
    return next((round(s.g_per_kwh, 1) for s in slots if s.start == slot_start(now)), None)


def _power_kw(reading: Reading | None) -> float | None:
    """What flows now. Through an open relay nothing does, though its meter has not said so yet."""
    if reading is None or reading.power_kw is not None:
        return reading.power_kw if reading else None
    return None if reading.on or reading.energy_kwh is None else 0.0


def _forecast_age_min(decision: Decision, issued_at: datetime | None) -> int | None:
    return None if issued_at is None else int((decision.at - issued_at).total_seconds() // 60)


def _morning_soc(tonight: SessionPlan, now: datetime, memory: Memory, household: Household) -> float:
    """What to expect at the session end: above the plan's cautious SOC by as much as the mean is when it begins."""
    begins = max(now, tonight.session.start)
    homecomings = sessions.drives(household, memory.overrides, memory.presence, memory.soc.driven_to, begins)
    at_home = soc.driven(memory.soc, homecomings, household.car)
    return min(1.0, tonight.soc_end + at_home.mean - soc.cautious(at_home))


def state(decision: Decision, reading: Reading | None, household: Household) -> dict[str, Any]:
    """The retained state document. Absent knowledge is null, never 0."""
    memory, now = decision.memory, decision.at
    house = habits.informed(household, memory.habits)
    tonight = memory.plan.sessions[0] if memory.plan and memory.plan.sessions else None
    outranked = decision.status in (Status.OFF, Status.DISCONNECTED, Status.BOOSTING)
    orders = memory.orders if isinstance(memory.orders, Switching) and not outranked else None
    start = orders.next(now, True) if orders else None
    # A guard that holds in a morning that is over, or before the next night, ends by the need: the plan's stop is not
    # its own, and the plan's end is not when the car that is late is ready.
    held = memory.guarding and tonight is not None and now < tonight.session.start
    stop = orders.next(now, False) if orders and not held else None
    ends = [slot.end for slot in (tonight.slots if tonight else ()) if slot.power_kw > 0.01 and slot.end > now]
    told_at = memory.soc.told_at
    power_kw = _power_kw(reading)
    zone = ZoneInfo(household.timezone)
    today = [at for at in memory.switch_ons if at.astimezone(zone).date() == now.astimezone(zone).date()]
    outlook = decision.outlook
    return {
        "at": iso(now),
        "mode": memory.overrides.mode.value,
        "status": decision.status.value,
        "decision": "on" if memory.relay_on else "off",
        "reason": decision.reason,
        "soc_pct": to_pct(memory.soc.mean),
        "soc_low_pct": to_pct(soc.cautious(memory.soc)),
        "soc_age_s": None if told_at is None else int((now - told_at).total_seconds()),
        "soc_told_at": iso(told_at) if told_at else None,
        "soc_source": memory.soc.source,
        "connected": memory.presence.connected,
        "power_w": None if power_kw is None else to_w(power_kw),
        "charging": None if power_kw is None else power_kw >= soc.FLOWING_KW,
        "energy_kwh": None if reading is None else reading.energy_kwh,
        "intensity_g_per_kwh": _intensity_at(now, outlook),
        "next_start": iso(start) if start else None,
        "next_stop": iso(stop) if stop else None,
        "ready_at": iso(max(ends)) if ends and not outranked and not held else None,
        "ready_by": iso(tonight.session.end) if tonight else None,
        "morning_soc_pct": to_pct(_morning_soc(tonight, now, memory, house)) if tonight else None,
        "minimum_pct": to_pct(tonight.session.minimum) if tonight else None,
        "shortfall_kwh": round(tonight.shortfall_kwh, 3) if tonight else None,
        "at_risk": reasons.at_risk(now, memory, house, decision.faults),
        "settings": settings(memory.overrides, household),
        "learned": habits.words(household, memory.habits),
        "saved_g_today": round(decision.saved.today_g, 1) if decision.saved else None,
        "saved_g_total": round(decision.saved.total_g, 1) if decision.saved else None,
        "switch_ons_today": len(today),
        "forecast_age_min": _forecast_age_min(decision, decision.forecast_issued_at),
        "forecast_until": iso(outlook.forecast_until) if outlook and outlook.forecast_until else None,
        "faults": [{"code": f.code, "text": f.text, "remedy": remedies.remedy(f)} for f in decision.faults],
        "guard_count": memory.guard_count,
        "running_since": iso(decision.running_since) if decision.running_since else None,
        "version": __version__,
    }
