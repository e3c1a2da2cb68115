"""What commands do to memory and what is answered."""

from dataclasses import replace
from datetime import date, datetime, time, timedelta
from pathlib import Path

import pytest

from plugd import commands
from plugd.adapters.store import SqliteStore
from plugd.domain import (
    Answer,
    ClearTrip,
    Command,
    DayRule,
    Memory,
    Mode,
    Overrides,
    Presence,
    Press,
    Replan,
    SetConnected,
    SetHorizon,
    SetMinimum,
    SetMode,
    SetReadyBy,
    SetSoc,
    SetTrip,
    SetWeek,
    Trip,
)
from plugd.perception import perceive
from plugd.sessions import expected
from tests.unit.deciding import EVENING, HOME, NIGHT, at, knows

MEMORY = knows(0.6)
HERE, AWAY, UNTOLD = Presence(True, EVENING), Presence(False, EVENING), Presence()

TRIP = Trip(date(2023, 1, 5), time(5, 30), 0.7)
WEEK = ((5, DayRule(time(10), 0.6)), (6, DayRule(away=True)))


def told(memory: Memory, *said: Command) -> Memory:
    return commands.apply(said, memory, HOME, NIGHT)[0]


def meaning(mode: Mode, presence: Presence = UNTOLD, press: Press | None = None) -> Memory:
    return replace(MEMORY, overrides=Overrides(mode=mode), presence=presence, press=press)


@pytest.mark.parametrize(
    ("command", "now_is", "said"),
    [
        (SetMode(Mode.NOW), {"overrides": Overrides(mode=Mode.NOW)}, "mode is now"),
        (SetMinimum(0.7), {"overrides": Overrides(minimum=0.7)}, "every morning has at least 70 %"),
        (SetReadyBy(time(7, 30)), {"overrides": Overrides(ready_by=time(7, 30))}, "ready by 07:30"),
        (SetReadyBy(None), {"overrides": Overrides()}, "ready by the configured time"),
        (SetHorizon(3), {"overrides": Overrides(horizon=3)}, "3 nights are planned together"),
        (SetConnected(True), {"presence": Presence(True, NIGHT)}, "the car is here"),
        (SetConnected(False), {"presence": Presence(False, NIGHT)}, "the car is not here"),
        (Replan(), {}, "planned anew"),
        (SetTrip(TRIP), {"overrides": Overrides(trips=(TRIP,))}, "2023-01-05: at least 70 % by 05:30"),
        (
            SetTrip(Trip(TRIP.day, away=True)),
            {"overrides": Overrides(trips=(Trip(TRIP.day, away=True),))},
            "2023-01-05: away",
        ),
        (ClearTrip(TRIP.day), {}, "2023-01-05: as any other day"),
        (ClearTrip(None), {}, "no trips are set"),
        (SetWeek(WEEK), {"overrides": Overrides(week=WEEK)}, "2 days of the week differ"),
        (SetWeek(()), {"overrides": Overrides(week=())}, "0 days of the week differ"),
        (SetWeek(None), {}, "the week is the configured one"),
    ],
)
def test_each_command_does_one_thing_and_twice_is_once(command: Command, now_is: dict[str, object], said: str) -> None:
    before = replace(MEMORY, overrides=Overrides(ready_by=time(6))) if isinstance(command, SetReadyBy) else MEMORY
    memory, (answer, again) = commands.apply((command, command), before, HOME, NIGHT)
    assert answer == again
    assert (answer.ok, answer.message) == (True, said)
    changed = {
        name: getattr(memory, name)
        for name in ("overrides", "presence", "press", "guarding", "soc", "plan", "orders")
        if getattr(memory, name) != getattr(before, name)
    }
    assert changed == now_is


def test_a_told_soc_counts_from_now() -> None:
    memory, (answer,) = commands.apply((SetSoc(0.43, "car"),), MEMORY, HOME, NIGHT)
    assert (memory.soc.mean, memory.soc.source, memory.soc.told_at) == (0.43, "car", NIGHT)
    assert (answer.command, answer.ok, answer.message) == ("soc", True, "the battery is at 43 %")


