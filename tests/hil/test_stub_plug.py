"""The stub plug does what the firmware does, and its ledger tells the truth."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from io import StringIO
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import pytest

from plugd.adapters.mqtt import Broker, MqttConnection
from plugd.adapters.tasmota_words import hear
from plugd.study.world import Battery, Driver
from plugd.units import HALF_HOUR
from plugd_hil.broker import Mosquitto
from plugd_hil.car import CarAtHome
from plugd_hil.conductor import Conductor
from plugd_hil.outlet import Said
from plugd_hil.scene import Scene
from plugd_hil.socket import Socket
from plugd_hil.tasmota import TasmotaPlug

ROOT = Path(__file__).resolve().parents[2]
ENV = {"PYTHONPATH": f"{ROOT}:{ROOT / 'hil'}", "OMP_NUM_THREADS": "1"}
SUMMER_NOON = datetime(2023, 7, 3, 11, 0, tzinfo=UTC)


@dataclass(slots=True)
class Bench:
    """A plug with a connected car, half full, and everything it says by the second it says it."""

    now: datetime = SUMMER_NOON
    power_delta: int = 10
    car: CarAtHome = field(init=False)
    plug: TasmotaPlug = field(init=False)

    def __post_init__(self) -> None:
        self.car = CarAtHome(Battery(), True, None, self.now)
        self.plug = TasmotaPlug("ev-plug", Socket(self.car, self.now), power_delta=self.power_delta)
        self.plug.connected()

    def tell(self, command: str, payload: str = "") -> list[Said]:
        """A command over MQTT."""
        return self.plug.handle(f"cmnd/ev-plug/{command}", payload.encode())

    def result(self, command: str, payload: str = "") -> dict[str, Any]:
        """The first answer to a command."""
        said: dict[str, Any] = json.loads(self.tell(command, payload)[0].payload)
        return said

    def after(self, seconds: float) -> list[tuple[float, str]]:
        """What it says by itself in this time: seconds from now, topic."""
        start, end, said = self.plug.board.now, self.plug.board.now + timedelta(seconds=seconds), []
        while (due := self.plug.board.due()) is not None and due <= end:
            said += [((due - start).total_seconds(), s.topic) for s in self.plug.board.advance(due)]
        self.plug.board.advance(end)
        return said


@pytest.fixture
def bench() -> Bench:
    """Up and connected; the telemetry of the start is over."""
    bench = Bench()
    bench.after(10.0)
    return bench


@pytest.mark.parametrize(
    ("payload", "on"),
    [("ON", True), ("1", True), ("on", True), ("TOGGLE", True), ("2", True), ("OFF", False), ("0", False),
     ("", False), ("?", False), ("nonsense", False)],
)  # fmt: skip
def test_power_is_answered_twice(bench: Bench, payload: str, on: bool) -> None:
    word = "ON" if on else "OFF"
    assert bench.tell("POWER", payload) == [
        Said("stat/ev-plug/RESULT", json.dumps({"POWER": word}, separators=(",", ":"))),
        Said("stat/ev-plug/POWER", word),
    ]
    assert bench.plug.board.on is on


def test_what_it_says_on_reaching_its_broker() -> None:
    plug = Bench().plug
    assert [s.topic for s in plug.connected()] == ["tele/ev-plug/LWT", "cmnd/ev-plug/POWER"], "it has not booted"
    assert plug.connected()[0] == Said("tele/ev-plug/LWT", "Online", retain=True)


def test_telemetry_every_five_minutes_and_nothing_else(bench: Bench) -> None:
    said = bench.after(1800.0)
    assert {topic for _, topic in said} == {"tele/ev-plug/STATE", "tele/ev-plug/SENSOR"}
    times = [at for at, topic in said if topic.endswith("STATE")]
    assert len(times) == 6
    assert all(b - a == pytest.approx(300.0) for a, b in pairwise(times))


def test_power_is_told_two_to_five_seconds_after_on_and_not_after_off(bench: Bench) -> None:
    bench.tell("POWER", "ON")
    said = bench.after(60.0)
    assert [topic for _, topic in said] == ["tele/ev-plug/MARGINS", "tele/ev-plug/SENSOR"]
    assert all(2.0 <= at <= 5.0 for at, _ in said)
    bench.tell("POWER", "OFF")
    assert bench.after(60.0) == []


def test_without_power_delta_only_telemetry_tells_power() -> None:
    bench = Bench(power_delta=0)
    bench.after(10.0)
    bench.tell("POWER", "ON")
    assert bench.after(60.0) == []


def test_a_car_that_fills_up_is_told(bench: Bench) -> None:
    bench.car.battery.energy_kwh = 0.96 * bench.car.battery.capacity_kwh
    bench.tell("POWER", "ON")
    bench.after(60.0)
    said = bench.after(5 * 3600.0)
    assert sum(topic.endswith("MARGINS") for _, topic in said) > 5
    assert bench.result("Status", "8")["StatusSNS"]["ENERGY"]["Power"] == 0


@pytest.mark.parametrize(
    ("power_on_state", "first", "then"),
    [(3, True, False), (5, True, True), (5, False, True), (3, False, False)],
)
def test_pulse_time_ends_on_or_with_state_five_off(bench: Bench, power_on_state: int, first: bool, then: bool) -> None:
    bench.tell("PowerOnState", str(power_on_state))
    bench.tell("PulseTime1", "160")
    bench.tell("POWER", "ON" if first else "OFF")
    bench.after(59.9)
    assert bench.plug.board.on is first
    bench.after(0.2)
    assert bench.plug.board.on is then


def test_every_off_restarts_the_timer(bench: Bench) -> None:
    bench.tell("Backlog", "PowerOnState 5; PulseTime1 160")
    bench.after(1.0)
    for _ in range(10):
        bench.tell("POWER", "OFF")
        bench.after(50.0)
        assert not bench.plug.board.on
        assert bench.result("PulseTime1")["PulseTime1"] == {"Set": 160, "Remaining": 100}
    bench.after(11.0)
    assert bench.plug.board.on


def test_a_query_does_not_restart_the_timer(bench: Bench) -> None:
    bench.tell("Backlog", "PowerOnState 5; PulseTime1 5")
    bench.after(1.0)
    bench.tell("POWER", "OFF")
    for _ in range(3):
        bench.tell("POWER", "")
        bench.after(0.15)
    assert not bench.plug.board.on
    bench.after(0.1)
    assert bench.plug.board.on


def test_a_backlog_takes_its_time(bench: Bench) -> None:
    said = bench.tell("Backlog", "PulseTime1 0; POWER ON; TelePeriod 60")
    assert [json.loads(s.payload) for s in said] == [{"PulseTime1": {"Set": 0, "Remaining": 0}}]
    assert [at for at, topic in bench.after(1.0) if topic.endswith("RESULT")] == pytest.approx([0.2, 0.4])
    assert len(bench.tell("Backlog0", "POWER OFF; POWER ON")) == 4


@pytest.mark.parametrize(
    ("state", "before", "after"),
    [(0, True, False), (1, False, True), (2, True, False), (3, True, True), (3, False, False), (4, False, True),
     (5, True, False)],
)  # fmt: skip
def test_after_a_power_cut(bench: Bench, state: int, before: bool, after: bool) -> None:
    bench.tell("POWER", "ON" if before else "OFF")
    bench.tell("PowerOnState", str(state))
    bench.plug.cut(timedelta(seconds=60))
    assert bench.tell("POWER", "ON") == [], "no mains, no answer"
    assert not bench.plug.board.on
    said = bench.after(62.9)
    assert said == [(45.0, "tele/ev-plug/LWT")], "the broker's own words"
    assert bench.plug.board.on is after
    back = [topic for _, topic in bench.after(1.0)]
    assert back[:2] == ["tele/ev-plug/LWT", "cmnd/ev-plug/POWER"]
    assert back[-2:] == ["stat/ev-plug/RESULT", "stat/ev-plug/POWER"]
    assert bench.result("Status", "11")["StatusSTS"]["UptimeSec"] == 3


def test_state_five_comes_on_after_a_power_cut_by_its_timer(bench: Bench) -> None:
    bench.tell("Backlog", "PowerOnState 5; PulseTime1 130; POWER ON")
    bench.after(1.0)
    bench.plug.cut(timedelta(seconds=2))
    bench.after(31.9)
    assert not bench.plug.board.on
    bench.after(0.2)
    assert bench.plug.board.on


def test_locked_and_always_on(bench: Bench) -> None:
    bench.tell("PowerLock", "1")
    assert bench.result("POWER", "ON") == {"POWER": "OFF"}
    bench.tell("PowerLock", "0")
    bench.tell("PowerOnState", "4")
    assert bench.result("POWER", "OFF") == {"POWER": "ON"}


def test_a_mute_plug_lives_on_in_silence(bench: Bench) -> None:
    bench.tell("Backlog", "PowerOnState 5; PulseTime1 130; POWER OFF")
    bench.after(1.0)
    bench.plug.muted = True
    assert bench.tell("POWER", "") == []
    assert bench.after(600.0) == []
    assert bench.plug.board.on


def test_plugd_understands_it(bench: Bench) -> None:
    bench.tell("POWER", "ON")
    bench.after(3600.0)
    for command, payload in (("Status", "8"), ("Status", "10"), ("Status", "11"), ("State", "")):
        (said,) = (hear(s.payload.encode()) for s in bench.tell(command, payload))
        assert said.nonsense == 0
        if command == "State" or payload == "11":
            assert (said.on, said.uptime_s) == (True, 86400 + 3610)
        else:
            assert said.power_kw == pytest.approx(2.3)
            assert said.energy_kwh == pytest.approx(2.3, abs=0.01)
    assert hear(bench.tell("PulseTime")[0].payload.encode()).pulse == 0
    assert bench.result("Nonsense") == {"Command": "Unknown"}


def test_its_time_is_local_and_without_offset(bench: Bench) -> None:
    assert bench.result("State")["Time"] == "2023-07-03T12:00:10"


def test_its_day_ends_at_local_midnight() -> None:
    bench = Bench(datetime(2023, 7, 3, 22, 0, tzinfo=UTC))
    bench.tell("POWER", "ON")
    for _ in range(3):
        bench.after(1800.0)
    energy = bench.result("Status", "8")["StatusSNS"]["ENERGY"]
    assert (energy["Yesterday"], energy["Today"]) == (pytest.approx(2.3, abs=0.01), pytest.approx(1.15, abs=0.01))


# -- the scene and its ledger ---------------------------------------------------------------------


def lines_of(text: str) -> list[dict[str, Any]]:
    """The ledger, with its times."""
    return [{**row, "at": datetime.fromisoformat(row["at"])} for row in map(json.loads, text.splitlines())]


def test_the_ledger_accounts_for_every_half_hour() -> None:
    start = datetime(2023, 1, 2, 12, tzinfo=UTC)
    driver = Driver(seed=3)
    battery = Battery(capacity_kwh=400.0)  # never full: what flows is what is offered
    car = CarAtHome(battery, False, driver.stays(start), start)
    plug = TasmotaPlug("ev-plug", Socket(car, start))
    ledger = StringIO()
    scene = Scene(plug, car, ledger, "car/soc")
    said = plug.connected()
    for step in range(1, 5 * 24 * 12):
        said += scene.advance(start + step * timedelta(minutes=5, seconds=1))
        if step % 50 == 0:
            said += scene.watch(plug.press())
    rows = lines_of(ledger.getvalue())
    slots = [row["at"] for row in rows if row["event"] == "slot"]
    assert slots[0] == start + HALF_HOUR
    assert all(b - a == HALF_HOUR for a, b in pairwise(slots))
    assert all(a["at"] <= b["at"] for a, b in pairwise(rows))
    for before, after in pairwise(rows):
        taken_kwh = after["energy_kwh"] - before["energy_kwh"]
        on_h = (after["at"] - before["at"]).total_seconds() / 3600.0 if before["on"] and before["connected"] else 0.0
        assert taken_kwh == pytest.approx(2.3 * on_h, abs=1e-9)
        if before["event"] != "leave":  # what is driven is gone in the line after
            assert (after["soc"] - before["soc"]) * 400.0 == pytest.approx(0.9 * taken_kwh, abs=1e-9)
    stays = list(islice(driver.stays(start), 4))
    assert [row["at"] for row in rows if row["event"] == "arrive"][:4] == [stay.arrival for stay in stays]
    assert [row["at"] for row in rows if row["event"] == "leave"][:4] == [stay.departure for stay in stays]
    told = [s for s in said if s.topic == "car/soc"]
    arrivals = [row["soc"] for row in rows if row["event"] == "arrive"]
    assert [(s.payload, s.qos, s.retain) for s in told] == [(f"{100 * soc:.1f}", 1, False) for soc in arrivals]


def test_a_stay_under_way_has_the_car_connected() -> None:
    night = datetime(2023, 1, 3, 2, tzinfo=UTC)
    car = CarAtHome(Battery(), False, Driver().stays(night), night)
    assert car.connected
    due = car.due()
    assert due is not None
    assert due > night


def test_orders_from_the_world() -> None:
    bench = Bench()
    ledger = StringIO()
    scene = Scene(bench.plug, bench.car, ledger)
    assert scene.told("press\n")[0].payload == '{"POWER":"ON"}'
    for line in ("car leave", "soc 40", "car arrive", "mute", "unmute", "cut 3"):
        scene.told(line)
    assert [row["event"] for row in lines_of(ledger.getvalue())] == ["start", "on", "leave", "soc", "arrive", "off"]
    assert bench.car.battery.soc == pytest.approx(0.4)
    with pytest.raises(ValueError, match="no order"):
        scene.told("explode")


# -- the program ----------------------------------------------------------------------------------


@pytest.fixture
def process(mosquitto: Mosquitto, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The stub plug at natural speed."""
    command = [sys.executable, "-m", "plugd_hil.plug", "--broker", f"{mosquitto.host}:{mosquitto.port}"]
    started = subprocess.Popen(
        [*command, "--ledger", tmp_path / "ledger.jsonl"], env=ENV, stdout=subprocess.PIPE, text=True
    )
    yield started
    started.kill()
    started.communicate()


