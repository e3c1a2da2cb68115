"""What a relay costs, and what makes its plan hold still: two tables from the whole cycle in its simulated house.

    PLUGD_DATA=folder python bench/relay.py [--table relay|stillness|house] [--world NAME] [--kw KW] [--year]

The real controller, relay and beat (`plugd.study.house.House`), the paper's driver, 50 kWh, efficiency 0.9, no random
delay, four nights planned, the clocks of Europe/London; measured intensity of 2023 (without PLUGD_DATA a synthetic
year). By default `--nights` nights from the middle of January, April, July and October; `--year`: all 357 nights.

relay: a year of the relay beside a charger that can take any power, with everything else the same and perfect
foresight, in the study's own loop (`plugd.study.engine`), which runs the daemon's plan and relay code.

house: the same through the whole cycle, and beside the continuous optimum: the energy that each night really took, in
the cleanest half hours of that night's session, which needs hindsight.
In the world `perfect` the forecast is what will be measured, to the end of the horizon; in `errors` it covers 48 h and
its error grows to 20 % there as an autoregressive process (0.97 a half hour), the demo's.

stillness: by how much cleaner another slot must be before the slot under way or the next is left. A reversal is a half
hour of this session that one tick plans on and the next plans off, a near one is in the half hour under way or the
next, where the relay may have been switched already. `errors` as above; `paper`: its noise, the one-step error of each
target slot, grown with the lead, with signs drawn anew for every slot of every issue.
"""

import argparse
import os
import random
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import date, datetime, timedelta
from functools import lru_cache
from itertools import takewhile
from pathlib import Path
from statistics import fmean

from plugd import sessions
from plugd.controller import Controller
from plugd.domain import Capability, Decision, Household, Memory, Observation, Overrides, RelayRules, Switching
from plugd.planner.exact import Exact
from plugd.relay import slot_shares
from plugd.study import measured, runs
from plugd.study.engine import Account
from plugd.study.forecasts import PAPER_GROWTH, Noise
from plugd.study.house import FunctionSource, House
from plugd.study.measured import Measured
from plugd.study.world import Battery, Driver, Stay
from plugd.units import HALF_HOUR, hours, next_slot, pieces, slot_start
from plugd_hil.neso_source import forecast_error
from plugd_hil.synthetic import synthetic_year

START_KWH = 25.0
SYNTHETIC_ERROR = 0.06
SEASONS = (1, 4, 7, 10)
YEAR_NIGHTS = 357
"""So that the last plan ends within the year."""
POWERS_KW = (2.3, 3.6, 7.4, 10.0)
HOLDS_G_PER_KWH = (0.0, 2.0, 5.0, 20.0)
USUAL = RelayRules(random_delay_s=0.0)
Issue = Callable[[datetime, datetime], float | None]


@dataclass(frozen=True, slots=True)
class Job:
    """One simulation."""

    power_kw: float
    modulating: bool
    world: str
    hold_g_per_kwh: float
    seed: int
    start_day: int
    nights: int


@dataclass(frozen=True, slots=True)
class Found:
    """What one simulation, or several together, came to. Energy at the plug."""

    carbon_g: float
    kwh: float
    owed_kwh: float
    """Missing at the end to the SOC of the beginning."""
    night_g: float
    """Carbon in the sessions."""
    night_best_g: float
    """The same energies in the cleanest half hours of the same sessions."""
    nights: int
    switch_ons: int
    most_switch_ons: int
    """By the plan in one session."""
    reversals: int
    near: int
    """Those of the half hour under way and the next."""
    missed: int
    guarded: int

    @property
    def g_per_kwh(self) -> float:
        """With the energy that is owed charged at the mean."""
        return self.carbon_g / self.kwh

    @property
    def lost_pct(self) -> float:
        """Against the continuous optimum of each night."""
        return 100.0 * (self.night_g / self.night_best_g - 1.0)


