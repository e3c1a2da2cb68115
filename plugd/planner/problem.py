"""What a planner is asked and what it answers: the chain of sessions of the paper's section II, in frozen
values.

Slots belong to sessions; nothing here knows the time of day. Intensity and power are at the plug, energy is
in the battery; `efficiency` turns plug kWh into battery kWh.
"""

from dataclasses import dataclass
from math import isfinite
from typing import Literal, Protocol

from plugd.domain import Series

__all__ = ["Problem", "ProblemSession", "Series", "Solution", "Solver"]


def _check(name: str, numbers: Series, least: float | None = None) -> None:
    """Raise ValueError unless every number is finite and, if given, at least `least`."""
    if not isfinite(sum(numbers)):
        raise ValueError(f"{name} holds a number that is not finite")
    if least is not None and numbers and min(numbers) < least:
        raise ValueError(f"{name} holds {min(numbers)}; the least is {least}")


@dataclass(frozen=True, slots=True)
class ProblemSession:
    """One overnight stay, or a day without one (no slots). All series: one value per slot, (K,).

    A slot gone by may keep its place with `power_max_kw` 0, so that the problem keeps its shape.
    """

    intensity_g_per_kwh: Series
    slot_h: Series
    power_max_kw: Series
    minimum_kwh: float
    """Battery energy guaranteed at the session's end: the morning minimum."""
    ceiling_kwh: float
    """Battery energy never exceeded: soc_max, or the session's own."""
    daily_use_kwh: float
    """Battery energy driven after this session."""
    power_min_kw: float = 0.0
    """A charger gives 0 or at least this (see `plugd.planner.least_power`)."""

    def __post_init__(self) -> None:
        if not len(self.intensity_g_per_kwh) == len(self.slot_h) == len(self.power_max_kw):
            raise ValueError("intensity_g_per_kwh, slot_h and power_max_kw differ in length")
        _check("intensity_g_per_kwh", self.intensity_g_per_kwh)
        _check("slot_h", self.slot_h, 0.0)
        _check("power_max_kw", self.power_max_kw, 0.0)
        _check("minimum_kwh, ceiling_kwh", (self.minimum_kwh, self.ceiling_kwh))
        _check("daily_use_kwh, power_min_kw", (self.daily_use_kwh, self.power_min_kw), 0.0)


@dataclass(frozen=True, slots=True)
class Problem:
    """The sessions to plan, from the battery's energy now (paper eqs. 2 to 6).

    `reserve_kwh` binds on arrival after every session but the last. `end_value` is the concave worth of
    energy left at the last session's end: steps (battery kWh, g per battery kWh), from that end's repaired
    lower bound upward (see `plugd.planner.bounds`), never rising, never negative, 0 beyond the last; a step
    may be endless (`math.inf`).
    """

    energy_kwh: float
    reserve_kwh: float
    efficiency: float
    sessions: tuple[ProblemSession, ...]
    end_value: tuple[tuple[float, float], ...] = ()
    previous_power_kw: tuple[Series, ...] | None = None
    """The plan before, in the shape of `sessions`: the proximal term's centre."""

    def __post_init__(self) -> None:
        _check("energy_kwh, reserve_kwh", (self.energy_kwh, self.reserve_kwh))
        if not 0 < self.efficiency <= 1:
            raise ValueError(f"efficiency is {self.efficiency}; it lies above 0 and at most at 1")
        if not self.sessions:
            raise ValueError("a problem has at least one session")
        worths = tuple(worth for _, worth in self.end_value)
        _check("end_value", worths, 0.0)
        if list(worths) != sorted(worths, reverse=True) or any(not width >= 0 for width, _ in self.end_value):
            raise ValueError("end_value's steps have a width and never rise")
        if self.previous_power_kw is not None:
            shape = [len(session.slot_h) for session in self.sessions]
            if [len(power_kw) for power_kw in self.previous_power_kw] != shape:
                raise ValueError("previous_power_kw is not in the shape of sessions")
            for power_kw in self.previous_power_kw:
                _check("previous_power_kw", power_kw)


@dataclass(frozen=True, slots=True)
class Solution:
    """A checked plan: every power within its limit, every bound of the repaired problem kept."""

    status: Literal["solved", "repaired", "fallback"]
    """repaired: some shortfall, or a bound was lifted; fallback: the exact plan where OSQP was asked."""
    solver: Literal["osqp", "exact"]
    """Where the powers came from."""
    power_kw: tuple[Series, ...]
    energy_kwh: Series
    """Battery energy at each session's end, before the day's driving, (N,)."""
    shortfall_kwh: Series
    """How far each session's end lies under its morning minimum, (N,)."""
    reserve_short_kwh: Series
    """How far the arrival after each session lies under the reserve, (N,); the last is 0."""
    carbon_g: float
    bound_g: float
    """The exact optimum of carbon_g - end value on the repaired problem."""
    gap: float
    """(objective - bound) / max(|bound|, 1 g), on the objective without the proximal term."""
    raw_gap: float
    """The same for OSQP's first pass; 0 where that gave no plan."""
    iterations: int
    """OSQP's, both passes together; 0 where it did not run."""


class Solver(Protocol):
    """Something that plans. Never raises: what cannot be reached is repaired."""

    def solve(self, problem: Problem) -> Solution:
        """The plan of least carbon_g - end value."""
