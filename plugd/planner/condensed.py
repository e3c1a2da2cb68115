"""The planning problem as OSQP sees it: N rows on the cumulative charge and a box, in units of one full slot.

A column is the energy of one slot, in full slots (the most any slot of the problem takes), so the constraint
matrix holds only ones and the same workspace serves partial, elapsed and weaker slots: they are bounds, never
coefficients. Costs are intensities over 150 g/kWh. The end value adds a column per finite step and one row;
an endless last step is folded into the costs.

**Pruning.** Session s takes at most U_s - L_{s-1}, and its slots differ only in price, so the cheapest slots
that together hold that much suffice: exact for the linear problem with any end value on the final energy. One
more is kept for the proximal term, whose optimum the pruning may move by at most epsilon/2 per full slot
charged.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from plugd.planner.bounds import DUST_KWH, Chain, repair, tube
from plugd.planner.prices import Prices
from plugd.planner.problem import Problem

TYPICAL_G_PER_KWH = 150.0
SNAP_SLOTS = 0.005
"""Bounds this near to a whole number of slots are nearly degenerate: ADMM crawls there, so the first pass
rounds them.
"""
NO_BOUND = 1e30
"""OSQP's infinity."""
CLOSED_COST = 4.0
"""Cost of a column that stands for no slot; its upper bound is 0."""


@dataclass(frozen=True, slots=True)
class Shape:
    """What a workspace is made for: it fits every problem that needs no more columns than these."""

    columns: tuple[int, ...]
    """Slots kept per session."""
    steps: int
    """Columns of the end value."""

    def nonzeros(self) -> int:
        """Ones in the cumulative rows: a session's columns stand in its own and all after it."""
        return sum(columns * (len(self.columns) - s) for s, columns in enumerate(self.columns))

    def fits(self, need: "Shape") -> bool:
        """Whether a problem that needs `need` goes into this shape without much waste."""
        return (
            self.steps == need.steps
            and len(self.columns) == len(need.columns)
            and all(have >= wanted for have, wanted in zip(self.columns, need.columns, strict=True))
            and max(self.columns) <= 2 * max(need.columns) + 6
        )


@dataclass(frozen=True, slots=True)
class Ranked:
    """The slots that may be used, and what they must be enough for."""

    slots: list[list[tuple[float, int]]]
    """Per session (intensity, slot), cheapest first, of equals those of the plan before; all with room."""
    least_kwh: list[float]
    most_kwh: list[float]
    full_kwh: float
    """Battery kWh of one full slot."""
    need: Shape


@dataclass(frozen=True, slots=True)
class Condensed:
    """min cost.x + epsilon/2 |x|^2 over lower <= x <= upper (box) and the rows on cumulative sums."""

    cost: list[float]
    lower: list[float]
    """Box, then the N rows, then with an end value its row."""
    upper: list[float]
    slots: list[list[tuple[float, int]]]
    """Per session (cost, slot) of the columns that stand for a slot, in the order of the columns."""
    epsilon: float
    scale_g_per_kwh: float
    """Intensity that is one unit of cost."""
    endless_g_per_kwh: float
    """Worth at the plug of the end value's endless step, taken off every cost; 0 without one."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """The exact solver's answer: battery kWh per slot, (n,), and its prices."""

    charge_kwh: list[float]
    prices: Prices


def roomy(need: Shape, problem: Problem) -> Shape:
    """A shape for a new workspace: the greatest need and a column to spare, whichever night is first."""
    columns = max(need.columns) + 1
    return Shape(tuple(min(columns, len(session.slot_h)) for session in problem.sessions), need.steps)


