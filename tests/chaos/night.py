"""One night: a household, a car, a plug and what befalls them; then whether every promise was kept."""

import heapq
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time, timedelta
from itertools import count
from zoneinfo import ZoneInfo

from plugd import sessions
from plugd.controller import Controller
from plugd.cycle import Cycle
from plugd.domain import (
    Capability,
    Command,
    Household,
    Memory,
    Nights,
    Overrides,
    Presence,
    Session,
    SetConnected,
    SetSoc,
    SocEstimate,
)
from plugd.errors import StoreError
from plugd.perception import fresh
from plugd.planner.exact import Exact
from plugd.planner.problem import Solver
from plugd.study.house import SimHub
from plugd.study.world import Battery
from plugd.units import hours, require_utc
from plugd_hil.car import CarAtHome
from tests.chaos.ports import TIMER_S, ChaosPlug, ChaosSource, ChaosStore, Device, TrueClock

LONDON = ZoneInfo("Europe/London")
SWITCH_DAYS = (date(2023, 3, 25), date(2023, 10, 28))
"""The evenings before the clocks change."""
SLACK = 0.01
"""Of the battery (0.5 kWh): a morning missed by less counts as kept."""
LOOKS_S = (10.0, 60.0, 130.0)
"""The daemon looks every 10 s. Here it looks when something is due, and at these times after anything happens."""
WITHIN = timedelta(seconds=60)
LOOKS_ALONE = timedelta(seconds=25)
"""A trouble alone is looked for nearly as often as on a real clock."""
MOST_ORDERS = 14
"""Times that plugd may close the relay in a night: the plan's six, and what guard, waking and faults add."""


@dataclass(frozen=True, slots=True)
class Said:
    """What was in plugd's state from a moment on."""

    at: datetime
    codes: frozenset[str]
    reason: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """How it went."""

    seed: int
    faults: tuple[str, ...]
    soc: float
    minimum: float
    best: float
    judged: bool
    orders: int
    objections: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something to befall a night: what begins it, what ends it, how long it lasts, and what is said of it."""

    name: str
    row: str
    """Of the failure table."""
    begin: Callable[["Night"], None]
    end: Callable[["Night"], None] | None = None
    lasts_min: tuple[float, float] = (5.0, 600.0)
    says: str = ""
    """A fault's code, or words of the reason, that stand in `state` within `WITHIN` of when it can be known."""
    silent: str = ""
    """Why nothing is to be said, where nothing is."""
    known: Callable[["Night", datetime], datetime] = lambda _, start: start
    """When it can be known, in a night of its own that has been lived and in which it began then."""
    at_h: float = 5.0
    """When it begins in a night of its own, in hours after 14:00."""
    before: Callable[["Night"], None] | None = None
    """What it asks of the night before anything happens."""
    span_h: tuple[float, float] = (2.0, 16.0)
    """When it may begin, in hours after 14:00."""


