"""The plug's own timer where plugd dies: a handful of what `make deadman` goes through."""

import json
from datetime import timedelta
from functools import partial

import pytest

from plugd.adapters.shelly2 import Shelly2
from plugd.adapters.switched import SwitchedPlug
from plugd.adapters.tasmota import Tasmota
from plugd.domain import Mode, Relay, SetMode
from plugd_hil.plug import parser as stub_parser
from plugd_hil.plug import plug_at
from tests.dead_man import FIRST_KILL, KINDS, NIGHTS, QUARTER, Day, kills
from tests.wire import Wire, WireClock

BY_NAME = {night.name: night for night in NIGHTS}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("night", "quarters"),
    [
        ("the last clean hours", range(20, 76, 14)),
        ("a timer of four hours", range(56, 66, 2)),
        ("clean by turns", range(70, 76, 1)),
    ],
)
def test_killed_for_good_the_car_is_at_its_minimum(kind: str, night: str, quarters: range) -> None:
    found = list(kills(kind, BY_NAME[night], quarters))
    assert any(not killed.was_on for killed in found)
    assert [killed for killed in found if not killed.morning.here or killed.morning.missed] == []


@pytest.mark.parametrize("kind", KINDS)
def test_a_persons_own_off_outlives_plugd(kind: str) -> None:
    day = Day(kind, BY_NAME["the usual"])
    day.run(FIRST_KILL + 32 * QUARTER)
    day.hub.said.append(SetMode(Mode.OFF))
    day.run(FIRST_KILL + 33 * QUARTER)
    morning = day.killed().morning
    assert morning.missed
    assert morning.soc == pytest.approx(0.45)


def test_a_tasmota_plug_writes_its_timer_to_flash_once() -> None:
    day = Day("tasmota", BY_NAME["clean by turns"])
    day.run(FIRST_KILL + timedelta(days=1))
    written = ("PulseTime1", "PowerOnState", "Backlog")
    settings = [(topic, said) for topic, said in day.wire.sent if said and topic.rsplit("/")[-1] in written]
    assert settings == [("cmnd/ev-plug/Backlog", "PowerOnState 5; PulseTime1 3700")]


def wire(kind: str) -> Wire:
    """A stub of this kind at the other end."""
    options = stub_parser().parse_args(["--dialect", kind])
    return Wire(partial(plug_at, options=options))


def test_a_shelly_is_given_no_longer_than_to_the_last_safe_start() -> None:
    line = wire("shelly2")
    clock = WireClock(line)
    plug = SwitchedPlug(line, clock, "ev-plug", Shelly2("ev-plug", "plugd/ev/me"), dead_man_s=3600.0)
    start = clock.now()
    plug.set(Relay(False, on_by=start + timedelta(minutes=75)))
    for minute in range(1, 76):
        clock.wait(start + timedelta(minutes=minute) - timedelta(seconds=1))
        plug.read()
        plug.tend(clock.now())
    calls = [json.loads(payload) for topic, payload in line.sent if topic == "ev-plug/rpc"]
    timers_s = [call["params"]["toggle_after"] for call in calls if call["method"] == "Switch.Set"]
    assert timers_s[:2] == [3600.0, 3600.0]
    assert timers_s[2:] == sorted(timers_s[2:], reverse=True)
    assert timers_s[-1] < 1000.0
    assert not plug.read().on
    clock.wait(start + timedelta(minutes=75, seconds=1))
    reading = plug.read()
    assert (reading.on, reading.changed_by_other) == (True, None)


def test_a_tasmota_off_is_repeated_for_the_last_time_an_hour_before_the_last_safe_start() -> None:
    line = wire("tasmota")
    clock = WireClock(line)
    plug = Tasmota(line, clock, "ev-plug", dead_man_s=3600.0)
    start = clock.now()
    plug.read()
    plug.set(Relay(False, on_by=start + timedelta(minutes=75)))
    first = len([1 for topic, payload in line.sent if payload == "OFF"])
    sent = []
    for minute in range(1, 75):
        clock.wait(start + timedelta(minutes=minute))
        before = len(line.sent)
        plug.read()
        plug.tend(clock.now())
        sent += [minute for topic, payload in line.sent[before:] if payload == "OFF"]
    assert first == 1
    assert sent == [11, 15]
    clock.wait(start + timedelta(minutes=76))
    reading = plug.read()
    assert (reading.on, reading.changed_by_other) == (True, None)
