"""The stub plug: a program that a broker, and plugd, cannot tell from a real plug with a car behind it.

It sends nothing that a real one would not. With `--stdin` it takes orders from the world, one a line:
press · cut [SECONDS] · mute · unmute · jam (or weld) · unjam · car arrive · car leave · soc PERCENT · limit KW, and
those of `plug_faults.py`; it ends when stdin closes. `--faults` takes them, each at its time, from a scenario.
"""

import argparse
import json
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from datetime import datetime, timedelta
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from plugd.adapters.clock import SystemClock
from plugd.adapters.mqtt import Broker, Mailbox, MqttConnection, Retained
from plugd.study.world import Battery, Driver
from plugd.units import HALF_HOUR, from_pct, next_slot, require_utc, to_pct
from plugd_hil.car import CarAtHome
from plugd_hil.conductor import Participant
from plugd_hil.openevse import OpenEvseCharger
from plugd_hil.outlet import Said
from plugd_hil.plain import HABITS, PlainPlug
from plugd_hil.plug_faults import PlugFaults
from plugd_hil.script import Script
from plugd_hil.shelly2 import Shelly2Plug
from plugd_hil.socket import Plug
from plugd_hil.tasmota import TasmotaPlug

BROKER_PATIENCE_S = 10.0


class Scene:
    """The plug, the car, and the truth about both, written down."""

    def __init__(self, plug: Plug, car: CarAtHome, ledger: TextIO | None = None, soc_topic: str | None = None) -> None:
        """With a `soc_topic` the car tells its SOC there when it arrives."""
        self.plug = plug
        self.car = car
        self._ledger = ledger
        self._soc_topic = soc_topic
        self._on = plug.board.on
        self._boundary = next_slot(plug.board.now)
        self.note("start")

    def due(self) -> datetime:
        """When something happens next."""
        moments = self.plug.board.due(), self.car.due(), self._boundary
        return min(moment for moment in moments if moment is not None)

    def advance(self, to: datetime) -> list[Said]:
        """Let time pass up to `to`, one event after the other, each at its own moment."""
        said: list[Said] = []
        while (due := self.due()) <= to:
            said += self.watch(self.plug.board.advance(due))
            if self.car.due() == due:
                said += self.leave() if self.car.connected else self.arrive()
            if due == self._boundary:
                self._boundary += HALF_HOUR
                self.note("slot")
        return said + self.watch(self.plug.board.advance(to))

    def watch(self, said: list[Said]) -> list[Said]:
        """Writes down when the relay has moved."""
        if self.plug.board.on is not self._on:
            self._on = self.plug.board.on
            self.note("on" if self._on else "off")
        return said

    def arrive(self) -> list[Said]:
        """The car is plugged in, and tells its SOC where it can."""
        self.car.arrive()
        said = self.plug.load_changed()
        self.note("arrive")
        percent = to_pct(self.car.battery.soc)
        return [*said, *([Said(self._soc_topic, f"{percent:.1f}", qos=1)] if self._soc_topic else [])]

    def leave(self) -> list[Said]:
        """The car is unplugged, and driven: what it uses is gone from the next line on."""
        self.car.leave()
        said = self.plug.load_changed()
        self.note("leave")
        self.car.drive()
        return said

    def told(self, line: str) -> list[Said]:
        """An order from the world. Raises ValueError for one that it does not know."""
        match line.split():
            case ["press"]:
                return self.watch(self.plug.press())
            case ["cut", *seconds]:
                return self.watch(self.plug.cut(timedelta(seconds=float(seconds[0]) if seconds else 5.0)))
            case ["mute" | "unmute" as word]:
                self.plug.muted = word == "mute"
            case ["jam" | "weld" | "unjam" as word]:
                self.plug.board.jammed = word != "unjam"
            case ["limit", most_kw]:
                self.car.most_kw = float(most_kw)
                return self.plug.load_changed()
            case ["car", "arrive"]:
                return self.arrive()
            case ["car", "leave"]:
                return self.leave()
            case ["soc", percent]:
                self.car.battery.energy_kwh = from_pct(float(percent)) * self.car.battery.capacity_kwh
                said = self.plug.load_changed()
                self.note("soc")
                return said
            case _:
                raise ValueError(f"stub plug: {line.strip()!r} is no order")
        return []

    def note(self, event: str, **more: float) -> None:
        """A line of the ledger."""
        if self._ledger is None:
            return
        line = {
            "at": self.plug.board.now.isoformat(), "event": event, "soc": self.car.battery.soc,
            "energy_kwh": self.plug.board.total_kwh, "on": self.plug.board.on, "connected": self.car.connected, **more,
        }  # fmt: skip
        print(json.dumps(line), file=self._ledger, flush=True)


