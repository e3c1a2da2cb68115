"""What a plain plug can tell: too much current, none at all, a car that sleeps or has stopped."""

from dataclasses import replace
from datetime import datetime, timedelta

import pytest

from plugd import flow
from plugd.beat import Cause, decide
from plugd.commands import apply, plugged_in
from plugd.domain import (
    Household,
    Memory,
    Mode,
    Overrides,
    Presence,
    Press,
    Reading,
    Relay,
    SetMode,
    Status,
)
from plugd.errors import PlugTimeout
from plugd.perception import fresh, perceive
from tests.unit.deciding import CHARGER, EVENING, HOME, NIGHT, Room, at, knows, minutes, switching

SOCKET = replace(HOME, max_current_a=10.5)
ON, OFF, HELD = Relay(True), Relay(False), Relay(False, held=True)
CHARGING_HOUR = at(2, day=3)
"""The plan's: the night's cleanest hours begin."""


def seconds(count: float) -> timedelta:
    return timedelta(seconds=count)


def told(
    now: datetime, power_kw: float | None = 2.3, current_a: float | None = None, on: bool = True, metered: bool = True
) -> Reading:
    return Reading(now, on, power_kw, None, now if metered else None, current_a=current_a)


def watch(readings: list[Reading], household: Household = SOCKET, memory: Memory | None = None) -> Memory:
    """Memory after these readings, each seen when it was told."""
    memory = memory or knows(0.4, NIGHT)
    for reading in readings:
        memory = perceive(reading.at, reading, memory, household)
    return memory


def every(step_s: float, count: int, power_kw: float | None = 2.3, current_a: float | None = None) -> list[Reading]:
    return [told(NIGHT + seconds(step_s * k), power_kw, current_a) for k in range(count)]


# -- too much current -----------------------------------------------------------------------------


def test_a_minute_of_too_much_is_cut_and_no_less() -> None:
    assert watch(every(10, 6, current_a=11.0)).flow.cut is None
    cut = watch(every(10, 7, current_a=11.0)).flow.cut
    assert cut is not None
    assert (cut.at, cut.current_a, cut.limit_a) == (NIGHT + seconds(60), 11.0, 10.5)


def test_the_limit_itself_may_flow_all_night() -> None:
    assert watch(every(10, 100, current_a=10.5)).flow.cut is None


def test_a_moment_below_the_limit_begins_the_minute_anew() -> None:
    readings = [told(NIGHT + seconds(10 * k), current_a=10.0 if k == 5 else 11.0) for k in range(12)]
    assert watch(readings).flow.cut is None
    assert watch([*readings, told(NIGHT + seconds(120), current_a=11.0)]).flow.cut is not None


@pytest.mark.parametrize(("power_kw", "cut"), [(2.41, False), (2.42, True)])
def test_without_a_current_it_is_reckoned_from_the_power(power_kw: float, cut: bool) -> None:
    """10.5 A at 230 V are 2.415 kW."""
    assert (watch(every(10, 7, power_kw)).flow.cut is not None) is cut


def test_a_current_that_is_told_counts_and_not_the_power() -> None:
    """At 250 V 10 A are 2.5 kW, which would be 10.9 A at 230 V."""
    assert watch(every(10, 20, 2.5, current_a=10.0)).flow.cut is None
    assert watch(every(10, 20, 2.5), replace(SOCKET, mains_voltage_v=250.0)).flow.cut is None


def test_one_word_of_the_meter_is_not_enough() -> None:
    first = told(NIGHT, current_a=30.0)
    seen_again = [replace(first, at=NIGHT + seconds(10 * k)) for k in range(12)]
    assert watch(seen_again).flow.cut is None
    assert watch([*seen_again, told(NIGHT + seconds(120), current_a=30.0)]).flow.cut is not None


def test_what_is_not_known_is_no_current() -> None:
    assert watch(every(10, 20, None)).flow == Memory(knows(0.4).soc).flow
    assert watch(every(10, 20, 9.0), HOME).flow.cut is None, "nobody has said what the socket bears"


def test_a_clock_set_back_does_not_put_the_cut_off() -> None:
    memory = watch([told(at(23, day=9), current_a=12.0)])
    assert watch(every(10, 7, current_a=12.0), memory=memory).flow.cut is not None


def test_a_charger_is_told_what_it_may_take_and_not_watched() -> None:
    assert watch(every(10, 20, 7.4), replace(CHARGER, max_current_a=10.5)).flow.cut is None


def cut_memory() -> Memory:
    return watch(every(10, 7, current_a=12.6))


