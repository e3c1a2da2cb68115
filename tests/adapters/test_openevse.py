"""The OpenEVSE charger: whole amperes, what is told of its claim, a person's override, its own faults."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta

import pytest

from plugd.adapters.openevse import OpenEvse, whole_amps
from plugd.domain import Capability, Reading, Relay, Setpoint
from plugd.errors import PlugFault, PlugRefused, PlugTimeout
from plugd_hil.openevse import OpenEvseCharger
from plugd_hil.outlet import Said
from plugd_hil.socket import Socket
from tests.wire import Wire, WireClock

SOON = timedelta(seconds=60)


@dataclass(slots=True)
class Bench:
    """The adapter and the stub on a wire."""

    charger: OpenEvse
    clock: WireClock
    wire: Wire

    def until(self, so: Callable[[Reading], bool]) -> Reading:
        """The first reading that is so; silence meanwhile is only that."""
        end = self.clock.now() + SOON
        seen: list[Reading] = []
        while self.clock.now() < end:
            with suppress(PlugTimeout):
                seen.append(self.charger.read())
                if so(seen[-1]):
                    return seen[-1]
            self.clock.wait(min(end, self.clock.now() + timedelta(seconds=0.5)))
        raise AssertionError(f"never so in {seen}")

    def kw(self, power_kw: float) -> Setpoint:
        """A setpoint for an hour."""
        return Setpoint(power_kw, self.clock.now() + timedelta(hours=1))

    def claimed(self) -> list[dict[str, object]]:
        """What was claimed since the last look."""
        found = [json.loads(payload) for topic, payload in self.wire.sent if topic == "ev-plug/claim/set"]
        self.wire.sent.clear()
        return found


@pytest.fixture
def bench() -> Bench:
    """A charger of 7.36 kW that tells everything every 30 s."""
    wire = Wire(lambda car, now: OpenEvseCharger("ev-plug", Socket(car, now, 7.36)))
    clock = WireClock(wire)
    bench = Bench(OpenEvse(wire, clock, "ev-plug", Capability(7.36, modulating=True, power_min_kw=1.38)), clock, wire)
    bench.charger.read()
    return bench


@pytest.mark.parametrize(
    ("most_kw", "least_kw", "whole"),
    [(7.36, 1.38, (7.36, 1.38)), (7.4, 1.38, (7.36, 1.38)), (2.415, 1.5, (2.3, 1.61)), (1.38, 1.38, (1.38, 1.38))],
)
def test_what_it_can_do_is_whole_amperes_within_the_limits(
    most_kw: float, least_kw: float, whole: tuple[float, float]
) -> None:
    found = whole_amps(Capability(most_kw, modulating=True, power_min_kw=least_kw), 230.0)
    assert (found.power_max_kw, found.power_min_kw) == pytest.approx(whole)


def test_the_nearest_ampere_is_claimed_once(bench: Bench) -> None:
    for power_kw, amps in ((1.9, 8), (1.38, 6), (7.3, 32)):
        bench.charger.set(bench.kw(power_kw))
        assert [c.get("charge_current") for c in bench.claimed()] == [amps]
        assert bench.until(lambda r, kw=0.23 * amps: r.power_kw == pytest.approx(kw)).on  # type: ignore[misc]
    bench.charger.set(bench.kw(7.36))
    assert bench.claimed() == [], "a claim that stands is not made again"
    bench.charger.set(bench.kw(0.0))
    assert bench.claimed() == [{"state": "disabled", "auto_release": False}]
    assert not bench.until(lambda r: r.power_kw == 0.0).on


@pytest.mark.parametrize("power_kw", [0.1, 1.37, 7.4, 100.0])
def test_what_it_cannot_give_is_refused_before_anything_is_sent(bench: Bench, power_kw: float) -> None:
    with pytest.raises(PlugRefused, match="from 6 to 32 A, or nothing"):
        bench.charger.set(bench.kw(power_kw))
    assert bench.claimed() == []


def test_a_persons_override_wins_and_is_named(bench: Bench) -> None:
    bench.charger.set(bench.kw(2.3))
    bench.until(lambda r: r.on)
    bench.wire.say(bench.wire.stub.press())
    assert bench.until(lambda r: not r.on).changed_by_other is False
    with pytest.raises(PlugRefused, match="clear the override there"):
        bench.charger.set(bench.kw(4.6))
    bench.wire.publish("ev-plug/override/set", b"clear")
    assert bench.until(lambda r: r.on).power_kw is not None


def test_a_claim_of_somebody_else_is_replaced(bench: Bench) -> None:
    bench.charger.set(bench.kw(2.3))
    bench.claimed()
    bench.wire.publish("ev-plug/claim/set", b'{"charge_current": 32}')
    bench.until(lambda r: r.power_kw == pytest.approx(7.36))
    bench.claimed()
    bench.charger.set(bench.kw(2.3))
    assert [c["charge_current"] for c in bench.claimed()] == [10]


def test_a_fault_of_its_own_is_told_and_nothing_is_claimed_of_it(bench: Bench) -> None:
    bench.charger.set(Relay(on=False))
    bench.wire.say([Said("ev-plug/state", "8")])
    bench.wire.stub.muted = True
    bench.until(lambda _: bool(bench.charger.warnings))
    assert "relay is stuck" in bench.charger.warnings[0].text
    with pytest.raises(PlugFault, match="its relay is stuck"):
        bench.charger.set(Relay(on=True))


def test_after_a_restart_it_has_forgotten_its_claim_and_gets_it_again(bench: Bench) -> None:
    bench.charger.set(bench.kw(0.0))
    bench.wire.say(bench.wire.stub.cut(timedelta(0)))
    back = bench.until(lambda r: r.came_back and r.on)
    assert back.changed_by_other is None
    bench.claimed()
    bench.charger.set(bench.kw(0.0))
    assert len(bench.claimed()) >= 1
    assert not bench.until(lambda r: not r.on).on
