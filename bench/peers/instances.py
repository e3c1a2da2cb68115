"""The instances every solver is timed on: a household in closed loop, and jumps of its state.

22 half hours a night, a 50 kWh battery kept between 20 and 80 %, 50 % every morning, 22.56 % driven a day,
and a grid like the British one: mean 175, sd 65 g/kWh, windy spells of 40 and of 3 h over a daily cycle. The
forecast is drawn anew every tick, its error growing from 3 to 40 g/kWh at 48 h: the hardest case for a solver
that starts from its last answer.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, pi

from plugd.planner.problem import Problem, ProblemSession, Series, Solution

SLOTS = 22
DAY = 48
CAPACITY_KWH, MINIMUM_KWH, CEILING_KWH, RESERVE_KWH, DAILY_USE_KWH = 50.0, 25.0, 40.0, 10.0, 11.28
EFFICIENCY = 0.9


@dataclass(frozen=True, slots=True)
class Case:
    """What is planned: how many nights, at which power, and what is left worth at their end."""

    power_kw: float
    sessions: int
    end_value: tuple[tuple[float, float], ...] = ()


def grid_g_per_kwh(slots: int, rng: random.Random) -> list[float]:
    """A carbon intensity for each of `slots` half hours."""
    slow = fast = 0.0
    found = []
    for slot in range(slots):
        slow = slow * (1 - 1 / 80) + rng.gauss(0, 55 * (2 / 80) ** 0.5)
        fast = fast * (1 - 1 / 6) + rng.gauss(0, 15 * (2 / 6) ** 0.5)
        found.append(max(10.0, 175 + slow + fast - 35 * cos(2 * pi * (slot - 4) / DAY)))
    return found


def forecast_g_per_kwh(truth: list[float], now: int, start: int, rng: random.Random) -> Series:
    """The night of slots from `start` as forecast in slot `now`."""
    error, found = rng.gauss(0, 1), []
    for slot in range(start, start + SLOTS):
        error = 0.95 * error + rng.gauss(0, (1 - 0.95**2) ** 0.5)
        lead_h = max(0, slot - now) / 2
        found.append(max(10.0, truth[slot] + error * min(40.0, 3 + 37 * lead_h / 48)))
    return tuple(found)


class Household:
    """The closed loop: `problem()` says what is to be planned now, `live` applies the answer for half an hour.

    With `only_plugged` the days are skipped: 22 ticks a night, else 48 a day, planning whole nights by day.
    """

    def __init__(self, case: Case, ticks: int, seed: int, *, only_plugged: bool) -> None:
        self._case, self._only_plugged = case, only_plugged
        self._rng = random.Random(seed)
        days = ticks // (SLOTS if only_plugged else DAY) + case.sessions + 2
        self._truth = grid_g_per_kwh(days * DAY, self._rng)
        self._day = self._slot = 0  # a day begins at plug-in
        self.energy_kwh = MINIMUM_KWH
        self._previous: tuple[Series, ...] | None = None

    def problem(self) -> Problem:
        """What is to be planned now."""
        now = self._day * DAY + self._slot
        plugged_in = self._slot < SLOTS
        first = self._day if plugged_in else self._day + 1
        return stated(
            self._case,
            self.energy_kwh,
            tuple(
                forecast_g_per_kwh(self._truth, now, day * DAY, self._rng)
                for day in range(first, first + self._case.sessions)
            ),
            self._slot if plugged_in else 0,
            self._previous,
        )

    def live(self, solution: Solution) -> None:
        """Half an hour passes as planned; at the night's end the day is driven and the plan moves up."""
        self._previous = solution.power_kw
        if self._slot < SLOTS:
            self.energy_kwh += EFFICIENCY * 0.5 * solution.power_kw[0][self._slot]
        self._slot += 1
        if self._slot == SLOTS:
            self.energy_kwh -= DAILY_USE_KWH
            self._previous = (*solution.power_kw[1:], (0.0,) * SLOTS)
        if self._slot == (SLOTS if self._only_plugged else DAY):
            self._day, self._slot = self._day + 1, 0


def stated(
    case: Case,
    energy_kwh: float,
    nights_g_per_kwh: tuple[Series, ...],
    elapsed: int,
    previous: tuple[Series, ...] | None,
) -> Problem:
    """The problem of these nights, `elapsed` slots of the first gone by."""
    return Problem(
        energy_kwh=energy_kwh,
        reserve_kwh=RESERVE_KWH,
        efficiency=EFFICIENCY,
        sessions=tuple(
            ProblemSession(
                intensity_g_per_kwh=night,
                slot_h=(0.5,) * SLOTS,
                power_max_kw=tuple(0.0 if s == 0 and k < elapsed else case.power_kw for k in range(SLOTS)),
                minimum_kwh=MINIMUM_KWH,
                ceiling_kwh=CEILING_KWH,
                daily_use_kwh=DAILY_USE_KWH,
            )
            for s, night in enumerate(nights_g_per_kwh)
        ),
        end_value=case.end_value,
        previous_power_kw=previous,
    )


def jumps(case: Case, count: int, seed: int) -> Iterator[Problem]:
    """Unrelated states: any SOC from 5 to 80 %, any slot of the night to plug in, any plan before."""
    rng = random.Random(seed)
    truth = grid_g_per_kwh((case.sessions + 400) * DAY, rng)
    for _ in range(count):
        day, elapsed = rng.randrange(400), rng.randrange(SLOTS)
        now = day * DAY + elapsed
        nights = tuple(forecast_g_per_kwh(truth, now, (day + s) * DAY, rng) for s in range(case.sessions))
        before = tuple(tuple(rng.choice((0.0, 0.0, case.power_kw)) for _ in night) for night in nights)
        yield stated(case, rng.uniform(0.05, 0.8) * CAPACITY_KWH, nights, elapsed, before)
