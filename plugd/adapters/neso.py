"""The NESO Carbon Intensity API as a ForecastSource.

One question, one answer, in `timeout_s` altogether: whatever is silent, slow or endless on the other side
(name server, handshake, headers, body) costs no more, because the question is asked in a thread of its own
that is left behind when the time is over. It ends by itself, and no second one is started beside it.
"""

import ipaddress
import re
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from http.client import HTTPException
from urllib.parse import urljoin, urlsplit

import requests
import urllib3.exceptions as urllib3_errors

from plugd import __version__
from plugd.adapters.neso_body import NATIONAL, PastRow, error_message, parse, parse_past, quotable
from plugd.domain import Forecast, Intensity
from plugd.errors import ConfigError, ForecastError, ForecastMalformed, ForecastUnavailable
from plugd.units import iso, slot_start

MOST_BYTES = 1_000_000
MOST_REDIRECTS = 2
REDIRECTS = (301, 302, 303, 307, 308)
REGION_IDS = range(1, 18)
LONGEST = timedelta(days=14)
"""The API answers no longer question about the past."""

_POSTCODE = re.compile(r"([A-Z]{1,2}[0-9][0-9A-Z]?)\s*([0-9][A-Z]{2})?")
_TRANSPORT = (requests.RequestException, urllib3_errors.HTTPError, HTTPException, OSError, ValueError)
"""What requests and what lies under it may raise for a question that cannot be asked or answered."""


@dataclass(slots=True)
class _Outcome:
    """What the asking thread leaves behind. Neither: it was ended by a mistake of ours."""

    body: bytes | None = None
    error: ForecastError | None = None


class Neso:
    """National forecast, or a region's by id, or a postcode's. Prefer the id: the API's postcode map errs."""

    def __init__(self, base_url: str, region_id: int | None, postcode: str | None, timeout_s: float = 10.0) -> None:
        """Raises ConfigError for an address that is not https, a region outside 1..17, or no postcode."""
        self._base_url = _checked_url(base_url)
        self._timeout_s = timeout_s
        self._asking: threading.Thread | None = None
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

    def fetch(self, now: datetime) -> Forecast:
        """The forecast from the half hour under way on. Raises ForecastUnavailable, ForecastMalformed."""
        question = self._question.format(_stamp(slot_start(now)), "fw48h")
        return parse(self._ask(self._base_url + question, now), now, self._region)

    def past(self, start: datetime, end: datetime) -> tuple[PastRow, ...]:
        """What the API tells of [start, end), at most `LONGEST`. Raises ForecastUnavailable, ForecastMalformed."""
        question = self._question.format(_stamp(start), _stamp(end))
        return parse_past(self._ask(self._base_url + question, end), start, end, self._region)

    def measured(self, start: datetime, end: datetime) -> tuple[Intensity, ...]:
        """What was measured in [start, end), at most 14 days: of the nation, for nobody measures a region.

        Raises ForecastUnavailable, ForecastMalformed.
        """
        if self._region != NATIONAL:
            return ()
        return tuple(Intensity(row.start, row.actual) for row in self.past(start, end) if row.actual is not None)

    def _ask(self, url: str, now: datetime) -> bytes:
        if self._asking is not None and self._asking.is_alive():
            raise ForecastUnavailable("an earlier question to NESO still hangs; check network and DNS")
        outcome = _Outcome()
        question = _Question(url, time.monotonic() + self._timeout_s, now)
        self._asking = threading.Thread(target=_keep, args=(question, outcome), name="neso", daemon=True)
        self._asking.start()
        self._asking.join(self._timeout_s)
        if outcome.error is not None:
            raise outcome.error
        if outcome.body is not None:
            return outcome.body
        if self._asking.is_alive():
            raise _too_slow(url, self._timeout_s)
        raise RuntimeError("the question to NESO ended without an outcome; the lines above say why")


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
    if parts.scheme != "https" and not (parts.scheme == "http" and _is_loopback(host)):
        raise ConfigError(f"forecast.base_url is {quotable(base_url)!r}; it must begin with https://")
    return base_url.strip().rstrip("/")


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _keep(question: "_Question", outcome: _Outcome) -> None:
    """The thread's work: the answer, or why there is none, into `outcome`."""
    try:
        outcome.body = question.answer()
    except ForecastError as error:
        outcome.error = error
    except _TRANSPORT as error:
        outcome.error = question.reason(error)
        outcome.error.__cause__ = error


