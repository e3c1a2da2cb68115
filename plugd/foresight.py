"""`plugd forecast`: what is expected of the grid up to the last planned night, and where each number is from."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import groupby
from zoneinfo import ZoneInfo

from plugd import daemon, scoring
from plugd.adapters.hub import foreseen
from plugd.adapters.store import SqliteStore
from plugd.config import Config
from plugd.domain import Decision, Intensity, OutlookSlot, SlotSource
from plugd.inspection import decision_now
from plugd.past import HISTORY
from plugd.score import LeadScore
from plugd.units import HALF_HOUR, iso

BAND_SD = 1.2816
"""Four of five values lie within so many standard deviations."""
BAR = 40
SOLID, SHADE = "█", "░"
SOURCES = {SlotSource.NESO: "neso", SlotSource.CORRECTED: "corrected", SlotSource.TAIL: "usual day"}
LEGEND = f"{SOLID} to the low end, {SHADE} to the high end of where it lies four times in five; * charging is planned"


@dataclass(frozen=True, slots=True)
class Foresight:
    """The decision of now, what it stands on, and how good such outlooks were."""

    decision: Decision
    region: str
    zone: ZoneInfo
    history: tuple[Intensity, ...]
    measured_until: datetime | None
    scores: Mapping[str, tuple[LeadScore, ...]]


def now(config: Config) -> Foresight:
    """What would be expected now, on what the daemon knows. Raises StoreError."""
    decision = decision_now(config)
    history: tuple[Intensity, ...] = ()
    measured: tuple[Intensity, ...] = ()
    scores: Mapping[str, tuple[LeadScore, ...]] = scoring.summed(())
    folder = daemon.state_folder(config)
    if folder.is_dir():
        with SqliteStore(folder, hold=False) as store:
            history, measured = store.history(decision.at - HISTORY), store.measured(decision.at - HISTORY)
            scores = scoring.summed(store.tallies((decision.at - scoring.SCORED).date()))
    return Foresight(
        decision=decision,
        region=daemon.source_for(config).region,
        zone=ZoneInfo(config.home.timezone),
        history=history,
        measured_until=measured[-1].start + HALF_HOUR if measured else None,
        scores=scores,
    )


def document(found: Foresight) -> dict[str, object]:
    """The JSON answer."""
    decision = found.decision
    slots = decision.outlook.slots if decision.outlook else ()
    return {
        "at": iso(decision.at),
        "region": found.region,
        "issued_at": iso(decision.forecast_issued_at) if decision.forecast_issued_at else None,
        "forecast_until": iso(decision.outlook.forecast_until)
        if decision.outlook and decision.outlook.forecast_until
        else None,
        "history_half_hours": len(found.history),
        "measured_until": iso(found.measured_until) if found.measured_until else None,
        "faults": [{"code": fault.code, "text": fault.text} for fault in decision.faults],
        "slots": [
            {**told, "session": _session(slot.start, decision)}
            for told, slot in zip(foreseen(decision), slots, strict=False)
        ],
        "score": {who: [scoring.row(one) for one in rows] for who, rows in found.scores.items()},
    }


def _session(start: datetime, decision: Decision) -> int | None:
    """The planned night that holds a half hour, counted from 1."""
    nights = enumerate(decision.sessions, start=1)
    return next((k for k, night in nights if night.start < start + HALF_HOUR and start < night.end), None)


# -- for people -----------------------------------------------------------------------------------


def lines(found: Foresight, plain: bool = False) -> list[str]:
    """The drawing: a line an hour, in local time; `plain` without any letter that an old terminal lacks."""
    decision = found.decision
    said = [_stands_on(found), *(f"  ! {fault.text}" for fault in decision.faults)]
    if decision.outlook is None:
        said.append("No night is coming, so nothing is looked ahead for.")
    else:
        slots = decision.outlook.slots
        top = max(slot.g_per_kwh + BAND_SD * slot.sd_g_per_kwh for slot in slots)
        for day, hours in groupby(_by_hour(slots, found.zone), key=lambda hour: hour[0].date()):
            said += ["", f"{day:%A %-d %B}"]
            said += [_hour(at, of_it, max(top, 1.0), decision) for at, of_it in hours]
        said += ["", LEGEND]
    said += scoring.lines(found.scores)
    return [line.replace(SOLID, "#").replace(SHADE, "-") for line in said] if plain else said


def _stands_on(found: Foresight) -> str:
    decision, outlook = found.decision, found.decision.outlook
    place = "the nation" if found.region == "national" else f"region {found.region}"
    own = f"from {len(found.history) / 48:.0f} days of own history" if found.history else "without own history yet"
    issued = decision.forecast_issued_at
    if issued is None or outlook is None or outlook.forecast_until is None:
        return f"There is no forecast for {place}: this is the usual day, {own}."
    at, until = issued.astimezone(found.zone), outlook.forecast_until.astimezone(found.zone)
    age = (decision.at - issued) // timedelta(minutes=1)
    old = f" ({age / 60:.0f} h old)" if age >= 90 else ""
    return f"NESO's forecast for {place} of {at:%a %H:%M}{old} reaches {until:%a %H:%M}; then the usual day, {own}."


def _by_hour(slots: tuple[OutlookSlot, ...], zone: ZoneInfo) -> Iterator[tuple[datetime, list[OutlookSlot]]]:
    for _, of_it in groupby(slots, key=lambda slot: slot.start.replace(minute=0)):
        both = list(of_it)
        yield both[0].start.astimezone(zone), both


def _hour(at: datetime, slots: list[OutlookSlot], top: float, decision: Decision) -> str:
    mean = sum(slot.g_per_kwh for slot in slots) / len(slots)
    sd = sum(slot.sd_g_per_kwh for slot in slots) / len(slots)
    low, high = max(0.0, mean - BAND_SD * sd), mean + BAND_SD * sd
    solid = round(BAR * low / top)
    bar = SOLID * solid + SHADE * (round(BAR * high / top) - solid)
    session = next((s for slot in slots if (s := _session(slot.start, decision))), None)
    starts = {slot.start for slot in slots}
    plan = decision.memory.plan
    charging = plan is not None and any(
        part.power_kw > 0.0 and any(start <= part.start < start + HALF_HOUR for start in starts)
        for part in plan.slots()
    )
    night = "" if session is None else f"night {session}"
    sources = "/".join(dict.fromkeys(SOURCES[slot.source] for slot in slots))
    mark = "*" if charging else " "
    return f"  {at:%H:%M} {mark} {mean:4.0f} g/kWh {low:4.0f} to {high:<4.0f} {bar:<{BAR}}  {night:<8} {sources}"
