"""What every stub plug has, whatever it speaks: messages, a load behind it, a meter."""

from datetime import date, datetime
from typing import NamedTuple, Protocol
from zoneinfo import ZoneInfo

from plugd.units import hours


class Said(NamedTuple):
    """A message to the broker."""

    topic: str
    payload: str
    retain: bool = False
    qos: int = 0


class Load(Protocol):
    """What hangs at the socket."""

    def draws_kw(self, offered_kw: float) -> float:
        """Power that flows when this much is offered."""

    def take(self, offered_kw: float, length_h: float) -> float:
        """Take energy for a time; returns kWh."""

    def steady_until(self, now: datetime, offered_kw: float) -> datetime | None:
        """Until when the power stays as it is; None where nothing will change by itself."""


class Meter:
    """Energy since it was made, and by local day."""

    def __init__(self, load: Load, power_kw: float, zone: ZoneInfo, now: datetime) -> None:
        """`power_kw`: what the socket offers."""
        self.now = now
        self.started = now
        self.total_kwh = self.today_kwh = self.yesterday_kwh = 0.0
        self.load = load
        self.power_kw = power_kw
        self._zone = zone
        self._day = self._local_day()

    def run(self, to: datetime, on: bool) -> None:
        """Let time pass with the relay as it is."""
        if to <= self.now:
            return
        if on:
            taken_kwh = self.load.take(self.power_kw, hours(to - self.now))
            self.total_kwh += taken_kwh
            self.today_kwh += taken_kwh
        self.now = to
        if (day := self._local_day()) != self._day:
            self._day, self.yesterday_kwh, self.today_kwh = day, self.today_kwh, 0.0

    def _local_day(self) -> date:
        return self.now.astimezone(self._zone).date()
