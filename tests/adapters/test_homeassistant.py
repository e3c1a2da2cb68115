"""The document by which Home Assistant gets to know plugd: what it demands of one, held against real states.

The tables are Home Assistant's own rules, as its 2025.4 and 2026.11 state them; `make hub-test` asks a real one.
"""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from datetime import date, datetime, time
from typing import Any

import pytest
from jinja2 import StrictUndefined
from jinja2.sandbox import ImmutableSandboxedEnvironment

from plugd.adapters import homeassistant
from plugd.adapters.hub import foreseen, planned, state
from plugd.command_words import PARSERS, Refused, parse
from plugd.controller import Controller
from plugd.domain import (
    Command,
    DayRule,
    Decision,
    Fault,
    Household,
    Memory,
    Mode,
    Observation,
    Overrides,
    Presence,
    Reading,
    SetHorizon,
    SetMinimum,
    SetMode,
    SetReadyBy,
    SetSoc,
    Status,
    Trip,
)
from plugd.planner.exact import Exact
from plugd.remedies import remedy
from tests.unit.deciding import HOME, NIGHT, forecast, knows

BASE = "plugd/ev"
DEVICE = homeassistant.device(BASE, HOME)
COMPONENTS: dict[str, dict[str, Any]] = DEVICE["components"]

NEEDED = {
    "sensor": {"state_topic"},
    "binary_sensor": {"state_topic"},
    "switch": {"command_topic", "state_topic"},
    "number": {"command_topic", "state_topic", "min", "max", "step", "mode"},
    "select": {"command_topic", "state_topic", "options"},
    "text": {"command_topic", "state_topic", "pattern", "max"},
    "button": {"command_topic", "payload_press"},
}
COMMON = {
    "platform", "unique_id", "name", "icon", "entity_category", "device_class", "value_template", "state_topic",
    "json_attributes_topic", "json_attributes_template",
}  # fmt: skip
ALLOWED = {
    "sensor": {"state_class", "unit_of_measurement", "suggested_display_precision", "options"},
    "binary_sensor": set(),
    "switch": {"command_topic"},
    "number": {"command_topic", "min", "max", "step", "mode", "unit_of_measurement"},
    "select": {"command_topic", "options"},
    "text": {"command_topic", "pattern", "max"},
    "button": {"command_topic", "payload_press"},
}
UNITS: dict[str, set[str | None]] = {
    "battery": {"%"},
    "power": {"W"},
    "energy": {"kWh"},
    "timestamp": {None},
    "enum": {None},
}
"""Device class of a sensor: its legal units, of those that are used here."""
STATE_CLASSES: dict[str, set[str | None]] = {
    "battery": {"measurement"},
    "power": {"measurement"},
    "energy": {"total", "total_increasing"},
    "timestamp": {None},
    "enum": {None},
}
BINARY_CLASSES = {"battery_charging", "problem"}
ATTRIBUTES_BYTES = 16384
"""What the recorder keeps; Home Assistant's own attributes (name, icon, unit) need some of it."""


def decided(
    memory: Memory, faults: tuple[Fault, ...] = (), household: Household = HOME, without: bool = False
) -> Decision:
    seen = Observation(forecast=None if without else forecast(NIGHT), faults=faults)
    return Controller(household, Exact()).tick(NIGHT, seen, memory)


FAULTY = (Fault("plug_silent", 'it says "nothing" & <more>'), Fault("store", "the card is full"))
BUSY = Overrides(
    minimum=0.6,
    ready_by=time(7),
    horizon=7,
    trips=(*(Trip(date(2023, 1, day), time(6, 30), 0.9) for day in range(4, 32)), Trip(date(2023, 2, 1), away=True)),
    week=((5, DayRule(time(10), 0.6)), (6, DayRule(away=True))),
)
BARE = replace(decided(knows(0.6)), memory=replace(knows(0.6), soc=replace(knows(0.6).soc, told_at=None)),
               outlook=None, forecast_issued_at=None)  # fmt: skip
