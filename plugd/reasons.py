"""One sentence that says what plugd is doing and why, and the status word that goes with it."""

from datetime import datetime
from zoneinfo import ZoneInfo

from plugd import flow, soc
from plugd.beat import Action, Cause
from plugd.domain import Cut, Fault, Household, Memory, Mode, Outlook, Session, SessionPlan, Status, Switching
from plugd.units import to_pct

PLANNED_KWH = 0.05
"""Less than this in a session is nothing planned."""
SHORT = 0.005
"""A morning minimum missed by less is not spoken of: it would be "0 % short"."""
SLOW_SHARE = 0.9
"""Of the plug's power: a car that takes less is spoken of."""
UNPLANNED = ("clock", "safe_mode")
"""With one of these no plan counts."""
UNREACHED = ("plug_silent", "plug_refuses")
"""With one of these faults nothing of what is wanted may be happening."""
UNCONTROLLED = (*UNREACHED, "relay_stuck")
"""With one of these something else may be happening than what is wanted."""


def _percent(fraction: float) -> str:
    return f"{to_pct(fraction, 0):.0f} %"


def _clock(moment: datetime, household: Household) -> str:
    return f"{moment.astimezone(ZoneInfo(household.timezone)):%H:%M}"


def _night(session: Session, household: Household) -> str:
    return f"{session.start.astimezone(ZoneInfo(household.timezone)):%A} night"


def _grams(intensity: float | None) -> str:
    return "unknown g/kWh" if intensity is None else f"{intensity:.0f} g/kWh"


def _off(memory: Memory) -> str:
    mode_off = memory.overrides.mode is Mode.OFF
    return "Off because you switched it off" + (
        ": set the mode to smart to charge again." if mode_off else " at the plug, until the next plug-in."
    )


def _cut(cut: Cut, household: Household) -> str:
    return f"Switched off for safety: {flow.cut_text(cut, household)}."


def _asked(memory: Memory, household: Household) -> str:
    press, most = memory.press, f"up to {_percent(household.car.soc_max)}"
    how = "you asked" if press is None else "you switched it on at the plug"
    until = f", until {_clock(press.until, household)}" if press is not None and press.until else ""
    return f"Charging now because {how}, {most}{until} or until you say otherwise."


def _guarded(action: Action, household: Household) -> str:
    session = action.session
    end = _clock(session.end, household) if session else "the morning"
    minimum = _percent(session.minimum) if session else "the minimum"
    if action.verdict.late:
        return f"Late: it is past {end} and the car has not reached {minimum} yet; charging until it has."
    return f"Charging now: this is the last safe start for {minimum} by {end}."


def _doubt(memory: Memory) -> str:
    """Why it charges though the car may be full: nobody has ever said how full it is."""
    if memory.soc.told_at is not None or memory.soc.source != soc.ASSUMED:
        return ""
    return " Nobody has said yet how full the battery is, so little is counted on."


def stale_text(memory: Memory, household: Household) -> str:
    """What is counted on where the car has fallen silent. Only for one that used to speak."""
    told_at = memory.soc.told_at
    since = f"{told_at.astimezone(ZoneInfo(household.timezone)):%A %H:%M}" if told_at else "long ago"
    counted, estimated = _percent(soc.cautious(memory.soc)), _percent(memory.soc.mean)
    return (
        f"the car has said nothing new of how full it is since {since}; it is reckoned to be at {estimated}, and "
        f"{counted} is counted on until it does"
    )


def fraction_text(memory: Memory) -> str:
    """A word that is hardly a percentage."""
    said = memory.soc.car_said or 0.0
    return f"the car says it is at {to_pct(said, 2):g} %, and may mean {_percent(100.0 * said)}: see car.soc_unit"


