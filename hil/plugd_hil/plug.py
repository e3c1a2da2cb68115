"""The stub plug: a program that a broker, and plugd, cannot tell from a real plug with a car behind it.

It sends nothing that a real one would not. With `--stdin` it takes orders from the world, one a line:
press · cut [SECONDS] · mute · unmute · jam (or weld) · unjam · car arrive · car leave · soc PERCENT · limit KW, and
those of `plug_faults.py`; it ends when stdin closes. `--faults` takes them, each at its time, from a scenario.
"""

import argparse
import json
import sys
from collections.abc import Callable
from contextlib import ExitStack
from datetime import datetime
from typing import Any, TextIO

from plugd.adapters.mqtt import Broker, Mailbox, MqttConnection, Retained
from plugd.ports import Clock
from plugd_hil.conductor import address
from plugd_hil.openevse import OpenEvseCharger
from plugd_hil.outlet import Load, Said
from plugd_hil.plain import HABITS, PlainPlug
from plugd_hil.plug_faults import PlugFaults
from plugd_hil.program import Orders, command_line, live
from plugd_hil.scene import Scene, car_at_home
from plugd_hil.shelly2 import Shelly2Plug
from plugd_hil.socket import Plug, Socket
from plugd_hil.tasmota import TasmotaPlug

BROKER_PATIENCE_S = 10.0


class Desk(Orders):
    """Everything that may wake the program: orders and MQTT."""

    def __init__(
        self, options: argparse.Namespace, now: datetime, connection: MqttConnection, mailbox: Mailbox
    ) -> None:
        super().__init__(options, now, connection.bell)
        self._connection = connection
        self._mailbox = mailbox

    def pending(self) -> bool:
        """Whether there is something to do."""
        return self._mailbox.pending() or super().pending()

    def flush(self) -> None:
        """Everything under way has arrived."""
        self._connection.flush()


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = command_line("plug", __doc__, 2.3, ("arrival", "never"))
    p.add_argument("--dialect", choices=DIALECTS, default="tasmota")
    p.add_argument("--broker", default="127.0.0.1:1883", metavar="HOST:PORT")
    p.add_argument("--topic", default="ev-plug")
    p.add_argument("--on", action="store_true", help="the relay is on at the start")
    p.add_argument("--soc-topic", metavar="TOPIC")
    p.add_argument("--tele-period", type=int, metavar="S", help="default: as the device is shipped")
    return p


DIALECTS: dict[str, Callable[[argparse.Namespace, Socket], Plug]] = {
    "tasmota": lambda options, board: TasmotaPlug(
        options.topic, board, seed=options.seed, tele_period_s=options.tele_period or 300
    ),
    "shelly2": lambda options, board: Shelly2Plug(options.topic, board, energy_period_s=options.tele_period or 60),
    "openevse": lambda options, board: OpenEvseCharger(options.topic, board, period_s=options.tele_period or 30),
    **dict.fromkeys(
        HABITS,
        lambda options, board: PlainPlug(options.dialect, options.topic, board, period_s=options.tele_period),
    ),
}


def plug_at(load: Load, now: datetime, options: argparse.Namespace) -> Plug:
    """The plug as the command line wants it, with this behind it."""
    return DIALECTS[options.dialect](options, Socket(load, now, options.power, options.on, options.timezone))


def run(options: argparse.Namespace, clock: Clock, ledger: TextIO | None, left: ExitStack) -> None:
    """Until SIGTERM, or the end of stdin."""
    now = clock.now()
    car = car_at_home(options, now)
    told_at = options.soc_topic if options.tell == "arrival" else None
    scene = Scene(plug_at(car, now, options), car, ledger, told_at)
    faults = PlugFaults(options.seed)
    will = scene.plug.will
    connection = MqttConnection(
        Broker(*address(options.broker)),
        f"DVES_{options.topic}",
        will=(will.topic, will.payload.encode()),
        retry_s=(1.0, 10.0),
    )
    mailbox = connection.subscribe(*((topic, Retained.REPLAYED) for topic in scene.plug.listens))
    desk = Desk(options, now, connection, mailbox)
    desk.listen(sys.stdin if options.stdin else None)
    connection.start()
    left.callback(connection.close)
    connection.wait_connected(BROKER_PATIENCE_S)
    ready: dict[str, Any] = {"ready": connection.connected, "topic": options.topic, "broker": options.broker}
    session = 0

    def say(said: list[Said]) -> None:
        for one in faults.pass_on(said, clock.now()):
            connection.publish(one.topic, one.payload.encode(), qos=one.qos, retain=one.retain)

    while not desk.stopped:
        say(scene.advance(clock.now()))
        if connection.session != session:
            session = connection.session
            say(scene.plug.connected())
        for message in mailbox.take():
            say([] if faults.deaf else scene.watch(scene.plug.handle(message.topic, message.payload)))
        for line in desk.take(clock.now()):
            said = faults.told(line)
            say(scene.told(line) if said is None else said)
        if ready:
            connection.flush()
            print(json.dumps(ready), flush=True)
            ready = {}
        clock.wait(min(m for m in (scene.due(), desk.due(), faults.due()) if m is not None), desk)
    connection.publish(will.topic, will.payload.encode(), retain=True)


if __name__ == "__main__":
    sys.exit(live(parser().parse_args(), run))
