"""A charger's least power: in every slot 0, or at least `power_min_kw`.

The solvers know nothing of it: it makes the problem a mixed-integer one. Their plan has about one part slot a
session, and only a part slot can lie under the least power. So their relaxed optimum is the bound, and the plan
is found by branch and bound: of a slot under the least power either nothing is asked, or at least that much.
Both leave a chain problem (a closed slot has no room; a forced one moves the bounds by what it takes), which the
exact solver answers in microseconds. A wave of such choices gives a first plan, the search improves it while its
budget lasts. No bound is given up but a minimum that no such plan keeps: then what is least short counts first.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import accumulate
from math import ceil, floor

from plugd.planner.answer import Made, account, answer, gap
from plugd.planner.bounds import DUST_KWH, Chain, chain, repair, session_charges_kwh
from plugd.planner.problem import Problem, Solution

MAX_NODES = 150
MAX_NODE_SLOTS = 60_000
"""Nodes times slots: a tenth of a second."""
MORE = 5
"""Times as long again is searched for a plan that misses no minimum."""
GOOD_GAP = 1e-4
"""A plan this near to the best that is possible ends the search."""
KEPT_KWH = 1e-7
"""Less than this is rounding, where a bound is concerned."""
ROUNDING = 1e-9
"""Of a slot: so near to a whole number of them a bound is one."""
MAX_WAVES = 12

Optimum = Callable[[Problem, Chain], list[float]]
"""The exact solver: battery kWh per slot (n,) of least cost on a chain's bounds."""


@dataclass(frozen=True, slots=True, order=True)
class Node:
    """A relaxed plan under some choices; ordered by what counts."""

    short_kwh: float
    """How far the repaired minima are missed in all."""
    objective_g: float
    charge_kwh: tuple[float, ...]
    closed: frozenset[int]
    forced: frozenset[int]


