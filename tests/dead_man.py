"""plugd killed for good at each quarter hour of a day: does the plug's own timer still bring the car to its minimum?

The plug is the daemon's own adapter and the stub of the device, the cycle is the daemon's, with solver and household
from a configuration; hand to hand instead of a broker, and forecast, hub and store in memory. What lives on after the
kill is a copy of the stub and its car: nothing else speaks to it any more.

What cannot be: a car that comes home after the kill, emptier than could be known, has what is left of its stay once
the timer is over, which is `dead_man_s` after the kill at the latest. A morning that even charging without a pause
(from then on, or for one that was home before: from its arrival) does not reach counts as kept where it comes as far.

    python -m tests.dead_man            all kinds, nights and quarter hours
"""

import argparse
import copy
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from plugd import daemon, perception, sessions
from plugd.config import household, parse
from plugd.controller import Controller
from plugd.cycle import Cycle
from plugd.domain import Household, Overrides, SetSoc
from plugd.planner.exact import Exact
from plugd.ports import Plug
from plugd.study.house import FunctionSource, RamStore, SimHub
from plugd.study.world import Battery, Morning, Stay
from plugd.units import hours
from plugd_hil.car import CarAtHome
from plugd_hil.plug import parser as stub_parser
from plugd_hil.plug import plug_at
from plugd_hil.socket import Plug as Stub
from tests.fakes import MIDNIGHT
from tests.wire import Wire, WireClock

KINDS = ("tasmota", "shelly2")
"""Those whose off ends by itself. The others stay off when plugd dies, and `plugd check` says so."""
QUARTER = timedelta(minutes=15)
QUARTERS = 96
DAY = timedelta(days=1)
FIRST_KILL = MIDNIGHT + timedelta(hours=12)


@dataclass(frozen=True, slots=True)
class Night:
    """A car, its habits and a forecast that make one way of waiting."""

    name: str
    arrival_soc: float
    """On both evenings: what is driven by day is what makes it so."""
    level: Callable[[datetime], float]
    """g/kWh of a half hour."""
    capacity_kwh: float = 50.0
    arrival_h: float = 18.0
    tells_soc: bool = True
    more: str = ""
    """Of [plug]."""


def clean_last(start: datetime) -> float:
    """The later the cleaner, until the morning: nobody charges before he must."""
    return 300.0 - 10.0 * ((start.hour - 12) % 24)


def clean_first(start: datetime) -> float:
    """The evening is the cleanest."""
    return 100.0 + 10.0 * ((start.hour - 18) % 24)


def clean_by_turns(start: datetime) -> float:
    """Every other hour is clean, the later the cleaner."""
    return clean_last(start) + (100.0 if start.hour % 2 else 0.0)


NIGHTS = (
    Night("the usual", 0.45, lambda start: 100.0 if 2 <= start.hour < 5 else 200.0),
    Night("the last clean hours", 0.45, clean_last),
    Night("a short charge, late", 0.46, clean_last, capacity_kwh=20.0),
    Night("a long charge", 0.3, clean_last),
    Night("clean by turns", 0.36, clean_by_turns),
    Night("clean at once", 0.4, clean_first),
    Night("home early", 0.4, clean_last, arrival_h=15.0),
    Night("home late", 0.42, clean_by_turns, arrival_h=21.0),
    Night("nobody tells the SOC", 0.45, clean_last, tells_soc=False),
    Night("a timer of two hours", 0.45, clean_last, more="dead_man_s = 7200\n"),
    Night("a timer of four hours", 0.46, clean_last, capacity_kwh=20.0, more="dead_man_s = 14400\n"),
    Night("a timer of twelve hours", 0.46, clean_last, capacity_kwh=20.0, more="dead_man_s = 43200\n"),
    Night("a long timer, clean by turns", 0.4, clean_by_turns, capacity_kwh=30.0, more="dead_man_s = 10800\n"),
    Night("more than a night can give", 0.1, clean_last, arrival_h=23.1),
)


@dataclass(slots=True)
class World:
    """The stub, its car, and when that comes and goes. A copy of it lives on alone."""

    stub: Stub
    car: CarAtHome
    night: Night
    reach: Battery | None = None
    """A battery that charges from arrival without a pause."""
    stays: list[Stay] = field(default_factory=list)
    known: bool = True
    """Whether plugd lived when the car last came."""
    timer_over: datetime | None = None
    """After a kill: when the timer is over at the latest."""

    def next_event(self) -> datetime:
        """When the car next comes or goes."""
        stay = self.stays[0]
        return stay.departure if self.car.connected else stay.arrival

    def happen(self, now: datetime) -> bool:
        """The car comes or goes, if it is time. Returns whether it has come."""
        if now < self.next_event():
            return False
        if self.car.connected:
            self.car.leave()
            self.stays.pop(0)
            self.reach = None
            return False
        battery = self.car.battery
        battery.energy_kwh = self.night.arrival_soc * battery.capacity_kwh
        self.car.arrive()
        self.known = self.timer_over is None
        self.reach = Battery(battery.capacity_kwh, battery.energy_kwh, battery.efficiency)
        return True

    def ran(self, start: datetime, end: datetime, power_kw: float) -> None:
        """What could have been charged meanwhile."""
        if self.reach is not None and self.timer_over is not None and not self.known:
            start = max(start, self.timer_over)
        if self.reach is not None and end > start:
            self.reach.charge(power_kw, hours(end - start))

    def live_on(self, start: datetime, until: datetime, power_kw: float) -> None:
        """Without plugd."""
        now = start
        while now < until:
            after = min(until, max(self.next_event(), now))
            self.stub.board.advance(after)
            self.ran(now, after, power_kw)
            if self.happen(after):
                self.stub.load_changed()
            now = after