def _slowly(memory: Memory, household: Household) -> str:
    """A car, or a cable, that takes less than the plug could give."""
    most_kw, seen_kw = household.capability.power_max_kw, memory.observed_kw
    if household.capability.modulating or seen_kw is None or seen_kw >= SLOW_SHARE * most_kw:
        return ""
    return f" It takes {seen_kw:.1f} kW, not {most_kw:.1f}, so more time is planned."


def _ends(outlook: Outlook | None, memory: Memory, now: datetime, household: Household) -> str:
    """What the plan uses where the forecast leaves off before the morning."""
    if outlook is None or not outlook.slots:
        return ""
    if outlook.forecast_until is None:
        return " There is no forecast at the moment: this plan uses the usual day."
    tonight = next(iter(_coming(now, memory)), None)
    if tonight is None or outlook.forecast_until >= tonight.session.end:
        return ""
    return f" The forecast ends at {_clock(outlook.forecast_until, household)}: the usual day counts from then on."


def _held(action: Action, memory: Memory, household: Household) -> str:
    """Why something other than the plan has the word."""
    match action.cause:
        case Cause.CUT:
            return "Switched off for safety." if memory.flow.cut is None else _cut(memory.flow.cut, household)
        case Cause.PERSON_OFF:
            return _off(memory)
        case Cause.WAKE:
            until = memory.flow.wake_until
            again = f" at {_clock(until, household)}" if until else ""
            return f"Off for a moment, to wake a car that takes nothing: on again{again}."
        case Cause.TIMER:
            return "Charging now: were plugd to die, the plug's own timer would end an off too late."
        case Cause.GUARD:
            return _guarded(action, household) + _doubt(memory) + _slowly(memory, household)
        case Cause.RESERVE:
            reserve = _percent(household.car.soc_min)
            return f"Charging now: the battery may be below the reserve of {reserve}." + _doubt(memory)
        case Cause.CONTESTED:
            until = memory.contested_until
            end = f" until {_clock(until, household)}" if until else ""
            return f"Something else switches this plug, so it is left as it is{end}; the last safe start counts still."
        case Cause.PERSON_ON:
            return _asked(memory, household)
        case _:
            return "The car is not plugged in."


def _shortfall(tonight: SessionPlan | None, household: Household) -> str:
    """What will be missing in the morning, in the household's words."""
    short = 0.0 if tonight is None else tonight.shortfall_kwh / household.car.capacity_kwh
    if tonight is None or short < SHORT:
        return ""
    end = _clock(tonight.session.end, household)
    counted, minimum = _percent(tonight.soc_end), _percent(tonight.session.minimum)
    return f" Only {counted} can be counted on by {end}, {_percent(short)} short of {minimum}."


def at_risk(now: datetime, memory: Memory, household: Household, faults: tuple[Fault, ...]) -> bool | None:
    """Whether the next morning may find less than its minimum; None where nothing is planned."""
    tonight = next(iter(_coming(now, memory)), None)
    if tonight is None:
        return None
    lacking = soc.cautious(memory.soc) < tonight.session.minimum
    unreached = any(fault.code in UNREACHED for fault in faults)
    return bool(_shortfall(tonight, household)) or (lacking and unreached)


def _starts(now: datetime, tonight: SessionPlan, memory: Memory) -> datetime | None:
    """When power is to flow next, by the relay's orders or else by the plan itself."""
    if isinstance(memory.orders, Switching):
        return memory.orders.next(now, True)
    return next((slot.start for slot in tonight.slots if slot.start > now and slot.power_kw > 0.0), None)


