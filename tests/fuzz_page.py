"""Bytes at the page's socket: requests that are nearly right, requests that are not, and noise.

Always an answer or a closed connection, never an exception in the server, and nothing set without token and origin.
"""

import logging
import random
import select
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field

from tests.fuzz_words import Count
from tests.web.serving import TOKEN, Served

PATIENCE_S = 20.0
ANSWER_S = 0.01
"""So long it is waited for an answer before the sender says that nothing more will come."""
LOOK_EVERY, ENOUGH = 200, 400

READS = ("/", "/live?since=0", "/live", "/api/state", "/metrics", "/healthz", "/static/page.css", "/static/../app.py")
HEADERS = (
    "Connection: close", "Connection: keep-alive", "Connection: Upgrade\r\nUpgrade: websocket", "Expect: 100-continue",
    "Transfer-Encoding: chunked", "Transfer-Encoding: identity, chunked", "Content-Length: 0", "Content-Length: -1",
    "Content-Length: 99999999999999999999", "Content-Length: 4\r\nContent-Length: 5", "Accept-Encoding: gzip",
    "Range: bytes=0-,5-2,-9", "If-None-Match: *", "If-Modified-Since: Thu, 99 Foo 2023 99:99:99 GMT", "Cookie: a=b",
    "X-Forwarded-For: 127.0.0.1", "Content-Type: multipart/form-data", f"X-Long: {'y' * 20000}", "X-\x00: \x00", ": x",
    "Host: evil.example", "Origin: null", "Authorization: Basic Og==", "X-Plugd-Token: \udcff", "X-Plugd-Token: ",
)  # fmt: skip
COMMANDS = (
    ("mode", "off"), ("soc", "55"), ("minimum", "70"), ("trip", '{"date": "2023-01-09", "minimum_pct": 60}'),
    ("week", '{"sat": {"away": true}}'), ("ready_by", "07:30"), ("replan", "PRESS"), ("nothing", "x"),
    ("%00", "\x00"), ("../mode", "off"),
)  # fmt: skip


@dataclass(slots=True)
class Ears(logging.Handler):
    """What the server logs with a traceback."""

    heard: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        logging.Handler.__init__(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Remember it."""
        if record.exc_info or record.levelno >= logging.ERROR:
            self.heard.append(f"{record.name}: {self.format(record)}")

    __hash__ = object.__hash__


@contextmanager
def listening() -> Iterator[Ears]:
    """To every logger of the server's."""
    ears, loggers = Ears(), [logging.getLogger(name) for name in ("", "uvicorn", "uvicorn.error", "asyncio")]
    for logger in loggers:
        logger.addHandler(ears)
    try:
        yield ears
    finally:
        for logger in loggers:
            logger.removeHandler(ears)


def request(dice: random.Random, host: str, may: bool) -> bytes:
    """One that is nearly right. Unless it `may`, either the token or the origin is wrong."""
    method, path, body = "GET", dice.choice(READS), ""
    headers = [f"Host: {dice.choice((host, host, host, 'localhost', 'evil.example'))}"]
    if dice.random() < 0.5:
        method = "POST"
        name, body = dice.choice(COMMANDS)
        path = f"/command/{name}"
        ours, knows = (True, True) if may else dice.choice(((True, False), (False, True), (False, False)))
        headers += [f"Origin: {f'http://{host}' if ours else dice.choice(('http://evil.example', 'null', ''))}"]
        headers += [f"X-Plugd-Token: {TOKEN if knows else dice.choice(('', TOKEN.upper(), 'open sesame'))}"]
        headers += [f"Content-Length: {len(body)}"]
    if dice.random() < 0.2:
        method = dice.choice(("HEAD", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "get", "PRI", "\x00"))
    if dice.random() < 0.2:
        path = dice.choice(("*", "//", "/%", "/%ff%00", f"http://{host}/", "/" + "a" * 9000, "/live?since=\udcff", ""))
    headers += dice.sample(HEADERS, dice.randrange(3)) if dice.random() < 0.5 else []
    dice.shuffle(headers)
    version = dice.choice(("HTTP/1.1",) * 6 + ("HTTP/1.0", "HTTP/2.0", "HTTP/9", ""))
    text = "\r\n".join([f"{method} {path} {version}", *headers, "", body])
    return text.encode("utf-8", "surrogateescape")


def thrown(dice: random.Random, host: str, may: bool) -> bytes:
    """A request, one with bytes changed, several at once, or noise."""
    kind = dice.random()
    if kind < 0.05:
        return dice.randbytes(dice.randrange(1, 3000))
    sent = bytearray(b"".join(request(dice, host, may) for _ in range(dice.choice((1, 1, 1, 1, 3)))))
    if kind < 0.6:
        for _ in range(dice.randrange(1, 5)):
            at = dice.randrange(len(sent))
            sent[at : at + dice.randrange(3)] = dice.randbytes(dice.randrange(3))
        if dice.random() < 0.2:
            del sent[dice.randrange(len(sent)) :]
    return bytes(sent) or b"\r"


def _heard(address: tuple[str, int], sent: bytes) -> bytes:
    """All that came back until the server closed. Raises AssertionError where it never does."""
    with socket.create_connection(address, PATIENCE_S) as line:
        answer = b""
        try:
            line.sendall(sent)
            if select.select([line], [], [], ANSWER_S)[0]:
                answer = line.recv(65536)
            line.shutdown(socket.SHUT_WR)
            while more := line.recv(65536):
                answer += more
        except TimeoutError:
            raise AssertionError(f"neither an answer nor an end after {sent!r}") from None
        except OSError:
            pass  # closed, with bytes of ours unread
        return answer


class Watched(Served):
    """A page of which it is known how often something was set."""

    def __init__(self) -> None:
        self.times_set = 0
        super().__init__()

    def _woken(self) -> None:
        self.times_set += 1
        super()._woken()


def throw_requests(dice: random.Random, inputs: int) -> Count:
    """Throw them at a page with a token. `taken` are those answered with 200."""
    count, served = Count(), Watched()
    host, port = served.host.rsplit(":", 1)
    served.later(seconds=1)
    with listening() as ears, closing(served):
        for number in range(inputs):
            may = number >= inputs // 2
            sent = thrown(dice, served.host, may)
            answer = _heard((host, int(port)), sent)
            count.tried += 1
            good = answer.startswith(b"HTTP/1.1 2")
            count.taken += good
            count.refused += not good
            if served.times_set and not may:
                raise AssertionError(f"something was set, by {sent!r} or one before it")
            if ears.heard or b"Traceback" in answer:
                raise AssertionError(f"{ears.heard or answer!r} after {sent!r}")
            if number % LOOK_EVERY == 0 and served.get("/").status != 200:
                raise AssertionError(f"the page is gone after {sent!r}")
    if inputs >= ENOUGH and not served.times_set:
        raise AssertionError("nothing was ever set, by those that may neither")
    return count