@pytest.mark.parametrize(
    "wishing",
    [
        replace(cut_memory(), overrides=Overrides(mode=Mode.NOW)),
        replace(cut_memory(), press=Press(True, None)),
        replace(cut_memory(), guarding=True),
        replace(cut_memory(), soc=knows(0.05, NIGHT).soc),
        replace(cut_memory(), orders=switching((EVENING, True))),
    ],
)
def test_a_cut_beats_everybody(wishing: Memory) -> None:
    action = decide(at(6, day=3), wishing, SOCKET)
    assert (action.cause, action.wanted, action.memory.guarding) == (Cause.CUT, HELD, False)


@pytest.mark.parametrize("mode", [Mode.SMART, Mode.NOW])
def test_no_mode_but_off_ends_a_cut(mode: Mode) -> None:
    memory, answers = apply((SetMode(mode),), cut_memory(), SOCKET, NIGHT)
    assert memory == cut_memory()
    assert not answers[0].ok
    assert answers[0].message == (
        "the plug was cut: 12.6 A flowed at 23:01, more than plug.max_current_a = 10.5; "
        "look at plug, socket and cable, then set the mode to off, and to smart again"
    )


def test_off_and_smart_end_a_cut() -> None:
    memory, answers = apply((SetMode(Mode.OFF), SetMode(Mode.SMART)), cut_memory(), SOCKET, NIGHT)
    assert [answer.ok for answer in answers] == [True, True]
    assert memory.flow.cut is None
    assert decide(NIGHT, memory, SOCKET).cause is not Cause.CUT


def test_plugging_in_does_not_end_a_cut() -> None:
    assert plugged_in(cut_memory(), NIGHT).flow.cut is not None


def test_a_cut_through_the_whole_cycle() -> None:
    """From the meter to the held off, told everywhere, past a restart, a boost and a press, until a person ends it."""
    house = Room(CHARGING_HOUR, knows(0.3, CHARGING_HOUR), SOCKET)
    house.step()
    assert house.plug.told == [ON]
    house.plug.current_a, house.plug.power_kw = 12.6, 2.9
    over_from = house.clock.at
    house.run(over_from + minutes(2))
    assert house.plug.told == [ON, HELD]
    assert over_from + seconds(60) <= house.plug.tries[-1] <= over_from + seconds(75)
    assert "12.6 A" in house.faults()["overcurrent"]
    assert house.hub.decision
    assert house.hub.decision.status is Status.FAULT
    assert house.hub.decision.reason.startswith("Switched off for safety: 12.6 A flowed at 02:01")
    saved = house.disk.load()
    assert saved
    house.begin(saved)
    house.hub.said.append(SetMode(Mode.NOW))
    house.run(at(2, 20, day=3))
    assert [answer.ok for answer in house.hub.answers] == [False]
    house.plug.press()
    house.run(at(6, 50, day=3))
    assert not house.plug.on
    assert set(house.plug.told[1:]) == {HELD}
    house.plug.current_a, house.plug.power_kw = 10.0, 2.3
    house.hub.said += [SetMode(Mode.OFF), SetMode(Mode.SMART)]
    house.run(at(6, 52, day=3))
    assert house.plug.told[-1] == ON
    assert house.faults() == {}


def test_a_cut_that_the_plug_does_not_obey_is_saved_and_tried_again() -> None:
    house = Room(CHARGING_HOUR, knows(0.3, CHARGING_HOUR), SOCKET)
    house.step()
    house.plug.current_a = 12.6
    house.plug.refuses = PlugTimeout("no answer")
    house.run(at(2, 5, day=3))
    saved = house.disk.load()
    assert saved
    assert saved.flow.cut
    assert {"overcurrent", "plug_refuses"} <= set(house.faults())
    house.plug.refuses = None
    house.run(at(2, 7, day=3))
    assert house.plug.told == [ON, HELD]


# -- no current -----------------------------------------------------------------------------------


def idle(
    here: bool | None = None, soc: float = 0.4, household: Household = SOCKET, before_kw: float = 0.0
) -> tuple[Memory, datetime]:
    """The relay on since NIGHT; `before_kw` flowed at first, then nothing for two minutes."""
    memory = replace(knows(soc, NIGHT), presence=Presence(here, None if here is None else EVENING))
    readings = [told(NIGHT + seconds(30 * k), before_kw if k < 4 else 0.0) for k in range(10)]
    memory = watch(readings, household, memory)
    return replace(memory, orders=switching((EVENING, True))), readings[-1].at


