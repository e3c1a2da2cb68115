"""A paho client as plugd wants it: for one connection, MQTT 5 or 3.1.1, last will, secret, TLS, no delay."""

import socket
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from plugd.adapters.mailbox import Retained

KEEPALIVE_S = 30
MAX_PACKET_BYTES = 16 * 1024
"""What an MQTT 5 broker may send us at all."""
WRONG_VERSION, TAKEN_OVER, NOBODY_LISTENS = 0x84, 0x8E, 0x10
NO_REASON, NOT_UNDERSTOOD = (0x00, 0x80), 0x82
"""What a broker says as it closes, and means nothing; and what paho says where it closes on words that are no MQTT."""
SECRET = "see [broker] username and password_file"  # nosec B105 # where it is, not what
REFUSALS = {
    0x86: f"it does not accept this user name and password; {SECRET}",
    0x87: f"this user is not allowed, or the password is wrong; {SECRET}",
    0x85: "it does not accept our client id",
    0x88: "it is not available now",
}
TROUBLES: tuple[tuple[type[Exception], str], ...] = (
    (ConnectionRefusedError, "refuses the connection: nothing listens there"),
    (ConnectionResetError, "cuts the connection off"),
    (socket.gaierror, "is not to be found: no host has this name"),
    (ssl.SSLError, "does not speak TLS there; see broker.port and broker.tls"),
    (TimeoutError, "does not answer: is there a firewall, or another address?"),
)

V5, V311 = MQTTProtocolVersion.MQTTv5, MQTTProtocolVersion.MQTTv311


@dataclass(frozen=True, slots=True)
class Broker:
    """Where the broker is and who we are to it. The password is read at each connection and kept nowhere."""

    host: str = "localhost"
    port: int = 1883
    username: str | None = None
    password_file: Path | None = None
    tls: bool = False
    ca_file: Path | None = None

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def new_client(broker: Broker, name: str, version: MQTTProtocolVersion, will: tuple[str, bytes] | None) -> Client:
    """A client that connects once and is then thrown away. Raises OSError for a missing secret or CA file."""
    client = Client(
        CallbackAPIVersion.VERSION2,
        client_id=name,
        protocol=version,
        clean_session=True if version is V311 else None,
        reconnect_on_failure=False,
    )
    client.on_socket_open = _without_delay
    # With this set paho queues what other threads publish and wakes our loop; else it writes from theirs.
    client.on_socket_register_write = lambda _client, _userdata, _socket: None
    if will is not None:
        client.will_set(will[0], will[1], qos=1, retain=True)
    if broker.username is not None:
        secret = broker.password_file
        client.username_pw_set(broker.username, secret.read_text("utf-8").strip() if secret else None)
    if broker.tls:
        client.tls_set(ca_certs=str(broker.ca_file) if broker.ca_file else None)
    return client


def connect(client: Client, broker: Broker, version: MQTTProtocolVersion) -> None:
    """Open the connection, always with a clean session. Raises OSError."""
    if version is V311:
        client.connect(broker.host, broker.port, KEEPALIVE_S)
        return
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.MaximumPacketSize = MAX_PACKET_BYTES
    client.connect(broker.host, broker.port, KEEPALIVE_S, clean_start=True, properties=properties)


def subscribe(client: Client, version: MQTTProtocolVersion, filters: dict[str, Retained]) -> None:
    """Ask for messages; only MQTT 5 knows what is wanted of retained ones."""
    if version is V311:
        client.subscribe([(f, 1) for f in filters])
        return
    client.subscribe([(f, _options(retained)) for f, retained in filters.items()])


def refusal(reason: ReasonCode) -> str:
    """Why the broker does not let us in, in words."""
    return f"the broker refuses us: {REFUSALS.get(reason.value, str(reason))}"


def trouble(error: Exception, broker: Broker) -> str:
    """Why no connection can be made, in words for a person."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename} cannot be read; see broker.password_file and broker.ca_file"
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"{broker} has a certificate that is not trusted ({error.verify_message}); see broker.ca_file"
    for kind, words in TROUBLES:
        if isinstance(error, kind):
            return f"{broker} {words}"
    return f"{broker}: {error}"


def objection(reason: ReasonCode) -> str | None:
    """What is wrong with a topic we published to, in words; None where nothing is."""
    if reason.is_failure:
        return f"the broker does not let us publish there ({reason}); see its access list"
    return "nobody listens there" if reason.value == NOBODY_LISTENS else None


def _options(retained: Retained) -> SubscribeOptions:
    handling, as_published, no_local = retained.value
    return SubscribeOptions(qos=1, noLocal=no_local, retainAsPublished=as_published, retainHandling=handling)


def _without_delay(_client: Client, _userdata: Any, connection: Any) -> None:
    """Nagle's algorithm and delayed acknowledgements together cost 40 ms a message."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