@dataclass(frozen=True, slots=True)
class Killed:
    """One kill, and the morning after."""

    at: datetime
    was_on: bool
    morning: Morning


class Day:
    """The daemon's cycle with its adapter and a stub, from midnight on."""

    def __init__(self, kind: str, night: Night) -> None:
        more = f"[car]\ncapacity_kwh = {night.capacity_kwh}\n"
        config = parse(f'[plug]\nkind = "{kind}"\ntopic = "ev-plug"\n{night.more}{more}')
        worlds: list[World] = []

        def make(_: CarAtHome, now: datetime) -> Stub:
            car = CarAtHome(Battery(night.capacity_kwh, 0.5 * night.capacity_kwh), False, None, now)
            stub = plug_at(car, now, stub_parser().parse_args(["--dialect", kind]))
            worlds.append(World(stub, car, night, stays=list(stays(night))))
            return stub

        self.wire = Wire(make)
        self.world = worlds[0]
        clock = WireClock(self.wire)
        self.dead_man_s = config.plug.dead_man_s
        self.plug: Plug = daemon.plug_for(config, self.wire, clock)
        self.home: Household = household(config, self.plug.capability)
        self.hub = SimHub()
        self.store = RamStore()
        self.cycle = Cycle(
            clock=clock,
            source=FunctionSource(lambda _, start: night.level(start)),
            plug=self.plug,
            hub=self.hub,
            store=self.store,
            controller=Controller(self.home, Exact(), seed=night.name),
            memory=perception.fresh(MIDNIGHT),
            spread=lambda: 0.0,
        )

    def run(self, until: datetime) -> None:
        """With plugd."""
        power_kw = self.home.capability.power_max_kw
        while self.wire.at < until:
            now = self.wire.at
            due = self.cycle.step()
            now = max(now, self.wire.at)
            stub_due = self.wire.stub.board.due()
            after = min(due, until, max(self.world.next_event(), now), *(() if stub_due is None else (stub_due,)))
            self.wire.pass_to(after)
            self.world.ran(now, self.wire.at, power_kw)
            if self.world.happen(self.wire.at):
                self.wire.say(self.wire.stub.load_changed())
                if self.world.night.tells_soc:
                    self.hub.said.append(SetSoc(self.world.car.battery.soc))

    def killed(self) -> Killed:
        """The morning after, were plugd killed now and never started again."""
        now, home = self.wire.at, self.home
        left = copy.deepcopy(self.world)
        left.timer_over = now + timedelta(seconds=self.dead_man_s)
        was_on = bool(self.cycle.memory.relay_on)
        session = next(w.session for w in sessions.windows(home, Overrides(), now))
        left.live_on(now, session.end, home.capability.power_max_kw)
        best = left.reach.soc if left.reach is not None else 0.0
        morning = Morning(session.end, session.minimum, left.car.battery.soc, best, left.car.connected)
        return Killed(now, was_on, morning)


def stays(night: Night) -> Iterator[Stay]:
    """Home every night, from the night's own hour to nine."""
    for k in range(-1, 4):
        evening = MIDNIGHT + k * DAY
        yield Stay(evening + timedelta(hours=night.arrival_h), evening + timedelta(hours=33), 0.0)


def kills(kind: str, night: Night, quarters: range = range(QUARTERS)) -> Iterator[Killed]:
    """Killed at these quarter hours from noon to noon."""
    day = Day(kind, night)
    for quarter in quarters:
        day.run(FIRST_KILL + quarter * QUARTER)
        yield day.killed()


def main() -> int:
    """Every kind, night and quarter hour."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "").parse_args()
    missed = 0
    for kind in KINDS:
        for night in NIGHTS:
            found = list(kills(kind, night))
            bad = [k for k in found if not k.morning.here or k.morning.missed]
            missed += len(bad)
            off = sum(not k.was_on for k in found)
            low = min(k.morning.soc - min(k.morning.minimum, k.morning.best_soc) for k in found)
            print(
                f"{kind:8} {night.name:28} {len(found)} kills, {off} with the relay off: {len(bad)} missed, "
                f"least {100 * low:+.2f} points from what was due or possible"
            )
            for k in bad:
                print(f"    {k.at:%H:%M} on={k.was_on} {k.morning}")
    print(f"missed: {missed}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
