"""What is seen of a household, what is learned from it, and what never is."""

import random
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, date, datetime, time, timedelta
from itertools import islice, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugd import commands, habits, perception, sessions
from plugd.adapters.store import SqliteStore
from plugd.domain import (
    Command,
    DayRule,
    Habits,
    Household,
    Memory,
    Nights,
    Overrides,
    Presence,
    Reading,
    SeenNight,
    SetConnected,
    SetSoc,
    SetTrip,
    Trip,
)
from plugd.planner.exact import Exact
from plugd.study.house import FunctionSource, House
from plugd.study.world import Driver
from plugd.units import hours

HOUSE = Household(nights=Nights(learn=True))
DAY = timedelta(days=1)
MONDAY = date(2023, 1, 2)
NOON = datetime(2023, 1, 2, 12, tzinfo=UTC)
CONFIDENCE = 0.98


def seen(count: int, plug_in: float = 1080, plug_out: float = 540, use_kwh: float = 5.8) -> Habits:
    """That many nights, all alike."""
    nights = (SeenNight(MONDAY + DAY * k, plug_in, plug_out, use_kwh) for k in range(count))
    return habits.kept(Habits(), *nights)


def coming(household: Household, now: datetime = NOON + 84 * DAY) -> tuple[object, ...]:
    """A week of windows."""
    return tuple(islice(sessions.windows(household, Overrides(), now), 7))


nights = st.builds(
    SeenNight,
    st.dates(date(2022, 1, 1), date(2025, 12, 31)),
    st.none() | st.floats(0, 2000),
    st.none() | st.floats(-300, 1400),
    st.none() | st.floats(0, 40),
)
numbers = st.lists(st.floats(0, 1400), min_size=1, max_size=40)
spreads = st.floats(0, 120)


# -- what is learned ------------------------------------------------------------------------------


@given(st.lists(nights, max_size=habits.LEAST_NIGHTS - 1))
def test_before_four_weeks_are_seen_nothing_is_other_than_configured(found: list[SeenNight]) -> None:
    assert habits.informed(HOUSE, habits.kept(Habits(), *found)) == HOUSE


@given(st.lists(nights, max_size=150))
@settings(max_examples=25)
def test_a_morning_minimum_is_never_learned(found: list[SeenNight]) -> None:
    learned = habits.informed(HOUSE, habits.kept(Habits(), *found))
    assert learned.nights == HOUSE.nights
    asked = replace(HOUSE, nights=replace(HOUSE.nights, week=((5, DayRule(minimum=0.7)),)))
    for house in (learned, replace(learned, nights=asked.nights)):
        expected = sessions.expected(NOON, house, Overrides(), Presence(), 7)
        assert [s.minimum for s in expected] == [
            s.minimum for s in sessions.expected(NOON, replace(house, learned=None), Overrides(), Presence(), 7)
        ]


@given(numbers, st.floats(300, 1200), spreads, st.floats(0, 300), st.data())
def test_a_later_night_is_never_a_smaller_quantile(
    found: list[float], mean: float, sd: float, more: float, data: st.DataObject
) -> None:
    moved = found.copy()
    moved[data.draw(st.integers(0, len(found) - 1))] += more
    for learn in (habits.late, habits.early):
        before, after = learn(found, mean, sd, CONFIDENCE), learn(moved, mean, sd, CONFIDENCE)
        assert after.low >= before.low - 0.05
        assert after.high >= before.high - 0.05


@given(numbers, st.floats(300, 1200), spreads)
def test_more_confidence_is_more_caution(found: list[float], mean: float, sd: float) -> None:
    arrivals = [habits.late(found, mean, sd, confidence).high for confidence in (0.9, 0.95, 0.98, 0.99)]
    departures = [habits.early(found, mean, sd, confidence).low for confidence in (0.9, 0.95, 0.98, 0.99)]
    assert all(b >= a - 0.05 for a, b in pairwise(arrivals))
    assert all(b <= a + 0.05 for a, b in pairwise(departures))


@given(st.floats(0.01, 0.99), st.floats(-500, 500), st.floats(0.1, 200))
def test_of_nothing_seen_the_configured_quantile_is_learned(share: float, mean: float, sd: float) -> None:
    expected = mean + sessions.z_score(share) * sd
    assert habits.quantile(share, [], mean, sd) == pytest.approx(expected, abs=sd * 1e-3)


