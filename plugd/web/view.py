"""What the page says, in words and numbers for a person, out of a snapshot."""

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any
from zoneinfo import ZoneInfo

from plugd import ledger, remedies
from plugd.command_words import WEEKDAYS
from plugd.domain import Decision, Savings, Status
from plugd.ledger import Night
from plugd.score import LeadScore
from plugd.units import grams, to_pct
from plugd.web.desk import Snapshot
from plugd.web.drawing import drawings

STATUS = {
    Status.WAITING_FOR_FORECAST: "waiting for a forecast",
    Status.HOLDING: "holding for a cleaner night",
    Status.WAITING: "waiting to start",
    Status.CHARGING: "charging",
    Status.BOOSTING: "charging now",
    Status.READY: "ready",
    Status.DISCONNECTED: "not plugged in",
    Status.OFF: "off",
    Status.FAULT: "needs you",
}
SAID_BY = {
    "car": "told by the car, AGO",
    "hub": "as you said, AGO",
    "meter": "told AGO, metered",
    "full": "full when it last stopped",
}
"""Who says how full it is, by the SOC's source."""
SHOWN_NIGHTS = 7
DAY_NAMES = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")


@dataclass(frozen=True, slots=True)
class Tile:
    """One figure."""

    name: str
    value: str
    more: str = ""


def _clock(moment: datetime, now: datetime, zone: ZoneInfo) -> str:
    """A moment as people say it: the time, with the weekday where it is not within a day."""
    local = moment.astimezone(zone)
    return f"{local:%H:%M}" if timedelta(0) <= moment - now < timedelta(hours=20) else f"{local:%a %H:%M}"