def test_the_program_says_when_it_is_ready_and_ends_when_told(
    process: subprocess.Popen[str], mosquitto: Mosquitto, tmp_path: Path
) -> None:
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline())
    assert ready == {"ready": True, "topic": "ev-plug", "broker": f"{mosquitto.host}:{mosquitto.port}"}
    watcher = MqttConnection(Broker(mosquitto.host, mosquitto.port), "watcher")
    mailbox = watcher.subscribe("stat/ev-plug/+", "tele/ev-plug/+")
    watcher.start()
    assert watcher.wait_connected(5.0)
    watcher.publish("cmnd/ev-plug/POWER", b"ON")
    heard: list[tuple[str, bytes]] = []
    on = ("stat/ev-plug/POWER", b"ON")

    def switched() -> bool:  # what it says of itself on connecting may come first
        heard.extend((m.topic, m.payload) for m in mailbox.take())
        return on in heard

    assert watcher.bell.hold(switched, 5.0)
    process.send_signal(signal.SIGTERM)
    assert process.wait(10.0) == 0
    watcher.flush()
    heard.extend((m.topic, m.payload) for m in mailbox.take())
    assert heard[-3:] == [("stat/ev-plug/RESULT", b'{"POWER":"ON"}'), on, ("tele/ev-plug/LWT", b"Offline")]
    watcher.close()
    events = [row["event"] for row in lines_of((tmp_path / "ledger.jsonl").read_text())]
    assert events == ["start", "on"]


