"""How Home Assistant gets to know plugd: one MQTT device with all its entities, as a document to publish.

Device discovery (Home Assistant 2024.12 and later; tried on 2025.4). Neither `object_id` nor `default_entity_id`, of
which every version knows only one: entity ids follow from the device's name and the entity's. What plugd does
not know is null in its state, and "None" to Home Assistant: unknown, and not unavailable.
"""

import re
from typing import Any

from plugd import __version__
from plugd.domain import Household, Mode, Status
from plugd.units import to_pct

USUAL_PREFIX = "homeassistant"
CLOCK = r"^(([01]\d|2[0-3]):[0-5]\d)?$"
"""HH:MM, or nothing."""
MOST_PLAN_SLOTS = 120
"""With these the plan stays under the 16 kB that Home Assistant's recorder keeps of an entity's attributes."""
MOST_STATE = 255
"""Characters of a state in Home Assistant."""

Component = dict[str, Any]

FAULTS = (
    "{% set ns = namespace(found={}) %}{% for f in value_json.faults %}"
    "{% set ns.found = dict(ns.found, **{f.code: f.text ~ '. ' ~ f.remedy}) %}{% endfor %}{{ ns.found | tojson }}"
)
TRIPS = "{{ {'trips': value_json.settings.trips, 'week': value_json.settings.week} | tojson }}"
OUTLOOK = (
    "{% set ns = namespace(rows=[]) %}{% for s in value_json %}"
    "{% set ns.rows = ns.rows + [[s.start, s.g_per_kwh]] %}{% endfor %}{{ {'outlook': ns.rows} | tojson }}"
)
PLAN = f"{{{{ {{'plan': value_json[:{MOST_PLAN_SLOTS}]}} | tojson }}}}"


def topic(prefix: str, base: str) -> str:
    """Where the device is announced (retained); an empty payload there takes it back."""
    return f"{prefix}/device/{object_id(base)}/config"


def object_id(base: str) -> str:
    """`plugd/ev` as part of a topic and of unique ids."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", base)


def device(base: str, household: Household) -> dict[str, Any]:
    """The whole device. `base`: where plugd's own topics begin."""
    ours = object_id(base)
    components = {**_controls(household), **_sensors(), **_binary_sensors()}
    return {
        "device": {
            "identifiers": [ours],
            "name": " ".join(base.split("/")),
            "manufacturer": "plugd",
            "model": "Carbon-aware charging",
            "sw_version": __version__,
        },
        "origin": {"name": "plugd", "sw_version": __version__},
        "availability_topic": f"{base}/availability",
        "qos": 1,
        "components": {
            key: {**_placed(component, base), "unique_id": f"{ours}_{key}"} for key, component in components.items()
        },
    }


def _placed(component: Component, base: str) -> Component:
    """With whole topics. Every component but a button shows something of the state."""
    placed = {key: f"{base}/{value}" if key.endswith("_topic") else value for key, value in component.items()}
    if component["platform"] != "button":
        placed["state_topic"] = f"{base}/state"
    return placed


def _of(expression: str) -> str:
    """A template for a value of the state; null is rendered as None, which Home Assistant takes for unknown."""
    return f"{{{{ value_json.{expression} }}}}"


def _switched(key: str) -> str:
    """ON, OFF, or None for what is not known."""
    value = f"value_json.{key}"
    return f"{{{{ 'None' if {value} is none else 'ON' if {value} else 'OFF' }}}}"


def _attributes(topic_name: str, template: str) -> Component:
    return {"json_attributes_topic": topic_name, "json_attributes_template": template}


def _picked(*keys: str) -> Component:
    """Some keys of the state as attributes."""
    pairs = ", ".join(f"'{key}': value_json.{key}" for key in keys)
    return _attributes("state", f"{{{{ {{{pairs}}} | tojson }}}}")


def _controls(household: Household) -> dict[str, Component]:
    car, nights = household.car, household.nights
    lowest, highest = min(car.soc_min, nights.minimum), max(car.soc_max, nights.minimum)
    percent = {"unit_of_measurement": "%", "step": 1, "mode": "slider"}
    return {
        "mode": {
            "platform": "select",
            "name": "Mode",
            "icon": "mdi:ev-station",
            "command_topic": "mode/set",
            "value_template": _of("mode"),
            "options": [mode.value for mode in Mode],
        },
        "minimum": {
            "platform": "number",
            "name": "Morning minimum",
            "icon": "mdi:battery-lock",
            "command_topic": "minimum/set",
            "value_template": _of("settings.minimum_pct"),
            "min": to_pct(lowest),
            "max": to_pct(highest),
            **percent,
        },
        "horizon": {
            "platform": "number",
            "name": "Horizon",
            "icon": "mdi:weather-night",
            "entity_category": "config",
            "command_topic": "horizon/set",
            "value_template": _of("settings.horizon"),
            "unit_of_measurement": "nights",
            "min": 1,
            "max": 7,
            "step": 1,
            "mode": "box",
        },
        "battery_now": {
            "platform": "number",
            "name": "Battery now",
            "icon": "mdi:battery-sync",
            "command_topic": "soc/set",
            "value_template": _of("soc_pct"),
            "min": 0,
            "max": 100,
            **percent,
            "mode": "box",
        },
        "ready_by": {
            "platform": "text",
            "name": "Ready by",
            "icon": "mdi:clock-check-outline",
            "command_topic": "ready_by/set",
            "value_template": "{{ value_json.settings.ready_by or '' }}",
            "pattern": CLOCK,
            "max": 5,
        },
        "replan": {
            "platform": "button",
            "name": "Replan",
            "icon": "mdi:refresh",
            "entity_category": "config",
            "command_topic": "replan/set",
            "payload_press": "PRESS",
        },
        "clear_trips": {
            "platform": "button",
            "name": "Clear trips",
            "icon": "mdi:calendar-remove",
            "entity_category": "config",
            "command_topic": "trip/set",
            "payload_press": '{"clear": true}',
        },
        "connected": {
            "platform": "switch",
            "name": "Car connected",
            "icon": "mdi:power-plug",
            "command_topic": "connected/set",
            "value_template": _switched("connected"),
        },
    }