HUGE = replace(HOME, car=replace(HOME.car, capacity_kwh=500.0, daily_use_kwh=100.0))
SITUATIONS: dict[str, tuple[Decision, Reading | None]] = {
    "waits": (decided(knows(0.6)), Reading(NIGHT, False, 0.0, 12.5)),
    "charges": (decided(knows(0.1)), Reading(NIGHT, True, 2.2871, 12.5)),
    "plug without a meter": (decided(knows(0.6)), Reading(NIGHT, True)),
    "knows nothing": (BARE, None),
    "boosts": (decided(replace(knows(0.6), overrides=Overrides(mode=Mode.NOW))), None),
    "is off": (decided(replace(knows(0.6), overrides=Overrides(mode=Mode.OFF))), None),
    "is alone": (decided(replace(knows(0.6), presence=Presence(False, NIGHT))), None),
    "is broken": (decided(knows(0.6), FAULTY), None),
    "has no forecast": (decided(knows(0.6), without=True), None),
    "is asked much": (decided(replace(knows(0.5), overrides=BUSY)), Reading(NIGHT, False, 0.0, 12.5)),
    "charges all week": (decided(replace(knows(0.0), overrides=Overrides(horizon=7)), household=HUGE), None),
    "is talkative": (replace(decided(knows(0.6)), reason="why " * 200), None),
}


def documents(situation: str) -> dict[str, Any]:
    """What plugd publishes then, as a hub reads it."""
    decision, reading = SITUATIONS[situation]
    said = {"state": state(decision, reading, HOME), "plan": planned(decision), "outlook": foreseen(decision)}
    return {f"{BASE}/{name}": json.loads(json.dumps(document)) for name, document in said.items()}


def rendered(template: str, document: object) -> str:
    """As Home Assistant does it; a name that is not there is an error here, and a warning in its log there."""
    jinja = ImmutableSandboxedEnvironment(undefined=StrictUndefined)
    return str(jinja.from_string(template).render(value_json=document, value=json.dumps(document))).strip()


def named(platform: str) -> list[str]:
    return [key for key, component in COMPONENTS.items() if component["platform"] == platform]


def test_the_topic_and_the_root_are_as_device_discovery_wants_them() -> None:
    assert homeassistant.topic("homeassistant", BASE) == "homeassistant/device/plugd_ev/config"
    assert DEVICE.keys() == {"device", "origin", "availability_topic", "qos", "components"}
    assert DEVICE["origin"].keys() == {"name", "sw_version"}
    assert DEVICE["device"].keys() == {"identifiers", "name", "manufacturer", "model", "sw_version"}
    assert DEVICE["device"]["identifiers"] == ["plugd_ev"]
    assert DEVICE["availability_topic"] == "plugd/ev/availability"
    assert len(json.dumps(DEVICE)) < ATTRIBUTES_BYTES


@pytest.mark.parametrize("base", ["plugd/ev", "house/left side/plugd/ev 2", "plügd/ev"])
def test_any_base_makes_a_legal_topic_and_ids_of_its_own(base: str) -> None:
    assert re.fullmatch(r"homeassistant/device/[A-Za-z0-9_-]+/config", homeassistant.topic("homeassistant", base))
    ids = {component["unique_id"] for component in homeassistant.device(base, HOME)["components"].values()}
    assert len(ids) == len(COMPONENTS)
    assert all(re.fullmatch(r"[A-Za-z0-9_-]+", one) for one in ids)


def test_everything_a_person_would_look_for_is_there() -> None:
    assert {platform: len(named(platform)) for platform in NEEDED} == {
        "sensor": 15, "binary_sensor": 3, "switch": 1, "number": 3, "select": 1, "text": 1, "button": 2,
    }  # fmt: skip
    assert COMPONENTS["status"]["options"] == [
        "waiting_for_forecast", "holding_for_cleaner_night", "waiting_to_start", "charging", "boosting", "ready",
        "disconnected", "off", "fault",
    ]  # fmt: skip
    assert COMPONENTS["mode"]["options"] == ["off", "smart", "now"]
    assert (COMPONENTS["energy"]["state_class"], COMPONENTS["energy"]["unit_of_measurement"]) == (
        "total_increasing",
        "kWh",
    )


