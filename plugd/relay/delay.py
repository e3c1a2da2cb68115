"""The random delay: so that not every house in the land switches at the same second."""

import hashlib
from collections.abc import Callable
from datetime import datetime, timedelta

from plugd.domain import Switching
from plugd.relay.blocks import Block, Blocks, Night
from plugd.units import slot_start


def delay_s(start: datetime, *, seed: str, most_s: float) -> float:
    """The random delay, in whole seconds of 0..most_s, of the block planned to begin at `start`.

    The same for all starts in one half hour: a plan made anew moves a start by minutes, and must not draw
    again. Different for each household and night by `seed` (and for each start by its time).
    """
    key = f"{seed}/{slot_start(start).isoformat()}".encode()
    drawn = int.from_bytes(hashlib.blake2b(key, digest_size=8).digest(), "big")
    return float(drawn % (int(most_s) + 1))


def delayed(
    blocks: Blocks, night: Night, now: datetime, orders: Switching | None, delay: Callable[[datetime], float]
) -> Blocks:
    """Every block later by its delay, start and end alike, as far as the next one and the margin allow."""
    later: Blocks = ()
    for block in reversed(blocks):
        last_s = later[0].start_s - night.rules.min_off_s if later else night.latest_s
        wait_s = 0.0
        if not night.runs(block):
            most_s = max(0.0, min(night.rules.random_delay_s, last_s - block.end_s))
            wait_s = min(_wait_s(block, night, now, orders, delay), most_s)
        later = (Block(block.start_s + wait_s, block.end_s + wait_s), *later)
    return later


def _wait_s(
    block: Block, night: Night, now: datetime, orders: Switching | None, delay: Callable[[datetime], float]
) -> float:
    """A block's delay: drawn once, so one that should begin now keeps the start it was already given."""
    if block.start_s <= 0.0 and orders is not None:
        if orders.state(now):
            return 0.0
        due = orders.next(now, on=True)
        if due is not None and (due - now).total_seconds() <= night.rules.random_delay_s:
            return (due - now).total_seconds()
    return max(0.0, delay(now + timedelta(seconds=block.start_s)))
