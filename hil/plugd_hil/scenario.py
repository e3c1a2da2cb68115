"""A scenario: one YAML that says what is built up, what goes wrong when, and what must hold all the same."""

from dataclasses import dataclass
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Annotated, Any, Literal
from zoneinfo import ZoneInfo

from pydantic import Field, ValidationError

from plugd.config.sections import Section
from plugd.errors import UsageError
from plugd.units import require_utc
from plugd_hil.plug import DIALECTS
from plugd_hil.promises import Promise, parsed
from plugd_hil.script import Event, document, event

ZONE = ZoneInfo("Europe/London")
START = "2023-01-10T17:00"
"""A winter afternoon of the synthetic year, in local time."""
NIGHT_H = 14.5
COMES, GOES = time(18), time(9)
CAN = "can_elcon"
KINDS = (*DIALECTS, CAN)


class Written(Section):
    """The YAML's keys."""

    title: str
    line: str
    """Of the table of failure modes: its first words."""
    plug: str = "tasmota"
    start: str = START
    nights: Annotated[int, Field(ge=1, le=7)] | None = None
    hours: Annotated[float, Field(gt=0, le=24)] | None = None
    """Instead of nights."""
    seconds: Annotated[float, Field(gt=0, le=60)] | None = None
    """Instead of nights: short enough for natural speed."""
    power_kw: float = 2.3
    soc_pct: float = 40.0
    car: Literal["comes", "connected", "absent"] = "comes"
    """It comes at 18:00 (and goes at 09:00), or is there all the time, or not at all; `faults` may move it too."""
    tell: Literal["arrival", "always", "never"] = "arrival"
    seed: int = 0
    look_s: Annotated[float, Field(ge=10)] = 30.0
    """The daemon looks at least so often on the simulated clock; on the real one it does every 10 s."""
    plug_options: list[str] = Field(default_factory=list)
    """More words for the stub's command line."""
    config: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Over plugd's own configuration, table by table."""
    faults: list[dict[str, Any]] = Field(default_factory=list)
    promises: list[dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Scenario:
    """Ready to be run."""

    path: Path
    written: Written
    start: datetime
    end: datetime
    events: tuple[Event, ...]
    promises: tuple[Promise, ...]

    @property
    def stays(self) -> list[tuple[datetime, str]]:
        """When the car comes and goes, as orders to the stub."""
        first = self.start.astimezone(ZONE).date()
        days = [first + timedelta(days=day) for day in range(self.written.nights or 0)]
        return [
            (require_utc(datetime.combine(day + timedelta(days=late), at, ZONE)), order)
            for day in days
            for late, at, order in ((0, COMES, "car arrive"), (1, GOES, "car leave"))
        ]

    @property
    def name(self) -> str:
        """The file's."""
        return self.path.stem


def load(path: Path, now: datetime | None = None) -> Scenario:
    """The scenario in a file, its times after its own start, or after `now`. Raises UsageError naming file and key."""
    try:
        written = Written.model_validate(document(path))
    except ValidationError as error:
        first = error.errors()[0]
        raise UsageError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    if written.plug not in KINDS:
        raise UsageError(f"{path}: plug {written.plug!r}: choose one of {', '.join(KINDS)}")
    if [written.nights, written.hours, written.seconds].count(None) != 2:
        raise UsageError(f"{path}: write one of nights, hours, seconds")
    start = now or require_utc(datetime.fromisoformat(written.start).replace(tzinfo=ZONE))
    length_s = written.seconds or 3600.0 * (written.hours or 24.0 * ((written.nights or 1) - 1) + NIGHT_H)
    end = start + timedelta(seconds=length_s)
    try:
        events = tuple(event(row, start, ZONE) for row in written.faults)
        promises = tuple(parsed(row, start, end, ZONE) for row in written.promises)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    return Scenario(path, written, start, end, tuple(sorted(events)), promises)
