"""An explanation in words and in JSON (`plugd plan --explain`): of a problem file, or of the house with its times."""

from dataclasses import dataclass
from datetime import datetime
from typing import Any
from zoneinfo import ZoneInfo

from plugd.planner.marginal import Explanation, Margin, MarginalSlot
from plugd.planner.nights import Part
from plugd.units import iso

SHOWN_KWH = 0.05
"""Less is not worth a word."""
ENDS_AT = {
    "minimum": "its morning minimum",
    "reserve": "what the way home and the reserve need",
    "ceiling": "its ceiling",
}


@dataclass(frozen=True, slots=True)
class Names:
    """How sessions and slots are called. `times`: of each session's slots, where they have any."""

    sessions: tuple[str, ...]
    slots: tuple[tuple[str, ...], ...] | None = None
    times: tuple[tuple[datetime, ...], ...] | None = None

    def slot(self, session: int, slot: int) -> str:
        """What a person calls a slot; without times its number, from 1."""
        return f"slot {slot + 1}" if self.slots is None else self.slots[session][slot]


def numbered(explained: Explanation) -> Names:
    """Sessions by number, from 1."""
    return Names(tuple(f"session {s}" for s in range(1, len(explained.margins) + 1)))


def dated(parts: tuple[Part, ...], timezone: str) -> Names:
    """Sessions and slots by the local time of a house. Tonight may be two: to the deadline, and from there."""
    zone = ZoneInfo(timezone)
    spans = [(part.pieces[0].start.astimezone(zone), part.pieces[-1].end.astimezone(zone)) for part in parts]
    return Names(
        tuple(f"{start:%a %d %b %H:%M} to {end:%a %H:%M}" for start, end in spans),
        tuple(tuple(f"{piece.start.astimezone(zone):%H:%M}" for piece in part.pieces) for part in parts),
        tuple(tuple(piece.start for piece in part.pieces) for part in parts),
    )


def lines(explained: Explanation, capacity_kwh: float, names: Names) -> list[str]:
    """For people: two lines a session, and one for every move."""
    found = []
    for s, margin in enumerate(explained.margins):
        found.append(f"{names.sessions[s]}: {_slots(margin, s, names)}")
        found.append(f"  {_bounds(margin, capacity_kwh / 100)}")
    for move in explained.moves:
        if move.battery_kwh < SHOWN_KWH:
            continue
        where = f"{move.battery_kwh:.1f} kWh charged early in {names.sessions[move.charged]}"
        figures = f"{move.at_g_per_kwh:.0f} against {move.instead_of_g_per_kwh:.0f} g/kWh"
        if move.needed is None:
            found.append(f"{where}, to be left after the last one: {figures} that it is worth there")
        else:
            found.append(f"{where}, not in {names.sessions[move.needed]}: {figures}")
    return found


def _slots(margin: Margin, s: int, names: Names) -> str:
    used, unused = margin.dearest_used, margin.cheapest_unused
    left = "no slot left unused" if unused is None else f"cheapest unused {_slot(unused, s, names)}"
    if used is None:
        return "nothing to charge; no slot has room" if unused is None else f"nothing charged; {left}"
    return f"{margin.charged_kwh:.1f} kWh; dearest used {_slot(used, s, names)}, {left}"


def _slot(slot: MarginalSlot, s: int, names: Names) -> str:
    return f"{names.slot(s, slot.slot)} ({slot.g_per_kwh:.0f} g/kWh)"


def _bounds(margin: Margin, kwh_per_pct: float) -> str:
    told = "no bound holds it: it ends where more would cost more than it saves"
    if margin.ends_at is not None:
        told = f"ends at {ENDS_AT[margin.ends_at]}"
    price = margin.floor_price
    if margin.short_kwh > SHOWN_KWH:
        told = f"ends {margin.short_kwh:.1f} kWh short of {ENDS_AT[margin.floor]}, which cannot be reached"
    elif price.less_saves or price.more_costs or price.more_costs is None:
        more = "more cannot be had"
        if price.more_costs is not None:
            more = f"1 % more costs {price.more_costs * kwh_per_pct:.1f} g"
        told += f": 1 % less saves {price.less_saves * kwh_per_pct:.1f} g, {more}"
    elif margin.ends_at == margin.floor:
        told += ", which costs nothing"
    if margin.ceiling_saves > 0:
        told += f"; 1 % more ceiling would save {margin.ceiling_saves * kwh_per_pct:.1f} g"
    return told


def document(explained: Explanation, capacity_kwh: float, names: Names) -> dict[str, Any]:
    """For programs: sessions and slots by their index, from 0; with their times where they have any."""
    kwh_per_pct = capacity_kwh / 100
    sessions = []
    for s, margin in enumerate(explained.margins):
        price = margin.floor_price
        saves, costs = price.less_saves, price.more_costs
        priced = {
            "less_saves_g_per_pct": _round(saves * kwh_per_pct),
            "more_costs_g_per_pct": None if costs is None else _round(costs * kwh_per_pct),
        }
        sessions.append(
            {
                "session": s,
                "charged_kwh": _round(margin.charged_kwh),
                "dearest_used": _marked(margin.dearest_used, s, names),
                "cheapest_unused": _marked(margin.cheapest_unused, s, names),
                "ends_at": margin.ends_at,
                "minimum": priced if margin.floor == "minimum" else _FREE,
                "reserve": priced if margin.floor == "reserve" else _FREE,
                "ceiling": {"more_saves_g_per_pct": _round(margin.ceiling_saves * kwh_per_pct)},
                "short_kwh": _round(margin.short_kwh),
            }
        )
    moved = [
        {
            "kwh": _round(move.battery_kwh),
            "charged_in": move.charged,
            "instead_of": move.needed,
            "g_per_kwh": _round(move.at_g_per_kwh),
            "instead_g_per_kwh": _round(move.instead_of_g_per_kwh),
        }
        for move in explained.moves
    ]
    return {"sessions": sessions, "moved": moved}


_FREE = {"less_saves_g_per_pct": 0.0, "more_costs_g_per_pct": 0.0}


def _marked(slot: MarginalSlot | None, s: int, names: Names) -> dict[str, Any] | None:
    if slot is None:
        return None
    at = {} if names.times is None else {"start": iso(names.times[s][slot.slot])}
    return {"slot": slot.slot, **at, "g_per_kwh": slot.g_per_kwh}


def _round(value: float) -> float:
    return round(value, 9) + 0.0
