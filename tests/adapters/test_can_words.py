"""Frames of the Elcon protocol and of batteries: the documents' own examples, and whatever else may arrive."""

import struct
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd.adapters.can_soc import PRESETS, SocSignal, soc_signal
from plugd.adapters.elcon_words import STATUS_ID, Limits, Words, is_command, is_status
from plugd.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]
BITS = ("HardwareFailure", "OverTemperature", "InputVoltage", "BatteryDisconnected", "CommunicationTimeout")
ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)


def status(data: bytes, identifier: int = STATUS_ID, **more: bool) -> can.Message:
    return can.Message(arbitration_id=identifier, is_extended_id=True, data=data, **more)


def test_the_vendors_own_example() -> None:
    frame = Words(Limits(98.0, 16.0)).command(16.0, charge=True)
    assert (frame.arbitration_id, frame.is_extended_id, frame.data.hex()) == (0x1806E5F4, True, "03d400a000000000")


def test_stop_is_a_whole_frame_too() -> None:
    frame = Words(Limits(98.0, 16.0)).command(16.0, charge=False)
    assert frame.data.hex() == "03d4000001000000"


def test_the_status_bits_count_from_the_least_significant() -> None:
    words = Words(Limits(400.0, 20.0))
    for place, name in enumerate(BITS):
        found = words.status(status(struct.pack(">HHB3x", 3500, 100, 1 << place)))
        assert found is not None
        assert found.bits == (name,)
    found = words.status(status(struct.pack(">HHB3x", 3500, 100, 0xE0)))
    assert found is not None
    assert (found.voltage_v, found.current_a, found.bits) == (350.0, 10.0, ())


def test_volts_are_not_negative() -> None:
    found = Words(Limits(4000.0, 20.0)).status(status(struct.pack(">HHB3x", 0x9000, 0, 0)))
    assert found is not None
    assert found.voltage_v == pytest.approx(0x9000 / 10.0)


@pytest.mark.parametrize(
    "data",
    [b"", bytes(7), struct.pack(">HHB3x", 0xFFFF, 0, 0), struct.pack(">HHB3x", 0, 0xFFFF, 0)],
    ids=["empty", "short", "volts of an unset field", "amperes of one"],
)
def test_what_cannot_be_is_dropped(data: bytes) -> None:
    assert Words(Limits(400.0, 20.0)).status(status(data)) is None


@pytest.mark.parametrize(
    "frame",
    [
        can.Message(arbitration_id=STATUS_ID & 0x7FF, is_extended_id=False, data=bytes(8)),
        can.Message(arbitration_id=STATUS_ID, is_extended_id=True, is_remote_frame=True, dlc=8),
        can.Message(arbitration_id=STATUS_ID, is_extended_id=True, is_error_frame=True, data=bytes(8)),
        can.Message(arbitration_id=STATUS_ID, is_extended_id=True, is_fd=True, data=bytes(8)),
        can.Message(arbitration_id=STATUS_ID + 1, is_extended_id=True, data=bytes(8)),
    ],
    ids=["11 bits", "remote", "error", "FD", "another"],
)
def test_only_the_chargers_own_frames_are_read(frame: can.Message) -> None:
    assert not is_status(frame)
    assert not is_command(frame)


@given(
    volts=st.floats(0.1, 7000.0),
    amps=st.floats(0.1, 7000.0),
    wanted_a=ANY_FLOAT,
    charge=st.booleans(),
)
def test_no_command_ever_holds_more_than_the_battery_bears(
    volts: float, amps: float, wanted_a: float, charge: bool
) -> None:
    frame = Words(Limits(volts, amps)).command(wanted_a, charge)
    told_v, told_a, control, rest = struct.unpack(">HHBB2x", bytes(frame.data))
    assert is_command(frame)
    assert told_v / 10.0 <= volts + 1e-6
    assert told_a / 10.0 <= amps + 1e-6
    assert (control, rest) == (0 if charge else 1, 0)
    assert charge or told_a == 0
    assert len(frame.data) == 8


