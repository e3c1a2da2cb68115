"""What commands do to memory, and what is answered."""

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from typing import Any

from plugd import soc
from plugd.domain import (
    Answer,
    Command,
    Household,
    Memory,
    Mode,
    Presence,
    Replan,
    SetConnected,
    SetHorizon,
    SetMinimum,
    SetMode,
    SetReadyBy,
    SetSoc,
)
from plugd.units import to_pct

Outcome = tuple[Memory, Answer]


def _mode(command: SetMode, memory: Memory, household: Household, now: datetime) -> Outcome:
    """A person's word also ends whatever a press at the plug asked for."""
    memory = replace(
        memory,
        overrides=replace(memory.overrides, mode=command.mode),
        press=None,
        guarding=memory.guarding and command.mode is not Mode.OFF,
    )
    return memory, Answer("mode", True, f"mode is {command.mode}")


def _soc(command: SetSoc, memory: Memory, household: Household, now: datetime) -> Outcome:
    memory = replace(memory, soc=soc.told(memory.soc, command.soc, now, command.source))
    return memory, Answer("soc", True, f"the battery is at {to_pct(command.soc):g} %")


def _minimum(command: SetMinimum, memory: Memory, household: Household, now: datetime) -> Outcome:
    low, high = household.car.soc_min, household.car.soc_max
    if not low <= command.minimum <= high:
        reason = (
            f"a morning minimum of {to_pct(command.minimum):g} % is outside soc_min {to_pct(low):g} % "
            f"to soc_max {to_pct(high):g} %; choose one within"
        )
        return memory, Answer("minimum", False, reason)
    memory = replace(memory, overrides=replace(memory.overrides, minimum=command.minimum))
    return memory, Answer("minimum", True, f"every morning has at least {to_pct(command.minimum):g} %")


def _ready_by(command: SetReadyBy, memory: Memory, household: Household, now: datetime) -> Outcome:
    memory = replace(memory, overrides=replace(memory.overrides, ready_by=command.ready_by))
    said = f"ready by {command.ready_by:%H:%M}" if command.ready_by else "ready by the configured time"
    return memory, Answer("ready_by", True, said)


def _horizon(command: SetHorizon, memory: Memory, household: Household, now: datetime) -> Outcome:
    memory = replace(memory, overrides=replace(memory.overrides, horizon=command.sessions))
    return memory, Answer("horizon", True, f"{command.sessions} sessions are planned together")


def plugged_in(memory: Memory, now: datetime) -> Memory:
    """The car has just been plugged in: whatever was asked of the stay before is over."""
    mode = Mode.SMART if memory.overrides.mode is Mode.OFF else memory.overrides.mode
    return replace(
        memory,
        presence=Presence(True, now),
        overrides=replace(memory.overrides, mode=mode),
        press=None,
        guarding=False,
    )


def unplugged(memory: Memory, now: datetime) -> Memory:
    """The car has just left: a boost or a press at the plug is over."""
    mode = Mode.SMART if memory.overrides.mode is Mode.NOW else memory.overrides.mode
    return replace(
        memory,
        presence=Presence(False, now),
        overrides=replace(memory.overrides, mode=mode),
        press=None if memory.press and memory.press.on else memory.press,
        guarding=False,
    )


def _connected(command: SetConnected, memory: Memory, household: Household, now: datetime) -> Outcome:
    here = memory.presence.connected
    if command.connected and here is not True:
        # Nobody having said before, this is news of a stay under way, and no reason to drop a person's off.
        memory = plugged_in(memory, now) if here is False else replace(memory, presence=Presence(True, now))
    elif not command.connected and here is not False:
        memory = unplugged(memory, now)
    return memory, Answer("connected", True, f"the car is {'here' if command.connected else 'not here'}")


def _replan(command: Replan, memory: Memory, household: Household, now: datetime) -> Outcome:
    return memory, Answer("replan", True, "planned anew")


_APPLY: dict[type, Callable[[Any, Memory, Household, datetime], Outcome]] = {
    SetMode: _mode,
    SetSoc: _soc,
    SetMinimum: _minimum,
    SetReadyBy: _ready_by,
    SetHorizon: _horizon,
    SetConnected: _connected,
    Replan: _replan,
}


def apply(
    commands: tuple[Command, ...], memory: Memory, household: Household, now: datetime
) -> tuple[Memory, tuple[Answer, ...]]:
    """Apply commands in order. Each sets, none toggles, so that one that comes twice does no harm."""
    answers = []
    for command in commands:
        memory, answer = _APPLY[type(command)](command, memory, household, now)
        answers.append(answer)
    return memory, tuple(answers)
