"""The Tasmota plug: what it says, who moved it, and what is sent to it."""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd.adapters.clock import SystemClock
from plugd.adapters.mqtt import Broker, Mailbox, MqttConnection, Retained
from plugd.adapters.plug_memory import PlugMemory
from plugd.adapters.tasmota import Tasmota
from plugd.adapters.tasmota_words import Heard, hear, pulse_for
from plugd.domain import Reading, Relay
from plugd.errors import PlugFault, PlugTimeout
from plugd_hil.broker import Mosquitto
from tests.contract.rigs import StubPlug
from tests.fakes import MIDNIGHT
from tests.programs import PATIENCE_S

SOON_S = PATIENCE_S


# -- words ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("payload", "heard"),
    [
        (b"ON", Heard(on=True)),
        (b"OFF", Heard(on=False)),
        (b'{"POWER":"ON"}', Heard(on=True)),
        (b'{"POWER1":"OFF"}', Heard(on=False)),
        (b'{"PowerOnState":5}', Heard(power_on_state=5)),
        (b'{"PulseTime1":{"Set":3700,"Remaining":12}}', Heard(pulse=3700)),
        (b'{"PulseTime":{"Set":[160,0,0],"Remaining":[0,0,0]}}', Heard(pulse=160)),
        (b'{"PulseTime1":"160 (Active 60)"}', Heard(pulse=160)),
        (b'{"PulseTime1":160}', Heard(pulse=160)),
        (b'{"Uptime":"1T01:01:01","POWER":"ON"}', Heard(on=True, uptime_s=90061.0)),
        (b'{"StatusSTS":{"UptimeSec":12,"Uptime":"9T00:00:00"}}', Heard(uptime_s=12.0)),
        (
            b'{"Time":"x","ENERGY":{"Total":12.5,"Power":2300}}',
            Heard(metered=True, power_kw=2.3, energy_kwh=12.5),
        ),
        (
            b'{"StatusSNS":{"ENERGY":{"Total":1,"Power":0}}}',
            Heard(metered=True, power_kw=0.0, energy_kwh=1.0),
        ),
        (
            b'{"ENERGY":{"Total":12.5,"Power":2300,"Current":10.027}}',
            Heard(metered=True, power_kw=2.3, energy_kwh=12.5, current_a=10.027),
        ),
        (b'{"ENERGY":{"Current":-1}}', Heard(metered=True, nonsense=1)),
        (b'{"StatusSNS":{"Time":"x"}}', Heard(metered=True)),
        (b'{"ENERGY":{"Total":"1","Power":-5}}', Heard(metered=True, nonsense=2)),
        (b'{"ENERGY":{"Total":1e9,"Power":1e6}}', Heard(metered=True, nonsense=2)),
        (b'{"ENERGY":{"Total":true,"Power":[1,2]}}', Heard(metered=True, nonsense=2)),
        (b'{"ENERGY":{"Power":1e999}}', Heard(metered=True, nonsense=1)),
        (b'{"ENERGY":{"Power":NaN}}', Heard()),
        (b'{"POWER":"ON","POWER":"OFF"}', Heard()),
        (b'{"ENERGY":{"Power":' + b"9" * 5000 + b"}}", Heard()),
        (b"[" * 4000, Heard()),
        (b'{"Command":"Unknown"}', Heard()),
        (b'{"StatusSNS":3,"ENERGY":4}', Heard()),
        (b"\xff\xfe", Heard()),
        (b"", Heard()),
    ],
)
def test_what_is_understood(payload: bytes, heard: Heard) -> None:
    assert hear(payload) == heard


@given(st.binary(max_size=200))
def test_no_bytes_break_it(payload: bytes) -> None:
    assert isinstance(hear(payload), Heard)


KEYS = st.sampled_from(("POWER", "ENERGY", "Power", "Total", "StatusSNS", "StatusSTS", "Uptime", "UptimeSec",
                        "PulseTime1", "PulseTime", "PowerOnState", "Set"))  # fmt: skip
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9)
JSON = st.recursive(LEAVES, lambda v: st.lists(v, max_size=3) | st.dictionaries(KEYS, v, max_size=4), max_leaves=12)


@given(st.dictionaries(KEYS, JSON, max_size=6))
def test_no_document_breaks_it_or_gets_a_wild_number_through(document: dict[str, Any]) -> None:
    heard = hear(json.dumps(document).encode())
    assert heard.power_kw is None or 0.0 <= heard.power_kw <= 100.0
    assert heard.energy_kwh is None or 0.0 <= heard.energy_kwh <= 1e7
    assert heard.uptime_s is None or heard.uptime_s >= 0.0


