"""The page beside the daemon: opened where it can be, said in one line where it cannot."""

import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from plugd.adapters.hub import state
from plugd.adapters.store import SqliteStore
from plugd.config import token as secret_token
from plugd.cycle import Cycle
from plugd.errors import PlugdError, StoreError
from plugd.ports import Inbox
from plugd.score import LeadScore, scores

if TYPE_CHECKING:
    from plugd.config import Config

log = logging.getLogger("plugd")

WEB_EXTRA = ("jinja2", "prometheus_client", "starlette", "uvicorn")
SCORED = timedelta(days=7)
"""How far back the page looks to say how good forecasts were."""


@contextmanager
def opened_page(config: "Config", folder: Path, cycle: Cycle, connection: Inbox) -> Iterator[Inbox]:
    """The page beside the cycle, and where to wait for messages of both. A page that cannot be is only said."""
    clock, web, book = cycle.clock, config.web, cycle.book
    if not web.enabled or book is None:
        yield connection
        return
    if any(find_spec(name) is None for name in WEB_EXTRA):
        log.info("there is no page: pip install 'plugd[web]' brings it, web.enabled = false ends this line")
        yield connection
        return
    # Only with a page: what it stands on is a third of the daemon's memory.
    from plugd.web.app import Page  # noqa: PLC0415
    from plugd.web.desk import Desk, Letterbox  # noqa: PLC0415
    from plugd.web.server import Server  # noqa: PLC0415

    desk = Desk(cycle.hub, cycle.controller.household, book.known, clock.monotonic)
    token, host = secret_token(config), socket.gethostname().lower()
    page = Page(
        name=config.name,
        desk=desk,
        state=state,
        monotonic=clock.monotonic,
        wake=connection.wake,
        names=frozenset({"localhost", host, f"{host}.local", *(name.lower() for name in web.hosts)}),
        token=token.get_secret_value() if token else None,
        score=partial(_scored, folder),
    )
    try:
        server = Server(page, web.bind)
    except PlugdError as error:
        log.warning("there is no page: %s", error)
        yield connection
        return
    cycle.hub = desk
    server.start()
    try:
        yield Letterbox(connection, desk)
    finally:
        server.close()


def _scored(folder: Path, now: datetime) -> tuple[LeadScore, ...]:
    """How good the forecasts of the last week were, through a connection of its own."""
    try:
        with SqliteStore(folder, hold=False) as store:
            return scores(store.issued(now - SCORED), store.measured(now - SCORED))
    except StoreError as error:
        log.warning("forecasts are not scored: %s", error)
        return ()
