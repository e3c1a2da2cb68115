"""The planning problem as OSQP sees it: N rows on the cumulative charge and a box, in units of one full slot.

What is left open to OSQP, three slots at the exact plan's edge in each session, and what that means is told in
`plugd.planner.qp`. Three: the last full one, the part one and the next.

A column is the energy of one slot, in full slots (the most any slot of the problem takes), so the constraint matrix
holds only ones and the same workspace serves partial, elapsed and weaker slots: they are bounds, never coefficients.
Costs are intensities over 150 g/kWh. The end value adds a column per finite step and one row; an endless last step is
folded into the costs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import inf
from operator import sub

from plugd.planner.answer import Account
from plugd.planner.bounds import DUST_KWH, Chain, tube
from plugd.planner.prices import binding, common, end_worth_g_per_kwh
from plugd.planner.problem import Problem
from plugd.planner.ranking import LEAST, Ranking

TYPICAL_G_PER_KWH = 150.0
OVERRUN_SLOTS = 0.005
"""A solver's answer outside its rows by more is not believed; by less it is moved inside."""
OPEN = LEAST
"""Columns of a session."""
NO_BOUND = 1e30
"""OSQP's infinity."""
DEAREST = 4.0
"""Costs are scaled so that none is more."""
IDLE_COST = 6.0
"""Cost of a column that stands for no slot. It is never worth using; closing it instead would change which
bounds are equal, and OSQP then factorises anew.
"""


@dataclass(frozen=True, slots=True)
class Shape:
    """What a workspace is made for."""

    sessions: int
    steps: int
    """Columns of the end value."""


@dataclass(frozen=True, slots=True)
class Condensed:
    """min cost.x + epsilon/2 |x|^2 over lower <= x <= upper (box) and the rows on cumulative sums."""

    shape: Shape
    slots: list[Ranking]
    """Per session those left open, at most `OPEN`, cheapest first."""
    settled_kwh: list[float]
    """Charged outside of them by the end of each session, (N,)."""
    full_kwh: float
    """Battery kWh of one full slot: the most any slot takes."""
    cost: list[float]
    lower: list[float]
    """Box, then the N rows, then with an end value its row."""
    upper: list[float]
    x: list[float]
    """The exact plan in full slots: where to start."""
    y: list[float]
    """Multipliers to start from."""


