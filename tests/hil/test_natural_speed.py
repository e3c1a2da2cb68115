"""The daemon, a real broker and the stubs, each a process of its own, on the clock on the wall."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import requests

from plugd.adapters.clock import utc_now
from plugd.units import slot_start
from plugd_hil.broker import Mosquitto, free_port
from tests.programs import Listener, Program, under_way

pytestmark = pytest.mark.requires("mosquitto", "data")

BASE = "plugd/ev"
DEAD_MAN_S = 30


@dataclass(slots=True)
class House:
    """A broker, the stub server with the forecasts of 14 March 2023, a plug with a car, and whoever listens.

    A session is under way, whatever time it is.
    """

    broker: Mosquitto
    plug: Program
    listener: Listener
    config: Path
    left: ExitStack

    def start(self) -> Program:
        """A daemon; it ends with the test."""
        return self.left.enter_context(Program("plugd", "-c", str(self.config), "run"))

    def daemon(self) -> Program:
        """One that is online."""
        before = self.listener.count()
        started = self.start()
        self.listener.until(f"{BASE}/availability", lambda said: said == "online", after=before)
        return started

    def command(self, name: str, payload: str) -> int:
        """Command, and wait for a good answer. Returns how much had been heard before."""
        before = self.listener.count()
        self.listener.send(f"{BASE}/{name}/set", payload)
        answer = self.listener.until(f"{BASE}/result", lambda a: a["command"] == name, after=before)
        assert answer["ok"], answer
        return before

    def state(self, wanted: Callable[[Any], bool] = lambda _: True, after: int = 0) -> Any:
        """The state, once it is as wanted."""
        return self.listener.until(f"{BASE}/state", wanted, after=after)

    def relay(self) -> list[str]:
        """What the plug's relay has done so far: an order to the stub and its echo are the fence."""
        seen = len(self.plug.said.all)
        self.plug.tell("soc 80")
        self.plug.said.until(lambda line: line["event"] == "soc", after=seen)
        return [line["event"] for line in self.plug.said.all if line.get("event") in ("on", "off")]

    def settled(self, soc: int, mode: str, decision: str) -> None:
        """Told how full the car is and what is wanted, it is on or off, and has said so."""
        self.command("mode", mode)
        before = self.command("soc", str(soc))
        wanted = {"mode": mode, "decision": decision, "soc_pct": float(soc)}
        self.state(lambda state: wanted.items() <= state.items(), after=before)


@pytest.fixture
def house(mosquitto: Mosquitto, neso_data: Path, tmp_path: Path) -> Iterator[House]:
    with ExitStack() as left:
        recorded = str(neso_data / "neso_fw48h")
        neso = left.enter_context(Program("plugd_hil.neso", "--replay", recorded, "--as-of", "now"))
        at = f"{mosquitto.host}:{mosquitto.port}"
        # The ledger on stdout: it is heard when it is written.
        plug = left.enter_context(
            Program("plugd_hil.plug", "--dialect", "tasmota", "--broker", at, "--topic", "ev-plug", "--car",
                    "connected", "--ledger", "/dev/stdout", "--stdin")
        )  # fmt: skip
        listener = Listener(mosquitto.host, mosquitto.port, [f"{BASE}/#"])
        left.callback(listener.close)
        config = tmp_path / "plugd.toml"
        dead_man, zone = f"dead_man_s = {DEAD_MAN_S}", '[home]\ntimezone = "UTC"'
        config.write_text(under_way(mosquitto, neso, tmp_path, dead_man, zone))
        plug.said.until(lambda line: line.get("ready"))
        yield House(mosquitto, plug, listener, config, left)


def test_ten_seconds_after_the_start_there_is_a_plan_and_the_relay_is_as_the_state_says(house: House) -> None:
    house.start()
    plan = house.listener.until(f"{BASE}/plan", within_s=10.0)
    state = house.listener.until(f"{BASE}/state", within_s=10.0)
    assert plan
    assert all(slot.keys() == {"start", "end", "power_kw", "intensity_g_per_kwh"} for slot in plan)
    ends = [datetime.fromisoformat(slot["end"]) for slot in plan]
    assert ends == sorted(ends)
    assert ends[0] > utc_now()
    house.plug.said.until(lambda line: line.get("event") == "on")  # nobody said how full the car is: charge
    state = house.state(lambda state: state["decision"] == "on")
    assert state["forecast_age_min"] == 0
    assert state["faults"] == []
    late = Listener(house.broker.host, house.broker.port, [f"{BASE}/+"])
    house.left.callback(late.close)
    for topic in ("availability", "plan", "state"):
        late.until(f"{BASE}/{topic}")
    assert all(retained for _, _, retained in late.heard.all[:3])


