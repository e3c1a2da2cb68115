"""Everything that a scenario needs, running: broker, stubs, daemon, somebody who listens, and the passing of time."""

import json
import signal
import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from plugd import config as configuration
from plugd.adapters.house_mark import drawn
from plugd.adapters.mqtt import Broker, MqttConnection, Retained
from plugd.errors import PlugdError
from plugd_hil.broker import HOST, running_broker
from plugd_hil.children import Children
from plugd_hil.conductor import Conductor
from plugd_hil.scenario import CAN, Scenario
from plugd_hil.script import Event

BASE = "plugd/ev"
LOOK_S = 0.05
SETTLE_S = 0.2
"""Real time in which a program notices that its connection is there, or gone."""
PATIENCE_S = 70.0
"""plugd tries its broker again after a minute at the latest."""
HEARD = {
    "tasmota": "cmnd/ev-plug/+", "shelly2": "ev-plug/rpc", "openevse": "ev-plug/+/set", "mqtt": "ev-plug/set",
    "zigbee2mqtt": "ev-plug/set", "shelly1": "shellies/ev-plug/relay/0/command", "esphome": "ev-plug/switch/+/command",
}  # fmt: skip
"""What plugs are told, for those who listen."""
SWITCHES = ("POWER", "Backlog", "set", "command", "Switch.Set")
"""An order has one of these in its topic, or in what it says."""


class House:
    """One run of a scenario. On the simulated clock time jumps; with `natural` it passes."""

    def __init__(self, scenario: Scenario, folder: Path, state: Path, natural: bool, left: ExitStack) -> None:
        """Start everything; `left` ends it. Raises PlugdError, in its words, for a part that does not start."""
        self.scenario = scenario
        self.folder = folder
        self._state = state
        self.heard: list[tuple[datetime, str, str]] = []
        """(at, topic, payload)"""
        self.ledger = folder / "ledger.jsonl"
        self._broker = running_broker(folder, left)
        self._conductor = None if natural else Conductor(scenario.start, ("plug", "plugd"))
        if self._conductor is not None:
            left.callback(self._conductor.close)
        self._children = Children(folder)
        left.callback(self._children.close)
        if self._conductor is not None:
            left.callback(self._conductor.hang_up)
        self._clock = () if self._conductor is None else ("--clock", f"{HOST}:{self._conductor.port}")
        self._ear = MqttConnection(Broker(HOST, self._broker.port), "bench")
        self._mail = self._ear.subscribe(
            *((f"{BASE}/{tail}", Retained.REPLAYED) for tail in ("state", "availability")),
            *((topic, Retained.LIVE) for kind, topic in HEARD.items() if kind == scenario.written.plug),
        )
        self._ear.start()
        left.callback(self._ear.close)
        self._ear.wait_connected(PATIENCE_S)
        self._start()

    # -- what runs --------------------------------------------------------------------------------

    def _start(self) -> None:
        written, start = self.scenario.written, self.scenario.start
        script = self.folder / "script.json"  # JSON is YAML
        rows = [
            {"at": f"+{(e.at - start).total_seconds():.3f}", e.who: e.order}
            for e in (*self.scenario.events, *_stays(self.scenario))
        ]
        script.write_text(json.dumps({"faults": rows}), encoding="utf-8")
        natural = () if self._clock else ("--as-of", "2023-01-10T18:00:00+00:00")
        neso = self._children.start(
            "neso", "plugd_hil.neso", "--seed", str(written.seed), "--faults", str(script), *natural, *self._clock,
            says=True,
        )  # fmt: skip
        can = written.plug == CAN
        speaks = ("plugd_hil.can_elcon",) if can else (
            "plugd_hil.plug", "--dialect", written.plug, "--broker", f"{HOST}:{self._broker.port}",
            "--soc-topic", "car/soc",
        )  # fmt: skip
        plug = self._children.start(
            "plug", *speaks, "--power", str(written.power_kw), "--soc", str(written.soc_pct), "--tell", written.tell,
            "--car", "connected" if written.car == "connected" else "absent", "--seed", str(written.seed),
            "--ledger", str(self.ledger), "--faults", str(script), *written.plug_options, *self._clock, says=True,
        )  # fmt: skip
        tables = _tables(self.scenario, self._broker.port, neso["port"], plug, self._state)
        (self.folder / "plugd.toml").write_text(toml(tables), encoding="utf-8")
        drawn(self._state, "ev/ev-plug")
        configuration.load(self.folder / "plugd.toml")
        self._plugd()
        if self._conductor is not None:
            self._conductor.gather(look=self._look)

    def _plugd(self) -> None:
        config = str(self.folder / "plugd.toml")
        words = (
            ("plugd_hil.daemon", "-c", config, "--look", str(self.scenario.written.look_s), *self._clock)
            if self._clock
            else ("plugd", "-c", config, "run")
        )
        self._children.start("plugd", *words)

    def _look(self) -> None:
        self._children.look()

    # -- time -------------------------------------------------------------------------------------

    def live(self) -> None:
        """Let it all happen. Raises PlugdError where a part ends before its time, or hangs."""
        try:
            for event in self.scenario.events:
                self._until(event.at)
                if event.who in ORDERS:
                    ORDERS[event.who](self, event)
            self._until(self.scenario.end)
            self._end()
        except (ConnectionError, TimeoutError) as error:
            self._children.look(patience_s=1.0)
            raise PlugdError(str(error)) from error

    def _until(self, moment: datetime) -> None:
        if self._conductor is not None:
            self._before = self._conductor.now
            self._conductor.run_until(moment, self._jumped)
            self._listen(self._conductor.now)
            return
        while (now := datetime.now(UTC)) < moment:
            self._look()
            self._listen(now)
            time.sleep(min(LOOK_S, (moment - now).total_seconds()))

    def _jumped(self, now: datetime) -> None:
        """Time has jumped: what is under way was said before."""
        self._look()
        self._listen(self._before)
        self._before = now

    def _listen(self, now: datetime) -> None:
        self._ear.flush()
        for message in self._mail.take():
            self.heard.append((now, message.topic, message.payload.decode("utf-8", "replace")))

    def _end(self) -> None:
        """plugd first, so that its last word to the plug is in the ledger."""
        for name in ("plugd", "plug"):
            child = self._children.running.get(name)
            if child is None:
                continue
            child.terminate()
            if self._conductor is not None:
                self._conductor.dismiss(name, lambda name=name: self._children.ended(name))  # type: ignore[misc]
            child.wait(PATIENCE_S)
            self._listen(self.scenario.end)

    # -- orders to what is not a stub -------------------------------------------------------------

    def say(self, event: Event) -> None:
        """Anybody says something: TOPIC PAYLOAD, retained with -r before it."""
        retain = event.order.startswith("-r ")
        topic, _, payload = event.order.removeprefix("-r ").partition(" ")
        self._ear.publish(topic, payload.encode(), qos=1, retain=retain)
        self._ear.flush()

    def broker(self, event: Event) -> None:
        """stop · start · restart."""
        if event.order in ("stop", "restart"):
            self._broker.stop()
            time.sleep(SETTLE_S)
        if event.order in ("start", "restart"):
            self._broker.log.clear()
            self._broker.start()
            running = self._children.running
            names = [name for name, who in (("DVES_ev-plug", "plug"), ("plugd-ev", "plugd")) if who in running]
            if self._conductor is not None:  # on this clock nobody would be waited for
                self._wait(lambda: all(self._greeted(name) for name in names if self.scenario.written.plug != CAN))
            self._ear.wait_connected(PATIENCE_S)
            time.sleep(SETTLE_S)

    def _greeted(self, name: str) -> bool:
        return any("New client connected" in line and f" as {name} " in line for line in tuple(self._broker.log))

    def _wait(self, until: Callable[[], bool]) -> None:
        for _ in range(int(PATIENCE_S / LOOK_S)):
            if until():
                return
            time.sleep(LOOK_S)
        raise PlugdError(f"nobody came back to the broker: {''.join(self._broker.log)}")

    def daemon(self, event: Event) -> None:
        """kill · stop · start · restart (killed, and started at once) · damage · hang · resume (natural speed only)."""
        if event.order in ("hang", "resume"):
            word = signal.SIGSTOP if event.order == "hang" else signal.SIGCONT
            self._children.running["plugd"].send_signal(word)
        if event.order == "damage":  # of a plugd that is dead
            with (self._state / "plugd.db").open("r+b") as file:
                file.write(b"\0" * 4096)
        if event.order in ("kill", "stop", "restart"):
            self._gone(signal.SIGTERM if event.order == "stop" else signal.SIGKILL)
        if event.order in ("start", "restart"):
            self._plugd()
            if self._conductor is not None:
                self._conductor.join("plugd", self._look)

    def _gone(self, word: signal.Signals) -> None:
        child = self._children.running.pop("plugd")
        child.send_signal(word)
        if self._conductor is not None:
            if word is signal.SIGTERM:
                self._conductor.dismiss("plugd", lambda: child.poll() is not None)
            self._conductor.part("plugd")
        child.wait(PATIENCE_S)
        if child.stdout is not None:
            child.stdout.close()
        time.sleep(SETTLE_S)  # the broker tells plugd's last will


