"""What an Elcon or TC charger tells and is told on CAN, by `elcon.dbc`: 29-bit identifiers, big-endian.

Whatever is asked of `Words.command`, the frame never holds more than the battery's limits.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import cantools

from plugd.units import within

COMMAND_ID = 0x1806E5F4
STATUS_ID = 0x18FF50E5
FRAME_BYTES = 8
FOLDER = Path(__file__).parent
CHARGE, STOP = 0, 1
VOLTAGE_SHARE, CURRENT_SHARE, CURRENT_SPARE_A = 1.25, 1.5, 5.0
"""Of the battery's limits: a charger that tells more is not believed (0xFFFF is 6553.5 V)."""
OVER_SHARE, OVER_SPARE_A = 1.03, 1.0
"""More than the limits by this is not the meter's inaccuracy any more."""
HARDWARE, HEAT, MAINS, BATTERY, DEAF = (
    "HardwareFailure", "OverTemperature", "InputVoltage", "BatteryDisconnected", "CommunicationTimeout"
)  # fmt: skip
"""Its status bits by their names in the DBC, bit 0 first."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What the battery bears: no frame asks for more."""

    voltage_v: float
    current_a: float

    def __post_init__(self) -> None:
        if not (0.0 < self.voltage_v < math.inf and 0.0 < self.current_a < math.inf):
            raise ValueError(f"battery limits are {self.voltage_v} V and {self.current_a} A")


@dataclass(frozen=True, slots=True)
class Status:
    """What the charger tells once a second: its output, on the battery's side, and which bits are set."""

    voltage_v: float
    current_a: float
    bits: tuple[str, ...] = ()


def plain(message: can.Message) -> bool:
    """Whether it is a classic data frame: no error frame, no remote one, no CAN FD."""
    return not (message.is_error_frame or message.is_remote_frame or message.is_fd)


class Words:
    """Frames to values and back, for one battery."""

    def __init__(self, limits: Limits) -> None:
        database: Any = cantools.database.load_file(FOLDER / "elcon.dbc")
        self._command = database.get_message_by_name("Command")
        self._status = database.get_message_by_name("Status")
        self.limits = limits

    def command(self, current_a: float, charge: bool) -> can.Message:
        """The frame of every second: up to the battery's voltage, this current, charge or stop."""
        limits = self.limits
        wanted_a = current_a if charge and math.isfinite(current_a) else 0.0
        fields = {
            "MaxVoltage": _tenths(limits.voltage_v),
            "MaxCurrent": _tenths(within(0.0, wanted_a, limits.current_a)),
            "Control": CHARGE if charge else STOP,
            "Mode": 0,
        }
        data: bytes = self._command.encode(fields)
        return can.Message(arbitration_id=COMMAND_ID, is_extended_id=True, data=data)

    def status(self, message: can.Message) -> Status | None:
        """What a frame with the charger's identifier says; None where that cannot be."""
        if len(message.data) != FRAME_BYTES:
            return None
        told = self._status.decode(bytes(message.data))
        found = Status(
            told["Voltage"], told["Current"], tuple(b for b in (HARDWARE, HEAT, MAINS, BATTERY, DEAF) if told[b])
        )
        most_a = CURRENT_SHARE * self.limits.current_a + CURRENT_SPARE_A
        return found if found.voltage_v <= VOLTAGE_SHARE * self.limits.voltage_v and found.current_a <= most_a else None

    def over(self, status: Status) -> bool:
        """Whether the charger gives what the battery does not bear."""
        too_much_a = OVER_SHARE * self.limits.current_a + OVER_SPARE_A
        return status.current_a > too_much_a or (
            status.current_a > 0.0 and status.voltage_v > OVER_SHARE * self.limits.voltage_v
        )


def is_status(message: can.Message) -> bool:
    """Whether a frame is the charger's own."""
    return plain(message) and message.is_extended_id and message.arbitration_id == STATUS_ID


def is_command(message: can.Message) -> bool:
    """Whether a frame tells the charger what to do."""
    return plain(message) and message.is_extended_id and message.arbitration_id == COMMAND_ID


def _tenths(value: float) -> float:
    """Rounded down to what a frame can say: never up, never above its 16 bits."""
    return min(math.floor(value * 10.0 + 1e-6), 0xFFFF) / 10.0
