"""The page's server: a thread with a loop of its own, bounded so that nobody can take the machine with it."""

import asyncio
import logging
import os
import socket
import sys
import threading
from typing import Any

import uvicorn
from h11 import LocalProtocolError
from uvicorn.protocols.http.h11_impl import H11Protocol

from plugd.errors import PlugdError
from plugd.web.app import Page

MOST_CONNECTIONS = 64
HEADERS_S = 5.0
"""How long a connection may take for its first question."""
LONGEST_S = 60.0
"""How long it may stay; the browser opens another."""
STOP_S = 5.0
SWITCH_S = 0.0005
"""How long the page's thread may keep the interpreter from the cycle's: a tenth of Python's own 5 ms."""

log = logging.getLogger("plugd.page")


class Bounded(H11Protocol):
    """Closes connections that are too many, that never ask, or that stay too long."""

    def connection_made(self, transport: Any) -> None:
        """Count it, and set its end."""
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS:
            transport.abort()
            return
        self.loop.call_later(HEADERS_S, self._end, transport, True)
        self.loop.call_later(LONGEST_S, self._end, transport, False)

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP. Whoever is about to answer an earlier part of it finds that nobody listens."""
        if self.cycle is not None:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        try:
            super().send_400_response(msg)
        except LocalProtocolError:  # an answer had begun
            self.transport.close()

    def _end(self, transport: Any, if_silent: bool) -> None:
        if not (if_silent and self.cycle is not None):
            transport.close()


def _reason(error: OSError) -> str:
    """Without the address, which `socket` adds to what the system says."""
    return os.strerror(error.errno) if error.errno is not None and error.errno > 0 else str(error)


class Server:
    """Serves a page until closed. `start` returns at once."""

    def __init__(self, page: Page, bind: str) -> None:
        """Raises PlugdError where the address cannot be had."""
        host, _, port = bind.rpartition(":")
        host = host.strip("[]")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._socket = socket.create_server((host, int(port)), family=family, backlog=MOST_CONNECTIONS)
        except OSError as error:
            raise PlugdError(f"{bind}: {_reason(error)}; set web.bind to a free address of this machine") from error
        self.address = f"{host if family == socket.AF_INET else f'[{host}]'}:{self._socket.getsockname()[1]}"
        config = uvicorn.Config(
            page.gate,
            http=Bounded,
            loop="asyncio",
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            timeout_keep_alive=5,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=16 * 1024,
        )
        logging.getLogger("uvicorn").setLevel(logging.WARNING)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def start(self) -> None:
        """Begin."""
        sys.setswitchinterval(SWITCH_S)
        self._thread.start()
        log.info("the page is at http://%s/", self.address)

    def _run(self) -> None:
        asyncio.run(self._server.serve(sockets=[self._socket]))

    def close(self) -> None:
        """End; open connections are cut after a second."""
        self._server.should_exit = True
        self._thread.join(STOP_S)
        self._socket.close()
