"""The closed loop: a driver, a battery, a strategy, and what flowed.

It goes from event to event: plug-in, whenever the strategy's word runs out, session end, departure. While no car is
connected nothing is planned. What a strategy plans with is the daemon's own; what the daemon's cycle does around it
(ports, memory, guard, faults) is `plugd.study.house`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import pairwise, takewhile
from statistics import fmean

from plugd import habits, sessions, soc
from plugd.domain import Habits, Household, Orders, Overrides, Presence, Session, Setpoint, SocEstimate, Switch
from plugd.study.measured import Measured
from plugd.study.strategies import Strategy
from plugd.study.world import Battery, Driver, Morning, Stay
from plugd.units import hours, pieces


@dataclass(frozen=True, slots=True)
class World:
    """Who drives what, behind which plug, when. Stays count that lie wholly between `start` and `end`."""

    household: Household
    driver: Driver
    start: datetime
    end: datetime
    start_soc: float = 0.5


@dataclass(frozen=True, slots=True)
class Flow:
    """Energy at the plug in a half hour or a part of one, and the SOC after it."""

    start: datetime
    end: datetime
    kwh: float
    soc: float


@dataclass(frozen=True, slots=True)
class Night:
    """One stay as it was."""

    arrival: datetime
    departure: datetime
    arrival_soc: float
    departure_soc: float
    morning: Morning
    charged_kwh: float
    """At the plug."""
    carbon_g: float
    switch_ons: int
    driven_kwh: float
    """From the battery, after it."""
    left_short: bool
    """It left under a minimum that was reachable until then, whenever the session was expected to end."""


@dataclass(frozen=True, slots=True)
class Account:
    """What a strategy came to."""

    nights: tuple[Night, ...]
    flows: tuple[Flow, ...]
    end_kwh: float
    """In the battery when all is over."""
    used_kwh: float
    """At the plug, for what was driven."""
    mean_g_per_kwh: float
    """Intensity over all the time simulated."""

    @property
    def energy_kwh(self) -> float:
        """Charged, at the plug."""
        return sum(night.charged_kwh for night in self.nights)

    @property
    def carbon_g(self) -> float:
        """Emitted for it (paper eq. 2, on what was measured)."""
        return sum(night.carbon_g for night in self.nights)

    @property
    def carbon_g_per_kwh(self) -> float | None:
        """The paper's C_EV, of what was driven; None where nothing was.

        What the battery holds less at the end than at the start is owed at the mean intensity. What it holds more was
        charged for later, and leaves at the lower of the mean and what it cost. Otherwise a fortnight of charging to
        the ceiling would be judged by energy that it never drives.
        """
        owed_kwh, rate = self.used_kwh - self.energy_kwh, self.mean_g_per_kwh
        if owed_kwh < 0.0:
            rate = min(rate, self.carbon_g / self.energy_kwh)
        settled_g = self.carbon_g + owed_kwh * rate
        return settled_g / self.used_kwh if self.used_kwh > 0.0 else None

    @property
    def missed(self) -> int:
        """Mornings under a minimum that was reachable."""
        return sum(night.morning.missed for night in self.nights)

    @property
    def left_short(self) -> int:
        """Mornings on which the car left under a minimum that was reachable, whenever it left."""
        return sum(night.left_short for night in self.nights)

    @property
    def switch_ons(self) -> int:
        """From no power to some."""
        return sum(night.switch_ons for night in self.nights)


def stays(world: World) -> Iterator[Stay]:
    """The driver's stays."""
    return takewhile(lambda s: s.arrival < world.end, world.driver.stays(world.start))


def expected(stay: Stay, household: Household, world: World, known_until: datetime) -> tuple[Session, ...]:
    """The sessions expected at a plug-in, as far as the intensity is known; none where the stay does not count."""
    coming = sessions.expected(stay.arrival, household, Overrides(), Presence(), household.nights.horizon)
    known = tuple(session for session in coming if session.end <= known_until)
    counts = stay.arrival >= world.start and max(stay.departure, coming[0].end) <= min(world.end, known_until)
    return known if counts else ()