@pytest.mark.parametrize(("here", "known"), [(None, True), (True, True), (False, False)])
def test_nothing_flows_for_two_minutes(here: bool | None, known: bool) -> None:
    memory, now = idle(here)
    assert flow.is_idle(now, memory, SOCKET) is known
    assert not flow.is_idle(NIGHT + seconds(119), memory, SOCKET)


def test_a_car_told_to_be_here_that_takes_nothing_is_a_fault() -> None:
    memory, now = idle(here=True)
    assert [(f.code, f.text) for f in flow.faults(now, memory, SOCKET)] == [
        (
            "no_current",
            "the car is plugged in and takes nothing since 23:00 though the relay is on",
        )
    ]


def test_where_nobody_knows_of_a_car_it_is_no_fault_but_is_said() -> None:
    memory, now = idle()
    assert flow.faults(now, memory, SOCKET) == ()
    assert flow.idle_text(memory, SOCKET) == (
        "no car, or the car does not charge: nothing has flowed since 23:00 though the relay is on"
    )


def test_a_car_that_stopped_in_the_middle_is_at_a_limit_of_its_own_or_gone() -> None:
    memory, _ = idle(before_kw=2.3)
    assert flow.idle_text(memory, SOCKET) == (
        "the car has taken nothing since 23:02: it is at a limit of its own, or unplugged"
    )


def test_a_full_car_takes_nothing_and_that_is_right() -> None:
    memory, now = idle(here=True, soc=0.8)
    assert flow.faults(now, memory, SOCKET) == ()
    assert not flow.sleeps(NIGHT + minutes(20), None, memory, SOCKET)


def test_a_car_whose_power_fell_away_is_full_and_not_idle() -> None:
    powers = [2.3, 2.3, 1.8, 1.2, 0.6, *[0.0] * 10]
    readings = [told(NIGHT + seconds(60 * k), power_kw) for k, power_kw in enumerate(powers)]
    memory = watch(readings)
    assert memory.soc.source == "full"
    assert not flow.is_idle(readings[-1].at, memory, SOCKET)


def test_what_the_power_is_nobody_says() -> None:
    memory = watch(every(30, 20, None))
    assert not flow.is_idle(NIGHT + minutes(10), memory, SOCKET)


# -- a car that sleeps ----------------------------------------------------------------------------


@pytest.mark.parametrize("here", [None, True])
def test_a_car_that_never_took_anything_is_woken_once_whoever_switched_it_on(here: bool | None) -> None:
    memory, soon = idle(here)
    assert decide(soon, memory, SOCKET).on, "its least time on is not over"
    now = NIGHT + minutes(15)
    boosting, empty = replace(memory, overrides=Overrides(mode=Mode.NOW)), replace(memory, soc=knows(0.05, NIGHT).soc)
    for asleep in (memory, boosting, empty):
        action = decide(now, asleep, SOCKET)
        assert (action.cause, action.wanted, action.until) == (Cause.WAKE, OFF, now + minutes(10))
        assert action.memory.flow.wakes == 1
        again = decide(now + minutes(9), action.memory, SOCKET)
        assert (again.cause, again.memory.flow.wakes) == (Cause.WAKE, 1)
        assert decide(now + minutes(10), action.memory, SOCKET).on


@pytest.mark.parametrize("why", ["gone", "full", "stopped", "tried", "off by a person"])
def test_a_car_is_not_woken(why: str) -> None:
    memory, _ = {
        "gone": lambda: idle(here=False),
        "full": lambda: idle(soc=0.8),
        "stopped": lambda: idle(before_kw=2.3),
    }.get(why, idle)()
    now = NIGHT + minutes(20)
    if why == "tried":
        memory = replace(memory, flow=replace(memory.flow, woken_for=at(7, day=3).date()))
    if why == "off by a person":
        memory = replace(memory, overrides=Overrides(mode=Mode.OFF))
    assert decide(now, memory, SOCKET).cause is not Cause.WAKE


def test_a_car_that_stopped_by_itself_is_not_woken_at_the_next_switch_on() -> None:
    memory, now = idle(before_kw=2.3)
    off = watch([told(now, 0.0, on=False)], memory=memory)
    later = [told(now + minutes(60 + k), 0.0) for k in range(20)]
    memory = watch(later, memory=off)
    assert flow.is_idle(later[-1].at, memory, SOCKET)
    assert decide(later[-1].at, memory, SOCKET).cause is not Cause.WAKE


