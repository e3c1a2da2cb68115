"""Simulated time for several programs at once: the conductor gives the turn to one at a time.

A participant runs only while it has the turn, and gives it back inside `Clock.wait`, saying when it is next due and
whether it did anything. When everybody in turn had nothing to do, nothing is under way anywhere, and time jumps to
the earliest moment that anybody asked for. So the same run gives the same bytes, as fast as the programs can go.

The wire: one JSON document a line over TCP on loopback.
  participant  {"name": "plug"}                                 once
  conductor    {"now": "..."}                                   its answer
  participant  {"until": "...", "active": true}                 the turn, given back
  conductor    {"now": "...", "call": false}                    the turn; with `call`, return from the wait whatever
  anybody      {"ask": "now"}  ->  {"now": "..."}               for those who only need the time
"""

import json
import socket
import socketserver
import threading
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any

from plugd.ports import Inbox

PATIENCE_S = 120.0
"""A participant that keeps the turn this long in real time hangs."""
AT_ONCE = 20
"""After so many calls in vain time passes for who is to end."""
LOOK_S = 0.2
"""How often `gather` looks up while it waits."""
FAR = datetime.max.replace(tzinfo=UTC) - timedelta(days=2)


class Line:
    """One JSON document a line, both ways."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection
        self._reader = connection.makefile("rb")

    def send(self, **document: Any) -> None:
        """Say something."""
        self._socket.sendall(json.dumps(document).encode() + b"\n")

    def lose_patience(self, after_s: float) -> None:
        """From now on `receive` raises TimeoutError when the other side says nothing for so long."""
        self._socket.settimeout(after_s)

    def receive(self) -> dict[str, Any]:
        """What the other side says. Raises ConnectionError when it is gone."""
        line = self._reader.readline()
        if not line:
            raise ConnectionError("the other side of the simulated clock is gone")
        document: dict[str, Any] = json.loads(line)
        return document

    def close(self) -> None:
        """Hang up."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # whoever reads on it, here or there, is told
        self._reader.close()
        self._socket.close()


def address(text: str) -> tuple[str, int]:
    """HOST:PORT; without a host it is this machine."""
    host, _, port = text.rpartition(":")
    return host or "127.0.0.1", int(port)


class Participant:
    """`plugd.ports.Clock` on the conductor's time."""

    def __init__(self, host: str, port: int, name: str, look_s: float | None = None) -> None:
        """With `look_s` no wait is longer, as on the real clock: what has fallen silent is noticed by looking."""
        self._look = None if look_s is None else timedelta(seconds=look_s)
        self._line = Line(socket.create_connection((host, port), timeout=None))
        self._line.send(name=name)
        self._now = datetime.fromisoformat(self._line.receive()["now"])
        self._start = self._now
        self._active = True

    def now(self) -> datetime:
        """Simulated time, aware UTC."""
        return self._now

    def monotonic(self) -> float:
        """Simulated seconds since the start: this world's clock never steps."""
        return (self._now - self._start).total_seconds()

    def wait(self, until: datetime, woken_by: Inbox | None = None) -> None:
        """Give the turn back; return with it when due, when a message is here, or when called."""
        until = until if self._look is None else min(until, self._now + self._look)
        while True:
            if woken_by is not None:
                woken_by.flush()
                if woken_by.pending():
                    self._active = True
                    return
            self._line.send(until=until.isoformat(), active=self._active)
            self._active = False
            turn = self._line.receive()
            self._now = datetime.fromisoformat(turn["now"])
            if turn["call"] or self._now >= until:
                self._active = True
                return

    def close(self) -> None:
        """Leave."""
        self._line.close()


class _Seat:
    """What the conductor knows of one participant."""

    def __init__(self, name: str, line: Line) -> None:
        self.name = name
        self.line = line
        self.until = FAR
        self.gone = False
        self.hung = False