@dataclass(frozen=True, slots=True)
class _Question:
    """One address asked until a moment of the monotonic clock."""

    url: str
    deadline_s: float
    now: datetime

    def answer(self) -> bytes:
        """The body of a 200 answer, after at most two redirects on the same host."""
        with requests.Session() as session:
            # A proxy set for the rest of the machine has no business between two programs on it.
            session.trust_env = not _is_loopback(urlsplit(self.url).hostname or "")
            session.headers.update({"User-Agent": f"plugd/{__version__}", "Accept": "application/json"})
            session.headers["Accept-Encoding"] = "identity"
            url = self.url
            for _ in range(MOST_REDIRECTS + 1):
                with session.get(url, stream=True, allow_redirects=False, timeout=self._left_s()) as response:
                    if response.status_code not in REDIRECTS:
                        return self._body(response)
                    url = _next_url(url, response.headers.get("Location", ""))
        raise ForecastUnavailable(f"{_host(self.url)} redirects without end; check forecast.base_url")

    def reason(self, error: Exception) -> ForecastError:
        """A failure of the connection, in words a person can act on."""
        host = _host(self.url)
        causes = tuple(_causes(error))
        for kinds, text in _REASONS:
            found = next((cause for cause in causes if isinstance(cause, kinds)), None)
            if found is not None:
                why = quotable(str(found))
                return ForecastUnavailable(text.format(host=host, why=why, now=iso(self.now)))
        return ForecastUnavailable(f"asking {host} failed ({quotable(str(error))}); check the network")

    def _left_s(self) -> float:
        left_s = self.deadline_s - time.monotonic()
        if left_s <= 0.0:
            raise ForecastUnavailable(f"{_host(self.url)} answers too slowly; check the network")
        return left_s

    def _body(self, response: requests.Response) -> bytes:
        coding = response.headers.get("Content-Encoding", "identity")
        if coding.strip().lower() != "identity":
            raise ForecastMalformed(f"{_host(self.url)} compressed its answer ({quotable(coding)}) unasked")
        body = bytearray()
        # read1 returns what one read of the socket brings, so that the time is looked at after each.
        while chunk := response.raw.read1(8192, decode_content=False):
            body += chunk
            self._left_s()
            if len(body) > MOST_BYTES:
                raise ForecastMalformed(f"{_host(self.url)} sent more than 1 MB; that is no forecast")
        if response.status_code == 200:
            return bytes(body)
        message = error_message(bytes(body)) or quotable(response.reason or "") or "no message"
        status = response.status_code
        raise ForecastUnavailable(f"NESO answered {status}: {message}; {_remedy(status)}")


_REASONS: tuple[tuple[tuple[type[BaseException], ...], str], ...] = (
    (
        (requests.exceptions.SSLError, urllib3_errors.SSLError),
        "the certificate of {host} was not accepted; the clock here says {now}: set it if that is wrong, "
        "else renew the CA certificates ({why})",
    ),
    ((urllib3_errors.NameResolutionError,), "the name {host} cannot be resolved; check network and DNS"),
    ((ConnectionRefusedError,), "{host} refuses the connection; check forecast.base_url"),
    (
        (requests.Timeout, urllib3_errors.TimeoutError, TimeoutError),
        "{host} does not answer in time; check the network",
    ),
    (
        (urllib3_errors.ProtocolError, HTTPException, ConnectionError),
        "{host} broke off its answer ({why}); plugd asks again later",
    ),
    ((OSError,), "{host} cannot be reached ({why}); check the network"),
)
"""First match counts, each looked for in the whole chain of causes."""


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """An error and what is under it: requests and urllib3 wrap each other's in arguments and `reason`."""
    seen: list[BaseException] = []
    waiting = [error]
    while waiting:
        cause = waiting.pop(0)
        if cause is None or any(cause is known for known in seen):
            continue
        seen.append(cause)
        yield cause
        inner = [*cause.args, getattr(cause, "reason", None), cause.__cause__, cause.__context__]
        waiting += [item for item in inner if isinstance(item, BaseException)]


def _next_url(url: str, location: str) -> str:
    """Where a redirect leads. Raises ForecastUnavailable where that is another host or scheme."""
    target = urljoin(url, location)
    here, there = urlsplit(url), urlsplit(target)
    if not location or (here.scheme, here.netloc) != (there.scheme, there.netloc):
        raise ForecastUnavailable(
            f"{_host(url)} redirects to {quotable(target)!r}, which plugd does not follow; "
            "log in to the network, or check forecast.base_url"
        )
    return target


def _remedy(status: int) -> str:
    return "check home.region_id or home.postcode" if status in (400, 404) else "plugd asks again later"


def _host(url: str) -> str:
    return urlsplit(url).hostname or url


def _too_slow(url: str, timeout_s: float) -> ForecastUnavailable:
    return ForecastUnavailable(f"{_host(url)} gave no answer within {timeout_s:g} s; check the network")