def together(found: list[Found]) -> Found:
    """Sums, and the most of the most."""
    total = {name: sum(getattr(each, name) for each in found) for name in Found.__slots__}
    return Found(**total | {"most_switch_ons": max(each.most_switch_ons for each in found)})


# -- one simulation -------------------------------------------------------------------------------


@dataclass(slots=True)
class Watched:
    """The controller, with an eye on what it makes of its last orders."""

    controller: Controller
    reversals: int = 0
    near: int = 0
    most_switch_ons: int = 0

    def tick(self, now: datetime, seen: Observation, memory: Memory) -> Decision:
        """As the controller, counting."""
        decision = self.controller.tick(now, seen, memory)
        before, after, plan = memory.orders, decision.memory.orders, decision.memory.plan
        if plan and isinstance(before, Switching) and isinstance(after, Switching) and before.until == after.until:
            slots = plan.sessions[0].slots
            shares = zip(slots, slot_shares(before, slots), slot_shares(after, slots), strict=True)
            turned = [slot.start for slot, was, now_is in shares if was >= 0.5 > now_is]
            self.reversals += len(turned)
            self.near += sum(start < next_slot(now) + HALF_HOUR for start in turned)
        if plan:
            begun = plan.sessions[0].session.start
            self.most_switch_ons = max(self.most_switch_ons, sum(at >= begun for at in memory.switch_ons))
        return decision

    def __getattr__(self, name: str) -> object:
        return getattr(self.controller, name)


def load() -> Measured:
    """2023 as measured, or a synthetic year with one-step errors of some per cent."""
    path = Path(os.environ.get("PLUGD_DATA") or Path(__file__).parents[1].parent / "shared/data")
    path /= "neso_national_2023.csv"
    if path.exists():
        return measured.load(path)
    found, dice = measured.measured("a synthetic year", synthetic_year()), random.Random(0)
    return replace(found, error=tuple(SYNTHETIC_ERROR * dice.gauss() for _ in found.actual))


def issues(year: Measured, job: Job) -> tuple[Issue, int]:
    """The forecast, and how many half hours of it there are."""

    def perfect(issued: datetime, slot: datetime) -> float | None:
        k = year.index(slot)
        return year.actual[k] if k < len(year.actual) else None

    def errors(issued: datetime, slot: datetime) -> float | None:
        g = perfect(issued, slot)
        return None if g is None else max(0.0, g * (1.0 + forecast_error(str(job.seed), issued, slot)))

    @lru_cache(maxsize=4)
    def signs(issued: datetime) -> int:
        return random.Random(f"{job.seed}/{issued.isoformat()}").getrandbits(96 * 3)

    def paper(issued: datetime, slot: datetime) -> float | None:
        lead, target = (slot - slot_start(issued)) // HALF_HOUR, year.index(slot)
        if target >= len(year.actual):
            return None
        sign = 1 if signs(slot_start(issued)) >> lead & 1 else -1
        grown = abs(year.error[target]) * (1.0 + PAPER_GROWTH * lead)
        return max(0.0, year.actual[target] * (1.0 + sign * grown))

    return {"perfect": (perfect, 240), "errors": (errors, 96), "paper": (paper, 240)}[job.world]


def run(job: Job) -> tuple[Job, Found]:
    """One simulation, in a process of its own."""
    year = load()
    begin = year.start + timedelta(days=job.start_day, hours=12)
    end = begin + timedelta(days=job.nights)
    household = Household(
        relay=replace(USUAL, hold_g_per_kwh=job.hold_g_per_kwh),
        capability=Capability(job.power_kw, modulating=job.modulating),
    )
    stays = tuple(takewhile(lambda stay: stay.arrival < end, Driver(seed=job.seed).stays(begin)))
    battery = Battery(energy_kwh=START_KWH)
    source = FunctionSource(*issues(year, job))
    house = House(household, Exact(), source, iter(stays), begin, battery)
    watched = Watched(house.cycle.controller)
    house.cycle.controller = watched  # type: ignore[assignment]
    house.run(end)
    flows = {year.index(at): kwh for at, kwh in house.plug.flows.items()}
    kwh, carbon_g = sum(flows.values()), sum(kwh * year.actual[k] for k, kwh in flows.items())
    owed_kwh = (START_KWH - battery.energy_kwh) / household.car.efficiency
    night_g, night_best_g = nights_apart(year, job, household, stays, flows, begin, end)
    return job, Found(
        carbon_g=carbon_g * (1.0 + owed_kwh / kwh),
        kwh=kwh + owed_kwh,
        owed_kwh=owed_kwh,
        night_g=night_g,
        night_best_g=night_best_g,
        nights=job.nights,
        switch_ons=house.plug.switch_ons,
        most_switch_ons=watched.most_switch_ons,
        reversals=watched.reversals,
        near=watched.near,
        missed=sum(morning.missed for morning in house.mornings),
        guarded=len(house.guarded),
    )


