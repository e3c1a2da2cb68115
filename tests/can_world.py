"""The charger on CAN and its stub in one process: python-can's own bus class in between, and time that jumps."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import can

from plugd.adapters.can_elcon import CanElcon, identifiers
from plugd.adapters.can_link import CanLink, Place
from plugd.adapters.can_soc import SocSignal
from plugd.adapters.elcon_words import Limits
from plugd.domain import Capability
from plugd.ports import Inbox
from plugd_hil.car import CarAtHome
from plugd_hil.elcon import ElconCharger, Rating

PLACE = Place("memory", "can0", 250_000)
LIMITS = Limits(405.0, 12.0)
CHARGER = Capability(3.3, modulating=True, power_min_kw=1.38)


class MemoryBus(can.BusABC):
    """Two queues. `broken` is raised by whatever is asked of it next."""

    def __init__(self) -> None:
        super().__init__(channel="memory")
        self.sent: deque[can.Message] = deque()
        self.arrived: deque[can.Message | Exception] = deque()
        self.refuses: Exception | None = None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """To the other side."""
        if self.refuses is not None:
            raise self.refuses
        self.sent.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.arrived:
            return None, True
        found = self.arrived.popleft()
        if isinstance(found, Exception):
            raise found
        return found, True


@dataclass(slots=True)
class CanWorld:
    """A clock that lets the stub charger speak on its way. Implements `plugd.ports.Clock`."""

    at: datetime
    car: CarAtHome
    rating: Rating = field(default_factory=Rating)
    tells: str = "never"
    bus: MemoryBus = field(init=False)
    charger: ElconCharger = field(init=False)
    start: datetime = field(init=False)
    commands: list[can.Message] = field(default_factory=list)
    """All that plugd ever sent."""
    happens: Callable[[datetime], None] = lambda _: None
    """Called at every word of the charger's."""
    opened: int = 0

    def __post_init__(self) -> None:
        self.start = self.at
        self.bus = MemoryBus()
        self.charger = ElconCharger(self.car, self.at, self.rating, self.tells)

    def open(self, _place: Place, _identifiers: tuple[tuple[int, bool], ...]) -> can.BusABC:
        """The bus, as often as it is opened."""
        self.opened += 1
        return self.bus

    def plug(
        self, capability: Capability = CHARGER, limits: Limits = LIMITS, soc: SocSignal | None = None, **more: float
    ) -> CanElcon:
        """plugd's side."""
        link = CanLink(PLACE, self, identifiers(soc), self.open)
        return CanElcon(link, self, capability, limits, self.rating.efficiency, soc, **more)

    def now(self) -> datetime:
        """Simulated time."""
        return self.at

    def monotonic(self) -> float:
        """Simulated seconds."""
        return (self.at - self.start).total_seconds()

    def wait(self, until: datetime, woken_by: Inbox | None = None) -> None:
        """Jump, word by word of the charger's."""
        while (due := min(self.charger.due(), until)) <= until and self.at < until:
            self.at = due
            while self.bus.sent:
                self.commands.append(self.bus.sent.popleft())
                self.charger.handle(self.commands[-1])
            self.bus.arrived.extend(self.charger.advance(due))
            self.happens(due)

    def live(self, plug: CanElcon, length_s: float) -> None:
        """What the daemon's loop does between two steps."""
        end = self.at + timedelta(seconds=length_s)
        while self.at < end:
            self.wait(min(end, plug.due() or end, self.at + timedelta(seconds=1)))
            plug.tend(self.at)
