"""The default window: where nothing at all is known of the grid, charging is planned there first.

That is before the first forecast, and without any history: a house that has never had a network. Charge points in
Great Britain have to keep out of the weekdays' peak then. It is a wish, no bound: what the minimum needs beyond it,
it gets.
"""

from dataclasses import replace
from datetime import datetime, time
from zoneinfo import ZoneInfo

from plugd.domain import Household, Intensity, Outlook
from plugd.planner.nights import Part
from plugd.planner.problem import Problem

DEARER_G_PER_KWH = 500.0
"""By so much a half hour outside counts as dirtier: more than the usual day has between its best and its worst."""


def preferred(
    asked: Problem, parts: tuple[Part, ...], outlook: Outlook, history: tuple[Intensity, ...], household: Household
) -> Problem:
    """The problem to solve in place of `asked`, which it is where anything is known."""
    if outlook.forecast_until is not None or history:
        return asked
    sessions = []
    for session, part in zip(asked.sessions, parts, strict=True):
        outside = (DEARER_G_PER_KWH * (not holds(slot, household)) for slot in part.slots)
        dearer = tuple(g + more for g, more in zip(session.intensity_g_per_kwh, outside, strict=True))
        sessions.append(replace(session, intensity_g_per_kwh=dearer))
    return replace(asked, sessions=tuple(sessions))


def holds(moment: datetime, household: Household) -> bool:
    """Whether a moment is in the window, which may go over midnight."""
    begin, end = household.nights.default_window
    clock: time = moment.astimezone(ZoneInfo(household.timezone)).time()
    return begin <= clock < end if begin < end else clock >= begin or clock < end