class Desk:
    """Everything that may wake the program: MQTT and stdin. A `plugd.ports.Inbox`."""

    def __init__(self, connection: MqttConnection, mailbox: Mailbox) -> None:
        self._connection = connection
        self.mailbox = mailbox
        self.lines: deque[str] = deque()
        self.stopped = False

    def pending(self) -> bool:
        """Whether there is something to do."""
        return self.mailbox.pending() or bool(self.lines) or self.stopped

    def wait(self, timeout_s: float) -> None:
        """Until there is, or the time is over."""
        self._connection.bell.wait_for(self.pending, timeout_s)

    def wake(self) -> None:
        """End the wait."""
        self._connection.wake()

    def flush(self) -> None:
        """Everything under way has arrived."""
        self._connection.flush()

    def stop(self, _signum: int = 0, _frame: FrameType | None = None) -> None:
        """End the program."""
        self.stopped = True
        self.wake()

    def read(self, stream: TextIO) -> None:
        """In a thread of its own: orders until the stream ends, and then the end."""
        for line in stream:
            self.lines.append(line)
            self.wake()
        self.stop()


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(prog="plugd_hil.plug", description=__doc__)
    p.add_argument("--dialect", choices=DIALECTS, default="tasmota")
    p.add_argument("--broker", default="127.0.0.1:1883", metavar="HOST:PORT")
    p.add_argument("--topic", default="ev-plug")
    p.add_argument("--power", type=float, default=2.3, metavar="KW", help="what the socket gives")
    p.add_argument("--soc", type=float, default=50.0, metavar="PERCENT")
    p.add_argument("--capacity", type=float, default=50.0, metavar="KWH")
    p.add_argument("--efficiency", type=float, default=0.9)
    p.add_argument("--car", choices=("connected", "driver", "absent"), default="connected")
    p.add_argument("--on", action="store_true", help="the relay is on at the start")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--timezone", default="Europe/London")
    p.add_argument("--start", type=datetime.fromisoformat, metavar="ISO", help="stays before are skipped")
    p.add_argument("--clock", metavar="HOST:PORT", help="the simulated clock's conductor")
    p.add_argument("--ledger", type=Path, metavar="FILE", help="the truth, as JSON lines")
    p.add_argument("--soc-topic", metavar="TOPIC")
    p.add_argument("--tell", choices=("arrival", "never"), default="never", help="when the car tells its SOC")
    p.add_argument("--tele-period", type=int, metavar="S", help="default: as the device is shipped")
    p.add_argument("--faults", type=Path, metavar="FILE", help="a scenario: what goes wrong, and when")
    p.add_argument("--stdin", action="store_true", help="take orders from stdin, and end with it")
    return p


def _tasmota(options: argparse.Namespace, car: CarAtHome, now: datetime) -> Plug:
    return TasmotaPlug(
        options.topic, car, now,
        power_kw=options.power, on=options.on, timezone=options.timezone, seed=options.seed,
        tele_period_s=options.tele_period or 300,
    )  # fmt: skip


def _shelly2(options: argparse.Namespace, car: CarAtHome, now: datetime) -> Plug:
    return Shelly2Plug(
        options.topic, car, now,
        power_kw=options.power, on=options.on, timezone=options.timezone,
        energy_period_s=options.tele_period or 60,
    )  # fmt: skip


