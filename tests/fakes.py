"""Small stand-ins for the ports, checked by mypy against the Protocols. Time in them moves only by waiting."""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from plugd.domain import Capability, Fault, Reading, Relay, Setpoint, Wanted
from plugd.errors import PlugRefused, PlugTimeout
from plugd.ports import Inbox
from plugd.study.world import Battery
from plugd.units import hours

MIDNIGHT = datetime(2023, 1, 2, tzinfo=UTC)
RENEWALS = 6


def configured(neso_url: str, folder: Path) -> Path:
    """A configuration file in `folder`, with its state there, that asks a stub for the forecast."""
    path = folder / "plugd.toml"
    path.write_text(f'[plug]\ntopic = "p"\n[forecast]\nbase_url = "{neso_url}"\n[state]\ndir = "{folder}/state"\n')
    return path


@dataclass(slots=True)
class FakeClock:
    """A clock that jumps to wherever somebody waits for."""

    at: datetime = MIDNIGHT

    def now(self) -> datetime:
        """Aware UTC."""
        return self.at

    def monotonic(self) -> float:
        """Seconds since this fake's beginning of time."""
        return (self.at - MIDNIGHT).total_seconds()

    def wait(self, until: datetime, woken_by: Inbox | None = None) -> None:
        """Jump, unless something is there already."""
        if woken_by is None or not woken_by.pending():
            self.at = max(self.at, until)


@dataclass(slots=True)
class Outlet:
    """A battery behind a meter that runs with a clock, whatever switches it."""

    clock: FakeClock
    battery: Battery = field(default_factory=Battery)
    offered_kw: float = 0.0
    energy_kwh: float = 0.0
    metered_at: datetime = MIDNIGHT

    def run(self, to: datetime) -> None:
        """Let the meter run."""
        if to > self.metered_at:
            self.energy_kwh += self.battery.charge(self.offered_kw, hours(to - self.metered_at))
            self.metered_at = to


@dataclass(slots=True)
class FakePlug:
    """A relay with a dead-man, a button and a meter. `silent` and `stuck` are its illnesses."""

    clock: FakeClock
    power_kw: float = 2.3
    dead_man_s: float = 3600.0
    silent: bool = False
    stuck: bool = False
    on: bool = False
    outlet: Outlet = field(init=False)
    _timer: datetime | None = None
    _sent: datetime | None = None
    _moved: bool | None = None
    _came_back: bool = False

    def __post_init__(self) -> None:
        self.outlet = Outlet(self.clock, metered_at=self.clock.now())

    @property
    def capability(self) -> Capability:
        """On and off, with a dead-man."""
        return Capability(self.power_kw, dead_man=True)

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """It is in order."""
        return ()

    def read(self) -> Reading:
        """As it is now. Raises PlugTimeout while silent."""
        self._answer()
        outlet = self.outlet
        reading = Reading(
            at=self.clock.now(),
            on=self.on,
            power_kw=outlet.battery.takes_kw(outlet.offered_kw),
            energy_kwh=outlet.energy_kwh,
            metered_at=outlet.metered_at,
            changed_by_other=self._moved,
            came_back=self._came_back,
        )
        self._moved, self._came_back = None, False
        return reading

    def set(self, wanted: Wanted) -> None:
        """Switch. Raises PlugTimeout while silent, PlugRefused where stuck or given a power."""
        self._answer()
        if isinstance(wanted, Setpoint):
            raise PlugRefused("a plug knows on and off only")
        if self.stuck and self.on is not wanted.on:
            raise PlugRefused("it is stuck")
        self._switch(wanted.on)
        timed = not wanted.on and not wanted.held
        self._sent = self.clock.now() if timed else None
        self._timer = self.clock.now() + timedelta(seconds=self.dead_man_s) if timed else None

    def tend(self, now: datetime) -> None:
        """Repeat an OFF that is due."""
        due = self.due()
        if due is not None and due <= now and not self.silent:
            self.set(Relay(on=False))

    def due(self) -> datetime | None:
        """When an OFF has to be repeated."""
        return None if self._sent is None else self._sent + timedelta(seconds=self.dead_man_s / RENEWALS)

    def press(self) -> None:
        """A person presses the button."""
        self._pass()
        self._switch(not self.on)
        self._moved = self.on

    def cut(self) -> None:
        """The mains fail for a moment: it is off, and its timer starts anew."""
        self._pass()
        self._switch(False)
        self._timer = self.clock.now() + timedelta(seconds=self.dead_man_s) if self._timer else None
        self._came_back = True

    def _switch(self, on: bool) -> None:
        self.on = on
        self.outlet.offered_kw = self.power_kw if on else 0.0

    def _pass(self) -> None:
        """What the timer did meanwhile."""
        now = self.clock.now()
        if self._timer is not None and self._timer <= now:
            self.outlet.run(self._timer)
            self._timer = self._sent = None
            self._switch(True)
        self.outlet.run(now)

    def _answer(self) -> None:
        self._pass()
        if self.silent:
            raise PlugTimeout("it says nothing")


@dataclass(slots=True)
class FakeCharger:
    """A charger that takes any power from its least up, until the setpoint's time is over."""

    clock: FakeClock
    power_max_kw: float = 7.4
    power_min_kw: float = 1.4
    silent: bool = False
    stuck: bool = False
    setpoint: Setpoint = field(default_factory=lambda: Setpoint(0.0, MIDNIGHT))
    outlet: Outlet = field(init=False)

    def __post_init__(self) -> None:
        self.outlet = Outlet(self.clock, metered_at=self.clock.now())

    @property
    def capability(self) -> Capability:
        """Any power between least and most, or none; nothing switches it on but plugd."""
        return Capability(self.power_max_kw, modulating=True, power_min_kw=self.power_min_kw)

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """It is in order."""
        return ()

    def read(self) -> Reading:
        """As it is now. Raises PlugTimeout while silent."""
        self._answer()
        outlet = self.outlet
        power_kw = outlet.battery.takes_kw(outlet.offered_kw)
        return Reading(self.clock.now(), power_kw > 0.0, power_kw, outlet.energy_kwh, outlet.metered_at)

    def set(self, wanted: Wanted) -> None:
        """Take a power. Raises PlugTimeout while silent, PlugRefused for one that it cannot give."""
        self._answer()
        if isinstance(wanted, Relay):
            wanted = Setpoint(self.power_max_kw if wanted.on else 0.0, datetime.max.replace(tzinfo=UTC))
        power_kw = wanted.power_kw
        if self.stuck or power_kw > self.power_max_kw or 0.0 < power_kw < self.power_min_kw:
            raise PlugRefused(f"{power_kw:g} kW is not what it does")
        self.setpoint = wanted
        self.outlet.offered_kw = power_kw

    def tend(self, now: datetime) -> None:
        """Nothing to repeat."""

    def due(self) -> datetime | None:
        """Never."""
        return None

    def _answer(self) -> None:
        now = self.clock.now()
        self.outlet.run(min(now, self.setpoint.until))
        if self.setpoint.until <= now:
            self.outlet.offered_kw = 0.0
        self.outlet.run(now)
        if self.silent:
            raise PlugTimeout("it says nothing")
