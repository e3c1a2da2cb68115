"""The ports of a chaotic night. Each works until it is told otherwise; the plug has the adapters' own memory in it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from plugd.adapters.plug_memory import PlugMemory
from plugd.adapters.plug_words import MAX_ENERGY_KWH, MAX_POWER_KW, Heard, bounded
from plugd.adapters.store import remembered, worded
from plugd.adapters.store_pack import pack, unpack
from plugd.domain import Capability, Fault, Forecast, Intensity, Memory, Outlook, Reading, Record, Relay, Wanted
from plugd.errors import ForecastError, ForecastUnavailable, PlugRefused, PlugTimeout, StoreError
from plugd.ports import Inbox
from plugd.study.house import RamStore
from plugd.units import HALF_HOUR, hours, slot_start
from plugd_hil.car import CarAtHome

ORIGIN = timedelta(seconds=0)
TIMER_S = 3600.0


@dataclass(slots=True)
class TrueClock:
    """True time, and a wall clock that may be wrong by `off`."""

    at: datetime
    start: datetime
    off: timedelta = ORIGIN

    def now(self) -> datetime:
        """What the wall clock shows."""
        return self.at + self.off

    def monotonic(self) -> float:
        """Seconds, whatever the wall clock shows."""
        return (self.at - self.start).total_seconds()

    def wait(self, until: datetime, woken_by: Inbox | None = None) -> None:
        """Nobody waits here: the night moves `at`."""


@dataclass(slots=True)
class Device:
    """The plug as it truly is: relay, timer, mains, meter, and the lies that it tells. It lives in true time."""

    clock: TrueClock
    car: CarAtHome
    power_kw: float = 2.3
    on: bool = False
    powered: bool = True
    jammed: bool = False
    silent: bool = False
    deaf: bool = False
    says_on: bool | None = None
    says_kw: float | None = None
    says_kwh: Callable[[float], float | None] | None = None
    total_kwh: float = 0.0
    ran_to: datetime = field(init=False)
    booted: datetime = field(init=False)
    timer: datetime | None = None
    moves: list[tuple[datetime, bool]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.ran_to = self.clock.at
        self.booted = self.clock.at - timedelta(days=1)

    def switch(self, on: bool) -> None:
        """Move the relay, if it can move."""
        if on is not self.on and not self.jammed and self.powered:
            self.on = on
            self.moves.append((self.ran_to, on))

    def run(self, to: datetime) -> None:
        """Let time pass; the timer does what it was set to."""
        while self.ran_to < to:
            until = to if self.timer is None else min(to, max(self.timer, self.ran_to))
            if self.on and self.powered:
                self.total_kwh += self.car.take(self.power_kw, hours(until - self.ran_to))
            self.ran_to = until
            if self.timer is not None and self.timer <= until:
                self.timer = None
                self.switch(True)

    def told(self, wanted: Relay, timer_s: float | None) -> None:
        """It obeys."""
        timed = not wanted.on and not wanted.held and timer_s is not None
        self.timer = self.ran_to + timedelta(seconds=timer_s or 0.0) if timed else None
        self.switch(wanted.on)

    def cut(self) -> None:
        """The mains fail."""
        self.switch(False)
        self.powered, self.timer = False, None

    def power_up(self) -> None:
        """They are back; it comes on, as `initial_state` asks of it."""
        self.powered, self.booted, self.timer = True, self.ran_to, None
        self.switch(True)

    def heard(self, answer: bool) -> Heard:
        """What it says of itself, lies included, as an adapter's parser leaves it."""
        true_kw = self.car.draws_kw(self.power_kw) if self.on and self.powered else 0.0
        told_kwh = self.total_kwh if self.says_kwh is None else self.says_kwh(self.total_kwh)
        power_kw, no_power = bounded(true_kw if self.says_kw is None else self.says_kw, MAX_POWER_KW)
        energy_kwh, no_total = bounded(told_kwh, MAX_ENERGY_KWH)
        return Heard(
            on=self.on if self.says_on is None else self.says_on,
            metered=True,
            power_kw=power_kw,
            energy_kwh=energy_kwh,
            uptime_s=(self.ran_to - self.booted).total_seconds(),
            answer=answer,
            nonsense=no_power + no_total,
        )