def _measured(unit: str, device_class: str | None = None, digits: int | None = None) -> Component:
    found: Component = {"state_class": "measurement", "unit_of_measurement": unit}
    if device_class is not None:
        found["device_class"] = device_class
    if digits is not None:
        found["suggested_display_precision"] = digits
    return found


def _sensors() -> dict[str, Component]:
    moment = {"device_class": "timestamp"}
    found = {
        "status": {
            "name": "Status",
            "icon": "mdi:state-machine",
            "device_class": "enum",
            "options": [status.value for status in Status],
            "value_template": _of("status"),
        },
        "reason": {
            "name": "Reason",
            "icon": "mdi:comment-text-outline",
            "value_template": f"{{{{ value_json.reason[:{MOST_STATE}] }}}}",
            **_picked("reason"),
        },
        "soc": {
            "name": "SOC",
            **_measured("%", "battery", digits=0),
            "value_template": _of("soc_pct"),
            **_picked("soc_low_pct", "soc_told_at"),
        },
        "soc_source": {
            "name": "SOC source",
            "icon": "mdi:battery-unknown",
            "entity_category": "diagnostic",
            "value_template": _of("soc_source"),
        },
        "next_start": {
            "name": "Next start",
            **moment,
            "value_template": _of("next_start"),
            **_attributes("plan", PLAN),
        },
        "ready_at": {"name": "Ready at", **moment, "value_template": _of("ready_at"), **_picked("ready_by")},
        "intensity": {
            "name": "Intensity now",
            "icon": "mdi:molecule-co2",
            **_measured("gCO2/kWh", digits=0),
            "value_template": _of("intensity_g_per_kwh"),
            **_attributes("outlook", OUTLOOK),
        },
        "power": {"name": "Power", **_measured("W", "power", digits=0), "value_template": _of("power_w")},
        "energy": {
            "name": "Energy",
            "device_class": "energy",
            "state_class": "total_increasing",
            "unit_of_measurement": "kWh",
            "suggested_display_precision": 2,
            "value_template": _of("energy_kwh"),
        },
        "saved_today": {
            "name": "CO2 saved today",
            "icon": "mdi:leaf",
            **_measured("g", digits=0),
            "value_template": _of("saved_g_today"),
        },
        "saved_total": {
            "name": "CO2 saved",
            "icon": "mdi:leaf",
            "state_class": "total",
            "unit_of_measurement": "kg",
            "suggested_display_precision": 1,
            "value_template": (
                "{{ None if value_json.saved_g_total is none else (value_json.saved_g_total / 1000) | round(3) }}"
            ),
        },
        "morning_soc": {
            "name": "Morning SOC expected",
            "icon": "mdi:battery-clock",
            **_measured("%", digits=0),
            "value_template": _of("morning_soc_pct"),
            **_picked("minimum_pct", "ready_by", "shortfall_kwh"),
        },
        "trips": {
            "name": "Trips",
            "icon": "mdi:road-variant",
            "value_template": "{{ value_json.settings.trips | length }}",
            **_attributes("state", TRIPS),
        },
        "forecast_until": {
            "name": "Forecast until",
            **moment,
            "entity_category": "diagnostic",
            "value_template": _of("forecast_until"),
        },
        "switch_ons": {
            "name": "Switch-ons today",
            "icon": "mdi:counter",
            "state_class": "measurement",
            "entity_category": "diagnostic",
            "value_template": _of("switch_ons_today"),
        },
    }  # fmt: skip
    return {key: {"platform": "sensor", **component} for key, component in found.items()}


def _binary_sensors() -> dict[str, Component]:
    found: dict[str, Component] = {
        "charging": {
            "name": "Charging",
            "device_class": "battery_charging",
            "value_template": _switched("charging"),
        },
        "at_risk": {
            "name": "Morning minimum at risk",
            "device_class": "problem",
            "value_template": _switched("at_risk"),
            **_picked("minimum_pct", "shortfall_kwh"),
        },
        "problem": {
            "name": "Problem",
            "device_class": "problem",
            "entity_category": "diagnostic",
            "value_template": "{{ 'ON' if value_json.faults else 'OFF' }}",
            **_attributes("state", FAULTS),
        },
    }
    return {key: {"platform": "binary_sensor", **component} for key, component in found.items()}
