"""The Shelly plug's words: replies by their number, notifications of what has changed, errors, timers."""

import json
from typing import Any

import pytest

from plugd.adapters.mqtt import Message
from plugd.adapters.plug_words import Heard
from plugd.adapters.shelly2 import Shelly2

STATUS = {
    "id": 0, "source": "MQTT", "output": False, "timer_started_at": 1690000000.5, "timer_duration": 3600,
    "apower": 0.0, "voltage": 231.4, "current": 0.0, "aenergy": {"total": 1234.567, "by_minute": [0.0, 0.0, 0.0]},
    "temperature": {"tC": 40.1, "tF": 104.2},
}  # fmt: skip


@pytest.fixture
def shelly() -> Shelly2:
    """Nothing asked yet."""
    return Shelly2("shelly-a1", "plugd/ev/me")


def reply(shelly: Shelly2, number: int, **said: Any) -> Heard:
    """Its answer to a call."""
    frame = {"id": number, "src": "shelly-a1", "dst": "plugd/ev/me", **said}
    return shelly.hear(Message("plugd/ev/me/rpc", json.dumps(frame).encode(), False))


def notified(shelly: Shelly2, retain: bool = False, **params: Any) -> Heard:
    """What it tells everybody."""
    frame = {"src": "shelly-a1", "dst": "shelly-a1/events", "method": "NotifyStatus", "params": params}
    return shelly.hear(Message("shelly-a1/events/rpc", json.dumps(frame).encode(), retain))


def test_off_is_sent_with_a_timer_and_asked_back(shelly: Shelly2) -> None:
    calls = [(topic, json.loads(payload)) for topic, payload in shelly.switch(False, 3600.0)]
    assert {topic for topic, _ in calls} == {"shelly-a1/rpc"}
    assert [(c["method"], c["params"]) for _, c in calls] == [
        ("Switch.Set", {"id": 0, "on": False, "toggle_after": 3600.0}),
        ("Switch.GetStatus", {"id": 0}),
    ]
    assert len({c["id"] for _, c in calls}) == 2
    assert all(c["src"] == "plugd/ev/me" for _, c in calls)


def test_on_and_a_held_off_have_no_timer(shelly: Shelly2) -> None:
    for on in (True, False):
        assert "toggle_after" not in shelly.switch(on, None)[0][1]


def test_a_status_is_an_answer_and_in_its_units(shelly: Shelly2) -> None:
    shelly.status()
    assert reply(shelly, 1, result=STATUS) == Heard(
        on=False, metered=True, power_kw=0.0, energy_kwh=1.234567, current_a=0.0, answer=True, timer=True, errors=()
    )
    assert reply(shelly, 2, result={"uptime": 77, "mac": "x"}) == Heard(uptime_s=77.0)


def test_only_what_was_asked_is_an_answer(shelly: Shelly2) -> None:
    assert reply(shelly, 1, result=STATUS) == Heard()
    shelly.status()
    for number in (True, "1", None, 99, [1], 1.5):
        assert reply(shelly, number, result=STATUS) == Heard()  # type: ignore[arg-type] # what a stranger may send


def test_an_answer_from_before_the_order_does_not_confirm_it(shelly: Shelly2) -> None:
    shelly.status()
    shelly.switch(True, None)
    assert not reply(shelly, 1, result=STATUS).answer
    assert reply(shelly, 4, result=STATUS).answer


def test_an_error_is_a_refusal_in_its_own_words(shelly: Shelly2) -> None:
    shelly.switch(True, None)
    assert reply(shelly, 1, error={"code": -103, "message": "Invalid argument 'on'!"}).refusal == (
        "Invalid argument 'on'! (-103)"
    )
    assert reply(shelly, 2, error={"code": 404, "message": "No handler"}) == Heard()
    assert reply(shelly, 1, error={"message": 7 * ["\n"], "code": "x"}).refusal is not None


@pytest.mark.parametrize(
    ("changed", "heard"),
    [
        ({"apower": 2300.0}, Heard(metered=True, partial=True, power_kw=2.3)),
        ({"aenergy": {"total": 1500}}, Heard(metered=True, partial=True, energy_kwh=1.5)),
        ({"output": True, "source": "button"}, Heard(on=True, partial=True)),
        ({"output": True, "source": "timer"}, Heard(on=True, partial=True, by_timer=True)),
        ({"output": False, "errors": ["overpower"]}, Heard(on=False, partial=True, errors=("overpower",))),
        ({"apower": -1, "aenergy": {"total": 1e13}}, Heard(metered=True, partial=True, nonsense=2)),
        ({"apower": True, "output": "yes"}, Heard(metered=True, partial=True, nonsense=1)),
        ({"temperature": {"tC": 50}}, Heard(partial=True)),
        ([], Heard()),
    ],
)
def test_a_notification_names_what_has_changed(shelly: Shelly2, changed: Any, heard: Heard) -> None:
    assert notified(shelly, **{"ts": 1.0, "switch:0": changed}) == heard


def test_what_is_not_of_its_relay_or_kept_is_nothing(shelly: Shelly2) -> None:
    stranger: Any = {"switch:1": {"output": True}}
    assert notified(shelly, **stranger) == Heard()
    ours: Any = {"switch:0": {"output": True}}
    assert notified(shelly, retain=True, **ours) == Heard()
    assert notified(shelly, sys={"uptime": 5}) == Heard(uptime_s=5.0)


@pytest.mark.parametrize(("payload", "online"), [(b"true", True), (b"false", False), (b"maybe", None), (b"\xff", None)])
def test_whether_it_is_there(shelly: Shelly2, payload: bytes, online: bool | None) -> None:
    assert shelly.hear(Message("shelly-a1/online", payload, True)) == Heard(online=online)
