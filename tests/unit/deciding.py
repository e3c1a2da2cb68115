"""A household, its clock and its memory, for the tests of who decides what."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, time, timedelta

from plugd.controller import Controller
from plugd.cycle import Cycle
from plugd.domain import (
    Capability,
    Fault,
    Forecast,
    Household,
    Intensity,
    Memory,
    Nights,
    Outlook,
    Plan,
    PlanSlot,
    Reading,
    Record,
    Relay,
    RelayRules,
    Session,
    SessionPlan,
    SocEstimate,
    Switch,
    Switching,
    Wanted,
)
from plugd.errors import ForecastError, PlugError, StoreError
from plugd.planner.exact import Exact
from plugd.planner.problem import Problem, Solution
from plugd.study.house import RamStore, SimHub
from plugd.units import HALF_HOUR, hours, pieces, slot_start
from tests.fakes import FakeClock

HOME = Household(relay=RelayRules(random_delay_s=0.0))
"""The paper's: expected at the plug from 20:03 to 06:57 UTC in January, 50 % in the morning, 2.3 kW."""
CHARGER = replace(HOME, capability=Capability(7.4, modulating=True, power_min_kw=1.4))


def at(hour: int, minute: int = 0, day: int = 2, second: int = 0) -> datetime:
    """A moment of January 2023. The 2nd is a Monday; the night of most tests is the one to the 3rd."""
    return datetime(2023, 1, day, hour, minute, second, tzinfo=UTC)


EVENING, NIGHT, NOON = at(18), at(23), at(12)
EXPECTED, READY_BY = at(20, 3), at(6, 57, day=3)
"""When the car is there, and until when."""


def home(minimum: float = 0.5, ready_by: time | None = None) -> Household:
    """The household with another wish."""
    return replace(HOME, nights=Nights(minimum=minimum, ready_by=ready_by))


def knows(soc: float, now: datetime = EVENING, sd: float = 0.0) -> Memory:
    """Memory of a car whose SOC was told on `now`, after that day's driving."""
    driven_to = max(now, at(20, 3, day=now.day))
    return Memory(soc=SocEstimate(soc, sd, "hub", now, driven_to))


def switching(*switches: tuple[datetime, bool], until: datetime = READY_BY) -> Switching:
    """Orders for a relay."""
    return Switching(tuple(Switch(moment, on) for moment, on in switches), until)


def session(start: datetime = EXPECTED, end: datetime = READY_BY, minimum: float = 0.5) -> Session:
    """One night."""
    return Session(start, end, minimum, 11.28, 0.8)


def planned(
    night: Session, on: Callable[[datetime], float] = lambda start: 0.0, soc_end: float = 0.6, short_kwh: float = 0.0
) -> SessionPlan:
    """A night's plan from the power of each slot, at 100 g/kWh."""
    slots = tuple(PlanSlot(first, last, on(first), 2.3, 100.0) for first, last in pieces(night.start, night.end))
    return SessionPlan(night, slots, soc_end, short_kwh)


def plan(*nights: SessionPlan, made_at: datetime = EVENING) -> Plan:
    """What was planned then."""
    return Plan(made_at, nights, "solved", "exact", 0.0, 0.0)


def forecast(issued_at: datetime, slots: int = 96, level: Callable[[datetime], float] | None = None) -> Forecast:
    """A forecast from that half hour on: cheapest from 02:00 to 05:00."""

    def usual(start: datetime) -> float:
        return 100.0 if 2 <= start.hour < 5 else 200.0

    first = slot_start(issued_at)
    starts = (first + k * HALF_HOUR for k in range(slots))
    return Forecast(issued_at, "13", tuple(Intensity(s, (level or usual)(s)) for s in starts))


# -- ports ----------------------------------------------------------------------------------------


@dataclass(slots=True)
class Source:
    """A forecast source with moods."""

    error: ForecastError | None = None
    slots: int = 96
    level: Callable[[datetime], float] | None = None
    asked: list[datetime] = field(default_factory=list)

    def fetch(self, now: datetime) -> Forecast:
        """A fresh one, or what is wrong."""
        self.asked.append(now)
        if self.error is not None:
            raise self.error
        return forecast(now, self.slots, self.level)


