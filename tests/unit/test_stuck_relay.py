"""A relay that stays on though it is told off: it is told three times, left alone, and said."""

from dataclasses import dataclass, replace
from datetime import timedelta
from itertools import pairwise

import pytest

from plugd import flow, reasons
from plugd.beat import is_on
from plugd.domain import Capability, Fault, Leak, Mode, Observation, Reading, Relay, SetMode, Status, Wanted
from plugd.errors import PlugFault, PlugRefused, PlugTimeout
from plugd.perception import perceive
from tests.unit.deciding import EVENING, HOME, NIGHT, READY_BY, Box, Room, at, knows, minutes, plan, planned, session

OFF = Relay(False)


@dataclass(slots=True)
class Welded(Box):
    """A plug whose contacts do not open. It says what its coil is, or what its contacts are; or it refuses."""

    stuck: bool = False
    says_off: bool = False
    answers: bool = True
    coil: bool = False

    def read(self) -> Reading:
        """What flows is the truth."""
        self.on = self.on or self.stuck
        reading = Box.read(self)
        return replace(reading, on=self.coil) if self.says_off else reading

    def set(self, wanted: Wanted) -> None:
        """The coil does as it is told."""
        Box.set(self, wanted)
        self.coil, self.on = self.on, self.on or self.stuck
        if self.on is not self.coil and not self.says_off and not self.answers:
            raise PlugRefused("plug ev-plug answers but stays ON; is it locked?")


@dataclass(slots=True)
class Frozen(Box):
    """A plug that does as it is told, and says that it is on."""

    def read(self) -> Reading:
        """Never anything else."""
        return replace(Box.read(self), on=True)

    def set(self, wanted: Wanted) -> None:
        """It answers with what it says."""
        Box.set(self, wanted)
        if not self.on:
            raise PlugRefused("plug ev-plug answers but stays ON; is it locked?")


def welded(says_off: bool, answers: bool = True, soc: float = 0.3) -> Room:
    """It welds while the car charges, and a person switches off."""
    house = Room(at(4, 40, day=3), knows(soc, at(4, 40, day=3)), HOME)
    plug = Welded(house.clock, says_off=says_off, answers=answers)
    house.plug = house.cycle.plug = house.cycle.actuator.plug = plug
    house.step()
    assert plug.told == [Relay(True)]
    house.hub.said.append(SetMode(Mode.OFF))
    plug.stuck = True
    return house


def offs(house: Room) -> list[float]:
    """The pauses between the offs that it was told, in seconds."""
    moments = [
        moment for moment, told in zip(house.plug.tries[1:], house.plug.told[1:], strict=True) if not is_on(told)
    ]
    return [(later - earlier).total_seconds() for earlier, later in pairwise(moments)]


def every_ten_seconds(house: Room, length: timedelta) -> None:
    """As the real clock looks."""
    until = house.clock.at + length
    while house.clock.at < until:
        house.step()
        house.clock.at += timedelta(seconds=10)


@pytest.mark.parametrize("answers", [True, False], ids=["says it has obeyed", "says that it stays on"])
def test_a_relay_that_stays_on_is_told_three_times_and_then_left_alone(answers: bool) -> None:
    house = welded(says_off=False, answers=answers)
    every_ten_seconds(house, timedelta(hours=3))
    assert len(offs(house)) == 2, "three times"
    assert sum(offs(house)) <= 60.0
    assert list(house.faults()) == ["relay_stuck"]
    assert "told off 3 times" in house.faults()["relay_stuck"]
    assert house.hub.decision is not None
    assert house.hub.decision.status is Status.FAULT
    assert "not under control" in house.hub.decision.reason
    assert house.cycle.memory.soc.mean > 0.4, "what flows is counted"


def test_current_through_a_relay_that_says_off_is_told_too() -> None:
    house = welded(says_off=True)
    every_ten_seconds(house, minutes(4))
    assert len(offs(house)) == 2, "three times"
    assert house.faults() == {"relay_stuck": "2.3 kW flows though the relay was told off 3 times and says that it is"}
    every_ten_seconds(house, timedelta(hours=3))
    assert len(offs(house)) == 2
    assert house.cycle.memory.soc.mean > 0.4


@pytest.mark.parametrize("says_off", [True, False])
def test_it_is_over_when_nothing_flows_any_more(says_off: bool) -> None:
    house = welded(says_off)
    every_ten_seconds(house, minutes(5))
    assert "relay_stuck" in house.faults()
    assert isinstance(house.plug, Welded)
    house.plug.stuck = house.plug.on = False
    every_ten_seconds(house, minutes(1))
    assert house.faults() == {}


@pytest.mark.parametrize("error", [None, PlugTimeout("silent")], ids=["left alone", "told on and on"])
def test_an_off_that_it_obeys_at_last_is_nobodys_press(error: PlugTimeout | None) -> None:
    house = Room(EVENING, knows(0.4))
    house.plug = house.cycle.plug = house.cycle.actuator.plug = plug = Welded(house.clock, stuck=True)
    plug.refuses = error
    every_ten_seconds(house, minutes(5))
    assert {"relay_stuck", "plug_refuses"} & house.faults().keys()
    plug.stuck = plug.on = plug.moved = False
    house.step()
    assert house.cycle.memory.press is None
    plug.refuses = None
    house.run(READY_BY)
    assert house.cycle.memory.soc.mean >= 0.5


