"""The ledger as the cycle keeps it: a half hour is opened, filled, closed, and a day later made final."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import date, datetime, timedelta

from plugd import ledger
from plugd.domain import Decision, Household, Memory, Reading, Savings
from plugd.ledger import HalfHour, Night
from plugd.outlook import typical_g_per_kwh
from plugd.ports import Books
from plugd.units import HALF_HOUR, slot_start

LONGEST_GAP = timedelta(days=7)
"""What plugd slept through is entered by the half hour up to this; after longer it begins anew."""
SETTLE_RETRY = timedelta(hours=6)
KEPT_NIGHTS = 35
"""Nights at hand; older ones count in the total only."""


def of_this_time(rows: Sequence[HalfHour], now: datetime) -> tuple[HalfHour, ...]:
    """The half hours without those of a clock that ran ahead: they lie beyond a gap, and now lies in it or before all.

    They stay where they are kept: should the clock be wrong now, they are the true ones.
    """
    count = bisect_right(rows, now, key=lambda row: row.start)
    before = rows[count - 1].start if count else now
    beyond_gap = count < len(rows) and rows[count].start - before > LONGEST_GAP
    return tuple(rows[:count] if beyond_gap else rows)


@dataclass(slots=True)
class Book:
    """One household's ledger. `note` is called at every step; it writes once a half hour."""

    books: Books
    household: Household
    rows: list[HalfHour] = field(default_factory=list)
    """The half hours at hand, in order of time; the last one is open."""
    nights: dict[date, Night] = field(default_factory=dict)
    """The account of each night at hand."""
    older_g: float = 0.0
    """Saved in nights that are no longer at hand."""
    loaded: bool = False
    looked_at: datetime | None = None
    _noted: datetime | None = None
    _relay_on: bool | None = None
    _meter_kwh: float | None = None
    _metered_at: datetime | None = None
    _unwritten: set[datetime] = field(default_factory=set)
    _changed: set[date] = field(default_factory=set)

    def note(self, now: datetime, reading: Reading | None, decision: Decision, memory: Memory) -> None:
        """Enter what has flowed and moved since the last call. Raises StoreError; it is entered with the next then."""
        self._load(now)
        if self.rows and now < self.rows[-1].start:
            return  # the clock was set back: what is entered stands until it has caught up
        self._open(now, decision, memory)
        if memory.relay_on and self._relay_on is False:
            self._enter(replace(self.rows[-1], switch_ons=self.rows[-1].switch_ons + 1))
        self._relay_on = memory.relay_on
        if reading is not None:
            self._flowed(now, reading, memory)
        self._write()

    def settle(self, now: datetime) -> None:
        """Make final what was measured a day ago. Raises StoreError."""
        pending = [row for row in self.rows if ledger.may_settle(row, now)]
        due = self.looked_at is None or not timedelta(0) <= now - self.looked_at < SETTLE_RETRY
        if not pending or not due:
            return
        self.looked_at = now
        known = {value.start: value.g_per_kwh for value in self.books.measured(pending[0].start)}
        for row in pending:
            self._enter(ledger.settled(row, known.get(row.start), now))
        self._write()

    def saved(self, now: datetime) -> Savings | None:
        """Of the night under way or just over, and in all; None before the first entry."""
        if not self.rows:
            return None
        self._account()
        tonight = self.nights.get(ledger.night_of(now, self.household))
        total_g = self.older_g + sum(night.saved_g for night in self.nights.values())
        return Savings(tonight.saved_g if tonight else 0.0, total_g)

    def known(self) -> tuple[tuple[HalfHour, ...], tuple[Night, ...]]:
        """The half hours and nights at hand, as values that stay."""
        self._account()
        return tuple(self.rows), tuple(self.nights.values())

    # -- entering ---------------------------------------------------------------------------------

    def _load(self, now: datetime) -> None:
        """What is kept, at first and when time has jumped: then other half hours may be of this time."""
        jumped = self._noted is not None and not -LONGEST_GAP <= now - self._noted <= LONGEST_GAP
        if self.loaded and not jumped:
            self._noted = now
            return
        if self._unwritten:
            self._enter_all()
        self.rows = list(of_this_time(self.books.half_hours(), now))
        self.nights, self.older_g = {}, 0.0
        self._changed = {row.night for row in self.rows}
        self._account()
        if self.rows:
            self._meter_kwh, self._metered_at = self.rows[-1].meter_kwh, self.rows[-1].metered_at
        self.loaded, self._noted = True, now

    def _open(self, now: datetime, decision: Decision, memory: Memory) -> None:
        """Open the half hour under way and those slept through; keep the open one's intensity as last known."""
        slot = slot_start(now)
        if not self.rows or slot - self.rows[-1].start > LONGEST_GAP:
            self._append(slot, memory)
        while self.rows[-1].start < slot:
            self._unwritten.add(self.rows[-1].start)
            self._append(self.rows[-1].start + HALF_HOUR, memory)
        outlook = decision.outlook
        known = next((s.g_per_kwh for s in outlook.slots if s.start == slot), None) if outlook else None
        if known is not None and known != self.rows[-1].g_per_kwh:
            self._enter(replace(self.rows[-1], g_per_kwh=known))

    def _append(self, start: datetime, memory: Memory) -> None:
        # What plugd slept through it knows no better than by the built-in day, until it is measured.
        row = ledger.opened(start, memory, self.household, typical_g_per_kwh(start))
        self.rows.append(replace(row, meter_kwh=self._meter_kwh, metered_at=self._metered_at))
        self._unwritten.add(start)
        self._changed.add(row.night)

    def _flowed(self, now: datetime, reading: Reading, memory: Memory) -> None:
        at = reading.metered_at or now
        if self._metered_at is not None and at <= self._metered_at:
            return
        limit_kw = max(memory.observed_kw or 0.0, self.household.capability.power_max_kw)
        taken_kwh = ledger.taken_kwh((self._meter_kwh, self._metered_at), at, reading, limit_kw)
        parts = ledger.spread(taken_kwh, self._metered_at, at)
        for row in [r for r in self.rows[-len(parts) - 1 :] if parts.get(r.start, 0.0) > 0.0]:
            self._enter(replace(row, kwh=row.kwh + parts[row.start]))
        self._metered_at = at
        if reading.energy_kwh is not None:
            self._meter_kwh = reading.energy_kwh
        # Not a change worth writing: it is what a restart within this half hour goes on from.
        self.rows[-1] = replace(self.rows[-1], meter_kwh=self._meter_kwh, metered_at=at)

    def _enter(self, row: HalfHour) -> None:
        index = (row.start - self.rows[0].start) // HALF_HOUR
        if index >= len(self.rows) or self.rows[index].start != row.start:  # after a gap that was not filled
            index = next(i for i, known in enumerate(self.rows) if known.start == row.start)
        if self.rows[index] != row:
            self.rows[index] = row
            self._unwritten.add(row.start)
            self._changed.add(row.night)

    def _write(self) -> None:
        """Write what has changed, once something other than the open half hour has."""
        if self._unwritten - {self.rows[-1].start}:
            self._enter_all()

    def _enter_all(self) -> None:
        self.books.enter(tuple(row for row in self.rows if row.start in self._unwritten))
        self._unwritten.clear()

    def _account(self) -> None:
        """The nights whose half hours have changed, anew; the oldest ones go."""
        car = self.household.car
        for day in sorted(self._changed):
            rows = tuple(row for row in self.rows if row.night == day)
            self.nights[day] = ledger.night(day, rows, car.efficiency, car.capacity_kwh)
        self._changed.clear()
        while len(self.nights) > KEPT_NIGHTS:
            day = min(self.nights)
            self.older_g += self.nights.pop(day).saved_g
            self.rows = [row for row in self.rows if row.night != day]
