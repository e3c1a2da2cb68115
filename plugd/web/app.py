"""The page's addresses: what is shown comes from the desk's last snapshot, what is set goes to the desk."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import reduce
from importlib.resources import files
from typing import Any
from zlib import crc32

from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.concurrency import run_in_threadpool
from starlette.middleware.exceptions import ExceptionMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route, Router
from starlette.staticfiles import StaticFiles

from plugd import __version__
from plugd.command_words import MAX_BYTES, Refused, parse
from plugd.domain import Answer
from plugd.score import LeadScore
from plugd.units import to_pct
from plugd.web.desk import Desk, Snapshot, State
from plugd.web.gate import TOKEN_HEADER, Gate, same
from plugd.web.view import live, values

PATIENCE_S = 10.0
"""How long a command may wait for the cycle, and a body for its sender."""
STALE_S = 120.0
"""A cycle that has shown nothing for so long hangs."""
SCORED_AGAIN = timedelta(hours=6)
PARTS = ("tiles", "faults", "drawing", "trips", "nights", "scores")
MODES = (("smart", "Smart"), ("now", "Now"), ("off", "Off"))
PLUGGED = (("ON", "Plugged in"), ("OFF", "Away"))
PRESSED = {True: "ON", False: "OFF", None: ""}
"""Which of them is pressed; neither where nobody has said."""


STATIC = files("plugd.web").joinpath("static")
MARK = f"{reduce(lambda mark, file: crc32(file.read_bytes(), mark), sorted(STATIC.iterdir(), key=str), 0):08x}"
"""Changes with any of the static files, which browsers may keep as long as it does not."""


@dataclass(slots=True)
class Page:
    """Everything behind the addresses. Lives in the page's own thread."""

    name: str
    desk: Desk
    state: State
    monotonic: Callable[[], float]
    wake: Callable[[], None]
    """Ends the cycle's wait, so that a command does not wait for it."""
    names: frozenset[str]
    token: str | None = None
    """What writing asks for. None: nobody writes."""
    score: Callable[[datetime], tuple[LeadScore, ...]] = lambda _: ()
    """How good the forecasts were before a moment. Slow: asked for rarely, in a thread of its own."""
    gate: Gate = field(init=False)
    _env: Environment = field(init=False)
    _scores: tuple[LeadScore, ...] = ()
    _scored_at: datetime | None = None
    _scoring: asyncio.Task[None] | None = None
    """Kept: the loop itself holds its tasks only weakly."""
    _drawn: tuple[int, dict[str, Any], dict[str, Any]] | None = None

    def __post_init__(self) -> None:
        self._env = Environment(
            loader=PackageLoader("plugd.web"), autoescape=True, undefined=StrictUndefined, auto_reload=False
        )
        for template in self._env.list_templates():
            self._env.get_template(template)  # compiled now, and not while somebody waits
        routes = [
            Route("/", self.whole),
            Route("/live", self.news),
            Route("/api/state", self.api_state),
            Route("/metrics", self.metrics),
            Route("/healthz", self.healthz),
            Route("/command/{name}", self.command, methods=["POST"]),
            Mount("/static", _Kept(packages=[("plugd.web", "static")])),
        ]
        # Starlette's own application would add what draws tracebacks, for half a MiB.
        self.gate = Gate(ExceptionMiddleware(Router(routes)), self.names)

    # -- reading ----------------------------------------------------------------------------------

    async def whole(self, request: Request) -> Response:
        """The page."""
        self._score()
        seen = self._seen()
        if seen is None:
            return self._html("wait.html", {})
        snapshot, state, view = seen
        car = snapshot.household.car
        more = {
            "soc_min": to_pct(car.soc_min, 0),
            "soc_max": to_pct(car.soc_max, 0),
            "modes": MODES,
            "plugged": PLUGGED,
        }
        more["connected"] = PRESSED[state["connected"]]
        can_write = self.token is not None
        return self._html(
            "page.html", {"v": view, "state": state, "version": snapshot.version, "can_write": can_write, **more}
        )

    async def news(self, request: Request) -> Response:
        """What has changed since a version; nothing where nothing has."""
        self._score()
        seen = self._seen()
        if seen is None or request.query_params.get("v") == str(seen[0].version):
            return Response(status_code=204)
        snapshot, state, view = seen
        parts: Any = self._env.get_template("parts.html").module
        return JSONResponse(
            {
                "version": snapshot.version,
                "status": view["status"],
                "reason": view["reason"],
                "at": view["at"],
                "pressed": {"mode": state["mode"], "connected": PRESSED[state["connected"]]},
                "values": values(state),
                "html": {part: str(getattr(parts, part)(view)) for part in PARTS},
            }
        )

    async def api_state(self, request: Request) -> Response:
        """The state document of the hub."""
        seen = self._seen()
        return JSONResponse(seen[1]) if seen else JSONResponse({"message": "plugd has just started"}, 503)

    async def metrics(self, request: Request) -> Response:
        """For Prometheus."""
        from plugd.web import metrics  # noqa: PLC0415 - 1 MB that most never ask for

        seen = self._seen()
        figures = metrics.Figures(lambda: seen[:2] if seen else None, self.gate.refused)
        return Response(metrics.text(figures), media_type="text/plain; version=0.0.4; charset=utf-8")

    async def healthz(self, request: Request) -> Response:
        """200 while the cycle goes round."""
        snapshot = self.desk.snapshot
        age_s = None if snapshot is None else self.monotonic() - snapshot.at_s
        ok = age_s is not None and age_s < STALE_S
        return JSONResponse({"ok": ok, "age_s": None if age_s is None else round(age_s, 1)}, 200 if ok else 503)

    def _html(self, template: str, values: dict[str, Any]) -> Response:
        words = {"name": self.name, "release": __version__, "mark": MARK, **values}
        return HTMLResponse(self._env.get_template(template).render(words))

    def _seen(self) -> tuple[Snapshot, dict[str, Any], dict[str, Any]] | None:
        """The last snapshot, its state document and its view, drawn once."""
        snapshot = self.desk.snapshot
        if snapshot is None:
            return None
        if self._drawn is None or self._drawn[0] != snapshot.version:
            state = self.state(snapshot.decision, snapshot.reading, snapshot.household)
            self._drawn = snapshot.version, state, live(snapshot, state, self._scores)
        return snapshot, *self._drawn[1:]

    def _score(self) -> None:
        """Have the forecasts scored now and then, beside everything else."""
        snapshot = self.desk.snapshot
        if snapshot is None:
            return
        now = snapshot.decision.at
        if self._scored_at is None or not timedelta(0) <= now - self._scored_at < SCORED_AGAIN:
            self._scored_at = now
            self._scoring = asyncio.create_task(self._scored(now))

    async def _scored(self, now: datetime) -> None:
        self._scores = await run_in_threadpool(self.score, now)
        self._drawn = None

    # -- writing ----------------------------------------------------------------------------------

    async def command(self, request: Request) -> Response:
        """One command, with the payload it has on MQTT. Answered when the cycle has obeyed or refused it."""
        name = request.path_params["name"]
        if self.token is None:
            return self._no(403, "read_only", name, "this page only shows; web.token_file in plugd.toml changes that")
        if not same(self.token, request.headers.get(TOKEN_HEADER)):
            return self._no(401, "token", name, "that is not the token; it stands in the file web.token_file names")
        try:
            payload = await asyncio.wait_for(_body(request), PATIENCE_S)
        except (TimeoutError, ClientDisconnect):
            return self._no(408, "slow", name, "the rest of it never came")
        try:
            wanted = parse(name, payload)
        except Refused as refusal:
            return self._no(400, "command", name, str(refusal))
        answer = self.desk.ask(name, wanted)
        if answer is None:
            return self._no(503, "busy", name, "too many commands wait already; try again in a moment")
        self.wake()
        return await self._answered(name, answer)

    async def _answered(self, name: str, future: "Future[Answer]") -> Response:
        try:
            answer = await asyncio.wait_for(asyncio.wrap_future(future), PATIENCE_S)
        except TimeoutError:
            return self._no(504, "unanswered", name, "plugd is busy and has not answered; look again in a moment")
        status = 200 if answer.ok else 409
        return JSONResponse({"command": answer.command, "ok": answer.ok, "message": answer.message}, status)

    def _no(self, status: int, reason: str, name: str, message: str) -> Response:
        self.gate.refused[reason] += 1
        return JSONResponse({"command": name[:40], "ok": False, "message": message}, status)


async def _body(request: Request) -> bytes:
    """The body, cut where no command is longer."""
    found = bytearray()
    async for chunk in request.stream():
        found += chunk
        if len(found) > MAX_BYTES:
            break
    return bytes(found)


class _Kept(StaticFiles):
    """Files that browsers may keep: their addresses carry the mark."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        """As they are, for a day."""
        response = super().file_response(*args, **kwargs)
        response.headers["Cache-Control"] = "max-age=86400"
        return response
