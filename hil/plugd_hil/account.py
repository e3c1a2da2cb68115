"""The true account of a simulated run: what each night took, how clean it was, and against what it is compared."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from plugd import sessions
from plugd.domain import Household, Overrides, Record, Status
from plugd.planner.exact import Exact
from plugd.study.house import FunctionSource, House
from plugd.study.world import Battery, Stay
from plugd.units import hours, pieces, slot_start

Actual = Callable[[datetime], float]
"""Measured intensity of a half hour, in every half hour of the run."""

MISSED = 0.005
"""A morning this far under its minimum is missed, as a fraction."""
CHARGING = (Status.CHARGING, Status.BOOSTING)


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the stub plug's ledger: the truth at a moment."""

    at: datetime
    event: str
    soc: float
    energy_kwh: float
    on: bool
    connected: bool


def read_ledger(path: Path) -> tuple[Line, ...]:
    """All lines, in order of time."""
    lines = []
    with path.open(encoding="utf-8") as file:
        for text in file:
            row = json.loads(text)
            at = datetime.fromisoformat(row.pop("at")).astimezone(UTC)
            lines.append(Line(at, row["event"], row["soc"], row["energy_kwh"], row["on"], row["connected"]))
    return tuple(lines)


def flows(ledger: tuple[Line, ...]) -> Iterator[tuple[datetime, float]]:
    """Energy at the plug between neighbouring lines, by the half hour it flowed in."""
    for before, after in pairwise(ledger):
        if after.energy_kwh > before.energy_kwh:
            yield slot_start(before.at), after.energy_kwh - before.energy_kwh


def soc_at(ledger: tuple[Line, ...], moment: datetime) -> float:
    """SOC at a moment between two lines."""
    for before, after in pairwise(ledger):
        if before.at <= moment < after.at:
            share = (moment - before.at) / (after.at - before.at)
            return before.soc + share * (after.soc - before.soc)
    return ledger[-1].soc


@dataclass(frozen=True, slots=True)
class Night:
    """One stay, as it really was."""

    stay: Stay
    session_end: datetime
    arrival_soc: float
    morning_soc: float
    """At the session end, or when the car left before it."""
    best_soc: float
    """What charging without a pause since arrival would have reached by then."""
    minimum: float
    charged_kwh: float
    carbon_g: float
    switch_ons: int
    reason: str

    @property
    def missed(self) -> bool:
        """Under a minimum that was reachable, with the car still there."""
        here = self.stay.departure >= self.session_end
        return here and self.morning_soc < min(self.minimum, self.best_soc) - MISSED


def nights(
    ledger: tuple[Line, ...],
    stays: tuple[Stay, ...],
    records: tuple[Record, ...],
    household: Household,
    actual: Actual,
) -> tuple[Night, ...]:
    """The account of every stay that was over when the run ended."""
    found = []
    last = ledger[-1].at
    for stay in stays:
        windows = sessions.windows(household, Overrides(), stay.arrival)
        session = next(windows).session
        if max(session.end, stay.departure) > last:
            break
        inside = tuple(line for line in ledger if stay.arrival <= line.at <= stay.departure)
        taken = tuple(flows(inside))
        arrival_soc = soc_at(ledger, stay.arrival)
        car = household.car
        best = Battery(car.capacity_kwh, arrival_soc * car.capacity_kwh, car.efficiency)
        best.charge(household.capability.power_max_kw, hours(session.end - stay.arrival))
        found.append(
            Night(
                stay=stay,
                session_end=session.end,
                arrival_soc=arrival_soc,
                morning_soc=soc_at(ledger, min(session.end, stay.departure)),
                best_soc=best.soc,
                minimum=session.minimum,
                charged_kwh=sum(kwh for _, kwh in taken),
                carbon_g=sum(kwh * actual(slot) for slot, kwh in taken),
                switch_ons=sum(b.on and not a.on for a, b in pairwise(inside)),
                reason=_reason(records, stay, session.end),
            )
        )
    return tuple(found)


def _reason(records: tuple[Record, ...], stay: Stay, end: datetime) -> str:
    """What the daemon said when it charged; where it did not, what it said last before the morning."""
    tonight = [r for r in records if stay.arrival <= r.at < end]
    charging = [r for r in tonight if r.status in CHARGING]
    said = charging[:1] or tonight[-1:]
    return said[0].reason if said else "The daemon said nothing."


def uncontrolled(
    stays: tuple[Stay, ...], household: Household, actual: Actual, battery: Battery
) -> tuple[float, float]:
    """Charging on arrival up to soc_max, whatever the grid: (kWh, g)."""
    taken_kwh = carbon_g = 0.0
    battery.full, battery.taper_from = household.car.soc_max, household.car.soc_max
    for stay in stays:
        for first, last in pieces(stay.arrival, stay.departure):
            kwh = battery.charge(household.capability.power_max_kw, hours(last - first))
            taken_kwh += kwh
            carbon_g += kwh * actual(slot_start(first))
        battery.drive(stay.use_kwh)
    return taken_kwh, carbon_g


def foresight(
    stays: tuple[Stay, ...],
    household: Household,
    actual: Actual,
    battery: Battery,
    span: tuple[datetime, datetime],
) -> tuple[float, float]:
    """The same controller, told the true intensity of the coming week, in the same house: (kWh, g)."""
    start, end = span
    week = FunctionSource(lambda issued, slot: actual(slot), slots=2 * 24 * 8)
    house = House(household, Exact(), week, iter(stays), start, battery)
    house.run(end)
    taken = house.plug.flows
    return sum(taken.values()), sum(kwh * actual(slot) for slot, kwh in taken.items())


def per_kwh(kwh: float, grams: float) -> float | None:
    """Mean intensity, None where nothing flowed."""
    return round(grams / kwh, 2) if kwh > 0.0 else None