def test_a_jump_of_the_cars_is_answered_and_a_persons_word_is_believed_at_once() -> None:
    memory = replace(MEMORY, soc=replace(MEMORY.soc, told_at=NIGHT))
    after, (answer,) = commands.apply((SetSoc(0.0, "car"),), memory, HOME, NIGHT)
    assert (after.soc.mean, after.soc.doubted) == (0.6, 0.0)
    assert not answer.ok
    assert answer.message == "the car says 0 % where 60 % was expected; believed if it still does in a minute"
    assert told(memory, SetSoc(0.0, "hub")).soc.mean == 0.0


def test_commands_are_applied_in_order() -> None:
    memory, answers = commands.apply((SetSoc(0.3), SetMode(Mode.OFF), SetSoc(0.4)), MEMORY, HOME, NIGHT)
    assert memory.soc.mean == 0.4
    assert [answer.command for answer in answers] == ["soc", "mode", "soc"]


@pytest.mark.parametrize("minimum", [0.0, 0.1999, 0.8001, 1.0])
def test_a_minimum_outside_the_battery_is_refused_with_the_remedy(minimum: float) -> None:
    memory, (answer,) = commands.apply((SetMinimum(minimum),), MEMORY, HOME, NIGHT)
    assert memory == MEMORY
    assert not answer.ok
    assert "outside soc_min 20 % to soc_max 80 %; choose one within" in answer.message


@pytest.mark.parametrize("minimum", [0.2, 0.8])
def test_the_limits_themselves_are_minima(minimum: float) -> None:
    assert told(MEMORY, SetMinimum(minimum)).overrides.minimum == minimum


# -- how long a person's word lasts ---------------------------------------------------------------


def test_off_is_over_at_the_next_told_plug_in() -> None:
    off = meaning(Mode.OFF, HERE)
    gone = told(off, SetConnected(False))
    assert gone.overrides.mode is Mode.OFF
    assert told(gone, SetConnected(True)).overrides.mode is Mode.SMART


@pytest.mark.parametrize("presence", [HERE, Presence()])
def test_off_outlives_the_news_of_a_stay_under_way(presence: Presence) -> None:
    off = meaning(Mode.OFF, presence, Press(False, None))
    still = told(off, SetConnected(True))
    assert (still.overrides.mode, still.press) == (Mode.OFF, Press(False, None))


def test_a_press_off_is_over_at_the_next_told_plug_in() -> None:
    pressed = meaning(Mode.SMART, HERE, Press(False, None))
    gone = told(pressed, SetConnected(False))
    assert gone.press == Press(False, None)
    assert told(gone, SetConnected(True)).press is None


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("on", [True, False])
def test_a_persons_word_ends_what_the_button_asked_for(mode: Mode, on: bool) -> None:
    pressed = meaning(Mode.SMART, HERE, Press(on, None))
    memory = told(pressed, SetMode(mode))
    assert (memory.press, memory.overrides.mode) == (None, mode)


@pytest.mark.parametrize("mode", list(Mode))
def test_now_with_a_battery_at_its_ceiling_is_smart_and_says_why(mode: Mode) -> None:
    full = replace(meaning(mode, press=Press(False, None)), soc=knows(0.83).soc)
    memory, (answer,) = commands.apply((SetMode(Mode.NOW),), full, HOME, NIGHT)
    assert (memory.overrides.mode, memory.press) == (Mode.SMART, None)
    assert answer == Answer(
        "mode", True,
        "mode is smart: the battery is at 83 %, and now ends at soc_max 80 %; "
        "say how full it is if that is wrong, or set a trip for more",
    )  # fmt: skip


def test_now_and_a_press_on_are_over_when_the_car_is_unplugged() -> None:
    boosting = meaning(Mode.NOW, HERE, Press(True, NIGHT))
    memory = told(boosting, SetConnected(False))
    assert (memory.overrides.mode, memory.press) == (Mode.SMART, None)


def test_now_said_before_the_car_is_there_holds_when_it_is() -> None:
    assert told(meaning(Mode.NOW, AWAY), SetConnected(True)).overrides.mode is Mode.NOW


