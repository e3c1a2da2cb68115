"""Somebody else switches the plug: one change is a person's word, a second one of a mind that changed, and
a third within ten minutes is another controller's. Pure.

While two fight over it plugd lets go: the relay stays as it is for half an hour. Only the guard may act then, and it
waits for ten quiet minutes: its margin is four times as long, and a relay that goes to and fro helps nobody.
"""

from dataclasses import replace
from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

from plugd.domain import Fault, Household, Memory

SPAN = timedelta(minutes=10)
MOST_PRESSES = 2
"""More changes within that time are no person's."""
YIELDS = timedelta(minutes=30)
QUIET = timedelta(minutes=10)


def moved(now: datetime, memory: Memory) -> Memory:
    """The relay was moved by neither plugd nor the plug's own timer. In a fight no press counts any more."""
    recent = (*(at for at in memory.moved if timedelta(0) <= now - at < SPAN), now)
    memory = replace(memory, moved=recent)
    if len(recent) <= MOST_PRESSES:
        return memory
    return replace(memory, press=None, contested_until=now + YIELDS)


def fought(now: datetime, memory: Memory) -> bool:
    """Whether plugd yields. An end too far ahead is from before the clock was set back."""
    until = memory.contested_until
    return until is not None and timedelta(0) < until - now <= YIELDS


def quiet_at(now: datetime, memory: Memory) -> datetime | None:
    """From when on the guard may act all the same; None where it may."""
    if not fought(now, memory) or not memory.moved:
        return None
    quiet = memory.moved[-1] + QUIET
    return quiet if quiet > now else None


def faults(now: datetime, memory: Memory, household: Household) -> tuple[Fault, ...]:
    """What a person should look for."""
    if not fought(now, memory) or memory.contested_until is None:
        return ()
    last, until = (
        f"{moment.astimezone(ZoneInfo(household.timezone)):%H:%M}"
        for moment in (memory.moved[-1], memory.contested_until)
    )
    whose = f" over {memory.moved_over}" if memory.moved_over else ""
    text = (
        f"something else switches this plug{whose}, last at {last}: look for an automation, a timer or an app, and "
        f"leave the plug to one of the two; until {until} only the last safe start can switch it"
    )
    return (Fault("fought_over", text),)
