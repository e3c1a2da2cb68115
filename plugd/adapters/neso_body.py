"""What a body of the NESO Carbon Intensity API means. Pure: bytes in, a Forecast or ForecastMalformed out.

The API's shapes, one object a half hour, in UTC:
national `{"data": [{"from", "to", "intensity": {"forecast", "actual", "index"}}]}`,
regional `{"data": {"regionid", ..., "data": [rows without actual]}}`, also as a list of one such object.
"""

import json
import re
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from enum import StrEnum

from plugd.domain import Forecast, Intensity, PastRow
from plugd.errors import ForecastMalformed
from plugd.units import HALF_HOUR, iso, require_utc, slot_start

NATIONAL = "national"
MOST_G_PER_KWH = 1000.0
"""No British half hour comes near it: all the grid on the worst coal."""
MOST_BAD = 0.25
"""Share of unusable rows from which the whole answer is not believed."""
LATEST_FIRST_ROW = timedelta(minutes=35)
"""A forecast begins with the half hour under way; the next one is accepted when the clock is behind."""
FARTHEST = timedelta(days=8)
"""Rows farther from now than this, either way, are not a forecast for now."""
LONGEST_QUOTE = 120

_EMPTY = "NESO's answer holds no half hours"
_MOMENT = re.compile(r"([0-9]{4})-([0-9]{2})-([0-9]{2})T([0-9]{2}):([0-9]{2})(?::00)?Z")


class Dropped(StrEnum):
    """Why a row, or a part of it, is not used. The value completes "3 rows ..."."""

    SHAPE = "without a time and an intensity"
    TIME = "with a time that is not YYYY-MM-DDThh:mmZ"
    GRID = "off the half-hour grid or not half an hour long"
    FAR = "more than 8 days away"
    NULL = "with a null forecast"
    VALUE = "with a forecast that is not a number from 0 to 1000"
    OVER = "already over"
    TWICE = "given twice, the last one used"
    ACTUAL = "with an actual that is not a number from 0 to 1000"


_BAD = (Dropped.SHAPE, Dropped.TIME, Dropped.GRID, Dropped.FAR, Dropped.NULL, Dropped.VALUE)


@dataclass(slots=True)
class _Rows:
    """What is gathered from an answer's rows."""

    expected: dict[datetime, float] = field(default_factory=dict)
    actual: dict[datetime, float] = field(default_factory=dict)
    first: datetime | None = None
    dropped: Counter[Dropped] = field(default_factory=Counter)


def parse(body: bytes, now: datetime, region: str) -> Forecast:
    """The forecast in an answer to a question asked at `now` about `region` ("national", "13", "SW1").

    Rows are keyed by their own `from`. Raises ForecastMalformed, with one line for a person, where the
    answer is none, is of another region, is mostly unusable or does not reach past `now`.
    """
    now = require_utc(now)
    rows = _rows_of(_json(body), region)
    seen = _Rows()
    for row in rows:
        why = _take(row, now, seen)
        if why is not None:
            seen.dropped[why] += 1
    _believe(seen, len(rows), now)
    return Forecast(
        issued_at=now,
        region=region,
        expected=_sorted(seen.expected),
        actual=_sorted(seen.actual),
        dropped=tuple(_told(seen.dropped)),
    )


def parse_past(body: bytes, start: datetime, end: datetime, region: str) -> tuple[PastRow, ...]:
    """What an answer says about [start, end), one row a half hour, without what is unusable. Raises ForecastMalformed.

    The API may answer from the half hour before `start` on; rows count by their own time.
    """
    found = {}
    for row in _rows_of(_json(body), region):
        intensity = row.get("intensity") if isinstance(row, dict) else None
        begin = _moment(row.get("from")) if isinstance(row, dict) else None
        if not isinstance(intensity, dict) or begin is None or slot_start(begin) != begin:
            continue
        forecast, actual = (_g_per_kwh(intensity.get(name)) for name in ("forecast", "actual"))
        if start <= begin < end and (forecast is not None or actual is not None):
            found[begin] = PastRow(begin, forecast, actual)
    return tuple(found[begin] for begin in sorted(found))


