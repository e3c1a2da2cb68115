"""Questions to an HTTPS server, asked in a thread that nobody has to wait for.

Whatever is silent, slow or endless on the other side (name server, handshake, headers, body) costs whoever asks no
more than they want to wait: the thread is left behind, ends by itself when its time is over, and what it brought by
then may be taken later.
"""

import ipaddress
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from http.client import HTTPException
from urllib.parse import urljoin, urlsplit
from urllib.request import getproxies, proxy_bypass

import urllib3
import urllib3.exceptions as urllib3_errors

from plugd import __version__
from plugd.adapters.bell import Bell
from plugd.adapters.neso_body import error_message, quotable
from plugd.errors import ForecastError, ForecastMalformed, ForecastUnavailable
from plugd.units import iso

MOST_BYTES = 1_000_000
MOST_REDIRECTS = 2
REDIRECTS = (301, 302, 303, 307, 308)
GRACE_S = 0.2
"""A thread whose time is over needs a moment to say why."""

_TRANSPORT = (urllib3_errors.HTTPError, HTTPException, OSError, ValueError)
"""What urllib3 and what lies under it may raise for a question that cannot be asked or answered."""


class Asked(Bell):
    """Some addresses asked one after the other. An inbox: a clock can wait for its end."""

    def __init__(self, urls: Sequence[str], now: datetime, timeout_s: float) -> None:
        """`now`: what time it is here, for what is said of a certificate. All answers together have `timeout_s`."""
        super().__init__()
        self.now = now
        self.bodies: list[bytes] = []
        """The answers that came, in the order of the addresses."""
        self.error: ForecastError | None = None
        """Why the next one did not."""
        self._timeout_s = timeout_s
        self._deadline_s = time.monotonic() + timeout_s
        self._host = host_of(urls[0])
        self._ended = False
        threading.Thread(target=self._ask, args=(urls,), name="neso", daemon=True).start()

    def pending(self) -> bool:
        """Whether it has ended."""
        return self._ended

    def flush(self) -> None:
        """Until it has ended, however long it may take."""
        self._bell.hold(self.pending, max(0.0, self._deadline_s - time.monotonic()) + GRACE_S)

    @property
    def overdue(self) -> bool:
        """Whether its time is over."""
        return time.monotonic() >= self._deadline_s

    def too_slow(self) -> ForecastUnavailable:
        """What to say of one that is overdue."""
        return ForecastUnavailable(f"{self._host} gave no answer within {self._timeout_s:g} s; check the network")

    def _ask(self, urls: Sequence[str]) -> None:
        """The thread's work: the answers, or why there is none."""
        try:
            with _pool(urls[0]) as pool:
                for url in urls:
                    self._next(pool, _Question(url, self._deadline_s, self.now))
                    if self.error is not None:
                        break
        finally:
            self._ended = True
            self._bell.look()

    def _next(self, pool: urllib3.PoolManager, question: "_Question") -> None:
        try:
            self.bodies.append(question.answer(pool))
        except ForecastError as error:
            self.error = error
        except _TRANSPORT as error:
            self.error = question.reason(error)
            self.error.__cause__ = error


def is_loopback(host: str) -> bool:
    """Whether a host is this machine."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _pool(url: str) -> urllib3.PoolManager:
    """Connections to a server: by the proxy that is set for this machine, unless that machine is this one.

    Trusted is whom this machine trusts, so that its certificates are renewed with it.
    """
    headers = {"User-Agent": f"plugd/{__version__}", "Accept": "application/json", "Accept-Encoding": "identity"}
    parts = urlsplit(url)
    host = parts.hostname or ""
    proxy = None if is_loopback(host) or proxy_bypass(host) else getproxies().get(parts.scheme)
    return urllib3.ProxyManager(proxy, headers=headers) if proxy else urllib3.PoolManager(headers=headers)


@dataclass(frozen=True, slots=True)
class _Question:
    """One address asked until a moment of the monotonic clock."""

    url: str
    deadline_s: float
    now: datetime

    def answer(self, pool: urllib3.PoolManager) -> bytes:
        """The body of a 200 answer, after at most two redirects on the same host."""
        url = self.url
        for _ in range(MOST_REDIRECTS + 1):
            left = urllib3.Timeout(total=self._left_s())
            question = pool.request("GET", url, redirect=False, retries=False, preload_content=False, timeout=left)
            with question as response:
                if response.status not in REDIRECTS:
                    return self._body(response)
                url = _next_url(url, response.headers.get("Location", ""))
        raise ForecastUnavailable(f"{host_of(self.url)} redirects without end; check forecast.base_url")

    def reason(self, error: Exception) -> ForecastError:
        """A failure of the connection, in words a person can act on."""
        host = host_of(self.url)
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
            raise ForecastUnavailable(f"{host_of(self.url)} answers too slowly; check the network")
        return left_s

    def _body(self, response: urllib3.BaseHTTPResponse) -> bytes:
        coding = response.headers.get("Content-Encoding", "identity")
        if coding.strip().lower() != "identity":
            raise ForecastMalformed(f"{host_of(self.url)} compressed its answer ({quotable(coding)}) unasked")
        body = bytearray()
        # read1 returns what one read of the socket brings, so that the time is looked at after each.
        while chunk := response.read1(8192, decode_content=False):
            body += chunk
            self._left_s()
            if len(body) > MOST_BYTES:
                raise ForecastMalformed(f"{host_of(self.url)} sent more than 1 MB; that is no forecast")
        if response.status == 200:
            return bytes(body)
        message = error_message(bytes(body)) or quotable(response.reason or "") or "no message"
        status = response.status
        raise ForecastUnavailable(f"NESO answered {status}: {message}; {_remedy(status)}")


_REASONS: tuple[tuple[tuple[type[BaseException], ...], str], ...] = (
    (
        (urllib3_errors.SSLError,),
        "the certificate of {host} was not accepted; the clock here says {now}: set it if that is wrong, "
        "else renew the CA certificates ({why})",
    ),
    ((urllib3_errors.NameResolutionError,), "the name {host} cannot be resolved; check network and DNS"),
    ((ConnectionRefusedError,), "{host} refuses the connection; check forecast.base_url"),
    (
        (urllib3_errors.TimeoutError, TimeoutError),
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
    """An error and what is under it: urllib3 wraps others' in arguments and `reason`."""
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
            f"{host_of(url)} redirects to {quotable(target)!r}, which plugd does not follow; "
            "log in to the network, or check forecast.base_url"
        )
    return target


def _remedy(status: int) -> str:
    return "check home.region_id or home.postcode" if status in (400, 404) else "plugd asks again later"


def host_of(url: str) -> str:
    """The host in an address."""
    return urlsplit(url).hostname or url