@dataclass(slots=True)
class Loop:
    """A battery at a plug under a strategy's orders."""

    household: Household
    strategy: Strategy
    found: Measured
    battery: Battery
    flows: list[Flow] = field(default_factory=list)

    def night(self, stay: Stay, coming: tuple[Session, ...]) -> Night:
        """One stay, and the driving after it."""
        battery, session, first = self.battery, coming[0], len(self.flows)
        arrival_soc = at_session_end = battery.soc
        estimate = soc.told(soc.unknown(stay.arrival), arrival_soc, stay.arrival, "car")
        self.strategy.plugged_in(stay.arrival, coming, self.household)
        now, power_kw, switch_ons = stay.arrival, 0.0, 0
        while now < stay.departure:
            orders = self.strategy.orders(now, estimate)
            until = min(orders.until, stay.departure, session.end if now < session.end else stay.departure)
            for start, end, offered_kw in spells(orders, now, until, self.household.capability.power_max_kw):
                switch_ons += int(offered_kw > 0.0 and power_kw == 0.0)
                power_kw = offered_kw
                if offered_kw > 0.0:
                    estimate = self._flow(start, end, offered_kw, estimate)
            now = until
            if now <= session.end:
                at_session_end = battery.soc
        flows, left_soc, left = self.flows[first:], battery.soc, replace(session, end=stay.departure)
        return Night(
            arrival=stay.arrival,
            departure=stay.departure,
            arrival_soc=arrival_soc,
            departure_soc=left_soc,
            morning=self._morning(stay, session, arrival_soc, at_session_end),
            charged_kwh=sum(flow.kwh for flow in flows),
            carbon_g=sum(flow.kwh * self.found.actual[self.found.index(flow.start)] for flow in flows),
            switch_ons=switch_ons,
            driven_kwh=battery.drive(stay.use_kwh),
            left_short=self._morning(stay, left, arrival_soc, left_soc).missed,
        )

    def _flow(self, start: datetime, end: datetime, offered_kw: float, estimate: SocEstimate) -> SocEstimate:
        """Let power flow; returns the estimate after it."""
        for first, last in pieces(start, end):
            taken_kwh = self.battery.charge(offered_kw, hours(last - first))
            if taken_kwh > 0.0:
                self.flows.append(Flow(first, last, taken_kwh, self.battery.soc))
                estimate = soc.charged(estimate, taken_kwh, self.household.car)
        return estimate

    def _morning(self, stay: Stay, session: Session, arrival_soc: float, end_soc: float) -> Morning:
        """The session's end beside what charging without a pause since plug-in would have reached."""
        here_h = max(0.0, hours(session.end - stay.arrival))
        best_kwh = self.household.capability.power_max_kw * self.household.car.efficiency * here_h
        best_soc = max(arrival_soc, min(arrival_soc + best_kwh / self.battery.capacity_kwh, session.ceiling))
        return Morning(session.end, session.minimum, end_soc, best_soc, stay.arrival < session.end <= stay.departure)


def spells(
    orders: Orders, now: datetime, until: datetime, relay_kw: float
) -> Iterator[tuple[datetime, datetime, float]]:
    """What is offered from `now` to `until`: (start, end, kW). A relay gives `relay_kw` or nothing."""
    if isinstance(orders, Setpoint):
        yield now, until, orders.power_kw
        return
    moves = (switch for switch in orders.switches if now < switch.at < until)
    edges = (Switch(now, orders.state(now)), *moves, Switch(until, on=False))
    for a, b in pairwise(edges):
        yield a.at, b.at, relay_kw if a.on else 0.0


def _lived(world: World, loop: Loop) -> Iterator[Night]:
    """The nights of a world, each with what was learned from those before it."""
    seen = Habits()
    for stay in stays(world):
        loop.household = habits.informed(world.household, seen)
        coming = expected(stay, loop.household, world, loop.found.end)
        if not coming:
            continue
        night = loop.night(stay, coming)
        yield night
        found = habits.nights_of(stay.arrival, stay.departure, world.household)
        seen = habits.kept(seen, *(replace(one, use_kwh=night.driven_kwh) for one in found))


def simulate(world: World, strategy: Strategy, found: Measured) -> Account:
    """All stays of a world under a strategy."""
    car = world.household.car
    battery = Battery(car.capacity_kwh, world.start_soc * car.capacity_kwh, car.efficiency)
    loop = Loop(world.household, strategy, found, battery)
    nights = tuple(_lived(world, loop))
    simulated = found.actual[found.index(world.start) : found.index(world.end)]
    return Account(
        nights,
        tuple(loop.flows),
        battery.energy_kwh,
        used_kwh=sum(night.driven_kwh for night in nights) / car.efficiency,
        mean_g_per_kwh=fmean(simulated) if simulated else 0.0,
    )