def test_a_plug_that_says_on_and_went_off_is_told_on_when_it_is_time() -> None:
    """What it says stands still: only the meter shows that it obeyed."""
    house = Room(NIGHT, knows(0.4))
    house.step(at(1, 0, day=3))
    house.cycle.plug = house.cycle.actuator.plug = plug = Frozen(house.clock)
    every_ten_seconds(house, timedelta(hours=5, minutes=50))
    assert plug.told.count(OFF) >= 3
    assert house.cycle.memory.soc.mean >= 0.5


def test_a_persons_word_and_a_plug_that_was_away_are_worth_one_more_try() -> None:
    house = welded(says_off=False, soc=0.7)
    every_ten_seconds(house, minutes(5))
    tries = len(house.plug.tries)
    house.plug.came_back = True
    every_ten_seconds(house, minutes(5))
    assert len(house.plug.tries) == tries + 1
    house.clock.at = at(5, 10, day=3)  # the plan's last clean hour is over
    house.hub.said.append(SetMode(Mode.SMART))
    every_ten_seconds(house, minutes(5))
    assert len(house.plug.tries) == tries + 2
    assert "relay_stuck" in house.faults()


def test_that_the_last_safe_start_moves_is_no_reason_to_try_again() -> None:
    """An off goes with the time by which its timer has to be over, which moves while the car charges."""
    house = Room(NIGHT, knows(0.45, NIGHT), replace(HOME, capability=Capability(2.3, dead_man=True)))
    house.plug = house.cycle.plug = house.cycle.actuator.plug = Welded(house.clock, stuck=True)
    every_ten_seconds(house, timedelta(hours=1))  # by the plan it is off from 23:42 to 2 o'clock
    assert house.plug.told == [OFF, OFF, OFF]
    told = house.plug.told[-1]
    wanted = house.cycle.controller.act(house.clock.at, Observation(), house.cycle.memory).wanted
    assert isinstance(told, Relay)
    assert isinstance(wanted, Relay)
    assert told.on_by is not None
    assert told.on_by != wanted.on_by
    assert list(house.faults()) == ["relay_stuck"]


@pytest.mark.parametrize("error", [PlugTimeout("silent"), PlugFault("does not take its timer")])
def test_a_plug_that_did_not_hear_is_told_on_and_on(error: PlugTimeout | PlugFault) -> None:
    house = welded(says_off=False)
    house.plug.refuses = error
    every_ten_seconds(house, minutes(20))
    assert len(house.plug.tries) > 15
    assert list(house.faults()) == ["plug_refuses"]


def test_stuck_on_is_no_risk_for_the_morning() -> None:
    night = planned(session())
    memory = replace(knows(0.3, NIGHT), plan=plan(night))
    assert reasons.at_risk(NIGHT, memory, HOME, (Fault("relay_stuck", "it stays on"),)) is False
    assert reasons.at_risk(NIGHT, memory, HOME, (Fault("plug_silent", "silent"),)) is True


# -- what leaks -----------------------------------------------------------------------------------


def look(*readings: tuple[float, float | None, float | None]) -> Leak | None:
    """(seconds, kW, total) of readings through a relay that says off."""
    memory = knows(0.4, NIGHT)
    for after_s, power_kw, energy_kwh in readings:
        now = NIGHT + timedelta(seconds=after_s)
        memory = perceive(now, Reading(now, False, power_kw, energy_kwh, now), memory, HOME)
    return memory.flow.leak


def test_half_a_minute_of_current_is_a_leak_once_the_total_rises() -> None:
    assert look((0, 2.3, 5.0)) == Leak(NIGHT, NIGHT, 5.0, 2.3)
    assert flow.leaks(look((0, 2.3, 5.0), (20, 2.3, 5.01))) is False
    assert flow.leaks(look((0, 2.3, 5.0), (30, 2.3, 5.02))) is True
    assert flow.leaks(look((0, 2.3, 5.0), (30, 2.3, 5.0), (600, 2.3, 5.0))) is False, "a power that is frozen"
    assert flow.leaks(look((0, 2.3, None), (30, 2.3, None))) is True, "no total to doubt it by"


def test_what_a_plug_itself_takes_is_no_leak_and_a_moment_without_current_ends_one() -> None:
    assert look((0, 0.049, 5.0)) is None
    assert look((0, None, 5.0)) is None
    assert look((0, 2.3, 5.0), (30, 2.3, 5.02), (40, 0.0, 5.02)) is None


def test_the_same_word_of_the_meter_twice_is_one() -> None:
    memory = knows(0.4, NIGHT)
    for after_s in (0, 30, 60):
        now = NIGHT + timedelta(seconds=after_s)
        memory = perceive(now, Reading(now, False, 2.3, None, NIGHT), memory, HOME)
    assert not flow.leaks(memory.flow.leak)