@pytest.mark.parametrize("limits", [(0.0, 1.0), (1.0, 0.0), (float("nan"), 1.0), (1.0, float("inf"))])
def test_a_battery_without_limits_is_none(limits: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="battery limits"):
        Limits(*limits)


@pytest.mark.parametrize("name", ["elcon.dbc", "bms.dbc"])
def test_the_dbc_of_the_documents_is_the_one_that_is_used(name: str) -> None:
    assert (ROOT / "etc" / name).read_bytes() == (ROOT / "plugd/adapters" / name).read_bytes()


# -- how full the battery is ----------------------------------------------------------------------


def preset(name: str) -> SocSignal:
    found = soc_signal(name, None, None)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("name", "identifier", "data", "soc"),
    [
        ("pylontech", 0x355, "50006400", 0.80),
        ("pylontech", 0x355, "5000640000000000", 0.80),
        ("orion", 0x6B0, "00A100486E50005F", 0.805),
    ],
)
def test_the_presets_read_their_documents_examples(name: str, identifier: int, data: str, soc: float) -> None:
    signal = preset(name)
    assert signal.absorb(can.Message(arbitration_id=identifier, is_extended_id=False, data=bytes.fromhex(data)), 5.0)
    assert signal.soc == pytest.approx(soc)
    assert signal.heard_s == 5.0
    assert set(PRESETS) == {"pylontech", "orion"}


def pylontech(percent: int, **more: bool) -> can.Message:
    return can.Message(arbitration_id=0x355, data=struct.pack("<H", percent), **{"is_extended_id": False, **more})


@pytest.mark.parametrize(
    "frame",
    [pylontech(101), pylontech(0xFFFF), can.Message(arbitration_id=0x355, is_extended_id=False, data=b"\x50")],
    ids=["101 %", "unset", "short"],
)
def test_a_soc_that_cannot_be_is_dropped_and_counted(frame: can.Message) -> None:
    signal = preset("pylontech")
    assert not signal.absorb(frame, 1.0)
    assert (signal.soc, signal.nonsense) == (None, 1)


def test_another_frame_with_the_same_number_in_29_bits_is_another() -> None:
    signal = preset("pylontech")
    assert not signal.absorb(pylontech(50, is_extended_id=True), 1.0)
    assert signal.nonsense == 0


def test_a_jump_is_believed_when_it_is_told_again() -> None:
    signal = preset("pylontech")
    signal.absorb(pylontech(50), 1.0)
    assert [signal.absorb(pylontech(p), 2.0) for p in (90, 51, 70, 71)] == [False, True, False, False]
    assert signal.soc == pytest.approx(0.51)
    assert signal.absorb(pylontech(70), 3.0)
    assert signal.soc == pytest.approx(0.70)


OWN = """VERSION ""
BS_:
BU_: A
BO_ 2566844926 Mine: 8 A
 SG_ Ladezustand : 8|8@1+ (0.4,0) [0|100] "%" A
"""


def test_any_signal_of_any_dbc(tmp_path: Path) -> None:
    (tmp_path / "own.dbc").write_text(OWN)
    signal = soc_signal(None, tmp_path / "own.dbc", "Ladezustand")
    assert signal is not None
    frame = can.Message(arbitration_id=2566844926 & 0x1FFFFFFF, is_extended_id=True, data=b"\0\x7d" + bytes(6))
    assert signal.absorb(frame, 1.0)
    assert signal.soc == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        (OWN, "Soc", "there are: Ladezustand"),
        ("nonsense", "Soc", "not read as a DBC"),
        (None, "Soc", "not read as a DBC"),
    ],
)
def test_a_dbc_without_the_signal_is_a_configuration_error(
    tmp_path: Path, text: str | None, name: str, said: str
) -> None:
    if text is not None:
        (tmp_path / "own.dbc").write_text(text)
    with pytest.raises(ConfigError, match=said) as refused:
        soc_signal(None, tmp_path / "own.dbc", name)
    assert "\n" not in str(refused.value)


def test_without_a_word_of_it_there_is_none() -> None:
    assert soc_signal(None, None, None) is None