def nights_apart(
    year: Measured, job: Job, household: Household, stays: tuple[Stay, ...], flows: dict[int, float], begin: datetime,
    end: datetime,
) -> tuple[float, float]:  # fmt: skip
    """Carbon in the sessions, and that of the same energy in each one's cleanest half hours."""
    spent_g = best_g = 0.0
    for window in takewhile(lambda w: w.session.end <= end, sessions.windows(household, Overrides(), begin)):
        session = window.session
        room: dict[int, float] = {}
        for stay in stays:
            for first, last in pieces(max(session.start, stay.arrival), min(session.end, stay.departure)):
                k = year.index(first)
                room[k] = room.get(k, 0.0) + job.power_kw * hours(last - first)
        left_kwh = 0.0
        for k in room:
            spent_g += flows.get(k, 0.0) * year.actual[k]
            left_kwh += flows.get(k, 0.0)
        for k in sorted(room, key=lambda k: year.actual[k]):
            part_kwh = min(left_kwh, room[k])
            best_g += part_kwh * year.actual[k]
            left_kwh -= part_kwh
    return spent_g, best_g


# -- the tables -----------------------------------------------------------------------------------


def spans(asked: argparse.Namespace) -> Iterator[tuple[int, int]]:
    """(first day, nights) of each stretch that is simulated."""
    if asked.year:
        yield 0, YEAR_NIGHTS
    else:
        for month in SEASONS:
            yield (date(2023, month, 8) - date(2023, 1, 1)).days, asked.nights


def simulate(asked: argparse.Namespace, lines: list[Job]) -> dict[Job, list[Found]]:
    """Every line of a table over all seeds and stretches: one `Found` a seed."""
    jobs = [
        replace(line, seed=seed, start_day=day, nights=nights)
        for line in lines for seed in range(asked.seeds) for day, nights in spans(asked)
    ]  # fmt: skip
    with ProcessPoolExecutor(asked.workers) as pool:
        found = dict(pool.map(run, jobs))
    return {
        line: [
            together([found[replace(line, seed=seed, start_day=day, nights=n)] for day, n in spans(asked)])
            for seed in range(asked.seeds)
        ]
        for line in lines
    }


def study_year(case: tuple[float, bool, int]) -> Account:
    """A year of a charger or a relay with perfect foresight, in the study's loop: the daemon's plan and relay code."""
    power_kw, modulating, seed = case
    found = load()
    household = Household(relay=USUAL, capability=Capability(power_kw, modulating=modulating))
    start, end = measured.span(found, None)
    chosen = runs.paper_run("mpc", found, start, end, horizon=4, seed=seed, noise=Noise.NONE, household=household)
    return runs.simulated(chosen)


def head(*columns: str) -> None:
    """A table's first two lines."""
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")


