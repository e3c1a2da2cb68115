"""The exact plan's prices: what one more battery kWh in a session costs, and one more at the horizon's end is
worth.

They are the dual of the linear problem: a slot cheaper than its session's price is full, a dearer one empty.
Where the row between two sessions does not bind, both have the same price.
"""

from math import inf

from plugd.planner.bounds import DUST_KWH, Chain
from plugd.planner.problem import Problem

BINDING_KWH = 1e-7
"""A total this near to a bound is at it."""


def binding(links: Chain, session_kwh: list[float]) -> list[bool]:
    """Whether a plan, charge per session (N,), is at a bound at the end of each, (N,)."""
    binds, total_kwh = [], 0.0
    for charged_kwh, lower, upper in zip(session_kwh, links.lower_kwh, links.upper_kwh, strict=True):
        total_kwh += charged_kwh
        binds.append(abs(total_kwh - lower) < BINDING_KWH or abs(total_kwh - upper) < BINDING_KWH)
    return binds


def common(margins: list[tuple[float, float]], binds: list[bool], end: float) -> list[float]:
    """A price per session, (N,), the same along sessions with no binding end between them.

    `margins`: per session the dearest used and the cheapest with room. `end`: the price of what is left where the
    last session's end does not bind. All in one unit.
    """
    found = [0.0] * len(binds)
    last = len(binds) - 1
    while last >= 0:
        first, (low, high) = last, margins[last]
        while first > 0 and not binds[first - 1]:
            first -= 1
            used, free = margins[first]
            low, high = max(low, used), min(high, free)
        open_end = last == len(binds) - 1 and not binds[last]
        price = max(low, min(high, end)) if open_end else _between(low, high)
        found[first : last + 1] = [price] * (last + 1 - first)
        last = first - 1
    return found


def _between(low: float, high: float) -> float:
    if low == -inf:
        return high if high < inf else 0.0
    return low if high == inf else (low + high) / 2


def end_worth_g_per_kwh(problem: Problem, above_kwh: float) -> float:
    """Worth per battery kWh of the step that `above_kwh` lies in."""
    for width_kwh, worth in problem.end_value:
        if above_kwh < width_kwh - DUST_KWH:
            return worth
        above_kwh -= width_kwh
    return 0.0
