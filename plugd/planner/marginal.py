"""Why a plan is as it is: the slots at its margin, the prices of its bounds, and what it moved between nights.

The price of a bound is read off the exact plan. One kWh more by a session's end comes from the cheapest slot with
room in that session or an earlier one, and is saved in the dearest slot used in a later one, or left over; between
them no row may be in the way. One kWh less is the same the other way round. Where a slot is partly used the two are
equal: the dual of `plugd.planner.prices`. Else they are its one-sided limits, and both are told.
"""

from collections import deque
from dataclasses import dataclass
from itertools import accumulate
from math import inf
from typing import Literal

from plugd.planner.bounds import DUST_KWH, Chain, chain, session_charges_kwh, tube
from plugd.planner.exact import optimum
from plugd.planner.prices import BINDING_KWH
from plugd.planner.problem import Problem, Solution

USED_KWH = 0.005
"""A slot with less is not used: a hundredth of a kW over half an hour, which plans do not show either."""

Bound = Literal["minimum", "reserve", "ceiling"]


@dataclass(frozen=True, slots=True)
class MarginalSlot:
    """A slot of a session, counted from 0, and its intensity."""

    slot: int
    g_per_kwh: float


@dataclass(frozen=True, slots=True)
class Price:
    """Of a bound, in g per battery kWh, never negative. All 0 where it does not bind."""

    less_saves: float = 0.0
    """What would be saved if it asked one kWh less."""
    more_costs: float | None = 0.0
    """What one kWh more would cost; None where it cannot be had."""


@dataclass(frozen=True, slots=True)
class Margin:
    """One session of a plan."""

    charged_kwh: float
    """At the plug."""
    dearest_used: MarginalSlot | None
    cheapest_unused: MarginalSlot | None
    """Of the slots with room and no use."""
    floor: Literal["minimum", "reserve"]
    """Which of the two asks for more at the session's end."""
    floor_price: Price
    ceiling_saves: float
    """g per battery kWh saved if the ceiling were one kWh higher."""
    short_kwh: float
    """What the minimum is short of: it was cut to what can be reached."""
    ends_at: Bound | None
    """The bound at which the session ends in the exact plan."""


@dataclass(frozen=True, slots=True)
class Move:
    """Energy charged in an earlier night than it had to be."""

    battery_kwh: float
    charged: int
    """Session in which it is charged."""
    needed: int | None
    """Session that would have charged it, planned by itself; None: no minimum needs it, it is left at the end."""
    at_g_per_kwh: float
    instead_of_g_per_kwh: float
    """Mean intensity of what the other session would have used; of the end value where it is left over."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Of one plan."""

    margins: tuple[Margin, ...]
    moves: tuple[Move, ...]


def explain(problem: Problem, solution: Solution) -> Explanation:
    """Why `solution`, a plan of `problem`, is as it is. Slots and moves are the plan's, prices the exact plan's.

    The prices are those of the repaired bounds. The end value stays where it is while the last minimum is
    thought to move; energy just under it is worth what energy just above is.
    """
    links = chain(problem)
    plan_kwh = [
        problem.efficiency * p * h
        for power_kw, session in zip(solution.power_kw, problem.sessions, strict=True)
        for p, h in zip(power_kw, session.slot_h, strict=True)
    ]
    exact = _Residual.of(problem, links, optimum(problem, links))
    margins = tuple(_margin(problem, solution, links, plan_kwh, exact, s) for s in range(len(problem.sessions)))
    return Explanation(margins, _moves(problem, links, plan_kwh))


def _margin(
    problem: Problem, solution: Solution, links: Chain, plan_kwh: list[float], exact: "_Residual", s: int
) -> Margin:
    session, span = problem.sessions[s], range(links.starts[s], links.starts[s + 1])
    price = links.intensity_g_per_kwh
    used = [i for i in span if plan_kwh[i] > USED_KWH]
    unused = [i for i in span if plan_kwh[i] <= USED_KWH < links.room_kwh[i]]
    dearest = max(used, key=lambda i: price[i], default=None)
    cheapest = min(unused, key=lambda i: price[i], default=None)
    last = s == len(problem.sessions) - 1
    reserve = not last and problem.reserve_kwh + session.daily_use_kwh > session.minimum_kwh
    floor: Literal["minimum", "reserve"] = "reserve" if reserve else "minimum"
    short_kwh = solution.reserve_short_kwh[s] if reserve else solution.shortfall_kwh[s]
    return Margin(
        charged_kwh=sum(plan_kwh[i] for i in span) / problem.efficiency,
        dearest_used=None if dearest is None else MarginalSlot(dearest - span.start, price[dearest]),
        cheapest_unused=None if cheapest is None else MarginalSlot(cheapest - span.start, price[cheapest]),
        floor=floor,
        floor_price=exact.floor_price(s),
        ceiling_saves=exact.ceiling_saves(s),
        short_kwh=short_kwh,
        ends_at=floor if exact.at_lower[s] else "ceiling" if exact.at_upper[s] else None,
    )


