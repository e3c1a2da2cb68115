"""The stub charger: an Elcon / TC charger with a battery behind it, on CAN, that plugd cannot tell from a real one.

On slcan it is a serial adapter too: plugd opens the terminal that is said in the first line of stdout. With `--stdin`
it takes orders from the world, one a line: mute · unmute · deaf · hear · fault [hardware hot mains battery] ·
lie VOLTS AMPERES · truth · babble FRAMES · raw HEX · car arrive · car leave · soc PERCENT; it ends when stdin closes.
`--faults` takes the same orders, each at its time, from a scenario.
"""

import argparse
import json
import random
import signal
import sys
import threading
from collections import deque
from contextlib import ExitStack
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import Any, TextIO, cast

import can

from plugd.adapters.clock import SystemClock
from plugd.study.world import Battery, Driver
from plugd.units import from_pct, require_utc
from plugd_hil.car import CarAtHome
from plugd_hil.conductor import Participant
from plugd_hil.elcon import ElconCharger, Rating
from plugd_hil.plug import Scene
from plugd_hil.script import Script
from plugd_hil.slcan import MulticastWire, SlcanWire, Wire


class Bench:
    """What may wake the program: orders on stdin. Frames wait for the charger's next word. A `plugd.ports.Inbox`."""

    def __init__(self) -> None:
        self.lines: deque[str] = deque()
        self.stopped = False
        self._bell = threading.Event()

    def pending(self) -> bool:
        """Whether there is an order."""
        return bool(self.lines) or self.stopped

    def wait(self, timeout_s: float) -> None:
        """Until there is, or the time is over."""
        self._bell.wait(timeout_s)
        self._bell.clear()

    def wake(self) -> None:
        """End the wait."""
        self._bell.set()

    def flush(self) -> None:
        """Nothing is under way: plugd's side asks the adapter whether all has arrived."""

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
    p = argparse.ArgumentParser(prog="plugd_hil.can_elcon", description=__doc__)
    p.add_argument("--bus", default="slcan", metavar="slcan|GROUP:PORT", help="a pseudo terminal, or UDP multicast")
    p.add_argument("--power", type=float, default=3.3, metavar="KW", help="its rating, at the plug")
    p.add_argument("--volts", type=float, nargs=2, default=(320.0, 400.0), metavar="V", help="battery empty and full")
    p.add_argument("--soc", type=float, default=50.0, metavar="PERCENT")
    p.add_argument("--capacity", type=float, default=50.0, metavar="KWH")
    p.add_argument("--efficiency", type=float, default=0.9)
    p.add_argument("--car", choices=("connected", "driver", "absent"), default="connected")
    p.add_argument("--period", type=float, default=1.0, metavar="S", help="between its words")
    p.add_argument("--timeout", type=float, default=5.0, metavar="S", help="without a command, after which it stops")
    p.add_argument(
        "--tell", choices=("arrival", "always", "never"), default="never", help="when the battery tells its SOC"
    )
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--timezone", default="Europe/London")
    p.add_argument("--start", type=datetime.fromisoformat, metavar="ISO", help="stays before are skipped")
    p.add_argument("--clock", metavar="HOST:PORT", help="the simulated clock's conductor")
    p.add_argument("--ledger", type=Path, metavar="FILE", help="the truth, as JSON lines")
    p.add_argument("--faults", type=Path, metavar="FILE", help="a scenario: what goes wrong, and when")
    p.add_argument("--stdin", action="store_true", help="take orders from stdin, and end with it")
    return p


def _charger(options: argparse.Namespace, now: datetime) -> ElconCharger:
    capacity_kwh = options.capacity
    battery = Battery(capacity_kwh, from_pct(options.soc) * capacity_kwh, options.efficiency)
    start = require_utc(options.start) if options.start else now
    stays = Driver(timezone=options.timezone, seed=options.seed).stays(start) if options.car == "driver" else None
    empty_v, full_v = options.volts
    rating = Rating(options.power, empty_v, full_v, options.efficiency, options.period, options.timeout)
    return ElconCharger(CarAtHome(battery, options.car == "connected", stays, start), now, rating, options.tell)


def _told(line: str, charger: ElconCharger, scene: Scene, wire: Wire, dice: random.Random) -> None:
    """An order from the world. Raises ValueError for one that it does not know."""
    match line.split():
        case ["babble", frames]:
            wire.send([_noise(dice) for _ in range(int(frames))])
        case ["raw", text] if isinstance(wire, SlcanWire):
            wire.raw(bytes.fromhex(text))
        case ["asked"]:
            print(json.dumps(asdict(charger.asked)), flush=True)
        case _ if not charger.told(line):
            scene.told(line)


def _noise(dice: random.Random) -> can.Message:
    extended = dice.random() < 0.5
    identifier = dice.getrandbits(29 if extended else 11)
    return can.Message(arbitration_id=identifier, is_extended_id=extended, data=dice.randbytes(dice.randrange(9)))


def run(options: argparse.Namespace, clock: SystemClock | Participant, left: ExitStack) -> None:
    """Until SIGTERM, or the end of stdin."""
    ledger = left.enter_context(options.ledger.open("w", encoding="utf-8")) if options.ledger else None
    bench = Bench()
    for signum in (signal.SIGTERM, signal.SIGINT):
        signal.signal(signum, bench.stop)
    wire: Wire = SlcanWire(waits=options.clock is not None) if options.bus == "slcan" else MulticastWire(options.bus)
    left.callback(wire.close)
    if options.stdin:
        threading.Thread(target=bench.read, args=(sys.stdin,), daemon=True).start()
    charger = _charger(options, clock.now())
    scene = Scene(cast(Any, charger), charger.car, ledger)  # it knows a plug by what this charger has too
    dice = random.Random(f"{options.seed}/can")
    script = Script.read(options.faults, "plug", clock.now(), options.timezone)
    print(json.dumps({"ready": True, "channel": wire.channel}), flush=True)
    while not bench.stopped:
        for message in wire.take():
            charger.handle(message)
        wire.send(cast(list[can.Message], scene.advance(clock.now())))
        bench.lines.extend(script.take(clock.now()))
        while bench.lines:
            _told(bench.lines.popleft(), charger, scene, wire, dice)
        clock.wait(min(scene.due(), script.due() or scene.due()), bench)
    scene.note("end", **asdict(charger.asked))


def main() -> int:
    """The program."""
    options = parser().parse_args()
    with ExitStack() as left:
        if options.clock:
            host, _, port = options.clock.rpartition(":")
            clock: SystemClock | Participant = Participant(host, int(port), "plug")
        else:
            clock = SystemClock()
        left.callback(clock.close)
        run(options, clock, left)
    return 0


if __name__ == "__main__":
    sys.exit(main())