@pytest.mark.parametrize("key", COMPONENTS)
def test_each_component_is_complete_and_has_nothing_that_its_platform_lacks(key: str) -> None:
    component = COMPONENTS[key]
    platform = component["platform"]
    assert component.keys() >= NEEDED[platform] | {"unique_id", "name"}
    assert component.keys() <= COMMON | ALLOWED[platform]
    assert component.get("entity_category") in (None, "config", "diagnostic")
    # A sensor may not be of category config, nor a control a diagnosis.
    refused = "config" if platform in ("sensor", "binary_sensor") else "diagnostic"
    assert component.get("entity_category") != refused
    assert not re.search(r"^plugd", component["name"], re.IGNORECASE), "the device's name stands before it anyway"


def test_names_are_told_apart() -> None:
    names = [(component["platform"], component["name"]) for component in COMPONENTS.values()]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("key", COMPONENTS)
def test_each_topic_exists(key: str) -> None:
    component = COMPONENTS[key]
    heard = documents("waits")
    for name, topic in component.items():
        if name == "command_topic":
            base, command, end = topic.rsplit("/", 2)
            assert (base, end) == (BASE, "set")
            assert command in PARSERS
        elif name.endswith("_topic"):
            assert topic in heard
    assert ("json_attributes_topic" in component) == ("json_attributes_template" in component)


@pytest.mark.parametrize("key", named("sensor"))
def test_classes_and_units_of_sensors_go_together(key: str) -> None:
    component = COMPONENTS[key]
    device_class, unit = component.get("device_class"), component.get("unit_of_measurement")
    if device_class is not None:
        assert unit in UNITS[device_class]
        assert component.get("state_class") in STATE_CLASSES[device_class]
    elif unit is not None:
        assert component["state_class"] in ("measurement", "total", "total_increasing")
    assert ("options" in component) == (device_class == "enum")


@pytest.mark.parametrize("key", named("binary_sensor"))
def test_classes_of_binary_sensors_exist(key: str) -> None:
    assert COMPONENTS[key]["device_class"] in BINARY_CLASSES


# -- templates ------------------------------------------------------------------------------------


def fits_sensor(component: dict[str, Any], shown: str) -> bool:
    if shown == "None":
        return True
    match component.get("device_class"):
        case "enum":
            return shown in component["options"]
        case "timestamp":
            return datetime.fromisoformat(shown).tzinfo is not None
    numeric = "unit_of_measurement" in component or "state_class" in component
    return float(shown) == float(shown) if numeric else bool(shown)


FITS: dict[str, Callable[[dict[str, Any], str], object]] = {
    "sensor": fits_sensor,
    "binary_sensor": lambda component, shown: shown in ("ON", "OFF", "None"),
    "switch": lambda component, shown: shown in ("ON", "OFF", "None"),
    "number": lambda component, shown: shown == "None" or component["min"] <= float(shown) <= component["max"],
    "select": lambda component, shown: shown in component["options"],
    "text": lambda component, shown: len(shown) <= component["max"] and re.match(component["pattern"], shown),
}


@pytest.mark.parametrize("situation", SITUATIONS)
def test_what_is_shown_is_a_legal_state_of_its_entity(situation: str) -> None:
    heard = documents(situation)
    for key, component in COMPONENTS.items():
        if component["platform"] == "button":
            continue
        shown = rendered(component["value_template"], heard[component["state_topic"]])
        assert len(shown) <= 255, key
        assert FITS[component["platform"]](component, shown), f"{key} shows {shown!r}"


@pytest.mark.parametrize("situation", SITUATIONS)
def test_attributes_are_objects_and_small_enough_for_the_recorder(situation: str) -> None:
    heard = documents(situation)
    for key, component in COMPONENTS.items():
        if "json_attributes_template" in component:
            text = rendered(component["json_attributes_template"], heard[component["json_attributes_topic"]])
            assert isinstance(json.loads(text), dict), key
            assert len(text.encode()) < ATTRIBUTES_BYTES - 1000, f"{key}: {len(text)} bytes when it {situation}"


def shown(key: str, situation: str) -> str:
    component = COMPONENTS[key]
    return rendered(component["value_template"], documents(situation)[component["state_topic"]])


def attributes(key: str, situation: str) -> Any:
    component = COMPONENTS[key]
    document = documents(situation)[component["json_attributes_topic"]]
    return json.loads(rendered(component["json_attributes_template"], document))


