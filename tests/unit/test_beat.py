"""Who has the last word on the plug: a person's off, the guard, the reserve, a person's on, the plan."""

from dataclasses import replace
from datetime import datetime, time, timedelta

import pytest

from plugd.beat import LEASE, WATCH, Action, Cause, decide, is_on
from plugd.domain import (
    Car,
    DayRule,
    Household,
    Memory,
    Mode,
    Nights,
    Orders,
    Overrides,
    Presence,
    Press,
    Relay,
    Setpoint,
)
from plugd.perception import fresh
from plugd.planner import taper
from plugd.units import hours
from tests.unit.deciding import CHARGER, EVENING, HOME, NIGHT, NOON, READY_BY, at, home, knows, minutes, switching

RATE_KW = 0.9 * 2.3 * 0.9
"""What the guard counts on, in the battery."""
ON = switching((EVENING, True))
OFF_TILL_THREE = switching((at(3, day=3), True), (at(5, day=3), False))
PLENTY, LOW, EMPTY = 0.7, 0.45, 0.15


def meaning(
    soc: float = PLENTY,
    orders: Orders | None = OFF_TILL_THREE,
    mode: Mode = Mode.SMART,
    press: Press | None = None,
    here: bool | None = None,
    guarding: bool = False,
) -> Memory:
    return replace(
        knows(soc),
        orders=orders,
        overrides=Overrides(mode=mode),
        press=press,
        presence=Presence(here, None if here is None else EVENING),
        guarding=guarding,
    )


def last_safe_start(soc: float, minimum: float = 0.5) -> datetime:
    return READY_BY - timedelta(hours=(minimum - soc) * 50.0 / RATE_KW, seconds=2400)


def ask(memory: Memory, now: datetime = NIGHT, household: Household = HOME) -> Action:
    return decide(now, memory, household)


GUARDED = last_safe_start(LOW) + minutes(1)
PRESSED_ON, PRESSED_OFF = Press(True, at(11, 3, day=3)), Press(False, at(20, 3, day=3))


@pytest.mark.parametrize(
    ("memory", "now", "cause", "on"),
    [
        (meaning(EMPTY, ON, Mode.OFF, guarding=True), GUARDED, Cause.PERSON_OFF, False),
        (meaning(EMPTY, ON, press=PRESSED_OFF, guarding=True), GUARDED, Cause.PERSON_OFF, False),
        (meaning(EMPTY, ON, Mode.NOW, press=PRESSED_OFF), GUARDED, Cause.PERSON_OFF, False),
        (meaning(LOW, mode=Mode.NOW), GUARDED, Cause.GUARD, True),
        (meaning(EMPTY), GUARDED, Cause.GUARD, True),
        (meaning(EMPTY, mode=Mode.NOW), at(20, 4), Cause.RESERVE, True),
        (meaning(EMPTY), at(20, 4), Cause.RESERVE, True),
        (meaning(PLENTY, mode=Mode.NOW), NIGHT, Cause.PERSON_ON, True),
        (meaning(PLENTY, press=PRESSED_ON), NIGHT, Cause.PERSON_ON, True),
        (meaning(PLENTY, mode=Mode.NOW, here=False), NIGHT, Cause.PERSON_ON, True),
        (meaning(PLENTY, ON, here=False), NIGHT, Cause.ABSENT, False),
        (meaning(PLENTY, ON), NIGHT, Cause.PLAN, True),
        (meaning(PLENTY, OFF_TILL_THREE), NIGHT, Cause.PLAN, False),
        (meaning(PLENTY, orders=None), NIGHT, Cause.PLAN, False),
    ],
)
def test_who_wins(memory: Memory, now: datetime, cause: Cause, on: bool) -> None:
    action = ask(memory, now)
    assert (action.cause, action.on) == (cause, on)


