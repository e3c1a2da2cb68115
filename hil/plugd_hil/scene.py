"""A stub's world: a plug or charger, the car at it, the truth about both written down, and what befalls them."""

import argparse
import json
from datetime import datetime, timedelta
from typing import TextIO

from plugd.study.world import Battery, Driver
from plugd.units import HALF_HOUR, from_pct, next_slot, require_utc, to_pct
from plugd_hil.car import CarAtHome
from plugd_hil.outlet import Said
from plugd_hil.socket import Plug


class Scene:
    """The plug, the car, and the truth about both, written down."""

    def __init__(self, plug: Plug, car: CarAtHome, ledger: TextIO | None = None, soc_topic: str | None = None) -> None:
        """With a `soc_topic` the car tells its SOC there when it arrives."""
        self.plug = plug
        self.car = car
        self._ledger = ledger
        self._soc_topic = soc_topic
        self._on = plug.board.on
        self._boundary = next_slot(plug.board.now)
        self.note("start")

    def due(self) -> datetime:
        """When something happens next."""
        moments = self.plug.board.due(), self.car.due(), self._boundary
        return min(moment for moment in moments if moment is not None)

    def advance(self, to: datetime) -> list[Said]:
        """Let time pass up to `to`, one event after the other, each at its own moment."""
        said: list[Said] = []
        while (due := self.due()) <= to:
            said += self.watch(self.plug.board.advance(due))
            if self.car.due() == due:
                said += self.leave() if self.car.connected else self.arrive()
            if due == self._boundary:
                self._boundary += HALF_HOUR
                self.note("slot")
        return said + self.watch(self.plug.board.advance(to))

    def watch(self, said: list[Said]) -> list[Said]:
        """Writes down when the relay has moved."""
        if self.plug.board.on is not self._on:
            self._on = self.plug.board.on
            self.note("on" if self._on else "off")
        return said

    def arrive(self) -> list[Said]:
        """The car is plugged in, and tells its SOC where it can."""
        self.car.arrive()
        said = self.plug.load_changed()
        self.note("arrive")
        percent = to_pct(self.car.battery.soc)
        return [*said, *([Said(self._soc_topic, f"{percent:.1f}", qos=1)] if self._soc_topic else [])]

    def leave(self) -> list[Said]:
        """The car is unplugged, and driven: what it uses is gone from the next line on."""
        self.car.leave()
        said = self.plug.load_changed()
        self.note("leave")
        self.car.drive()
        return said

    def told(self, line: str) -> list[Said]:
        """An order from the world. Raises ValueError for one that it does not know."""
        match line.split():
            case ["press"]:
                return self.watch(self.plug.press())
            case ["cut", *seconds]:
                return self.watch(self.plug.cut(timedelta(seconds=float(seconds[0]) if seconds else 5.0)))
            case ["mute" | "unmute" as word]:
                self.plug.muted = word == "mute"
            case ["jam" | "weld" | "unjam" as word]:
                self.plug.board.jammed = word != "unjam"
            case ["limit", most_kw]:
                self.car.most_kw = float(most_kw)
                return self.plug.load_changed()
            case ["car", "arrive"]:
                return self.arrive()
            case ["car", "leave"]:
                return self.leave()
            case ["soc", percent]:
                self.car.battery.energy_kwh = from_pct(float(percent)) * self.car.battery.capacity_kwh
                said = self.plug.load_changed()
                self.note("soc")
                return said
            case _:
                raise ValueError(f"stub plug: {line.strip()!r} is no order")
        return []

    def note(self, event: str, **more: float) -> None:
        """A line of the ledger."""
        if self._ledger is None:
            return
        line = {
            "at": self.plug.board.now.isoformat(), "event": event, "soc": self.car.battery.soc,
            "energy_kwh": self.plug.board.total_kwh, "on": self.plug.board.on, "connected": self.car.connected, **more,
        }  # fmt: skip
        print(json.dumps(line), file=self._ledger, flush=True)


def car_at_home(options: argparse.Namespace, now: datetime) -> CarAtHome:
    """The car as the command line wants it."""
    battery = Battery(options.capacity, from_pct(options.soc) * options.capacity, options.efficiency)
    start = require_utc(options.start) if options.start else now
    driver = Driver(timezone=options.timezone, seed=options.seed)
    stays = driver.stays(start) if options.car == "driver" else None
    return CarAtHome(battery, options.car == "connected", stays, start)