def left_before(low_min: float, draw: Iterator[float]) -> float:
    """The share of a thousand departures that are earlier."""
    return sum(moment < low_min for moment in islice(draw, 1000)) / 1000


@pytest.mark.parametrize(("mean", "sd"), [(540.0, 60.0), (600.0, 20.0), (420.0, 30.0)])
@pytest.mark.parametrize("count", [habits.LEAST_NIGHTS, 80])
def test_few_households_are_left_early_by_a_learned_departure(mean: float, sd: float, count: int) -> None:
    """One household in ten may see a little more than the promised fiftieth; on average they see less."""
    dice = random.Random(7)
    draw = iter(lambda: dice.gauss(mean, sd), None)
    misses = sorted(
        left_before(habits.early(list(islice(draw, count)), 540.0, 60.0, CONFIDENCE).low, draw) for _ in range(100)
    )
    assert sum(misses) / len(misses) <= 0.02
    assert misses[89] <= 0.04


def test_a_household_as_configured_is_left_alone_but_for_caution() -> None:
    dice = random.Random(1)
    found = [dice.gauss(540, 60) for _ in range(80)]
    learned = habits.early(found, 540, 60, CONFIDENCE).low
    assert 360 <= learned <= 540 - sessions.z_score(CONFIDENCE) * 60 + 0.1


def test_a_household_that_leaves_earlier_is_ready_earlier() -> None:
    learned = habits.informed(HOUSE, seen(habits.LEAST_NIGHTS, plug_out=360))
    for usual, now in zip(coming(HOUSE), coming(learned), strict=True):
        assert hours(usual.session.end - now.session.end) > 1.0  # type: ignore[attr-defined]


def test_a_regular_household_gets_a_longer_night_and_plans_with_less_use() -> None:
    learned = habits.informed(HOUSE, seen(84))
    for usual, now in zip(coming(HOUSE), coming(learned), strict=True):
        assert 0.8 < hours(usual.session.start - now.session.start) < 2.05  # type: ignore[attr-defined]
        assert 0.8 < hours(now.session.end - usual.session.end) < 2.05  # type: ignore[attr-defined]
        assert now.early_plug_in == usual.early_plug_in  # type: ignore[attr-defined]
        assert now.late_plug_out == usual.late_plug_out  # type: ignore[attr-defined]
        assert 5.8 < now.session.daily_use_kwh < 9.0  # type: ignore[attr-defined]
    assert learned.car.daily_use_kwh == pytest.approx(5.8)
    assert learned.car.daily_use_sd_kwh < 0.5 * HOUSE.car.daily_use_sd_kwh


def test_a_ready_by_is_taken_as_it_is() -> None:
    learned = habits.informed(HOUSE, seen(84, plug_out=660))
    asked = Overrides(ready_by=time(6, 30))
    session = sessions.expected(NOON, learned, asked, Presence(), 1)[0]
    assert session.end == datetime(2023, 1, 3, 6, 30, tzinfo=UTC)


def test_weekends_are_learned_apart_once_enough_of_them_are_seen() -> None:
    def of(weeks: int) -> tuple[float, float]:
        days = (MONDAY + DAY * k for k in range(7 * weeks))
        found = (SeenNight(day, plug_out_min=660 if day.weekday() >= 5 else 480) for day in days)
        learned = habits.informed(HOUSE, habits.kept(Habits(), *found)).learned
        assert learned is not None
        assert learned.plug_out_min is not None
        return learned.plug_out_min[0].low, learned.plug_out_min[1].low

    weekday, weekend = of(6)
    assert weekend == pytest.approx(weekday, abs=45)
    weekday, weekend = of(16)
    assert weekend > weekday + 60


def test_not_wanted_or_seen_in_part_it_is_not_learned() -> None:
    unwanted = replace(HOUSE, nights=replace(HOUSE.nights, learn=False))
    assert habits.informed(unwanted, seen(84)) == unwanted
    found = (SeenNight(MONDAY + DAY * k, use_kwh=4.0) for k in range(60))
    learned = habits.informed(HOUSE, habits.kept(Habits(), *found))
    assert learned.learned is not None
    assert learned.learned.plug_in_min is None
    usual = coming(HOUSE)
    assert [w.session.end for w in coming(learned)] == [w.session.end for w in usual]  # type: ignore[attr-defined]


