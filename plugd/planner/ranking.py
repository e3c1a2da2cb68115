"""Slots by price, and no more of them than a session can use: what every solver starts from.

**Pruning.** Session s takes at most U_s - L_{s-1}, and its slots differ only in price, so the cheapest slots
that together hold that much suffice: exact for the linear problem with any end value on the final energy.
"""

from itertools import compress

from plugd.domain import Series
from plugd.planner.bounds import DUST_KWH, Chain

LEAST = 3
"""Slots of a session that are kept however little it can take: as many as OSQP has columns for."""

Ranking = list[int]
"""Slots of one session, cheapest first."""


def ranked(links: Chain, before_kw: tuple[Series, ...] | None = None) -> list[Ranking]:
    """Per session the slots worth looking at: of equals those with most in the plan before, then the earlier.

    `before_kw`: the plan before, a series per session.
    """
    slots, reached_kwh = [], 0.0
    for s, (most_kwh, least_kwh) in enumerate(zip(links.upper_kwh, links.lower_kwh, strict=True)):
        first, end = links.starts[s], links.starts[s + 1]
        room = links.room_kwh[first:end]
        own = list(compress(range(end - first), room))
        if before_kw and any(before_kw[s]):
            own.sort(key=before_kw[s].__getitem__, reverse=True)  # stable, so is the next
        own.sort(key=links.intensity_g_per_kwh[first:end].__getitem__)
        wanted_kwh, kept = most_kwh - reached_kwh, 0
        for slot in own:
            if wanted_kwh <= DUST_KWH and kept >= LEAST:
                break
            wanted_kwh -= room[slot]
            kept += 1
        slots.append([first + slot for slot in own[:kept]])
        reached_kwh = max(reached_kwh, least_kwh)
    return slots
