"""What energy left at the horizon's end is worth: the carbon it saves on the nights beyond.

**Derivation.** Let x be the battery kWh above the morning minimum at a session's end, 0 <= x <= R, R the room up to
the ceiling. Beyond the horizon no intensity is known, only what nights are like: night n offers its slots at prices
c_n1 <= c_n2 <= ... a battery kWh, which is intensity / efficiency, each for the energy that one slot takes, so that a
weak plug offers many small slots and cannot catch the cleanest hour whole. With u driven between two sessions and
every known night as likely as another, the least expected carbon from here on obeys

    J(x) = mean over n of  min over y of  C_n(y) + K(x - u + y),    0 <= x - u + y <= R,  y >= 0,

where C_n(y) is the sum of the cheapest y kWh and K is J one night later (0 after the last one). C_n is convex;
a convex K stays convex under the minimum (an infimal convolution) and the mean, so V = -J is concave, and only its
slope v(x) = -dJ/dx is needed: what one more kWh saves. Let w be K's. At z = x - u the night buys from its cheapest
slot on while that is cheaper than the kWh will be worth the next morning, up to the first y with c_n(y) >= w(z + y).
Below z = 0 it must buy, at any price; above R there is no room, and the worth is 0. One more kWh in hand then saves the
last slot bought or keeps the worth of the next one, whichever is more: max(c_n(y - 1), w(z + y)). So it is one pass
over sorted prices.

A plan counts on the cautious daily use u+ after each of its N - 1 earlier sessions, and the next plans find the battery
fuller by u+ - u for each. A kWh planned at x is expected at x + (N - 1)(u+ - u), and worth what it is there.

v falls with x: the more is left, the more nights it has to last, and the cleaner the charging it stands in the way of.
It rises with the use. A battery with more room values the same kWh no less. Nothing here needs numpy.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from math import ceil, floor, inf

from plugd.domain import Series

Steps = tuple[tuple[float, float], ...]
"""(battery kWh, g per battery kWh), upward from the last session's lower bound; never rising."""

NIGHTS_BEYOND = 12
"""Nights that are looked at. The usual battery is through its room in three; more change nothing."""
CELLS_A_STEP, STEPS = 3, 5
"""The slope is worked out on a finer grid than it is told on: every step is a column to the solver."""
LEAST_KWH = 0.01
"""Less room, or less in a slot, is not worth planning for."""


@lru_cache(maxsize=8)
def steps(nights: tuple[Series, ...], slot_kwh: float, use_kwh: float, room_kwh: float, efficiency: float) -> Steps:
    """The worth of energy left, in `STEPS` equal steps over the room; none where there is no room or no night.

    `nights`: what nights are like, each the intensities of its slots in g per kWh at the plug, in any order.
    `slot_kwh`: battery kWh that a slot takes. `use_kwh`: battery kWh expected to be driven a day. `room_kwh`: from
    the morning minimum to the ceiling. Cached, since history brings a new night only once a day.
    """
    if min(room_kwh, slot_kwh) < LEAST_KWH:
        return ()
    cells = CELLS_A_STEP * STEPS
    cell_kwh = room_kwh / cells
    offers = [_offer(prices, slot_kwh / cell_kwh, cells, use_kwh / cell_kwh, efficiency) for prices in nights if prices]
    if not offers:
        return ()
    slope = [0.0] * cells
    for _ in range(NIGHTS_BEYOND):
        slope = _night_before(slope, offers, use_kwh / cell_kwh)
    width_kwh = room_kwh / STEPS
    means = (sum(slope[k : k + CELLS_A_STEP]) / CELLS_A_STEP for k in range(0, cells, CELLS_A_STEP))
    return tuple((width_kwh, worth) for worth in _falling(means))


def beyond(found: Steps, spare_kwh: float) -> Steps:
    """The steps that are left for a plan that will find `spare_kwh` more in the battery than it counts on."""
    left = []
    for width_kwh, worth in found:
        passed_kwh = min(width_kwh, spare_kwh)
        spare_kwh -= passed_kwh
        if width_kwh > passed_kwh:
            left.append((width_kwh - passed_kwh, worth))
    return tuple(left)


def _offer(prices: Series, slot_cells: float, cells: int, use_cells: float, efficiency: float) -> list[float]:
    """What each cell charged in a night costs, g per battery kWh, cheapest first: as many as could be wanted."""
    ranked = sorted(prices)
    wanted = min(cells + ceil(use_cells), max(1, floor(len(ranked) * slot_cells)))
    return [ranked[min(int((k + 0.5) / slot_cells), len(ranked) - 1)] / efficiency for k in range(wanted)]


def _night_before(slope: list[float], offers: list[list[float]], use_cells: float) -> list[float]:
    """The slope at one session's end from that at the next. A use between two cells is one or the other."""
    low = floor(use_cells)
    share = use_cells - low
    stocks = range(len(slope) - low - 1, -low - 2, -1)
    found = [_savings(slope, offer, stocks) for offer in offers]
    means = [sum(savings) / len(offers) for savings in zip(*found, strict=True)]
    return [share * more + (1.0 - share) * fewer for fewer, more in pairwise(means)][::-1]


def _savings(slope: list[float], offer: list[float], stocks: range) -> list[float]:
    """What one more cell saves on a night that begins with each of `stocks` cells, falling.

    Below 0 some must be bought. The less there is, the more is: one pass through the offer serves them all.
    """
    found, bought, cells, slots = [], 0, len(slope), len(offer)
    for stock in stocks:
        if -stock > slots:  # out of reach: every slot is taken, and the next one is worth no less
            found.append(max(0.0, offer[-1], slope[0]))
            continue
        bought, most = max(bought, -stock), min(slots, max(0, cells - stock))
        while bought < most and offer[bought] < slope[stock + bought]:
            bought += 1
        last = offer[bought - 1] if bought else 0.0
        kept = slope[stock + bought] if stock + bought < cells else 0.0
        found.append(max(0.0, last, kept))
    return found


def _falling(worths: Iterator[float]) -> Iterator[float]:
    """The same numbers without what rounding may have let rise."""
    least = inf
    for worth in worths:
        least = min(least, worth)
        yield least
