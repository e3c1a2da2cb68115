"""A stub of the NESO Carbon Intensity API: the real one's paths and shapes over HTTP, on this machine only.

As a program it prints its port on one line, `{"port": 40123}`, and serves until it is told to end.
"""

import argparse
import json
import signal
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import TCPServer
from typing import Any

from plugd.errors import UsageError
from plugd.units import iso, require_utc, slot_start
from plugd_hil.conductor import Line, address
from plugd_hil.neso_answers import Refused, answer_to
from plugd_hil.neso_faults import CONTENT, LINE, NAMES, OUTAGE, Answer, send
from plugd_hil.neso_source import SeriesSource, Shifted, Source, from_file, from_folder, shift_to
from plugd_hil.script import Script
from plugd_hil.synthetic import synthetic_year

LOOPBACK = "127.0.0.1"


class StubNeso(ThreadingHTTPServer):
    """The running server. `asked` lists the paths asked for; `fault` may be changed at any time."""

    daemon_threads = True

    def __init__(self, source: Source, now: Callable[[], datetime], port: int, fault: str | None) -> None:
        super().__init__((LOOPBACK, port), Handler)
        self.source = source
        self.now = now
        self.fault = fault
        self.asked: list[str] = []
        self.ended = threading.Event()
        self.script = Script([])

    def server_bind(self) -> None:
        """Without the parent's look-up of this machine's name, which may take seconds."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = LOOPBACK, int(self.server_address[1])

    @property
    def port(self) -> int:
        """Where it listens."""
        return self.server_port

    @property
    def url(self) -> str:
        """What to configure as base_url."""
        return f"http://{LOOPBACK}:{self.port}"

    def follow(self) -> None:
        """Do wrong what the script says by now; `none` is nothing."""
        for order in self.script.take(self.now()):
            self.fault = None if order == "none" else order

    def handle_error(self, request: object, client_address: object) -> None:
        """A client that hangs up early is none of ours; anything else is printed."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]

    def close(self) -> None:
        """End, the silent and dripping answers too."""
        self.ended.set()
        self.shutdown()
        self.server_close()


def serve(source: Source, now: Callable[[], datetime], port: int = 0, fault: str | None = None) -> StubNeso:
    """Start the server in the background, on loopback; end it with `close`. `now`: the time it lives in."""
    server = StubNeso(source, now, port, fault)
    run = partial(server.serve_forever, poll_interval=0.05)
    threading.Thread(target=run, name="stub neso", daemon=True).start()
    return server


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    protocol_version = "HTTP/1.1"
    server: StubNeso

    def do_GET(self) -> None:
        """Answer, or misbehave."""
        server = self.server
        server.asked.append(self.path)
        server.follow()
        status, answer = 200, Answer()
        try:
            path = self.path.partition("?")[0]
            answer = answer_to(path, server.source, server.now(), server.fault == "boundary")
        except Refused as refused:
            status, answer = 400, {"error": {"code": "400 Bad Request", "message": str(refused)}}
        if server.fault == "500":
            status, answer = 500, OUTAGE
        if server.fault in CONTENT:
            answer = CONTENT[server.fault](answer)
        body = json.dumps(answer, separators=(",", ":")).encode()
        if server.fault in LINE:
            LINE[server.fault](self, body, server.ended)
        else:
            send(self, body, status)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the parent's name
        """Quiet."""


# -- the program ----------------------------------------------------------------------------------


def asking(host: str, port: int) -> Callable[[], datetime]:
    """The time, asked from a simulated clock."""
    line, one_at_a_time = Line(socket.create_connection((host, port))), threading.Lock()

    def now() -> datetime:
        with one_at_a_time:
            line.send(ask="now")
            return require_utc(datetime.fromisoformat(line.receive()["now"]))

    return now


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until SIGTERM or SIGINT. Returns the exit status."""
    options = _parser().parse_args(arguments)
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    try:
        now, source = _set_up(options)
    except (UsageError, ValueError, OSError) as error:
        print(f"stub NESO server: {error}", file=sys.stderr)
        return 2
    server = serve(source, now, options.port, options.fault)
    server.script = Script.read(options.faults, "neso", now(), options.timezone)
    print(json.dumps({"port": server.port}), flush=True)
    signal.sigwait({signal.SIGTERM, signal.SIGINT})
    server.close()
    return 0


def _set_up(options: argparse.Namespace) -> tuple[Callable[[], datetime], Source]:
    source: Source
    if options.replay is not None:
        source = from_folder(options.replay)
    elif options.source == "synthetic":
        source = SeriesSource({None: synthetic_year(options.seed)}, options.seed)
    else:
        source = from_file(Path(options.source), options.seed)
    if options.clock is not None:
        return asking(*address(options.clock)), source
    now = partial(datetime.now, UTC)
    at = now()
    if options.as_of == "now":
        shift = shift_to(source.span(), at)
    else:
        shift = slot_start(at) - slot_start(datetime.fromisoformat(options.as_of))
    made = options.source == "synthetic" and options.replay is None
    what = "synthetic, not measured" if made else "recorded"
    print(f"stub NESO server: {what}; now counts as {iso(at - shift)}", file=sys.stderr)
    return now, Shifted(source, shift)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m plugd_hil.neso", description=__doc__)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--source", default="synthetic", help="a CSV of intensities, or `synthetic`")
    what.add_argument("--replay", type=Path, help="a folder of recorded forecasts")
    parser.add_argument("--seed", type=int, default=0, help="of the forecast errors, and of the synthetic year")
    parser.add_argument("--port", type=int, default=0, help="0: any free one")
    parser.add_argument("--as-of", default="now", help="`now`: moved by whole weeks; or what time now stands for")
    parser.add_argument("--clock", metavar="HOST:PORT", help="a simulated clock to ask, not this machine's")
    parser.add_argument("--faults", type=Path, metavar="FILE", help="a scenario: what goes wrong, and when")
    parser.add_argument("--timezone", default="Europe/London", help="of the times in it")
    parser.add_argument("--fault", choices=NAMES, help="what to do wrong")
    return parser


if __name__ == "__main__":
    sys.exit(main())
