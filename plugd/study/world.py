"""The world of simulations and stubs: a battery that fills, and a driver who comes and goes."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from zoneinfo import ZoneInfo

from plugd.units import require_utc, within

TAPER_STEP_H = 1.0 / 60.0
"""While the power tapers it is held for a minute at a time: under 0.1 % of energy off the smooth curve."""
TRICKLE = 0.02
"""Share of full power at which a car stops: below it nothing flows."""
LEAST_KW = 1e-6
"""Less is no power, only the rounding of one."""


@dataclass(slots=True)
class Battery:
    """A battery behind a charger. It takes what it is offered up to its taper, and conserves energy.

    From `taper_from` on the power falls in proportion to what is left to `full`, where the car stops.
    `energy_kwh` is inside the battery; power and the meter are at the plug.
    """

    capacity_kwh: float = 50.0
    energy_kwh: float = 25.0
    efficiency: float = 0.9
    taper_from: float = 0.95
    full: float = 1.0

    @property
    def soc(self) -> float:
        """State of charge, 0..1."""
        return self.energy_kwh / self.capacity_kwh

    def takes_kw(self, offered_kw: float) -> float:
        """Power drawn at the plug when `offered_kw` is to be had."""
        left = self.full - self.soc
        if self.full <= self.taper_from:
            share = 1.0 if left > 1e-9 else 0.0
        else:
            share = within(0.0, left / (self.full - self.taper_from), 1.0)
        return offered_kw * share if share > TRICKLE and offered_kw > LEAST_KW else 0.0

    def charge(self, offered_kw: float, length_h: float) -> float:
        """Charge for `length_h` hours. Returns the energy taken at the plug, kWh."""
        taken_kwh = 0.0
        while length_h > 1e-12:
            power_kw = self.takes_kw(offered_kw)
            if power_kw <= 0.0:
                break
            speed = power_kw * self.efficiency / self.capacity_kwh  # SOC per hour
            to_knee_h = (min(self.taper_from, self.full) - self.soc) / speed
            to_full_h = (self.full - self.soc) / speed
            step_h = min(length_h, to_full_h, to_knee_h if to_knee_h > 1e-9 else TAPER_STEP_H)
            self.energy_kwh += power_kw * step_h * self.efficiency
            taken_kwh += power_kw * step_h
            length_h -= step_h
        return taken_kwh

    def drive(self, use_kwh: float) -> float:
        """Drive. Returns what was driven: an empty battery stops the car."""
        used_kwh = min(use_kwh, self.energy_kwh)
        self.energy_kwh -= used_kwh
        return used_kwh


@dataclass(frozen=True, slots=True)
class Stay:
    """One time at home: plugged in from `arrival` to `departure`, then `use_kwh` is driven."""

    arrival: datetime
    departure: datetime
    use_kwh: float


@dataclass(frozen=True, slots=True)
class Driver:
    """The paper's driver (section III): normal arrival, departure and use, use cut at zero."""

    timezone: str = "Europe/London"
    arrival: time = time(18, 0)
    departure: time = time(9, 0)
    sd_h: float = 1.0
    use_kwh: float = 5.8
    use_sd_kwh: float = 2.67
    seed: int = 0

    def stay(self, evening: date) -> Stay:
        """The stay that begins on this local day, mostly in the evening: the same for the same seed and day."""
        dice = random.Random(f"{self.seed}/{evening.isoformat()}")
        zone = ZoneInfo(self.timezone)

        def around(day: date, clock: time) -> datetime:
            away_h = within(-5.0, dice.gauss(0.0, self.sd_h), 5.0)
            return require_utc(datetime.combine(day, clock, zone)) + timedelta(seconds=round(away_h * 3600))

        return Stay(
            arrival=around(evening, self.arrival),
            departure=around(evening + timedelta(days=self.arrival >= self.departure), self.departure),
            use_kwh=max(0.0, dice.gauss(self.use_kwh, self.use_sd_kwh)),
        )

    def stays(self, start: datetime) -> Iterator[Stay]:
        """All stays that end after `start`."""
        evening = require_utc(start).astimezone(ZoneInfo(self.timezone)).date() - timedelta(days=1)
        while True:
            stay = self.stay(evening)
            if stay.departure > start:
                yield stay
            evening += timedelta(days=1)


@dataclass(frozen=True, slots=True)
class Morning:
    """One session end, as it really was."""

    end: datetime
    minimum: float
    soc: float
    best_soc: float
    """What charging without a pause since arrival would have reached, up to the limit."""
    here: bool

    @property
    def missed(self) -> bool:
        """More than half a point under a minimum that was reachable, with the car there."""
        return self.here and self.soc < min(self.minimum, self.best_soc) - 0.005

    @property
    def missed_by(self) -> float:
        """How far it was missed, as a share of the battery; 0 where it was not."""
        return min(self.minimum, self.best_soc) - self.soc if self.missed else 0.0
