"""The script of a run: what happens to whom, and when. Part of a scenario's YAML, and read by every stub from there.

faults:
  - {at: "02:10", plug: mute}              # the first 02:10 after the start, in the script's time zone
  - {at: "+90", broker: stop}              # seconds after the start
  - {at: "1/02:10", plugd: kill}           # a day later
"""

import re
from collections import deque
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

from plugd.errors import UsageError
from plugd.units import require_utc

WHO = ("plug", "neso", "broker", "plugd", "say")
"""Stub plug or charger, stub server, broker, the daemon, and anybody who says something to the broker."""
SINCE = re.compile(r"\+(\d+(?:\.\d+)?)")
CLOCK = re.compile(r"(?:(\d)/)?(\d\d?):(\d\d)(?::(\d\d))?")


class Event(NamedTuple):
    """An order to one of those in `WHO`."""

    at: datetime
    who: str
    order: str


def moment(text: object, start: datetime, zone: ZoneInfo) -> datetime:
    """A script's time as aware UTC. Raises UsageError for anything else."""
    if isinstance(text, str) and (since := SINCE.fullmatch(text)):
        return start + timedelta(seconds=float(since[1]))
    if not isinstance(text, str) or not (clock := CLOCK.fullmatch(text)):
        raise UsageError(f'{text!r} is no time: write "02:10", "1/02:10" (a day later) or "+90" (s), in quotes')
    days, hour, minute, second = (int(part or 0) for part in clock.groups())
    first = start.astimezone(zone)
    try:
        there = datetime.combine(first.date() + timedelta(days=days), time(hour, minute, second), zone)
    except ValueError:
        raise UsageError(f"{text!r}: there is no such time of day") from None
    return require_utc(there if there >= first + timedelta(days=days) else there + timedelta(days=1))


def event(row: Any, start: datetime, zone: ZoneInfo) -> Event:
    """One row of the script. Raises UsageError."""
    if not isinstance(row, dict) or len(row) != 2 or "at" not in row:
        raise UsageError(f"{row!r}: a row of `faults` is a time and one order, as {{at: '02:10', plug: mute}}")
    who = next(key for key in row if key != "at")
    if who not in WHO:
        raise UsageError(f"{who!r} is nobody; there are {', '.join(WHO)}")
    return Event(moment(row["at"], start, zone), who, str(row[who]))


def document(path: Path) -> dict[str, Any]:
    """A scenario's YAML. Raises UsageError naming the file where it is none."""
    import yaml  # noqa: PLC0415 # in an extra: the demo does without

    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from error
    if not isinstance(found, dict):
        raise UsageError(f"{path}: a scenario is a table, with a list under `faults`")
    return found


class Script:
    """The orders for one of them, in order of time."""

    def __init__(self, events: list[Event]) -> None:
        self._left = deque(sorted(events, key=lambda event: event.at))
        self.current = ""
        """The last one that was taken."""

    @classmethod
    def read(cls, path: Path | None, who: str, start: datetime, timezone: str) -> "Script":
        """Those in a file. Raises UsageError."""
        rows = document(path).get("faults") or [] if path else []
        events = [event(row, start, ZoneInfo(timezone)) for row in rows]
        return cls([one for one in events if one.who == who])

    def due(self) -> datetime | None:
        """When the next is due."""
        return self._left[0].at if self._left else None

    def take(self, now: datetime) -> list[str]:
        """Those that are due now."""
        taken = []
        while self._left and self._left[0].at <= now:
            taken.append(self._left.popleft().order)
        self.current = taken[-1] if taken else self.current
        return taken
