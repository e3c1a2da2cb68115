"""What the value of energy left at the horizon's end does over a year, by horizon: without, a constant, plugd's own.

    PLUGD_DATA=folder python bench/end_value.py [--plug demo] [--check] [--nights 357] [--seeds 2]

The world is the paper's: 50 kWh, 20 to 80 %, minimum 50 %, 10 kW modulating, efficiency 1, its driver and its forecast
errors (the one-step error of each target slot, grown by 0.997 % of itself a half hour, random signs at every issue),
clocks in UTC. `--plug demo`: 2.3 kW, efficiency 0.9. It is a light loop over the controller's own steps (sessions,
`nights.layout`, `nights.problem`, the exact solver) at the moments when the car can charge. `--check` runs some weeks
of it through `plugd.study.house.House`, the whole cycle. Without the measured year: a synthetic one, errors of 6 %.
Parameters (28 nights of history) were chosen on the odd months; the table shows the even ones beside them.
"""

import argparse
import os
import random
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import takewhile
from math import inf
from pathlib import Path

from plugd import series, sessions, soc
from plugd.cycle import HISTORY
from plugd.domain import (
    Capability,
    Car,
    Household,
    Intensity,
    Nights,
    Outlook,
    OutlookSlot,
    Overrides,
    Presence,
    Session,
    SlotSource,
)
from plugd.planner import exact, nights
from plugd.planner.end_value import Steps
from plugd.study.house import FunctionSource, House
from plugd.study.world import Battery, Driver, Stay
from plugd.units import HALF_HOUR, hours, pieces, slot_start
from plugd_hil.synthetic import synthetic_year

GROWTH = 9.97e-3
"""Of the relative error, a half hour ahead (paper III-A)."""
SYNTHETIC_ERROR = 0.06
START_KWH = 25.0
FIRST_SLOT = 24
"""The year begins at its first noon, and so does what is remembered of it."""
SETTLED = 48 * 9
"""Half hours of history from which on what nights are like changes once a day only."""
CONSTANT_G_PER_KWH = 110.0
"""The best of 70, 90, 110 and 130 for N = 1 over the same year, in local time: hindsight that no house has."""
PLUGS = {"paper": (10.0, 1.0), "demo": (2.3, 0.9)}
VALUES = ("off", "constant", "ours")
HORIZONS = (1, 2, 4, 7)
ALL, ODD, EVEN = (frozenset(range(*span)) for span in ((1, 13), (1, 13, 2), (2, 13, 2)))


@dataclass(frozen=True, slots=True)
class Year:
    """Measured intensity and the relative error of the one-step forecast, a value a half hour."""

    name: str
    start: datetime
    actual: tuple[float, ...]
    error: tuple[float, ...]

    def index(self, moment: datetime) -> int:
        """Of the half hour that holds `moment`."""
        return (moment - self.start) // HALF_HOUR

    def forecast(self, issued: int, target: int, sign: int) -> float:
        """Paper eq. forecastCgen: of the half hour `target` in the issue of `issued`."""
        grown = self.error[target] * (1.0 + GROWTH * (target - issued))
        return self.actual[target] * (1.0 + sign * grown)


def load() -> Year:
    """2023 as measured, or a synthetic year."""
    path = Path(os.environ.get("PLUGD_DATA") or Path(__file__).parents[1].parent / "shared/data")
    path /= "neso_national_2023.csv"
    if path.exists():
        found = series.load(path)
        actual = tuple(g or 0.0 for g in found.held().actual)
        pairs = zip(actual, found.forecast, strict=True)
        error = tuple(0.0 if f is None else abs(f - g) / max(g, 1.0) for g, f in pairs)
        return Year(path.name, found.start, actual, error)
    found, dice = synthetic_year(), random.Random(0)
    actual = tuple(g or 0.0 for g in found.actual)
    return Year("a synthetic year", found.start, actual, tuple(SYNTHETIC_ERROR * abs(dice.gauss()) for _ in actual))


@dataclass(frozen=True, slots=True)
class Job:
    """One line of the table."""

    plug: str
    horizon: int
    value: str
    seed: int
    span: int
    """Nights."""


@dataclass(slots=True)
class Account:
    """What flowed, by half hour (kWh at the plug), the battery at the end, and mornings under the minimum."""

    flows: dict[int, float]
    end_kwh: float
    missed: int = 0

    def g_per_kwh(self, year: Year, efficiency: float, months: frozenset[int]) -> tuple[float, float]:
        """Carbon and energy, with what is missing to the start's SOC charged at the mean of the year."""
        chosen = {k: kwh for k, kwh in self.flows.items() if (year.start + k * HALF_HOUR).month in months}
        kwh, carbon_g = sum(chosen.values()), sum(kwh * year.actual[k] for k, kwh in chosen.items())
        owed_kwh = (START_KWH - self.end_kwh) / efficiency if len(months) == 12 else 0.0
        return (carbon_g + owed_kwh * sum(year.actual) / len(year.actual)) / (kwh + owed_kwh), kwh


