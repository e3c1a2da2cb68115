"""As the UK asks of smart charge points: a random delay of every start, and a window where nothing is known."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, time, timedelta

import pytest

from plugd.controller import Controller
from plugd.domain import Memory, Mode, Nights, Presence, Relay, RelayRules, SetMode
from plugd.errors import ForecastUnavailable
from plugd.soc import unknown
from tests.unit.deciding import EVENING, HOME, READY_BY, Room, at, knows, minutes

ONE = replace(HOME, nights=Nights(horizon=1), end_value=False)
"""A household that charges what the coming morning needs."""
DELAYED = replace(ONE, relay=RelayRules())
HERE = Presence(True, EVENING)
SPAN_S = 600.0
NIGHTLY = (time(23), time(6))


def room(seed: str, memory: Memory | None = None, start: datetime = EVENING) -> Room:
    """A household with a random delay of its own, and a night that is clean from two o'clock on."""
    found = Room(start, memory or knows(0.45), DELAYED)
    found.cycle.controller = Controller(DELAYED, found.solver, seed)
    return found


def starts(found: Room) -> list[datetime]:
    """When the relay was told to go on until the morning."""
    found.run(READY_BY)
    return [at for told, at in zip(found.plug.told, found.plug.tries, strict=True) if told == Relay(True)]


# -- the delay ------------------------------------------------------------------------------------


def test_houses_start_apart_by_up_to_ten_minutes_to_the_second() -> None:
    first = [starts(room(f"house {k}"))[0] for k in range(8)]
    late_s = [(start - at(2, day=3)).total_seconds() for start in first]
    assert all(0.0 <= s <= SPAN_S for s in late_s)
    assert len(set(late_s)) > 6
    assert max(late_s) - min(late_s) > SPAN_S / 3.0


def test_the_delay_is_drawn_once_and_outlives_a_restart() -> None:
    """Not again with each half hour's plan, nor by a daemon that is killed on the way to its start."""
    (whole,) = starts(room("a"))
    killed = room("a")
    for moment in (at(22, 10), at(1, 40, day=3), whole - timedelta(seconds=30)):
        killed.run(moment)
        memory = killed.disk.load()
        assert memory
        killed.begin(memory, killed.cycle.forecast).controller = Controller(DELAYED, killed.solver, "a")
    assert starts(killed) == [whole]


@pytest.mark.parametrize("seed", ["a", "b", "c"])
def test_a_person_and_the_reserve_do_not_wait(seed: str) -> None:
    asked = room(seed)
    asked.run(EVENING + minutes(5))
    asked.hub.said.append(SetMode(Mode.NOW))
    asked.step(EVENING + minutes(7))
    assert asked.plug.told[-1] == Relay(True)
    empty = room(seed, replace(knows(0.1, EVENING), presence=HERE))
    empty.step()
    assert empty.plug.told == [Relay(True)]


@pytest.mark.parametrize("seed", ["a", "b", "c"])
def test_the_guard_does_not_wait(seed: str) -> None:
    """A planner that never charges: the relay goes on at the last safe start, to the second."""
    late = room(seed, knows(0.4))
    late.cycle.controller.household = replace(DELAYED, relay=RelayRules(max_switch_on=0))
    lead_s = 5.0 / (0.9 * 2.3 * 0.9) * 3600.0 + DELAYED.guard_margin_s
    assert starts(late) == [READY_BY - timedelta(seconds=lead_s)]


@pytest.mark.parametrize("soc", [0.19, 0.3, 0.45])
def test_no_minimum_is_missed_for_it(soc: float) -> None:
    """However little is left of the night, and whatever is drawn."""
    for seed in "abc":
        night = room(seed, replace(knows(soc), presence=HERE))
        night.run(READY_BY)
        assert soc + night.plug.energy_kwh * 0.9 / 50.0 >= 0.5 - 0.002


# -- nothing is known -----------------------------------------------------------------------------


def dark(memory: Memory, window: tuple[time, time] = NIGHTLY) -> Room:
    """A first start in a house that never had a network."""
    found = Room(EVENING, memory, replace(ONE, nights=replace(ONE.nights, default_window=window)))
    found.source.error = ForecastUnavailable("no network")
    return found


def on(found: Room) -> Iterator[datetime]:
    """The minutes of the night in which the relay is on."""
    while found.clock.at < READY_BY:
        found.run(found.clock.at + minutes(1))
        if found.plug.on:
            yield found.clock.at


@pytest.mark.parametrize(("soc", "begin", "end"), [(0.45, time(23), time(6)), (0.45, time(0, 30), time(3))])
def test_with_no_forecast_and_no_history_it_charges_in_the_default_window(soc: float, begin: time, end: time) -> None:
    charged = list(on(dark(knows(soc), (begin, end))))
    assert len(charged) >= 60 * 0.05 * 50.0 / 0.9 / 2.3 - 1
    inside = [begin < moment.time() <= end if begin < end else not end < moment.time() <= begin for moment in charged]
    # The doubt grows with what flows, and what is lacking then comes in one least block.
    assert inside.count(False) <= ONE.relay.min_on_s / 60.0


def test_the_minimum_goes_before_the_window() -> None:
    short = dark(knows(0.3), (time(2), time(3)))
    charged = list(on(short))
    assert any(not at(2, day=3) < moment <= at(3, day=3) for moment in charged)
    assert 0.3 + short.plug.energy_kwh * 0.9 / 50.0 >= 0.5 - 0.002


def test_a_forecast_goes_before_the_window() -> None:
    known = Room(EVENING, knows(0.45), replace(ONE, nights=replace(ONE.nights, default_window=(time(4), time(6)))))
    charged = list(on(known))
    assert charged[0] == at(2, 1, day=3), "the forecast's cleanest hours"


def test_nobody_told_the_soc_either_and_the_car_is_charged_all_the_same() -> None:
    blank = dark(Memory(unknown(EVENING)))
    list(on(blank))
    assert blank.plug.energy_kwh * 0.9 / 50.0 >= 0.5 - 0.09 - 0.002, "from the 9 % that are counted on"