def condense(problem: Problem, links: Chain, ranking: list[Ranking], exact: Account, epsilon: float) -> Condensed:
    """The problem at the edges of the exact plan, which is filled in the order of `ranking`.

    `epsilon` weighs the proximal term, in full slots. OSQP starts at the exact plan with its prices, in marginal costs
    with the proximal term, for multipliers. Unless slots of nearly one price share, this is the optimum of the
    quadratic problem too, and OSQP has only to confirm it. Better than the last tick's answer, which is for another
    forecast and, at a session's end, for another session. OSQP's stationarity is P x + q + A'y = 0.
    """
    slots, settled_kwh = _edges(links, ranking, exact)
    flat = [slot for own in slots for slot in own]
    intensity = [links.intensity_g_per_kwh[slot] for slot in flat]
    endless = _endless_g_per_kwh(problem)
    scale = max(TYPICAL_G_PER_KWH, max(intensity) / DEAREST, -min(intensity) / DEAREST)
    full_kwh = max(links.room_kwh)
    cost = [(g - endless) / scale for g in intensity]
    if problem.previous_power_kw is not None:
        cost = list(map(sub, cost, _pulls(problem, links, slots, epsilon / full_kwh)))
    upper = [links.room_kwh[slot] / full_kwh for slot in flat]
    x = [exact.charge_kwh[slot] / full_kwh for slot in flat]
    if len(flat) < OPEN * len(slots):
        for column in _idle(slots):
            cost.insert(column, IDLE_COST)
            upper.insert(column, 1.0)
            x.insert(column, 0.0)
    marginals = [linear + epsilon * full for linear, full in zip(cost, x, strict=True)]
    above_kwh = sum(exact.session_kwh) - links.lower_kwh[-1]
    worth = (end_worth_g_per_kwh(problem, above_kwh) * problem.efficiency - endless) / scale
    prices = common(_margins(marginals, x, upper), binding(links, exact.session_kwh), worth)
    y = [prices[column // OPEN] - marginal for column, marginal in enumerate(marginals)]
    steps = sum([width_kwh < inf for width_kwh, _ in problem.end_value])
    form = Condensed(Shape(len(slots), steps), slots, settled_kwh, full_kwh, cost, [0.0] * len(cost), upper, x, y)
    if steps:
        _add_steps(form, problem, links, (above_kwh, worth, endless, scale))
    form.lower.extend([(kwh - out) / full_kwh for kwh, out in zip(links.lower_kwh, settled_kwh, strict=True)])
    form.upper.extend([(kwh - out) / full_kwh for kwh, out in zip(links.upper_kwh, settled_kwh, strict=True)])
    form.y.extend(map(sub, [*prices[1:], worth if steps else 0.0], prices))
    if steps:  # what the steps are paid for is there: all charge - the steps >= the last lower bound
        form.lower.append(form.lower[-1])
        form.upper.append(NO_BOUND)
        form.y.append(-worth)
    return form


def _edges(links: Chain, ranking: list[Ranking], exact: Account) -> tuple[list[Ranking], list[float]]:
    """Per session the slots next to its edge, and what is charged outside of them by its end."""
    slots, settled, settled_kwh = [], [], 0.0
    for own, session_kwh in zip(ranking, exact.session_kwh, strict=True):
        left_kwh, edge = session_kwh + DUST_KWH, 0
        for slot in own:
            left_kwh -= links.room_kwh[slot]
            if left_kwh < 0.0:
                break
            edge += 1
        first = max(0, min(edge - 1, len(own) - OPEN))
        near = own[first : first + OPEN]
        settled_kwh += session_kwh
        for slot in near:
            settled_kwh -= exact.charge_kwh[slot]
        slots.append(near)
        settled.append(settled_kwh)
    return slots, settled


def _pulls(problem: Problem, links: Chain, slots: list[Ranking], weight: float) -> list[float]:
    """The proximal term's part of the costs of `slots`: `weight` for a battery kWh of the plan before."""
    weight *= problem.efficiency
    before = zip(slots, problem.previous_power_kw or (), problem.sessions, links.starts, strict=False)
    return [
        weight * power_kw[slot - first] * session.slot_h[slot - first]
        for own, power_kw, session, first in before
        for slot in own
    ]


def _idle(slots: list[Ranking]) -> list[int]:
    """The columns that stand for no slot, ascending."""
    return [column for s, own in enumerate(slots) for column in range(OPEN * s + len(own), OPEN * (s + 1))]


def _margins(marginals: list[float], x: list[float], upper: list[float]) -> list[tuple[float, float]]:
    """Per session the greatest marginal cost of a column that is used and the least of one with room."""
    found = []
    used, free = -inf, inf
    for column, (marginal, full, most) in enumerate(zip(marginals, x, upper, strict=True), 1):
        if full > DUST_KWH and marginal > used:
            used = marginal
        if full < most - DUST_KWH and marginal < free:
            free = marginal
        if column % OPEN == 0:
            found.append((used, free))
            used, free = -inf, inf
    return found


def _add_steps(form: Condensed, problem: Problem, links: Chain, start: tuple[float, float, float, float]) -> None:
    """A column for each finite step of the end value."""
    above_kwh, worth, endless, scale = start
    _, most_kwh = tube(links.lower_kwh, links.upper_kwh, links.session_room_kwh)
    left_kwh = most_kwh[-1] - links.lower_kwh[-1]
    for width_kwh, worth_g_per_kwh in problem.end_value:
        if width_kwh == inf:
            break
        room_kwh = max(0.0, min(width_kwh, left_kwh))
        part_kwh = max(0.0, min(room_kwh, above_kwh))
        left_kwh, above_kwh = left_kwh - room_kwh, above_kwh - part_kwh
        form.cost.append((endless - worth_g_per_kwh * problem.efficiency) / scale)
        form.lower.append(0.0)
        form.upper.append(room_kwh / form.full_kwh)
        form.x.append(part_kwh / form.full_kwh)
        form.y.append(-worth - form.cost[-1])


def _endless_g_per_kwh(problem: Problem) -> float:
    """Worth at the plug of the end value's endless step, taken off every cost; 0 without one."""
    if problem.end_value and problem.end_value[-1][0] == inf:
        return problem.end_value[-1][1] * problem.efficiency
    return 0.0


def overrun_slots(form: Condensed, x: Sequence[float]) -> float:
    """How far `x`, a solver's answer in full slots, lies outside the rows it was given."""
    rows, worst = len(form.cost), 0.0
    for s, total in enumerate(accumulate(_session_slots(form, x))):
        off = max(form.lower[rows + s] - total, total - form.upper[rows + s])
        worst = off if not off <= worst else worst  # a NaN stays
    return worst


def _session_slots(form: Condensed, x: Sequence[float]) -> list[float]:
    """What `x` holds for each session, (N,)."""
    return [sum(x[OPEN * s : OPEN * (s + 1)]) for s in range(form.shape.sessions)]


def charges_kwh(links: Chain, exact: Account, form: Condensed, x: Sequence[float], hair_slots: float) -> list[float]:
    """A plan, battery kWh per slot (n,), that keeps every bound exactly, from a solver's `x` in full slots.

    The energy of each session is the solver's, moved into the true bounds by what the tolerance left over.
    Inside the session it goes to the slots in order of cost, proximal term included, equal ones to the earlier:
    the same energy, at most as much carbon, and one part slot instead of a solver's dust over all of them. A
    total within a hair of a bound, or of the edge of a slot, was meant to be there.
    """
    charge, room = exact.charge_kwh.copy(), links.room_kwh
    lower = list(map(sub, links.lower_kwh, form.settled_kwh))
    upper = list(map(sub, links.upper_kwh, form.settled_kwh))
    least, most = tube(lower, upper, [sum([room[slot] for slot in own]) for own in form.slots])
    total_kwh = 0.0
    for s, full_slots in enumerate(_session_slots(form, x)):
        least_kwh, most_kwh = max(least[s], total_kwh), most[s]
        wanted_kwh = total_kwh + full_slots * form.full_kwh
        order = [slot for _, slot in sorted(zip(form.cost[OPEN * s :], form.slots[s], strict=False))]
        edges_kwh = [least_kwh, most_kwh, *accumulate([room[slot] for slot in order], initial=total_kwh)]
        near_kwh = min(edges_kwh, key=lambda edge_kwh: abs(edge_kwh - wanted_kwh))
        if abs(near_kwh - wanted_kwh) < hair_slots * form.full_kwh:
            wanted_kwh = near_kwh
        need_kwh = max(min(wanted_kwh, most_kwh), least_kwh) - total_kwh
        for slot in order:
            part_kwh = max(0.0, min(need_kwh, room[slot]))
            charge[slot] = part_kwh
            need_kwh -= part_kwh
            total_kwh += part_kwh
    return charge


def confirmed(form: Condensed, x: Sequence[float], hair_slots: float) -> bool:
    """Whether a solver's `x` is the exact plan it started from, to a hair. Of equal length."""
    return all(map(hair_slots.__gt__, map(abs, map(sub, x, form.x))))  # a NaN is not
