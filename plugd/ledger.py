"""The ledger: what every half hour took and how clean it was, and what its nights are compared with.

A half hour's intensity is set twice and never again: when it is over, to what was then known, and a day later to
what was measured. What a night is compared with follows from its half hours alone, so past figures stand still.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from itertools import groupby, pairwise
from zoneinfo import ZoneInfo

from plugd.domain import Household, Memory, Reading
from plugd.sessions import to_utc
from plugd.soc import flowed_kwh
from plugd.units import HALF_HOUR, SLOT_H, hours, pieces, slot_start

FINAL_AFTER = timedelta(hours=24)
"""NESO still changes a measured value for about a day."""
GIVEN_UP_AFTER = timedelta(days=4)
"""A half hour without a measured value by then keeps what was known when it was over."""
LITTLE_KWH = 0.005
"""Less is a plug's own use, not charging."""
MISSED = 0.005
"""A morning this far under its minimum is missed, as a fraction."""


@dataclass(frozen=True, slots=True)
class HalfHour:
    """One half hour of the ledger. Energy and power at the plug; `soc` is the estimate as it began."""

    start: datetime
    kwh: float
    g_per_kwh: float
    """As known when the half hour was over."""
    final_g_per_kwh: float | None
    """As measured, a day later; None until then."""
    soc: float
    switch_ons: int
    night: date
    """The local day on which its night began."""
    arrival: datetime
    """When the car came home for that night: as told, else the usual time."""
    arrival_told: bool
    limit_kw: float
    """What the car takes at this plug."""
    session_end: datetime | None
    """As then planned, where it belongs to this night."""
    minimum: float | None
    meter_kwh: float | None
    """The meter's total up to which `kwh` counts, and when it was read."""
    metered_at: datetime | None

    @property
    def carbon_g_per_kwh(self) -> float:
        """What counts: the measured value, once it is final."""
        return self.g_per_kwh if self.final_g_per_kwh is None else self.final_g_per_kwh