def ranked(problem: Problem, links: Chain) -> Ranked | None:
    """Slots by price and the columns needed; None where nothing can be charged at all."""
    full_kwh = max(links.room_kwh, default=0.0)
    if full_kwh <= DUST_KWH:
        return None
    least, most = tube(links.lower_kwh, links.upper_kwh, links.session_room_kwh)
    room, price = links.room_kwh, links.intensity_g_per_kwh
    slots, columns, before_kwh = [], [], 0.0
    previous = _previous_kwh(problem) or [0.0] * len(price)
    for s, most_kwh in enumerate(most):
        span = range(links.starts[s], links.starts[s + 1])
        own = [(g, i) for g, _, i in sorted((price[i], -previous[i], i) for i in span if room[i] > 0)]
        wanted_kwh, kept = most_kwh - before_kwh, 0
        for _, slot in own:
            if wanted_kwh <= DUST_KWH:
                break
            wanted_kwh -= room[slot]
            kept += 1
        slots.append(own)
        columns.append(min(kept + 1, len(own)))
        before_kwh = least[s]
    steps = sum(width_kwh < inf for width_kwh, _ in problem.end_value)
    return Ranked(slots, least, most, full_kwh, Shape(tuple(columns), steps))


def condense(problem: Problem, links: Chain, rank: Ranked, shape: Shape, *, epsilon: float, snap: bool) -> Condensed:
    """The problem in `shape`, which must fit. `epsilon` weighs the proximal term, in full slots."""
    full_kwh, efficiency = rank.full_kwh, problem.efficiency
    scale = max(TYPICAL_G_PER_KWH, max(map(abs, links.intensity_g_per_kwh)) / CLOSED_COST)
    endless = 0.0
    if problem.end_value and problem.end_value[-1][0] == inf:
        endless = problem.end_value[-1][1] * efficiency
    before = _previous_kwh(problem)
    cost, upper, slots = [], [], []
    for own, columns in zip(rank.slots, shape.columns, strict=True):
        kept = [
            ((price - endless) / scale - (epsilon * before[i] / full_kwh if before else 0.0), i)
            for price, i in own[:columns]
        ]
        closed = columns - len(kept)
        cost += [c for c, _ in kept] + [CLOSED_COST] * closed
        upper += [links.room_kwh[i] / full_kwh for _, i in kept] + [0.0] * closed
        slots.append(kept)
    left_kwh = rank.most_kwh[-1] - links.lower_kwh[-1]
    for width_kwh, worth in problem.end_value[: shape.steps]:
        part_kwh = max(0.0, min(width_kwh, left_kwh))
        left_kwh -= part_kwh
        cost.append((endless - worth * efficiency) / scale)
        upper.append(part_kwh / full_kwh)
    rows_low, rows_high = _rows(links, full_kwh, snap=snap)
    lower = [0.0] * len(cost) + rows_low
    upper += rows_high
    if shape.steps:  # what the steps are paid for is there: all charge - the steps >= the last lower bound
        lower.append(rows_low[-1])
        upper.append(NO_BOUND)
    return Condensed(cost, lower, upper, slots, epsilon, scale, endless)


def _previous_kwh(problem: Problem) -> list[float]:
    """Battery kWh per slot of the plan before, (n,), or nothing."""
    if problem.previous_power_kw is None:
        return []
    return [
        problem.efficiency * p * h
        for power_kw, session in zip(problem.previous_power_kw, problem.sessions, strict=True)
        for p, h in zip(power_kw, session.slot_h, strict=True)
    ]


def _rows(links: Chain, full_kwh: float, *, snap: bool) -> tuple[list[float], list[float]]:
    """The repaired bounds in full slots; snapped ones are repaired again, so that they stay feasible."""
    lower = [kwh / full_kwh for kwh in links.lower_kwh]
    upper = [kwh / full_kwh for kwh in links.upper_kwh]
    if snap:
        room = [kwh / full_kwh for kwh in links.session_room_kwh]
        lower, upper = repair([_snapped(x) for x in lower], [_snapped(x) for x in upper], room)
    return lower, upper


def _snapped(slots: float) -> float:
    whole = float(round(slots))
    return whole if abs(slots - whole) < SNAP_SLOTS else slots