@given(st.lists(nights, max_size=400))
@settings(max_examples=30)
def test_what_is_remembered_is_bounded(found: list[SeenNight]) -> None:
    known = Habits()
    for night in found:
        known = habits.kept(known, night)
    days = [night.day for night in known.nights]
    assert days == sorted(set(days))
    assert len(days) <= (habits.SPAN + habits.AHEAD).days
    assert not found or found[-1].day in days


def test_a_clock_that_ran_ahead_does_not_end_learning() -> None:
    wrong = habits.kept(seen(40), SeenNight(date(2037, 1, 1), 1000))
    again = habits.kept(wrong, SeenNight(MONDAY + 41 * DAY, 1000))
    assert [night.day for night in again.nights] == [MONDAY + 41 * DAY]


@given(st.lists(nights, max_size=60))
@settings(max_examples=10)
def test_it_survives_a_restart(tmp_path_factory: pytest.TempPathFactory, found: list[SeenNight]) -> None:
    known = replace(habits.kept(Habits(), *found), arrived_at=NOON, level_kwh=20.0, day=MONDAY, whole=True)
    memory = replace(perception.fresh(NOON), habits=known)
    with SqliteStore(tmp_path_factory.mktemp("state")) as store:
        store.save(memory)
        assert store.load() == memory


# -- what is seen ---------------------------------------------------------------------------------


def obeyed(memory: Memory, *said: tuple[datetime, Command]) -> Memory:
    for now, command in said:
        memory, _ = commands.apply((command,), memory, HOUSE, now)
        memory = perception.perceive(now, None, memory, HOUSE)
    return memory


def metered(memory: Memory, now: datetime, total_kwh: float) -> Memory:
    return perception.perceive(now, Reading(now, True, 2.3, total_kwh, now), memory, HOUSE)


def at(hour: float, day: int = 2) -> datetime:
    return datetime(2023, 1, day, tzinfo=UTC) + timedelta(hours=hour)


HERE, GONE = SetConnected(True), SetConnected(False)


def stays(*moments: datetime) -> tuple[SeenNight, ...]:
    """What is seen of somebody who comes and goes at these moments, having been away before."""
    memory = replace(perception.fresh(at(0)), presence=Presence(False, at(0)))
    said = ((moment, GONE if k % 2 else HERE) for k, moment in enumerate(moments))
    return obeyed(memory, *said).habits.nights


def test_a_told_stay_is_a_night_once_the_next_one_begins() -> None:
    assert stays(at(18.5), at(8, 3)) == ()
    assert stays(at(18.5), at(8, 3), at(19, 3)) == (SeenNight(date(2023, 1, 3), 1110.0, 480.0),)


def test_an_errand_is_no_night() -> None:
    found = stays(at(17), at(19), at(20), at(8, 3), at(12, 3), at(13, 3), at(18, 3))
    assert found == (SeenNight(date(2023, 1, 3), 1200.0, 480.0),)


def test_a_hub_that_restarts_does_not_end_a_stay() -> None:
    found = stays(at(18), at(2, 3), at(2.1, 3), at(8, 3), at(18, 3))
    assert found == (SeenNight(date(2023, 1, 3), 1080.0, 480.0),)


def test_a_car_that_stays_for_days_was_there_in_time_and_left_late() -> None:
    first, second = stays(at(18), at(8, 4), at(18, 4))
    assert (first.day, first.plug_in_min) == (date(2023, 1, 3), 1080.0)
    assert first.plug_out_min == 540.0 + 720.0
    assert (second.day, second.plug_out_min) == (date(2023, 1, 4), 480.0)
    assert second.plug_in_min == 1080.0 - 720.0


def test_a_car_that_was_there_when_first_asked_did_not_arrive_then() -> None:
    memory = obeyed(perception.fresh(at(0)), (at(23), HERE), (at(8, 3), GONE), (at(18, 3), HERE))
    assert memory.habits.nights == ()
    assert memory.habits.arrived_at == at(18, 3)


def test_clock_changes_move_no_habit() -> None:
    spring = datetime(2023, 3, 25, 18, tzinfo=UTC), datetime(2023, 3, 26, 8, tzinfo=UTC)
    (night,) = habits.nights_of(*spring, HOUSE)
    assert (night.plug_in_min, night.plug_out_min) == (1080.0, 540.0)


