"""The stub charger: an Elcon / TC charger with a battery behind it, on CAN, that plugd cannot tell from a real one.

On slcan it is a serial adapter too: plugd opens the terminal that is said in the first line of stdout. With `--stdin`
it takes orders from the world, one a line: mute · unmute · deaf · hear · fault [hardware hot mains battery] ·
lie VOLTS AMPERES · truth · babble FRAMES · raw HEX · car arrive · car leave · soc PERCENT; it ends when stdin closes.
`--faults` takes the same orders, each at its time, from a scenario.
"""

import argparse
import json
import random
import sys
from contextlib import ExitStack
from dataclasses import asdict
from datetime import datetime
from typing import Any, TextIO, cast

import can

from plugd.ports import Clock
from plugd_hil.elcon import ElconCharger, Rating
from plugd_hil.program import Orders, command_line, live
from plugd_hil.scene import Scene, car_at_home
from plugd_hil.slcan import MulticastWire, SlcanWire, Wire


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = command_line("can_elcon", __doc__, 3.3, ("arrival", "always", "never"))
    p.add_argument("--bus", default="slcan", metavar="slcan|GROUP:PORT", help="a pseudo terminal, or UDP multicast")
    p.add_argument("--volts", type=float, nargs=2, default=(320.0, 400.0), metavar="V", help="battery empty and full")
    p.add_argument("--period", type=float, default=1.0, metavar="S", help="between its words")
    p.add_argument("--timeout", type=float, default=5.0, metavar="S", help="without a command, after which it stops")
    return p


def _charger(options: argparse.Namespace, now: datetime) -> ElconCharger:
    empty_v, full_v = options.volts
    rating = Rating(options.power, empty_v, full_v, options.efficiency, options.period, options.timeout)
    return ElconCharger(car_at_home(options, now), now, rating, options.tell)


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


def run(options: argparse.Namespace, clock: Clock, ledger: TextIO | None, left: ExitStack) -> None:
    """Until SIGTERM, or the end of stdin."""
    orders = Orders(options, clock.now())
    orders.listen(sys.stdin if options.stdin else None)
    wire: Wire = SlcanWire(waits=options.clock is not None) if options.bus == "slcan" else MulticastWire(options.bus)
    left.callback(wire.close)
    charger = _charger(options, clock.now())
    scene = Scene(cast(Any, charger), charger.car, ledger)  # it knows a plug by what this charger has too
    dice = random.Random(f"{options.seed}/can")
    print(json.dumps({"ready": True, "channel": wire.channel}), flush=True)
    while not orders.stopped:
        for message in wire.take():
            charger.handle(message)
        wire.send(cast(list[can.Message], scene.advance(clock.now())))
        for line in orders.take(clock.now()):
            _told(line, charger, scene, wire, dice)
        clock.wait(min(scene.due(), orders.due() or scene.due()), orders)
    scene.note("end", **asdict(charger.asked))


if __name__ == "__main__":
    sys.exit(live(parser().parse_args(), run))
