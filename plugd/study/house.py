"""A simulated house for the daemon's own cycle: clock, plug with a car behind it, forecast, hub and store in memory."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from plugd import perception, sessions
from plugd.controller import Controller
from plugd.cycle import Cycle
from plugd.domain import (
    Answer,
    Capability,
    Command,
    Decision,
    Fault,
    Forecast,
    Household,
    Intensity,
    Memory,
    Outlook,
    Overrides,
    PastRow,
    Reading,
    Record,
    Relay,
    SetConnected,
    SetSoc,
    Wanted,
)
from plugd.outlook import Learned
from plugd.planner.problem import Solver
from plugd.ports import ForecastSource, Inbox
from plugd.study.world import Battery, Morning, Stay
from plugd.units import HALF_HOUR, hours, pieces, slot_start

MOST_FORECASTS = 56 * 48
"""Eight weeks of them."""


@dataclass(slots=True)
class SimClock:
    """Time that is set. Nothing arrives while somebody waits here, so a wait is a jump."""

    at: datetime
    start: datetime = field(init=False)

    def __post_init__(self) -> None:
        self.start = self.at

    def now(self) -> datetime:
        """Simulated time."""
        return self.at

    def monotonic(self) -> float:
        """Simulated seconds since the start."""
        return (self.at - self.start).total_seconds()

    def wait(self, until: datetime, woken_by: Inbox | None = None) -> None:
        """Jump."""
        self.at = max(self.at, until)


@dataclass(slots=True)
class SimPlug:
    """A plug that always obeys, and the car behind it. Implements `plugd.ports.Plug`."""

    clock: SimClock
    battery: Battery
    capability: Capability
    connected: bool = False
    offered_kw: float = 0.0
    energy_kwh: float = 0.0
    switch_ons: int = 0
    flows: dict[datetime, float] = field(default_factory=dict)
    """Energy at the plug by half hour."""
    warnings: Sequence[Fault] = ()

    def read(self) -> Reading:
        """What a plug with a meter would tell now."""
        now = self.clock.now()
        power_kw = self.battery.takes_kw(self.offered_kw) if self.connected else 0.0
        return Reading(now, self.offered_kw > 0.0, power_kw, self.energy_kwh, now)

    def set(self, wanted: Wanted) -> None:
        """Obey."""
        if isinstance(wanted, Relay):
            offered_kw = self.capability.power_max_kw if wanted.on else 0.0
        else:
            offered_kw = wanted.power_kw
        self.switch_ons += int(offered_kw > 0.0 and self.offered_kw == 0.0)
        self.offered_kw = offered_kw

    def tend(self, now: datetime) -> None:
        """No timer to renew."""

    def due(self) -> datetime | None:
        """Never."""
        return None

    def pass_time(self, start: datetime, end: datetime) -> None:
        """Let power flow from `start` to `end`."""
        if not (self.connected and self.offered_kw > 0.0):
            return
        for first, last in pieces(start, end):
            taken_kwh = self.battery.charge(self.offered_kw, hours(last - first))
            self.energy_kwh += taken_kwh
            slot = slot_start(first)
            self.flows[slot] = self.flows.get(slot, 0.0) + taken_kwh


@dataclass(slots=True)
class FunctionSource:
    """A forecast computed from a function of (issued at, half hour); None leaves the half hour out."""

    value: Callable[[datetime, datetime], float | None]
    slots: int = 96

    def fetch(self, now: datetime) -> Forecast:
        """The forecast issued now."""
        first = slot_start(now)
        starts = [first + k * HALF_HOUR for k in range(self.slots)]
        rows = [(start, self.value(now, start)) for start in starts]
        return Forecast(now, "simulated", tuple(Intensity(s, g) for s, g in rows if g is not None))


@dataclass(slots=True)
class SimHub:
    """Somebody who says what is put into `said`, and keeps the last decision and the faults seen."""

    said: list[Command] = field(default_factory=list)
    decision: Decision | None = None
    answers: list[Answer] = field(default_factory=list)
    faults: set[str] = field(default_factory=set)
    warnings: tuple[Fault, ...] = ()

    def commands(self) -> Sequence[Command]:
        """What was said since the last call."""
        said, self.said = tuple(self.said), []
        return said

    def publish(self, decision: Decision, reading: Reading | None) -> None:
        """Remember."""
        self.decision = decision
        self.faults |= {fault.code for fault in decision.faults}

    def answer(self, answers: Sequence[Answer]) -> None:
        """Remember."""
        self.answers.extend(answers)


@dataclass(slots=True)
class RamStore:
    """A store that forgets when the program ends."""

    memory: Memory | None = None
    seen: dict[datetime, Intensity] = field(default_factory=dict)
    measured: set[datetime] = field(default_factory=set)
    """Those of `seen` that are no expectation."""
    records: list[Record] = field(default_factory=list)
    forecasts: deque[Forecast] = field(default_factory=lambda: deque(maxlen=MOST_FORECASTS))

    def load(self) -> Memory | None:
        """What was saved."""
        return self.memory

    def save(self, memory: Memory) -> None:
        """Keep."""
        self.memory = memory

    def append(self, record: Record) -> None:
        """Keep."""
        self.records.append(record)

    def keep(self, forecast: Forecast) -> None:
        """Remember the nearest expectation of each half hour, and what was measured."""
        self.forecasts.append(forecast)
        last = next(reversed(self.seen), None)
        rows = (*forecast.actual, *forecast.expected[:2])
        late = any(last is not None and row.start < last and row.start not in self.seen for row in rows)
        self.seen |= {row.start: row for row in rows}
        self.measured |= {row.start for row in forecast.actual}
        if late:  # measured after an outage
            self.seen = dict(sorted(self.seen.items()))

    def latest_forecast(self) -> Forecast | None:
        """None: a simulation begins without one."""
        return None

    def history(self, since: datetime) -> tuple[Intensity, ...]:
        """What was kept from `since` on. Nobody asks for anything older afterwards, so that goes."""
        while self.seen and next(iter(self.seen)) < since:
            del self.seen[next(iter(self.seen))]
        return tuple(self.seen.values())

    def issued(self, since: datetime) -> tuple[Forecast, ...]:
        """As kept."""
        return tuple(forecast for forecast in self.forecasts if forecast.issued_at >= since)

    def expect(self, at: datetime, outlook: Outlook) -> None:
        """Nobody scores a simulation."""

    def keep_past(self, region: str, rows: Iterable[PastRow]) -> None:
        """Remember what was measured."""
        measured = {row.start: Intensity(row.start, row.actual) for row in rows if row.actual is not None}
        self.seen = dict(sorted((self.seen | measured).items()))
        self.measured |= measured.keys()

    def lacks(self, region: str, start: datetime, end: datetime, measured: bool) -> int:
        """Half hours of which nothing is known, or nothing measured."""
        known = self.measured if measured else self.seen.keys()
        return max(0, -((start - end) // HALF_HOUR) - sum(start <= slot < end for slot in known))


@dataclass(slots=True)
class House:
    """The cycle in its simulated house. `run` lets time pass and collects the mornings."""

    household: Household
    solver: Solver
    source: ForecastSource
    stays: Iterator[Stay]
    start: datetime
    battery: Battery = field(default_factory=Battery)
    tells_soc: bool = True
    tells_presence: bool = False
    learned: Learned | None = None
    """What the cycle begins with, as the daemon does; None: forecasts are taken as they are."""
    clock: SimClock = field(init=False)
    plug: SimPlug = field(init=False)
    hub: SimHub = field(default_factory=SimHub)
    store: RamStore = field(default_factory=RamStore)
    cycle: Cycle = field(init=False)
    mornings: list[Morning] = field(default_factory=list)
    guarded: list[datetime] = field(default_factory=list)
    """When the guard fired."""
    stay: Stay | None = None
    coming: Stay | None = None
    reach: Battery | None = None
    """A battery that charges from arrival without a pause."""

    def __post_init__(self) -> None:
        self.clock = SimClock(self.start)
        self.plug = SimPlug(self.clock, self.battery, self.household.capability)
        self.cycle = Cycle(
            clock=self.clock,
            source=self.source,
            plug=self.plug,
            hub=self.hub,
            store=self.store,
            controller=Controller(self.household, self.solver),
            memory=perception.fresh(self.start),
            spread=lambda: 0.0,
            learned=self.learned,
        )
        self.coming = next((s for s in self.stays if s.arrival >= self.start), None)

    def run(self, until: datetime) -> None:
        """Let time pass to `until`."""
        for window in sessions.windows(self.household, Overrides(), self.start):
            session = window.session
            if session.end > until:
                break
            self._run(session.end)
            best = self.reach.soc if self.reach else 0.0
            self.mornings.append(Morning(session.end, session.minimum, self.battery.soc, best, self.plug.connected))
        self._run(until)

    def _run(self, until: datetime) -> None:
        now = self.clock.now()
        while now < until:
            fired = self.cycle.memory.guard_count
            due = self.cycle.step()
            if self.cycle.memory.guard_count > fired:
                self.guarded.append(now)
            after = min(due, until, self._next_event())
            self.plug.pass_time(now, after)
            if self.reach is not None and self.plug.connected:
                self.reach.charge(self.household.capability.power_max_kw, hours(after - now))
            self.clock.wait(after)
            now = after
            self._happen(now)

    def _next_event(self) -> datetime:
        moments = [self.stay.departure if self.stay else None, self.coming.arrival if self.coming else None]
        return min((m for m in moments if m is not None), default=self.clock.now() + timedelta(days=1))

    def _happen(self, now: datetime) -> None:
        """Arrivals and departures that are due."""
        if self.stay is not None and self.stay.departure <= now:
            self.battery.drive(self.stay.use_kwh)
            self.stay, self.plug.connected, self.reach = None, False, None
            self.hub.said += self._presence(False)
        if self.coming is not None and self.coming.arrival <= now and self.stay is None:
            self.stay, self.coming = self.coming, next(self.stays, None)
            self.plug.connected = True
            self.reach = Battery(self.battery.capacity_kwh, self.battery.energy_kwh, self.battery.efficiency)
            self.hub.said += self._presence(True)
            if self.tells_soc:
                self.hub.said.append(SetSoc(self.battery.soc, source="car"))

    def _presence(self, here: bool) -> list[Command]:
        return [SetConnected(here)] if self.tells_presence else []