def evenings(*socs: float, charged_kwh: float = 4.0, hour: float = 18.0) -> Memory:
    """A car that tells its SOC every evening, and takes as much at the plug every night."""
    memory = metered(perception.fresh(at(0)), at(1), 100.0)
    for day, soc in enumerate(socs, 2):
        memory = obeyed(memory, (at(hour, day), SetSoc(soc, "hub")))
        memory = metered(memory, at(26, day), 100.0 + charged_kwh * (day - 1))
    return memory


def test_use_is_what_the_battery_lost_beside_what_flowed() -> None:
    found = evenings(0.6, 0.55, 0.58, 0.5).habits.nights
    # From 60 % by 4 kWh at 0.9 to 67.2 %, home with 55 %: 12.2 % of 50 kWh on the day after the first night.
    assert [night.day for night in found] == [date(2023, 1, 3), date(2023, 1, 4)]
    assert [night.use_kwh for night in found] == pytest.approx([6.1, 2.1])


def test_a_car_that_speaks_while_it_is_driven_has_used_the_sum() -> None:
    memory = metered(perception.fresh(at(0)), at(1), 100.0)
    words = [(18, 0.6), (30, 0.6), (33, 0.57), (37, 0.54), (42, 0.5), (54, 0.5)]
    for hour, soc in words:
        memory = obeyed(memory, (at(hour), SetSoc(soc, "hub")))
    assert memory.habits.nights == ()
    memory = obeyed(memory, (at(60), SetSoc(0.45, "hub")))
    assert [night.day for night in memory.habits.nights] == [date(2023, 1, 3)]
    assert [night.use_kwh for night in memory.habits.nights] == pytest.approx([5.0])


def test_two_days_together_say_nothing_of_one() -> None:
    memory = evenings(0.6)
    for day in (4, 5, 6):
        memory = obeyed(memory, (at(18, day), SetSoc(0.5, "hub")))
    assert [night.day for night in memory.habits.nights] == [date(2023, 1, 5)]


def test_a_word_by_day_says_nothing_of_a_whole_day() -> None:
    assert evenings(0.6, 0.55, 0.58, 0.5, hour=12.0).habits.nights == ()


def test_an_announced_trip_is_no_habit() -> None:
    memory = evenings(0.6, 0.55)
    memory = obeyed(memory, (at(20, 3), SetTrip(Trip(date(2023, 1, 4), minimum=0.8))))
    for day, soc in ((4, 0.2), (5, 0.3), (6, 0.3)):
        memory = obeyed(memory, (at(18, day), SetSoc(soc, "hub")))
    assert date(2023, 1, 4) not in [night.day for night in memory.habits.nights]
    assert date(2023, 1, 3) in [night.day for night in memory.habits.nights]


def test_charging_elsewhere_is_no_negative_use() -> None:
    found = evenings(0.6, 0.75, 0.7).habits.nights
    assert [night.use_kwh for night in found] == [0.0]


def test_a_plain_plug_that_nobody_talks_to_learns_nothing() -> None:
    memory = perception.fresh(at(0))
    for hour in range(24 * 6):
        memory = metered(memory, at(hour), 100.0 + 0.5 * hour)
    assert memory.habits == Habits()


def test_the_daemon_sees_what_its_driver_does() -> None:
    """The cycle in its simulated house: what it has seen after six nights is what was done."""
    start, driver = NOON, Driver()
    source = FunctionSource(lambda _, slot: 100.0 + slot.hour)
    house = House(HOUSE, Exact(), source, driver.stays(start), start, tells_presence=True)
    house.run(start + 6 * DAY)
    found = {night.day: night for night in house.cycle.memory.habits.nights}
    for evening in (MONDAY + DAY * k for k in range(1, 4)):
        stay, night = driver.stay(evening), found[evening + DAY]
        assert night.plug_in_min == pytest.approx(stay.arrival.hour * 60 + stay.arrival.minute, abs=1.0)
        assert night.plug_out_min == pytest.approx(stay.departure.hour * 60 + stay.departure.minute, abs=1.0)
        assert night.use_kwh == pytest.approx(stay.use_kwh, abs=0.3)


# -- told -----------------------------------------------------------------------------------------


def test_it_is_told_on_one_line() -> None:
    assert habits.words(HOUSE, seen(12)) == (
        "12 of 28 nights seen; until then the configured times and daily use count"
    )
    told = habits.words(HOUSE, seen(84))
    assert told.startswith("from 84 nights: home by 18:")
    assert "kWh a day" in told
    assert "\n" not in told
    assert habits.words(Household(), seen(84)) == "nothing is learned: nights.learn is false"