@dataclass(frozen=True, slots=True)
class _Residual:
    """What can still be changed in an exact plan: per session the cheapest room and the dearest use, +-inf for
    none, and which rows bind. Intensities; the worth of energy at the end is per plug kWh like them.
    """

    efficiency: float
    free: list[float]
    used: list[float]
    at_lower: list[bool]
    at_upper: list[bool]
    worth_above: float
    worth_below: float

    @classmethod
    def of(cls, problem: Problem, links: Chain, charge_kwh: list[float]) -> "_Residual":
        """The residual of battery kWh per slot, (n,)."""
        free, used = [], []
        for first, end in zip(links.starts, links.starts[1:], strict=False):
            slots = [(links.intensity_g_per_kwh[i], charge_kwh[i], links.room_kwh[i]) for i in range(first, end)]
            free.append(min((g for g, x, room in slots if x < room - DUST_KWH), default=inf))
            used.append(max((g for g, x, _ in slots if x > DUST_KWH), default=-inf))
        totals = list(accumulate(session_charges_kwh(links, charge_kwh)))
        above_kwh = totals[-1] - links.lower_kwh[-1]
        return cls(
            problem.efficiency,
            free,
            used,
            [total - low < BINDING_KWH for total, low in zip(totals, links.lower_kwh, strict=True)],
            [high - total < BINDING_KWH for total, high in zip(totals, links.upper_kwh, strict=True)],
            problem.efficiency * _worth(problem, above_kwh + BINDING_KWH),
            problem.efficiency * _worth(problem, max(0.0, above_kwh - BINDING_KWH)),
        )

    def floor_price(self, s: int) -> Price:
        """Of the lower bound at the end of session `s`."""
        if not self.at_lower[s]:
            return Price()
        costs = self._more(s) / self.efficiency
        return Price(max(0.0, -self._less(s) / self.efficiency), None if costs == inf else max(0.0, costs))

    def ceiling_saves(self, s: int) -> float:
        """What one battery kWh more of the upper bound at the end of session `s` is worth."""
        return max(0.0, -self._more(s) / self.efficiency) if self.at_upper[s] else 0.0

    def _more(self, s: int) -> float:
        """Cost of one plug kWh more by the end of `s`: added up to it, taken back after it or left over."""
        return self._first(s, self.free, self.at_upper) + self._later(
            s, [-g for g in self.used], self.at_upper, -self.worth_above
        )

    def _less(self, s: int) -> float:
        """The same for one kWh less."""
        return self._first(s, [-g for g in self.used], self.at_lower) + self._later(
            s, self.free, self.at_lower, self.worth_below
        )

    def _first(self, s: int, costs: list[float], stops: list[bool]) -> float:
        """The least of `costs` in session `s` or before it, as far as no row stops the change on its way to `s`."""
        least = costs[s]
        for earlier in range(s - 1, -1, -1):
            if stops[earlier]:
                break
            least = min(least, costs[earlier])
        return least

    def _later(self, s: int, costs: list[float], stops: list[bool], end: float) -> float:
        """The least of `costs` after session `s`, or `end` where no row stops the change on its way there."""
        least = inf
        for later in range(s + 1, len(costs)):
            least = min(least, costs[later])
            if stops[later]:
                return least
        return min(least, end)


def _worth(problem: Problem, above_kwh: float) -> float:
    """g per battery kWh of the end value's step that `above_kwh` lies in; the first one's below its start."""
    for width_kwh, worth in problem.end_value:
        if above_kwh < width_kwh:
            return worth
        above_kwh -= width_kwh
    return 0.0


# -- what was moved -------------------------------------------------------------------------------


def _moves(problem: Problem, links: Chain, plan_kwh: list[float]) -> tuple[Move, ...]:
    """The plan against one that charges, night by night, only what its bounds ask by then. First in, first out."""
    least, _ = tube(links.lower_kwh, links.upper_kwh, links.session_room_kwh)
    asked_kwh = [now - before for now, before in zip(least, [0.0, *least], strict=False)]
    early: deque[tuple[int, float]] = deque()
    found: list[tuple[int, int | None, float]] = []
    for s, (charged_kwh, need_kwh) in enumerate(zip(session_charges_kwh(links, plan_kwh), asked_kwh, strict=True)):
        missing_kwh = need_kwh - charged_kwh
        if missing_kwh < -BINDING_KWH:
            early.append((s, -missing_kwh))
        while missing_kwh > BINDING_KWH and early:
            source, kwh = early.popleft()
            part_kwh = min(kwh, missing_kwh)
            missing_kwh -= part_kwh
            found.append((source, s, part_kwh))
            if kwh - part_kwh > BINDING_KWH:
                early.appendleft((source, kwh - part_kwh))
    found += [(source, None, kwh) for source, kwh in early]
    return tuple(_move(problem, links, plan_kwh, *move) for move in found)


def _move(problem: Problem, links: Chain, plan_kwh: list[float], charged: int, needed: int | None, kwh: float) -> Move:
    price = links.intensity_g_per_kwh
    own = range(links.starts[charged], links.starts[charged + 1])
    dearest = sorted(((price[i], plan_kwh[i]) for i in own), reverse=True)
    if needed is None:
        above_kwh = sum(plan_kwh) - links.lower_kwh[-1]
        instead = _worth(problem, max(0.0, above_kwh - BINDING_KWH)) * problem.efficiency
    else:
        other = range(links.starts[needed], links.starts[needed + 1])
        instead = _mean(sorted((price[i], links.room_kwh[i] - plan_kwh[i]) for i in other), kwh)
    return Move(kwh, charged, needed, _mean(dearest, kwh), instead)


def _mean(slots: list[tuple[float, float]], kwh: float) -> float:
    """Mean intensity of the first `kwh` of (intensity, battery kWh)."""
    left_kwh, total_g = kwh, 0.0
    for g, has_kwh in slots:
        part_kwh = min(max(0.0, has_kwh), left_kwh)
        total_g += g * part_kwh
        left_kwh -= part_kwh
    return total_g / (kwh - left_kwh) if kwh > left_kwh else 0.0
