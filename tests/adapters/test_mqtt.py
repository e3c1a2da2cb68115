"""The MQTT connection against a real broker."""

import logging
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest
from paho.mqtt.enums import MQTTProtocolVersion

from plugd.adapters.hub import MqttHub, Topics
from plugd.adapters.mailbox import MAX_MESSAGES, MAX_PAYLOAD_BYTES
from plugd.adapters.mqtt import Broker, MqttConnection, Retained
from plugd.adapters.mqtt_client import V5, V311
from plugd.adapters.twin import AT_PEACE_S, MOST_SOON, Twin
from plugd.adapters.twin import SOON_S as ENDS_SOON_S
from plugd_hil.broker import HOST, Amqtt, BrokerProcess, Mosquitto, find_mosquitto, free_port
from tests.programs import PATIENCE_S
from tests.unit.deciding import HOME

Connect = Callable[..., MqttConnection]
SOON_S = PATIENCE_S


@pytest.fixture
def clients() -> Iterator[Callable[[MqttConnection], MqttConnection]]:
    """Starts connections, and ends them with the test."""
    with ExitStack() as left:

        def start(connection: MqttConnection) -> MqttConnection:
            left.callback(connection.close)
            connection.start()
            return connection

        yield start


@pytest.fixture
def connect(mosquitto: Mosquitto, clients: Callable[[MqttConnection], MqttConnection]) -> Connect:
    """A connection to the test's broker, made."""

    def made(name: str, will: tuple[str, bytes] | None = None) -> MqttConnection:
        broker = Broker(mosquitto.host, mosquitto.port)
        connection = clients(MqttConnection(broker, name, will, retry_s=(0.2, 1.0)))
        assert connection.wait_connected(SOON_S)
        return connection

    return made


def until(connection: MqttConnection, so: Callable[[], bool]) -> bool:
    """Wait on the connection until something is so."""
    return connection.bell.hold(so, SOON_S)


def ended(connection: MqttConnection, number: int) -> bool:
    """Whether it has been connected more often than that, and is no more."""
    return connection.session > number and not connection.connected


def broker_with(tmp_path: Path, lines: str) -> BrokerProcess:
    """A mosquitto of another kind."""
    program = find_mosquitto("")
    if program is None:
        pytest.skip("needs mosquitto")
    port = free_port()
    config = tmp_path / "strict.conf"
    config.write_text(f"listener {port} {HOST}\nset_tcp_nodelay true\npersistence false\nlog_dest stderr\n{lines}")
    return BrokerProcess([program, "-c", config], port)


def test_messages_come_in_order_and_a_flush_brings_them_all(connect: Connect) -> None:
    ours, other = connect("ours"), connect("other")
    mailbox = ours.subscribe("room/+")
    ours.flush()
    for i in range(100):
        other.publish(f"room/{i % 3}", b"%d" % i)
    other.flush()
    ours.flush()
    assert ours.pending()
    assert [int(m.payload) for m in mailbox.take()] == list(range(100))
    assert not ours.pending()
    assert mailbox.take() == ()


def test_a_message_takes_no_forty_milliseconds(connect: Connect) -> None:
    connection = connect("ours")
    assert connection._client is not None
    line = connection._client.socket()
    assert isinstance(line, socket.socket)
    assert line.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0


def test_nothing_is_queued_while_the_broker_is_away(connect: Connect, mosquitto: Mosquitto) -> None:
    ours, other = connect("ours"), connect("other")
    mailbox = other.subscribe("cmnd/#")
    mosquitto.stop()
    assert until(ours, lambda: not ours.connected and ours.refusal is not None)
    assert re.search("closed|refuses", str(ours.refusal))
    assert not ours.publish("cmnd/POWER", b"ON")
    assert not ours.publish("cmnd/POWER", b"ON", qos=1)
    ours.flush()
    mosquitto.start()
    assert ours.wait_connected(SOON_S)
    assert until(other, lambda: other.session == 2)
    assert ours.refusal is None
    assert ours.session == 2
    other.flush()  # its subscription is taken
    assert ours.publish("cmnd/now", b"here")
    ours.flush()
    other.flush()
    assert [m.topic for m in mailbox.take()] == ["cmnd/now"]


