"""Frames at random against the charger on CAN: no crash, and no command above the battery's limits. Says how many.

python -m tests.fuzz_can [FRAMES, 1000000] [SEED, 0]
"""

import random
import struct
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import can

from plugd.adapters.can_link import MOST_FRAMES
from plugd.adapters.can_soc import soc_signal
from plugd.adapters.elcon_words import COMMAND_ID, STATUS_ID, Limits
from plugd.domain import Capability, Setpoint
from plugd.errors import PlugError
from plugd.study.world import Battery
from plugd_hil.car import CarAtHome
from plugd_hil.elcon import Rating
from tests.can_world import CanWorld

START = datetime(2023, 1, 2, tzinfo=UTC)
IDS = (STATUS_ID, STATUS_ID, STATUS_ID, COMMAND_ID, 0x355, 0x6B0)
BATCH = MOST_FRAMES - 20


@dataclass(slots=True)
class Outcome:
    """What came of it."""

    frames: int = 0
    commands: int = 0
    charging: int = 0
    dropped: int = 0
    over: list[str] = field(default_factory=list)
    """Commands above the limits, or not whole."""
    refusals: Counter[str] = field(default_factory=Counter)


def frame(dice: random.Random) -> can.Message:
    """Anything that can be on a bus; often the charger's own, plausible or not."""
    identifier = dice.choice(IDS) if dice.random() < 0.7 else dice.getrandbits(29)
    extended = dice.random() < (0.95 if identifier > 0x7FF else 0.05)
    length = 8 if dice.random() < 0.9 else dice.randrange(9)
    data = dice.randbytes(length)
    if length == 8 and dice.random() < 0.5:  # volts and amperes as they might be
        data = struct.pack(">HHB", dice.randrange(3000, 4200), dice.randrange(150), dice.getrandbits(5)) + data[5:]
    kind = dice.random()
    return can.Message(
        arbitration_id=identifier if extended else identifier & 0x7FF,
        is_extended_id=extended,
        is_remote_frame=kind < 0.02,
        is_error_frame=0.02 <= kind < 0.04,
        data=None if kind < 0.02 else data,
    )


def run(frames: int, seed: int = 0) -> Outcome:
    """Throw frames at a charger that is told to charge, and look at every command. Raises what crashes."""
    dice, outcome = random.Random(seed), Outcome()
    while outcome.frames < frames:
        limits = Limits(dice.uniform(40.0, 800.0), dice.uniform(1.0, 60.0))
        world = CanWorld(
            START, CarAtHome(Battery(), True, None, START), Rating(7.0, 0.8 * limits.voltage_v, limits.voltage_v)
        )
        plug = world.plug(
            Capability(7.0, modulating=True, power_min_kw=1.38), limits, soc_signal("pylontech", None, None)
        )
        world.charger.muted = dice.random() < 0.3
        for _ in range(20):
            world.bus.arrived.extend(frame(dice) for _ in range(BATCH))
            outcome.frames += BATCH
            try:
                plug.set(Setpoint(dice.choice((0.0, 1.38, 3.0, 7.0)), world.at + timedelta(hours=1)))
                plug.read()
            except PlugError as error:
                outcome.refusals[type(error).__name__] += 1
            world.live(plug, 2.0)
        outcome.dropped += plug.nonsense
        _judge(outcome, [*world.commands, *world.bus.sent], limits)
        world.bus.shutdown()
    return outcome


def _judge(outcome: Outcome, commands: list[can.Message], limits: Limits) -> None:
    for told in commands:
        volts, amps, control, mode, rest = struct.unpack(">HHBBH", bytes(told.data))
        outcome.commands += 1
        outcome.charging += int(control == 0 and amps > 0)
        whole = control in (0, 1) and (mode, rest) == (0, 0) and (control == 0 or amps == 0)
        if not whole or volts / 10.0 > limits.voltage_v + 1e-6 or amps / 10.0 > limits.current_a + 1e-6:
            outcome.over.append(f"{bytes(told.data).hex()} with {limits}")


def main() -> int:
    """The program: exit 1 where a command was above the limits."""
    given = [int(text) for text in sys.argv[1:]]
    frames, seed = (given + [1_000_000, 0][len(given) :])[:2]
    began, spent = time.perf_counter(), time.process_time()
    outcome = run(frames, seed)
    sys.stdout.write(
        f"{outcome.frames} frames, {outcome.commands} commands ({outcome.charging} to charge), "
        f"{outcome.dropped} frames dropped as impossible, {len(outcome.over)} commands above the limits, no crash; "
        f"{time.perf_counter() - began:.0f} s ({time.process_time() - spent:.0f} s of processor); "
        f"refused: {dict(outcome.refusals)}\n"
    )
    for line in outcome.over[:5]:
        sys.stdout.write(f"{line}\n")
    return 1 if outcome.over or not outcome.charging else 0


if __name__ == "__main__":
    sys.exit(main())