@dataclass(frozen=True, slots=True)
class Search:
    """One problem's terms: what is asked on which bounds, and the least a slot takes."""

    problem: Problem
    asked: Chain
    """The problem's own: the end value counts from its last minimum."""
    links: Chain
    """The bounds to keep."""
    least_kwh: tuple[float, ...]
    """Per slot, battery kWh."""
    optimum: Optimum

    def under(self, charge_kwh: tuple[float, ...]) -> list[int]:
        """Slots with something, but less than the least power."""
        return [
            i
            for i, (x, least) in enumerate(zip(charge_kwh, self.least_kwh, strict=True))
            if DUST_KWH < x < least - DUST_KWH
        ]

    def node(self, closed: frozenset[int], forced: frozenset[int]) -> Node | None:
        """The relaxed plan under these choices, None where a ceiling forbids them."""
        links = self.links
        room = links.room_kwh.copy()
        taken = [0.0] * len(room)
        for i in closed:
            room[i] = 0.0
        for i in forced:
            taken[i] = self.least_kwh[i]
            room[i] = max(0.0, room[i] - taken[i])
        rooms = session_charges_kwh(links, room)
        totals = list(accumulate(session_charges_kwh(links, taken)))
        wanted = [low - total for low, total in zip(links.lower_kwh, totals, strict=True)]
        most = [high - total for high, total in zip(links.upper_kwh, totals, strict=True)]
        lower, upper = repair(wanted, most, rooms)
        if any(kept > high + KEPT_KWH for kept, high in zip(upper, most, strict=True)):
            return None
        rest = replace(links, room_kwh=room, session_room_kwh=rooms, lower_kwh=lower, upper_kwh=upper)
        found = self.optimum(self.problem, rest)
        charge = tuple(x + more for x, more in zip(found, taken, strict=True))
        return self._judged(charge, zip(wanted, lower, strict=True), closed, forced)

    def _judged(
        self,
        charge_kwh: tuple[float, ...],
        minima: Iterable[tuple[float, float]],
        closed: frozenset[int],
        forced: frozenset[int],
    ) -> Node:
        """A plan with what counts of it. `minima`: (asked, kept) up to each session's end."""
        short_kwh = sum(max(0.0, asked - kept) for asked, kept in minima)
        objective_g = account(self.problem, self.asked, list(charge_kwh)).objective_g
        return Node(short_kwh if short_kwh > KEPT_KWH else 0.0, objective_g, charge_kwh, closed, forced)

    def best(self) -> Node:
        """The best plan found that keeps the least power."""
        slots = len(self.least_kwh)
        weak = frozenset(i for i in range(slots) if self.links.room_kwh[i] < self.least_kwh[i] - DUST_KWH)
        root = self.node(weak, frozenset())
        if root is None:  # nothing is forced yet, so no ceiling can forbid it
            raise RuntimeError("a chain without forced slots was found impossible")
        best = min((self._first(root), *self._whole(weak)))
        budget = max(8, min(MAX_NODES, MAX_NODE_SLOTS // max(1, slots)))
        heap, nodes = [root], budget
        while heap and nodes > (-MORE * budget if best.short_kwh > 0.0 else 0):
            node = heappop(heap)
            if not _better(node, best):
                break
            at = self.under(node.charge_kwh)[0]
            for child in (self.node(node.closed, node.forced | {at}), self.node(node.closed | {at}, node.forced)):
                nodes -= 1
                if child is None or not _better(child, best):
                    continue
                if self.under(child.charge_kwh):
                    heappush(heap, child)
                else:
                    best = child
        return best

    def _first(self, node: Node) -> Node:
        """A plan in few waves: every slot under the least power is raised to it, or where that may not be, closed."""
        for _ in range(MAX_WAVES):
            under = frozenset(self.under(node.charge_kwh))
            if not under:
                return node
            near = frozenset(i for i in under if node.charge_kwh[i] > self.least_kwh[i] / 2)
            choices = (
                self.node(node.closed | (under - raised), node.forced | raised)
                for raised in (under, near, frozenset[int]())
            )
            node = min(choice for choice in choices if choice is not None)
        return self._without_weak(node.charge_kwh, node.closed, node.forced)

    def _without_weak(self, charge_kwh: tuple[float, ...], closed: frozenset[int], forced: frozenset[int]) -> Node:
        """The plan with nothing in the slots under the least power, whatever minimum that misses."""
        under = frozenset(self.under(charge_kwh))
        charge = tuple(0.0 if i in under else x for i, x in enumerate(charge_kwh))
        totals = accumulate(session_charges_kwh(self.links, list(charge)))
        return self._judged(charge, zip(self.links.lower_kwh, totals, strict=True), closed, forced)

    def _whole(self, weak: frozenset[int]) -> Iterator[Node]:
        """Where every slot is wholly on or off and all are alike: the plan on bounds that count whole slots.

        Minima are rounded up and ceilings down; where they cross, the ceiling counts. What the end value would take
        besides may be a part of a slot, and is left.
        """
        links = self.links
        slots = zip(links.room_kwh, self.least_kwh, strict=True)
        usable = [(room, least) for room, least in slots if room > DUST_KWH and least - DUST_KWH <= room]
        size_kwh = max((room for room, _ in usable), default=0.0)
        if not usable or any(min(room, least) < size_kwh - DUST_KWH for room, least in usable):
            return
        upper = [size_kwh * floor(kwh / size_kwh + ROUNDING) for kwh in links.upper_kwh]
        ceilings = list(accumulate(reversed(upper), min))[::-1]
        wanted = [size_kwh * ceil(kwh / size_kwh - ROUNDING) for kwh in links.lower_kwh]
        room_kwh = [0.0 if i in weak else kwh for i, kwh in enumerate(links.room_kwh)]
        rooms = session_charges_kwh(links, room_kwh)
        lower, upper = repair([min(pair) for pair in zip(wanted, ceilings, strict=True)], upper, rooms)
        rest = replace(links, room_kwh=room_kwh, session_room_kwh=rooms, lower_kwh=lower, upper_kwh=upper)
        yield self._without_weak(tuple(self.optimum(self.problem, rest)), weak, frozenset())


def _better(node: Node, best: Node) -> bool:
    """Whether something under `node` may be worth more than `best`."""
    if abs(node.short_kwh - best.short_kwh) > KEPT_KWH:
        return node.short_kwh < best.short_kwh
    return gap(best.objective_g, node.objective_g) > GOOD_GAP


def honoured(problem: Problem, solution: Solution, optimum: Optimum) -> Solution:
    """`solution` with the least power kept in every slot; itself where it is kept already.

    What OSQP gave each session stays where a plan with the same energies is as good as a free one; else the
    powers are the exact solver's, and the solution says so. `bound_g` stays the relaxed optimum, without least
    power; `gap` is against it, and negative only where a minimum is missed for the least power's sake.
    """
    if not any(session.power_min_kw for session in problem.sessions):
        return solution
    links = chain(problem)
    least_kwh = tuple(problem.efficiency * s.power_min_kw * h for s in problem.sessions for h in s.slot_h)
    free = Search(problem, links, links, least_kwh, optimum)
    given_kwh = _charge_kwh(problem, solution)
    if not free.under(given_kwh):
        return _at_least(problem, solution)
    best, solver = free.best(), "exact"
    if solution.solver == "osqp":
        totals = list(accumulate(session_charges_kwh(links, list(given_kwh))))
        same = replace(free, links=replace(links, lower_kwh=totals, upper_kwh=totals)).best()
        if same.short_kwh <= KEPT_KWH and not _better(best, same):
            best, solver = same, "osqp"
    made = Made(solution.bound_g, solution.raw_gap, solution.iterations)
    plan = account(problem, links, list(best.charge_kwh))
    found = answer(problem, links, plan, made, fallback=solution.status == "fallback")
    return _at_least(problem, replace(found, solver="osqp" if solver == "osqp" else "exact"))


def _charge_kwh(problem: Problem, solution: Solution) -> tuple[float, ...]:
    """Battery kWh per slot, (n,)."""
    return tuple(
        problem.efficiency * p * h
        for power_kw, session in zip(solution.power_kw, problem.sessions, strict=True)
        for p, h in zip(power_kw, session.slot_h, strict=True)
    )


def _at_least(problem: Problem, solution: Solution) -> Solution:
    """The same, a power that rounding left a hair under the least put on it, and dust on 0."""
    return replace(
        solution,
        power_kw=tuple(
            tuple(
                0.0 if p * h * problem.efficiency <= DUST_KWH else max(p, session.power_min_kw)
                for p, h in zip(power_kw, session.slot_h, strict=True)
            )
            for power_kw, session in zip(solution.power_kw, problem.sessions, strict=True)
        ),
    )
