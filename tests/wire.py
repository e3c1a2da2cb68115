"""An adapter and a stub plug in one process, without a broker: messages go from hand to hand, time only by waiting."""

from collections.abc import Callable
from datetime import datetime

from paho.mqtt.client import topic_matches_sub

from plugd.adapters.mqtt import Broker, Mailbox, Message, MqttConnection, Retained
from plugd.ports import Inbox
from plugd.study.world import Battery
from plugd_hil.car import CarAtHome
from plugd_hil.outlet import Said
from plugd_hil.socket import Plug
from tests.fakes import MIDNIGHT


class Wire(MqttConnection):
    """A connection whose other end is a stub; what it retains is kept as a broker does."""

    def __init__(self, make: Callable[[CarAtHome, datetime], Plug]) -> None:
        """The car is connected, half full."""
        super().__init__(Broker(), "wire")
        self.at = MIDNIGHT
        self.stub = make(CarAtHome(Battery(), True, None, MIDNIGHT), MIDNIGHT)
        self.sent: list[tuple[str, str]] = []
        self._kept: dict[str, bytes] = {}
        self.connected, self.session = True, 1
        self.say(self.stub.connected())

    def subscribe(self, *filters: str | tuple[str, Retained]) -> Mailbox:
        """What is kept comes at once, where it is asked for."""
        mailbox = super().subscribe(*filters)
        for topic, payload in self._kept.items():
            for wanted, how in mailbox.filters.items():
                if how is Retained.REPLAYED and topic_matches_sub(wanted, topic):
                    mailbox.put(Message(topic, payload, True))
        return mailbox

    def publish(self, topic: str, payload: bytes, *, qos: int = 0, retain: bool = False) -> bool:
        """Straight to the stub."""
        self.sent.append((topic, payload.decode()))
        self.stub.board.advance(self.at)
        if any(topic_matches_sub(wanted, topic) for wanted in self.stub.listens):
            self.say(self.stub.handle(topic, payload))
        return True

    def say(self, said: list[Said]) -> None:
        """Messages of the stub's, or anybody's."""
        for one in said:
            if one.retain:
                self._kept[one.topic] = one.payload.encode()
            for mailbox in self._mailboxes:
                if any(topic_matches_sub(wanted, one.topic) for wanted in mailbox.filters):
                    mailbox.put(Message(one.topic, one.payload.encode(), False))

    def flush(self) -> None:
        """Nothing is ever under way."""

    def pass_to(self, until: datetime) -> None:
        """Let the stub live up to a moment, whatever it says on the way."""
        self.at = max(self.at, until)
        self.say(self.stub.board.advance(self.at))


class WireClock:
    """The wire's time, as a clock."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire

    def now(self) -> datetime:
        """Aware UTC."""
        return self._wire.at

    def monotonic(self) -> float:
        """Seconds since midnight."""
        return (self._wire.at - MIDNIGHT).total_seconds()

    def wait(self, until: datetime, woken_by: Inbox | None = None) -> None:
        """On to the next thing that the stub does, and no further than until something is there."""
        wire = self._wire
        while wire.at < until and not (woken_by is not None and woken_by.pending()):
            due = wire.stub.board.due()
            wire.pass_to(until if due is None else min(due, until))