def household(job: Job) -> Household:
    """The planner's side of the world."""
    power_kw, efficiency = PLUGS[job.plug]
    return Household(
        timezone="UTC",
        car=Car(efficiency=efficiency),
        nights=Nights(horizon=job.horizon),
        capability=Capability(power_kw, modulating=True),
        guard_margin_s=0.0,
        planner_slack_s=0.0,
        end_value=job.value == "ours",
    )


def stays(year: Year, job: Job) -> Iterator[Stay]:
    """The paper's driver, from the first noon on."""
    noon = year.start + timedelta(hours=12)
    found = Driver(timezone="UTC", seed=job.seed).stays(noon)
    end = noon + timedelta(days=job.span)
    return (stay for stay in takewhile(lambda s: s.arrival < end, found) if stay.arrival >= noon)


def uncontrolled(year: Year, job: Job) -> Account:
    """Charging on arrival up to the ceiling."""
    power_kw, efficiency = PLUGS[job.plug]
    battery = Battery(energy_kwh=START_KWH, efficiency=efficiency, taper_from=0.8, full=0.8)
    account = Account({}, START_KWH)
    for stay in stays(year, job):
        for first, last in pieces(stay.arrival, stay.departure):
            slot = year.index(first)
            account.flows[slot] = account.flows.get(slot, 0.0) + battery.charge(power_kw, hours(last - first))
        battery.drive(stay.use_kwh)
    account.end_kwh = battery.energy_kwh
    return account


