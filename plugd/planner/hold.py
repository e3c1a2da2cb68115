"""A plan that holds still: the slot under way and the next keep what they had, unless moving saves enough.

Every new forecast moves the cheapest slots a little, and a relay that follows all of it wears out for grams. So where
the last plan charges in one of these two slots, it counts as some g/kWh cleaner than it is: energy leaves it only for
slots cleaner by more than that. Later slots move as they like: nothing has been switched there yet.
"""

from dataclasses import replace
from datetime import datetime

from plugd.domain import Household
from plugd.planner.nights import Part
from plugd.planner.problem import Problem, ProblemSession, Solution
from plugd.units import HALF_HOUR, next_slot

KEPT_SHARE = 0.5
"""Of what a slot can have: a slot that had less in the last plan is not held."""


def held(asked: Problem, parts: tuple[Part, ...], now: datetime, household: Household) -> Problem:
    """The problem to solve in place of `asked`. Where nothing is held it is `asked` itself.

    A relay is spared; a charger changes its power without wear.
    """
    hold_g_per_kwh = household.relay.hold_g_per_kwh
    if asked.previous_power_kw is None or hold_g_per_kwh <= 0.0 or household.capability.modulating:
        return asked
    until = next_slot(now) + HALF_HOUR
    sessions = []
    for session, part, before_kw in zip(asked.sessions, parts, asked.previous_power_kw, strict=True):
        kept = [
            piece.end > now and piece.start < until and 0.0 < KEPT_SHARE * piece.limit_kw <= kw
            for piece, kw in zip(part.pieces, before_kw, strict=True)
        ]
        cheaper = tuple(g - hold_g_per_kwh * k for g, k in zip(session.intensity_g_per_kwh, kept, strict=True))
        sessions.append(replace(session, intensity_g_per_kwh=cheaper) if any(kept) else session)
    found = tuple(sessions)
    return asked if found == asked.sessions else replace(asked, sessions=found)


def let_go(asked: Problem, stated: Problem, solution: Solution) -> tuple[Problem, Solution]:
    """What was solved and its solution with the carbon as it is: every slot with the intensity it had in `asked`."""
    pairs = zip(stated.sessions, asked.sessions, strict=True)
    if all(solved.intensity_g_per_kwh is own.intensity_g_per_kwh for solved, own in pairs):
        return stated, solution
    sessions = tuple(
        replace(solved, intensity_g_per_kwh=own.intensity_g_per_kwh)
        for solved, own in zip(stated.sessions, asked.sessions, strict=True)
    )
    carbon_g = sum(_carbon_g(own, kw) for own, kw in zip(sessions, solution.power_kw, strict=True))
    return replace(stated, sessions=sessions), replace(solution, carbon_g=carbon_g)


def _carbon_g(session: ProblemSession, power_kw: tuple[float, ...]) -> float:
    return sum(g * p * h for g, p, h in zip(session.intensity_g_per_kwh, power_kw, session.slot_h, strict=True))