def error_message(body: bytes) -> str:
    """The message inside an error body, fit to be quoted on one line; "" where there is none."""
    try:
        answer = json.loads(body.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        return ""
    return _error_in(answer)


def _error_in(answer: object) -> str:
    error = answer.get("error") if isinstance(answer, dict) else None
    message = error.get("message") if isinstance(error, dict) else error
    return quotable(message) if isinstance(message, str) else ""


def quotable(text: str) -> str:
    """Text from outside, on one line: printable characters only, shortened."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text[: 4 * LONGEST_QUOTE]).split())
    return line if len(line) <= LONGEST_QUOTE else line[: LONGEST_QUOTE - 1] + "…"


def _json(body: bytes) -> object:
    if not body.strip():
        raise ForecastMalformed("NESO answered with an empty body; plugd asks again later")
    try:
        answer: object = json.loads(body.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        start = quotable(body[:60].decode("utf-8", "replace"))
        raise ForecastMalformed(
            f"NESO's answer is not JSON but begins with {start!r}; log in to the network, or check forecast.base_url"
        ) from error
    return answer


def _rows_of(answer: object, region: str) -> list[object]:
    """The rows of an answer in either shape, checked to be of `region`."""
    content = answer.get("data") if isinstance(answer, dict) else None
    if not content:
        error = _error_in(answer)
        said = f" but an error ({error})" if error else ""
        raise ForecastMalformed(f"{_EMPTY}{said}; plugd asks again later")
    items = content if isinstance(content, list) else [content]
    regional = [item for item in items if isinstance(item, dict) and "data" in item]
    if region == NATIONAL:
        if regional or not isinstance(content, list):
            raise ForecastMalformed("NESO answered for a region, but the national forecast was asked for")
        return items
    return _of_region(regional, region)


def _of_region(regional: list[dict[str, object]], region: str) -> list[object]:
    if not regional:
        raise ForecastMalformed(f"NESO's answer is not for a region, but region {region} was asked for")
    named = [_name(item.get("regionid")) for item in regional]
    chosen = [item for item, name in zip(regional, named, strict=True) if not region.isdigit() or name in ("", region)]
    if not chosen:
        others = quotable(", ".join(named))
        raise ForecastMalformed(f"NESO answered for region {others}, but region {region} was asked for")
    rows = chosen[0]["data"]
    if not isinstance(rows, list) or not rows:
        raise ForecastMalformed(f"{_EMPTY} of region {region}; plugd asks again later")
    return rows


def _name(told: object) -> str:
    """A region as the answer names it, "" where it does not. A nested value may be too deep to print."""
    return "" if told is None else str(told) if isinstance(told, str | int | float) else "?"


def _take(row: object, now: datetime, seen: _Rows) -> Dropped | None:
    """Add one row to what was seen. Returns why its forecast is not used, None where it is."""
    if not isinstance(row, dict) or not isinstance(row.get("intensity"), dict):
        return Dropped.SHAPE
    start, end = _moment(row.get("from")), _moment(row.get("to"))
    if start is None or end is None:
        return Dropped.TIME
    if end - start != HALF_HOUR or slot_start(start) != start:
        return Dropped.GRID
    if abs(start - now) > FARTHEST:
        return Dropped.FAR
    seen.first = start if seen.first is None else min(seen.first, start)
    intensity = row["intensity"]
    if end <= now:
        _take_actual(intensity.get("actual"), start, seen)
        return Dropped.OVER
    if intensity.get("forecast") is None:
        return Dropped.NULL
    value = _g_per_kwh(intensity["forecast"])
    if value is None:
        return Dropped.VALUE
    if start in seen.expected:
        seen.dropped[Dropped.TWICE] += 1
    seen.expected[start] = value
    return None


def _take_actual(told: object, start: datetime, seen: _Rows) -> None:
    """Keep a measured value. A half hour not over yet has none, whatever the answer says."""
    value = _g_per_kwh(told)
    if value is not None:
        seen.actual[start] = value
    elif told is not None:
        seen.dropped[Dropped.ACTUAL] += 1


def _believe(seen: _Rows, count: int, now: datetime) -> None:
    """Raise ForecastMalformed where what is left is not a forecast for now."""
    bad = sum(seen.dropped[why] for why in _BAD)
    if bad > MOST_BAD * count:
        worst = ", ".join(_told(Counter({why: seen.dropped[why] for why in _BAD})))
        raise ForecastMalformed(f"NESO's answer is not used: {bad} of {count} rows are unusable ({worst})")
    if not seen.expected or seen.first is None:
        raise ForecastMalformed(
            f"NESO's answer has nothing after now, {iso(now)}; if that is not the time, set the clock"
        )
    if seen.first - now > LATEST_FIRST_ROW:
        raise ForecastMalformed(
            f"NESO's answer begins at {iso(seen.first)}, but now is {iso(now)}; if that is not the time, set the clock"
        )


def _moment(text: object) -> datetime | None:
    """The API's time stamp, None for anything else, such as one without its Z."""
    match = _MOMENT.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        return None
    year, month, day, hour, minute = (int(part) for part in match.groups())
    try:
        return datetime(year, month, day, hour, minute, tzinfo=UTC)
    except ValueError:
        return None


def _g_per_kwh(value: object) -> float | None:
    """A believable intensity, None for anything else. JSON's integers have no end: compare, then convert."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= MOST_G_PER_KWH:
        return None
    return abs(float(value))  # -0.0 is 0


def _sorted(values: dict[datetime, float]) -> tuple[Intensity, ...]:
    return tuple(Intensity(start, values[start]) for start in sorted(values))


def _told(dropped: Counter[Dropped]) -> list[str]:
    """ "3 rows with a null forecast", one text a cause, in the order of the table."""
    return [f"{dropped[why]} row{'' if dropped[why] == 1 else 's'} {why}" for why in Dropped if dropped[why]]
