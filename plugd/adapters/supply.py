"""Whether a Raspberry Pi is fed with too little, as its kernel says (its documentation: raspberrypi-hwmon)."""

import time
from pathlib import Path

from plugd.domain import Fault

HWMON = Path("/sys/class/hwmon")
NAME, ALARM = "rpi_volt", "in0_lcrit_alarm"
STANDS_S = 3600.0
"""A dip lasts for seconds; it is told for so long after the last one that was seen."""


class Supply:
    """Asks for the alarm at every look. Other machines have none."""

    def __init__(self, hwmon: Path = HWMON) -> None:
        names = (name for name in sorted(hwmon.glob("hwmon*/name")) if _word(name) == NAME)
        self._alarm = next((name.with_name(ALARM) for name in names), None)
        self._low_s: float | None = None

    def faults(self) -> tuple[Fault, ...]:
        """What is said of it."""
        now_s = time.monotonic()
        if self._alarm is not None and _word(self._alarm) == "1":
            self._low_s = now_s
        if self._low_s is None or now_s - self._low_s > STANDS_S:
            return ()
        return (Fault("weak_supply", "this Raspberry Pi gets less than 4.63 V, or did within the last hour"),)


def _word(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""
