"""The car at the stub's socket, and when it comes and goes."""

import math
from collections.abc import Iterator
from datetime import datetime

from plugd.study.world import TAPER_STEP_H, Battery, Stay
from plugd.units import span_h


class CarAtHome:
    """A battery that is sometimes plugged in. Times are aware UTC."""

    def __init__(self, battery: Battery, connected: bool, stays: Iterator[Stay] | None, start: datetime) -> None:
        """With `stays` the driver decides when the car is here; else it stays as it is until told."""
        self.battery = battery
        self.most_kw = math.inf
        """What the car takes at most, whatever is offered: its own limit, or 0 while it sleeps."""
        self._stays = stays
        self._stay = next(stays) if stays else None
        self.connected = connected if self._stay is None else self._stay.arrival <= start

    def due(self) -> datetime | None:
        """When it next comes or goes by itself."""
        if self._stay is None:
            return None
        return self._stay.departure if self.connected else self._stay.arrival

    def arrive(self) -> None:
        """It is plugged in."""
        self.connected = True

    def leave(self) -> None:
        """It is unplugged."""
        self.connected = False

    def drive(self) -> None:
        """What the driver uses until the next time."""
        if self._stay is not None and self._stays is not None:
            self.battery.drive(self._stay.use_kwh)
            self._stay = next(self._stays)

    def draws_kw(self, offered_kw: float) -> float:
        """Power that flows when this much is offered at the socket."""
        return self.battery.takes_kw(min(offered_kw, self.most_kw)) if self.connected else 0.0

    def take(self, offered_kw: float, length_h: float) -> float:
        """Charge for a time. Returns the energy taken at the socket, kWh."""
        return self.battery.charge(min(offered_kw, self.most_kw), length_h) if self.connected else 0.0

    def steady_until(self, now: datetime, offered_kw: float) -> datetime | None:
        """Until when it draws what it draws now; None where nothing will change by itself."""
        battery = self.battery
        power_kw = self.draws_kw(offered_kw)
        if power_kw <= 0.0:
            return None
        knee_kwh = (min(battery.taper_from, battery.full) - battery.soc) * battery.capacity_kwh
        knee_h = knee_kwh / (power_kw * battery.efficiency)
        return now + span_h(max(knee_h, TAPER_STEP_H))
