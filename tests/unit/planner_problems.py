"""Random planning problems, from everyday ones to nonsense that could still be built, and an independent oracle."""

import random
from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np
from scipy.optimize import linprog

from plugd.planner.bounds import chain
from plugd.planner.problem import Problem, ProblemSession, Series, Solution


def prices(rng: random.Random, slots: int) -> Series:
    """Intensities of one of five kinds: spread, tied, flat, partly negative, nearly tied."""
    kind = rng.randrange(5)
    if kind == 0:
        return tuple(rng.uniform(20, 350) for _ in range(slots))
    if kind == 1:
        return tuple(float(rng.randrange(50, 250, 50)) for _ in range(slots))
    if kind == 2:
        return (rng.choice((0.0, 120.0)),) * slots
    if kind == 3:
        return tuple(rng.uniform(-80, 200) for _ in range(slots))
    return tuple(150 + rng.uniform(-0.3, 0.3) for _ in range(slots))


def session(rng: random.Random, power_kw: float) -> ProblemSession:
    """One session; some slots partial, weak or closed, the minimum now and then above the ceiling."""
    slots = rng.choice((0, 1, 3, 22, 22, 22, 24))
    varied = rng.random() < 0.4
    return ProblemSession(
        intensity_g_per_kwh=prices(rng, slots),
        slot_h=tuple(rng.choice((0.5, 0.5, 0.25, rng.uniform(0.01, 0.5))) if varied else 0.5 for _ in range(slots)),
        power_max_kw=tuple(
            rng.choice((power_kw, power_kw, 0.0, rng.uniform(0, power_kw))) if varied else power_kw
            for _ in range(slots)
        ),
        minimum_kwh=rng.choice((25.0, 0.0, 40.0, rng.uniform(5, 45))),
        ceiling_kwh=rng.choice((40.0, 40.0, 50.0, 30.0, rng.uniform(15, 50))),
        daily_use_kwh=rng.choice((11.28, 5.8, 0.0, rng.uniform(0, 30))),
    )


def end_value(rng: random.Random) -> tuple[tuple[float, float], ...]:
    """None, a constant, or falling steps."""
    kind = rng.randrange(3)
    if kind == 0:
        return ()
    if kind == 1:
        return ((inf, rng.uniform(1, 250)),)
    worths = sorted((rng.uniform(0, 300) for _ in range(rng.randrange(1, 5))), reverse=True)
    return tuple((rng.uniform(0.5, 15), worth) for worth in worths)


def problem(rng: random.Random) -> Problem:
    """Any problem."""
    power_kw = rng.choice((10.0, 2.3, 3.6, 7.4))
    sessions = tuple(session(rng, power_kw) for _ in range(rng.choice((1, 2, 4, 7))))
    previous = None
    if rng.random() < 0.5:
        previous = tuple(tuple(rng.choice((0.0, p)) for p in own.power_max_kw) for own in sessions)
    return Problem(
        energy_kwh=rng.choice((25.0, 40.0, rng.uniform(2, 48))),
        reserve_kwh=10.0,
        efficiency=rng.choice((1.0, 0.9)),
        sessions=sessions,
        end_value=end_value(rng),
        previous_power_kw=previous,
    )


def everyday(rng: random.Random, *, power_kw: float = 10.0, sessions: int = 4, elapsed: int = 0) -> Problem:
    """A problem as the daemon has it: equal sessions of 22 slots, `elapsed` of the first gone by."""
    own = tuple(
        ProblemSession(
            intensity_g_per_kwh=tuple(max(20.0, rng.uniform(60, 260)) for _ in range(22)),
            slot_h=(0.5,) * 22,
            power_max_kw=tuple(0.0 if s == 0 and k < elapsed else power_kw for k in range(22)),
            minimum_kwh=25.0,
            ceiling_kwh=40.0,
            daily_use_kwh=11.28,
        )
        for s in range(sessions)
    )
    return Problem(rng.uniform(12, 40), 10.0, 0.9, own)


def as_repaired(given: Problem) -> Problem:
    """`given` with the repaired bounds for its own, as battery levels: feasible, and the same end value."""
    links = chain(given)
    level_kwh, sessions = given.energy_kwh, []
    for own, lower, upper in zip(given.sessions, links.lower_kwh, links.upper_kwh, strict=True):
        sessions.append(replace(own, minimum_kwh=level_kwh + lower, ceiling_kwh=level_kwh + upper))
        level_kwh -= own.daily_use_kwh
    return replace(given, sessions=tuple(sessions), reserve_kwh=-1e6)


