"""A battery that takes less as it fills: what it can take in a slot, from the SOC expected then.

Up to `taper_from` the whole power flows; from there it falls in a straight line to `taper_share` of it when full.
So the energy follows de/dt = efficiency * power * (1 - k (e - e_from)), which has a closed form: the mean power of
a slot, not the one it begins with (at 10 kW half an hour is a tenth of the battery).
"""

from collections.abc import Iterator
from dataclasses import replace
from math import exp, log

from plugd.domain import Car
from plugd.planner.problem import Problem, ProblemSession, Series, Solution, Solver
from plugd.units import within

FREE_PASSES = 3
"""From then on limits only fall, so that they come to rest."""
MAX_PASSES = 10
REST_KW = 0.005


def reached_kwh(car: Car, energy_kwh: float, power_kw: float, for_h: float) -> float:
    """Battery energy after `for_h` hours at all that `power_kw` at the plug can give."""
    rate_kw = car.efficiency * power_kw
    knee_kwh = car.taper_from * car.capacity_kwh
    if rate_kw <= 0.0 or for_h <= 0.0:
        return energy_kwh
    if car.taper_from >= 1.0 or car.taper_share >= 1.0:
        return energy_kwh + rate_kw * for_h
    to_knee_h = max(0.0, knee_kwh - energy_kwh) / rate_kw
    if to_knee_h >= for_h:
        return energy_kwh + rate_kw * for_h
    k = (1.0 - car.taper_share) / (car.capacity_kwh - knee_kwh)
    # Above full, where an estimate may stray, the last share still flows: never a power below 0.
    above_kwh = min(max(energy_kwh, knee_kwh) - knee_kwh, car.capacity_kwh - knee_kwh)
    gained_kwh = (1.0 / k - above_kwh) * (1.0 - exp(-rate_kw * k * (for_h - to_knee_h)))
    return max(energy_kwh, knee_kwh) + gained_kwh


def flat_kwh(car: Car, energy_kwh: float, target_kwh: float) -> float:
    """What the full power would have given in the time that it takes from `energy_kwh` to `target_kwh`, battery kWh.

    The inverse of `reached_kwh`, whatever the power: as the car takes less, its time stretches. Below 0 where there
    is more than the target.
    """
    missing_kwh = target_kwh - energy_kwh
    knee_kwh = car.taper_from * car.capacity_kwh
    if car.taper_from >= 1.0 or car.taper_share >= 1.0 or missing_kwh <= 0.0 or target_kwh <= knee_kwh:
        return missing_kwh
    width_kwh = car.capacity_kwh - knee_kwh
    k = (1.0 - car.taper_share) / width_kwh
    first_kwh, last_kwh = (within(0.0, kwh - knee_kwh, width_kwh) for kwh in (energy_kwh, target_kwh))
    return max(0.0, knee_kwh - energy_kwh) + log((1.0 - k * first_kwh) / (1.0 - k * last_kwh)) / k


def limits_kw(car: Car, asked: Problem, power_kw: tuple[Series, ...], *, taken: bool = False) -> tuple[Series, ...]:
    """The most each slot can be given at the SOC that `power_kw` leads to.

    With `taken` only what the car can take of these powers counts, else they are believed, as a plan believes
    itself. Shapes: one series per session, one value per slot, as in `asked`.
    """
    return tuple(_expected(car, asked, power_kw, taken=taken))


def _expected(car: Car, asked: Problem, power_kw: tuple[Series, ...], *, taken: bool) -> Iterator[Series]:
    energy_kwh = asked.energy_kwh
    for session, powers in zip(asked.sessions, power_kw, strict=True):
        limits = []
        for power, most_kw, h in zip(powers, session.power_max_kw, session.slot_h, strict=True):
            could_kwh = reached_kwh(car, energy_kwh, most_kw, h) - energy_kwh
            limit_kw = min(most_kw, could_kwh / (car.efficiency * h)) if h > 0.0 else most_kw
            energy_kwh += car.efficiency * (min(power, limit_kw) if taken else power) * h
            limits.append(limit_kw)
        yield tuple(limits)
        energy_kwh -= session.daily_use_kwh


def solve(solver: Solver, asked: Problem, car: Car) -> tuple[Problem, Solution]:
    """The plan, and the problem it is the plan of: `asked` with each slot's power limited to what the car will take.

    The limits follow from the plan and the plan from the limits. They are found together by planning again with
    the limits of the plan before, until none of them is passed; after a few passes they only fall, which costs a
    little carbon and keeps what is promised.
    """
    solution = solver.solve(asked)
    stated = asked
    if car.taper_from >= 1.0:
        return stated, solution
    for number in range(MAX_PASSES):
        # First as the car would take it: a night that is flat out is then right at once. After that as planned,
        # which moves the rest to its slots in two or three passes instead of twenty.
        limits = limits_kw(car, asked, solution.power_kw, taken=number == 0)
        if not _passed(solution.power_kw, limits):
            break
        if number >= FREE_PASSES:
            limits = tuple(
                tuple(min(pair) for pair in zip(new, session.power_max_kw, strict=True))
                for new, session in zip(limits, stated.sessions, strict=True)
            )
        stated = replace(
            asked,
            sessions=tuple(_limited(own, series) for own, series in zip(asked.sessions, limits, strict=True)),
        )
        solution = solver.solve(stated)
    return stated, solution


def _limited(session: ProblemSession, limits: Series) -> ProblemSession:
    """A car that takes less than the charger's least power takes what it takes: the charger is no limit there."""
    least_kw = min((kw for kw in limits if kw > 0.0), default=session.power_min_kw)
    return replace(session, power_max_kw=limits, power_min_kw=min(session.power_min_kw, least_kw))


def _passed(power_kw: tuple[Series, ...], limits: tuple[Series, ...]) -> bool:
    pairs = zip(power_kw, limits, strict=True)
    return any(p > most + REST_KW for powers, mosts in pairs for p, most in zip(powers, mosts, strict=True))
