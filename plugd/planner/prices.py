"""The exact plan's prices: what one more battery kWh in a session costs, and one more at the horizon's end is
worth.

They are the dual of the linear problem: a slot cheaper than its session's price is full, a dearer one empty.
Where the row between two sessions does not bind, both have the same price.
"""

from dataclasses import dataclass
from math import inf

from plugd.planner.bounds import DUST_KWH, Chain
from plugd.planner.problem import Problem

BINDING_KWH = 1e-7


@dataclass(frozen=True, slots=True)
class Prices:
    """In g per kWh at the plug."""

    session_g_per_kwh: list[float]
    """(N,)."""
    end_g_per_kwh: float
    """Worth of a little more energy at the end, by the end value alone."""


def prices(problem: Problem, links: Chain, slots: list[list[tuple[float, int]]], charge_kwh: list[float]) -> Prices:
    """The prices of an exact plan, (n,). `slots`: per session (intensity, slot), cheapest first."""
    binds, total_kwh = [], 0.0
    for first, end, lower, upper in zip(links.starts, links.starts[1:], links.lower_kwh, links.upper_kwh, strict=False):
        total_kwh += sum(charge_kwh[first:end])
        binds.append(abs(total_kwh - lower) < BINDING_KWH or abs(total_kwh - upper) < BINDING_KWH)
    end_g = _end_worth_g_per_kwh(problem, total_kwh - links.lower_kwh[-1]) * problem.efficiency
    found = [0.0] * len(binds)
    last = len(binds) - 1
    while last >= 0:
        first, low, high = last, -inf, inf
        while True:
            used, free = _margin(slots[first], links.room_kwh, charge_kwh)
            low, high = max(low, used), min(high, free)
            if first == 0 or binds[first - 1]:
                break
            first -= 1
        price = _between(low, high)
        if last == len(binds) - 1 and not binds[last]:
            price = max(low, min(high, end_g))
        found[first : last + 1] = [price] * (last + 1 - first)
        last = first - 1
    return Prices(found, end_g)


def _margin(own: list[tuple[float, int]], room_kwh: list[float], charge_kwh: list[float]) -> tuple[float, float]:
    """Of one session: the dearest intensity used and the cheapest with room, +-inf for none."""
    used = -inf
    for intensity, slot in own:
        if charge_kwh[slot] > DUST_KWH:
            used = intensity
        if charge_kwh[slot] < room_kwh[slot] - DUST_KWH:
            return used, intensity
    return used, inf


def _between(low: float, high: float) -> float:
    if low == -inf:
        return high if high < inf else 0.0
    return low if high == inf else (low + high) / 2


def _end_worth_g_per_kwh(problem: Problem, above_kwh: float) -> float:
    """Worth per battery kWh of the step that `above_kwh` lies in."""
    for width_kwh, worth in problem.end_value:
        if above_kwh < width_kwh - DUST_KWH:
            return worth
        above_kwh -= width_kwh
    return 0.0