@pytest.mark.parametrize(
    ("seconds", "pulse"), [(0.1, 1), (0.5, 5), (11.0, 110), (11.5, 112), (12, 112), (60, 160), (64800, 64900)]
)
def test_how_a_plug_counts_seconds(seconds: float, pulse: int) -> None:
    assert pulse_for(seconds) == pulse


@pytest.mark.parametrize("seconds", [0.0, -1.0, 64801.0, float("nan")])
def test_what_a_plug_cannot_count(seconds: float) -> None:
    with pytest.raises(ValueError, match="cannot count"):
        pulse_for(seconds)


# -- memory ---------------------------------------------------------------------------------------


def told(plug: PlugMemory, at_s: float, **words: Any) -> None:
    """The plug says something, this many seconds after midnight."""
    plug.absorb(Heard(answer=True, **words), now=MIDNIGHT + timedelta(seconds=at_s), now_s=at_s)


@pytest.mark.parametrize(
    ("after_s", "moved"), [(60.0, True), (3590.0, True), (3596.0, None), (3600.0, None), (9000.0, None)]
)
def test_on_after_the_dead_mans_time_is_the_timer(after_s: float, moved: bool | None) -> None:
    plug = PlugMemory(dead_man_s=3600.0)
    plug.order(on=False, now_s=10.0)
    told(plug, 10.1, on=False)
    told(plug, 10.0 + after_s, on=True)
    assert plug.moved is moved


def test_a_persons_off_has_no_timer_to_blame() -> None:
    plug = PlugMemory(dead_man_s=3600.0, held=True)
    plug.order(on=False, now_s=10.0)
    told(plug, 10.1, on=False)
    told(plug, 9000.0, on=True)
    assert plug.moved is True


def test_an_order_obeyed_late_is_ours() -> None:
    plug = PlugMemory(dead_man_s=3600.0)
    told(plug, 0.0, on=False)
    plug.order(on=True, now_s=5.0)
    told(plug, 45.0, on=True)
    assert plug.moved is None
    told(plug, 46.0, on=False)
    assert plug.moved is False, "one order moves it once"


@pytest.mark.parametrize(
    ("uptime_s", "moved"), [(500.0, False), (3.0, None), (None, None)], ids=["wifi", "mains", "unknown"]
)
def test_its_uptime_tells_a_power_cut_from_a_press(uptime_s: float | None, moved: bool | None) -> None:
    plug = PlugMemory(dead_man_s=3600.0)
    told(plug, 100.0, on=True, uptime_s=400.0, metered=True)
    assert plug.fresh(100.0)
    plug.back()
    assert not plug.fresh(100.0)
    told(plug, 200.0, on=False)
    told(plug, 200.0, uptime_s=uptime_s, metered=True)
    reading = plug.reading(200.0)
    assert reading is not None
    assert (reading.on, reading.came_back, reading.changed_by_other) == (False, True, moved)
    again = plug.reading(200.0)
    assert again is not None
    assert (again.came_back, again.changed_by_other) == (False, None)


def test_power_of_before_the_switch_is_not_power_of_now() -> None:
    plug = PlugMemory(dead_man_s=3600.0)
    told(plug, 0.0, on=True, metered=True, power_kw=2.3, energy_kwh=5.0)
    plug.order(on=False, now_s=1.0)
    told(plug, 1.0, on=False)
    reading = plug.reading(1.0)
    assert reading is not None
    assert (reading.power_kw, reading.energy_kwh) == (None, 5.0)
    assert plug.reading(62.0) is None, "too old to be a reading"


# -- over a broker --------------------------------------------------------------------------------


@dataclass(slots=True)
class Bench:
    """The adapter, the stub plug, and a second client that listens to everything."""

    plug: Tasmota
    clock: SystemClock
    ours: MqttConnection
    other: MqttConnection
    heard: Mailbox
    stub: StubPlug
    mosquitto: Mosquitto

    def commands(self) -> list[tuple[str, str]]:
        """What was sent to the plug since the last look, without queries of its state."""
        self.ours.flush()
        self.other.flush()
        sent = [(m.topic.rsplit("/", 1)[-1], m.payload.decode()) for m in self.heard.take()]
        return [(command, text) for command, text in sent if command != "Status" and text]

    def until(self, so: Callable[[], bool]) -> bool:
        """Wait on our connection until something is so, and no longer than a few seconds."""
        end = self.clock.now() + timedelta(seconds=SOON_S)
        while self.clock.now() < end:
            if so():
                return True
            self.clock.wait(min(end, self.clock.now() + timedelta(seconds=0.5)), self.ours)
        return False

    def readings_until(self, so: Callable[[Reading], bool]) -> list[Reading]:
        """Read until a reading is so; silence meanwhile is only that. Fails the test where none is."""
        seen: list[Reading] = []

        def look() -> bool:
            try:
                seen.append(self.plug.read())
            except PlugTimeout:
                return False
            return so(seen[-1])

        assert self.until(look), f"never so in {seen}"
        return seen

    def warned(self) -> bool:
        """Whether the plug warns of anything, after listening."""
        self.plug.read()
        return bool(self.plug.warnings)