def test_what_is_not_known_is_unknown() -> None:
    unknown = {key for key, component in COMPONENTS.items()
               if component["platform"] != "button" and shown(key, "knows nothing") == "None"}  # fmt: skip
    assert unknown == {
        "connected", "next_start", "ready_at", "intensity", "power", "energy", "saved_today", "saved_total",
        "morning_soc", "forecast_until", "charging", "at_risk",
    }  # fmt: skip


def test_what_is_known_is_shown() -> None:
    assert (shown("status", "is alone"), shown("connected", "is alone")) == (Status.DISCONNECTED.value, "OFF")
    assert (shown("charging", "charges"), shown("power", "charges"), shown("energy", "charges")) == (
        "ON", "2287.1", "12.5",
    )  # fmt: skip
    assert (shown("charging", "waits"), shown("charging", "plug without a meter")) == ("OFF", "None")
    assert (shown("minimum", "is asked much"), shown("horizon", "is asked much")) == ("60.0", "7")
    assert (shown("ready_by", "is asked much"), shown("ready_by", "waits")) == ("07:00", "")
    assert (shown("trips", "is asked much"), shown("trips", "waits")) == ("29", "0")
    assert attributes("trips", "is asked much")["week"]["sun"] == {"away": True}
    assert shown("battery_now", "waits") == shown("soc", "waits") == "60.0"
    assert shown("saved_total", "waits") == "None"
    saved = {**documents("waits")[f"{BASE}/state"], "saved_g_total": 12345.6}
    assert rendered(COMPONENTS["saved_total"]["value_template"], saved) == "12.346"


def test_each_fault_is_an_attribute_of_the_problem() -> None:
    assert (shown("problem", "waits"), shown("problem", "is broken")) == ("OFF", "ON")
    assert attributes("problem", "waits") == {}
    assert attributes("problem", "is broken") == {fault.code: f"{fault.text}. {remedy(fault)}" for fault in FAULTY}


def test_plan_and_outlook_are_attributes() -> None:
    assert attributes("next_start", "waits")["plan"] == documents("waits")[f"{BASE}/plan"]
    outlook = attributes("intensity", "waits")["outlook"]
    assert outlook == [[s["start"], s["g_per_kwh"]] for s in documents("waits")[f"{BASE}/outlook"]]
    assert len(documents("charges all week")[f"{BASE}/plan"]) > homeassistant.MOST_PLAN_SLOTS
    assert len(attributes("next_start", "charges all week")["plan"]) == homeassistant.MOST_PLAN_SLOTS


# -- commands -------------------------------------------------------------------------------------


def sent(key: str, text: str) -> Command:
    """What plugd understands of what this control sends."""
    return parse(COMPONENTS[key]["command_topic"].split("/")[-2], text.encode())


def test_what_the_controls_send_is_understood() -> None:
    assert [sent("mode", option) for option in COMPONENTS["mode"]["options"]] == [
        SetMode(Mode.OFF),
        SetMode(Mode.SMART),
        SetMode(Mode.NOW),
    ]
    for key, command in (("minimum", SetMinimum), ("battery_now", SetSoc), ("horizon", SetHorizon)):
        low, high, step = (int(COMPONENTS[key][name]) for name in ("min", "max", "step"))
        assert all(isinstance(sent(key, str(value)), command) for value in range(low, high + 1, step))
        with pytest.raises(Refused):
            sent(key, str(high + 1 if key != "minimum" else 101))
    sent("replan", COMPONENTS["replan"]["payload_press"])
    assert sent("connected", "ON") != sent("connected", "OFF")


@pytest.mark.parametrize("text", ["", "00:00", "07:30", "23:59"])
def test_ready_by_takes_a_time_or_nothing(text: str) -> None:
    assert re.match(COMPONENTS["ready_by"]["pattern"], text)
    assert isinstance(sent("ready_by", text), SetReadyBy)


@pytest.mark.parametrize("text", ["24:00", "7:30", "07:60", "07:30:00", "x", "07:3"])
def test_the_pattern_of_ready_by_keeps_out_what_is_no_time(text: str) -> None:
    assert not re.match(COMPONENTS["ready_by"]["pattern"], text)


def test_the_minimum_may_be_what_it_is_configured_to_be() -> None:
    low = replace(HOME, nights=replace(HOME.nights, minimum=0.1))
    component = homeassistant.device(BASE, low)["components"]["minimum"]
    assert (component["min"], component["max"]) == (10.0, 80.0)
