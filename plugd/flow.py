"""What flows at a plain plug, beside what should: too much is cut, a sleeping car woken, a stuck relay noticed.

A modulating charger is told how much it may take, and is not watched here. Pure.
"""

from dataclasses import replace
from datetime import date, datetime, timedelta
from zoneinfo import ZoneInfo

from plugd.domain import Cut, Fault, Flow, Household, Leak, Memory, Reading, Session
from plugd.soc import FLOWING_KW
from plugd.units import amps_of

OVER = timedelta(seconds=60)
"""So long may more flow than the socket bears: a car that starts, a meter that settles."""
LOOK = timedelta(seconds=10)
"""While too much flows, or something through an open relay, the meter is looked at this often."""
LEAKS = timedelta(seconds=30)
"""So long after its relay opened may a plug still tell of power: it measures now and then."""
IDLE = timedelta(seconds=120)
"""A car that is awake takes power by then."""
STOPPED = timedelta(hours=12)
"""A car that stopped by itself is not woken for this long: it is full, or at a limit of its own."""
WAKE_SLACK = timedelta(seconds=60)
"""How late the relay may go on again and still do so for the car's waking."""


def amperes(reading: Reading, household: Household) -> float | None:
    """The current at the plug: told, else reckoned from the power. None where neither is known."""
    if reading.current_a is not None or reading.power_kw is None:
        return reading.current_a
    return amps_of(reading.power_kw, household.mains_voltage_v)


def seen(now: datetime, reading: Reading, memory: Memory, household: Household) -> Memory:
    """Memory after a look at what flows."""
    if household.capability.modulating:
        return memory
    found = replace(_over(now, reading, memory.flow, household), leak=_leak(now, reading, memory.flow.leak))
    on_since = now if reading.came_back else _on_since(now, memory)
    return replace(memory, flow=_idle(now, reading, found, on_since))


def _over(now: datetime, reading: Reading, flow: Flow, household: Household) -> Flow:
    """Too much flows, for how long, and when that is enough. What is cut already stays as it was."""
    flowing_a, limit_a = amperes(reading, household), household.max_current_a
    if limit_a is None or flowing_a is None or flow.cut is not None:
        return flow
    if flowing_a <= limit_a:
        return replace(flow, over_since=None, over_metered_at=None)
    if flow.over_since is None or flow.over_since > now:  # the clock may have been set back
        return replace(flow, over_since=now, over_metered_at=reading.metered_at)
    told_twice = reading.metered_at is None or reading.metered_at != flow.over_metered_at
    if now - flow.over_since < OVER or not told_twice:
        return flow
    return replace(flow, over_since=None, over_metered_at=None, cut=Cut(now, flowing_a, limit_a))


def _leak(now: datetime, reading: Reading, leak: Leak | None) -> Leak | None:
    """Power through a relay that says off. The meter's total, where there is one, must rise too."""
    if reading.on or reading.power_kw is None:
        return None if reading.on else leak
    if reading.power_kw < FLOWING_KW:
        return None
    if leak is None or leak.since > now:  # the clock may have been set back
        return Leak(now, reading.metered_at, reading.energy_kwh, reading.power_kw)
    told_twice = reading.metered_at is None or reading.metered_at != leak.metered_at
    totals = leak.energy_kwh is not None and reading.energy_kwh is not None
    rises = not totals or reading.energy_kwh != leak.energy_kwh
    sure = leak.sure or (now - leak.since >= LEAKS and told_twice and rises)
    return replace(leak, power_kw=reading.power_kw, sure=sure)


def leaks(leak: Leak | None) -> bool:
    """Whether power flows for certain through a relay that says off."""
    return leak is not None and leak.sure


def _on_since(now: datetime, memory: Memory) -> datetime:
    """Since when power could flow into this car: also where plugd was started anew since, and has not looked yet."""
    moments = (memory.relay_since, memory.presence.since if memory.presence.connected else None)
    known = [moment for moment in moments if moment is not None]
    return min(now, max(known)) if memory.relay_on and known else now


def _idle(now: datetime, reading: Reading, flow: Flow, on_since: datetime) -> Flow:
    """Whether something flows while the relay is on, and whether the car stopped by itself."""
    if flow.wake_until is not None and now >= flow.wake_until and (reading.on or now > flow.wake_until + WAKE_SLACK):
        flow = replace(flow, wake_until=None)
    if reading.came_back:  # what flowed before a power cut says nothing of the relay now
        flow = replace(flow, idle_since=None, flowed=False)
    if not reading.on:
        return replace(flow, idle_since=None, flowed=False)
    if reading.power_kw is None:
        return flow
    if reading.power_kw >= FLOWING_KW:
        return replace(flow, idle_since=None, flowed=True, stopped_at=None)
    began = flow.idle_since if flow.idle_since is not None and flow.idle_since <= now else None
    if began is None:
        began = now if flow.flowed else on_since
    stopped_at = began if flow.flowed and flow.stopped_at is None else flow.stopped_at
    return replace(flow, idle_since=began, stopped_at=stopped_at)


