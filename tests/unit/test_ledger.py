"""The ledger: what is entered is what flowed, intensities are set twice and never again, comparisons are exact."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import date, datetime, time, timedelta
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd import ledger
from plugd.beat import is_on
from plugd.book import Book
from plugd.cycle import Cycle
from plugd.domain import Household, Intensity, Nights, Reading
from plugd.errors import StoreError
from plugd.ledger import HalfHour, night, night_of, nights, settled, spread, taken_kwh, total, usual_arrival
from plugd.perception import fresh
from plugd.units import HALF_HOUR, slot_start
from tests.unit.deciding import HOME, NIGHT, Room, at, knows, minutes

DAY = date(2023, 1, 2)
START = at(18)
END = at(6, 57, day=3)


def row(k: int, kwh: float = 0.0, g_per_kwh: float = 100.0, **more: object) -> HalfHour:
    """The k-th half hour after 18:00 on the 2nd."""
    plain = HalfHour(START + k * HALF_HOUR, kwh, g_per_kwh, None, 0.5, 0, DAY, START, False, 2.0, END, 0.5, None, None)
    return replace(plain, **more)  # type: ignore[arg-type]


# -- nights ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("moment", "day"),
    [
        (at(18), 2),
        (at(13, 30), 2),
        (at(13, 29), 1),
        (at(3, day=3), 2),
        (at(13, 29, day=3), 2),
        (at(13, 30, day=3), 3),
    ],
)
def test_nights_meet_in_the_middle_of_the_time_away(moment: datetime, day: int) -> None:
    assert night_of(moment, HOME) == date(2023, 1, day)


def test_a_car_that_is_home_by_day_has_its_night_by_day() -> None:
    home = Household(nights=Nights(plug_in=time(7), plug_out=time(21)))
    assert {night_of(at(hour, 30), home) for hour in (6, 7, 12, 20, 22)} == {DAY}
    assert usual_arrival(DAY, home) == at(7)


def test_a_car_that_comes_home_after_midnight_belongs_to_the_night_before() -> None:
    home = Household(nights=Nights(plug_in=time(0, 30), plug_out=time(8)))
    arrival = usual_arrival(DAY, home)
    assert arrival == at(0, 30, day=3)
    assert night_of(arrival, home) == DAY


@given(st.integers(0, 360 * 96))
def test_the_usual_arrival_lies_in_its_own_night_all_year(quarters: int) -> None:
    moment = START + minutes(15 * quarters)
    day = night_of(moment, HOME)
    assert night_of(usual_arrival(day, HOME), HOME) == day
    assert abs(usual_arrival(day, HOME) - moment) < timedelta(hours=25)


def test_a_night_is_compared_with_arrival_and_with_the_cleanest_half_hours() -> None:
    """4 half hours at 2 kW: 1 kWh each. 1.5 kWh flowed in the last two."""
    rows = (row(0, 0.0, 300.0), row(1, 0.0, 200.0), row(2, 1.0, 100.0, switch_ons=1), row(3, 0.5, 150.0, soc=0.52))
    found = night(DAY, rows, 0.9, 50.0)
    assert found.kwh == 1.5
    assert found.carbon_g == 1.0 * 100 + 0.5 * 150
    assert found.on_arrival_g == 1.0 * 300 + 0.5 * 200
    assert found.best_g == 1.0 * 100 + 0.5 * 150
    assert found.saved_g == 400 - 175
    assert found.switch_ons == 1
    assert found.arrival_soc == 0.5


def test_arrival_counts_from_the_minute_it_was_told() -> None:
    told = {"arrival": START + minutes(15), "arrival_told": True}
    rows = (row(0, 0.0, 300.0), row(1, 0.0, 200.0, **told), row(2, 1.0, 100.0, **told))
    found = night(DAY, rows, 0.9, 50.0)
    assert found.arrival_told
    assert found.on_arrival_g == 0.5 * 300 + 0.5 * 200


def test_the_morning_is_read_at_the_session_end() -> None:
    k = (at(6, 30, day=3) - START) // HALF_HOUR
    assert night(DAY, (row(k - 1), row(k)), 0.9, 50.0).morning_soc is not None
    assert night(DAY, (row(k - 2), row(k - 1)), 0.9, 50.0).morning_soc is None
    rows = (row(k, soc=0.5), row(k + 1, soc=0.6, session_end=None))
    assert night(DAY, rows, 0.9, 50.0).morning_soc == pytest.approx(0.59)


@pytest.mark.parametrize(("morning", "could", "missed"), [(0.44, 8.0, True), (0.496, 8.0, False), (0.44, 0.0, False)])
def test_only_a_minimum_that_could_be_reached_is_missed(morning: float, could: float, missed: bool) -> None:
    k = (at(6, 30, day=3) - START) // HALF_HOUR
    rows = (row(0, soc=0.43, limit_kw=could), row(k, soc=morning, limit_kw=could))
    rows = (replace(rows[0], kwh=0.01), rows[1])
    assert night(DAY, rows, 0.9, 50.0).missed is missed


AMOUNTS = st.lists(
    st.tuples(st.floats(0.0, 1.2), st.floats(0.0, 500.0), st.sampled_from([0.8, 1.0, 2.0, 3.0])),
    min_size=1,
    max_size=28,
)


@given(AMOUNTS, st.integers(-3, 20))
def test_the_best_is_never_worse_and_all_have_the_same_energy(
    amounts: list[tuple[float, float, float]], arrived: int
) -> None:
    arrival = START + arrived * minutes(17)
    rows = tuple(row(k, kwh, g, limit_kw=limit, arrival=arrival) for k, (kwh, g, limit) in enumerate(amounts))
    found = night(DAY, rows, 0.9, 50.0)
    assert found.best_g <= found.carbon_g + 1e-6
    assert found.best_g <= found.on_arrival_g + 1e-6
    flat = night(DAY, tuple(replace(r, g_per_kwh=1.0) for r in rows), 0.9, 50.0)
    assert flat.on_arrival_g == pytest.approx(flat.kwh)
    assert flat.best_g == pytest.approx(flat.kwh)


def test_sums_are_the_sums_of_the_nights() -> None:
    rows = (row(0, 1.0, 200.0), row(1), row(48, 0.5, 100.0, night=date(2023, 1, 3), arrival=START + timedelta(days=1)))
    found = tuple(nights(rows, 0.9, 50.0))
    assert [n.kwh for n in found] == [1.0, 0.5]
    whole = total(found)
    assert (whole.nights, whole.kwh, whole.carbon_g) == (2, 1.5, 250.0)
    assert whole.per_kwh(whole.carbon_g) == pytest.approx(250 / 1.5)
    assert [(month, part.kwh) for month, part in ledger.months(found)] == [(date(2023, 1, 1), 1.5)]


# -- entries --------------------------------------------------------------------------------------


@given(st.floats(0.0, 50.0), st.integers(1, 40_000), st.integers(0, 3600))
def test_energy_is_spread_whole_over_the_time_it_flowed_in(kwh: float, length_s: int, offset_s: int) -> None:
    start = START + timedelta(seconds=offset_s)
    end = start + timedelta(seconds=length_s)
    parts = spread(kwh, start, end)
    assert sum(parts.values()) == pytest.approx(kwh)
    assert min(parts) == slot_start(start)
    assert max(parts) <= slot_start(end)


def test_a_meter_that_starts_anew_or_jumps_adds_no_nonsense() -> None:
    later = START + HALF_HOUR

    def taken(before: float | None, after: float) -> float:
        return taken_kwh((before, START), later, Reading(later, True, 2.3, after, later), 2.3)

    assert taken(10.0, 11.0) == 1.0
    assert taken(10.0, 0.4) == 0.4
    assert taken(10.0, 9.0) == 0.0
    assert taken(10.0, 1e6) == 0.0
    assert taken(None, 10.0) == 0.0


def test_without_a_meter_the_power_counts_and_without_that_the_plugs_own() -> None:
    later = START + minutes(15)
    assert taken_kwh((None, START), later, Reading(later, True, 2.0), 2.3) == 0.5
    assert taken_kwh((None, START), later, Reading(later, True), 2.0) == 0.5
    assert taken_kwh((None, START), later, Reading(later, False), 2.0) == 0.0
    assert taken_kwh((None, START), START + timedelta(hours=9), Reading(later, True, 2.0), 2.3) == 0.0


def test_an_intensity_is_made_final_once_and_stays() -> None:
    fresh_row, day_later = row(0), START + HALF_HOUR + timedelta(hours=24)
    assert settled(fresh_row, 90.0, day_later - minutes(1)) is fresh_row
    assert settled(fresh_row, None, day_later) is fresh_row
    final = settled(fresh_row, 90.0, day_later)
    assert final.carbon_g_per_kwh == 90.0
    assert final.g_per_kwh == 100.0
    assert settled(final, 80.0, day_later + timedelta(days=9)) is final
    assert settled(fresh_row, None, day_later + timedelta(days=3)).carbon_g_per_kwh == 100.0


# -- the book, kept by the cycle ------------------------------------------------------------------


@dataclass(slots=True)
class Shelf:
    """Books in memory, and what was measured; `full` is a full card."""

    kept: dict[datetime, HalfHour] = field(default_factory=dict)
    writes: int = 0
    full: bool = False
    level: float = 80.0
    away: bool = False
    asked: list[datetime] = field(default_factory=list)

    def half_hours(self, since: datetime | None = None) -> tuple[HalfHour, ...]:
        """What is kept."""
        return tuple(self.kept[start] for start in sorted(self.kept))

    def enter(self, rows: Sequence[HalfHour]) -> None:
        """Keep."""
        if self.full:
            raise StoreError("the card is full")
        self.writes += 1
        self.kept |= {r.start: r for r in rows}

    def measured(self, since: datetime) -> tuple[Intensity, ...]:
        """The same value for all of a fortnight."""
        self.asked.append(since)
        return () if self.away else tuple(Intensity(since + k * HALF_HOUR, self.level) for k in range(14 * 48))


def housed(shelf: Shelf, start: datetime = START, soc: float = 0.4) -> Room:
    """A household whose cycle keeps a ledger."""
    room = Room(start, knows(soc, start))
    room.cycle.book = Book(shelf, HOME)
    return room


def book_of(cycle: Cycle) -> Book:
    assert cycle.book is not None
    return cycle.book


def test_the_ledger_of_two_nights_agrees_with_the_log_of_the_meter() -> None:
    """Recomputed from the raw log lines: energy by half hour, then grams by what the forecast said."""
    shelf = Shelf()
    room = housed(shelf)
    room.run(START + timedelta(days=2))
    log = room.disk.ram.records
    by_slot: dict[datetime, float] = {}
    for before, after in pairwise(log):
        assert before.energy_kwh is not None
        assert after.energy_kwh is not None
        slot = slot_start(before.at)
        by_slot[slot] = by_slot.get(slot, 0.0) + after.energy_kwh - before.energy_kwh
    rows, found = book_of(room.cycle).known()
    assert sum(by_slot.values()) > 5.0
    assert {r.start: r.kwh for r in rows if r.kwh > 0.0} == pytest.approx({s: k for s, k in by_slot.items() if k > 0.0})
    grams = sum(k * (100.0 if 2 <= s.hour < 5 else 200.0) for s, k in by_slot.items() if s >= rows[-40].start)
    assert sum(r.kwh * r.carbon_g_per_kwh for r in rows[-40:]) == pytest.approx(grams)
    saved = book_of(room.cycle).saved(room.clock.now())
    assert saved is not None
    assert saved.total_g == pytest.approx(sum(n.on_arrival_g - n.carbon_g for n in found))
    assert room.hub.decision is not None
    assert room.hub.decision.saved is not None
    relay = [False, *(is_on(wanted) for wanted in room.plug.told)]  # the log is of each half hour, and misses some
    assert sum(r.switch_ons for r in rows) == sum(b and not a for a, b in pairwise(relay)) > 0


def test_it_writes_once_a_half_hour() -> None:
    shelf = Shelf()
    room = housed(shelf)
    for minute in range(0, 180, 1):
        room.step(START + minutes(minute))
    assert shelf.writes <= 7


def test_a_restart_in_the_middle_of_a_half_hour_loses_no_energy() -> None:
    shelf = Shelf()
    room = housed(shelf)
    for minute in range(0, 700, 7):
        room.step(START + minutes(minute))
        if minute % 140 == 0:
            memory = room.cycle.memory
            room.begin(memory).book = Book(shelf, HOME)
    assert room.plug.energy_kwh > 2.0
    assert sum(r.kwh for r in book_of(room.cycle).known()[0]) == pytest.approx(room.plug.energy_kwh)


def test_what_flowed_while_it_slept_is_entered_over_that_time() -> None:
    shelf = Shelf()
    room = housed(shelf, NIGHT)
    room.step(NIGHT)
    room.plug.on = True
    room.step(NIGHT + timedelta(hours=3))
    rows, _ = book_of(room.cycle).known()
    assert [round(r.kwh, 3) for r in rows[:6]] == [1.15] * 6
    starts = [r.start for r in rows]
    assert all(b - a == HALF_HOUR for a, b in pairwise(starts))


def test_a_full_card_costs_no_entry_once_there_is_room() -> None:
    shelf = Shelf()
    room = housed(shelf)
    room.step(START)
    shelf.full = True
    room.run(START + timedelta(hours=6))
    assert "store" in room.faults()
    shelf.full = False
    room.run(START + timedelta(hours=12))
    assert "store" not in room.faults()
    kept = shelf.half_hours()
    assert [r.start for r in kept] == [START + k * HALF_HOUR for k in range(len(kept))]
    assert sum(r.kwh for r in kept) == pytest.approx(room.plug.energy_kwh, abs=1.2)


def test_figures_change_once_when_they_are_measured_and_then_stand_still() -> None:
    shelf = Shelf()
    room = housed(shelf)
    room.run(START + timedelta(hours=23))
    first, _ = book_of(room.cycle).known()
    room.run(START + timedelta(hours=72))
    final, _ = book_of(room.cycle).known()
    assert {r.final_g_per_kwh for r in final[: len(first)]} == {80.0}
    assert [r.g_per_kwh for r in final[: len(first) - 1]] == [r.g_per_kwh for r in first[:-1]]
    shelf.level = 10.0
    room.run(START + timedelta(hours=120))
    again, _ = book_of(room.cycle).known()
    assert again[: len(first)] == final[: len(first)]
    assert 10.0 in {r.final_g_per_kwh for r in again}


def test_as_long_as_nothing_is_measured_nothing_is_made_final_and_it_looks_again_only_after_hours() -> None:
    shelf = Shelf(away=True)
    room = housed(shelf)
    room.run(START + timedelta(hours=48))
    assert 1 <= len(shelf.asked) <= 5
    assert all(r.final_g_per_kwh is None for r in shelf.half_hours())


def test_a_clock_set_back_overwrites_nothing() -> None:
    shelf = Shelf()
    room = housed(shelf)
    room.run(START + timedelta(hours=10))
    before, _ = book_of(room.cycle).known()
    room.step(START + timedelta(hours=3))
    assert book_of(room.cycle).known()[0] == before


@pytest.mark.parametrize("restarts", [False, True])
def test_a_clock_that_ran_ahead_and_was_set_right_does_not_stop_the_ledger(restarts: bool) -> None:
    """For hours it was weeks ahead. What flowed meanwhile is entered over the true time, by the meter's total."""
    days = 20
    shelf = Shelf()
    room = housed(shelf)
    room.run(START + timedelta(hours=6))
    room.step(START + timedelta(days=days, hours=6))
    room.run(START + timedelta(days=days, hours=8))
    ahead = {start: r for start, r in shelf.kept.items() if start > START + timedelta(days=days)}
    assert ahead
    room.clock.at = START + timedelta(hours=8)
    room.plug.ran_to = None
    if restarts:
        room.cycle.book = Book(shelf, HOME)
    room.run(START + timedelta(hours=18))
    rows, nights = book_of(room.cycle).known()
    assert [r.start for r in rows] == [START + k * HALF_HOUR for k in range(len(rows))], "no half hour is left out"
    assert rows[-1].start >= START + timedelta(hours=17, minutes=30)
    assert sum(r.kwh for r in rows) == pytest.approx(room.plug.energy_kwh, abs=0.1)
    assert max(night.day for night in nights) <= (START + timedelta(days=2)).date()
    assert ahead.keys() <= shelf.kept.keys(), "nothing is taken out of the store: it may have been right after all"


