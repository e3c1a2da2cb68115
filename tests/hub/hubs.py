"""What the tries of real hubs share: a house on loopback, Home Assistant as a process, and waiting for others."""

import json
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import requests
from websockets.sync.client import connect

from plugd_hil.broker import HOST, Mosquitto, find_mosquitto, free_port
from tests.programs import Listener, Program, under_way

BASE = "plugd/ev"

CONFIGURATION = """
homeassistant: {{name: Home, time_zone: Europe/London, unit_system: metric, country: GB}}
http: {{server_host: 127.0.0.1, server_port: {port}}}
api:
websocket_api:
config:
onboarding:
history:
input_button:
logger: {{default: warning}}
lovelace:
  dashboards:
    plugd-car: {{mode: yaml, filename: dashboard.yaml, title: plugd, show_in_sidebar: true}}
"""


Found = TypeVar("Found")


def say(text: str) -> None:
    """One line of progress."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def end_in_order() -> None:
    """SIGTERM ends the program as Ctrl-C does: with all that it started."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


class Failed(Exception):
    """The hub, or plugd, did not do what it should."""


def until(look: Callable[[], Found], what: str, within_s: float = 30.0) -> Found:
    """What `look` finds, tried again until it is true. Raises Failed."""
    end = time.monotonic() + within_s
    while True:
        found = look()
        if found:
            return found
        if time.monotonic() > end:
            raise Failed(f"not in {within_s:g} s: {what}; at last {found!r}")
        threading.Event().wait(0.2)


@dataclass(slots=True)
class House:
    """A broker, a stub plug with a car, a stub forecast server, plugd, and somebody who listens."""

    folder: Path
    left: ExitStack
    broker: Mosquitto = field(init=False)
    plug: Program = field(init=False)
    plugd: Program = field(init=False)
    ears: Listener = field(init=False)

    def open(self) -> None:
        """Start everything. A session is under way, whatever time it is."""
        program = find_mosquitto("/usr/bin")
        if program is None:
            raise Failed("mosquitto is needed; sudo apt install mosquitto")
        self.broker = Mosquitto(program, self.folder)
        self.broker.start()
        self.left.callback(self.broker.stop)
        neso = self.left.enter_context(Program("plugd_hil.neso"))
        at = f"{self.broker.host}:{self.broker.port}"
        self.plug = self.left.enter_context(
            Program("plugd_hil.plug", "--broker", at, "--topic", "ev-plug", "--ledger", "/dev/stdout", "--stdin")
        )
        self.plug.said.until(lambda line: line.get("ready"))
        self.ears = Listener(self.broker.host, self.broker.port, [f"{BASE}/#", "homeassistant/#"])
        self.left.callback(self.ears.close)
        text = under_way(self.broker, neso, self.folder, more='[car]\nsoc_topic = "car/soc"')
        (self.folder / "plugd.toml").write_text(text)
        self.begin_plugd()

    def begin_plugd(self) -> None:
        """Start the daemon, and wait until it is online."""
        heard = self.ears.count()
        arguments = ("plugd", "-c", str(self.folder / "plugd.toml"), "run")
        self.plugd = self.left.enter_context(Program(*arguments))
        self.ears.until(f"{BASE}/availability", lambda said: said == "online", after=heard)

    def kill_plugd(self) -> None:
        """Without a word."""
        self.plugd.process.kill()
        self.plugd.ends()

    def state(self, wanted: Callable[[Any], bool], after: int, within_s: float = 10.0) -> Any:
        """The state once it is as wanted, of what was heard from number `after` on."""
        return self.ears.until(f"{BASE}/state", wanted, within_s, after)

    def moved(self, on: bool, after: int, within_s: float = 2.0) -> None:
        """That the plug's relay has gone on (or off) in this time."""
        event = "on" if on else "off"
        self.plug.said.until(lambda line: line.get("event") == event, within_s, after)


