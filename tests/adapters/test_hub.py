"""The hub: what it takes for a command, and what it tells through a real broker."""

import json
import math
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from datetime import date, time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd.adapters import homeassistant
from plugd.adapters.hub import MqttHub, Topics, foreseen, planned, state
from plugd.adapters.mqtt import Broker, Mailbox, Message, MqttConnection, Retained
from plugd.command_words import MAX_BYTES, PARSERS, NotKnown, Refused, car_soc, parse
from plugd.controller import Controller
from plugd.cycle import Cycle
from plugd.domain import (
    ClearTrip,
    Command,
    DayRule,
    Decision,
    Fault,
    Memory,
    Mode,
    Observation,
    Overrides,
    Presence,
    Reading,
    Relay,
    Replan,
    Savings,
    SetConnected,
    SetHorizon,
    SetMinimum,
    SetMode,
    SetReadyBy,
    SetSoc,
    SetTrip,
    SetWeek,
    Switching,
    Trip,
)
from plugd.planner.exact import Exact
from plugd.remedies import KNOWN
from plugd_hil.broker import Mosquitto
from tests.fakes import FakeClock
from tests.programs import PATIENCE_S, Listener
from tests.unit.deciding import HOME, NIGHT, Box, Disk, Source, at, forecast, knows, minutes

SOON_S = PATIENCE_S
"""Only a limit: nothing waits longer than it must, and on a busy or an emulated machine five seconds were too few."""


