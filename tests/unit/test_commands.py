"""What commands do to memory and what is answered."""

from dataclasses import replace
from datetime import time

import pytest

from plugd import commands
from plugd.domain import (
    Command,
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
)
from tests.unit.deciding import EVENING, HOME, NIGHT, knows

MEMORY = knows(0.6)
HERE, AWAY, UNTOLD = Presence(True, EVENING), Presence(False, EVENING), Presence()


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
        (SetHorizon(3), {"overrides": Overrides(horizon=3)}, "3 sessions are planned together"),
        (SetConnected(True), {"presence": Presence(True, NIGHT)}, "the car is here"),
        (SetConnected(False), {"presence": Presence(False, NIGHT)}, "the car is not here"),
        (Replan(), {}, "planned anew"),
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