def test_hearing_the_same_of_the_car_again_changes_nothing() -> None:
    here = replace(meaning(Mode.NOW, HERE, Press(True, NIGHT)), guarding=True)
    away = replace(meaning(Mode.OFF, AWAY), guarding=True)
    assert told(here, SetConnected(True)) == here
    assert told(away, SetConnected(False)) == away


def test_what_the_guard_holds_ends_with_the_stay_or_a_persons_off() -> None:
    guarding = replace(meaning(Mode.SMART, HERE), guarding=True)
    assert not told(guarding, SetConnected(False)).guarding
    assert not told(guarding, SetMode(Mode.OFF)).guarding
    assert told(guarding, SetMode(Mode.NOW)).guarding
    assert not told(replace(guarding, presence=AWAY), SetConnected(True)).guarding


# -- trips and the week ---------------------------------------------------------------------------


def mornings(memory: Memory, count: int = 4) -> dict[int, tuple[float, str]]:
    """What the next mornings are to find, by their day of the month: the minimum, and by when (UTC)."""
    coming = expected(NIGHT, HOME, memory.overrides, memory.presence, count)
    return {s.end.day: (s.minimum, f"{s.end:%H:%M}") for s in coming}


USUAL = (0.5, "06:57")


def test_a_trip_replaces_its_own_morning_and_only_what_it_names() -> None:
    assert mornings(told(MEMORY, SetTrip(TRIP))) == {3: USUAL, 4: USUAL, 5: (0.7, "05:30"), 6: USUAL}
    assert mornings(told(MEMORY, SetTrip(replace(TRIP, ready_by=None))))[5] == (0.7, "06:57")
    assert mornings(told(MEMORY, SetTrip(replace(TRIP, minimum=None))))[5] == (0.5, "05:30")
    assert mornings(told(MEMORY, SetTrip(Trip(TRIP.day, away=True)))) == {3: USUAL, 4: USUAL, 6: USUAL, 7: USUAL}
    assert mornings(told(MEMORY, SetTrip(TRIP), ClearTrip(TRIP.day)))[5] == USUAL


def test_a_trip_beats_the_week_and_the_week_the_defaults() -> None:
    thursday = ((3, DayRule(time(8), 0.6)),)
    asked = told(MEMORY, SetMinimum(0.4), SetReadyBy(time(9)), SetWeek(thursday))
    assert mornings(asked) == {3: (0.4, "09:00"), 4: (0.4, "09:00"), 5: (0.6, "08:00"), 6: (0.4, "09:00")}
    assert mornings(told(asked, SetTrip(TRIP)))[5] == (0.7, "05:30")
    assert mornings(told(asked, SetTrip(replace(TRIP, ready_by=None))))[5] == (0.7, "08:00")
    at_home = told(MEMORY, SetWeek(((3, DayRule(away=True)),)), SetTrip(TRIP))
    assert mornings(at_home)[5] == (0.7, "05:30"), "away every Thursday, but not on this one"


def test_the_week_that_is_set_replaces_the_configured_one_until_it_is_taken_back() -> None:
    house = replace(HOME, nights=replace(HOME.nights, week=((3, DayRule(minimum=0.7)),)))

    def thursdays(memory: Memory) -> float:
        return next(s.minimum for s in expected(NIGHT, house, memory.overrides, memory.presence, 4) if s.end.day == 5)

    assert thursdays(MEMORY) == 0.7
    assert thursdays(told(MEMORY, SetWeek(()))) == 0.5
    assert thursdays(told(MEMORY, SetWeek(()), SetWeek(None))) == 0.7


def test_a_trip_may_ask_for_more_than_the_usual_limit() -> None:
    full = told(MEMORY, SetTrip(replace(TRIP, minimum=1.0)))
    session = next(s for s in expected(NIGHT, HOME, full.overrides, full.presence, 4) if s.end.day == 5)
    assert (session.minimum, session.ceiling) == (1.0, 1.0)


