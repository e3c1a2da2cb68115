"""What a reading and the passing of time do to memory: SOC, presses at the plug, what has run out."""

from dataclasses import replace
from datetime import datetime, timedelta

from plugd import contest, flow, habits, sessions, soc
from plugd.beat import next_plug_in
from plugd.domain import Household, Memory, Mode, Press, Reading, Setpoint, SocEstimate

SMOOTHING = 0.2
PLAUSIBLE_SHARE = (0.3, 1.2)
"""Of the configured power: outside it a reading says nothing about what the car takes."""
LEAST_CAR_KW = 1.0
"""No car's charger takes less (6 A): so much says something, however much power was configured."""
ALL_SHARE = 0.95
"""Of a setpoint: a car that takes this much of it is not at a limit of its own."""
TAPER_SOC = 0.9
"""Above it a car takes less because it is nearly full, which is no sign for another night."""
BUDGET_SPAN = timedelta(hours=24)


def fresh(now: datetime) -> Memory:
    """The memory of a first start."""
    return Memory(soc=soc.unknown(now))


def perceive(now: datetime, reading: Reading | None, memory: Memory, household: Household) -> Memory:
    """Memory after looking at the plug and the time. Without a reading only time passes."""
    before = memory
    homecomings = sessions.drives(household, memory.overrides, memory.presence, memory.soc.driven_to, now)
    memory = replace(
        memory,
        soc=soc.driven(memory.soc, homecomings, household.car),
        switch_ons=tuple(at for at in memory.switch_ons if now - at < BUDGET_SPAN),
    )
    if reading is not None:
        memory = _seen(now, reading, memory, household)
    return _run_out(now, habits.observed(now, before, memory, household), household)


def _seen(now: datetime, reading: Reading, memory: Memory, household: Household) -> Memory:
    """What the plug itself tells.

    One that said "on" and gave nothing, and says "off" now, has only come to tell the truth: nobody pressed. Where that
    "on" looked like a press, the press is taken back, and no more.
    """
    power_kw = household.capability.power_max_kw
    only_tried = _only_tried(memory)
    idle = flow.is_idle(now, memory, household) and not flow.has_stopped(now, memory.flow)
    never_flowed = idle and memory.press is None
    memory = flow.seen(now, reading, memory, household)
    memory = replace(memory, observed_kw=_observed_kw(reading, memory, household))
    held_back = isinstance(memory.orders, Setpoint) and memory.orders.power_kw < power_kw
    metered = soc.metered(memory.soc, reading, household.car, power_kw, held_back=held_back)
    memory = replace(memory, soc=metered)
    memory = replace(memory, soc=_told_soc(reading, memory.soc))
    if reading.changed_by_other is not None and not (never_flowed and reading.changed_by_other is False):
        taken_back = only_tried and not reading.changed_by_other
        memory = (
            replace(memory, press=None) if taken_back else _pressed(now, reading.changed_by_other, memory, household)
        )
        memory = replace(contest.moved(now, memory), moved_over=reading.changed_over)
    if reading.on is not memory.relay_on:
        # Seen for the first time, it may have been so for long: no dwell time is due.
        since = None if memory.relay_on is None else reading.at
        memory = replace(memory, relay_on=reading.on, relay_since=since)
    return memory


def _told_soc(reading: Reading, known: SocEstimate) -> SocEstimate:
    """A battery that tells its charger how full it is knows better than anybody."""
    if reading.soc is None or reading.soc_at is None:
        return known
    if known.told_at is not None and reading.soc_at <= known.told_at:
        return known
    return soc.told(known, reading.soc, reading.soc_at, "car")


def _only_tried(memory: Memory) -> bool:
    """Whether a press has switched the relay on, nothing has flowed yet, and nobody wanted it off before."""
    press, power = memory.press, memory.flow
    gave_nothing = power.idle_since is not None and not power.flowed
    return press is not None and press.on and not press.after_off and gave_nothing


def _pressed(now: datetime, on: bool, memory: Memory, household: Household) -> Memory:
    """A person's word at the plug counts for this stay, and takes back the opposite one said elsewhere."""
    opposite, before = Mode.OFF if on else Mode.NOW, memory.press
    mode = Mode.SMART if memory.overrides.mode is opposite else memory.overrides.mode
    off_before = memory.overrides.mode is Mode.OFF or (before is not None and not before.on)
    # An off ends at the next plug-in: the told one, where anybody tells of them.
    told = memory.presence.connected is not None
    off_until = None if told else next_plug_in(now, memory, household)
    until = _stay_end(now, memory, household) if on else off_until
    return replace(
        memory,
        overrides=replace(memory.overrides, mode=mode),
        press=Press(on, until, after_off=on and off_before),
        flow=replace(memory.flow, wake_until=None),
    )


def _stay_end(now: datetime, memory: Memory, household: Household) -> datetime | None:
    """When the car has left, as far as expected: the end of the stay under way, else of the next."""
    stays = sessions.windows(household, memory.overrides, now - sessions.DAY)
    return next((stay.late_plug_out for stay in stays if stay.late_plug_out > now), None)


def _observed_kw(reading: Reading, memory: Memory, household: Household) -> float | None:
    """The power the car really takes, smoothed over readings."""
    configured_kw = household.capability.power_max_kw
    low, high = (share * configured_kw for share in PLAUSIBLE_SHARE)
    power_kw, known_kw = reading.power_kw, memory.observed_kw
    new = reading.metered_at is not None and reading.metered_at != memory.soc.metered_at
    if not (new and reading.on and power_kw is not None and min(low, LEAST_CAR_KW) <= power_kw <= high):
        return known_kw
    if memory.soc.mean > min(TAPER_SOC, household.car.taper_from):
        return known_kw
    offered_kw = memory.orders.power_kw if isinstance(memory.orders, Setpoint) else configured_kw
    believed_kw = configured_kw if known_kw is None else known_kw
    if offered_kw < configured_kw and ALL_SHARE * offered_kw <= power_kw <= believed_kw:
        return known_kw  # it takes what it is given, and may take more
    return power_kw if known_kw is None else known_kw + SMOOTHING * (power_kw - known_kw)


def _run_out(now: datetime, memory: Memory, household: Household) -> Memory:
    """End what ends by itself: a person's on at the battery's limit, a press at the session's end too, a trip with
    its day."""
    if any(trip.day < sessions.today(now, household) for trip in memory.overrides.trips):
        trips = tuple(trip for trip in memory.overrides.trips if trip.day >= sessions.today(now, household))
        memory = replace(memory, overrides=replace(memory.overrides, trips=trips))
    memory = replace(memory, soc=soc.aged(memory.soc, now, household.car))
    press, full = memory.press, memory.soc.mean >= household.car.soc_max
    if memory.overrides.mode is Mode.NOW and full:
        memory = replace(memory, overrides=replace(memory.overrides, mode=Mode.SMART))
    if press is not None and ((press.on and full) or (press.until is not None and now >= press.until)):
        memory = replace(memory, press=None)
    return memory