def test_a_first_start_with_a_clock_years_ahead_does_not_stop_the_ledger_for_years() -> None:
    shelf = Shelf()
    room = housed(shelf)
    room.step(START + timedelta(days=1500))
    room.run(START + timedelta(days=1500, hours=2))
    assert shelf.kept
    room.clock.at = START
    room.plug.ran_to = None
    room.run(START + timedelta(hours=3))
    assert book_of(room.cycle).known()[0][0].start == START
    assert START + timedelta(hours=2) in shelf.kept


def test_a_clock_set_back_into_a_time_without_plugd_and_set_right_again_loses_nothing() -> None:
    shelf = Shelf()
    room = housed(shelf)
    room.run(START + timedelta(hours=3))
    room.step(START + timedelta(days=30))
    room.run(START + timedelta(days=30, hours=2))
    before = book_of(room.cycle).known()[0]
    room.step(START + timedelta(days=12))
    room.step(START + timedelta(days=30, hours=10, minutes=30))
    room.run(START + timedelta(days=30, hours=11))
    kept = {r.start: r for r in book_of(room.cycle).known()[0]}
    assert all(kept[r.start].kwh >= r.kwh for r in before)


def test_an_arrival_that_was_told_is_entered() -> None:
    shelf = Shelf()
    book = Book(shelf, HOME)
    memory = fresh(START)
    here = replace(memory, presence=replace(memory.presence, connected=True, since=START + minutes(3)))
    assert ledger.opened(START, memory, HOME, 1.0).arrival == START
    told = ledger.opened(START + HALF_HOUR, here, HOME, 1.0)
    assert (told.arrival, told.arrival_told) == (START + minutes(3), True)
    since_long = replace(here, presence=replace(here.presence, since=START - timedelta(days=3)))
    assert ledger.opened(START, since_long, HOME, 1.0).arrival_told is False
    assert book.saved(START) is None


def test_old_nights_count_in_the_total_when_they_are_no_longer_at_hand() -> None:
    shelf = Shelf()
    for k in range(50):
        day = DAY + timedelta(days=k)
        begin = START + timedelta(days=k)
        clean = replace(row(0), start=begin + HALF_HOUR, night=day, arrival=begin, kwh=0.5, g_per_kwh=50.0)
        dirty = replace(clean, start=begin, kwh=0.0, g_per_kwh=250.0)
        shelf.enter([replace(r, final_g_per_kwh=r.g_per_kwh) for r in (dirty, clean)])
    book = Book(shelf, HOME)
    room = housed(shelf, START + timedelta(days=50))
    room.cycle.book = book
    room.step()
    saved = book.saved(room.clock.now())
    assert saved is not None
    assert saved.total_g == pytest.approx(50 * 0.5 * 200.0)
    assert len(book.nights) <= 35