class Conductor:
    """The simulated clock's other side. `run_until` moves time; everybody named takes part."""

    def __init__(self, start: datetime, names: tuple[str, ...], patience_s: float = PATIENCE_S) -> None:
        self.now = start
        self._patience_s = patience_s
        self._names = names
        self._seats: dict[str, _Seat] = {}
        self._arrived = threading.Condition()
        conductor = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                line = Line(self.request)
                with suppress(ConnectionError, OSError, ValueError):
                    conductor._greet(line)
                line.close()

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = False  # closing waits for them
            allow_reuse_address = True

        self._server = Server(("127.0.0.1", 0), Handler)
        self._closing = threading.Event()
        threading.Thread(target=self._server.serve_forever, name="conductor", daemon=True).start()

    @property
    def port(self) -> int:
        """Where participants call."""
        return int(self._server.server_address[1])

    def _greet(self, line: Line) -> None:
        """A participant takes its seat; anybody else may ask the time for as long as they like."""
        while True:
            said = line.receive()
            line.send(now=self.now.isoformat())
            if "name" in said:
                line.lose_patience(self._patience_s)
                with self._arrived:
                    self._seats[said["name"]] = _Seat(said["name"], line)
                    self._arrived.notify_all()
                self._closing.wait()
                return

    def gather(self, patience_s: float | None = None, look: Callable[[], None] = lambda: None) -> None:
        """Wait until everybody is here and waits. Raises TimeoutError naming who is missing.

        `look` is called now and then meanwhile; what it raises ends the wait.
        """
        left_s = self._patience_s if patience_s is None else patience_s
        with self._arrived:
            while not self._arrived.wait_for(lambda: set(self._names) <= set(self._seats), min(left_s, LOOK_S)):
                look()
                left_s -= LOOK_S
                if left_s <= 0.0:
                    missing = sorted(set(self._names) - set(self._seats))
                    raise TimeoutError(f"not started: {', '.join(missing)}")
        for name in self._names:
            self._listen(self._seats[name])

    def part(self, name: str) -> None:
        """Go on without one that has ended; `gather` waits for it again after `join`."""
        self._names = tuple(other for other in self._names if other != name)
        with self._arrived:
            self._seats.pop(name, None)

    def join(self, name: str, look: Callable[[], None] = lambda: None) -> None:
        """Wait until one more, or one that is back, is here and waits. Raises TimeoutError."""
        before, self._names = self._names, (name,)
        self.gather(look=look)
        self._names = (*before, name)

    def _listen(self, seat: _Seat) -> bool:
        """Until the participant gives the turn back. Returns whether it did anything."""
        try:
            said = seat.line.receive()
        except OSError as error:
            seat.gone, seat.hung = True, isinstance(error, TimeoutError)
            seat.until = FAR
            return False
        seat.until = datetime.fromisoformat(said["until"])
        return bool(said["active"])

    def _turn(self, seat: _Seat, call: bool = False) -> bool:
        """Give the turn. Returns whether it was used."""
        if seat.gone:
            return False
        try:
            seat.line.send(now=self.now.isoformat(), call=call)
        except OSError:
            seat.gone = True
            return False
        return self._listen(seat)

    def settle(self) -> None:
        """Turns all round until nobody has anything left to do at this moment."""
        idle = 0
        while idle < len(self._names):
            for name in self._names:
                idle = 0 if self._turn(self._seats[name]) else idle + 1
                if idle >= len(self._names):
                    break

    def run_until(self, end: datetime, progress: Callable[[datetime], None] = lambda _: None) -> None:
        """Move time to `end`. Raises ConnectionError when a participant has died, TimeoutError when it hangs."""
        while self.now < end:
            self.settle()
            self._all_here()
            self.now = min(end, *(max(self.now, self._seats[name].until) for name in self._names))
            progress(self.now)
        self.settle()
        self._all_here()

    def _all_here(self) -> None:
        """Raises TimeoutError naming who hangs, ConnectionError naming who is gone."""
        if hung := [seat.name for seat in self._seats.values() if seat.hung]:
            raise TimeoutError(f"hangs, silent for {self._patience_s:.0f} s: {', '.join(hung)}")
        if dead := [seat.name for seat in self._seats.values() if seat.gone]:
            raise ConnectionError(f"ended before its time: {', '.join(dead)}")

    def dismiss(self, name: str, ended: Callable[[], bool]) -> None:
        """Call a participant that was told to end until it is gone. One in the middle of a wait needs time to pass."""
        seat, turns = self._seats[name], 0
        while not seat.gone and not ended():
            self._turn(seat, call=True)
            turns += 1
            if turns > AT_ONCE:
                self.now += timedelta(seconds=1)

    def hang_up(self) -> None:
        """End the participants' connections: who waits for the turn is told, and ends."""
        self._closing.set()

    def close(self) -> None:
        """End. Those who only asked the time have to be gone."""
        self.hang_up()
        self._server.shutdown()
        self._server.server_close()
