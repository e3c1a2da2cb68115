"""The stub charger: what a real one does with good, bad and missing commands; and the demo's way to plugd."""

import struct
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import can
import pytest
from can.interfaces.slcan import slcanBus

from plugd.study.world import Battery
from plugd_hil.account import read_ledger
from plugd_hil.car import CarAtHome
from plugd_hil.demo_run import Options, simulate
from plugd_hil.elcon import COMMAND_ID, ElconCharger, Rating
from plugd_hil.slcan import SlcanWire, line_of, message_of

NOON = datetime(2023, 1, 2, 12, tzinfo=UTC)


@pytest.fixture
def charger() -> ElconCharger:
    """Half full, at 360 V."""
    return ElconCharger(CarAtHome(Battery(), True, None, NOON), NOON, Rating())


def command(volts: float, amps: float, control: int = 0, data: bytes | None = None) -> can.Message:
    payload = struct.pack(">HHB3x", round(10 * volts), round(10 * amps), control) if data is None else data
    return can.Message(arbitration_id=COMMAND_ID, is_extended_id=True, data=payload)


def after(charger: ElconCharger, seconds: float) -> tuple[float, float, int]:
    """Volts, amperes, bits of its last word."""
    said = charger.advance(charger.now + timedelta(seconds=seconds))
    volts, amps, bits = struct.unpack(">HHB3x", bytes(said[-1].data))
    return volts / 10.0, amps / 10.0, bits


def test_it_gives_what_it_is_told_and_stops_after_five_seconds_of_silence(charger: ElconCharger) -> None:
    charger.handle(command(400.0, 5.0))
    assert after(charger, 5.0) == (360.0, 5.0, 0)
    assert after(charger, 1.0) == (360.0, 0.0, 16)
    charger.handle(command(400.0, 5.0))
    assert after(charger, 1.0) == (360.0, 5.0, 0)


@pytest.mark.parametrize(
    ("told", "amps"),
    [(command(400.0, 50.0), 8.2), (command(400.0, 5.0, control=1), 0.0), (command(355.0, 5.0), 0.0)],
    ids=["its rating", "stop", "a voltage that the battery has passed"],
)
def test_it_keeps_to_its_rating_and_its_limits(charger: ElconCharger, told: can.Message, amps: float) -> None:
    charger.handle(told)
    assert after(charger, 1.0)[1] == amps


def test_a_bad_command_is_counted_and_not_obeyed(charger: ElconCharger) -> None:
    charger.handle(command(0.0, 0.0, data=bytes(7)))
    assert after(charger, 1.0) == (360.0, 0.0, 16)
    assert charger.asked.invalid == 1


def test_opening_under_load_is_counted(charger: ElconCharger) -> None:
    charger.handle(command(400.0, 5.0))
    after(charger, 1.0)
    charger.handle(command(400.0, 0.0, control=1))
    assert charger.asked.opened_under_load == 1


@pytest.mark.parametrize("word", ["fault hot", "deaf"])
def test_a_fault_ends_the_current(charger: ElconCharger, word: str) -> None:
    charger.handle(command(400.0, 5.0))
    after(charger, 1.0)
    assert charger.told(word)
    volts, amps, bits = after(charger, 1.0)
    assert (volts, amps) == (360.0, 0.0)
    assert bits != 0


def test_a_frame_is_the_same_after_a_line() -> None:
    for frame in (command(400.0, 5.0), can.Message(arbitration_id=0x355, is_extended_id=False, data=b"\x50\0")):
        found = message_of(line_of(frame).rstrip("\r"))
        assert found is not None
        assert found.equals(frame, timestamp_delta=None)
    for line in ("T123", "t35", "T1806E5F48zz", "T1806E5F4800"):
        assert message_of(line) is None


@pytest.fixture
def wire() -> Iterator[SlcanWire]:
    made = SlcanWire(waits=True)
    yield made
    made.close()


def test_after_its_adapter_has_answered_all_that_was_sent_is_there(wire: SlcanWire) -> None:
    bus = slcanBus(wire.channel, bitrate=250_000, sleep_after_open=0.0)
    for _ in range(20):
        bus.send(command(400.0, 5.0))
    assert bus.get_version(5.0) == (10, 13)
    assert len(wire.take()) == 20
    wire.send([command(400.0, 5.0)] * 3)
    found = [bus.recv(timeout=0.0) for _ in range(30)]
    assert sum(frame is not None for frame in found) == 3
    bus.shutdown()


def test_the_demo_on_can_has_a_word_for_the_charger_every_period(tmp_path: Path) -> None:
    start = datetime(2023, 1, 2, 17, 50, tzinfo=UTC)
    end = start + timedelta(minutes=15)
    ledger, _ = simulate(Options(plug="can_elcon"), tmp_path, start, end, lambda _: None)
    last = ledger.read_text().splitlines()[-1]
    assert read_ledger(ledger)[-1].at == end
    assert '"invalid": 0, "opened_under_load": 0, "longest_silence_s": 2.0' in last