def past(year: Year, moment: datetime, dice: random.Random) -> tuple[Intensity, ...]:
    """What the store would hold: the one-step forecast of each half hour."""
    last = year.index(moment)
    return tuple(
        Intensity(year.start + k * HALF_HOUR, year.forecast(k, k, dice.choice((-1, 1))))
        for k in range(max(FIRST_SLOT, last - HISTORY // HALF_HOUR), last)
    )


def expectation(year: Year, now: datetime, until: datetime, dice: random.Random) -> Outlook:
    """A fresh issue for every half hour to `until`: the paper's forecast covers its whole horizon."""
    issued = year.index(now)
    targets = range(issued, year.index(until - timedelta(seconds=1)) + 1)
    signs = dice.getrandbits(len(targets))
    rows = (
        (year.start + k * HALF_HOUR, year.forecast(issued, k, 1 if signs >> (k - issued) & 1 else -1)) for k in targets
    )
    return Outlook(tuple(OutlookSlot(start, g, 0.0, SlotSource.NESO) for start, g in rows), until)


def controlled(year: Year, job: Job) -> Account:
    """The controller's plan, made anew every half hour, with its first slot carried out."""
    house, dice = household(job), random.Random(job.seed)
    battery = Battery(energy_kwh=START_KWH, efficiency=house.car.efficiency)
    account = Account({}, START_KWH)
    for stay in stays(year, job):
        evening = stay.arrival.replace(hour=12, minute=0, second=0, microsecond=0)
        coming = sessions.expected(evening, house, Overrides(), Presence(), job.horizon)
        night(year, job, house, battery, stay, coming, account, dice)
        session = coming[0]
        if stay.departure >= session.end and battery.soc < session.minimum - 0.005:
            account.missed += 1
        battery.drive(stay.use_kwh)
    account.end_kwh = battery.energy_kwh
    return account


def night(
    year: Year, job: Job, house: Household, battery: Battery, stay: Stay, coming: tuple[Session, ...],
    account: Account, dice: random.Random,
) -> None:  # fmt: skip
    """One stay. Once there is history, what nights are like changes once a day: the end value is asked for once."""
    estimate = soc.told(soc.unknown(stay.arrival), battery.soc, stay.arrival, "car")
    given: Steps | None = {"off": (), "constant": ((inf, CONSTANT_G_PER_KWH),)}.get(job.value)
    begin, end = max(coming[0].start, stay.arrival), min(coming[0].end, stay.departure)
    for now, until in pieces(begin, end):
        energy_kwh = soc.cautious(estimate) * house.car.capacity_kwh
        parts = nights.layout(coming, now, energy_kwh, house.capability.power_max_kw, house)
        outlook = expectation(year, now, coming[-1].end, dice)
        if given is None:
            history = past(year, now, random.Random(job.seed))
            steps = nights.problem(parts, outlook, energy_kwh, None, house, history).end_value
            given = steps if len(history) >= SETTLED else None
        else:
            steps = given
        stated = nights.problem(parts, outlook, energy_kwh, None, replace(house, end_value=False))
        plan = nights.plan(now, parts, stated, exact.solve(replace(stated, end_value=steps)), house)
        power_kw = next(slot.power_kw for slot in plan.slots() if slot.start <= now < slot.end)
        before = battery.soc
        taken_kwh = battery.charge(power_kw, hours(until - now))
        gain = battery.soc - before
        estimate = replace(estimate, mean=estimate.mean + gain, sd=estimate.sd + soc.METER_SHARE * gain)
        account.flows[year.index(now)] = account.flows.get(year.index(now), 0.0) + taken_kwh


def whole_cycle(year: Year, job: Job) -> Account:
    """The same through the daemon's own cycle, for the check."""
    dice = random.Random(job.seed)

    def issue(issued: datetime, slot: datetime) -> float | None:
        return year.forecast(year.index(issued), year.index(slot), dice.choice((-1, 1)))

    begin = year.start + timedelta(hours=12)
    battery = Battery(energy_kwh=START_KWH, efficiency=PLUGS[job.plug][1])
    source = FunctionSource(issue, 48 * (job.horizon + 1))
    house = House(household(job), exact.Exact(), source, stays(year, job), begin, battery)
    house.run(begin + timedelta(days=job.span))
    flows = {year.index(slot_start(at)): kwh for at, kwh in house.plug.flows.items()}
    return Account(flows, battery.energy_kwh, sum(morning.missed for morning in house.mornings))


def run(job: Job) -> tuple[Job, Account]:
    """One line, in a process of its own."""
    return job, controlled(load(), job)


def check(year: Year, span: int) -> None:
    """The light loop beside the whole cycle, both without forecast errors, whose signs each draws on its own."""
    year = replace(year, error=(0.0,) * len(year.error))
    print("| horizon | light loop g/kWh | kWh | whole cycle g/kWh | kWh |\n|---|---|---|---|---|")
    for horizon in (1, 2):
        job = Job("paper", horizon, "ours", 0, span)
        cells = [
            f"{make(year, job).g_per_kwh(year, 1.0, ALL)[k]:.1f}" for make in (controlled, whole_cycle) for k in (0, 1)
        ]
        print(f"| {horizon} | " + " | ".join(cells) + " |")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--plug", choices=PLUGS, default="paper")
    parser.add_argument("--nights", type=int, default=357, help="so that the last plan ends within the year")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--horizons", default=",".join(map(str, HORIZONS)))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--check", action="store_true", help="28 nights beside the whole cycle")
    asked = parser.parse_args()
    year, began = load(), time.monotonic()
    if asked.check:
        check(year, min(asked.nights, 28))
        return
    efficiency = PLUGS[asked.plug][1]
    horizons = tuple(map(int, asked.horizons.split(",")))
    seeds = range(asked.seeds)
    jobs = [Job(asked.plug, n, value, seed, asked.nights) for n in horizons for value in VALUES for seed in seeds]

    def mean(accounts: list[Account], months: frozenset[int]) -> tuple[float, float]:
        figures = [account.g_per_kwh(year, efficiency, months) for account in accounts]
        return sum(g for g, _ in figures) / len(figures), sum(kwh for _, kwh in figures) / len(figures)

    bases = [uncontrolled(year, Job(asked.plug, 1, "off", seed, asked.nights)) for seed in seeds]
    on_arrival = {months: mean(bases, months)[0] for months in (ALL, ODD, EVEN)}
    print(f"{year.name}, plug {asked.plug}, {asked.nights} nights, {asked.seeds} seeds;", end=" ")
    print(f"charging on arrival {on_arrival[ALL]:.1f} g/kWh", end="\n\n")
    print("| horizon | end value | g/kWh | reduction % | odd months | even months | kWh | missed |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    with ProcessPoolExecutor(asked.workers) as pool:
        found = dict(pool.map(run, jobs))
    for n in horizons:
        for value in VALUES:
            accounts = [found[Job(asked.plug, n, value, seed, asked.nights)] for seed in seeds]
            g, kwh = mean(accounts, ALL)
            cuts = [f"{100 * (1 - mean(accounts, m)[0] / base):.1f}" for m, base in on_arrival.items()]
            missed = sum(account.missed for account in accounts)
            print(f"| {n} | {value} | {g:.1f} | {' | '.join(cuts)} | {kwh:.0f} | {missed} |")
    print(f"\n{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
