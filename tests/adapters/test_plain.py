"""Plugs that differ by their words: what each says, in its units, and what the broker keeps of it."""

import re
from dataclasses import asdict
from pathlib import Path

import pytest

from plugd.adapters.mqtt import Message, Retained
from plugd.adapters.plain import PRESETS, Plain, Words
from plugd.adapters.plug_words import Heard
from plugd.config import parse

EXAMPLE = Path(__file__).resolve().parents[2] / "etc" / "plugd.toml"
STATE = Heard(on=True, partial=True, answer=True, errors=())
NESTED = Words(
    state_key="relay.is", state_on="true", state_off="false", power_topic="{topic}/state", power_key="meter.kW",
    power_unit="kW", energy_topic="{topic}/state", energy_key="meter.Wh", energy_unit="Wh",
)  # fmt: skip


def hear(words: Words, topic: str, payload: bytes, retain: bool = False) -> Heard:
    """What a plug called p says."""
    return Plain("p", words).hear(Message(topic, payload, retain))


@pytest.mark.parametrize(
    ("kind", "topic", "payload", "heard"),
    [
        ("shelly1", "shellies/p/relay/0", b"on", STATE),
        ("shelly1", "shellies/p/relay/0", b"off", Heard(on=False, partial=True, answer=True, errors=())),
        ("shelly1", "shellies/p/relay/0", b"overpower",
         Heard(on=False, partial=True, answer=True, errors=("overpower",))),
        ("shelly1", "shellies/p/relay/0/power", b"2300.50", Heard(metered=True, partial=True, power_kw=2.3005)),
        ("shelly1", "shellies/p/relay/0/energy", b"60000", Heard(metered=True, partial=True, energy_kwh=1.0)),
        ("shelly1", "shellies/p/online", b"false", Heard(online=False)),
        ("zigbee2mqtt", "p", b'{"state":"ON","power":2300,"energy":1.5,"linkquality":9}',
         Heard(on=True, metered=True, power_kw=2.3, energy_kwh=1.5, answer=True, errors=())),
        ("zigbee2mqtt", "p", b'{"state":"ON","power":null}', STATE),
        ("zigbee2mqtt", "p", b'{"power":2300}', Heard(metered=True, partial=True, power_kw=2.3)),
        ("zigbee2mqtt", "p/availability", b'{"state":"offline"}', Heard(online=False)),
        ("zigbee2mqtt", "p/availability", b"online", Heard(online=True)),
        ("zigbee2mqtt", "p/availability", b'{"state":["online"]}', Heard()),
        ("esphome", "p/switch/relay/state", b"ON", STATE),
        ("esphome", "p/sensor/power/state", b"nan", Heard(partial=True)),
        ("esphome", "p/sensor/energy/state", b"12.345", Heard(metered=True, partial=True, energy_kwh=12.345)),
        ("esphome", "p/sensor/energy/state", b"-1", Heard(metered=True, partial=True, nonsense=1)),
        ("esphome", "p/sensor/energy/state", b"1e99", Heard(metered=True, partial=True, nonsense=1)),
        ("esphome", "p/sensor/energy/state", b"0x10", Heard(metered=True, partial=True, nonsense=1)),
        ("mqtt", "p/state", b"on", Heard(partial=True)),
        ("mqtt", "p/elsewhere", b"ON", Heard(partial=True)),
        ("mqtt", "p/power", b"1e6", Heard(metered=True, partial=True, nonsense=1)),
    ],
)  # fmt: skip
def test_what_is_understood(kind: str, topic: str, payload: bytes, heard: Heard) -> None:
    assert hear(PRESETS[kind], topic, payload) == heard


def test_a_value_within_values() -> None:
    assert hear(NESTED, "p/state", b'{"relay":{"is":true},"meter":{"kW":2.3,"Wh":1500}}') == Heard(
        on=True, metered=True, power_kw=2.3, energy_kwh=1.5, answer=True, errors=()
    )
    assert hear(NESTED, "p/state", b'{"relay":"on","meter":[2.3]}') == Heard(partial=True)
    assert hear(NESTED, "p/state", b'{"meter":{"kW":"2.3","Wh":false}}') == Heard(
        metered=True, partial=True, power_kw=2.3, nonsense=1
    )


def test_a_kept_state_counts_only_for_plugs_that_tell_changes() -> None:
    assert hear(PRESETS["esphome"], "p/switch/relay/state", b"ON", retain=True).kept
    assert hear(PRESETS["esphome"], "p/sensor/energy/state", b"1", retain=True) == Heard()
    assert hear(PRESETS["shelly1"], "shellies/p/relay/0", b"on", retain=True) == Heard()
    assert hear(PRESETS["shelly1"], "shellies/p/online", b"true", retain=True) == Heard(online=True)


@pytest.mark.parametrize("kind", list(PRESETS))
def test_no_filter_is_there_twice_and_no_command_is_listened_to(kind: str) -> None:
    plug = Plain("p", PRESETS[kind])
    filters = plug.filters()
    assert len(dict(filters)) == len(filters)
    sent = {topic for topic, _ in (*plug.switch(True, None), *plug.status())}
    assert not sent & set(dict(filters))
    assert dict(filters)[PRESETS[kind].availability_topic.replace("{topic}", "p")] is Retained.REPLAYED


def test_the_examples_words_are_those_of_the_preset() -> None:
    opened = re.sub(r"(?m)^# (\w+ = )", r"\1", EXAMPLE.read_text()).split("[plug.mqtt]")[1].split("\n[")[0]
    config = parse(f'[plug]\nkind = "mqtt"\ntopic = "p"\n[plug.mqtt]{opened}')
    assert config.plug.mqtt.model_dump() == asdict(PRESETS["mqtt"])