def relay_table(asked: argparse.Namespace) -> None:
    """The relay beside a charger of the same power, a year in seconds."""
    cases = [(kw, m, seed) for kw in asked.kw or POWERS_KW for seed in range(asked.seeds) for m in (True, False)]
    with ProcessPoolExecutor(asked.workers) as pool:
        found = dict(zip(cases, pool.map(study_year, cases), strict=True))
    head("kW", "charger g/kWh", "relay g/kWh", "relay against charger %", "switch-ons a night", "most", "missed")
    for kw in asked.kw or POWERS_KW:
        chargers, relays = ([found[kw, m, seed] for seed in range(asked.seeds)] for m in (True, False))
        charger_g, relay_g = (fmean(each.carbon_g_per_kwh or 0.0 for each in kind) for kind in (chargers, relays))
        nights = [night for each in relays for night in each.nights]
        print(
            f"| {kw:g} | {charger_g:.2f} | {relay_g:.2f} | {100.0 * (relay_g / charger_g - 1.0):+.2f} | "
            f"{fmean(night.switch_ons for night in nights):.2f} | {max(night.switch_ons for night in nights)} | "
            f"{sum(night.morning.missed for night in nights)} |"
        )


def house_table(asked: argparse.Namespace) -> None:
    """The same through the whole cycle, with forecast errors too."""
    hold = USUAL.hold_g_per_kwh
    lines = [
        Job(kw, modulating, world, hold, 0, 0, 0)
        for world in asked.world or ("perfect", "errors") for kw in asked.kw or POWERS_KW
        for modulating in (True, False)
    ]  # fmt: skip
    found = simulate(asked, lines)
    head("world", "kW", "charger g/kWh", "relay g/kWh", "relay against charger %", "inside the night %",
         "switch-ons a night", "most", "missed", "guard")  # fmt: skip
    for line in lines:
        if line.modulating:
            continue
        chargers, relays = found[replace(line, modulating=True)], found[line]
        cost_pct = [100.0 * (r.g_per_kwh / c.g_per_kwh - 1.0) for r, c in zip(relays, chargers, strict=True)]
        total = together(relays)
        print(
            f"| {line.world} | {line.power_kw:g} | {together(chargers).g_per_kwh:.1f} | {total.g_per_kwh:.1f} | "
            f"{fmean(cost_pct):+.2f} | {total.lost_pct:.2f} | {total.switch_ons / total.nights:.2f} | "
            f"{total.most_switch_ons} | {total.missed} | {total.guarded} |"
        )


def stillness_table(asked: argparse.Namespace) -> None:
    """What holding costs and saves."""
    lines = [
        Job(kw, False, world, hold, 0, 0, 0)
        for world in asked.world or ("errors", "paper") for kw in asked.kw or (2.3,) for hold in HOLDS_G_PER_KWH
    ]  # fmt: skip
    found = simulate(asked, lines)
    head("world", "kW", "hold g/kWh", "reversals a night", "near ones", "switch-ons a night", "g/kWh",
         "against none %", "missed")  # fmt: skip
    for line in lines:
        free, total = together(found[replace(line, hold_g_per_kwh=0.0)]), together(found[line])
        print(
            f"| {line.world} | {line.power_kw:g} | {line.hold_g_per_kwh:g} | {total.reversals / total.nights:.1f} | "
            f"{total.near / total.nights:.2f} | {total.switch_ons / total.nights:.2f} | {total.g_per_kwh:.2f} | "
            f"{100.0 * (total.g_per_kwh / free.g_per_kwh - 1.0):+.2f} | {total.missed} |"
        )


TABLES = {"relay": relay_table, "stillness": stillness_table, "house": house_table}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--table", choices=TABLES, action="append")
    parser.add_argument("--world", choices=("perfect", "errors", "paper"), action="append")
    parser.add_argument("--kw", type=float, action="append")
    parser.add_argument("--year", action="store_true")
    parser.add_argument("--nights", type=int, default=14)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    for name in asked.table or ("relay", "stillness"):
        began = time.monotonic()
        print(f"{name}: {load().name}, {asked.seeds} seeds", end="")
        nights = sum(n for _, n in spans(asked))
        print("" if name == "relay" else f", {nights} nights")
        TABLES[name](asked)
        print(f"{time.monotonic() - began:.0f} s\n", flush=True)


if __name__ == "__main__":
    main()