@dataclass(slots=True)
class Night:
    """A simulated afternoon, evening and night. `run` lives it."""

    seed: int
    dice: random.Random = field(init=False)
    clock: TrueClock = field(init=False)
    home: Household = field(init=False)
    session: Session = field(init=False)
    car: CarAtHome = field(init=False)
    device: Device = field(init=False)
    plug: ChaosPlug = field(init=False)
    source: ChaosSource = field(init=False)
    store: ChaosStore = field(default_factory=ChaosStore)
    hub: SimHub = field(default_factory=SimHub)
    solver: Solver = field(default_factory=Exact)
    cycle: Cycle | None = None
    tells_soc: bool = True
    tells_presence: bool = True
    use_kwh: float = 5.8
    arrival: datetime = field(init=False)
    reach: Battery | None = None
    lost_at: datetime | None = None
    """Since when nothing reaches the plug."""
    blocked: bool = False
    """Plug, mains or car stand in the way, whatever anybody does."""
    untold: bool = False
    """Nobody has told the machine the time since it was switched on."""
    stuck_alone: bool = False
    """It stuck off when nobody reached it and no timer ran any more: whoever told it to come on did so in vain."""
    waits: bool = False
    """A trouble waits for the relay to be as it needs it."""
    person_off: bool = False
    said: list[Said] = field(default_factory=list)
    flowed: list[tuple[datetime, float]] = field(default_factory=list)
    """What the plug had truly given by then, in kWh."""
    struck_at: datetime | None = None
    """When a trouble that waits for the relay to be as it needs it has struck."""
    objections: list[str] = field(default_factory=list)
    _events: list[tuple[datetime, int, Callable[[], None]]] = field(default_factory=list)
    _order: Iterator[int] = field(default_factory=count)

    def __post_init__(self) -> None:
        dice = self.dice = random.Random(f"night {self.seed}")
        day = dice.choice(SWITCH_DAYS) if dice.random() < 0.15 else date(2023, 1, 9) + timedelta(dice.randrange(340))
        start = require_utc(datetime.combine(day, time(14, 0), LONDON))
        self.clock = TrueClock(start, start)
        fixed = TIMER_S if dice.random() < 0.5 else None
        self.home = Household(
            nights=Nights(horizon=dice.randrange(1, 5), minimum=dice.choice((0.4, 0.5, 0.6))),
            capability=Capability(2.3, dead_man=True, fixed_timer_s=fixed),
            max_current_a=None if dice.random() < 0.5 else 10.5,
        )
        self.session = next(w.session for w in sessions.windows(self.home, Overrides(), start))
        soc = dice.uniform(0.25, 0.75)
        self.use_kwh = min(10.5, max(0.0, dice.gauss(5.8, 2.67)))
        self.tells_soc, self.tells_presence = dice.random() < 0.5, dice.random() < 0.5
        self.arrival = start + timedelta(hours=dice.uniform(2.0, 5.5))
        self.car = CarAtHome(Battery(50.0, soc * 50.0 - self.use_kwh), False, None, start)
        self.device = Device(self.clock, self.car)
        self.plug = ChaosPlug(self.clock, self.device, self.home.capability)
        levels = [dice.uniform(30.0, 350.0) for _ in range(48)]
        self.source = ChaosSource(self.clock, lambda slot: levels[2 * slot.hour + slot.minute // 30])
        memory = Memory(
            SocEstimate(soc, 0.01, "hub", start, start), presence=Presence(False if self.tells_presence else None)
        )
        self.begin(memory)

    # -- what may be done to it -------------------------------------------------------------------

    def at(self, moment: datetime, act: Callable[[], None]) -> None:
        """Do something then, and look afterwards as the daemon does."""
        heapq.heappush(self._events, (moment, next(self._order), act))
        for wait_s in LOOKS_S:
            heapq.heappush(self._events, (moment + timedelta(seconds=wait_s), next(self._order), _nothing))

    def later(self, minutes: float, act: Callable[[], None]) -> None:
        """Do something in so many minutes."""
        self.at(self.clock.at + timedelta(minutes=minutes), act)

    def say(self, command: Command) -> None:
        """Somebody commands; without broker or daemon nobody hears it."""
        if self.cycle is not None and self.plug.broker:
            self.hub.said.append(command)

    def begin(self, memory: Memory | None) -> None:
        """The daemon starts, with the forecast that was kept."""
        self.plug = self.plug.restarted()
        try:
            forecast = self.store.latest_forecast()
        except StoreError:
            forecast = None
        self.cycle = Cycle(
            clock=self.clock,
            source=self.source,
            plug=self.plug,
            hub=self.hub,
            store=self.store,
            controller=Controller(self.home, self.solver, seed=str(self.seed)),
            memory=memory or fresh(self.clock.now()),
            spread=lambda: 0.5,
            forecast=forecast,
            unset=lambda: self.untold,
        )
        self.lost_at = None if self.reachable() else self.lost_at

    def kill(self) -> None:
        """It is killed."""
        self.cycle = None
        self.hub.said.clear()

    def lose(self) -> None:
        """From now on nothing reaches the plug."""
        self.lost_at = self.lost_at or self.clock.at

    def found(self) -> None:
        """It can be reached again, unless something else is in the way."""
        if self.reachable():
            self.lost_at = None

    def reachable(self) -> bool:
        """Whether an order would arrive."""
        device = self.device
        return self.cycle is not None and self.plug.broker and not (device.silent or device.deaf)

    def look_often(self, trouble: Trouble, since: datetime) -> None:
        """From then on, nearly as often as on a real clock, until it is said."""

        def again() -> None:
            if not self.heard(trouble, since):
                heapq.heappush(self._events, (self.clock.at + LOOKS_ALONE, next(self._order), again))

        heapq.heappush(self._events, (since, next(self._order), again))

    def heard(self, trouble: Trouble, since: datetime) -> list[datetime]:
        """When something was said of it, not before it began."""
        said = (s for s in self.said if trouble.says in s.codes or trouble.says in s.reason)
        return [s.at for s in said if s.at >= since]

    # -- living -----------------------------------------------------------------------------------

    @property
    def end(self) -> datetime:
        """When it is judged."""
        return self.session.end

    def _in_the_way(self) -> bool:
        """Whether no power could flow now, whatever anybody does. A plug without a timer does nothing unless told."""
        device = self.device
        unreached = self.lost_at is not None and not self.home.capability.dead_man
        return not device.powered or not self.car.connected or (not device.on and (device.jammed or unreached))

    def deliverable(self) -> bool:
        """Whether power could flow now if everybody who works did the right thing."""
        if self._in_the_way():
            return False
        if self.lost_at is None or self.device.on:
            return True
        return not self.stuck_alone and self.clock.at - self.lost_at >= timedelta(seconds=TIMER_S)

    def run(self) -> None:
        """Live it."""
        self.at(self.arrival, self._arrive)
        self.live(self.end)

    def live(self, until: datetime) -> None:
        """Let time pass, what is to happen on the way included."""
        while self.clock.at < until and not any("fell over" in found for found in self.objections):
            now = self.clock.at
            moments = [until, self._step()]
            if self._events:
                moments.append(self._events[0][0])
            if self.lost_at is not None:
                moments.append(self.lost_at + timedelta(seconds=TIMER_S))
            after = min(moment for moment in moments if moment is not None and moment > now)
            self._see_what_is_possible()
            if self.reach is not None and self.deliverable():
                self.reach.charge(min(self.device.power_kw, self.car.most_kw), hours(after - now))
            self.device.run(after)
            self.clock.at = after
            self.flowed.append((after, self.device.total_kwh))
            while self._events and self._events[0][0] <= after:
                heapq.heappop(self._events)[2]()

    def _see_what_is_possible(self) -> None:
        """Nobody foresees a plug that sticks: what is possible afterwards begins where that began."""
        device, blocked = self.device, self._in_the_way()
        if blocked and not self.blocked and self.reach is not None:
            self.reach.energy_kwh = min(self.reach.energy_kwh, self.car.battery.energy_kwh)
        self.blocked = blocked
        in_vain = device.jammed and not device.on and device.timer is None
        self.stuck_alone = self.lost_at is not None and (self.stuck_alone or in_vain)

    def _step(self) -> datetime | None:
        """One step of the daemon. Returns when it wants the next, in true time."""
        cycle = self.cycle
        if cycle is None:
            return None
        try:
            due = cycle.step()
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            self.objections.append(f"{self.clock.at}: the daemon fell over: {type(error).__name__}: {error}")
            return None
        shown = cycle.shown
        if shown is not None:
            codes = frozenset(fault.code for fault in shown.faults)
            if not self.said or (self.said[-1].codes, self.said[-1].reason) != (codes, shown.reason):
                self.said.append(Said(self.clock.at, codes, shown.reason))
        if due <= self.clock.now():
            self.objections.append(f"{self.clock.at}: the next step is not ahead")
        return max(due - self.clock.off, self.clock.at + timedelta(milliseconds=1))

    def _arrive(self) -> None:
        self.car.arrive()
        told = self.tells_presence and self.cycle is not None and self.plug.broker
        self.at(self.clock.at if told else max(self.clock.at, self.session.start), self._could_charge)
        if self.tells_presence:
            self.say(SetConnected(True))
        if self.tells_soc:
            self.say(SetSoc(self.car.battery.soc, source="car"))

    def _could_charge(self) -> None:
        """From now on somebody can know that the car is there: told so, or at the earliest of its usual times."""
        battery = self.car.battery
        self.reach = Battery(battery.capacity_kwh, battery.energy_kwh, battery.efficiency)

    def outcome(self, faults: tuple[str, ...]) -> Outcome:
        """Judge it."""
        soc, minimum = self.car.battery.soc, self.session.minimum
        best = self.reach.soc if self.reach is not None else 0.0
        judged = self.car.connected and not self.person_off
        found = list(self.objections)
        if judged and soc < min(minimum, best) - SLACK:
            found.append(f"morning: {100 * soc:.1f} % of {100 * minimum:.0f} %, {100 * best:.1f} % was possible")
        ons = sum(on for at, on in self.device.moves)
        if ons > MOST_ORDERS:
            found.append(f"the relay closed {ons} times")
        stepped = any(name.startswith(("clock", "boot")) for name in faults)  # a step of the clock may cost one
        if self.cycle is not None and len(self.cycle.memory.switch_ons) > self.home.relay.max_switch_on + stepped:
            found.append(f"the plan switched on {len(self.cycle.memory.switch_ons)} times")
        wrong = [at for at in self.store.at if not self.clock.start <= at <= self.end + timedelta(hours=2)]
        if wrong and wrong[0].astimezone(UTC).year < 2020:
            found.append(f"written from an unset clock: {wrong[0]}")
        return Outcome(self.seed, faults, soc, minimum, best, judged, ons, tuple(found))


def _nothing() -> None:
    """Only to look."""


def lived(seed: int, troubles: tuple[Trouble, ...]) -> Outcome:
    """A night with these, each at a moment drawn from the seed."""
    night = Night(seed)
    for trouble in troubles:
        if trouble.before is not None:
            trouble.before(night)
        low, high = trouble.span_h
        start = night.clock.start + timedelta(hours=night.dice.uniform(low, high))
        _strike(night, trouble, start, night.dice.uniform(*trouble.lasts_min))
    night.run()
    return night.outcome(tuple(trouble.name for trouble in troubles))


def single(trouble: Trouble) -> tuple[Outcome, Night]:
    """A night in which only this happens: a car at 35 % that is told of, home at 17:00."""
    night = Night(1)
    night.tells_soc = night.tells_presence = True
    night.arrival = night.clock.start + timedelta(hours=3)
    night.car.battery.energy_kwh = 17.5
    if trouble.before is not None:
        trouble.before(night)
    start = night.clock.start + timedelta(hours=trouble.at_h)
    _strike(night, trouble, start, max(trouble.lasts_min[1], 0.0))
    if trouble.says:
        night.look_often(trouble, start)
    night.run()
    known = trouble.known(night, start)
    if trouble.says and not any(at <= known + WITHIN for at in night.heard(trouble, start)):
        heard = sorted({code for said in night.said for code in said.codes})
        night.objections.append(f"{trouble.says!r} was not said by a minute after {known:%H:%M:%S}; only {heard}")
    return night.outcome((trouble.name,)), night


def _strike(night: Night, trouble: Trouble, start: datetime, lasts_min: float) -> None:
    night.at(start, lambda: trouble.begin(night))
    end = trouble.end
    if end is not None:
        night.at(start + timedelta(minutes=lasts_min), lambda: end(night))
