"""What the NESO Carbon Intensity API answers to a path: its endpoints, shapes and refusals, without HTTP."""

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

from plugd.units import HALF_HOUR, require_utc, slot_start
from plugd_hil.neso_faults import Answer
from plugd_hil.neso_source import Row, Source

LONGEST = timedelta(days=14)
WINDOWS = {"fw24h": (0, 24), "fw48h": (0, 48), "pt24h": (-24, 0)}
"""Hours from `from`."""
INDEX = ((40, "very low"), (120, "low"), (200, "moderate"), (280, "high"), (float("inf"), "very high"))
"""Upper ends of the API's words, about those of 2023."""
MIX = ("biomass", "coal", "imports", "gas", "nuclear", "other", "hydro", "solar", "wind")
REGIONS = {
    1: ("Scottish Hydro Electric Power Distribution", "North Scotland"),
    2: ("SP Distribution", "South Scotland"),
    3: ("Electricity North West", "North West England"),
    4: ("NPG North East", "North East England"),
    5: ("NPG Yorkshire", "Yorkshire"),
    6: ("SP Manweb", "North Wales and Merseyside"),
    7: ("WPD South Wales", "South Wales"),
    8: ("WPD West Midlands", "West Midlands"),
    9: ("WPD East Midlands", "East Midlands"),
    10: ("UKPN East", "East England"),
    11: ("WPD South West", "South West England"),
    12: ("SSE South", "South England"),
    13: ("UKPN London", "London"),
    14: ("UKPN South East", "South East England"),
    15: ("England", "England"),
    16: ("Scotland", "Scotland"),
    17: ("Wales", "Wales"),
}
POSTCODE_REGION = 13
"""Every postcode is in London here."""
NO_REGION = {
    "regionid": "Please enter a valid region ID.",
    "postcode": "No postcode match can be found.",
}
NOT_A_TIME = "Please enter a valid datetime in ISO8601 format YYYY-MM-DDThh:mmZ e.g. /intensity/2017-08-25T15:30Z"


class Refused(Exception):
    """Answered 400 with this message."""


def answer_to(path: str, source: Source, now: datetime, boundary: bool = False) -> Answer:
    """The API's answer at `now`. Raises Refused."""
    for pattern, answer in ROUTES:
        match = re.fullmatch(pattern, path)
        if match is not None:
            if any(re.fullmatch(r"\d{4}-\d\d-\d\d", part) for part in match.groups()[:1]) and "/date/" not in path:
                return {}  # off-spec, and what the real one often does with it
            return answer(_Ask(source, now, boundary), *match.groups())
    raise Refused("Requested resource not found.")


class _Ask:
    """One question's surroundings."""

    def __init__(self, source: Source, now: datetime, boundary: bool) -> None:
        self.source, self.now, self.boundary = source, require_utc(now), boundary

    def rows(self, start: datetime, end: datetime, region: int | None = None) -> list[Row]:
        """All half hours known from the one that holds `start` up to `end`."""
        first = slot_start(start)
        if self.boundary and first == start:
            first -= HALF_HOUR
        count = max(0, -((first - end) // HALF_HOUR))
        found = (self.source.row(region, first + k * HALF_HOUR, self.now) for k in range(count))
        return [row for row in found if row is not None]


def _current(ask: _Ask) -> Answer:
    """The real one's "current" half hour is the last complete one."""
    last = slot_start(ask.now) - HALF_HOUR
    return _national(ask.rows(last, last + HALF_HOUR))


def _at(ask: _Ask, begin: str) -> Answer:
    start = slot_start(_moment(begin))
    return _national(ask.rows(start, start + HALF_HOUR))


def _between(ask: _Ask, begin: str, until: str) -> Answer:
    return _national(ask.rows(*_window(begin, until)))


def _day(ask: _Ask, day: str | None = None, period: str | None = None) -> Answer:
    """A settlement day: local midnight to midnight, in 46, 48 or 50 half hours."""
    zone = ZoneInfo("Europe/London")
    try:
        local = datetime.strptime(day, "%Y-%m-%d").replace(tzinfo=zone) if day else ask.now.astimezone(zone)
    except ValueError as error:
        raise Refused(NOT_A_TIME) from error
    midnight = local.replace(hour=0, minute=0, second=0, microsecond=0)
    start, end = require_utc(midnight), require_utc(midnight + timedelta(days=1))
    if period is not None:
        start += (int(period) - 1) * HALF_HOUR
        end = start + HALF_HOUR
    return _national(ask.rows(start, end))


def _regional(ask: _Ask, begin: str, until: str, kind: str, place: str) -> Answer:
    known = re.fullmatch(r"[1-9][0-9]?" if kind == "regionid" else r"[A-Z]{1,2}[0-9][0-9A-Z]?", place)
    if known is None:
        raise Refused(NO_REGION[kind])
    region = int(place) if kind == "regionid" else POSTCODE_REGION
    if region not in REGIONS or not ask.source.knows(region):
        raise Refused(NO_REGION["regionid"])
    operator, name = REGIONS[region]
    rows = [_regional_row(row) for row in ask.rows(*_window(begin, until), region=region)]
    echo = {"postcode": place} if kind == "postcode" else {}
    return {"data": {"regionid": region, "dnoregion": operator, "shortname": name, **echo, "data": rows}}


ROUTES: tuple[tuple[str, Callable[..., Answer]], ...] = (
    (r"/intensity", _current),
    (r"/intensity/date", _day),
    (r"/intensity/date/([^/]+)", _day),
    (r"/intensity/date/([^/]+)/([0-9]{1,2})", _day),
    (r"/intensity/([^/]+)", _at),
    (r"/intensity/([^/]+)/([^/]+)", _between),
    (r"/regional/intensity/([^/]+)/([^/]+)/(regionid|postcode)/([^/]+)", _regional),
)


def _moment(text: str) -> datetime:
    try:
        return datetime.strptime(text, "%Y-%m-%dT%H:%MZ").replace(tzinfo=UTC)
    except ValueError as error:
        raise Refused(NOT_A_TIME) from error


def _window(begin: str, until: str) -> tuple[datetime, datetime]:
    """`from` to `to`, or to a named length."""
    start = _moment(begin)
    if until in WINDOWS:
        low_h, high_h = WINDOWS[until]
        return start + timedelta(hours=low_h), start + timedelta(hours=high_h)
    end = _moment(until)
    if not timedelta(0) < end - start <= LONGEST:
        raise Refused("The maximum date range is limited to 14 days.")
    return start, end


# -- shapes ---------------------------------------------------------------------------------------


def _national(rows: list[Row]) -> Answer:
    return {"data": [_row(row, {"actual": _whole(row.actual)}) for row in rows]}


def _regional_row(row: Row) -> Answer:
    mix = [{"fuel": fuel, "perc": 100 if fuel == "other" else 0} for fuel in MIX]
    return {**_row(row, {}), "generationmix": mix}


def _row(row: Row, more: Answer) -> Answer:
    forecast = _whole(row.forecast)
    index = next(word for below, word in INDEX if (forecast or 0) < below)
    stamps = {"from": f"{row.start:%Y-%m-%dT%H:%MZ}", "to": f"{row.start + HALF_HOUR:%Y-%m-%dT%H:%MZ}"}
    return {**stamps, "intensity": {"forecast": forecast, **more, "index": index}}


def _whole(value: float | None) -> int | None:
    return None if value is None else round(value)