def bench_with(mosquitto: Mosquitto, dead_man_s: float, *options: str) -> Iterator[Bench]:
    """Everything started, and ended again."""
    with ExitStack() as left:
        stub = StubPlug(mosquitto, *options)
        left.callback(stub.close)
        clock = SystemClock()
        left.callback(clock.close)
        broker = Broker(mosquitto.host, mosquitto.port)
        ours, other = (MqttConnection(broker, name, retry_s=(0.2, 0.5)) for name in ("ours", "other"))
        plug = Tasmota(ours, clock, "ev-plug", 2.3, dead_man_s)
        heard = other.subscribe(("cmnd/ev-plug/+", Retained.FLAGGED))
        for connection in (other, ours):
            connection.start()
            left.callback(connection.close)
            assert connection.wait_connected(SOON_S)
        yield Bench(plug, clock, ours, other, heard, stub, mosquitto)


@pytest.fixture
def bench(mosquitto: Mosquitto) -> Iterator[Bench]:
    """An hour of dead-man."""
    yield from bench_with(mosquitto, 3600.0)


@pytest.fixture
def hasty(mosquitto: Mosquitto) -> Iterator[Bench]:
    """A second of dead-man."""
    yield from bench_with(mosquitto, 1.0)


def test_the_timer_is_set_once_and_off_is_repeated(bench: Bench) -> None:
    bench.plug.set(Relay(on=False))
    assert bench.commands() == [("Backlog", "PowerOnState 5; PulseTime1 3700"), ("POWER", "OFF")]
    bench.plug.set(Relay(on=True))
    bench.plug.set(Relay(on=False))
    assert bench.commands() == [("POWER", "ON"), ("POWER", "OFF")]
    now = bench.clock.now()
    due = bench.plug.due()
    assert due is not None
    assert (due - now).total_seconds() == pytest.approx(600.0, abs=1.0)
    bench.plug.tend(now)
    assert bench.commands() == []


def test_a_second_plugd_finds_the_timer_set(bench: Bench) -> None:
    bench.plug.set(Relay(on=False))
    bench.commands()
    again = Tasmota(bench.ours, bench.clock, "ev-plug", 2.3, 3600.0)
    again.set(Relay(on=False))
    assert bench.commands() == [("POWER", "OFF")]


def test_no_command_is_retained(bench: Bench) -> None:
    bench.plug.read()
    bench.plug.set(Relay(on=False))
    bench.plug.set(Relay(on=False, held=True))
    bench.plug.set(Relay(on=True))
    bench.other.flush()
    assert not any(m.retain for m in bench.heard.take())


def test_a_persons_off_disarms_in_one_message_and_on_arms_again(bench: Bench) -> None:
    bench.plug.set(Relay(on=False, held=True))
    assert bench.commands() == [("Backlog", "PulseTime1 0; POWER OFF")]
    bench.plug.set(Relay(on=True))
    bench.commands()

    def armed() -> bool:
        bench.plug.tend(bench.clock.now())
        return ("Backlog", "PowerOnState 5; PulseTime1 3700") in bench.commands()

    assert bench.until(armed)


def test_after_a_power_cut_the_timer_is_looked_at_again(bench: Bench) -> None:
    bench.plug.set(Relay(on=False))
    bench.plug.read()
    bench.commands()
    bench.stub.tell("cut 0")
    bench.readings_until(lambda reading: reading.came_back)
    bench.plug.tend(bench.clock.now())
    bench.ours.flush()
    bench.other.flush()
    assert {m.topic for m in bench.heard.take()} >= {"cmnd/ev-plug/PowerOnState", "cmnd/ev-plug/PulseTime1"}


def test_a_lost_broker_is_survived(hasty: Bench) -> None:
    """Off; the broker goes; the plug comes on by itself; both are back; it is seen, and is nobody's press."""
    hasty.plug.set(Relay(on=False))
    assert not hasty.plug.read().on
    hasty.mosquitto.stop()
    assert hasty.until(lambda: not hasty.ours.connected)
    with pytest.raises(PlugTimeout, match="no broker"):
        hasty.plug.set(Relay(on=False))
    assert hasty.plug.due() is None
    hasty.clock.wait(hasty.clock.now() + timedelta(seconds=1.1))
    hasty.mosquitto.start()
    seen = hasty.readings_until(lambda reading: reading.on)
    assert any(reading.came_back for reading in seen)
    assert all(reading.changed_by_other is None for reading in seen)
    hasty.plug.set(Relay(on=False))
    assert not hasty.plug.read().on


