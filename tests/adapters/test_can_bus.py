"""The charger on CAN over python-can's real buses, its stub in a process of its own, and garbage on the wire."""

import random
import socket
from collections.abc import Iterator
from datetime import timedelta

import pytest

from plugd import daemon, inspection
from plugd.adapters.can_elcon import CanElcon
from plugd.adapters.can_link import Place
from plugd.adapters.clock import SystemClock
from plugd.config import parse
from plugd.domain import Setpoint
from plugd.errors import ConfigError, PlugTimeout
from tests.contract.can_rig import CanRig, charger_at, stub_at


@pytest.fixture
def clock() -> Iterator[SystemClock]:
    made = SystemClock()
    yield made
    made.close()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def charges(rig: CanRig, within_s: float = 5.0) -> bool:
    """Whether it takes 46 kW, is seen to give it, and stops again."""
    charger = rig.charger
    charger.set(Setpoint(46.0, rig.clock.now() + timedelta(hours=1)))
    rig.pause(lambda: charger.read().power_kw == pytest.approx(46.0), within_s)
    given = charger.read().power_kw == pytest.approx(46.0)
    charger.set(Setpoint(0.0, rig.clock.now() + timedelta(hours=1)))
    return given and not charger.read().on


@pytest.mark.requires("multicast")
def test_over_udp_multicast_that_never_leaves_this_machine(clock: SystemClock) -> None:
    channel = f"239.74.163.2:{free_port()}"
    stub, _ = stub_at("--bus", channel)
    with stub:
        charger = charger_at(Place("udp_multicast", channel, 250_000), clock)
        assert charges(CanRig(stub, charger, clock))
        assert not charger.warnings, "its own frames come back, and are nobody else's"
        charger.close()


def test_over_a_serial_adapter_with_garbage_on_the_line(clock: SystemClock) -> None:
    dice = random.Random(5)
    stub, channel = stub_at()
    with stub:
        charger = charger_at(Place("slcan", channel, 250_000, settle_s=0.0), clock)
        rig = CanRig(stub, charger, clock)
        charger.read()
        for noise in (
            b"T18FF50E58zz\r",
            b"T\r",
            b"t99\r",
            b"\xff\xfe\r",
            b"T18FF50E5900\r",
            dice.randbytes(300) + b"\r",
        ):
            stub.tell(f"raw {noise.hex()}")
        stub.tell("babble 500")
        rig.pause(lambda: charger.line.garbled > 0, 5.0)
        assert charger.line.garbled > 0
        assert charges(rig)
        charger.close()


def test_a_pulled_cable_is_a_timeout_and_a_fault(clock: SystemClock) -> None:
    stub, channel = stub_at()
    with stub:
        charger = charger_at(Place("slcan", channel, 250_000, settle_s=0.0), clock)
        assert charges(CanRig(stub, charger, clock))
        stub.close()
        with pytest.raises(PlugTimeout):
            charger.set(Setpoint(46.0, clock.now() + timedelta(hours=1)))
        assert [fault.code for fault in charger.warnings] == ["can_bus"]
        charger.close()


@pytest.mark.parametrize(
    ("interface", "channel", "said"),
    [
        ("slcan", "/dev/none", "No such file"),
        ("socketcan", "none0", "socketcan none0"),
        ("udp_multicast", "x:y", "int"),
    ],
)
def test_a_bus_that_is_not_there_is_said_and_tried_again(
    clock: SystemClock, interface: str, channel: str, said: str
) -> None:
    charger = charger_at(Place(interface, channel, 250_000), clock, beat_s=0.02)
    with pytest.raises(PlugTimeout, match=said):
        charger.read()
    assert [fault.code for fault in charger.warnings] == ["can_bus"]
    charger.close()


# -- by hand --------------------------------------------------------------------------------------


@pytest.mark.requires("multicast")
def test_by_hand_it_is_shown_switched_and_checked_without_a_broker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(daemon, "BROKER_PATIENCE_S", 0.1)
    stub, channel = stub_at("--bus", f"239.74.163.2:{free_port()}", "--volts", "380", "380", "--efficiency", "0.9")
    with stub:
        text = WHOLE.replace("[can]", f'[can]\ninterface = "udp_multicast"\nchannel = "{channel}"\nperiod_s = 0.1')
        config = parse(f"{text}[broker]\nport = 1\n")
        assert inspection.switch(config, "show").startswith("off, 0 W")
        assert inspection.switch(config, "on").endswith("without a word every second it gives nothing")
        checks = dict(inspection.CHECKS)
        assert "a dead plugd leaves it OFF" in checks["plug"](config, False)
        with pytest.raises(PlugTimeout, match=r"is \[broker\] right"):
            checks["broker"](config, False)


# -- from the configuration -----------------------------------------------------------------------

WHOLE = (
    '[plug]\nkind = "can_elcon"\npower_kw = 3.3\nmax_current_a = 13\n[can]\nmax_voltage_v = 400\nmax_current_a = 9\n'
)


def test_the_configuration_makes_the_charger(clock: SystemClock) -> None:
    config = parse(WHOLE)
    charger = daemon.plug_for(config, daemon.connect(config), clock)
    assert isinstance(charger, CanElcon)
    assert charger.capability.modulating
    assert charger.capability.power_max_kw == pytest.approx(13 * 0.23)
    assert charger.capability.power_min_kw == pytest.approx(6 * 0.23)
    assert not charger.capability.dead_man


def test_the_batterys_limits_are_the_chargers_too(clock: SystemClock) -> None:
    config = parse(WHOLE.replace("max_current_a = 9", "max_current_a = 6"))
    assert daemon.capability_of(config).power_max_kw == pytest.approx(2.4 / 0.9)


@pytest.mark.parametrize("key", ["max_voltage_v", "max_current_a"])
def test_without_the_batterys_limits_it_does_not_run(clock: SystemClock, key: str) -> None:
    lines = [
        line
        for line in WHOLE.splitlines()
        if line not in ("max_voltage_v = 400", "max_current_a = 9") or key not in line
    ]
    config = parse("\n".join(lines))
    with pytest.raises(ConfigError, match=f"can.{key}: write the highest"):
        daemon.plug_for(config, daemon.connect(config), clock)


def test_without_its_libraries_it_says_what_to_install(clock: SystemClock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(daemon, "find_spec", lambda name: None if name in ("cantools", "serial") else object())
    config = parse(WHOLE)
    with pytest.raises(ConfigError, match=r"needs cantools and serial; pip install 'plugd\[can\]'"):
        daemon.plug_for(config, daemon.connect(config), clock)
