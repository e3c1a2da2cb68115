"""Two controllers at one plug: it is noticed, named, and it ends; a person's press stays a person's."""

from dataclasses import replace
from datetime import timedelta

import pytest

from plugd import contest
from plugd.beat import Cause, decide
from plugd.domain import Memory, Press, Reading, Relay
from plugd.perception import perceive
from tests.unit.deciding import EXPECTED, HOME, NIGHT, READY_BY, Room, knows, minutes


def toggled(memory: Memory, *at_minutes: float, over: str = "") -> Memory:
    """After somebody else has moved the relay at these times, on and off by turns."""
    on = bool(memory.relay_on)
    for minute in at_minutes:
        on, now = not on, NIGHT + minutes(minute)
        memory = perceive(now, Reading(now, on, 2.0 if on else 0.0, 5.0, now, on, changed_over=over), memory, HOME)
    return memory


@pytest.mark.parametrize("times", [(0,), (0, 1), (0, 9, 18, 27)])
def test_a_press_and_a_second_thought_are_a_persons(times: tuple[float, ...]) -> None:
    memory = toggled(knows(0.5), *times)
    now = NIGHT + minutes(times[-1])
    assert memory.press is not None
    assert not contest.fought(now, memory)
    assert contest.faults(now, memory, HOME) == ()


def test_a_third_change_in_ten_minutes_is_another_controllers_and_named() -> None:
    now = NIGHT + minutes(2)
    memory = toggled(knows(0.6), 0, 1, 2, over="cmnd/ev-plug/POWER")
    assert memory.press is None
    (fault,) = contest.faults(now, memory, HOME)
    assert fault.code == "fought_over"
    assert "over cmnd/ev-plug/POWER, last at 23:02" in fault.text
    action = decide(now, memory, HOME)
    assert (action.cause, action.on) == (Cause.CONTESTED, True), "left as it is"
    assert action.until == now + contest.QUIET


def test_it_yields_for_half_an_hour_and_then_the_plan_goes_on() -> None:
    memory = toggled(knows(0.6), 0, 1, 2)
    end = NIGHT + minutes(32)
    assert decide(end - timedelta(seconds=1), memory, HOME).cause is Cause.CONTESTED
    assert decide(end, memory, HOME).cause is Cause.PLAN
    assert contest.faults(end, memory, HOME) == ()


def test_only_the_guard_acts_meanwhile_and_only_once_it_is_quiet() -> None:
    memory = toggled(knows(0.1), 0, 1, 2, 3)
    assert not memory.relay_on
    last = NIGHT + minutes(3)
    assert decide(last, memory, HOME).cause is Cause.CONTESTED
    acts = decide(last + contest.QUIET, memory, HOME)
    assert (acts.cause, acts.wanted) == (Cause.GUARD, Relay(True))


def test_a_clock_set_back_does_not_lengthen_it() -> None:
    memory = toggled(knows(0.6), 0, 1, 2)
    assert not contest.fought(NIGHT - timedelta(days=3650), memory)


def test_a_fight_ends_within_six_closings_and_the_morning_is_kept() -> None:
    house = Room(EXPECTED, knows(0.4, EXPECTED))
    house.step()
    for minute in range(40):
        house.plug.press()
        house.step(EXPECTED + minutes(minute))
    assert sum(wanted == Relay(True) for wanted in house.plug.told) <= 6
    assert "fought_over" in house.faults()
    house.run(READY_BY)
    assert house.cycle.memory.soc.mean >= 0.5
    assert "fought_over" not in house.faults()


# -- a plug that lied ------------------------------------------------------------------------------


def idle(flowed: bool) -> Memory:
    """The relay on for five minutes, and nothing flowing."""
    memory = replace(knows(0.5), relay_on=True)
    kw = 2.0 if flowed else 0.0
    for minute in range(-6, 0):
        now = NIGHT + minutes(minute)
        memory = perceive(now, Reading(now, True, kw if minute == -6 else 0.0, 5.0, now), memory, HOME)
    return memory


def test_an_off_after_an_on_that_gave_nothing_is_the_truth_and_no_press() -> None:
    off = Reading(NIGHT, False, 0.0, 5.0, NIGHT, changed_by_other=False)
    lied = perceive(NIGHT, off, idle(flowed=False), HOME)
    assert (lied.press, lied.moved, lied.relay_on) == (None, (), False)
    pressed = perceive(NIGHT, off, idle(flowed=True), HOME)
    assert pressed.press == Press(False, pressed.press.until if pressed.press else None)