def test_of_two_trips_on_a_day_the_later_word_counts_and_they_are_kept_in_order() -> None:
    first, second = Trip(date(2023, 1, 8), minimum=0.6), Trip(date(2023, 1, 4), away=True)
    memory = told(MEMORY, SetTrip(TRIP), SetTrip(first), SetTrip(second), SetTrip(replace(TRIP, minimum=0.8)))
    assert memory.overrides.trips == (second, replace(TRIP, minimum=0.8), first)


def test_a_trip_outlives_unplugging_plugging_in_and_a_restart(tmp_path: Path) -> None:
    memory = told(MEMORY, SetTrip(TRIP), SetConnected(True), SetMode(Mode.NOW), SetConnected(False), SetConnected(True))
    assert memory.overrides.trips == (TRIP,)
    memory = told(memory, SetWeek(WEEK))
    with SqliteStore(tmp_path) as store:
        store.save(memory)
    with SqliteStore(tmp_path) as again:
        assert again.load() == memory


@pytest.mark.parametrize(("now", "there"), [(at(23, 59, day=5), True), (at(0, 0, day=6), False)])
def test_a_trip_is_forgotten_when_its_day_is_over(now: datetime, there: bool) -> None:
    later = Trip(date(2023, 1, 6), away=True)
    memory = told(MEMORY, SetTrip(TRIP), SetTrip(later))
    assert perceive(now, None, memory, HOME).overrides.trips == ((TRIP, later) if there else (later,))


@pytest.mark.parametrize(
    ("trip", "why"),
    [
        (
            Trip(date(2023, 1, 1), away=True),
            "2023-01-01: is not in the year to come; send a morning from 2023-01-02 on",
        ),
        (Trip(date(2024, 1, 4), away=True), "2024-01-04: is not in the year to come"),
        (Trip(date(2023, 1, 2), minimum=0.6), "2023-01-02: that morning is over; send a later one"),
        (replace(TRIP, minimum=0.1), "a minimum of 10 % is below soc_min 20 %; choose more"),
        (replace(TRIP, ready_by=time(20, 30)), "ready by 20:30 is not between one plug-in and the next"),
    ],
)
def test_a_trip_that_cannot_be_is_refused_with_the_reason(trip: Trip, why: str) -> None:
    memory, (answer,) = commands.apply((SetTrip(trip),), MEMORY, HOME, NIGHT)
    assert memory == MEMORY
    assert (answer.command, answer.ok) == ("trip", False)
    assert why in answer.message


def test_trips_have_an_end() -> None:
    trips = [SetTrip(Trip(TRIP.day + timedelta(days=k), away=True)) for k in range(commands.MAX_TRIPS + 1)]
    memory, answers = commands.apply(tuple(trips), MEMORY, HOME, NIGHT)
    assert [answer.ok for answer in answers] == [True] * commands.MAX_TRIPS + [False]
    assert "31 trips are set already; clear one first" in answers[-1].message
    assert told(memory, trips[0]) == memory, "the same again is no more"


@pytest.mark.parametrize(
    ("week", "why"),
    [
        (((0, DayRule(minimum=0.9)),), "outside soc_min 20 % to soc_max 80 %; choose within"),
        (((0, DayRule(minimum=0.1)),), "outside soc_min 20 % to soc_max 80 %; choose within"),
        (tuple((day, DayRule(away=True)) for day in range(7)), "away on every day; leave one out"),
        (((0, DayRule(ready_by=time(22))),), "ready by 22:00 is not between one plug-in and the next"),
    ],
)
def test_a_week_that_cannot_be_is_refused_with_the_reason(week: tuple[tuple[int, DayRule], ...], why: str) -> None:
    memory, (answer,) = commands.apply((SetWeek(week),), MEMORY, HOME, NIGHT)
    assert memory == MEMORY
    assert not answer.ok
    assert why in answer.message


def test_a_time_at_which_the_car_is_expected_home_is_no_time_to_be_ready() -> None:
    memory, (answer,) = commands.apply((SetReadyBy(time(21)),), MEMORY, HOME, NIGHT)
    assert (memory, answer.ok) == (MEMORY, False)
    assert "ready by 21:00 is not between one plug-in and the next, expected about 18:00" in answer.message
    assert told(MEMORY, SetReadyBy(time(17))).overrides.ready_by == time(17)