@pytest.mark.parametrize(
    ("memory", "held"),
    [
        (meaning(mode=Mode.OFF), True),
        (meaning(press=PRESSED_OFF), True),
        (meaning(), False),
        (meaning(here=False), False),
        (meaning(orders=None), False),
    ],
)
def test_only_a_persons_off_is_without_the_timer(memory: Memory, held: bool) -> None:
    assert ask(memory).wanted == Relay(False, held=held)


# -- the guard ------------------------------------------------------------------------------------


def test_the_guard_fires_at_the_last_safe_start() -> None:
    start = last_safe_start(LOW)
    memory = meaning(LOW, switching((at(6, day=3), True)))
    before, after = ask(memory, start - minutes(1)), ask(memory, start)
    assert (before.cause, before.on, before.memory.guarding, before.until) == (Cause.PLAN, False, False, start)
    assert (after.cause, after.on, after.memory.guarding) == (Cause.GUARD, True, True)
    assert (before.memory.guard_count, after.memory.guard_count) == (0, 1)
    assert ask(after.memory, start + minutes(1)).memory.guard_count == 1


def test_the_guard_uses_the_power_that_was_seen() -> None:
    slow = replace(meaning(LOW), observed_kw=1.15)
    lead = READY_BY - last_safe_start(LOW) - timedelta(seconds=2400)
    start = READY_BY - timedelta(seconds=2400) - 2 * lead
    assert ask(slow, NIGHT).verdict.last_safe_start == pytest.approx(start, abs=timedelta(seconds=1))


def test_the_guard_starts_earlier_for_a_car_that_takes_less_as_it_fills() -> None:
    tapers = replace(HOME, car=replace(HOME.car, taper_from=0.4, taper_share=0.2))
    start = ask(meaning(LOW), household=tapers).verdict.last_safe_start
    assert start
    lead = READY_BY - start - timedelta(seconds=tapers.guard_margin_s)
    assert taper.reached_kwh(tapers.car, LOW * 50, 0.9 * 2.3, hours(lead)) == pytest.approx(25.0, abs=1e-3)
    assert start < last_safe_start(LOW)


def test_the_guard_counts_on_the_cautious_soc() -> None:
    unsure = replace(meaning(0.6), soc=replace(knows(0.6).soc, sd=0.15 / 2.05))
    assert ask(unsure).verdict.last_safe_start == pytest.approx(last_safe_start(LOW), abs=timedelta(seconds=1))


def test_the_guard_holds_until_the_need_is_met_even_where_there_is_time_again() -> None:
    guarding = meaning(LOW, guarding=True)
    assert ask(guarding, NIGHT).cause is Cause.GUARD
    met = ask(replace(guarding, soc=knows(0.5).soc), NIGHT)
    assert (met.cause, met.on, met.memory.guarding) == (Cause.PLAN, False, False)


@pytest.mark.parametrize("here", [None, True])
def test_after_the_session_end_the_guard_goes_on_late(here: bool | None) -> None:
    late = ask(meaning(LOW, here=here), READY_BY + minutes(30))
    assert (late.cause, late.on, late.verdict.late) == (Cause.GUARD, True, True)
    assert late.session is not None
    assert late.session.end == READY_BY


def test_between_stays_nobody_guards() -> None:
    over = at(11, 4, day=3)
    assert ask(meaning(LOW, guarding=True), over - minutes(2)).cause is Cause.GUARD
    action = ask(meaning(LOW, guarding=True), over)
    assert (action.cause, action.on, action.memory.guarding) == (Cause.PLAN, False, False)


def test_a_car_told_to_be_here_is_guarded_past_the_expected_departure() -> None:
    assert ask(meaning(LOW, here=True), at(13, day=3)).cause is Cause.GUARD