def test_a_car_plugged_in_anew_may_be_woken_again() -> None:
    memory, _ = idle(here=True, before_kw=2.3)
    anew = plugged_in(replace(memory, flow=replace(memory.flow, woken_for=at(7, day=3).date())), NIGHT)
    assert (anew.flow.woken_for, anew.flow.stopped_at) == (None, None)
    assert not flow.sleeps(NIGHT, None, anew, SOCKET), "it gets the time that any car gets"


def test_a_plugd_that_was_started_anew_knows_since_when_nothing_flows() -> None:
    """Nothing has flowed since the relay went on, whoever was there to see it; then it has only stopped since."""
    memory = replace(
        knows(0.42, NIGHT), relay_on=True, relay_since=NIGHT - minutes(9), presence=Presence(True, EVENING)
    )
    assert perceive(NIGHT, told(NIGHT, 0.0), memory, SOCKET).flow.idle_since == NIGHT - minutes(9)
    flowed = replace(memory, flow=replace(memory.flow, flowed=True))
    assert perceive(NIGHT, told(NIGHT, 0.0), flowed, SOCKET).flow.idle_since == NIGHT
    # Nor before the car came, or the relay was seen to be on.
    came = replace(memory, presence=Presence(True, NIGHT - minutes(2)))
    assert perceive(NIGHT, told(NIGHT, 0.0), came, SOCKET).flow.idle_since == NIGHT - minutes(2)
    assert perceive(NIGHT, told(NIGHT, 0.0), replace(memory, relay_on=False), SOCKET).flow.idle_since == NIGHT


@pytest.mark.parametrize(("hours", "pressed"), [(2, True), (20, False)])
def test_that_a_car_stopped_last_night_makes_no_press_of_a_relay_that_tells_the_truth_tonight(
    hours: int, pressed: bool
) -> None:
    """It said on and gave nothing, and says off at last. In the night in which the car stopped it may be a person."""
    memory, now = idle()
    memory = replace(memory, flow=replace(memory.flow, stopped_at=now - minutes(60 * hours)))
    off = replace(told(now + seconds(10), 0.0, on=False), changed_by_other=False)
    assert (perceive(off.at, off, memory, SOCKET).press is not None) is pressed


def test_a_car_is_given_time_to_begin_again_after_a_power_cut() -> None:
    charging = replace(
        knows(0.42, NIGHT), relay_on=True, relay_since=NIGHT - minutes(90), presence=Presence(True, EVENING)
    )
    back = replace(told(NIGHT, 0.0), came_back=True)
    memory = watch([told(NIGHT - minutes(1)), back], memory=charging)
    assert memory.flow.idle_since == NIGHT
    assert flow.faults(NIGHT, memory, SOCKET) == ()
    assert decide(NIGHT, memory, SOCKET).cause is not Cause.WAKE
    soon = NIGHT + seconds(30)
    off = perceive(soon, replace(told(soon, 0.0, on=False), changed_by_other=False), memory, SOCKET)
    assert off.press is not None, "somebody's off counts"


def test_a_press_ends_the_waking() -> None:
    memory, now = idle()[0], NIGHT + minutes(15)
    woken = decide(now, memory, SOCKET).memory
    assert flow.waking(now, woken.flow)
    pressed = perceive(now, replace(told(now), changed_by_other=True), woken, SOCKET)
    assert decide(now, pressed, SOCKET).cause is Cause.PERSON_ON


def test_waking_through_the_whole_cycle() -> None:
    """One off of ten minutes, on again, not on the plan's budget; then charging, or the plain word that it does not."""
    house = Room(CHARGING_HOUR, knows(0.42, CHARGING_HOUR), SOCKET)
    house.cycle.memory = replace(house.cycle.memory, presence=Presence(True, EVENING))
    house.plug.power_kw = 0.0
    house.step()
    house.step(CHARGING_HOUR + seconds(10))  # as a real clock does
    house.run(at(3, day=3))
    assert house.plug.told == [ON, OFF, ON]
    on, off, again = house.plug.tries
    assert (again - off, off - on) == (minutes(10), minutes(15))
    memory = house.cycle.memory
    assert (memory.flow.wakes, memory.switch_ons) == (1, (on,))
    assert "switching off and on has not woken it" in house.faults()["no_current"]
    assert house.hub.decision
    assert house.hub.decision.status is Status.FAULT
    assert house.hub.decision.reason.startswith("The car is plugged in and takes nothing since 02:")
    house.plug.power_kw = 2.3
    house.run(at(3, 2, day=3))
    assert house.faults() == {}


def test_the_first_memory_has_seen_nothing_flow() -> None:
    assert fresh(NIGHT).flow.cut is None
    assert flow.next_look(NIGHT, fresh(NIGHT).flow, SOCKET) is None