ORDERS: dict[str, Callable[[House, Event], None]] = {
    "say": House.say,
    "broker": House.broker,
    "plugd": House.daemon,
}


def _stays(scenario: Scenario) -> list[Event]:
    """The car comes at 18:00 and goes at 09:00, where nothing else is written."""
    if scenario.written.car != "comes":
        return []
    return [Event(at, "plug", order) for at, order in scenario.stays]


def _tables(
    scenario: Scenario, broker_port: int, neso_port: object, plug: dict[str, object], state: Path
) -> dict[str, dict[str, Any]]:
    """plugd's configuration."""
    written = scenario.written
    tables: dict[str, dict[str, Any]] = {
        "broker": {"host": HOST, "port": broker_port},
        "plug": {"kind": written.plug, "power_kw": written.power_kw},
        "nights": {"ready_by": "07:00"},
        "relay": {"random_delay_s": 0},
        "forecast": {"base_url": f"http://{HOST}:{neso_port}"},
        "state": {"dir": str(state)},
        "web": {"enabled": False},
    }
    if written.plug == CAN:
        tables["can"] = {
            "interface": "slcan", "channel": plug["channel"], "max_voltage_v": 405, "max_current_a": 12,
            "soc": "pylontech",
        }  # fmt: skip
    else:
        tables["plug"]["topic"] = "ev-plug"
        tables["car"] = {"soc_topic": "car/soc"}
    for name, table in written.config.items():
        tables[name] = {**tables.get(name, {}), **table}
    return tables


def toml(tables: dict[str, dict[str, Any]]) -> str:
    """Tables of plain values; TOML and JSON write those alike."""
    return "\n".join(
        f"[{name}]\n" + "\n".join(f"{key} = {json.dumps(value)}" for key, value in table.items())
        for name, table in tables.items()
    )


def natural_start() -> datetime:
    """A little ahead: programs take a moment to start."""
    return datetime.now(UTC) + timedelta(seconds=1)
