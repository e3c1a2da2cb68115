"""How full the battery is, as its own management system (BMS) tells on CAN: any signal of any DBC."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
import cantools

from plugd.adapters.elcon_words import FOLDER, plain
from plugd.errors import ConfigError
from plugd.units import from_pct

PRESETS = {"pylontech": "Pylontech_Soc", "orion": "Orion_Soc"}
"""Signals of `bms.dbc`."""
JUMP = 0.05
"""A larger step than this from the last word is believed when it was told `TELLINGS` times in a row."""
TELLINGS = 3


@dataclass(slots=True)
class SocSignal:
    """One signal, in percent: what it last said as a fraction, and when."""

    frame_id: int
    extended: bool
    soc: float | None = None
    heard_s: float = 0.0
    """Monotonic time of the last believed word."""
    nonsense: int = 0
    _message: Any = None
    _signal: str = ""
    _jumps: list[float] = field(default_factory=list)

    def absorb(self, message: can.Message, now_s: float) -> bool:
        """Look at a frame. Returns whether it said something that is believed."""
        mine = message.arbitration_id == self.frame_id and message.is_extended_id is self.extended
        if not (mine and plain(message)):
            return False
        percent = self._percent(message)
        if percent is None or not 0.0 <= percent <= 100.0:
            self.nonsense += 1
            return False
        return self._believe(from_pct(percent), now_s)

    def _percent(self, message: can.Message) -> float | None:
        try:
            told = self._message.decode(bytes(message.data), decode_choices=False, allow_truncated=True)
        except (cantools.Error, ValueError):
            return None
        value = told.get(self._signal)
        return float(value) if isinstance(value, int | float) else None

    def _believe(self, soc: float, now_s: float) -> bool:
        if self.soc is not None and abs(soc - self.soc) > JUMP:
            self._jumps = [s for s in self._jumps if abs(s - soc) <= JUMP] + [soc]
            if len(self._jumps) < TELLINGS:
                return False
        self._jumps.clear()
        self.soc, self.heard_s = soc, now_s
        return True


def soc_signal(preset: str | None, dbc: Path | None, signal: str | None) -> SocSignal | None:
    """The signal of the configuration, None where none is wanted. Raises ConfigError for one that is not there."""
    if preset is not None:
        dbc, signal = FOLDER / "bms.dbc", PRESETS[preset]
    if dbc is None or signal is None:
        return None
    try:
        database: Any = cantools.database.load_file(dbc)
    except (OSError, UnicodeDecodeError, cantools.Error) as error:
        raise ConfigError(f'can.soc_dbc = "{dbc}": not read as a DBC: {" ".join(str(error).split())[:200]}') from error
    found = [m for m in getattr(database, "messages", ()) if signal in (s.name for s in m.signals)]
    if len(found) != 1:
        known = ", ".join(sorted(s.name for m in getattr(database, "messages", ()) for s in m.signals))[:200]
        many = "is in several messages" if found else f"is not in {dbc}; there are: {known}"
        raise ConfigError(f'can.soc_signal = "{signal}": {many}')
    message = found[0]
    return SocSignal(message.frame_id, message.is_extended_frame, _message=message, _signal=signal)
