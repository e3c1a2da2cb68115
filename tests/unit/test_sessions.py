"""The calendar, against the paper's figures and the days on which clocks change."""

from dataclasses import replace
from datetime import UTC, date, datetime, time, timedelta
from itertools import islice, pairwise
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd import sessions
from plugd.domain import DayRule, Household, Nights, Overrides, Presence, Trip

LONDON = ZoneInfo("Europe/London")
HOUSE = Household()
NOBODY_SAYS = Presence()
NOON = datetime(2023, 1, 2, 12, tzinfo=UTC)


def expect(
    now: datetime = NOON,
    house: Household = HOUSE,
    overrides: Overrides | None = None,
    presence: Presence = NOBODY_SAYS,
    n: int = 4,
) -> list[tuple[str, str]]:
    """Local start and end of the expected sessions."""
    found = sessions.expected(now, house, overrides or Overrides(), presence, n)
    return [tuple(f"{m.astimezone(LONDON):%a %H:%M}" for m in (s.start, s.end)) for s in found]  # type: ignore[misc]


def test_the_papers_quantiles() -> None:
    assert expect(n=2) == [("Mon 20:03", "Tue 06:57"), ("Tue 20:03", "Wed 06:57")]
    (session,) = sessions.expected(NOON, HOUSE, Overrides(), NOBODY_SAYS, 1)
    assert session.daily_use_kwh == pytest.approx(11.28, abs=0.005)
    assert (session.minimum, session.ceiling) == (0.5, 0.8)


def test_a_session_under_way_comes_first_with_its_own_start() -> None:
    night = datetime(2023, 1, 3, 2, 10, tzinfo=UTC)
    assert expect(night, n=1) == [("Mon 20:03", "Tue 06:57")]


def test_after_the_planned_end_the_next_night_is_planned_and_the_stay_goes_on() -> None:
    breakfast = datetime(2023, 1, 3, 7, 30, tzinfo=UTC)
    assert expect(breakfast, n=1) == [("Tue 20:03", "Wed 06:57")]
    stay = sessions.under_way(breakfast, HOUSE, Overrides(), NOBODY_SAYS)
    assert stay is not None
    assert stay.session.end == datetime(2023, 1, 3, 6, 57, tzinfo=UTC)
    assert stay.late_plug_out == datetime(2023, 1, 3, 11, 3, tzinfo=UTC)
    assert sessions.under_way(datetime(2023, 1, 3, 11, 3, tzinfo=UTC), HOUSE, Overrides(), NOBODY_SAYS) is None


def test_told_that_the_car_is_still_here_the_stay_lasts() -> None:
    here = Presence(True, datetime(2023, 1, 2, 18, 0, tzinfo=UTC))
    stay = sessions.under_way(datetime(2023, 1, 3, 15, 0, tzinfo=UTC), HOUSE, Overrides(), here)
    assert stay is not None
    assert stay.session.end == datetime(2023, 1, 3, 6, 57, tzinfo=UTC)


def test_an_early_plug_in_begins_the_session_early() -> None:
    here = Presence(True, datetime(2023, 1, 2, 16, 20, tzinfo=UTC))
    assert expect(datetime(2023, 1, 2, 16, 30, tzinfo=UTC), presence=here, n=1) == [("Mon 16:20", "Tue 06:57")]


def test_a_car_here_since_last_night_does_not_begin_the_coming_session_early() -> None:
    here = Presence(True, datetime(2023, 1, 1, 18, 0, tzinfo=UTC))
    assert expect(NOON, presence=here, n=1) == [("Mon 20:03", "Tue 06:57")]


def test_a_late_plug_in_leaves_the_session_as_it_was_expected() -> None:
    here = Presence(True, datetime(2023, 1, 2, 23, 0, tzinfo=UTC))
    assert expect(datetime(2023, 1, 2, 23, 5, tzinfo=UTC), presence=here, n=1) == [("Mon 20:03", "Tue 06:57")]


def test_ready_by_is_taken_as_it_is() -> None:
    house = replace(HOUSE, nights=replace(HOUSE.nights, ready_by=time(8, 30)))
    assert expect(house=house, n=1) == [("Mon 20:03", "Tue 08:30")]


def test_a_trip_beats_the_week_and_the_week_beats_the_rest() -> None:
    week = ((1, DayRule(ready_by=time(10, 0), minimum=0.6)), (2, DayRule(away=True)))
    house = replace(HOUSE, nights=replace(HOUSE.nights, week=week))
    assert expect(house=house, n=2) == [("Mon 20:03", "Tue 10:00"), ("Wed 20:03", "Thu 06:57")]
    trip = Overrides(minimum=0.4, trips=(Trip(date(2023, 1, 3), minimum=0.9),))
    tuesday, thursday = sessions.expected(NOON, house, trip, NOBODY_SAYS, 2)
    assert (tuesday.minimum, tuesday.ceiling, thursday.minimum) == (0.9, 0.9, 0.4)
    assert f"{tuesday.end:%H:%M}" == "10:00"


