"""The one MQTT connection: a network thread that only fills bounded mailboxes, and what is told about it.

Every attempt to connect is a client of its own, so that nothing is left over from an earlier connection to be
sent late: an order that was queued an hour ago must not switch a plug.
"""

import logging
import struct
import threading
import time
from itertools import count
from typing import Any

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage, topic_matches_sub
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.properties import MQTTException  # type: ignore[attr-defined] # the one place of it in 2.1 and 2.2
from paho.mqtt.reasoncodes import ReasonCode

from plugd.adapters.bell import Doorbell
from plugd.adapters.mailbox import Mailbox, Message, Retained
from plugd.adapters.mqtt_client import (
    NO_REASON,
    NOT_UNDERSTOOD,
    TAKEN_OVER,
    V5,
    V311,
    WRONG_VERSION,
    Broker,
    connect,
    new_client,
    objection,
    refusal,
    subscribe,
    trouble,
)
from plugd.adapters.twin import SOON_S, Twin

__all__ = ["Broker", "Mailbox", "Message", "MqttConnection", "Retained"]

FLUSH_S = 2.0
MOST_ACKS = 64
"""More than may be under way at once."""
ANSWER_S = 3.0
"""Some brokers say nothing at all to a version that they do not know."""

log = logging.getLogger(__name__)