def _planned(now: datetime, action: Action, memory: Memory, household: Household) -> tuple[Status, str]:
    """Status and reason where the plan has the word."""
    coming = _coming(now, memory)
    if not coming:
        return Status.READY, "Nothing to do: no night at home is expected."
    tonight, later = coming[0], coming[1:]
    short = _shortfall(tonight, household)
    short += _doubt(memory) if short else ""
    nights = f"the next {len(coming)} nights" if later else "tonight"
    grams = _grams(tonight.intensity_g_per_kwh)
    if action.on:
        stop = memory.orders.next(now, False) if isinstance(memory.orders, Switching) else None
        until = f" until {_clock(stop, household)}" if stop else ""
        if not any(slot.start <= now < slot.end and slot.power_kw > 0.0 for slot in tonight.slots):
            return Status.CHARGING, f"On{until}: a relay stays on for a while once it is on.{short}"
        short += _slowly(memory, household)
        return Status.CHARGING, f"Charging{until} at {grams}, among the cleanest hours of {nights}.{short}"
    if tonight.energy_kwh > PLANNED_KWH:
        start = _starts(now, tonight, memory)
        if start is not None:
            word = f"Waiting until {_clock(start, household)}: {grams} then, among the cleanest hours of {nights}."
            return Status.WAITING, word + short
    cleaner = next((s for s in later if s.energy_kwh > PLANNED_KWH), None)
    if cleaner is not None:
        word = (
            f"Holding for {_night(cleaner.session, household)}: {_grams(cleaner.intensity_g_per_kwh)} then, and "
            f"{_percent(memory.soc.mean)} is enough for {_percent(tonight.session.minimum)} in the morning."
        )
        return Status.HOLDING, word + short
    return Status.READY, f"Ready: at {_percent(memory.soc.mean)} nothing needs charging for {nights}.{short}"


_STATUS = {
    Cause.CUT: Status.FAULT,
    Cause.WAKE: Status.WAITING,
    Cause.TIMER: Status.CHARGING,
    Cause.PERSON_OFF: Status.OFF,
    Cause.GUARD: Status.CHARGING,
    Cause.RESERVE: Status.CHARGING,
    Cause.PERSON_ON: Status.BOOSTING,
    Cause.ABSENT: Status.DISCONNECTED,
    Cause.CONTESTED: Status.FAULT,
}


def _coming(now: datetime, memory: Memory) -> tuple[SessionPlan, ...]:
    """What the plan says of sessions that are not over."""
    return tuple(s for s in memory.plan.sessions if s.session.end > now) if memory.plan else ()


def _decided(
    now: datetime, action: Action, memory: Memory, outlook: Outlook | None, household: Household
) -> tuple[Status, str]:
    """Status and reason with a plug that does as it is told."""
    if action.cause is not Cause.PLAN:
        short = ""
        if action.on and not action.verdict.late:
            short = _shortfall(next(iter(_coming(now, memory)), None), household)
        return _STATUS[action.cause], _held(action, memory, household) + short
    status, reason = _planned(now, action, memory, household)
    if outlook is not None and outlook.forecast_until is None and status is Status.HOLDING:
        status = Status.WAITING_FOR_FORECAST
    return status, reason + _ends(outlook, memory, now, household)


def explain(
    now: datetime,
    action: Action,
    memory: Memory,
    outlook: Outlook | None,
    household: Household,
    faults: tuple[Fault, ...] = (),
) -> tuple[Status, str]:
    """The status and the sentence. They follow from the decision; nothing is decided here."""
    status, reason = _decided(now, action, memory, outlook, household)
    broken = next((fault.text for fault in faults if fault.code in UNCONTROLLED), None)
    if action.on and flow.is_idle(now, memory, household):
        found = flow.idle_text(memory, household)
        found += "; look at its charge limit, its timer and the cable" if memory.presence.connected else ""
        status = Status.FAULT if memory.presence.connected else status
        reason = f"{found[0].upper()}{found[1:]}. {reason}"
    unset = next((fault.text for fault in faults if fault.code in UNPLANNED), None)
    if unset is not None and action.cause not in (Cause.CUT, Cause.PERSON_OFF):
        status, reason = Status.FAULT, f"{unset[0].upper()}{unset[1:]}."
    if broken is None:
        return status, reason
    return Status.FAULT, f"The plug is not under control: {broken}. Wanted: {reason}"
