"""A household whose cycle is stepped by the test, with the page in front of it on loopback."""

import http.client
import json
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from plugd.adapters.hub import state
from plugd.book import Book
from plugd.domain import Memory
from plugd.score import LeadScore
from plugd.web.app import Page
from plugd.web.desk import Desk, Letterbox
from plugd.web.server import Server
from tests.unit.deciding import HOME, NIGHT, Room, knows
from tests.unit.test_ledger import Shelf

TOKEN = "an old oak"
SCORE = LeadScore(0, 6, 100, 12.0, -3.0, 8.0)


@dataclass(frozen=True, slots=True)
class Reply:
    """What came back."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def text(self) -> str:
        """The body as text."""
        return self.body.decode()

    @property
    def document(self) -> Any:
        """The body as JSON."""
        return json.loads(self.body)


class Served:
    """A room with a page. A command is obeyed at once: waking the cycle is a step of it."""

    def __init__(
        self, token: str | None = TOKEN, name: str = "ev", start: datetime = NIGHT, memory: Memory | None = None
    ) -> None:
        self.room = Room(start, memory or knows(0.6, start))
        shelf = Shelf()
        book = Book(shelf, HOME)
        self.room.cycle.book = book
        self.desk = Desk(self.room.cycle.hub, HOME, book.known, self.room.clock.monotonic)
        self.room.cycle.hub = self.desk
        self.letterbox = Letterbox(NoLine(), self.desk)
        self.obeys = True
        self.page = Page(
            name=name,
            desk=self.desk,
            state=state,
            monotonic=self.room.clock.monotonic,
            wake=self._woken,
            names=frozenset({"localhost", "plugpi", "plugpi.local"}),
            token=token,
            score=lambda moment: (SCORE,),
        )
        self.server = Server(self.page, "127.0.0.1:0")
        self.host = self.server.address
        self.server.start()

    def _woken(self) -> None:
        if self.obeys:
            self.later(seconds=1)

    def later(self, **span: float) -> None:
        """Time passes, and the cycle looks."""
        self.room.step(self.room.clock.at + timedelta(**span))

    def ask(self, method: str, path: str, body: bytes = b"", **headers: str) -> Reply:
        """One request. Headers are given as `Host`, `Origin`, `X_Plugd_Token`."""
        connection = http.client.HTTPConnection(self.host, timeout=20)
        try:
            connection.putrequest(method, path, skip_host=True)
            given = {"Host": self.host, **{name.replace("_", "-"): value for name, value in headers.items()}}
            if method == "POST":
                given.setdefault("Content-Length", str(len(body)))
            for name, value in given.items():
                connection.putheader(name, value)
            connection.endheaders(body if method == "POST" else None)
            answer = connection.getresponse()
            return Reply(answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read())
        finally:
            connection.close()

    def get(self, path: str = "/", **headers: str) -> Reply:
        """Look."""
        return self.ask("GET", path, b"", **headers)

    def set(self, command: str, payload: str, **headers: str) -> Reply:
        """Set something, with all that it takes."""
        given = {"Origin": f"http://{self.host}", "X_Plugd_Token": TOKEN, **headers}
        return self.ask("POST", f"/command/{command}", payload.encode(), **given)

    def close(self) -> None:
        """End."""
        self.server.close()


class NoLine:
    """An inbox into which nothing comes."""

    def pending(self) -> bool:
        """Never."""
        return False

    def wait(self, timeout_s: float) -> None:
        """At once."""

    def wake(self) -> None:
        """Nobody sleeps."""

    def flush(self) -> None:
        """Nothing to flush."""