class MqttConnection:
    """Keeps one connection to the broker, MQTT 5 or else 3.1.1. A `plugd.ports.Inbox` over all its mailboxes.

    Nothing here raises for a lost connection: `connected`, `session`, `refusal` and `twin` tell.
    """

    def __init__(
        self,
        broker: Broker,
        name: str,
        will: tuple[str, bytes] | None = None,
        retry_s: tuple[float, float] = (1.0, 60.0),
    ) -> None:
        """`name` is the client id, `will` a retained last word (topic, payload). `start` begins."""
        self.broker = broker
        self.name = name
        self.bell = Doorbell()
        self.connected = False
        self.session = 0
        """How many connections were made: who keeps state at the broker tells it again when this grows."""
        self.refusal: str | None = None
        """Why there is no connection, in words; None while there is one."""
        self.twin = Twin()
        """Another client with our client id, which pushes us out."""
        self.objections: dict[str, str] = {}
        """Topics that the broker refuses us or that nobody listens to, and why (MQTT 5, QoS 1)."""
        self._will = will
        self._retry_s = retry_s
        self._mailboxes: tuple[Mailbox, ...] = ()
        self._closing = threading.Event()
        self._version = V5
        self._client: Client | None = None
        self._answered = False
        self._told: bool | None = None
        """Whether the connection ended for another of our name; None: nobody said why."""
        self._made_s = 0.0
        self._sent: dict[int, str] = {}
        self._acks: dict[int, ReasonCode] = {}
        self._flush_topic = f"plugd/clock/{name}"
        self._flush_asked = False
        self._tokens = count(1)
        self._echo = 0
        self._thread = threading.Thread(target=self._run, name="mqtt", daemon=True)

    def start(self) -> None:
        """Begin to connect, and never stop trying."""
        self._thread.start()

    def close(self) -> None:
        """Say goodbye after what was published (the last will is not), and end the thread."""
        self._closing.set()
        if self._client is not None:
            self._client.disconnect()
        if self._thread.is_alive():
            self._thread.join(5.0)

    @property
    def alive(self) -> bool:
        """Whether its thread still runs: connected, or trying to be."""
        return self._thread.is_alive()

    def wait_connected(self, timeout_s: float) -> bool:
        """Whether there is a connection, within this time. For programs that start."""
        return self.bell.hold(lambda: self.connected, timeout_s)

    def subscribe(self, *filters: str | tuple[str, Retained]) -> Mailbox:
        """A mailbox for what these filters match, now and after reconnects; a bare one is Retained.FLAGGED.

        No two filters of one connection may overlap: brokers would send a message twice.
        """
        wishes = dict(f if isinstance(f, tuple) else (f, Retained.FLAGGED) for f in filters)
        mailbox = Mailbox(self, wishes)
        self._mailboxes = (*self._mailboxes, mailbox)
        if self.connected and self._client is not None:
            subscribe(self._client, self._version, wishes)
        return mailbox

    def publish(self, topic: str, payload: bytes, *, qos: int = 0, retain: bool = False) -> bool:
        """Send now; False (and nothing is kept for later) without a connection."""
        client = self._client
        if client is None or not self.connected:
            return False
        sent = client.publish(topic, payload, qos=qos, retain=retain)
        if sent.rc is not MQTTErrorCode.MQTT_ERR_SUCCESS:
            return False
        if qos:
            self._sent[sent.mid] = topic
            self._judge(sent.mid)
        return True

    def pending(self) -> bool:
        """Whether any mailbox holds something."""
        return any(mailbox.pending() for mailbox in self._mailboxes)

    def wait(self, timeout_s: float) -> None:
        """Until something is pending, somebody wakes us, the connection comes or goes, or time is over."""
        self.bell.wait_for(self.pending, timeout_s)

    def wake(self) -> None:
        """End a wait, this one or the next. Safe from any thread and from a signal handler."""
        self.bell.wake()

    def flush(self) -> None:
        """A message to ourselves: when it is back, the broker has ours, and we have all it held for us.

        True of all with QoS 0, and of the few with QoS 1 that may be under way at once (20 with mosquitto).
        Returns at once without a connection, and after 2 s at the latest.
        """
        client, session, token = self._client, self.session, next(self._tokens)
        if client is None or not self.connected:
            return
        if not self._flush_asked:
            self._flush_asked = True
            subscribe(client, self._version, {self._flush_topic: Retained.LIVE})
        if self.publish(self._flush_topic, b"%d" % token):
            self.bell.hold(lambda: self._echo >= token or self.session != session or not self.connected, FLUSH_S)

    # -- the network thread -----------------------------------------------------------------------

    def _run(self) -> None:
        shortest_s, longest_s = self._retry_s
        delay_s = shortest_s / 2.0
        while not self._closing.is_set():
            before, self._answered, self._told = self.session, False, None
            try:
                self._stay()
            except (OSError, ValueError, LookupError, struct.error, MQTTException) as error:
                self._trouble(trouble(error, self.broker))
                self._told = None if isinstance(error, OSError) else False  # what it sends cannot be read
            else:
                if not self._answered:
                    self._trouble(f"{self.broker} does not answer as an MQTT broker")
                    self._other_version()
                elif self.refusal is None:
                    self._trouble(f"{self.broker} has closed the connection")
            self._client = None
            self._lost()
            made = self.session > before
            lasted_s = time.monotonic() - self._made_s if made else 0.0
            # A restart of the broker is over soon; what it objects to at once, it will object to again.
            at_once = made and self._told is False and lasted_s < SOON_S
            delay_s = shortest_s if made and not at_once else min(2.0 * delay_s, longest_s)
            pushed = self._pushed_out(made, lasted_s)
            wait_s = 0.0 if self.twin.suspected else delay_s
            self._closing.wait(self.twin.away_s(longest_s) if pushed else wait_s)

    def _pushed_out(self, made: bool, lasted_s: float) -> bool:
        """Whether the connection that has just ended, if one was `made`, has ended for another of our name."""
        if not made:
            self.twin.not_made()
            return False
        if not self.twin.ended(lasted_s, self._told):
            return False
        self._trouble(f"another program is at {self.broker} as {self.name}, and pushes this one out; stop one of them")
        return True

    def _stay(self) -> None:
        """Connect, and serve the connection until it ends. Raises OSError where there is none to be had."""
        client = new_client(self.broker, self.name, self._version, self._will)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
        client.on_publish = self._on_publish
        connect(client, self.broker, self._version)
        self._client = client
        asked_s = time.monotonic()
        while client.loop(timeout=1.0) is MQTTErrorCode.MQTT_ERR_SUCCESS:
            if not self._answered and time.monotonic() - asked_s > ANSWER_S:
                return  # the client is dropped, and its socket with it
            if self.connected:
                self.twin.lasting(time.monotonic() - self._made_s)

    def _on_connect(
        self, client: Client, _userdata: Any, _flags: ConnectFlags, reason: ReasonCode, _properties: Any
    ) -> None:
        self._answered = True
        if reason.is_failure:
            if reason.value == WRONG_VERSION:
                self._other_version()
            self._trouble(refusal(reason))
            return
        self._sent, self._acks, self.objections = {}, {}, {}
        filters = {f: wish for mailbox in self._mailboxes for f, wish in mailbox.filters.items()}
        if self._flush_asked:
            filters[self._flush_topic] = Retained.LIVE
        if filters:
            subscribe(client, self._version, filters)
        self.refusal, self._made_s = None, time.monotonic()
        self.session += 1
        self.connected = True
        log.info("connected to the broker at %s", self.broker)
        self.bell.wake()

    def _on_disconnect(
        self, _client: Client, _userdata: Any, flags: DisconnectFlags, reason: ReasonCode, _properties: Any
    ) -> None:
        told = flags.is_disconnect_packet_from_server and reason.value not in NO_REASON
        if self.connected and (told or reason.value == NOT_UNDERSTOOD):
            self._told = reason.value == TAKEN_OVER
            self._trouble(f"the connection to {self.broker} has ended: {reason}")
        self._lost()

    def _on_message(self, _client: Client, _userdata: Any, message: MQTTMessage) -> None:
        try:
            topic = message.topic
        except UnicodeDecodeError:
            return
        if topic == self._flush_topic:
            self._echo = int(message.payload) if message.payload.isdigit() else self._echo
        for mailbox in self._mailboxes:
            if any(topic_matches_sub(f, topic) for f in mailbox.filters):
                mailbox.put(Message(topic, bytes(message.payload), message.retain))
        self.bell.look()

    def _on_publish(self, _client: Client, _userdata: Any, mid: int, reason: ReasonCode, _properties: Any) -> None:
        self._acks[mid] = reason
        while len(self._acks) > MOST_ACKS:  # those of QoS 0 are asked for by nobody
            del self._acks[next(iter(self._acks))]
        self._judge(mid)

    def _judge(self, mid: int) -> None:
        """What the broker said of a message: its answer may be here before `publish` knows its number."""
        if mid not in self._sent or mid not in self._acks:
            return
        topic, text = self._sent.pop(mid), objection(self._acks.pop(mid))
        if text is None:
            self.objections.pop(topic, None)
        else:
            self.objections[topic] = text
        self.bell.look()

    def _other_version(self) -> None:
        self._version = V311 if self._version is V5 else V5

    def _trouble(self, why: str) -> None:
        """Remembers why there is no connection; says it once, and again when it is for another reason."""
        if why != self.refusal and not self._closing.is_set():
            log.warning("no connection to the broker: %s", why)
        self.refusal = why
        self.bell.look()

    def _lost(self) -> None:
        """Idempotent: paho tells some ends twice."""
        if self.connected:
            self.connected = False
            self.bell.wake()
