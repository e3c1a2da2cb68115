"""The shipped access list, configuration and instructions for the broker, with a real mosquitto."""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import pytest
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.reasoncodes import ReasonCode

from plugd.adapters.mqtt import Broker, MqttConnection
from plugd_hil.broker import HOST, BrokerProcess, find_mosquitto, free_port

pytestmark = pytest.mark.requires("mosquitto")

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "etc" / "mosquitto"
SOON_S = 10.0
NOT_AUTHORISED = 0x87

USERS = ("plugd", "hub", "ev-plug", "guest")
MATRIX = {
    # topic: what plugd, the hub, the plug and a guest may: w(rite), r(ead)
    "plugd/ev/state": ("rw", "r", "-", "-"),
    "plugd/ev/result": ("rw", "r", "-", "-"),
    "plugd/ev/mode/set": ("rw", "rw", "-", "-"),
    "plugd/ev/availability": ("rw", "r", "-", "-"),
    "plugd/clock/plugd-ev": ("rw", "r", "-", "-"),
    "homeassistant/device/plugd_ev/config": ("w", "rw", "-", "-"),
    "homeassistant/status": ("r", "rw", "-", "-"),
    "homeassistant/light/other/config": ("-", "rw", "-", "-"),
    "cmnd/ev-plug/POWER": ("rw", "-", "r", "-"),
    "cmnd/ev-plug/Backlog0": ("rw", "-", "r", "-"),
    "cmnd/other-plug/POWER": ("-", "-", "-", "-"),
    "stat/ev-plug/RESULT": ("r", "r", "w", "-"),
    "stat/other-plug/RESULT": ("-", "-", "-", "-"),
    "tele/ev-plug/LWT": ("r", "r", "w", "-"),
    "car/soc": ("r", "w", "-", "-"),
    "$SYS/broker/version": ("-", "-", "-", "-"),
    "anything/else": ("-", "-", "-", "-"),
}
CELLS = [(user, topic, may) for topic, row in MATRIX.items() for user, may in zip(USERS, row, strict=True)]


class Somebody:
    """A client of the broker's, speaking MQTT 5."""

    def __init__(self, port: int, user: str | None, password: str | None = None) -> None:
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._answers: Queue[Any] = Queue()
        self.heard: Queue[tuple[str, bytes]] = Queue()
        if user is not None:
            self._client.username_pw_set(user, f"{user}'s" if password is None else password)
        self._client.on_connect = lambda _c, _u, _f, reason, _p: self._answers.put(reason)
        self._client.on_subscribe = lambda _c, _u, _m, reasons, _p: self._answers.put(reasons[0])
        self._client.on_publish = lambda _c, _u, _m, reason, _p: self._answers.put(reason)
        self._client.on_message = self._on_message
        self._client.connect(HOST, port)
        self._client.loop_start()
        self.welcome: ReasonCode = self._answers.get(timeout=SOON_S)

    def _on_message(self, _client: Client, _user: object, message: MQTTMessage) -> None:
        self.heard.put((message.topic, bytes(message.payload)))

    def say(self, topic: str, payload: bytes) -> ReasonCode:
        """Publish; the broker's answer."""
        self._client.publish(topic, payload, qos=1)
        answer: ReasonCode = self._answers.get(timeout=SOON_S)
        return answer

    def listen(self, topic: str) -> ReasonCode:
        """Subscribe; the broker's answer. Whatever it had for us before comes before."""
        self._client.subscribe(topic, 1)
        answer: ReasonCode = self._answers.get(timeout=SOON_S)
        return answer

    def hears(self, payload: bytes) -> bool:
        """Whether this was delivered by now."""
        self.listen("a/later/one")
        found = False
        while True:
            try:
                found = self.heard.get_nowait()[1] == payload or found
            except Empty:
                return found

    def close(self) -> None:
        """Leave."""
        self._client.disconnect()
        self._client.loop_stop()