def test_a_press_while_the_broker_was_away_is_a_press(bench: Bench) -> None:
    bench.plug.set(Relay(on=False))
    bench.plug.read()
    bench.mosquitto.stop()
    bench.stub.tell("press")
    bench.mosquitto.start()
    seen = bench.readings_until(lambda reading: reading.on)
    assert seen[-1].changed_by_other is True
    assert seen[-1].came_back


def test_what_moved_while_a_twin_had_our_place_is_nobodys_press(bench: Bench) -> None:
    """Else its off would count as a person's, without a timer, until the next plug-in."""
    for on in (False, True):
        bench.plug.set(Relay(on))
        assert bench.plug.read().on is on
    bench.mosquitto.stop()
    assert bench.until(lambda: not bench.ours.connected)
    bench.ours.twin.ended(0.5, told=True)
    bench.stub.tell("press")
    bench.mosquitto.start()
    seen = bench.readings_until(lambda reading: not reading.on)
    assert seen[-1].came_back
    assert all(reading.changed_by_other is None for reading in seen)
    bench.stub.tell("press")
    assert bench.readings_until(lambda reading: reading.on)[-1].changed_by_other is True, "seen as it happened"


def test_a_retained_command_of_somebody_else_is_told(bench: Bench) -> None:
    assert not bench.plug.warnings
    bench.other.publish("cmnd/ev-plug/POWER", b"ON", retain=True)
    assert bench.until(bench.warned)
    assert bench.plug.warnings[0].code == "plug_retained_command"
    bench.other.publish("cmnd/ev-plug/POWER", b"", retain=True)
    assert bench.until(lambda: not bench.warned())


def test_nonsense_on_the_meter_is_not_believed(bench: Bench) -> None:
    assert bench.plug.read().power_kw == 0.0
    bench.other.publish("tele/ev-plug/SENSOR", b'{"ENERGY":{"Power":-4,"Total":"lots"}}')
    reading = bench.readings_until(lambda reading: bench.plug.nonsense == 2)[-1]
    assert (reading.power_kw, reading.energy_kwh) == (None, 0.0)


def test_a_kept_message_is_no_news(bench: Bench) -> None:
    bench.other.publish("stat/ev-plug/POWER", b"ON", retain=True)
    bench.other.flush()
    again = MqttConnection(Broker(bench.mosquitto.host, bench.mosquitto.port), "again")
    plug = Tasmota(again, bench.clock, "ev-plug")
    again.start()
    assert again.wait_connected(SOON_S)
    assert not plug.read().on
    again.close()


def test_a_plug_that_is_not_there_is_told_as_such(bench: Bench) -> None:
    plug = Tasmota(bench.ours, bench.clock, "nowhere")
    with pytest.raises(PlugTimeout, match=r"nowhere has not answered yet.*nobody listens"):
        plug.read()
    start = bench.clock.monotonic()
    with pytest.raises(PlugTimeout):
        plug.read()
    assert bench.clock.monotonic() - start < 2.0, "a plug known to be silent is not waited for as long"


def test_no_off_where_the_timer_cannot_be_set(bench: Bench) -> None:
    """A plug that answers, but not to PowerOnState: staying on is the lesser evil."""
    topic = "stubborn"
    stubborn = bench.other.subscribe(f"cmnd/{topic}/+")

    class Answering(SystemClock):
        """Waits as ever, and lets the stubborn plug answer first."""

        def wait(self, until: Any, woken_by: Any = None) -> None:
            bench.ours.flush()
            bench.other.flush()
            for message in stubborn.take():
                tail = message.topic.rsplit("/", 1)[-1]
                words = {"PowerOnState": b'{"PowerOnState":3}', "PulseTime1": b'{"PulseTime1":{"Set":0}}'}
                for name in (tail,) if tail in words else tuple(words):
                    bench.other.publish(f"stat/{topic}/RESULT", words[name])
            bench.other.flush()
            super().wait(until, woken_by)

    clock = Answering()
    plug = Tasmota(bench.ours, clock, topic)
    with pytest.raises(PlugFault, match="not switched off"):
        plug.set(Relay(on=False))
    clock.close()


def test_the_last_renewal_is_sent_once_even_where_it_comes_a_microsecond_early() -> None:
    """Moments are told in whole microseconds: what is due then is due a trifle before its seconds say."""
    plug = PlugMemory(dead_man_s=600.0, on=False)
    plug.on_by_s = 1800.00000073
    off = Relay(on=False)
    due_s = plug.on_by_s - 600.0
    plug.order(on=False, now_s=due_s - 50.0)
    plug.off_s = plug.off_sent_s
    assert plug.last_renewal_s(off) == due_s
    plug.order(on=False, now_s=due_s - 7e-7)
    assert plug.last_renewal_s(off) == math.inf