def night_of(moment: datetime, household: Household) -> date:
    """The local day on which the night of a moment began. Nights meet in the middle of the time away."""
    nights = household.nights
    in_min, out_min = (60 * t.hour + t.minute for t in (nights.plug_in, nights.plug_out))
    cut_min = (out_min + (in_min - out_min) % 1440 // 2) % 1440
    local = moment.astimezone(ZoneInfo(household.timezone))
    began_today = local.time() >= time(cut_min // 60, cut_min % 60)
    return local.date() if began_today else local.date() - timedelta(days=1)


def usual_arrival(night: date, household: Household) -> datetime:
    """When the car usually comes home for a night."""
    zone = ZoneInfo(household.timezone)
    usual = to_utc(night, household.nights.plug_in, zone)
    if night_of(usual, household) == night:
        return usual
    return to_utc(night + timedelta(days=1), household.nights.plug_in, zone)


def opened(start: datetime, memory: Memory, household: Household, g_per_kwh: float) -> HalfHour:
    """A half hour as it begins: nothing has flowed yet."""
    night = night_of(start, household)
    since = memory.presence.since if memory.presence.connected else None
    told = since is not None and night_of(since, household) == night
    plan = memory.plan
    session = plan.sessions[0].session if plan is not None and plan.sessions else None
    if session is not None and night_of(session.end, household) != night:
        session = None
    return HalfHour(
        start=start,
        kwh=0.0,
        g_per_kwh=g_per_kwh,
        final_g_per_kwh=None,
        soc=memory.soc.mean,
        switch_ons=0,
        night=night,
        arrival=since if told and since is not None else usual_arrival(night, household),
        arrival_told=told,
        limit_kw=memory.observed_kw or household.capability.power_max_kw,
        session_end=session.end if session else None,
        minimum=session.minimum if session else None,
        meter_kwh=None,
        metered_at=None,
    )


Metered = tuple[float | None, datetime | None]
"""A meter's total, and when it was read."""


def taken_kwh(before: Metered, at: datetime, reading: Reading, limit_kw: float) -> float:
    """Energy from `before` to `at`: by the meter's totals, without them by the power, for a short while."""
    total_kwh, metered_at = before
    span = None if metered_at is None else at - metered_at
    if reading.energy_kwh is not None:
        return flowed_kwh(total_kwh, reading.energy_kwh, span, limit_kw)
    if span is None or span > HALF_HOUR:
        return 0.0
    power_kw = reading.power_kw if reading.power_kw is not None else limit_kw * reading.on
    return max(0.0, power_kw) * hours(span)


def spread(kwh: float, start: datetime | None, end: datetime) -> dict[datetime, float]:
    """Energy by half hour, in proportion to the time of [start, end] in each."""
    if start is None or end <= start:
        return {slot_start(end): kwh}
    whole_h = hours(end - start)
    return {slot_start(first): kwh * hours(last - first) / whole_h for first, last in pieces(start, end)}


def may_settle(row: HalfHour, now: datetime) -> bool:
    """Whether a half hour is not final yet, and old enough to become so."""
    return row.final_g_per_kwh is None and now >= row.start + HALF_HOUR + FINAL_AFTER


def settled(row: HalfHour, measured_g_per_kwh: float | None, now: datetime) -> HalfHour:
    """The half hour with its final intensity, once; unchanged where none is known yet and hope is left."""
    if not may_settle(row, now):
        return row
    if measured_g_per_kwh is None and now < row.start + HALF_HOUR + GIVEN_UP_AFTER:
        return row
    final = row.g_per_kwh if measured_g_per_kwh is None else measured_g_per_kwh
    return replace(row, final_g_per_kwh=final)


# -- nights ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Night:
    """One night's account. Energy and grams are at the plug, SOC as fractions."""

    day: date
    arrival: datetime
    arrival_told: bool
    arrival_soc: float
    """The estimate when charging began; without any, in the morning."""
    session_end: datetime | None
    minimum: float | None
    morning_soc: float | None
    """At the session end; None until then."""
    reachable_soc: float
    """What charging without a pause since arrival would have reached by the session end."""
    kwh: float
    carbon_g: float
    on_arrival_g: float
    """The same energy from arrival on without a pause."""
    best_g: float
    """The same energy in the cleanest half hours between arrival and session end, known afterwards."""
    switch_ons: int
    final: bool
    """Whether every half hour has its measured intensity."""

    @property
    def saved_g(self) -> float:
        """Against charging on arrival."""
        return self.on_arrival_g - self.carbon_g

    @property
    def missed(self) -> bool:
        """The morning was under a minimum that could have been reached."""
        if self.morning_soc is None or self.minimum is None:
            return False
        return self.morning_soc < min(self.minimum, self.reachable_soc) - MISSED


def nights(rows: Iterable[HalfHour], efficiency: float, capacity_kwh: float) -> Iterator[Night]:
    """The nights of half hours in order of time."""
    for day, found in groupby(rows, key=lambda row: row.night):
        yield night(day, tuple(found), efficiency, capacity_kwh)


def night(day: date, rows: tuple[HalfHour, ...], efficiency: float, capacity_kwh: float) -> Night:
    """The account of one night's half hours, in order of time and at least one."""
    told = next((row for row in reversed(rows) if row.arrival_told), rows[-1])
    planned = next((row for row in reversed(rows) if row.session_end is not None), rows[-1])
    arrival, end = told.arrival, planned.session_end
    kwh = sum(row.kwh for row in rows)
    stay = tuple(_rooms(rows, arrival, end))
    over = end is not None and rows[-1].start + HALF_HOUR > end
    morning_soc = _soc_at(rows, end) if over and end is not None else None
    charging = next((row.soc for row in rows if row.kwh > LITTLE_KWH), None)
    arrival_soc = charging if charging is not None else morning_soc if morning_soc is not None else rows[-1].soc
    could_h = 0.0 if end is None else max(0.0, hours(end - arrival))
    could_kwh = could_h * max(row.limit_kw for row in rows) * efficiency
    return Night(
        day=day,
        arrival=arrival,
        arrival_told=told.arrival_told,
        arrival_soc=arrival_soc,
        session_end=end,
        minimum=planned.minimum,
        morning_soc=morning_soc,
        reachable_soc=min(1.0, arrival_soc + could_kwh / capacity_kwh),
        kwh=kwh,
        carbon_g=sum(row.kwh * row.carbon_g_per_kwh for row in rows),
        on_arrival_g=_filled_g(kwh, stay),
        best_g=_filled_g(kwh, sorted(stay, key=lambda room: room[1])),
        switch_ons=sum(row.switch_ons for row in rows),
        final=all(row.final_g_per_kwh is not None for row in rows),
    )


def _rooms(rows: tuple[HalfHour, ...], arrival: datetime, end: datetime | None) -> Iterator[tuple[float, float]]:
    """(what could flow, intensity) of every half hour of the stay, in order: never less than what did flow."""
    flowing = [row.start for row in rows if row.kwh > 0.0]
    first = min([arrival, *flowing[:1]])
    last = max([end or arrival, *(start + HALF_HOUR for start in flowing[-1:])])
    for row in rows:
        stop = row.start + HALF_HOUR
        part_h = hours(min(stop, last) - max(row.start, first))
        if part_h > 0.0:
            yield max(row.limit_kw * min(part_h, SLOT_H), row.kwh), row.carbon_g_per_kwh


def _filled_g(kwh: float, rooms: Iterable[tuple[float, float]]) -> float:
    """Grams of an energy poured into rooms in their order."""
    carbon_g, left_kwh = 0.0, kwh
    for room_kwh, g_per_kwh in rooms:
        part_kwh = min(left_kwh, room_kwh)
        carbon_g += part_kwh * g_per_kwh
        left_kwh -= part_kwh
    return carbon_g


def _soc_at(rows: tuple[HalfHour, ...], moment: datetime) -> float:
    """The estimate at a moment, on the straight line between two half hours."""
    for before, after in pairwise(rows):
        if before.start <= moment < after.start:
            share = (moment - before.start) / (after.start - before.start)
            return before.soc + share * (after.soc - before.soc)
    return rows[-1].soc if moment >= rows[-1].start else rows[0].soc


@dataclass(frozen=True, slots=True)
class Sum:
    """Nights together."""

    nights: int
    kwh: float
    carbon_g: float
    on_arrival_g: float
    best_g: float
    switch_ons: int
    missed: int

    @property
    def saved_g(self) -> float:
        """Against charging on arrival."""
        return self.on_arrival_g - self.carbon_g

    @property
    def saved_pct(self) -> float | None:
        """The same in percent; None where nothing flowed."""
        return 100.0 * self.saved_g / self.on_arrival_g if self.on_arrival_g > 0.0 else None

    def per_kwh(self, grams: float) -> float | None:
        """Grams over this energy; None where nothing flowed."""
        return grams / self.kwh if self.kwh > 0.0 else None


def total(found: Iterable[Night]) -> Sum:
    """What nights come to."""
    those = tuple(found)
    return Sum(
        nights=len(those),
        kwh=sum(n.kwh for n in those),
        carbon_g=sum(n.carbon_g for n in those),
        on_arrival_g=sum(n.on_arrival_g for n in those),
        best_g=sum(n.best_g for n in those),
        switch_ons=sum(n.switch_ons for n in those),
        missed=sum(n.missed for n in those),
    )


def months(found: Iterable[Night]) -> Iterator[tuple[date, Sum]]:
    """Sums by calendar month (its first day) of the evening."""
    for month, those in groupby(found, key=lambda n: n.day.replace(day=1)):
        yield month, total(those)
