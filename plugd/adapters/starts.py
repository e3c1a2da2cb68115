"""How often plugd has started lately, in a file beside the store: what ends it at once must not do so for ever."""

import json
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from plugd.adapters.kept_twice import replaced

FILE = "starts.json"
SPAN_S = 600.0
MOST = 5
"""More starts than this within that time, none of them ended by a person, are a loop."""


class Starts:
    """The last starts that were not ended in order. A file that cannot be read or written counts as none."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE

    def begun(self, now: datetime) -> bool:
        """plugd starts. Whether it has done so too often."""
        at_s = now.timestamp()
        recent = [each_s for each_s in self._read() if 0.0 <= at_s - each_s < SPAN_S]
        self._write([*recent, at_s][-2 * MOST :])
        return len(recent) >= MOST

    def ended(self) -> None:
        """It ends in order, told to: that is no crash."""
        self._write([])

    def _read(self) -> list[float]:
        try:
            found = json.loads(self._path.read_bytes()[:4096])
        except (OSError, ValueError, RecursionError):
            return []
        if not isinstance(found, list):
            return []
        return [each for each in found if isinstance(each, float)]

    def _write(self, starts: list[float]) -> None:
        with suppress(OSError):
            replaced(self._path, json.dumps(starts).encode())
