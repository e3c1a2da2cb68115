"""Stretches with the relay on, and the two ways to move energy between them: trim ends, grow ends.

Times are seconds from the tick's `now`, energies are at the plug.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from plugd.domain import RelayRules

WHOLE_S = 1.0
"""The grain: nothing shorter is moved."""
TINY_S = 1e-3
TINY_KWH = 1e-5
"""Rounding: a hundredth of a watt-hour, a millisecond at 36 kW."""


@dataclass(frozen=True, slots=True, order=True)
class Block:
    """A stretch with the relay on."""

    start_s: float
    end_s: float

    @property
    def length_s(self) -> float:
        """How long it is."""
        return self.end_s - self.start_s


Blocks = tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Cell:
    """A slot, or what is left of it: the power it would take and what that emits."""

    start_s: float
    end_s: float
    kw: float
    g_per_kwh: float


@dataclass(frozen=True, slots=True)
class Night:
    """The session as the relay sees it."""

    cells: tuple[Cell, ...]
    rules: RelayRules
    first_s: float
    """Before it nothing can be switched on."""
    latest_s: float
    """After it nothing is put that can be helped: session end less the guard's margin."""
    end_s: float
    running: bool
    """The relay is on."""
    hold_s: float
    """The relay is on and has to stay on until then; at most 0 where it may go off."""
    surplus_kwh: float
    must_kwh: float

    def runs(self, block: Block) -> bool:
        """Whether the block is the one that is on now."""
        return self.running and block.start_s <= 0.0

    def spans(self, block: Block) -> Iterator[tuple[float, Cell]]:
        """Seconds of a block in each slot."""
        for cell in self.cells:
            length_s = min(block.end_s, cell.end_s) - max(block.start_s, cell.start_s)
            if length_s > 0.0:
                yield length_s, cell

    def kwh(self, block: Block) -> float:
        """Energy at the plug."""
        return sum(length_s * cell.kw for length_s, cell in self.spans(block)) / 3600.0

    def g_per_kwh(self, block: Block) -> float:
        """Mean intensity; infinite where part of it can take no power."""
        spans = [(length_s, cell) for length_s, cell in self.spans(block) if cell.kw > 0.0]
        length_s = sum(length_s for length_s, _ in spans)
        if length_s <= 0.0 or length_s < block.length_s - TINY_S:
            return math.inf
        return sum(length_s * cell.g_per_kwh for length_s, cell in spans) / length_s

    def total_kwh(self, blocks: Blocks) -> float:
        """Energy of all blocks."""
        return sum(self.kwh(b) for b in blocks)

    @property
    def second_kwh(self) -> float:
        """What flows in a second: the grain of all moving about."""
        return max((cell.kw for cell in self.cells), default=0.0) * WHOLE_S / 3600.0


def joined(blocks: Iterable[Block], gap_s: float = 0.0) -> Blocks:
    """Sorted, and what touches or lies less than `gap_s` apart made one."""
    done: list[Block] = []
    for block in sorted(blocks):
        gap = block.start_s - done[-1].end_s if done else math.inf
        if gap <= 0.0 or gap < gap_s - TINY_S:
            last = done.pop()
            done.append(Block(last.start_s, max(last.end_s, block.end_s)))
        else:
            done.append(block)
    return tuple(done)


def closed(blocks: Blocks, night: Night) -> Blocks:
    """Every off gap under min off closed, the one that begins now too where the relay is on."""
    running = (Block(0.0, 0.0),) if night.running else ()
    return tuple(b for b in joined((*running, *blocks), night.rules.min_off_s) if b.length_s > 0.0)


def trimmed(blocks: Blocks, kwh: float, night: Night, keep: Block | None = None) -> tuple[Blocks, float]:
    """Take energy from the dearest ends of blocks, all but `keep`. Returns what could not be taken too."""
    while kwh > TINY_KWH:
        cuts = [(cut, b) for b in blocks if b != keep for cut in _cuts(b, kwh, night)]
        if not cuts:
            break
        cut, block = max(cuts, key=lambda c: (night.g_per_kwh(c[0]), c[0]))
        left = (Block(block.start_s, cut.start_s), Block(cut.end_s, block.end_s))
        blocks = tuple(sorted((*(b for b in blocks if b != block), *(b for b in left if b.length_s > 0.0))))
        kwh -= night.kwh(cut)
    return blocks, kwh


def _cuts(block: Block, kwh: float, night: Night) -> Iterator[Block]:
    """What may be cut off a block: all of it where that is not too much, else an end, down to min on."""
    runs = night.runs(block)
    if night.kwh(block) <= kwh + TINY_KWH and (not runs or night.hold_s <= 0.0):
        yield block
        return
    min_on_s = night.rules.min_on_s
    least_s = max(0.0, night.hold_s) if runs else min_on_s if block.length_s >= min_on_s - TINY_S else 0.0
    for cell in night.cells:
        # Rounded down: a trim never takes more than was added.
        most_s = math.floor(kwh * 3600.0 / cell.kw + TINY_S) if cell.kw > 0.0 else math.inf
        most_s = min(most_s, block.length_s - least_s)
        at_end_s = min(most_s, block.end_s - cell.start_s)
        if cell.start_s < block.end_s <= cell.end_s and at_end_s >= WHOLE_S:
            yield Block(block.end_s - at_end_s, block.end_s)
        at_start_s = min(most_s, cell.end_s - block.start_s)
        if cell.start_s <= block.start_s < cell.end_s and at_start_s >= WHOLE_S and not runs:
            yield Block(block.start_s, block.start_s + at_start_s)


def grown(
    blocks: Blocks, kwh: float, night: Night, until_s: float, under_g: float = math.inf, over: bool = False
) -> tuple[Blocks, float]:
    """Put energy at the cheapest ends of blocks, under an intensity. Returns what found no place too.

    over: an off gap may be closed where that is more than wanted; then what is returned is below zero.
    """
    while kwh > TINY_KWH:
        steps = ((night.g_per_kwh(step), step) for step in _steps(blocks, kwh, night, until_s, over))
        g_per_kwh, step = min(steps, default=(math.inf, Block(0.0, 0.0)))
        if g_per_kwh >= under_g:
            break
        blocks = joined((*blocks, step))
        kwh -= night.kwh(step)
    return blocks, kwh


def _steps(blocks: Blocks, kwh: float, night: Night, until_s: float, over: bool) -> Iterator[Block]:
    """What may be added at the ends of blocks, leaving off gaps of min off or none."""
    min_off_s = night.rules.min_off_s
    first_s = max(night.first_s, min_off_s) if night.running else night.first_s
    for before, after in zip((None, *blocks), (*blocks, None), strict=True):
        if before and after and after.start_s - before.end_s <= min_off_s + TINY_S:
            gap = Block(before.end_s, after.start_s)
            if over or night.kwh(gap) <= kwh + TINY_KWH:
                yield gap
            continue
        for cell in night.cells:
            need_s = math.ceil(kwh * 3600.0 / cell.kw - TINY_S) if cell.kw > 0.0 else 0.0
            if before and cell.start_s <= before.end_s < cell.end_s:
                high_s = after.start_s - min_off_s if after else until_s
                stop_s = min(cell.end_s, high_s, before.end_s + need_s)
                if stop_s - before.end_s > TINY_S:
                    yield Block(before.end_s, stop_s)
            if after and cell.start_s < after.start_s <= cell.end_s and not night.runs(after):
                low_s = before.end_s + min_off_s if before else first_s
                begin_s = max(cell.start_s, low_s, after.start_s - need_s)
                if after.start_s - begin_s > TINY_S:
                    yield Block(begin_s, after.start_s)