@pytest.mark.parametrize(("soc", "mode", "decision"), [(90, "smart", "off"), (60, "now", "on")])
def test_a_killed_daemon_comes_back_to_the_same_plan_and_leaves_the_relay_alone(
    house: House, soc: int, mode: str, decision: str
) -> None:
    first = house.daemon()
    house.settled(soc, mode, decision)
    for _ in range(2):  # a second time where a new half hour, with a new plan, began meanwhile
        began = slot_start(utc_now())
        plans = [m[1] for m in house.listener.heard.all if m[0] == f"{BASE}/plan"]
        moves = house.relay()
        killed = house.listener.count()
        first.kill()
        house.listener.until(f"{BASE}/availability", lambda said: said == "offline", after=killed)
        first = house.daemon()
        state = house.state(after=killed)
        plan = house.listener.until(f"{BASE}/plan", after=killed)
        if slot_start(utc_now()) == began:
            break
    assert [m[1] for m in house.listener.heard.all if m[0] == f"{BASE}/plan"] == [*plans, plans[-1]]
    assert plan
    assert state["decision"] == decision
    assert state["mode"] == mode
    assert state["intensity_g_per_kwh"] is not None
    assert "unknown" not in state["reason"]
    assert house.relay() == moves
    assert moves[-1] == decision


def test_killed_for_good_the_plug_comes_on_by_itself(house: House) -> None:
    first = house.daemon()
    house.settled(90, "smart", "off")
    seen = len(house.plug.said.all)
    first.kill()
    killed = utc_now()
    house.plug.said.until(lambda line: line.get("event") == "on", DEAD_MAN_S + 5.0, after=seen)
    assert utc_now() - killed > timedelta(seconds=0.5 * DEAD_MAN_S)
    assert house.relay()[-1] == "on"


def test_without_a_broker_the_plug_comes_on_by_itself_and_goes_off_when_plugd_is_back(house: House) -> None:
    daemon = house.daemon()
    house.settled(90, "smart", "off")
    assert house.relay()[-1] == "off"
    heard, seen = house.listener.count(), len(house.plug.said.all)
    house.broker.stop()
    stopped = utc_now()
    house.plug.said.until(lambda line: line.get("event") == "on", DEAD_MAN_S + 5.0, after=seen)
    assert utc_now() - stopped > timedelta(seconds=0.5 * DEAD_MAN_S)
    house.broker.start()
    seen = len(house.plug.said.all)
    house.plug.said.until(lambda line: line.get("event") == "off", 45.0, after=seen)
    house.listener.until(f"{BASE}/availability", lambda said: said == "online", after=heard)
    state = house.state(lambda state: state["decision"] == "off", after=heard)
    assert state["mode"] == "smart"
    assert house.relay()[-1] == "off"
    assert daemon.process.poll() is None


def test_a_command_reaches_the_relay_within_two_seconds(house: House) -> None:
    house.daemon()
    house.settled(60, "off", "off")
    seen = len(house.plug.said.all)
    house.listener.send(f"{BASE}/mode/set", "now")
    house.plug.said.until(lambda line: line.get("event") == "on", 2.0, after=seen)
    assert house.state(lambda state: state["mode"] == "now")["decision"] == "on"
    seen = len(house.plug.said.all)
    house.listener.send(f"{BASE}/mode/set", "off")
    house.plug.said.until(lambda line: line.get("event") == "off", 2.0, after=seen)


def test_a_second_daemon_on_the_same_folder_is_refused_and_the_first_told_to_end_ends(house: House) -> None:
    first = house.daemon()
    house.settled(90, "smart", "off")
    before = house.listener.count()
    second = house.start()
    assert second.ends() == 75
    assert len(second.complained.all) == 1
    assert f"(process {first.process.pid})" in second.complained.all[0]
    moves = house.relay()
    assert not [m for m in house.listener.heard.all[before:] if m[0] == f"{BASE}/availability"]
    first.process.terminate()
    assert first.ends(within_s=5.0) == 0
    assert not any("Traceback" in str(line) for line in first.complained.all)
    house.listener.until(f"{BASE}/availability", lambda said: said == "offline", after=before)
    assert house.relay() == moves


def test_a_word_on_the_page_reaches_the_relay_within_two_seconds_and_the_page_ends_with_the_daemon(
    house: House, tmp_path: Path
) -> None:
    token = tmp_path / "token"
    token.write_text("an old oak\n")
    token.chmod(0o600)
    port = free_port()
    text = house.config.read_text().replace("enabled = false", f'bind = "127.0.0.1:{port}"\ntoken_file = "{token}"')
    house.config.write_text(text)
    daemon = house.daemon()
    house.settled(60, "off", "off")
    page, seen = f"http://127.0.0.1:{port}", len(house.plug.said.all)
    headers = {"Origin": page, "X-Plugd-Token": "an old oak"}
    with requests.Session() as browser:
        browser.trust_env = False
        told = browser.post(f"{page}/command/mode", data="now", headers=headers, timeout=10.0)
        assert told.json() == {"command": "mode", "ok": True, "message": "mode is now"}
        house.plug.said.until(lambda line: line.get("event") == "on", 2.0, after=seen)
        assert browser.get(f"{page}/api/state", timeout=10.0).json()["mode"] == "now"
        assert "Charging now because you asked" in browser.get(page, timeout=10.0).text
        daemon.process.terminate()
        assert daemon.ends(within_s=5.0) == 0
    assert not any("Traceback" in str(line) for line in daemon.complained.all)