def test_a_car_that_may_have_come_home_early_with_far_to_go_is_guarded_before_its_time() -> None:
    """At 30 % before today's driving it lacks 21.3 kWh, 11.4 h at the guard's rate: from 18:52."""
    noon = knows(0.3, NOON)
    before_driving = replace(noon, soc=replace(noon.soc, driven_to=NOON), presence=Presence())
    start = at(18, 52)
    assert ask(before_driving, start - minutes(2)).cause is Cause.PLAN
    assert ask(before_driving, start + minutes(2)).cause is Cause.GUARD
    away = replace(before_driving, presence=Presence(False, NOON))
    assert ask(away, start + minutes(2)).cause is Cause.ABSENT


def test_a_car_that_stays_is_guarded_for_the_next_morning_too() -> None:
    far = replace(HOME, car=Car(daily_use_kwh=20.0))
    here = replace(knows(0.5), presence=Presence(True, EVENING))
    action = ask(here, at(17, day=3), far)
    assert action.cause is Cause.GUARD
    assert action.session
    assert action.session.end == at(6, 57, day=4)


def test_told_away_the_plan_is_not_obeyed_but_the_guard_is() -> None:
    away = meaning(LOW, ON, here=False)
    assert ask(away, NIGHT).cause is Cause.ABSENT
    assert ask(away, GUARDED).cause is Cause.GUARD


def test_told_away_nothing_is_late_after_the_session_end() -> None:
    gone = ask(meaning(LOW, here=False, guarding=True), READY_BY)
    assert (gone.cause, gone.on, gone.memory.guarding) == (Cause.ABSENT, False, False)


def test_a_persons_off_ends_what_the_guard_holds() -> None:
    assert not ask(meaning(LOW, mode=Mode.OFF, guarding=True), GUARDED).memory.guarding


def test_a_later_ready_by_and_a_higher_minimum_move_the_guard() -> None:
    late = ask(meaning(LOW), household=home(ready_by=time(8)))
    more = ask(meaning(LOW), household=home(minimum=0.6))
    usual = last_safe_start(LOW)
    assert late.verdict.last_safe_start == usual + minutes(63)
    assert more.verdict.last_safe_start == pytest.approx(last_safe_start(LOW, 0.6), abs=timedelta(seconds=1))


# -- the reserve ----------------------------------------------------------------------------------


def test_an_unknown_battery_charges_at_the_first_start() -> None:
    action = ask(fresh(NIGHT))
    assert action.on
    assert action.cause in (Cause.RESERVE, Cause.GUARD)


def test_the_reserve_is_left_at_soc_min() -> None:
    high = home(minimum=0.2)
    assert ask(meaning(0.199), at(20, 4), high).cause is Cause.RESERVE
    assert ask(meaning(0.2), at(20, 4), high).cause is Cause.PLAN


def test_told_away_no_reserve_is_filled() -> None:
    assert ask(meaning(EMPTY, here=False), at(20, 4)).cause is Cause.ABSENT


def test_told_here_the_reserve_is_filled_though_no_night_at_home_is_expected() -> None:
    never = replace(HOME, nights=Nights(week=tuple((day, DayRule(away=True)) for day in range(7))))
    assert ask(meaning(EMPTY, here=True), NOON, never).cause is Cause.RESERVE
    assert ask(meaning(EMPTY), NOON, never).cause is Cause.PLAN


# -- when to look again ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("memory", "now", "until"),
    [
        (meaning(), NIGHT, at(3, day=3)),
        (meaning(), at(4, day=3), at(5, day=3)),
        (meaning(), at(14), at(15, 57)),  # from then on the coming night is watched, too
        (meaning(), at(16), at(20, 3)),
        (meaning(orders=None), at(5, day=3), at(15, 57, day=3)),
        (meaning(press=PRESSED_OFF), NIGHT, PRESSED_OFF.until),
        (meaning(mode=Mode.OFF), NIGHT, None),
        (meaning(mode=Mode.NOW), NIGHT, NIGHT + WATCH),
        (meaning(here=False), NIGHT, at(3, day=3)),
    ],
)
def test_when_the_word_may_change(memory: Memory, now: datetime, until: datetime | None) -> None:
    assert ask(memory, now).until == until


