"""Planned power to relay minutes: joined blocks, dwell, a budget of switch-ons, a random delay.

A relay is on or off, a plan's slot may want something between: then it runs a part of the slot, to the
second, on the side of a neighbour that is on. What dwell adds is taken from the dearest minutes elsewhere,
what it takes is put back at the cheapest edge of a block, so that the planned energy flows.

Inside this module times are seconds from `now`, energies are at the plug.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise

from plugd.domain import PlanSlot, RelayRules, Series, SessionPlan, Switch, Switching
from plugd.relay.blocks import TINY_KWH, TINY_S, Block, Blocks, Cell, Night, closed, grown, joined, trimmed
from plugd.relay.delay import delayed
from plugd.units import within

JOIN_G_PER_KWH = 5.0
"""A part too short to stand alone joins another block where that is at most this much dearer."""


@dataclass(frozen=True, slots=True)
class RelayHistory:
    """What the relay does now, and what the plan already made it do."""

    on: bool = False
    since: datetime | None = None
    """When it last moved; None where nobody knows: then dwell asks nothing of it."""
    switch_ons: tuple[datetime, ...] = ()
    """Switch-ons by the plan in this session."""
    orders: Switching | None = None
    """The last result: a delay that was drawn there and is running out is kept."""


def realise(
    session: SessionPlan,
    now: datetime,
    history: RelayHistory,
    rules: RelayRules,
    *,
    surplus_kwh: float,
    must_kwh: float,
    margin_s: float = 0.0,
    delay: Callable[[datetime], float] | None = None,
) -> Switching:
    """When the relay goes on and off from `now` to the session end, after this plan.

    surplus_kwh: room below soc_max beyond what is planned. must_kwh: what has to flow before the session
    end for the morning minimum. Both at the plug. margin_s: the guard's; nothing is moved into it that the
    plan did not put there. delay: seconds for a block by its planned start, None for no random delay.

    What the rules (dwell, budget) force comes first, except that the budget alone never cuts must_kwh while
    one switch-on is left or the relay is on. A part left out here is planned again at the next tick.
    """
    night = _night(session, now, history, rules, surplus_kwh, must_kwh, margin_s)
    blocks = _placed(session.slots, now, history, rules)
    planned_kwh = night.total_kwh(blocks)
    blocks = _dwelled(blocks, night)
    blocks = _lengthened(blocks, night, planned_kwh)
    blocks = _budgeted(blocks, night, rules.max_switch_on - len(history.switch_ons))
    if delay is not None:
        blocks = delayed(blocks, night, now, history.orders, delay)
    switches = [
        Switch(at=now + timedelta(seconds=moment_s), on=on)
        for block in blocks
        for moment_s, on in ((block.start_s, True), (block.end_s, False))
    ]
    return Switching(switches=tuple(switches), until=session.session.end)


def slot_shares(switching: Switching, slots: tuple[PlanSlot, ...]) -> Series:
    """Share of each slot with the relay on, 0..1, (len(slots),)."""
    edges = (*switching.switches, Switch(at=switching.until, on=False))
    ons = [(a.at, b.at) for a, b in pairwise(edges) if a.on]
    return tuple(
        sum(max(0.0, (min(end, s.end) - max(start, s.start)).total_seconds()) for start, end in ons)
        / (s.end - s.start).total_seconds()
        for s in slots
    )


# -- from slots to blocks -------------------------------------------------------------------------


def _night(
    session: SessionPlan,
    now: datetime,
    history: RelayHistory,
    rules: RelayRules,
    surplus_kwh: float,
    must_kwh: float,
    margin_s: float,
) -> Night:
    """All that the later steps have to know."""

    def since_now_s(moment: datetime) -> float:
        return (moment - now).total_seconds()

    dwell_s = rules.min_on_s if history.on else rules.min_off_s
    # A `since` in the future is a clock that stepped: no dwell is longer than from now on.
    wait_s = 0.0 if history.since is None else min(dwell_s, dwell_s + since_now_s(history.since))
    end_s = since_now_s(session.session.end)
    cells = tuple(
        Cell(max(0.0, since_now_s(s.start)), since_now_s(s.end), s.limit_kw, s.intensity_g_per_kwh)
        for s in session.slots
        if s.end > now
    )
    first_s = cells[0].start_s if cells else 0.0
    return Night(
        cells=cells,
        rules=rules,
        first_s=max(first_s, 0.0 if history.on else wait_s),
        latest_s=end_s - margin_s,
        end_s=end_s,
        running=history.on,
        hold_s=wait_s if history.on else 0.0,
        surplus_kwh=surplus_kwh,
        must_kwh=must_kwh,
    )


def _placed(slots: tuple[PlanSlot, ...], now: datetime, history: RelayHistory, rules: RelayRules) -> Blocks:
    """The planned minutes: fractional slots on the side of a neighbour that is on, else at their start."""
    ons_s = [_on_s(slot) for slot in slots]
    placed: list[Block] = []
    for i, (slot, on_s) in enumerate(zip(slots, ons_s, strict=True)):
        if on_s <= 0.0:
            continue
        start_s, end_s = (slot.start - now).total_seconds(), (slot.end - now).total_seconds()
        at_start = i == 0 and history.on and (history.since is None or history.since <= slot.start)
        left = at_start or (bool(placed) and placed[-1].end_s >= start_s)
        left_s = math.inf if at_start else placed[-1].length_s if left else 0.0
        right_s = _run_s(slots[i + 1 :], ons_s[i + 1 :], slot.end)
        # Between two: with the left one, sooner is safer, unless only the right one is too short alone.
        to_right = right_s > 0.0 and (not left or right_s < rules.min_on_s <= left_s)
        block = Block(end_s - on_s, end_s) if to_right else Block(start_s, start_s + on_s)
        placed = list(joined((*placed, block)))
    return tuple(Block(max(0.0, b.start_s), b.end_s) for b in placed if b.end_s > 0.0)


def _on_s(slot: PlanSlot) -> float:
    """On-time of a slot, up to a whole second."""
    length_s = (slot.end - slot.start).total_seconds()
    if slot.limit_kw <= 0.0 or slot.power_kw <= 0.0:
        return 0.0
    wanted_s = within(0.0, slot.power_kw / slot.limit_kw, 1.0) * length_s
    return min(length_s, float(math.ceil(wanted_s - TINY_S)))


def _run_s(slots: tuple[PlanSlot, ...], ons_s: list[float], end: datetime) -> float:
    """Length of the run of on-time that begins at `end` with these slots."""
    run_s = 0.0
    for slot, on_s in zip(slots, ons_s, strict=True):
        if slot.start != end or on_s <= 0.0:
            break
        run_s += on_s
        end = slot.end if on_s >= (slot.end - slot.start).total_seconds() else slot.start
    return run_s


# -- the rules ------------------------------------------------------------------------------------


def _dwelled(blocks: Blocks, night: Night) -> Blocks:
    """Stay on, stay off, close short gaps; the energy stays."""
    planned_kwh = night.total_kwh(blocks)
    if not night.running:
        blocks = _pushed(blocks, night)
    elif night.hold_s > 0.0:
        blocks = joined((Block(0.0, min(night.hold_s, night.end_s)), *blocks))
    blocks = closed(blocks, night)
    blocks, _ = trimmed(blocks, night.total_kwh(blocks) - planned_kwh, night)
    return grown(blocks, planned_kwh - night.total_kwh(blocks), night, night.latest_s)[0]


def _pushed(blocks: Blocks, night: Night) -> Blocks:
    """Blocks begin later where the relay has to stay off until `first_s`, and end as much later."""
    pushed: Blocks = ()
    free_s = night.first_s
    for block in blocks:
        start_s = max(block.start_s, free_s)
        free_s = min(start_s + block.length_s, night.end_s)
        if free_s > start_s:
            pushed = joined((*pushed, Block(start_s, free_s)))
    return pushed


def _lengthened(blocks: Blocks, night: Night, planned_kwh: float) -> Blocks:
    """No block shorter than min on: lengthened, joined to another or left to a later session."""
    if night.end_s - night.first_s < night.rules.min_on_s:  # too late for the rule
        return blocks if night.must_kwh > TINY_KWH else tuple(b for b in blocks if night.runs(b))
    min_on_s = night.rules.min_on_s
    while True:
        short = next((b for b in blocks if not night.runs(b) and b.length_s < min_on_s - TINY_S), None)
        if short is None:
            return blocks
        blocks = _settled(blocks, short, night, planned_kwh + night.surplus_kwh)


def _settled(blocks: Blocks, short: Block, night: Night, most_kwh: float) -> Blocks:
    """The blocks with one that is too short dealt with."""
    rest = tuple(b for b in blocks if b != short)
    kwh = night.kwh(short)
    merged, left_kwh = grown(rest, kwh, night, night.latest_s, night.g_per_kwh(short) + JOIN_G_PER_KWH)
    if left_kwh <= TINY_KWH:
        return merged
    longer, window = _extended(rest, short, night)
    longer, left_kwh = trimmed(longer, night.total_kwh(longer) - night.total_kwh(blocks), night, window)
    needed = night.total_kwh(rest) < night.must_kwh - TINY_KWH
    # The part is the session's marginal one: more or less of it costs about the same, so the nearer wins.
    worth_it = needed or short.length_s >= night.rules.min_on_s / 2.0
    if left_kwh <= night.second_kwh or (worth_it and night.total_kwh(longer) <= most_kwh + TINY_KWH):
        return longer
    if not needed:
        return rest
    for until_s in (night.latest_s, night.end_s):
        merged, left_kwh = grown(rest, kwh, night, until_s)
        if left_kwh <= TINY_KWH:
            return merged
    return longer


def _extended(rest: Blocks, short: Block, night: Night) -> tuple[Blocks, Block]:
    """A short block made min on, later or sooner, whichever is cleaner; with it the block it is now in."""
    min_on_s = night.rules.min_on_s
    last_s = max(night.latest_s, short.end_s) - min_on_s
    if last_s < night.first_s:
        last_s = night.end_s - min_on_s
    starts_s = (min(short.start_s, last_s), max(night.first_s, min(short.end_s, night.end_s) - min_on_s))
    windows = [Block(start_s, start_s + min_on_s) for start_s in starts_s]
    window = min(windows, key=night.g_per_kwh)
    blocks = closed((*rest, window), night)
    return blocks, next(b for b in blocks if b.start_s <= window.start_s < b.end_s)


def _budgeted(blocks: Blocks, night: Night, switch_ons: int) -> Blocks:
    """At most so many switch-ons: the smallest blocks go, their energy to the cheapest ends of others.

    Without one left, a relay that is on stays on for what the minimum needs; one that is off stays off.
    """
    while True:
        fresh = [b for b in blocks if not night.runs(b)]
        if len(fresh) <= max(0, switch_ons):
            return blocks
        least = min(fresh, key=night.kwh)
        kwh = night.kwh(least)
        rest = tuple(b for b in blocks if b != least)
        if not rest:
            if not night.running or night.must_kwh <= TINY_KWH:
                return ()
            rest, kwh = (Block(0.0, 0.0),), min(kwh, night.must_kwh)
        for until_s, over in ((night.latest_s, False), (night.end_s, False), (night.end_s, True)):
            rest, kwh = grown(rest, kwh, night, until_s, over=over)
        blocks, _ = trimmed(tuple(b for b in rest if b.length_s > 0.0), -kwh, night)
