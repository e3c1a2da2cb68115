"""A plugd that ends again and again charges in the default window, and plans again after a quiet hour."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from plugd import safe_mode
from plugd.adapters.starts import FILE, MOST, Starts
from plugd.beat import Cause, decide
from plugd.domain import Cut, Flow, Mode, Overrides, Presence, Press, Relay, SetMode, Status
from plugd.perception import fresh
from tests.unit.deciding import EVENING, HOME, NIGHT, READY_BY, Room, at, knows, minutes


def house(soc: float = 0.6, start: datetime = EVENING) -> Room:
    """A daemon that starts in safe mode."""
    found = Room(start, knows(soc, start))
    found.cycle.controller.safe = True
    return found


def test_it_charges_in_the_default_window_and_neither_plans_nor_fetches_nor_keeps() -> None:
    room = house(start=at(22, 30))
    room.step()
    assert room.plug.told == [Relay(False)]
    room.run(at(23, 5))
    assert room.plug.told == [Relay(False), Relay(True)]
    assert (room.solver.calls, room.source.asked, room.disk.saves, room.disk.ram.records) == (0, [], 0, [])
    assert "from 23:00 to 06:00" in room.faults()["safe_mode"]
    assert room.hub.decision
    assert room.hub.decision.status is Status.FAULT
    assert room.hub.decision.reason.startswith("Plugd has ended again and again")


def test_what_people_said_and_a_cut_are_taken_over_and_nothing_else() -> None:
    cut = Cut(EVENING, 14.0, 10.5)
    before = replace(
        knows(0.7),
        overrides=Overrides(mode=Mode.OFF, minimum=0.6),
        press=Press(False, None),
        presence=Presence(True, EVENING),
        flow=Flow(cut=cut, stopped_at=EVENING),
        observed_kw=1.2,
    )
    after = safe_mode.begun(NIGHT, before)
    assert after == replace(
        fresh(NIGHT), overrides=before.overrides, press=before.press, presence=before.presence, flow=Flow(cut=cut)
    )
    assert decide(NIGHT, after, HOME).cause is Cause.CUT


def test_what_people_say_meanwhile_outlives_the_next_end() -> None:
    room = house(start=NIGHT)
    room.step()
    room.hub.said.append(SetMode(Mode.OFF))
    room.step(NIGHT + minutes(1))
    kept = room.disk.load()
    assert kept is not None
    assert kept.overrides.mode is Mode.OFF
    room.plug.press()
    room.step(NIGHT + minutes(2))
    assert room.disk.saves == 2


def test_a_cut_meanwhile_outlives_the_next_end() -> None:
    room = house(start=NIGHT)
    room.household = room.cycle.controller.household = replace(HOME, max_current_a=10.5)
    room.plug.current_a = 14.0
    for _ in range(12):
        room.step(room.clock.at + timedelta(seconds=10))
    kept = room.disk.load()
    assert kept is not None
    assert kept.flow.cut is not None


def test_after_a_quiet_hour_it_plans_again() -> None:
    room = house()
    room.run(EVENING + minutes(59))
    assert room.solver.calls == 0
    room.run(EVENING + minutes(61))
    assert (room.solver.calls, "safe_mode" in room.faults()) == (1, False)


def test_the_guard_acts_all_the_same() -> None:
    room = house(soc=0.1, start=NIGHT - minutes(60))
    room.step()
    assert room.plug.told == [Relay(True)]


@pytest.mark.parametrize(("hour", "on"), [(22, False), (23, True), (3, True), (5, True), (6, False), (12, False)])
def test_the_window_crosses_midnight(hour: int, on: bool) -> None:
    now = at(hour, 1)
    assert safe_mode.orders(now, knows(0.6), HOME).state(now) is on


def test_a_window_by_day_and_a_full_battery() -> None:
    by_day = replace(HOME, nights=replace(HOME.nights, default_window=(at(11).time(), at(15).time())))
    assert safe_mode.orders(at(12), fresh(EVENING), by_day).state(at(12))
    assert not safe_mode.orders(at(16), fresh(EVENING), by_day).state(at(16))
    assert not safe_mode.orders(at(12), knows(0.8), by_day).state(at(12))
    assert NIGHT < READY_BY


# -- how often it has started ---------------------------------------------------------------------


def test_a_sixth_start_in_ten_minutes_is_a_loop(tmp_path: Path) -> None:
    begun = [Starts(tmp_path).begun(NIGHT + minutes(minute)) for minute in range(MOST + 1)]
    assert begun == [False] * MOST + [True]
    assert not Starts(tmp_path).begun(NIGHT + minutes(30))


def test_who_ends_it_in_order_has_not_seen_it_crash(tmp_path: Path) -> None:
    for _ in range(20):
        starts = Starts(tmp_path)
        assert not starts.begun(NIGHT)
        starts.ended()


@pytest.mark.parametrize("poison", [b"", b"[", b"[" * 4096, b'{"a": 1}', b'[null, "x", 1e999]', b"\xff\xfe"])
def test_a_poisoned_file_counts_as_none(poison: bytes, tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(poison)
    assert not Starts(tmp_path).begun(NIGHT)
    assert not Starts(tmp_path / "missing").begun(NIGHT)


def test_a_clock_that_jumps_makes_no_loop(tmp_path: Path) -> None:
    for k in range(10):
        assert not Starts(tmp_path).begun(datetime(2023 - k, 1, 1, tzinfo=UTC) + timedelta(minutes=k))