@dataclass(slots=True)
class Box:
    """A plug that keeps a list of what it was told. The car takes all it is given."""

    clock: FakeClock
    capability: Capability = HOME.capability
    on: bool = False
    power_kw: float = 2.3
    current_a: float | None = None
    energy_kwh: float = 0.0
    ran_to: datetime | None = None
    told: list[Wanted] = field(default_factory=list)
    tries: list[datetime] = field(default_factory=list)
    silent: PlugError | None = None
    refuses: PlugError | None = None
    tend_fails: PlugError | None = None
    moved: bool | None = None
    came_back: bool = False
    warnings: Sequence[Fault] = ()
    due_at: datetime | None = None
    tended: list[datetime] = field(default_factory=list)

    def read(self) -> Reading:
        """As it is; each event once."""
        if self.silent is not None:
            raise self.silent
        now = self.clock.now()
        if self.ran_to is not None and self.on:
            self.energy_kwh += self.power_kw * hours(now - self.ran_to)
        self.ran_to = now
        reading = Reading(
            now, self.on, self.power_kw if self.on else 0.0, self.energy_kwh, now, self.moved, self.came_back,
            current_a=self.current_a if self.on else None,
        )  # fmt: skip
        self.moved, self.came_back = None, False
        return reading

    def set(self, wanted: Wanted) -> None:
        """Obey, unless it refuses."""
        self.tries.append(self.clock.now())
        if self.refuses is not None:
            raise self.refuses
        self.told.append(wanted)
        self.on = wanted.on if isinstance(wanted, Relay) else wanted.power_kw > 0.0

    def press(self) -> None:
        """A person presses the button."""
        self.read()
        self.on = self.moved = not self.on

    def tend(self, now: datetime) -> None:
        """Remember."""
        self.tended.append(now)
        if self.tend_fails is not None:
            raise self.tend_fails

    def due(self) -> datetime | None:
        """As told."""
        return self.due_at


@dataclass(slots=True)
class Disk:
    """A store of which some parts fail."""

    broken: set[str] = field(default_factory=set)
    ram: RamStore = field(default_factory=RamStore)
    saves: int = 0

    def _try(self, what: str) -> None:
        if what in self.broken:
            raise StoreError(f"{what}: the card is full")

    def load(self) -> Memory | None:
        """What was saved."""
        return self.ram.load()

    def save(self, memory: Memory) -> None:
        """Keep, or fail."""
        self._try("save")
        self.saves += 1
        self.ram.save(memory)

    def append(self, record: Record) -> None:
        """Keep, or fail."""
        self._try("append")
        self.ram.append(record)

    def keep(self, issued: Forecast) -> None:
        """Keep, or fail."""
        self._try("keep")
        self.ram.keep(issued)

    def latest_forecast(self) -> Forecast | None:
        """None."""
        return None

    def history(self, since: datetime) -> tuple[Intensity, ...]:
        """What was kept, or fail."""
        self._try("history")
        return self.ram.history(since)

    def issued(self, since: datetime) -> tuple[Forecast, ...]:
        """What was kept, or fail."""
        self._try("issued")
        return self.ram.issued(since)

    def expect(self, at: datetime, outlook: Outlook) -> None:
        """Nobody scores it."""


@dataclass(slots=True)
class Counted:
    """A solver that is counted."""

    calls: int = 0

    def solve(self, problem: Problem) -> Solution:
        """As the exact one."""
        self.calls += 1
        return Exact().solve(problem)


class Room:
    """One household's cycle with its ports in reach."""

    def __init__(self, start: datetime, memory: Memory, household: Household = HOME) -> None:
        self.clock = FakeClock(start)
        self.source = Source()
        self.plug = Box(self.clock, household.capability)
        self.hub = SimHub()
        self.disk = Disk()
        self.solver = Counted()
        self.household = household
        self.cycle = self.begin(memory)

    def begin(self, memory: Memory, known: Forecast | None = None) -> Cycle:
        """The daemon starts."""
        self.cycle = Cycle(
            clock=self.clock,
            source=self.source,
            plug=self.plug,
            hub=self.hub,
            store=self.disk,
            controller=Controller(self.household, self.solver),
            memory=memory,
            spread=lambda: 0.0,
            forecast=known,
        )
        return self.cycle

    def step(self, now: datetime | None = None) -> datetime:
        """One step of the cycle, at `now` where given. Returns when the next is due."""
        self.clock.at = now or self.clock.at
        return self.cycle.step()

    def run(self, until: datetime) -> list[datetime]:
        """Steps when they are due, up to `until`. Returns their moments."""
        steps = []
        while self.clock.at < until:
            steps.append(self.clock.at)
            due = self.cycle.step()
            assert due > self.clock.at
            self.clock.at = min(due, until)
        return steps

    def faults(self) -> dict[str, str]:
        """Code and text of what is told to be wrong."""
        assert self.hub.decision
        found = {fault.code: fault.text for fault in self.hub.decision.faults}
        assert len(found) == len(self.hub.decision.faults)
        return found


def minutes(count: float) -> timedelta:
    """A time span."""
    return timedelta(minutes=count)
