"""What may be wrong between a stub plug over MQTT and its broker, whatever it speaks: it lies, babbles, is late.

Orders: lie power WATTS · lie energy VALUE · lie relay on|off · truth · reset (the meter begins at 0) · late SECONDS ·
deaf · hear · babble MESSAGES.
"""

import json
import random
from collections import deque
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

from plugd_hil.outlet import Said

WHAT = {
    "power": ("Power", "apower", "power", "amp"),
    "energy": ("Total", "total", "energy", "wh", "total_energy"),
    "relay": ("POWER", "POWER1", "output", "state", "0"),
}
"""By what is told: its JSON keys, and the ends of its topics where a topic holds one value (Gen1's relay is `0`)."""
NOISE = (
    "", "null", "[" * 3000, '{"POWER":', '{"ENERGY":{"Power":NaN,"Total":1e999}}', "\u00ff\u00fe\0", "-1e308",
    '{"apower":"much","output":2}', '{"POWER":"MAYBE"}', "ONN", '{"state":{"state":{"state":[]}}}', "9" * 4000,
)  # fmt: skip
Change = Callable[[str, Any], Any]
"""Of a key and what is told under it."""


class PlugFaults:
    """What the plug says goes through `pass_on`, what it is told through `hears`."""

    def __init__(self, seed: int) -> None:
        self.deaf = False
        self._lies: dict[str, Change] = {}
        self._late = timedelta(0)
        self._waiting: deque[tuple[datetime, Said]] = deque()
        self._topics: dict[str, None] = {}
        self._dice = random.Random(f"{seed}/noise")

    def due(self) -> datetime | None:
        """When something held back is sent."""
        return self._waiting[0][0] if self._waiting else None

    def pass_on(self, said: list[Said], now: datetime) -> list[Said]:
        """What of it, and of what was held back, goes to the broker now."""
        for one in said:
            self._topics[one.topic] = None
            self._waiting.append((now + self._late, self._lied(one)))
        out = []
        while self._waiting and self._waiting[0][0] <= now:
            out.append(self._waiting.popleft()[1])
        return out

    def told(self, line: str) -> list[Said] | None:
        """An order from the world; None for one that is none of these."""
        match line.split():
            case ["lie", ("power" | "energy") as what, value]:
                self._lies[what] = _always(float(value))
            case ["lie", "relay", ("on" | "off") as word]:
                self._lies["relay"] = _as_told(word == "on")
            case ["truth"]:
                self._lies.clear()
            case ["reset"]:
                self._lies["energy"] = _since_now()
            case ["late", seconds]:
                self._late = timedelta(seconds=float(seconds))
            case ["deaf" | "hear" as word]:
                self.deaf = word == "deaf"
            case ["babble", messages]:
                return [self._noise() for _ in range(int(messages))]
            case _:
                return None
        return []

    def _noise(self) -> Said:
        """Something that cannot be, on a topic of its own."""
        return Said(self._dice.choice(list(self._topics)), self._dice.choice(NOISE))

    def _lied(self, said: Said) -> Said:
        for what, change in self._lies.items():
            said = said._replace(payload=_rewritten(said, WHAT[what], change))
        return said


def _rewritten(said: Said, keys: tuple[str, ...], change: Change) -> str:
    """The payload with every value under these keys changed."""
    try:
        document = json.loads(said.payload)
    except (ValueError, RecursionError):  # its own noise is as deep as it likes
        document = said.payload
    tail = said.topic.rsplit("/", 1)[-1]
    if not isinstance(document, dict):
        changed = change(tail, document) if tail in keys else document
        return changed if isinstance(changed, str) else json.dumps(changed)
    return json.dumps(_walked(document, keys, change), separators=(",", ":"))


def _walked(table: dict[str, Any], keys: tuple[str, ...], change: Change) -> dict[str, Any]:
    return {
        key: _walked(value, keys, change) if isinstance(value, dict) else change(key, value) if key in keys else value
        for key, value in table.items()
    }


def _always(value: float) -> Change:
    return lambda _, told: value if isinstance(told, int | float) and not isinstance(told, bool) else told


def _as_told(on: bool) -> Change:
    """In the plug's own word for it."""
    word = "on" if on else "off"

    def change(_key: str, told: Any) -> Any:
        if isinstance(told, bool):
            return on
        if isinstance(told, str) and told.lower() in ("on", "off"):
            return word.upper() if told.isupper() else word
        return told

    return change


def _since_now() -> Change:
    """Less the first number that is told under each key."""
    first: dict[str, float] = {}

    def change(key: str, told: Any) -> Any:
        if not isinstance(told, int | float) or isinstance(told, bool):
            return told
        return round(told - first.setdefault(key, told), 6)

    return change
