"""An Elcon / TC charger with a battery behind it, as a state machine without I/O: frames in, frames out.

Frames are packed by hand from the vendor's table, and not by plugd's own DBC: each checks the other.
"""

import struct
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Self

import can

from plugd.study.world import Battery
from plugd.units import amps_of, hours, kw_of, to_pct
from plugd_hil.car import CarAtHome

COMMAND_ID, STATUS_ID, BMS_ID = 0x1806E5F4, 0x18FF50E5, 0x355
HARDWARE, HOT, MAINS, BATTERY, DEAF = 1, 2, 4, 8, 16
BITS = {"hardware": HARDWARE, "hot": HOT, "mains": MAINS, "battery": BATTERY}
UNDER_LOAD_A = 1.0
TELLINGS = 5
"""A battery that tells how full it is only on arrival does so this many times."""


@dataclass(frozen=True, slots=True)
class Rating:
    """What charger and battery are made for. Power at the plug, voltage of an empty and a full battery."""

    power_kw: float = 3.3
    empty_v: float = 320.0
    full_v: float = 400.0
    efficiency: float = 0.9
    period_s: float = 1.0
    timeout_s: float = 5.0


@dataclass(slots=True)
class Asked:
    """The most it was ever told, and what it suffered."""

    voltage_v: float = 0.0
    current_a: float = 0.0
    invalid: int = 0
    opened_under_load: int = 0
    longest_silence_s: float = 0.0


@dataclass(slots=True)
class ElconCharger:
    """`advance` it to now before anything else."""

    car: CarAtHome
    now: datetime
    rating: Rating = field(default_factory=Rating)
    tells: str = "never"
    """When the battery tells how full it is: never, arrival, always."""
    muted: bool = False
    deaf: bool = False
    """Commands do not reach it."""
    fault_bits: int = 0
    lie: tuple[float, float] | None = None
    """Volts and amperes that it tells instead of the truth."""
    total_kwh: float = 0.0
    current_a: float = 0.0
    asked: Asked = field(default_factory=Asked)
    _limit_v: float = 0.0
    _limit_a: float = 0.0
    _charge: bool = False
    _command_at: datetime | None = None
    _next: datetime = field(init=False)
    _tellings: int = 0

    def __post_init__(self) -> None:
        self._next = self.now + timedelta(seconds=self.rating.period_s)

    @property
    def board(self) -> Self:
        """Relay, meter and time are its own."""
        return self

    @property
    def on(self) -> bool:
        """Whether it gives a current."""
        return self.current_a > 0.0

    @property
    def voltage_v(self) -> float:
        """At its output: the battery's, by how full that is."""
        battery: Battery = self.car.battery
        share = battery.soc if self.car.connected else 0.0
        volts = self.rating.empty_v + (self.rating.full_v - self.rating.empty_v) * share
        return volts if self.car.connected else 0.0

    # -- time -------------------------------------------------------------------------------------

    def due(self) -> datetime:
        """Its next word."""
        return self._next

    def advance(self, to: datetime) -> list[can.Message]:
        """Let time pass; a word every period."""
        said: list[can.Message] = []
        while self._next <= to:
            self._charged_to(self._next)
            self._next += timedelta(seconds=self.rating.period_s)
            self._regulate()
            said += self._words()
        self._charged_to(to)
        return said

    def _charged_to(self, to: datetime) -> None:
        if to <= self.now:
            return
        if self.on:
            offered_kw = kw_of(self.current_a, self.voltage_v) / self.rating.efficiency
            self.total_kwh += self.car.take(offered_kw, hours(to - self.now))
        self.now = to

    def load_changed(self) -> list[can.Message]:
        """The car came or went; it says so with its next words."""
        self._tellings = TELLINGS if self.car.connected else 0
        self._regulate()
        return []

    def _silence_s(self) -> float:
        return float("inf") if self._command_at is None else (self.now - self._command_at).total_seconds()

    @property
    def _bits(self) -> int:
        late = self.deaf or self._silence_s() > self.rating.timeout_s
        return self.fault_bits | (0 if self.car.connected else BATTERY) | (DEAF if late else 0)

    def _regulate(self) -> None:
        """The current that limits, rating and battery leave."""
        self.current_a = 0.0
        volts = self.voltage_v
        if self._bits or not self._charge or volts <= 0.0 or volts >= self._limit_v:
            return
        most_a = amps_of(self.rating.power_kw * self.rating.efficiency, volts)
        offered_kw = kw_of(min(self._limit_a, most_a), volts) / self.rating.efficiency
        self.current_a = amps_of(self.car.draws_kw(offered_kw) * self.rating.efficiency, volts)

    # -- words ------------------------------------------------------------------------------------

    def _words(self) -> list[can.Message]:
        if self.muted:
            return []
        volts, amps = self.lie if self.lie is not None else (self.voltage_v, self.current_a)
        said = [_frame(STATUS_ID, struct.pack(">HHB3x", _tenths(volts), _tenths(amps), self._bits))]
        if self.tells != "never" and self.car.connected and (self.tells == "always" or self._tellings > 0):
            self._tellings -= 1
            percent = round(to_pct(self.car.battery.soc, 0))
            said.append(
                can.Message(arbitration_id=BMS_ID, is_extended_id=False, data=struct.pack("<HHH2x", percent, 100, 0))
            )
        return said

    def handle(self, message: can.Message) -> None:
        """A frame from the bus."""
        if message.arbitration_id != COMMAND_ID or not message.is_extended_id or self.deaf:
            return
        if len(message.data) != 8 or message.is_remote_frame:
            self.asked.invalid += 1
            return
        volts, amps, control, mode, rest = struct.unpack(">HHBBH", bytes(message.data))
        self.asked.invalid += int(control not in (0, 1) or mode != 0 or rest != 0)
        self.asked.opened_under_load += int(control != 0 and self.current_a > UNDER_LOAD_A)
        if self._command_at is not None:
            self.asked.longest_silence_s = max(self.asked.longest_silence_s, self._silence_s())
        self._limit_v, self._limit_a, self._charge = volts / 10.0, amps / 10.0, control == 0
        self.asked.voltage_v = max(self.asked.voltage_v, self._limit_v)
        self.asked.current_a = max(self.asked.current_a, self._limit_a)
        self._command_at = self.now

    def told(self, line: str) -> bool:
        """An order from the world that only a charger understands. Returns whether it was one."""
        match line.split():
            case ["deaf" | "hear" as word]:
                self.deaf = word == "deaf"
            case ["fault", *names]:
                self.fault_bits = sum(BITS[name] for name in names)
            case ["lie", volts, amps]:
                self.lie = float(volts), float(amps)
            case ["truth"]:
                self.lie = None
            case _:
                return False
        return True


def _frame(identifier: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=identifier, is_extended_id=True, data=data)


def _tenths(value: float) -> int:
    return min(max(int(value * 10.0 + 1e-6), 0), 0xFFFF)