def test_orders_run_out_with_the_session() -> None:
    assert ask(meaning(orders=ON), READY_BY - minutes(1)).on
    assert not ask(meaning(orders=ON), READY_BY).on


# -- a charger ------------------------------------------------------------------------------------


def test_a_charger_is_given_powers() -> None:
    planned = Setpoint(3.0, at(23, 30))
    assert ask(meaning(orders=planned), household=CHARGER).wanted == planned
    assert ask(meaning(orders=planned), at(23, 30), CHARGER).wanted == Setpoint(0.0, at(23, 30) + LEASE)
    assert ask(meaning(mode=Mode.NOW), household=CHARGER).wanted == Setpoint(7.4, NIGHT + LEASE)
    assert ask(meaning(mode=Mode.OFF), household=CHARGER).wanted == Setpoint(0.0, NIGHT + LEASE)
    assert LEASE > WATCH, "it would run out before it is looked at again"


def test_power_may_flow() -> None:
    assert [is_on(w) for w in (Relay(True), Relay(False), Setpoint(1.4, NIGHT), Setpoint(0.0, NIGHT))] == [
        True, False, True, False,
    ]  # fmt: skip


# -- a plug's own timer ---------------------------------------------------------------------------

FIXED = replace(HOME, capability=replace(HOME.capability, fixed_timer_s=3600.0))
START = last_safe_start(LOW)
HOUR = minutes(60)
NEVER = switching()


def off_by(action: Action) -> datetime | None:
    assert isinstance(action.wanted, Relay)
    return None if action.on else action.wanted.on_by


def test_an_off_says_by_when_its_timer_has_to_be_over() -> None:
    assert off_by(ask(meaning(LOW, NEVER), START - minutes(5))) == START
    assert off_by(ask(meaning(PLENTY, NEVER), NIGHT)) is None, "nothing is needed"
    without = replace(HOME, capability=replace(HOME.capability, dead_man=False))
    assert off_by(ask(meaning(LOW, NEVER), START - minutes(5), without)) is None


def test_a_persons_off_has_no_timer() -> None:
    assert ask(meaning(LOW, NEVER, Mode.OFF), START - minutes(5), FIXED).wanted == Relay(False, held=True)


def test_with_a_fixed_timer_no_off_is_begun_that_it_would_end_too_late() -> None:
    on = replace(meaning(LOW, NEVER), relay_on=True)
    assert off_by(ask(on, START - HOUR, FIXED)) == START
    late = ask(on, START - HOUR + minutes(1), FIXED)
    assert (late.cause, late.on, late.memory.guarding, late.memory.guard_count) == (Cause.TIMER, True, False, 0)


def test_with_a_fixed_timer_an_off_that_was_begun_in_time_lasts_to_the_last_safe_start() -> None:
    off = ask(replace(meaning(LOW, NEVER), relay_on=False), START - HOUR, FIXED)
    assert off.memory.on_by == START
    for left in (50, 5, 1):
        action = ask(off.memory, START - minutes(left), FIXED)
        assert (action.on, off_by(action)) == (False, START)
    assert ask(off.memory, START, FIXED).cause is Cause.GUARD


def test_with_a_fixed_timer_a_last_safe_start_that_comes_nearer_is_kept() -> None:
    """Half an hour nearer than the timer that runs was meant for: nothing but switching on now is in time."""
    off = ask(replace(meaning(LOW, NEVER), relay_on=False), START - HOUR, FIXED)
    nearer = replace(off.memory, soc=knows(LOW - 0.02).soc)
    assert ask(nearer, START - minutes(50), FIXED).cause is Cause.TIMER
    farther = ask(replace(off.memory, soc=knows(LOW + 0.003).soc), START - minutes(50), FIXED)
    assert (farther.on, off_by(farther)) == (False, START), "the timer that runs is not begun anew"