def test_the_use_over_a_night_away_is_the_quantile_of_the_sum() -> None:
    house = replace(HOUSE, nights=replace(HOUSE.nights, week=((2, DayRule(away=True)),)))
    tuesday, _ = sessions.expected(NOON, house, Overrides(), NOBODY_SAYS, 2)
    assert tuesday.daily_use_kwh == pytest.approx(2 * 5.8 + 2.0537 * 2.67 * 2**0.5, abs=0.01)


def test_every_night_away_is_no_session_and_no_endless_loop() -> None:
    away = replace(HOUSE, nights=replace(HOUSE.nights, week=tuple((d, DayRule(away=True)) for d in range(7))))
    assert expect(house=away) == []


@pytest.mark.parametrize(
    ("day", "clock", "utc"),
    [
        (date(2026, 3, 29), time(1, 30), "2026-03-29T01:00"),  # missing: the next that exists, 02:00 BST
        (date(2026, 10, 25), time(1, 30), "2026-10-25T00:30"),  # twice: the first
        (date(2026, 7, 1), time(6, 57), "2026-07-01T05:57"),
        (date(2026, 1, 1), time(6, 57), "2026-01-01T06:57"),
    ],
)
def test_local_times_on_the_days_clocks_change(day: date, clock: time, utc: str) -> None:
    assert sessions.to_utc(day, clock, LONDON) == datetime.fromisoformat(utc).replace(tzinfo=UTC)


@pytest.mark.parametrize(
    ("start", "hours"), [(datetime(2026, 3, 28, 12, tzinfo=UTC), 9.9), (datetime(2026, 10, 24, 12, tzinfo=UTC), 11.9)]
)
def test_the_night_of_a_change_is_an_hour_shorter_or_longer(start: datetime, hours: float) -> None:
    (session,) = sessions.expected(start, HOUSE, Overrides(), NOBODY_SAYS, 1)
    assert (session.end - session.start) / timedelta(hours=1) == pytest.approx(hours)


@given(
    hours=st.floats(0, 4 * 8766),
    plug_in=st.times(time(12), time(23, 30)),
    plug_out=st.times(time(3), time(11, 30)),
    sd_min=st.floats(0, 90),
    zone=st.sampled_from(["Europe/London", "Australia/Lord_Howe", "America/St_Johns", "Pacific/Auckland"]),
)
def test_sessions_are_in_order_and_cover_what_comes(
    hours: float, plug_in: time, plug_out: time, sd_min: float, zone: str
) -> None:
    now = datetime(2023, 1, 1, tzinfo=UTC) + timedelta(hours=hours)
    plug_in, plug_out = (t.replace(second=0, microsecond=0) for t in (plug_in, plug_out))
    house = replace(
        HOUSE,
        timezone=zone,
        nights=Nights(plug_in=plug_in, plug_out=plug_out, plug_in_sd_min=sd_min, plug_out_sd_min=sd_min),
    )
    found = sessions.expected(now, house, Overrides(), NOBODY_SAYS, 7)
    assert all(s.start < s.end for s in found)
    assert all(a.end <= b.start for a, b in pairwise(found))
    assert all(s.end > now for s in found)
    assert len(found) == 7
    windows = list(islice(sessions.windows(house, Overrides(), now), 3))
    assert [w.session.end for w in windows] == [s.end for s in found[:3]]


def test_driving_is_counted_once_for_each_homecoming() -> None:
    told = datetime(2023, 1, 2, 23, 0, tzinfo=UTC)
    later = told + timedelta(days=3)
    homecomings = sessions.drives(HOUSE, Overrides(), NOBODY_SAYS, told, later)
    assert [(f"{at:%d %H:%M}", days) for at, days in homecomings] == [
        ("03 20:03", 1), ("04 20:03", 1), ("05 20:03", 1),
    ]  # fmt: skip


@pytest.mark.parametrize(("told", "expected"), [("16:30", []), ("07:30", ["20:03"]), ("15:00", ["20:03"])])
def test_a_soc_told_in_the_morning_is_before_the_drive_and_one_told_on_arrival_after_it(
    told: str, expected: list[str]
) -> None:
    at = datetime.fromisoformat(f"2023-01-03T{told}").replace(tzinfo=UTC)
    found = sessions.drives(HOUSE, Overrides(), NOBODY_SAYS, at, datetime(2023, 1, 3, 21, 0, tzinfo=UTC))
    assert [f"{moment:%H:%M}" for moment, _ in found] == expected


def test_a_homecoming_that_is_told_counts_from_then() -> None:
    told = datetime(2023, 1, 3, 7, 0, tzinfo=UTC)
    here = Presence(True, datetime(2023, 1, 3, 17, 0, tzinfo=UTC))
    ((home_at, _),) = sessions.drives(HOUSE, Overrides(), here, told, datetime(2023, 1, 3, 18, 0, tzinfo=UTC))
    assert home_at == here.since
