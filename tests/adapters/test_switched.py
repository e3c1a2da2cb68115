"""A relay by its words: renewed offs, refusals, protection, what is kept by the broker, plugs without a meter."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import pytest

from plugd.adapters.plain import PRESETS, Plain
from plugd.adapters.shelly2 import Shelly2
from plugd.adapters.switched import SwitchedPlug
from plugd.domain import Reading, Relay
from plugd.errors import PlugFault, PlugRefused, PlugTimeout
from plugd_hil.outlet import Said
from plugd_hil.plain import PlainPlug
from plugd_hil.shelly2 import Shelly2Plug
from plugd_hil.socket import Socket
from tests.wire import Wire, WireClock


@dataclass(slots=True)
class Bench:
    """Adapter and stub on a wire."""

    plug: SwitchedPlug
    clock: WireClock
    wire: Wire

    def live(self, seconds: float) -> None:
        """As the daemon would, a look every 10 s."""
        end = self.clock.now() + timedelta(seconds=seconds)
        while (now := self.clock.now()) < end:
            self.plug.tend(now)
            due = self.plug.due()
            look = now + timedelta(seconds=10)
            self.clock.wait(min(end, look, due or end) if due is None or due > now else min(end, look))

    def reading(self, so: Callable[[Reading], bool], within_s: float = 120.0) -> Reading:
        """The first that is so."""
        end = self.clock.now() + timedelta(seconds=within_s)
        while not so(reading := self.plug.read()) and self.clock.now() < end:
            self.clock.wait(self.clock.now() + timedelta(seconds=0.5))
        assert so(reading), reading
        return reading


def bench_of(kind: str, **options: Any) -> Bench:
    """The adapter as the daemon builds it."""
    if kind == "shelly2":
        wire = Wire(lambda car, now: Shelly2Plug("p", Socket(car, now, **options)))
        dialect: Shelly2 | Plain = Shelly2("p", "plugd/me")
    else:
        wire = Wire(lambda car, now: PlainPlug(kind, "p", Socket(car, now, **options)))
        dialect = Plain("p", PRESETS[kind])
    clock = WireClock(wire)
    return Bench(SwitchedPlug(wire, clock, "p", dialect, 2.3, 3600.0), clock, wire)


@pytest.fixture
def shelly() -> Bench:
    """With a dead-man of an hour."""
    return bench_of("shelly2")


def sets(bench: Bench) -> list[dict[str, Any]]:
    """The relay commands since the last look."""
    calls = [json.loads(payload) for topic, payload in bench.wire.sent if topic == "p/rpc"]
    bench.wire.sent.clear()
    return [call["params"] for call in calls if call["method"] == "Switch.Set"]


def test_an_off_is_renewed_six_times_an_hour_with_its_timer(shelly: Bench) -> None:
    shelly.plug.set(Relay(on=False))
    shelly.live(3601.0)
    assert sets(shelly) == 7 * [{"id": 0, "on": False, "toggle_after": 3600.0}]
    assert not shelly.plug.read().on
    shelly.clock.wait(shelly.clock.now() + timedelta(seconds=3600))
    reading = shelly.plug.read()
    assert (reading.on, reading.changed_by_other) == (True, None), "the timer is nobody's press"


def test_a_press_on_beside_a_running_timer_is_a_press(shelly: Bench) -> None:
    shelly.plug.set(Relay(on=False))
    shelly.plug.read()
    shelly.wire.say(shelly.wire.stub.press())
    assert shelly.plug.read().changed_by_other is True


def test_a_plug_that_does_not_keep_its_timer_is_told(shelly: Bench) -> None:
    shelly.plug.set(Relay(on=False))
    assert not shelly.plug.warnings
    status = {"id": 0, "output": False, "apower": 0.0, "aenergy": {"total": 0.0}}
    shelly.wire.sent.clear()
    shelly.wire.stub.muted = True
    shelly.clock.wait(shelly.clock.now() + timedelta(seconds=61))
    with pytest.raises(PlugTimeout):
        shelly.plug.read()
    asked = json.loads(shelly.wire.sent[-2][1])["id"]
    shelly.wire.say([Said("plugd/me/rpc", json.dumps({"id": asked, "src": "p", "dst": "plugd/me", "result": status}))])
    shelly.plug.read()
    assert [warning.code for warning in shelly.plug.warnings] == ["plug_dead_man"]


def test_an_error_reply_is_a_refusal_in_its_own_words(shelly: Bench) -> None:
    shelly.wire.stub.muted = True

    class Refusing(WireClock):
        """The plug answers every Set with an error while we wait."""

        def wait(self, until: Any, woken_by: Any = None) -> None:
            for topic, payload in tuple(shelly.wire.sent):
                call = json.loads(payload)
                if topic == "p/rpc" and call["method"] == "Switch.Set":
                    error = {"id": call["id"], "src": "p", "error": {"code": -114, "message": "Resource unavailable!"}}
                    shelly.wire.say([Said("plugd/me/rpc", json.dumps(error))])
            shelly.wire.sent.clear()
            super().wait(until, woken_by)

    plug = SwitchedPlug(shelly.wire, Refusing(shelly.wire), "p", Shelly2("p", "plugd/me"), 2.3, 3600.0)
    with pytest.raises(PlugRefused, match=r"Resource unavailable! \(-114\)"):
        plug.set(Relay(on=True))


def test_a_plug_that_protects_itself_is_left_off_and_is_no_press(shelly: Bench) -> None:
    shelly.plug.set(Relay(on=True))
    shelly.plug.read()
    stub = shelly.wire.stub
    assert isinstance(stub, Shelly2Plug)
    shelly.wire.say(stub.overpower())
    reading = shelly.plug.read()
    assert (reading.on, reading.changed_by_other) == (False, None)
    assert [warning.code for warning in shelly.plug.warnings] == ["plug_protects"]
    with pytest.raises(PlugFault, match=r"overpower.*left off for ten minutes"):
        shelly.plug.set(Relay(on=True))
    shelly.clock.wait(shelly.clock.now() + timedelta(minutes=10))
    shelly.plug.set(Relay(on=True))
    assert shelly.plug.read().on
    assert not shelly.plug.warnings


def test_a_first_shellys_meter_begins_anew_at_each_boot() -> None:
    bench = bench_of("shelly1", power_kw=2.3)
    bench.plug.set(Relay(on=True))
    before = bench.reading(lambda r: (r.energy_kwh or 0.0) > 0.03)
    bench.wire.say(bench.wire.stub.cut(timedelta(0)))
    bench.clock.wait(bench.clock.now() + timedelta(seconds=4))
    after = bench.plug.read()
    assert after.came_back
    assert after.energy_kwh is not None
    assert after.energy_kwh < (before.energy_kwh or 0.0)


def test_what_the_broker_keeps_counts_while_the_plug_is_online() -> None:
    bench = bench_of("esphome", on=True)
    seconds = bench.clock.monotonic()
    assert bench.plug.read().on
    assert bench.clock.monotonic() - seconds <= 35.0
    bench.wire.say([bench.wire.stub.will])
    with pytest.raises(PlugTimeout, match="offline"):
        bench.plug.read()


def test_what_the_broker_keeps_of_a_plug_that_is_gone_is_nothing() -> None:
    bench = bench_of("esphome", on=True)
    bench.wire.say([bench.wire.stub.will])
    bench.wire.stub.muted = True
    late = SwitchedPlug(bench.wire, bench.clock, "p", Plain("p", PRESETS["esphome"]), 2.3)
    with pytest.raises(PlugTimeout, match="has said nothing yet"):
        late.read()


def test_a_plug_that_turns_out_to_have_no_meter_is_told_and_not_waited_for_again() -> None:
    bench = bench_of("zigbee2mqtt")
    topic = "p"
    bench.wire.stub.muted = True
    bench.wire.say([Said(topic, '{"state":"ON","linkquality":9}')])
    assert bench.plug.read().metered_at is None
    seconds = bench.clock.monotonic()
    bench.wire.say([Said(topic, '{"state":"ON","linkquality":9}')])
    assert bench.plug.read().on
    assert bench.clock.monotonic() == seconds
    assert [warning.code for warning in bench.plug.warnings] == ["plug_meter"]
