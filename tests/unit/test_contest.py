"""Two controllers at one plug: it is noticed, named, and it ends; a person's press stays a person's."""

from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest

from plugd import contest
from plugd.beat import Cause, decide
from plugd.domain import Memory, Mode, Overrides, Press, Reading, Relay
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


def test_a_timer_that_would_end_too_late_does_not_go_on_with_the_fight() -> None:
    home = replace(HOME, capability=replace(HOME.capability, fixed_timer_s=3600.0))
    memory = toggled(knows(0.45), 0, 1, 2, 3)
    assert not memory.relay_on
    start = decide(NIGHT, memory, home).verdict.last_safe_start
    assert start is not None
    ago = start - minutes(20) - memory.moved[-1]  # so near that an hour's timer would end after it
    memory = replace(memory, moved=tuple(at + ago for at in memory.moved), contested_until=start + minutes(10))
    last = memory.moved[-1]
    off = decide(last, memory, home)
    assert (off.cause, off.wanted) == (Cause.CONTESTED, Relay(False, on_by=last + minutes(60)))
    quiet = decide(last + contest.QUIET, off.memory, home)
    assert (quiet.cause, quiet.wanted) == (Cause.TIMER, Relay(True))


def test_nor_does_a_timer_of_any_length_end_before_it_is_quiet() -> None:
    memory = toggled(knows(0.1), 0, 1, 2, 3)
    last = NIGHT + minutes(3)
    off = decide(last, memory, HOME)
    assert off.verdict.last_safe_start is not None
    assert off.verdict.last_safe_start < last
    assert off.wanted == Relay(False)
    assert isinstance(off.wanted, Relay)
    assert off.wanted.on_by == last + contest.QUIET


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


def lied_for_a_moment(before: Memory, kw: float = 0.0, seconds: int = 40) -> Memory:
    """Off, then on without having been told, and off again soon."""
    for second, on in ((0, True), (10, True), (seconds - 1, True), (seconds, False)):
        now = NIGHT + timedelta(seconds=second)
        moved = on if second in (0, seconds) else None
        before = perceive(now, Reading(now, on, kw if on else 0.0, 5.0, now, changed_by_other=moved), before, HOME)
    return before


BRIEFLY_OR_LONG = pytest.mark.parametrize("seconds", [40, 300])


@BRIEFLY_OR_LONG
def test_an_off_after_a_press_through_which_nothing_flowed_takes_it_back(seconds: int) -> None:
    memory = lied_for_a_moment(replace(knows(0.5), relay_on=False), seconds=seconds)
    assert memory.press is None
    assert len(memory.moved) == 2, "a third would be another controller's all the same"
    assert decide(NIGHT + minutes(1), memory, HOME).cause is Cause.PLAN


def test_an_off_at_once_after_a_press_through_which_the_car_charged_is_meant() -> None:
    memory = lied_for_a_moment(replace(knows(0.5), relay_on=False), kw=2.0)
    assert memory.press is not None
    assert not memory.press.on


@pytest.mark.parametrize(
    "said", [{"overrides": Overrides(mode=Mode.OFF)}, {"press": Press(False, None)}], ids=["hub", "plug"]
)
@BRIEFLY_OR_LONG
def test_an_off_said_before_the_press_that_is_taken_back_counts_again(said: dict[str, Any], seconds: int) -> None:
    memory = lied_for_a_moment(replace(knows(0.5), relay_on=False, **said), seconds=seconds)
    assert memory.press is not None
    assert not memory.press.on
    assert decide(NIGHT + minutes(1), memory, HOME).cause is Cause.PERSON_OFF