class SomeNumber:
    """Equal to any number."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, float)

    def __hash__(self) -> int:
        return 0


ANY = SomeNumber()
KEYS = {
    "mode", "decision", "reason", "soc_pct", "soc_age_s", "soc_source", "power_w", "energy_kwh", "intensity_g_per_kwh",
    "next_start", "next_stop", "ready_by", "morning_soc_pct", "shortfall_kwh", "saved_g_today", "saved_g_total",
    "switch_ons_today", "forecast_age_min", "forecast_until", "faults", "version",
}  # fmt: skip
"""What others rely on."""

THURSDAY = date(2023, 1, 5)
TRIP = Trip(THURSDAY, time(5, 30), 0.9)

# -- what is a command ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "payload", "command"),
    [
        ("mode", b"smart", SetMode(Mode.SMART)),
        ("mode", b" NOW\n", SetMode(Mode.NOW)),
        ("mode", b"Off", SetMode(Mode.OFF)),
        ("soc", b"43", SetSoc(0.43)),
        ("soc", b"43.5", SetSoc(0.435)),
        ("soc", b"0", SetSoc(0.0)),
        ("soc", b"1", SetSoc(0.01)),
        ("soc", b"100", SetSoc(1.0)),
        ("minimum", b"7e1", SetMinimum(0.7)),
        ("connected", b"ON", SetConnected(True)),
        ("connected", b"off", SetConnected(False)),
        ("ready_by", b"07:30", SetReadyBy(time(7, 30))),
        ("ready_by", b"0:00", SetReadyBy(time(0, 0))),
        ("ready_by", b"", SetReadyBy(None)),
        ("horizon", b"3", SetHorizon(3)),
        ("horizon", b"7.0", SetHorizon(7)),
        ("replan", b"PRESS", Replan()),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": 90, "ready_by": "05:30"}', SetTrip(TRIP)),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": 90}', SetTrip(Trip(THURSDAY, minimum=0.9))),
        ("trip", b'{"date": "2023-01-05", "ready_by": "05:30", "away": false}', SetTrip(Trip(THURSDAY, time(5, 30)))),
        ("trip", b'{"date": "2023-01-05", "away": true, "clear": null}', SetTrip(Trip(THURSDAY, away=True))),
        ("trip", b' {"clear": true, "date": "2023-01-05"}\n', ClearTrip(THURSDAY)),
        ("trip", b'{"clear": true}', ClearTrip(None)),
        ("week", b"", SetWeek(None)),
        ("week", b"null", SetWeek(None)),
        ("week", b"{}", SetWeek(())),
        (
            "week",
            b'{"sun": {"away": true}, "mon": {}, "sat": {"ready_by": "10:00", "minimum_pct": 60}}',
            SetWeek(((5, DayRule(time(10), 0.6)), (6, DayRule(away=True)))),
        ),
    ],
)
def test_what_is_understood(name: str, payload: bytes, command: Command) -> None:
    assert parse(name, payload) == command


@pytest.mark.parametrize("payload", [b"0.43", b"0.999", b"1e-9"])
@pytest.mark.parametrize("name", ["soc", "minimum"])
def test_a_fraction_is_not_taken_for_percent(name: str, payload: bytes) -> None:
    with pytest.raises(Refused, match="looks like a fraction; send percent, 0 to 100"):
        parse(name, payload)


@pytest.mark.parametrize("payload", [b"nan", b"NaN", b"inf", b"-Infinity", b"1e999", b"-1", b"100.01", b"9" * 4000])
@pytest.mark.parametrize("name", ["soc", "minimum"])
def test_a_number_outside_is_refused_with_its_bounds(name: str, payload: bytes) -> None:
    with pytest.raises(Refused, match="is outside 0 to 100 %"):
        parse(name, payload)


@pytest.mark.parametrize(
    ("name", "payload", "remedy"),
    [
        ("soc", b"", "send one from 0 to 100 %"),
        ("soc", b"half", "send one from 0 to 100 %"),
        ("soc", b"50 %", "send one from 0 to 100 %"),
        ("mode", b"", "send one of off, smart, now"),
        ("mode", b"on", "send one of off, smart, now"),
        ("connected", b"1", "neither ON nor OFF"),
        ("ready_by", b"25:00", "send HH:MM"),
        ("ready_by", b"07:30:15", "send HH:MM"),
        ("ready_by", b"9" * 4000 + b":00", "send HH:MM"),
        ("ready_by", b"-1:30", "send HH:MM"),
        ("horizon", b"0", "is outside 1 to 7 nights"),
        ("horizon", b"8", "is outside 1 to 7 nights"),
        ("horizon", b"2.5", "not a whole number"),
        ("replan", b"", "is not PRESS"),
        ("toggle", b"ON", "there are mode, soc, minimum, connected, ready_by, week, trip, horizon, replan"),
        ("trip", b"", "is no JSON"),
        ("trip", b"[]", "a trip is a JSON object with date, minimum_pct, ready_by, away, clear"),
        ("trip", b"{}", "date 'null' is no day; send the morning's, as YYYY-MM-DD"),
        ("trip", b'{"date": "20230105", "away": true}', "is no day"),
        ("trip", b'{"date": "2023-02-29", "away": true}', "is no day"),
        ("trip", b'{"date": "2023-W01-4", "away": true}', "is no day"),
        ("trip", b'{"date": 20230105, "away": true}', "is no day"),
        ("trip", b'{"date": "2023-01-05"}', "asks for nothing; send minimum_pct, ready_by or away"),
        ("trip", b'{"date": "2023-01-05", "away": true, "minimum_pct": 60}', "send one or the other"),
        ("trip", b'{"date": "2023-01-05", "clear": true, "minimum_pct": 60}', "send it with the date alone"),
        ("trip", b'{"date": "2023-01-05", "clear": 1}', "neither true nor false"),
        ("trip", b'{"date": "2023-01-05", "away": "yes"}', "neither true nor false"),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": "60"}', "is not a number"),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": true}', "is not a number"),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": 0.6}', "looks like a fraction"),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": 101}', "is outside 0 to 100 %"),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": NaN}', "NaN is no JSON; send a finite number"),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": 1e999}', "too large"),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": ' + b"9" * 3000 + b"}", "is not a number"),
        ("trip", b'{"date": "2023-01-05", "minimum_pct": 60, "minimum_pct": 20}', "a key comes twice"),
        ("trip", b'{"date": "2023-01-05", "minimum": 60}', "a trip has no 'minimum'; there are date, minimum_pct"),
        ("trip", b'{"date": "2023-01-05", "ready_by": 5}', "send HH:MM in quotes"),
        ("trip", b'{"date": "2023-01-05", "ready_by": "5 am"}', "send HH:MM"),
        ("trip", b"[" * 4000, "nested too deep"),
        ("trip", b'{"date": "\\ud800"}', "is no day"),
        ("week", b"[]", "a week is a JSON object with mon, tue"),
        ("week", b'{"saturday": {"away": true}}', "a week has no 'saturday'"),
        ("week", b'{"sat": true}', "a day of the week is a JSON object"),
        ("week", b'{"sat": {"away": false}}', "sat asks for nothing"),
        ("week", b'{"sat": {"away": true, "ready_by": "10:00"}}', "send one or the other"),
        ("week", b'{"sat": {"a": {"b": {"c": {}}}}}', "sat has no 'a'"),
        ("", b"ON", "there is no command ''"),
        ("soc", b"\xff\xfe", "not UTF-8"),
        ("soc", b"5" * 4097, "at most 4096"),
    ],
)
def test_what_is_refused_says_what_would_be_right(name: str, payload: bytes, remedy: str) -> None:
    with pytest.raises(Refused) as refusal:
        parse(name, payload)
    assert remedy in str(refusal.value)
    assert len(str(refusal.value)) < 250


JSONS = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.sampled_from(["2023-01-05", "10:00", "x", "\ud800"]),
    lambda inner: (
        st.lists(inner, max_size=2)
        | st.dictionaries(
            st.sampled_from(["date", "minimum_pct", "ready_by", "away", "clear", "sat"]), inner, max_size=4
        )
    ),
    max_leaves=6,
).map(lambda tree: json.dumps(tree).encode())
WORDS = st.sampled_from(["ON", "off", "NOW", "07:30", "1_0", "٣", "0x10", "NaN", "1e999", "-0", "true", "{}", "\u2028"])
TEXTS = (WORDS | st.text(max_size=40) | st.floats().map(str) | st.integers().map(str)).map(
    lambda t: t.encode("utf-8", "replace")
)


@given(
    name=st.sampled_from([*PARSERS, "other", ""]) | st.text(max_size=9), payload=TEXTS | JSONS | st.binary(max_size=60)
)
def test_anything_is_a_command_or_refused(name: str, payload: bytes) -> None:
    try:
        command = parse(name, payload)
    except Refused:
        return
    if isinstance(command, SetSoc | SetMinimum):
        value = command.soc if isinstance(command, SetSoc) else command.minimum
        assert 0.0 <= value <= 1.0
    if isinstance(command, SetTrip):
        assert command.trip != Trip(command.trip.day)
        assert command.trip.minimum is None or 0.0 <= command.trip.minimum <= 1.0
    if isinstance(command, SetHorizon):
        assert 1 <= command.sessions <= 7


# -- the car's own topic --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("payload", "key", "soc"),
    [
        (b"64", None, 0.64),
        (b" 64.5 ", None, 0.645),
        (b'{"soc": 64}', "soc", 0.64),
        (b'{"battery": {"level": 64.5, "x": 1}}', "battery.level", 0.645),
        (b'{"soc": 0}', "soc", 0.0),
        (b'{"soc": "64"}', "soc", 0.64),
    ],
)
def test_the_soc_in_a_cars_message(payload: bytes, key: str | None, soc: float) -> None:
    assert car_soc(payload, key) == pytest.approx(soc)


@pytest.mark.parametrize(
    ("payload", "key"),
    [
        (b"0.64", None), (b"nan", None), (b"101", None), (b"\xff", None),
        (b'{"soc": "low"}', "soc"), (b'{"soc": true}', "soc"), (b'{"soc": 1, "soc": 64}', "soc"),
        (b'{"soc": [64]}', "soc"), (b'{"soc": {}}', "soc"),
        (b'{"soc": 0.64}', "soc"),
        (b'{"soc": NaN}', "soc"), (b'{"soc": Infinity}', "soc"), (b'{"soc": 1e999}', "soc"), (b'{"soc": -1}', "soc"),
        (b'{"soc": ' + b"9" * 4000 + b"}", "soc"), (b'{"soc": 64', "soc"), (b"[" * 4000, "soc"), (b'{"a":' * 800, "a"),
        (b'{"soc": 64}' + b" " * MAX_BYTES, "soc"),
    ],
)  # fmt: skip
def test_a_cars_message_without_a_soc_is_refused(payload: bytes, key: str | None) -> None:
    with pytest.raises(Refused) as refusal:
        car_soc(payload, key)
    assert not isinstance(refusal.value, NotKnown)


@pytest.mark.parametrize(
    ("payload", "key"),
    [
        (b"", None), (b"unavailable", None), (b"Unknown", None), (b"null", None), (b"null", "soc"),
        (b'{"soc": null}', "soc"), (b'{"soc": "unavailable"}', "soc"), (b'{"soc": 64}', "level"),
        (b'"\\ud800"', "soc"),
        (b'{"soc": 64}', "soc.level"), (b'{"a": {}}', "a.c"), (b"[64]", "0"), (b'"abc"', "soc"), (b"64", "soc"),
    ],
)  # fmt: skip
def test_a_car_that_does_not_know_says_nothing_and_that_is_no_fault(payload: bytes, key: str | None) -> None:
    with pytest.raises(NotKnown):
        car_soc(payload, key)


@pytest.mark.parametrize(("payload", "soc"), [(b"0.64", 0.64), (b"1", 1.0), (b"0", 0.0), (b"1.0", 1.0)])
def test_a_car_that_counts_in_fractions(payload: bytes, soc: float) -> None:
    assert car_soc(payload, None, fraction=True) == soc


@pytest.mark.parametrize("payload", [b"64", b"1.01", b"-0.1", b"nan"])
def test_percent_from_a_car_that_counts_in_fractions_is_refused(payload: bytes) -> None:
    with pytest.raises(Refused, match="is outside 0 to 1, a fraction as soc_unit says"):
        car_soc(payload, None, fraction=True)


TREES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["soc", "a"]), inner, max_size=2),
    max_leaves=8,
)


@given(
    payload=TREES.map(lambda tree: json.dumps(tree).encode()) | TEXTS | st.binary(max_size=60),
    key=st.sampled_from([None, "soc", "a.soc", "", "."]),
)
def test_any_message_of_the_car_is_a_fraction_or_refused(payload: bytes, key: str | None) -> None:
    try:
        soc = car_soc(payload, key)
    except Refused:
        return
    assert math.isfinite(soc)
    assert 0.0 <= soc <= 1.0


# -- what arrives, without a network --------------------------------------------------------------

HERE = Topics("plugd/ev", "car/soc")


def unconnected() -> MqttHub:
    return MqttHub(MqttConnection(Broker(), "nobody"), HERE, HOME)


def arrive(mailbox: Mailbox | None, *messages: tuple[str, bytes, bool]) -> None:
    assert mailbox is not None
    for topic, payload, retain in messages:
        mailbox.put(Message(topic, payload, retain))


def test_commands_come_in_their_order_and_once() -> None:
    hub = unconnected()
    arrive(hub._commands, ("plugd/ev/soc/set", b"43", False), ("plugd/ev/mode/set", b"now", False))
    assert list(hub.commands()) == [SetSoc(0.43), SetMode(Mode.NOW)]
    assert list(hub.commands()) == []


def test_one_bad_command_does_not_take_the_good_ones_with_it() -> None:
    hub = unconnected()
    arrive(hub._commands, ("plugd/ev/soc/set", b"x", False), ("plugd/ev/mode/set", b"now", False))
    assert list(hub.commands()) == [SetMode(Mode.NOW)]
    assert hub.refused == 1


def test_a_kept_copy_is_never_obeyed() -> None:
    hub = unconnected()
    arrive(hub._commands, ("plugd/ev/mode/set", b"now", True))
    arrive(hub._car, ("car/soc", b"50", True))
    assert list(hub.commands()) == []


def test_a_command_that_is_too_long_is_answered_too() -> None:
    connection = Flaky(0)
    hub = MqttHub(connection, HERE, HOME)
    arrive(hub._commands, ("plugd/ev/trip/set", b"{" * 5000, False), ("plugd/ev/mode/set", b"now", False))
    assert list(hub.commands()) == [SetMode(Mode.NOW)]
    assert connection.said == ["plugd/ev/result"]
    assert list(hub.commands()) == []
    assert (connection.said, hub.refused) == (["plugd/ev/result"], 1)


def test_what_the_car_says_that_cannot_be_its_soc_is_a_fault_until_it_says_better() -> None:
    hub = unconnected()
    arrive(hub._car, ("car/soc", b"0.64", False))
    assert list(hub.commands()) == []
    (fault,) = hub.warnings
    assert fault.code == "car_soc"
    assert "car/soc: 0.64 looks like a fraction" in fault.text
    arrive(hub._car, ("car/soc", b"unavailable", False))
    assert list(hub.commands()) == []
    assert hub.warnings == (fault,)
    arrive(hub._car, ("car/soc", b"64", False), ("car/soc", b"unavailable", False))
    assert list(hub.commands()) == [SetSoc(0.64, source="car")]
    assert not hub.warnings


def test_a_key_that_was_never_there_is_a_fault_and_one_that_is_sometimes_there_is_none() -> None:
    hub = MqttHub(MqttConnection(Broker(), "nobody"), Topics("plugd/ev", "car/soc", "battery.soc"), HOME)
    arrive(hub._car, ("car/soc", b'{"odometer": 5}', False))
    assert list(hub.commands()) == []
    assert "there is no 'battery.soc' in the car's message" in hub.warnings[0].text
    arrive(hub._car, ("car/soc", b'{"battery": {"soc": 64}}', False))
    assert list(hub.commands()) == [SetSoc(0.64, source="car")]
    arrive(hub._car, ("car/soc", b'{"odometer": 6}', False))
    assert (list(hub.commands()), hub.warnings) == ([], ())


def test_the_cars_last_good_word_counts() -> None:
    hub = unconnected()
    arrive(hub._car, ("car/soc", b"40", False), ("car/soc", b"41", False), ("car/soc", b"unavailable", False))
    assert list(hub.commands()) == [SetSoc(0.41, source="car")]
    assert hub.refused == 0


class Flaky(MqttConnection):
    """A connection that breaks while it is spoken to."""

    def __init__(self, fails: int) -> None:
        super().__init__(Broker(), "nobody")
        self.connected, self.session, self.fails = True, 1, fails
        self.said: list[str] = []

    def publish(self, topic: str, payload: bytes, *, qos: int = 0, retain: bool = False) -> bool:
        self.fails -= 1
        if self.fails < 0:
            self.said.append(topic)
        return self.fails < 0


@pytest.mark.parametrize("fails", [1, 2, 3, 4])
def test_what_could_not_be_told_is_told_the_next_time(fails: int) -> None:
    connection = Flaky(fails)
    hub = MqttHub(connection, HERE, HOME)
    for _ in range(5):
        hub.publish(decided(), None)
    assert sorted(connection.said) == [f"plugd/ev/{name}" for name in ("availability", "outlook", "plan", "state")]


# -- the documents --------------------------------------------------------------------------------


def decided(memory: Memory | None = None, faults: tuple[Fault, ...] = ()) -> Decision:
    seen = Observation(forecast=forecast(NIGHT), faults=faults)
    return Controller(HOME, Exact()).tick(NIGHT, seen, memory or knows(0.6))


def test_the_state_has_every_key_and_what_is_not_known_is_null() -> None:
    told = state(decided(), None, HOME)
    assert told.keys() >= KEYS
    assert (told["power_w"], told["energy_kwh"], told["saved_g_today"]) == (None, None, None)
    bare = state(replace(decided(), memory=replace(knows(0.6), soc=replace(knows(0.6).soc, told_at=None)), outlook=None,
                         forecast_issued_at=None), None, HOME)  # fmt: skip
    empty = {"soc_age_s", "intensity_g_per_kwh", "next_start", "next_stop", "ready_by", "morning_soc_pct",
             "shortfall_kwh", "forecast_age_min", "forecast_until"}  # fmt: skip
    assert {key for key in KEYS if bare[key] is None} >= empty
    json.dumps(bare, allow_nan=False)


def test_the_state_says_what_is() -> None:
    decision = decided(faults=(Fault("store", "the card is full"),))
    told = state(replace(decision, at=NIGHT + minutes(10)), Reading(NIGHT, True, 2.2871, 12.5), HOME)
    expected = {
        "at": "2023-01-02T23:10:00Z",
        "mode": "smart",
        "decision": "off",
        "soc_pct": 60.0,
        "soc_source": "hub",
        "soc_age_s": 18600,
        "power_w": 2287.1,
        "energy_kwh": 12.5,
        "intensity_g_per_kwh": 200.0,
        "next_start": "2023-01-03T02:00:00Z",
        "next_stop": "2023-01-03T05:00:00Z",
        "ready_by": "2023-01-03T06:57:00Z",
        "minimum_pct": 50.0,
        "shortfall_kwh": 0.0,
        "switch_ons_today": 0,
        "forecast_age_min": 10,
        "forecast_until": "2023-01-04T23:00:00Z",
        "faults": [{"code": "store", "text": "the card is full", "remedy": KNOWN["store"].remedy}],
    }
    assert {key: told[key] for key in expected} == expected
    assert told["ready_at"] == "2023-01-03T05:00:00Z"
    assert (told["charging"], told["at_risk"]) == (True, False)
    assert told["settings"] == {"minimum_pct": 50.0, "ready_by": None, "horizon": 4, "week": {}, "trips": []}
    assert told["morning_soc_pct"] == pytest.approx(60 + 3 * 2.3 * 0.9 * 2, abs=0.1)


def test_what_is_saved_today_and_in_all_are_told_apart() -> None:
    told = state(replace(decided(), saved=Savings(today_g=120.04, total_g=5136.16)), None, HOME)
    assert (told["saved_g_today"], told["saved_g_total"]) == (120.0, 5136.2)


def test_the_intensity_is_that_of_the_half_hour_under_way_and_not_of_the_outlooks_first() -> None:
    decision = decided()
    assert decision.outlook is not None
    first, second, *rest = decision.outlook.slots
    outlook = replace(decision.outlook, slots=(first, replace(second, g_per_kwh=first.g_per_kwh + 50), *rest))
    later = replace(decision, outlook=outlook, at=second.start + minutes(5))
    assert state(later, None, HOME)["intensity_g_per_kwh"] == first.g_per_kwh + 50


@pytest.mark.parametrize(
    ("reading", "power_w", "charging"),
    [
        (Reading(NIGHT, True, 2.3, 12.5), 2300.0, True),
        (Reading(NIGHT, True, 0.0, 12.5), 0.0, False),
        (Reading(NIGHT, True, None, 12.5), None, None),
        (Reading(NIGHT, False, None, 12.5), 0.0, False),
        (Reading(NIGHT, False, 2.3, 12.5), 2300.0, True),
        (Reading(NIGHT, False), None, None),
        (None, None, None),
    ],
)
def test_it_charges_where_power_flows(reading: Reading | None, power_w: float | None, charging: bool | None) -> None:
    told = state(decided(), reading, HOME)
    assert (told["power_w"], told["charging"]) == (power_w, charging)


def test_switch_ons_are_todays_by_the_local_calendar() -> None:
    memory = replace(knows(0.6), switch_ons=(at(23, 30, day=1), at(1), at(4)))
    assert state(decided(memory), None, HOME)["switch_ons_today"] == 2
    assert state(decided(memory), None, replace(HOME, timezone="Europe/Berlin"))["switch_ons_today"] == 0


@pytest.mark.parametrize(
    "memory",
    [
        replace(knows(0.6), overrides=Overrides(mode=Mode.OFF)),
        replace(knows(0.6), overrides=Overrides(mode=Mode.NOW)),
        replace(knows(0.6), presence=Presence(False, NIGHT)),
    ],
    ids=["off", "now", "away"],
)
def test_no_start_is_announced_that_will_not_be(memory: Memory) -> None:
    told = state(decided(memory), None, HOME)
    assert (told["next_start"], told["next_stop"]) == (None, None)


def test_while_the_guard_is_late_no_stop_of_the_coming_nights_is_announced() -> None:
    here = Presence(True, NIGHT)
    late = Controller(HOME, Exact()).tick(
        at(8, day=3), Observation(forecast=forecast(at(8, day=3))), replace(knows(0.45, at(21)), presence=here)
    )
    assert late.reason.startswith("Late")
    assert isinstance(late.memory.orders, Switching)
    assert late.memory.orders.next(late.at, False), "the plan has a stop of its own"
    told = state(late, None, HOME)
    assert (told["next_stop"], told["ready_at"]) == (None, None)
    assert told["next_start"] is not None


def test_the_plan_lists_the_slots_with_power() -> None:
    decision = decided()
    told = planned(decision)
    assert told[0] == {
        "start": "2023-01-03T02:00:00Z",
        "end": "2023-01-03T02:30:00Z",
        "power_kw": 2.3,
        "intensity_g_per_kwh": 100.0,
    }
    assert all(slot["power_kw"] > 0.0 for slot in told)
    assert planned(replace(decision, memory=knows(0.6))) == []


def test_the_settings_are_what_counts_now_in_the_words_of_the_commands() -> None:
    asked = Overrides(minimum=0.6, ready_by=time(7), horizon=2, trips=(TRIP, Trip(date(2023, 1, 6), away=True)),
                      week=((5, DayRule(minimum=0.7)), (6, DayRule(away=True))))  # fmt: skip
    told = state(decided(replace(knows(0.6), overrides=asked)), None, HOME)["settings"]
    assert told == {
        "minimum_pct": 60.0,
        "ready_by": "07:00",
        "horizon": 2,
        "week": {"sat": {"minimum_pct": 70.0}, "sun": {"away": True}},
        "trips": [
            {"date": "2023-01-05", "minimum_pct": 90.0, "ready_by": "05:30"},
            {"date": "2023-01-06", "away": True},
        ],
    }
    assert parse("week", json.dumps(told["week"]).encode()) == SetWeek(asked.week)
    assert [parse("trip", json.dumps(trip).encode()) for trip in told["trips"]] == [SetTrip(t) for t in asked.trips]


def test_a_morning_that_will_be_short_is_at_risk_and_so_is_one_with_a_silent_plug() -> None:
    assert state(decided(knows(0.2)), None, HOME)["at_risk"] is False
    late = replace(HOME, car=replace(HOME.car, capacity_kwh=100.0))
    short = Controller(late, Exact()).tick(NIGHT, Observation(forecast=forecast(NIGHT)), knows(0.2))
    assert state(short, None, late)["at_risk"] is True
    silent = (Fault("plug_silent", "it says nothing"),)
    assert state(decided(knows(0.2), silent), None, HOME)["at_risk"] is True
    assert state(decided(knows(0.7), silent), None, HOME)["at_risk"] is False
    assert state(replace(decided(), memory=knows(0.6)), None, HOME)["at_risk"] is None


def test_the_outlook_lists_a_week_at_most() -> None:
    decision = decided()
    told = foreseen(decision)
    assert told[0] == {"start": "2023-01-02T23:00:00Z", "g_per_kwh": 200.0, "sd_g_per_kwh": ANY, "source": "neso"}
    assert decision.outlook
    assert len(told) == len(decision.outlook.slots) < 7 * 48
    away = replace(
        knows(0.6), overrides=Overrides(trips=tuple(Trip(date(2023, 1, d), away=True) for d in range(4, 20)))
    )
    assert len(foreseen(decided(away))) == 7 * 48
    assert foreseen(replace(decision, outlook=None)) == []


# -- through a broker -----------------------------------------------------------------------------


class Line:
    """plugd at one end of a real broker, a hub at the other. Nobody waits but for messages."""

    def __init__(self, broker: Mosquitto, left: ExitStack) -> None:
        self._where, self._left = Broker(broker.host, broker.port), left
        will = ("plugd/ev/availability", b"offline")
        self.ours = self._connect("plugd-ev", will)
        self.hub = MqttHub(self.ours, Topics("plugd/ev", "car/state", "battery.soc"), HOME)
        self.theirs = self._connect("hub")
        self.heard = self.theirs.subscribe(("plugd/ev/#", Retained.REPLAYED))
        self.theirs.flush()
        self.clock = FakeClock(NIGHT)
        self.plug = Box(self.clock)
        self.cycle = Cycle(
            clock=self.clock,
            source=Source(),
            plug=self.plug,
            hub=self.hub,
            store=Disk(),
            controller=Controller(HOME, Exact()),
            memory=knows(0.6),
            spread=lambda: 0.0,
        )

    def _connect(self, name: str, will: tuple[str, bytes] | None = None) -> MqttConnection:
        connection = MqttConnection(self._where, name, will, retry_s=(0.05, 0.2))
        self._left.callback(connection.close)
        connection.start()
        assert connection.wait_connected(SOON_S)
        return connection

    def step(self) -> dict[str, Any]:
        """One step, ten seconds later; what was told in it, by topic."""
        self.ours.flush()
        self.clock.at += minutes(1 / 6)
        self.cycle.step()
        self.ours.flush()
        return self.listen()

    def listen(self) -> dict[str, Any]:
        """What the hub has heard since the last time: the last word on each topic."""
        self.theirs.flush()
        return {m.topic.removeprefix("plugd/ev/"): _read(m.payload) for m in self.heard.take()}

    def say(self, topic: str, payload: bytes, retain: bool = False) -> dict[str, Any]:
        """The hub publishes, and plugd makes a step."""
        self.theirs.publish(topic, payload, qos=1, retain=retain)
        self.theirs.flush()
        return self.step()

    def command(self, name: str, payload: bytes, retain: bool = False) -> dict[str, Any]:
        """The hub commands."""
        return self.say(f"plugd/ev/{name}/set", payload, retain)

    def late_hub(self) -> dict[str, Any]:
        """What somebody hears who comes only now: what is retained."""
        late = self._connect("late")
        heard = late.subscribe(("plugd/ev/#", Retained.REPLAYED))
        late.flush()
        found = heard.take()
        late.close()  # of two with one name each would push the other out
        assert all(message.retain for message in found)
        return {m.topic.removeprefix("plugd/ev/"): _read(m.payload) for m in found}


def _read(payload: bytes) -> Any:
    text = payload.decode()
    return json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON")) if text[:1] in "{[" else text


@pytest.fixture
def line(mosquitto: Mosquitto) -> Iterator[Line]:
    with ExitStack() as left:
        yield Line(mosquitto, left)


def test_state_plan_and_availability_are_retained(line: Line) -> None:
    line.step()
    kept = line.late_hub()
    assert kept.keys() == {"availability", "state", "plan"}
    assert kept["availability"] == "online"
    assert kept["state"].keys() >= KEYS
    assert kept["plan"][0].keys() == {"start", "end", "power_kw", "intensity_g_per_kwh"}


@pytest.mark.parametrize(
    ("name", "payload", "key", "value", "said"),
    [
        ("soc", b"43", "soc_pct", 43.0, "the battery is at 43 %"),
        ("connected", b"ON", "connected", True, "the car is here"),
        ("connected", b"OFF", "status", "disconnected", "the car is not here"),
        ("mode", b"now", "status", "boosting", "mode is now"),
        ("mode", b"off", "mode", "off", "mode is off"),
        ("minimum", b"70", "minimum_pct", 70.0, "every morning has at least 70 %"),
    ],
)
def test_a_command_is_answered_and_shows(
    line: Line, name: str, payload: bytes, key: str, value: object, said: str
) -> None:
    before = line.step()["state"]
    assert before[key] != value
    told = line.command(name, payload)
    assert told["result"] == {"command": name, "ok": True, "message": said}
    assert told["state"][key] == value
    assert "result" not in line.late_hub()


def test_now_and_off_move_the_plug_in_the_same_step(line: Line) -> None:
    line.step()
    line.command("mode", b"now")
    line.command("mode", b"off")
    assert line.plug.told == [Relay(False), Relay(True), Relay(False, held=True)]


@pytest.mark.parametrize(
    ("name", "payload", "message"),
    [
        ("soc", b"0.4", "0.4 looks like a fraction; send percent, 0 to 100"),
        ("minimum", b"90", "outside soc_min 20 % to soc_max 80 %; choose one within"),
        ("toggle", b"ON", "there is no command 'toggle'"),
    ],
)
def test_a_refusal_is_answered_and_changes_nothing(line: Line, name: str, payload: bytes, message: str) -> None:
    before = line.step()["state"]
    told = line.command(name, payload)
    assert (told["result"]["command"], told["result"]["ok"]) == (name, False)
    assert message in told["result"]["message"]
    assert line.command("replan", b"PRESS").get("state", before)["mode"] == before["mode"]
    assert line.cycle.memory.overrides == Overrides()


def test_a_retained_command_is_answered_and_not_obeyed(line: Line) -> None:
    line.step()
    told = line.command("mode", b"now", retain=True)
    assert not told["result"]["ok"]
    assert "without retain" in told["result"]["message"]
    assert line.cycle.memory.overrides.mode is Mode.SMART


def test_the_cars_own_topic_counts_even_where_it_is_published_retained(line: Line) -> None:
    line.step()
    told = line.say("car/state", b'{"battery": {"soc": 55}}', retain=True)
    assert (told["state"]["soc_pct"], told["state"]["soc_source"]) == (55.0, "car")


def test_what_the_broker_kept_of_the_car_is_not_news(mosquitto: Mosquitto) -> None:
    with ExitStack() as left:
        before = MqttConnection(Broker(mosquitto.host, mosquitto.port), "car")
        left.callback(before.close)
        before.start()
        assert before.wait_connected(SOON_S)
        before.publish("car/state", b'{"battery": {"soc": 5}}', qos=1, retain=True)
        before.flush()
        assert Line(mosquitto, left).step()["state"]["soc_pct"] == 60.0


def test_the_state_is_told_when_it_changes_and_not_else(line: Line) -> None:
    assert line.step().keys() == {"availability", "plan", "state"}
    assert line.step() == {}
    line.plug.energy_kwh += 0.1
    assert line.step().keys() == {"state"}


def test_a_broken_connection_is_offline_and_back_online(line: Line) -> None:
    line.step()
    assert line.ours._client is not None
    cut = line.ours._client.socket()
    assert isinstance(cut, socket.socket)
    cut.shutdown(socket.SHUT_RDWR)
    assert heard(line, lambda: "availability" in (said := line.listen()) and said["availability"] == "offline")
    assert line.ours.bell.hold(lambda: line.ours.session == 2, SOON_S)
    assert line.step()["availability"] == "online"


DEVICE = "homeassistant/device/plugd_ev/config"


@pytest.fixture
def long_ears(line: Line, mosquitto: Mosquitto) -> Iterator[Listener]:
    """Somebody who hears everything there is, however long: plugd itself takes no more than 4 kB."""
    line.hub = MqttHub(line.ours, Topics("plugd/ha", discovery_prefix="homeassistant"), HOME)
    line.cycle.hub = line.hub
    line.ours.flush()
    listener = Listener(mosquitto.host, mosquitto.port, ["plugd/ha/+", "homeassistant/#"])
    yield listener
    listener.close()


def test_the_device_is_announced_once_and_again_when_the_hub_is_born(line: Line, long_ears: Listener) -> None:
    line.step()
    announced = long_ears.until("homeassistant/device/plugd_ha/config")
    assert announced == json.loads(json.dumps(homeassistant.device("plugd/ha", HOME)))
    assert long_ears.until("plugd/ha/outlook")[0].keys() == {"start", "g_per_kwh", "sd_g_per_kwh", "source"}
    long_ears.until("plugd/ha/state")
    for birth, told in (("offline", []), ("online", ["config", "outlook", "plan", "state"])):
        seen = long_ears.count()
        long_ears.send("homeassistant/status", birth)
        line.step()
        line.ours.publish("plugd/ha/end", birth.encode())
        long_ears.until("plugd/ha/end", birth.__eq__, after=seen)
        heard = {topic.split("/")[-1] for topic, _, _ in long_ears.heard.all[seen:]}
        assert sorted(heard - {"status", "end"}) == told


def test_an_empty_prefix_takes_back_what_was_announced(line: Line, long_ears: Listener, mosquitto: Mosquitto) -> None:
    line.step()
    long_ears.until("homeassistant/device/plugd_ha/config")
    line.cycle.hub = MqttHub(line.ours, Topics("plugd/ha", discovery_prefix=""), HOME)
    line.step()
    assert long_ears.until("homeassistant/device/plugd_ha/config", lambda said: said == "") == ""
    late = Listener(mosquitto.host, mosquitto.port, ["homeassistant/#", "plugd/ha/state"])
    late.until("plugd/ha/state")
    late.close()
    assert [topic for topic, _, _ in late.heard.all] == ["plugd/ha/state"]


def test_a_trip_is_set_listed_and_cleared(line: Line) -> None:
    line.step()
    told = line.command("trip", b'{"date": "2023-01-04", "minimum_pct": 75, "ready_by": "05:00"}')
    assert told["result"] == {"command": "trip", "ok": True, "message": "2023-01-04: at least 75 % by 05:00"}
    assert told["state"]["settings"]["trips"] == [{"date": "2023-01-04", "minimum_pct": 75.0, "ready_by": "05:00"}]
    told = line.command("trip", b'{"date": "2023-01-04", "clear": true}')
    assert told["result"]["ok"]
    assert told["state"]["settings"]["trips"] == []
    assert not line.command("trip", b'{"date": "2022-12-24", "away": true}')["result"]["ok"]


def test_a_daemon_that_ends_says_so(line: Line) -> None:
    line.step()
    line.hub.close()
    line.ours.close()
    assert heard(line, line.heard.pending)
    assert line.late_hub()["availability"] == "offline"


def test_after_a_broker_restart_everything_is_told_again(line: Line, mosquitto: Mosquitto) -> None:
    line.step()
    mosquitto.stop()
    assert line.ours.bell.hold(lambda: not line.ours.connected, SOON_S)
    line.clock.at += minutes(1)
    line.cycle.step()
    mosquitto.start()
    assert line.ours.bell.hold(lambda: line.ours.session == 2, SOON_S)
    assert line.theirs.bell.hold(lambda: line.theirs.session == 2, SOON_S)
    assert line.late_hub() == {}, "this broker forgets"
    assert line.step().keys() == {"availability", "plan", "state"}
    assert line.late_hub().keys() == {"availability", "plan", "state"}
    assert line.command("mode", b"now")["result"]["ok"]


def heard(line: Line, so: Callable[[], bool]) -> bool:
    """Whether it came to the hub's ears in time."""
    return line.theirs.bell.hold(line.heard.pending, SOON_S) and so()


def test_the_morning_soc_is_what_is_expected_and_not_what_is_promised() -> None:
    decision = decided(knows(0.6))
    promised = state(decision, None, HOME)["morning_soc_pct"]
    doubtful = replace(decision.memory, soc=replace(decision.memory.soc, sd=0.05))
    assert state(replace(decision, memory=doubtful), None, HOME)["morning_soc_pct"] == pytest.approx(
        promised + 10.25, abs=0.1
    )