@dataclass(slots=True)
class HomeAssistant:
    """A real one, headless, that knows a broker and nothing else."""

    command: str
    folder: Path
    broker_port: int
    port: int = field(default_factory=free_port)
    process: subprocess.Popen[bytes] | None = None
    token: str = ""

    def seed(self, dashboard: Path) -> None:
        """Its configuration, with the broker entered as a person would."""
        storage = self.folder / ".storage"
        storage.mkdir(parents=True)
        (self.folder / "configuration.yaml").write_text(CONFIGURATION.format(port=self.port))
        (self.folder / "dashboard.yaml").write_text(dashboard.read_text())
        moment = "2026-01-01T00:00:00+00:00"
        entry = {
            "created_at": moment, "modified_at": moment, "domain": "mqtt", "entry_id": "plugdhubtest",
            "title": HOST, "data": {"broker": HOST, "port": self.broker_port, "protocol": "5"}, "options": {},
            "version": 1, "minor_version": 2, "source": "user", "unique_id": None, "disabled_by": None,
            "discovery_keys": {}, "subentries": [], "pref_disable_new_entities": False,
            "pref_disable_polling": False,
        }  # fmt: skip
        document = {"version": 1, "minor_version": 5, "key": "core.config_entries", "data": {"entries": [entry]}}
        (storage / "core.config_entries").write_text(json.dumps(document))

    @property
    def url(self) -> str:
        """Where it answers."""
        return f"http://{HOST}:{self.port}"

    def start(self) -> None:
        """Begin, and wait until its API answers. What it writes goes to `hass.log`."""
        with (self.folder / "hass.log").open("ab") as log:
            command = [*shlex.split(self.command), "-c", str(self.folder)]
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        until(self._answers, f"Home Assistant answers; see {self.folder}/hass.log", 240.0)

    def _answers(self) -> bool:
        if self.process is not None and self.process.poll() is not None:
            raise Failed(f"Home Assistant ended; see {self.folder}/hass.log")
        with suppress(requests.ConnectionError):
            return requests.get(f"{self.url}/manifest.json", timeout=5).status_code in (200, 404)
        return False

    def stop(self) -> None:
        """End it as systemd does."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            self.process.wait(60)

    def log_in(self) -> None:
        """The first user, and a token."""
        client = f"{self.url}/"
        user = {"client_id": client, "name": "Try", "username": "try", "password": "try", "language": "en"}
        said = requests.post(f"{self.url}/api/onboarding/users", json=user, timeout=30)
        said.raise_for_status()
        code = {"client_id": client, "grant_type": "authorization_code", "code": said.json()["auth_code"]}
        said = requests.post(f"{self.url}/auth/token", data=code, timeout=30)
        said.raise_for_status()
        self.token = said.json()["access_token"]

    def states(self) -> dict[str, Any]:
        """Every entity's state and attributes, by its id; nothing while it starts."""
        with suppress(requests.ConnectionError):
            said = requests.get(f"{self.url}/api/states", headers=self._bearer(), timeout=10)
            if said.ok:
                return {one["entity_id"]: one for one in said.json()}
        return {}

    def call(self, service: str, **what: object) -> None:
        """A service call, as a person's click makes it."""
        path = service.replace(".", "/")
        said = requests.post(f"{self.url}/api/services/{path}", headers=self._bearer(), json=what, timeout=30)
        if not said.ok:
            raise Failed(f"{service} {what}: {said.status_code} {said.text[:200]}")

    def render(self, template: str) -> str:
        """A template, as a card shows it."""
        said = requests.post(
            f"{self.url}/api/template", headers=self._bearer(), json={"template": template}, timeout=30
        )
        said.raise_for_status()
        return said.text

    def ask(self, **what: object) -> Any:
        """A question over its web socket."""
        with connect(f"ws://{HOST}:{self.port}/api/websocket", max_size=None) as socket:
            socket.recv()
            socket.send(json.dumps({"type": "auth", "access_token": self.token}))
            socket.recv()
            socket.send(json.dumps({"id": 1, **what}))
            answer = json.loads(socket.recv())
        if not answer.get("success"):
            raise Failed(f"{what}: {answer}")
        return answer["result"]

    def complaints(self) -> list[str]:
        """Lines of its log that warn of us or of MQTT."""
        lines = (self.folder / "hass.log").read_text(errors="replace").splitlines()
        loud = [line for line in lines if "WARNING" in line or "ERROR" in line]
        return [line for line in loud if "plugd" in line.lower() or "mqtt" in line.lower()]

    def _bearer(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.token}"}