def test_what_becomes_of_retained_messages(connect: Connect) -> None:
    ours, other = connect("ours"), connect("other")
    for name in ("command", "telemetry", "will", "watched"):
        other.publish(f"{name}/1", b"old", retain=True)
    other.flush()
    mailbox = ours.subscribe(
        "command/+",
        ("telemetry/+", Retained.LIVE),
        ("will/+", Retained.REPLAYED),
        ("watched/+", Retained.WATCHED),
    )
    ours.flush()
    assert [(m.topic, m.retain) for m in mailbox.take()] == [("will/1", True), ("watched/1", True)]
    for name in ("command", "telemetry", "will", "watched"):
        other.publish(f"{name}/1", b"new", retain=True)
    ours.publish("watched/1", b"own")
    other.flush()
    ours.flush()
    assert [(m.topic, m.payload, m.retain) for m in mailbox.take()] == [
        ("command/1", b"new", True), ("telemetry/1", b"new", False),
        ("will/1", b"new", False), ("watched/1", b"new", True),
    ]  # fmt: skip


def test_a_mailbox_is_bounded(connect: Connect) -> None:
    ours, other = connect("ours"), connect("other")
    mailbox = ours.subscribe("room/+")
    ours.flush()
    for i in range(MAX_MESSAGES + 10):
        other.publish("room/1", b"%d" % i)
    other.flush()
    ours.flush()
    taken = mailbox.take()
    assert (len(taken), taken[-1].payload) == (MAX_MESSAGES, b"%d" % (MAX_MESSAGES + 9))
    assert mailbox.dropped == 10


def test_long_messages_are_dropped_and_the_connection_stays(connect: Connect) -> None:
    ours, other = connect("ours"), connect("other")
    mailbox = ours.subscribe("room/+")
    ours.flush()
    for size in (MAX_PAYLOAD_BYTES, MAX_PAYLOAD_BYTES + 1, 50_000):
        other.publish("room/1", b"x" * size)
    other.flush()
    ours.flush()
    assert [len(m.payload) for m in mailbox.take()] == [MAX_PAYLOAD_BYTES]
    assert mailbox.dropped == 1, "the longest is dropped by the broker"
    assert ours.session == 1


def test_a_mailbox_is_woken_by_its_own_messages_only(connect: Connect) -> None:
    ours, other = connect("ours"), connect("other")
    hub, plug = ours.subscribe("hub/+"), ours.subscribe("plug/+")
    ours.flush()
    other.publish("hub/1", b"x")
    other.flush()
    ours.flush()
    assert hub.pending()
    assert not plug.pending()
    ours.wait(60.0)  # the ring of the new connection
    start = time.perf_counter()
    plug.wait(0.2)
    assert time.perf_counter() - start >= 0.19
    ours.wait(60.0)
    assert time.perf_counter() - start < 10.0


def test_a_wake_ends_the_wait_it_meets_or_the_next(connect: Connect) -> None:
    connection = connect("ours")
    start = time.perf_counter()
    connection.wake()
    connection.wait(60.0)
    waiting = threading.Thread(target=connection.wait, args=(60.0,))
    waiting.start()
    connection.wake()
    waiting.join(10.0)
    assert not waiting.is_alive()
    assert time.perf_counter() - start < 10.0


def test_the_last_will_is_for_those_who_do_not_say_goodbye(connect: Connect) -> None:
    watcher = connect("watcher")
    mailbox = watcher.subscribe(("state/+", Retained.REPLAYED))
    connect("polite", ("state/polite", b"offline")).close()
    connect("twin", ("state/twin", b"offline"))
    connect("twin")  # takes the first one's place
    assert until(watcher, mailbox.pending)
    assert {m.topic for m in mailbox.take()} == {"state/twin"}


def test_being_pushed_out_by_a_twin_is_told(clients: Callable[[MqttConnection], MqttConnection]) -> None:
    with socket.create_server((HOST, 0)) as server:
        port = server.getsockname()[1]
        connection = clients(MqttConnection(Broker(HOST, port), "twin"))
        broker, _ = server.accept()
        with broker:
            broker.recv(1024)
            broker.sendall(bytes.fromhex("2003000000"))  # CONNACK: success
            assert connection.wait_connected(SOON_S)
            broker.sendall(bytes.fromhex("e0028e00"))  # DISCONNECT: session taken over
            assert until(connection, lambda: connection.twin.pushed_out == 1)
        assert until(connection, lambda: not connection.connected)
        assert "twin" in str(connection.refusal)
        connection.close()