def start(
    links: Chain, rank: Ranked, form: Condensed, shape: Shape, exact: Certificate
) -> tuple[list[float], list[float]]:
    """Where to start: the exact plan in full slots, and its prices as OSQP's multipliers.

    Better than the last tick's answer, which is for another forecast and, at a session's end, for another
    session: a third of the iterations, and ticks that never end became rare. OSQP's stationarity is P x + q +
    A'y = 0.
    """
    x: list[float] = []
    y: list[float] = []
    price = [(g - form.endless_g_per_kwh) / form.scale_g_per_kwh for g in exact.prices.session_g_per_kwh]
    for s, columns in enumerate(shape.columns):
        kept = form.slots[s]
        filled = [exact.charge_kwh[slot] / rank.full_kwh for _, slot in kept]
        x += filled + [0.0] * (columns - len(kept))
        y += [price[s] - cost - form.epsilon * full for (cost, _), full in zip(kept, filled, strict=True)]
        y += [price[s] - CLOSED_COST] * (columns - len(kept))
    worth = (exact.prices.end_g_per_kwh - form.endless_g_per_kwh) / form.scale_g_per_kwh if shape.steps else 0.0
    above = (sum(exact.charge_kwh) - links.lower_kwh[-1]) / rank.full_kwh
    for column in range(len(x), len(form.cost)):
        part = max(0.0, min(above, form.upper[column]))
        above -= part
        x.append(part)
        y.append(-worth - form.cost[column])
    y += [later - now for now, later in zip(price, [*price[1:], worth], strict=True)]
    if shape.steps:
        y.append(-worth)
    return x, y


def overrun_slots(form: Condensed, shape: Shape, x: Sequence[float]) -> float:
    """How far `x`, a solver's answer in full slots, lies outside the rows it was given."""
    rows = len(form.cost)
    total, worst, first = 0.0, 0.0, 0
    for s, columns in enumerate(shape.columns):
        total += sum(x[first : first + columns])
        first += columns
        off = max(form.lower[rows + s] - total, total - form.upper[rows + s])
        worst = off if not off <= worst else worst  # a NaN stays
    return worst


def charges_kwh(
    links: Chain, rank: Ranked, form: Condensed, shape: Shape, x: Sequence[float], *, hair_slots: float
) -> list[float]:
    """A plan, battery kWh per slot (n,), that keeps every bound exactly, from a solver's `x` in full slots.

    The energy of each session is the solver's, moved into the true bounds by what snapping and the tolerance
    left over. Inside the session it goes to the slots in order of cost, proximal term included, equal ones to
    the earlier: the same energy, at most as much carbon, and one part slot instead of a solver's dust over
    all of them. A total within a hair of a bound, or of the edge of a slot, was meant to be there.
    """
    charge = [0.0] * len(links.room_kwh)
    hair_kwh = hair_slots * rank.full_kwh
    total_kwh, first = 0.0, 0
    for s, columns in enumerate(shape.columns):
        least_kwh, most_kwh = max(rank.least_kwh[s], total_kwh), rank.most_kwh[s]
        wanted_kwh = total_kwh + sum(x[first : first + columns]) * rank.full_kwh
        first += columns
        edges_kwh = [least_kwh, most_kwh, total_kwh]
        order = sorted(form.slots[s])
        for _, slot in order:
            edges_kwh.append(edges_kwh[-1] + links.room_kwh[slot])
        near_kwh = min(edges_kwh, key=lambda edge_kwh: abs(edge_kwh - wanted_kwh))
        if abs(near_kwh - wanted_kwh) < hair_kwh:
            wanted_kwh = near_kwh
        need_kwh = max(min(wanted_kwh, most_kwh), least_kwh) - total_kwh
        for _, slot in order:
            part_kwh = min(need_kwh, links.room_kwh[slot])
            if part_kwh <= 0:
                break
            charge[slot] = part_kwh
            need_kwh -= part_kwh
            total_kwh += part_kwh
    return charge
