"""Bounds on the cumulative charge, made feasible before any solver sees them.

SOC only rises inside a session, so bounds at session ends say everything (paper eqs. 4 to 6 summed along the
chain): `lower_s <= charge_1 + ... + charge_s <= upper_s`, in battery kWh. What cannot be reached is cut from
the lower bounds, and an upper bound that no charger could keep (the battery is above it already, or an
earlier minimum takes it there) is lifted. What was cut shows as the shortfall of the answer.
"""

from dataclasses import dataclass
from itertools import compress
from operator import mul

from plugd.planner.problem import Problem, Series

DUST_KWH = 1e-9
"""Less than this is rounding, not energy."""


@dataclass(frozen=True, slots=True)
class Chain:
    """A problem flattened: one value per slot over all sessions, and the repaired bounds at session ends."""

    intensity_g_per_kwh: list[float]
    room_kwh: list[float]
    """Battery kWh that each slot can take."""
    starts: list[int]
    """Index of each session's first slot, then the number of slots, (N + 1,)."""
    session_room_kwh: list[float]
    lower_kwh: list[float]
    """Repaired L_s. Negative where the battery holds more. The end value counts from the last."""
    upper_kwh: list[float]
    """Repaired U_s, never negative."""
    lifted: bool
    """Some upper bound was lifted by more than rounding."""


def chain(problem: Problem) -> Chain:
    """Flatten `problem` and repair its bounds; the result is always feasible."""
    efficiency, last = problem.efficiency, len(problem.sessions) - 1
    intensity: list[float] = []
    room: list[float] = []
    power_kw: Series = ()
    slot_h: Series = ()
    rooms: list[float] = []
    rooms_kwh = 0.0
    starts, session_room, lowers, uppers = [0], [], [], []
    offset_kwh = -problem.energy_kwh  # added to a battery level: what it is as cumulative charge
    for number, session in enumerate(problem.sessions):
        if session.power_max_kw != power_kw or session.slot_h != slot_h:  # most nights are alike
            power_kw, slot_h = session.power_max_kw, session.slot_h
            rooms = [efficiency * kwh for kwh in map(mul, power_kw, slot_h)]
            rooms_kwh = sum(rooms)
        intensity += session.intensity_g_per_kwh
        room += rooms
        starts.append(len(room))
        session_room.append(rooms_kwh)
        level_kwh = session.minimum_kwh
        if number < last:  # paper eq. 4: nothing binds on arrival after the last session
            level_kwh = max(level_kwh, problem.reserve_kwh + session.daily_use_kwh)
        lowers.append(level_kwh + offset_kwh)
        uppers.append(session.ceiling_kwh + offset_kwh)
        offset_kwh += session.daily_use_kwh
    lower, upper = repair(lowers, uppers, session_room)
    lifted = any(kept > asked + DUST_KWH for kept, asked in zip(upper, uppers, strict=True))
    return Chain(intensity, room, starts, session_room, lower, upper, lifted)


def repair(lower: list[float], upper: list[float], room: list[float]) -> tuple[list[float], list[float]]:
    """Bounds on a cumulative charge that can be kept together, all (N,), in the unit of `room` per session.

    One forward pass. With M_s the most that can be in by the end of session s:
    U_s = max(U_s, 0, every earlier repaired L), M_s = min(M_{s-1} + room_s, U_s), L_s = min(L_s, M_s).
    """
    lowers, uppers = [], []
    reach = floor = 0.0
    for low, high, more in zip(lower, upper, room, strict=True):
        kept_high = max(high, floor)
        reach = min(reach + more, kept_high)
        kept_low = min(low, reach)
        floor = max(floor, kept_low)
        lowers.append(kept_low)
        uppers.append(kept_high)
    return lowers, uppers


def tube(lower_kwh: list[float], upper_kwh: list[float], room_kwh: list[float]) -> tuple[list[float], list[float]]:
    """The least and the most that can be in by each session's end if every bound is to be kept, (N,) each.

    From any point between them the next can be reached. Arguments (N,): repaired bounds, room per session.
    """
    least, most = [], []
    low_kwh = high_kwh = 0.0
    for lower, upper, room in zip(lower_kwh, upper_kwh, room_kwh, strict=True):
        low_kwh, high_kwh = max(low_kwh, lower), min(high_kwh + room, upper)
        least.append(low_kwh)
        most.append(high_kwh)
    for s in range(len(least) - 2, -1, -1):
        least[s] = max(least[s], least[s + 1] - room_kwh[s + 1])
        most[s] = min(most[s], most[s + 1])
    return least, most


def session_charges_kwh(links: Chain, charge_kwh: list[float]) -> list[float]:
    """Battery kWh charged in each session, (N,)."""
    return [sum(charge_kwh[first:end]) for first, end in zip(links.starts, links.starts[1:], strict=False)]


def end_value_g(problem: Problem, above_kwh: float) -> float:
    """Worth in g of `above_kwh` battery kWh above the last session end's repaired lower bound; concave."""
    value_g = 0.0
    for width_kwh, worth_g_per_kwh in problem.end_value:
        if above_kwh <= 0:
            break
        part_kwh = min(width_kwh, above_kwh)
        value_g += part_kwh * worth_g_per_kwh
        above_kwh -= part_kwh
    return value_g


def powers_kw(problem: Problem, charge_kwh: list[float]) -> tuple[Series, ...]:
    """Power at the plug, per session and slot, for battery kWh per slot (n,); within limits."""
    powers, first = [], 0
    for session in problem.sessions:
        end = first + len(session.slot_h)
        own = [0.0] * (end - first)
        charged = charge_kwh[first:end]
        for k in compress(range(end - first), charged):
            if charged[k] > DUST_KWH and session.slot_h[k] > 0:
                own[k] = min(charged[k] / (problem.efficiency * session.slot_h[k]), session.power_max_kw[k])
        powers.append(tuple(own))
        first = end
    return tuple(powers)