def test_the_program_lives_on_simulated_time(mosquitto: Mosquitto, tmp_path: Path) -> None:
    start = datetime(2023, 1, 2, 12, tzinfo=UTC)
    conductor = Conductor(start, ("plug",))
    texts: list[str] = []
    for name in ("one", "two"):
        if texts:
            conductor = Conductor(start, ("plug",))
        ledger = tmp_path / name
        process = subprocess.Popen(
            [sys.executable, "-m", "plugd_hil.plug", "--broker", f"{mosquitto.host}:{mosquitto.port}",
             "--clock", f"127.0.0.1:{conductor.port}", "--car", "driver", "--on", "--ledger", ledger,
             "--tell", "arrival", "--soc-topic", "car/soc"],
            env=ENV, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        conductor.gather()
        conductor.run_until(start + timedelta(days=2))
        process.terminate()
        conductor.dismiss("plug", lambda process=process: process.poll() is not None)  # type: ignore[misc]
        process.communicate(timeout=10.0)
        conductor.close()
        assert process.returncode == 0
        texts.append(ledger.read_text())
    assert texts[0] == texts[1], "the same every time"
    rows = lines_of(texts[0])
    assert [row["event"] for row in rows].count("slot") == 96
    assert rows[-1]["energy_kwh"] > 10.0