def oracle_g(given: Problem) -> float | None:
    """The optimum by HiGHS, from the problem's own words: powers, battery levels, steps. None where infeasible.

    Variables: power of every slot, kW; battery energy at each session's end, kWh; what each step holds, kWh.
    """
    powers = [len(own.slot_h) for own in given.sessions]
    n, sessions, steps = sum(powers), len(powers), len(given.end_value)
    cost = np.zeros(n + sessions + steps)
    equal, right = np.zeros((sessions, len(cost))), np.zeros(sessions)
    limits: list[tuple[float, float]] = []
    first = 0
    for s, own in enumerate(given.sessions):
        for k, (c, h, p) in enumerate(zip(own.intensity_g_per_kwh, own.slot_h, own.power_max_kw, strict=True)):
            cost[first + k] = c * h
            equal[s, first + k] = -given.efficiency * h
            limits.append((0.0, p))
        first += powers[s]
        equal[s, n + s] = 1.0
        if s:
            equal[s, n + s - 1] = -1.0
        right[s] = given.energy_kwh if s == 0 else -given.sessions[s - 1].daily_use_kwh
    for s, own in enumerate(given.sessions):
        least = own.minimum_kwh if s == sessions - 1 else max(own.minimum_kwh, given.reserve_kwh + own.daily_use_kwh)
        limits.append((least, own.ceiling_kwh))
    held = np.zeros((1, len(cost)))
    held[0, n + sessions - 1] = -1.0
    for k, (width_kwh, worth) in enumerate(given.end_value):
        cost[n + sessions + k] = -worth
        held[0, n + sessions + k] = 1.0
        limits.append((0.0, width_kwh))
    if any(low > high for low, high in limits):
        return None
    found = linprog(
        cost,
        A_ub=held if steps else None,
        b_ub=[-given.sessions[-1].minimum_kwh] if steps else None,
        A_eq=equal,
        b_eq=right,
        bounds=limits,
        method="highs",
    )
    if found.status == 2:
        return None
    if found.status != 0:
        raise RuntimeError(found.message)
    return float(found.fun)


def faults(given: Problem, solution: Solution, tolerance_kwh: float = 1e-6) -> list[str]:
    """What is wrong with a plan by the problem's own words, repaired bounds for bounds; [] for a sound one."""
    found = []
    repaired = as_repaired(given)
    level_kwh = given.energy_kwh
    for s, (own, power_kw) in enumerate(zip(repaired.sessions, solution.power_kw, strict=True)):
        for p, most in zip(power_kw, own.power_max_kw, strict=True):
            if not 0 <= p <= most:
                found.append(f"session {s}: {p} kW of {most}")
        level_kwh += given.efficiency * sum(p * h for p, h in zip(power_kw, own.slot_h, strict=True))
        if not abs(level_kwh - solution.energy_kwh[s]) <= tolerance_kwh:
            found.append(f"session {s}: ends at {level_kwh}, told {solution.energy_kwh[s]}")
        if not own.minimum_kwh - tolerance_kwh <= level_kwh <= own.ceiling_kwh + tolerance_kwh:
            found.append(f"session {s}: {level_kwh} outside {own.minimum_kwh} to {own.ceiling_kwh}")
        level_kwh -= own.daily_use_kwh
    return found


def dearer_before_cheaper(given: Problem, power_kw: tuple[Series, ...]) -> list[str]:
    """Where a slot has energy while a cheaper one of its session, or an earlier equal one, has room."""
    found = []
    for s, (own, powers) in enumerate(zip(given.sessions, power_kw, strict=True)):
        order = sorted(range(len(powers)), key=lambda k: (own.intensity_g_per_kwh[k], k))
        used = [k for k in order if own.power_max_kw[k] * own.slot_h[k] > 0]
        for cheap, dear in pairwise(used):
            if powers[dear] > 1e-6 and powers[cheap] < own.power_max_kw[cheap] - 1e-6:
                found.append(f"session {s}: slot {dear} before {cheap}")
    return found