@dataclass(slots=True)
class ChaosPlug:
    """The adapter's end of the device: what is believed of it is decided by the adapters' own `PlugMemory`."""

    clock: TrueClock
    device: Device
    capability: Capability
    broker: bool = True
    warnings: Sequence[Fault] = ()
    memory: PlugMemory = field(default_factory=lambda: PlugMemory(TIMER_S))
    wanted: Relay | None = None
    told: list[tuple[datetime, Relay]] = field(default_factory=list)
    unheeded: list[datetime] = field(default_factory=list)
    """Orders that were not obeyed though the plug was there."""

    def _hears(self) -> bool:
        return self.broker and self.device.powered and not self.device.silent

    def read(self) -> Reading:
        """As `PlugLine.reading`: asked anew each time, believed for a minute."""
        now_s = self.clock.monotonic()
        if self._hears():
            self.memory.absorb(self.device.heard(answer=False), self.clock.now(), now_s)
        reading = self.memory.reading(now_s)
        if reading is None:
            raise PlugTimeout("plug ev-plug is silent" if self.broker else "plug ev-plug is out of reach: no broker")
        return reading

    def set(self, wanted: Wanted) -> None:
        """As the adapters: ordered, then confirmed by what it says."""
        if not isinstance(wanted, Relay):
            raise PlugRefused("a plug knows on and off only")
        if not self.broker:
            raise PlugTimeout("plug ev-plug is out of reach: no broker")
        self.wanted = wanted
        self.told.append((self.clock.at, wanted))
        now_s, memory = self.clock.monotonic(), self.memory
        memory.promise(wanted, self.clock.now(), now_s)
        memory.held = wanted.held and not wanted.on
        memory.order(wanted.on, now_s)
        if not self._hears():
            raise PlugTimeout("plug ev-plug is silent")
        if not self.device.deaf:
            self.device.told(wanted, self._timer_s(now_s))
        memory.absorb(self.device.heard(answer=not self.device.deaf), self.clock.now(), now_s)
        if self.device.on is not wanted.on:
            self.unheeded.append(self.clock.at)
        if self.device.deaf:
            raise PlugTimeout("plug ev-plug does not answer to its orders")
        if memory.on is not wanted.on:
            raise PlugRefused(f"plug ev-plug answers but stays {'ON' if memory.on else 'OFF'}; is it locked?")

    def _timer_s(self, now_s: float) -> float | None:
        return TIMER_S if self.capability.fixed_timer_s else self.memory.timer_s(now_s)

    def _renewal_s(self) -> float:
        memory = self.memory
        return (memory.last_renewal_s if self.capability.fixed_timer_s else memory.renewal_s)(self.wanted)

    def due(self) -> datetime | None:
        """When an off has to be repeated."""
        due_s = self._renewal_s()
        if due_s == float("inf") or not self.broker:
            return None
        return self.clock.now() + timedelta(seconds=max(due_s - self.clock.monotonic(), 0.0))

    def tend(self, now: datetime) -> None:
        """Repeat it. A device that hears nothing is asked again after a renewal's time."""
        now_s = self.clock.monotonic()
        if self._renewal_s() > now_s + 0.001:
            return
        if not self.broker:
            raise PlugTimeout("plug ev-plug is out of reach: no broker")
        self.memory.order(on=False, now_s=now_s)
        if self._hears() and not self.device.deaf:
            self.device.told(Relay(False), self._timer_s(now_s))
            self.memory.absorb(self.device.heard(answer=True), self.clock.now(), now_s)

    def restarted(self) -> "ChaosPlug":
        """The same device for a daemon that starts."""
        return ChaosPlug(self.clock, self.device, self.capability, self.broker)

    def reconnected(self) -> None:
        """The broker is back."""
        self.broker = True
        self.memory.back()


@dataclass(slots=True)
class ChaosSource:
    """A forecast, or what is wrong with it. Its server lives in true time."""

    clock: TrueClock
    level: Callable[[datetime], float]
    error: ForecastError | None = None
    slots: int = 96
    shift: int = 0
    times: float = 1.0
    stale: bool = False
    fetched: int = 0

    def fetch(self, now: datetime) -> Forecast:
        """The one issued now, or the fault."""
        self.fetched += 1
        if self.error is not None:
            raise self.error
        first = slot_start(self.clock.at) + self.shift * HALF_HOUR
        starts = (first + k * HALF_HOUR for k in range(self.slots))
        return Forecast(now, "13", tuple(Intensity(start, self.times * self.level(start)) for start in starts))


def down() -> ForecastUnavailable:
    """The API answers with 500."""
    return ForecastUnavailable("the API answers 500")


@dataclass(slots=True)
class ChaosStore:
    """A store in memory with the file's own faults. What was saved survives a kill as JSON."""

    ram: RamStore = field(default_factory=RamStore)
    fails: Callable[[int], bool] = lambda _: False
    """Whether the write of this number fails."""
    writes: int = 0
    lost: bool = False
    at: list[datetime] = field(default_factory=list)
    """Moments written, to see that none is from a wrong clock."""

    def _write(self) -> None:
        self.writes += 1
        if self.fails(self.writes):
            raise StoreError("plugd.db: the disk is full; make room")

    def load(self) -> Memory | None:
        """What was saved."""
        if self.lost:
            raise StoreError("plugd.db: the saved memory cannot be read; plugd begins without it")
        return None if self.ram.memory is None else remembered(worded(self.ram.memory))

    def save(self, memory: Memory) -> None:
        """Keep."""
        self._write()
        self.ram.save(memory)

    def append(self, record: Record) -> None:
        """Keep."""
        self._write()
        self.at.append(record.at)
        self.ram.append(record)

    def keep(self, forecast: Forecast) -> None:
        """Keep."""
        self._write()
        self.at.append(forecast.issued_at)
        self.ram.keep(forecast)

    def expect(self, at: datetime, outlook: Outlook) -> None:
        """Keep."""
        self._write()
        self.at.append(at)

    def issued(self, since: datetime) -> tuple[Forecast, ...]:
        """Nobody learns from one night."""
        return ()

    def latest_forecast(self) -> Forecast | None:
        """The last one kept: a restart goes on with it until a newer one is due."""
        if self.lost:
            raise StoreError("plugd.db: the forecast cannot be read; plugd begins without it")
        kept = self.ram.forecasts
        return unpack(kept[-1].issued_at, kept[-1].region, pack(kept[-1])) if kept else None

    def history(self, since: datetime) -> tuple[Intensity, ...]:
        """What was kept."""
        return self.ram.history(since)