class Shipped(BrokerProcess):
    """mosquitto with the shipped files, moved into a folder and to free ports; all-powerful `tester` is added."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.tls_port = free_port()
        port = free_port()
        (folder / "certs").mkdir()
        authority(folder / "certs")
        text = (SHIPPED / "plugd.conf").read_text().replace("/etc/mosquitto", str(folder))
        text = text.replace("listener 1883 127.0.0.1", f"listener {port} {HOST}")
        text = text.replace("listener 8883", f"listener {self.tls_port} {HOST}")
        root = "user root\n" if os.geteuid() == 0 else ""  # else it may not read this folder
        config = folder / "mosquitto.conf"
        config.write_text(f"{root}persistence false\nlog_dest stderr\n{text}")
        (folder / "plugd.acl").write_text((SHIPPED / "plugd.acl").read_text() + "\nuser tester\ntopic readwrite #\n")
        passwords = folder / "plugd.passwd"
        passwords.write_text("".join(f"{user}:{user}'s\n" for user in (*USERS, "tester")))
        passwords.chmod(0o600)
        subprocess.run(["mosquitto_passwd", "-U", passwords], check=True)
        self.ca_file = folder / "certs" / "plugd-ca.crt"
        super().__init__([program, "-c", config], port)


def blocks(text: str, language: str) -> list[str]:
    """The fenced blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def authority(folder: Path) -> None:
    """The certificates, by the commands of the instructions."""
    said = next(block for block in blocks((ROOT / "docs" / "broker.md").read_text(), "sh") if "req -x509" in block)
    names = {"BROKER": "localhost", "ADDRESS": HOST}
    subprocess.run(["bash", "-euc", said], cwd=folder, env=os.environ | names, check=True, capture_output=True)


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shipped]:
    """One for all the tests here."""
    program = find_mosquitto(os.environ.get("PATH", ""))
    if program is None or shutil.which("mosquitto_passwd") is None:
        pytest.skip("needs mosquitto")
    made = Shipped(program, tmp_path_factory.mktemp("broker"))
    made.start()
    yield made
    made.stop()


@pytest.fixture(scope="module")
def people(broker: Shipped) -> Iterator[dict[str, Somebody]]:
    """Every user, connected."""
    found = {user: Somebody(broker.port, user) for user in (*USERS, "tester")}
    yield found
    for somebody in found.values():
        somebody.close()


@pytest.mark.parametrize(("user", "topic", "may"), CELLS)
def test_what_a_user_may_say(people: dict[str, Somebody], user: str, topic: str, may: str) -> None:
    answer = people[user].say(topic, b"")
    if "w" in may:
        assert not answer.is_failure
    else:
        assert answer.value == NOT_AUTHORISED


@pytest.mark.parametrize(("user", "topic", "may"), [cell for cell in CELLS if not cell[1].startswith("$")])
def test_what_a_user_hears(people: dict[str, Somebody], user: str, topic: str, may: str) -> None:
    payload = f"{user} {topic}".encode()
    people[user].listen(topic)
    assert not people["tester"].say(topic, payload).is_failure
    assert people[user].hears(payload) == ("r" in may)


def test_who_asks_for_everything_hears_what_is_allowed(people: dict[str, Somebody]) -> None:
    for user, topic in (("hub", "plugd/ev/plan"), ("hub", "cmnd/ev-plug/Status"), ("guest", "plugd/ev/plan")):
        people[user].listen("#")
        people["tester"].say(topic, topic.encode())
        assert people[user].hears(topic.encode()) == (user == "hub" and topic.startswith("plugd"))


def test_what_mosquitto_tells_of_itself_is_nobodys_business(people: dict[str, Somebody]) -> None:
    for user in USERS:
        people[user].listen("$SYS/broker/version")  # retained, so it would come at once
        people[user].listen("a/later/one")
        assert all(not topic.startswith("$SYS") for topic, _ in tuple(people[user].heard.queue))


@pytest.mark.parametrize(("user", "password"), [(None, None), ("plugd", "hub's"), ("stranger", "plugd's")])
def test_nobody_comes_in_without_their_password(broker: Shipped, user: str | None, password: str | None) -> None:
    somebody = Somebody(broker.port, user, password)
    assert somebody.welcome.is_failure
    somebody.close()


@pytest.mark.filterwarnings("ignore:.*SSLSocket")  # paho leaves the one that was refused to the collector
@pytest.mark.parametrize("kind", ["right", "without TLS", "another authority"])
def test_plugd_itself_over_tls(broker: Shipped, kind: str, tmp_path: Path) -> None:
    secret = tmp_path / "password"
    secret.write_text("plugd's\n")
    ca_file = broker.ca_file
    if kind == "another authority":
        authority(tmp_path)
        ca_file = tmp_path / "plugd-ca.crt"
    where = Broker("localhost", broker.tls_port, "plugd", secret, tls=kind != "without TLS", ca_file=ca_file)
    connection = MqttConnection(where, "plugd-tls", ("plugd/ev/availability", b"offline"))
    connection.start()
    try:
        assert connection.wait_connected(SOON_S if kind == "right" else 1.0) == (kind == "right")
    finally:
        connection.close()


def test_the_shipped_list_names_what_the_shipped_configuration_does() -> None:
    """A topic that is renamed in one of them and not in the other would be a silent plug."""
    allowed = (SHIPPED / "plugd.acl").read_text()
    configuration = (ROOT / "etc" / "plugd.toml").read_text()
    assert 'topic = "plugd"' in configuration
    assert "topic readwrite plugd/#" in allowed
    assert 'topic = "ev-plug"' in configuration
    assert "topic readwrite cmnd/ev-plug/#" in allowed
    assert 'discovery_prefix = "homeassistant"' in configuration
    assert "topic write homeassistant/device/+/config" in allowed