def _openevse(options: argparse.Namespace, car: CarAtHome, now: datetime) -> Plug:
    return OpenEvseCharger(
        options.topic, car, now,
        power_kw=options.power, on=options.on, timezone=options.timezone, period_s=options.tele_period or 30,
    )  # fmt: skip


def _plain(options: argparse.Namespace, car: CarAtHome, now: datetime) -> Plug:
    return PlainPlug(
        options.dialect, options.topic, car, now,
        power_kw=options.power, on=options.on, timezone=options.timezone, period_s=options.tele_period,
    )  # fmt: skip


DIALECTS: dict[str, Callable[[argparse.Namespace, CarAtHome, datetime], Plug]] = {
    "tasmota": _tasmota,
    "shelly2": _shelly2,
    "openevse": _openevse,
    **dict.fromkeys(HABITS, _plain),
}


def scene(options: argparse.Namespace, now: datetime, ledger: TextIO | None) -> Scene:
    """Everything as the command line wants it."""
    battery = Battery(
        capacity_kwh=options.capacity,
        energy_kwh=from_pct(options.soc) * options.capacity,
        efficiency=options.efficiency,
    )
    start = require_utc(options.start) if options.start else now
    driver = Driver(timezone=options.timezone, seed=options.seed)
    stays = driver.stays(start) if options.car == "driver" else None
    car = CarAtHome(battery, options.car == "connected", stays, start)
    plug = DIALECTS[options.dialect](options, car, now)
    return Scene(plug, car, ledger, options.soc_topic if options.tell == "arrival" else None)


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    return host or "127.0.0.1", int(port)


def run(options: argparse.Namespace, clock: SystemClock | Participant, left: ExitStack) -> None:
    """Until SIGTERM, or the end of stdin."""
    ledger = left.enter_context(options.ledger.open("w", encoding="utf-8")) if options.ledger else None
    host, port = _address(options.broker)
    world = scene(options, clock.now(), ledger)
    script = Script.read(options.faults, "plug", clock.now(), options.timezone)
    faults = PlugFaults(options.seed)
    will = world.plug.will
    connection = MqttConnection(
        Broker(host, port), f"DVES_{options.topic}", will=(will.topic, will.payload.encode()), retry_s=(1.0, 10.0)
    )
    desk = Desk(connection, connection.subscribe(*((topic, Retained.REPLAYED) for topic in world.plug.listens)))
    for signum in (signal.SIGTERM, signal.SIGINT):
        signal.signal(signum, desk.stop)
    connection.start()
    left.callback(connection.close)
    connection.wait_connected(BROKER_PATIENCE_S)
    if options.stdin:
        threading.Thread(target=desk.read, args=(sys.stdin,), daemon=True).start()
    ready: dict[str, Any] = {"ready": connection.connected, "topic": options.topic, "broker": options.broker}
    session = 0

    def say(said: list[Said]) -> None:
        for one in faults.pass_on(said, clock.now()):
            connection.publish(one.topic, one.payload.encode(), qos=one.qos, retain=one.retain)

    while not desk.stopped:
        say(world.advance(clock.now()))
        if connection.session != session:
            session = connection.session
            say(world.plug.connected())
        for message in desk.mailbox.take():
            say([] if faults.deaf else world.watch(world.plug.handle(message.topic, message.payload)))
        desk.lines.extend(script.take(clock.now()))
        while desk.lines:
            line = desk.lines.popleft()
            said = faults.told(line)
            say(world.told(line) if said is None else said)
        if ready:
            connection.flush()
            print(json.dumps(ready), flush=True)
            ready = {}
        clock.wait(min(m for m in (world.due(), script.due(), faults.due()) if m is not None), desk)
    connection.publish(will.topic, will.payload.encode(), retain=True)


def main() -> int:
    """The program."""
    options = parser().parse_args()
    with ExitStack() as left:
        clock = Participant(*_address(options.clock), "plug") if options.clock else SystemClock()
        left.callback(clock.close)
        run(options, clock, left)
    return 0


if __name__ == "__main__":
    sys.exit(main())
