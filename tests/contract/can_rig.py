"""The charger on CAN, its stub in a process of its own behind a serial adapter. Time is real, and ten times faster."""

from collections.abc import Callable, Iterator
from datetime import timedelta

from plugd.adapters.can_elcon import CanElcon, identifiers
from plugd.adapters.can_link import CanLink, Place
from plugd.adapters.clock import SystemClock
from plugd.adapters.elcon_words import Limits
from plugd.domain import Capability
from plugd.ports import Clock, Plug
from plugd_hil.broker import Mosquitto
from tests.programs import Program

BEAT_S = 0.1
VOLTS = "400"
"""Whether full or empty: then powers are whole tenths of an ampere."""


class CanRig:
    """The adapter, the stub, and what the daemon's loop does between two steps: tend."""

    def __init__(self, stub: Program, charger: CanElcon, clock: SystemClock) -> None:
        self.plug: Plug = charger
        self.clock: Clock = clock
        self.dead_man_s = 0.0
        self.metered = True
        self.charger = charger
        self.stub = stub

    def press(self) -> None:
        """It has no button."""

    def cut(self) -> None:
        """Its bus and its mains are two."""

    def mute(self) -> None:
        """Its wire is off."""
        self._tell("mute")

    def jam(self) -> None:
        """It does not hear."""
        self._tell("deaf")

    def _tell(self, order: str) -> None:
        self.stub.tell(order)
        self.pause(lambda: False, 3.0 * BEAT_S)

    def pause(self, until: Callable[[], bool], longest_s: float) -> None:
        """Beat by beat."""
        end = self.clock.now() + timedelta(seconds=longest_s)
        while (now := self.clock.now()) < end and not until():
            self.clock.wait(min(end, self.charger.due() or end, now + timedelta(seconds=BEAT_S)), self.charger.line)
            self.charger.tend(self.clock.now())


def charger_at(place: Place, clock: Clock, beat_s: float = BEAT_S) -> CanElcon:
    """90 kW, so that a second of charging shows on any meter; no losses."""
    return CanElcon(
        CanLink(place, clock, identifiers(None)),
        clock,
        Capability(90.0, modulating=True, power_min_kw=2.0),
        Limits(410.0, 250.0),
        1.0,
        beat_s=beat_s,
    )


def stub_at(*options: str) -> tuple[Program, str]:
    """The stub charger, and the channel it says. One that says none does not stay."""
    timing = ("--period", str(BEAT_S / 2.0), "--timeout", str(5.0 * BEAT_S))
    stub = Program(
        "plugd_hil.can_elcon",
        "--stdin",
        "--power",
        "90",
        "--efficiency",
        "1",
        "--volts",
        VOLTS,
        VOLTS,
        *timing,
        *options,
    )
    try:
        return stub, stub.said.until(lambda said: "channel" in said)["channel"]
    except TimeoutError:
        stub.close()
        raise TimeoutError(f"the stub charger does not begin: {stub.complained.all[-3:]}") from None


def can_slcan(_broker: Callable[[], Mosquitto]) -> Iterator[CanRig]:
    """Over a serial adapter on a pseudo terminal."""
    with stub_at()[0] as stub:
        channel = stub.said.all[0]["channel"]
        clock = SystemClock()
        charger = charger_at(Place("slcan", channel, 250_000, settle_s=0.0), clock)
        yield CanRig(stub, charger, clock)
        charger.close()
        clock.close()