@pytest.mark.parametrize("version", [V5, V311], ids=["5", "3.1.1"])
def test_who_is_pushed_out_stays_away_says_so_and_does_not_fight(
    mosquitto: Mosquitto, clients: Callable[[MqttConnection], MqttConnection], version: MQTTProtocolVersion
) -> None:
    """Two with one client id: nobody tells them, and one finds it out."""
    pair = [MqttConnection(Broker(mosquitto.host, mosquitto.port), "twin", retry_s=(0.05, 30.0)) for _ in range(2)]
    hubs = [MqttHub(connection, Topics(base="plugd/ev"), HOME) for connection in pair]
    for connection in pair:
        connection._version = version
        assert clients(connection).wait_connected(SOON_S)
    assert until(pair[0], lambda: any(one.twin.pushed_out for one in pair))
    (away,) = (k for k in range(2) if pair[k].twin.pushed_out)
    here = pair[1 - away]
    assert until(here, lambda: here.connected)
    sessions = [one.session for one in pair]
    assert not pair[away].bell.hold(lambda: pair[away].connected or not here.connected, 0.5), "nobody fights"
    assert [one.session for one in pair] == sessions
    assert sum(sessions) <= 2 * MOST_SOON + 1
    assert [fault.code for fault in hubs[away].warnings] == ["taken_over"]
    assert hubs[1 - away].warnings == ()
    assert not pair[away].publish("cmnd/plug/POWER", b"OFF"), "nothing is switched meanwhile"


def test_a_twin_is_told_from_a_broker_that_goes_and_comes() -> None:
    twin = Twin()
    for _ in range(5 * MOST_SOON):  # it restarts again and again, and is away in between
        assert not twin.ended(0.5, told=None)
        twin.not_made()
    assert [twin.ended(0.5, told=None) for _ in range(MOST_SOON)] == [False] * (MOST_SOON - 1) + [True]
    assert [twin.ended(ENDS_SOON_S, told=None), twin.pushed_out] == [False, 1], "one that lasts is not soon"
    twin.lasting(ENDS_SOON_S)
    assert twin.about, "it may come again"
    twin.lasting(AT_PEACE_S)
    assert (twin.pushed_out, twin.about) == (0, False)
    assert not twin.ended(0.5, told=None)
    assert twin.about
    twin.lasting(ENDS_SOON_S)
    assert not twin.about, "an accident"


@pytest.mark.parametrize("end", ["e0028700", "30ffffffffff"], ids=["not allowed", "nonsense"])
def test_an_end_whose_cause_is_known_is_no_twins_and_is_not_hurried_after(
    clients: Callable[[MqttConnection], MqttConnection], end: str
) -> None:
    """Its access list, or what it keeps for us, ends each connection as it begins: we ask again, ever later."""
    with socket.create_server((HOST, 0)) as server:
        connection = clients(MqttConnection(Broker(HOST, server.getsockname()[1]), "ours", retry_s=(0.05, 1.0)))
        for number in range(MOST_SOON + 1):
            began_s = time.perf_counter()
            broker, _ = server.accept()
            with broker:
                broker.recv(1024)
                broker.sendall(bytes.fromhex("2003000000" + end))
                assert until(connection, partial(ended, connection, number))
        assert connection.twin.pushed_out == 0
        assert "another program" not in str(connection.refusal)
        assert time.perf_counter() - began_s > 0.15
        connection.close()


def test_each_time_it_stays_away_for_longer() -> None:
    twin, away_s = Twin(), []
    for _ in range(9):
        assert twin.ended(60.0, told=True)
        away_s.append(twin.away_s(60.0))
    assert away_s == [60.0, 120.0, 240.0, 480.0, 960.0, 1800.0, 1800.0, 1800.0, 1800.0]


@pytest.mark.parametrize("answer", ["", "20020001"], ids=["hangs up", "refuses"])
def test_the_older_version_is_tried_where_the_newer_is_not_known(
    clients: Callable[[MqttConnection], MqttConnection], answer: str
) -> None:
    with socket.create_server((HOST, 0)) as server:
        port = server.getsockname()[1]
        connection = clients(MqttConnection(Broker(HOST, port), "ours", retry_s=(0.05, 0.1)))
        asked = []
        for reply in (answer, "20020000"):
            broker, _ = server.accept()
            asked.append(broker.recv(1024)[8])  # the version, after the name MQTT
            broker.sendall(bytes.fromhex(reply))
            if not connection.wait_connected(0.2):
                broker.close()
        assert connection.wait_connected(SOON_S)
        connection.close()
        broker.close()
    assert asked == [5, 4]