def _ago(length_s: float) -> str:
    minutes = int(length_s // 60)
    return (
        "just now"
        if minutes < 1
        else f"{minutes} min ago"
        if minutes < 120
        else f"{minutes // 60} h ago"
        if minutes < 2880
        else f"{minutes // 1440} days ago"
    )


def _battery(decision: Decision) -> Tile:
    soc = decision.memory.soc
    if soc.told_at is None:
        return Tile("battery", f"{to_pct(soc.mean, 0):.0f} %", "nobody has told yet")
    ago = _ago((decision.at - soc.told_at).total_seconds())
    how = SAID_BY.get(soc.source, f"told by {soc.source}, AGO").replace("AGO", ago)
    return Tile("battery", f"{to_pct(soc.mean, 0):.0f} %", how)


def _saved(snapshot: Snapshot, saved: Savings) -> Tile:
    """In all, and of the last night where it saved anything; else in percent of what arriving would have cost."""
    end = snapshot.nights[-1].session_end if snapshot.nights else None
    when = "last night" if end is not None and end <= snapshot.decision.at else "tonight"
    share = ledger.total(snapshot.nights).saved_pct
    more = "against charging on arrival" if share is None else f"{share:.0f} % less than on arrival"
    more = f"{grams(saved.today_g)} {when}" if abs(saved.today_g) >= 0.5 else more
    return Tile("CO2 saved", grams(saved.total_g), more)


def tiles(snapshot: Snapshot, state: dict[str, Any]) -> list[Tile]:
    """The figures at the top."""
    decision, zone = snapshot.decision, ZoneInfo(snapshot.household.timezone)
    now, plan = decision.at, decision.memory.plan
    found = [_battery(decision)]
    tonight = plan.sessions[0] if plan and plan.sessions else None
    if tonight is not None:
        by = _clock(tonight.session.end, now, zone)
        minimum = f"at least {to_pct(tonight.session.minimum, 0):.0f} % by {by}"
        found.append(Tile("in the morning", f"{state['morning_soc_pct']:.0f} %", minimum))
    power_w = state["power_w"]
    flowing = "-" if power_w is None else f"{power_w / 1000:.1f} kW"
    found.append(Tile("power", flowing, "relay on" if decision.memory.relay_on else "relay off"))
    if state["intensity_g_per_kwh"] is not None:
        found.append(Tile("grid now", f"{state['intensity_g_per_kwh']:.0f} g", "CO2 per kWh"))
    if decision.saved is not None:
        found.append(_saved(snapshot, decision.saved))
    return found


@dataclass(frozen=True, slots=True)
class NightLine:
    """One night of the table."""

    name: str
    kwh: str
    clean: str
    arrival: str
    best: str
    saved: str
    morning: str
    missed: bool


def night_line(night: Night) -> NightLine:
    """A night for people."""
    flowed = night.kwh > ledger.LITTLE_KWH
    clean, arrival, best = (
        f"{g / night.kwh:.0f}" if flowed else "-" for g in (night.carbon_g, night.on_arrival_g, night.best_g)
    )
    return NightLine(
        name=f"{night.day:%a %-d %b}",
        kwh=f"{night.kwh:.1f}",
        clean=clean,
        arrival=arrival,
        best=best,
        saved=grams(night.saved_g) if flowed else "-",
        morning="" if night.morning_soc is None else f"{to_pct(night.morning_soc, 0):.0f} %",
        missed=night.missed,
    )


def _seen(night: Night) -> bool:
    return night.session_end is not None or night.kwh > ledger.LITTLE_KWH


def says(snapshot: Snapshot) -> str:
    """The picture in words, for those who do not see it."""
    zone, now = ZoneInfo(snapshot.household.timezone), snapshot.decision.at
    plan = snapshot.decision.memory.plan
    nights = [
        f"{p.session.start.astimezone(zone):%A}: {p.energy_kwh:.1f} kWh"
        + ("" if p.intensity_g_per_kwh is None else f" at {p.intensity_g_per_kwh:.0f} grams per kWh")
        for p in (plan.sessions if plan else ())
        if p.session.end > now
    ]
    return "Planned: " + "; ".join(nights) + "." if nights else "Nothing is planned."


def forecast_words(snapshot: Snapshot) -> str:
    """How far the forecast reaches, and how old it is."""
    decision, zone = snapshot.decision, ZoneInfo(snapshot.household.timezone)
    outlook, issued = decision.outlook, decision.forecast_issued_at
    if issued is None or outlook is None or outlook.forecast_until is None:
        return "There is no forecast at the moment; the plan uses the usual day."
    until = outlook.forecast_until.astimezone(zone)
    age = _ago((decision.at - issued).total_seconds())
    return f"Forecast from {age}, reaching to {until:%a %H:%M}; beyond it (dashed) the usual day."


def live(snapshot: Snapshot, state: dict[str, Any], scores: tuple[LeadScore, ...]) -> dict[str, Any]:
    """Everything on the page that changes by itself."""
    nights = [night for night in snapshot.nights if _seen(night)]
    zone = ZoneInfo(snapshot.household.timezone)
    at, since = snapshot.decision.at, snapshot.decision.running_since or snapshot.decision.at
    return {
        "status": STATUS[snapshot.decision.status],
        "reason": snapshot.decision.reason,
        "at": f"{at.astimezone(zone):%a %-d %b, %H:%M}",
        "since": f"{since.astimezone(zone):%a %-d %b, %H:%M}",
        "faults": [
            {"title": remedies.title(fault), "text": fault.text, "remedy": remedies.remedy(fault)}
            for fault in snapshot.decision.faults
        ],
        "tiles": tiles(snapshot, state),
        "drawing": drawings(snapshot, says(snapshot)),
        "forecast": forecast_words(snapshot),
        "learned": state["learned"],
        "cover": "" if snapshot.household.capability.dead_man else f"The plug has {remedies.NO_COVER}.",
        "nights": [night_line(night) for night in nights[-SHOWN_NIGHTS:][::-1]],
        "month": ledger.total(nights),
        "scores": scores,
        "trips": [_trip(trip) for trip in state["settings"]["trips"]],
        "week": week(state),
        "grams": grams,
    }


def _trip(trip: dict[str, Any]) -> dict[str, str]:
    day = datetime.fromisoformat(trip["date"])
    return {"date": trip["date"], "words": f"{day:%A %-d %B}: {_asked(trip)}"}


def _asked(rule: dict[str, Any]) -> str:
    """What a trip or a weekday asks, in words."""
    asked = [
        "away" if rule.get("away") else "",
        f"{rule['minimum_pct']:g} %" if "minimum_pct" in rule else "",
        f"ready by {rule['ready_by']}" if "ready_by" in rule else "",
    ]
    return ", ".join(filter(None, asked))


@dataclass(frozen=True, slots=True)
class Day:
    """A weekday, and what its morning asks where it differs."""

    key: str
    name: str
    minimum: str
    ready_by: str
    away: bool
    words: str
    """Empty where nothing differs."""


def week(state: dict[str, Any]) -> list[Day]:
    """The seven of them."""
    found = []
    for key, name in zip(WEEKDAYS, DAY_NAMES, strict=True):
        rule: dict[str, Any] = state["settings"]["week"].get(key, {})
        percent = f"{rule['minimum_pct']:g}" if "minimum_pct" in rule else ""
        words = f"{name}: {_asked(rule)}" if rule else ""
        found.append(Day(key, name, percent, rule.get("ready_by", ""), rule.get("away", False), words))
    return found


def values(state: dict[str, Any]) -> dict[str, str | bool]:
    """What stands in the fields, by their ids."""
    settings = state["settings"]
    found: dict[str, str | bool] = {
        "minimum": f"{settings['minimum_pct']:g}",
        "ready_by": settings["ready_by"] or "",
        "horizon": str(settings["horizon"]),
    }
    for day in week(state):
        found |= {
            f"{day.key}-minimum_pct": day.minimum,
            f"{day.key}-ready_by": day.ready_by,
            f"{day.key}-away": day.away,
        }
    return found