def is_idle(now: datetime, memory: Memory, household: Household) -> bool:
    """The relay is on, and for two minutes nothing has flowed into a car that is not full, and may be there."""
    since = memory.flow.idle_since
    full = memory.soc.mean >= household.car.soc_max
    return since is not None and now - since >= IDLE and not full and memory.presence.connected is not False


def _morning(now: datetime, session: Session | None) -> date:
    return (now if session is None else session.end).date()


def sleeps(now: datetime, session: Session | None, memory: Memory, household: Household) -> bool:
    """Nothing has flowed since the relay went on, the car did not stop by itself, and nobody has tried to wake it.

    The relay stays on for its least time first, as after any switch-on.
    """
    flow = memory.flow
    if flow.idle_since is None or now - flow.idle_since < _patience(household):
        return False
    tried = flow.woken_for == _morning(now, session)
    return is_idle(now, memory, household) and not (has_stopped(now, flow) or tried)


def has_stopped(now: datetime, flow: Flow) -> bool:
    """Whether the car has taken power since the relay went on, or stopped by itself earlier in this stay."""
    return flow.flowed or (flow.stopped_at is not None and timedelta(0) <= now - flow.stopped_at < STOPPED)


def waking(now: datetime, flow: Flow) -> bool:
    """The relay is off to wake the car."""
    return flow.wake_until is not None and now < flow.wake_until


def wake(now: datetime, session: Session | None, memory: Memory, household: Household) -> Memory:
    """Begin the one off-on cycle of this session; the relay rests as long as after any off."""
    until = now + timedelta(seconds=household.relay.min_off_s)
    flow = replace(
        memory.flow,
        wake_until=until,
        woken_for=_morning(now, session),
        wakes=memory.flow.wakes + 1,
        idle_since=None,
    )
    return replace(memory, flow=flow)


def _patience(household: Household) -> timedelta:
    """How long a car may take nothing before it is woken."""
    return max(IDLE, timedelta(seconds=household.relay.min_on_s))


def next_look(now: datetime, flow: Flow, household: Household) -> datetime | None:
    """When to look again for what flows, None where nothing is in question."""
    if flow.over_since is not None or (flow.leak is not None and not flow.leak.sure):
        return now + LOOK
    if flow.idle_since is None:
        return None
    moments = (flow.idle_since + IDLE, flow.idle_since + _patience(household))
    return min((moment for moment in moments if moment > now), default=None)


def anew(memory: Memory) -> Memory:
    """The car has just been plugged in: it may be another's, and is woken again if need be. A cut stays."""
    flow = replace(memory.flow, flowed=False, stopped_at=None, woken_for=None, idle_since=None)
    return replace(memory, flow=flow)


def _clock(moment: datetime, household: Household) -> str:
    return f"{moment.astimezone(ZoneInfo(household.timezone)):%H:%M}"


def _cut_seen(cut: Cut, household: Household) -> str:
    flowed = f"{cut.current_a:.1f} A flowed at {_clock(cut.at, household)}"
    return f"{flowed}, more than plug.max_current_a = {cut.limit_a:g}"


def cut_text(cut: Cut, household: Household) -> str:
    """Why it was cut, and what to do."""
    remedy = "look at plug, socket and cable, then set the mode to off, and to smart again"
    return f"{_cut_seen(cut, household)}; {remedy}"


def idle_text(memory: Memory, household: Household) -> str:
    """What it may be that nothing flows, as far as it can be known. Only where it is idle."""
    since = memory.flow.idle_since
    when = f"since {_clock(since, household)}" if since is not None else "for now"
    if memory.presence.connected:
        tried = ", and switching off and on has not woken it" if memory.flow.woken_for is not None else ""
        how = "has stopped taking power" if memory.flow.flowed else "takes nothing"
        return f"the car is plugged in and {how} {when} though the relay is on{tried}"
    if memory.flow.flowed:
        return f"the car has taken nothing {when}: it is at a limit of its own, or unplugged"
    return f"no car, or the car does not charge: nothing has flowed {when} though the relay is on"


def faults(now: datetime, memory: Memory, household: Household) -> tuple[Fault, ...]:
    """What a person should look at."""
    found = []
    if memory.flow.cut is not None:
        found.append(Fault("overcurrent", _cut_seen(memory.flow.cut, household)))
    if memory.presence.connected and is_idle(now, memory, household):
        found.append(Fault("no_current", idle_text(memory, household)))
    return tuple(found)
