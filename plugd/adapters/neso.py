"""The NESO Carbon Intensity API: the forecast, what was measured of the last day, and the past in pages.

Every question is asked in a thread of its own (`neso_line.py`). The daemon waits a moment for the answer and else
comes back for it; commands on a terminal wait until there is none to come.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from urllib.parse import urlsplit

from plugd.adapters.neso_body import NATIONAL, parse, parse_past, quotable
from plugd.adapters.neso_line import Asked, is_loopback
from plugd.domain import Forecast, Intensity, PastRow
from plugd.errors import ConfigError, ForecastError, ForecastLate, ForecastUnavailable
from plugd.ports import Inbox
from plugd.units import slot_start

REGION_IDS = range(1, 18)
MEASURED = timedelta(hours=26)
"""How far back it is asked what was measured: values are revised for a day."""
Wait = Callable[[Inbox], None]


def to_the_end(inbox: Inbox) -> None:
    """However long it takes: the question has its own end."""
    inbox.flush()


_POSTCODE = re.compile(r"([A-Z]{1,2}[0-9][0-9A-Z]?)\s*([0-9][A-Z]{2})?")


class Neso:
    """National forecast, or a region's by id, or a postcode's. Prefer the id: the API's postcode map errs."""

    def __init__(
        self,
        base_url: str,
        region_id: int | None,
        postcode: str | None,
        timeout_s: float = 10.0,
        wait: Wait = to_the_end,
    ) -> None:
        """`wait` for an answer, as long as the caller can; one not there by then is ForecastLate.

        Raises ConfigError for an address that is not https, a region outside 1..17, or no postcode.
        """
        self._base_url = _checked_url(base_url)
        self._timeout_s = timeout_s
        self._wait = wait
        self._asked: dict[str, tuple[tuple[str, ...], Asked]] = {}
        """What is under way, by kind: what was asked, and the thread."""
        if region_id is not None:
            if region_id not in REGION_IDS:
                raise ConfigError(f"home.region_id is {region_id}; NESO's regions are 1 to 17")
            self._region = str(region_id)
            self._question = f"/regional/intensity/{{}}/{{}}/regionid/{region_id}"
        elif postcode is not None:
            self._region = outward(postcode)
            self._question = f"/regional/intensity/{{}}/{{}}/postcode/{self._region}"
        else:
            self._region, self._question = NATIONAL, "/intensity/{}/{}"

    @property
    def region(self) -> str:
        """What its forecasts call their region."""
        return self._region

    @property
    def measures(self) -> bool:
        """Whether it tells what was measured: of the nation, for nobody measures a region."""
        return self._region == NATIONAL

    def fetch(self, now: datetime) -> Forecast:
        """The forecast from the half hour under way on, and what was measured of the day before.

        Raises ForecastLate, ForecastUnavailable, ForecastMalformed. A later call gets the answer that was late.
        """
        urls = [self._url(slot_start(now), "fw48h")]
        if self.measures:
            urls.append(self._url(slot_start(now) - MEASURED, slot_start(now)))
        asked = self._ended("forecast", tuple(urls), now, again=True)
        if not asked.bodies:
            raise asked.error or _without_outcome()
        forecast = parse(asked.bodies[0], asked.now, self._region)
        return _with_measured(forecast, asked) if self.measures else forecast

    def past(self, start: datetime, end: datetime) -> tuple[PastRow, ...]:
        """What the API tells of [start, end), at most `plugd.past.PAGE`.

        Raises ForecastLate, ForecastUnavailable, ForecastMalformed. A later call gets the answer that was late.
        """
        asked = self._ended("past", (self._url(start, end),), end)
        if not asked.bodies:
            raise asked.error or _without_outcome()
        return parse_past(asked.bodies[0], start, end, self._region)

    def _url(self, start: datetime, end: datetime | str) -> str:
        return self._base_url + self._question.format(_stamp(start), end if isinstance(end, str) else _stamp(end))

    def _ended(self, kind: str, urls: tuple[str, ...], now: datetime, again: bool = False) -> Asked:
        """The answers to a question, asked now or before; `again`: to whatever was asked of this kind."""
        before = self._asked.pop(kind, None)
        other = before is not None and not again and before[0] != urls
        if before is not None and other and before[1].pending():
            before = None
        kept = before or (urls, Asked(urls, now, self._timeout_s))
        asked = kept[1]
        if not asked.overdue:
            self._wait(asked)
        if asked.pending() and not (before and other):
            return asked
        self._asked[kind] = kept
        if not asked.overdue:
            raise ForecastLate("NESO has not answered yet")
        if before is None:
            raise asked.too_slow()
        raise ForecastUnavailable("an earlier question to NESO still hangs; check network and DNS")


def _with_measured(forecast: Forecast, asked: Asked) -> Forecast:
    """The forecast beside what was measured, or a word on why that is missing."""
    first, end = slot_start(asked.now) - MEASURED, slot_start(asked.now)
    try:
        if asked.error is not None:
            raise asked.error
        rows = parse_past(asked.bodies[1], first, end, forecast.region)
    except ForecastError as error:
        return replace(forecast, dropped=(*forecast.dropped, f"what was measured: {error}"))
    known = {value.start: value for value in forecast.actual}
    known |= {row.start: Intensity(row.start, row.actual) for row in rows if row.actual is not None}
    return replace(forecast, actual=tuple(known[start] for start in sorted(known)))


def _without_outcome() -> RuntimeError:
    return RuntimeError("the question to NESO ended without an outcome; the lines above say why")


def _stamp(moment: datetime) -> str:
    return f"{moment:%Y-%m-%dT%H:%MZ}"


def outward(postcode: str) -> str:
    """The outward part of a postcode ("SW1A 1AA" gives "SW1A"): the API knows nothing longer."""
    match = _POSTCODE.fullmatch(postcode.strip().upper())
    if match is None:
        raise ConfigError(f"home.postcode is {quotable(postcode)!r}; give its first half, like SW1")
    return match[1]


def _checked_url(base_url: str) -> str:
    """The base address without a trailing slash: https, or plain http to this machine (the stub)."""
    try:
        parts = urlsplit(base_url.strip())
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise ConfigError(f"forecast.base_url is {quotable(base_url)!r}, not an address ({error})") from error
    if not host or parts.query or parts.fragment or parts.username:
        raise ConfigError(f"forecast.base_url is {quotable(base_url)!r}; it needs the form https://HOST")
    if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(host)):
        raise ConfigError(f"forecast.base_url is {quotable(base_url)!r}; it must begin with https://")
    return base_url.strip().rstrip("/")