def test_a_refused_password_is_told_in_words_and_never_shown(
    tmp_path: Path, clients: Callable[[MqttConnection], MqttConnection], caplog: pytest.LogCaptureFixture
) -> None:
    broker = broker_with(tmp_path, "allow_anonymous false\n")
    broker.start()
    secret = tmp_path / "secret"
    secret.write_text("correct horse battery\n")
    caplog.set_level(logging.DEBUG)
    connection = clients(MqttConnection(Broker(broker.host, broker.port, "plugd", secret), "ours"))
    connection.bell.hold(lambda: connection.refusal is not None, 2.0)
    broker.stop()
    assert "password" in str(connection.refusal)
    assert not connection.connected
    seen = caplog.text + repr(connection.broker) + repr(connection) + str(connection.refusal)
    assert "refuses" in caplog.text
    assert "horse" not in seen


def test_a_missing_password_file_is_told(
    tmp_path: Path, mosquitto: Mosquitto, clients: Callable[[MqttConnection], MqttConnection]
) -> None:
    broker = Broker(mosquitto.host, mosquitto.port, "plugd", tmp_path / "none")
    connection = clients(MqttConnection(broker, "ours", retry_s=(0.1, 0.1)))
    connection.bell.hold(lambda: connection.refusal is not None, 1.0)
    assert str(tmp_path / "none") in str(connection.refusal)
    (tmp_path / "none").write_text("word")
    assert connection.wait_connected(SOON_S), "a secret that comes later is used"


def test_what_the_access_list_forbids_is_told(
    tmp_path: Path, clients: Callable[[MqttConnection], MqttConnection]
) -> None:
    (tmp_path / "acl").write_text("topic readwrite ours/#\ntopic readwrite plugd/#\n")
    broker = broker_with(tmp_path, f"allow_anonymous true\nacl_file {tmp_path / 'acl'}\nuser root\n")
    broker.start()
    connection = clients(MqttConnection(Broker(broker.host, broker.port), "ours"))
    assert connection.wait_connected(SOON_S)
    connection.publish("theirs/1", b"x", qos=1)
    connection.publish("ours/1", b"x", qos=1)
    connection.bell.hold(lambda: len(connection.objections) == 2, 2.0)
    broker.stop()
    assert "access list" in connection.objections["theirs/1"]
    assert "nobody listens" in connection.objections["ours/1"]


@pytest.mark.filterwarnings("ignore:unclosed <ssl:ResourceWarning")  # paho drops the socket of a failed handshake
def test_a_plain_port_is_never_taken_for_a_safe_one(
    mosquitto: Mosquitto, clients: Callable[[MqttConnection], MqttConnection]
) -> None:
    connection = clients(MqttConnection(Broker(mosquitto.host, mosquitto.port, tls=True), "ours"))
    assert until(connection, lambda: connection.refusal is not None)
    assert not connection.connected


def test_a_real_broker_of_the_older_version(
    clients: Callable[[MqttConnection], MqttConnection], request: pytest.FixtureRequest
) -> None:
    if find_spec("amqtt") is None:
        pytest.skip("needs amqtt")
    broker = Amqtt()
    broker.start()
    request.addfinalizer(broker.stop)
    connection = clients(MqttConnection(Broker(broker.host, broker.port), "ours", retry_s=(0.1, 0.5)))
    mailbox = connection.subscribe("room/+")
    assert connection.wait_connected(2 * SOON_S)
    connection.publish("room/1", b"x")
    connection.flush()
    assert [m.payload for m in mailbox.take()] == [b"x"]
    broker.stop()
    assert until(connection, lambda: not connection.connected)


def test_a_broker_that_is_not_there_yet(tmp_path: Path, clients: Callable[[MqttConnection], MqttConnection]) -> None:
    broker = broker_with(tmp_path, "allow_anonymous true\n")
    connection = clients(MqttConnection(Broker(broker.host, broker.port), "ours", retry_s=(0.1, 0.2)))
    assert not connection.wait_connected(0.5)
    assert "refuses the connection" in str(connection.refusal)
    broker.start()
    assert connection.wait_connected(SOON_S)
    connection.close()
    broker.stop()


def test_closing_before_anything_was_sent_is_quiet(mosquitto: Mosquitto) -> None:
    never = MqttConnection(Broker(mosquitto.host, mosquitto.port), "never")
    never.close()
    assert not never.connected
