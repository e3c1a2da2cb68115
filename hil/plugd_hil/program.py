"""What a stub with a car behind it is as a program: its command line, clock and ledger, and who orders it about."""

import argparse
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import TextIO

from plugd.adapters.bell import Bell, Doorbell
from plugd.adapters.clock import SystemClock
from plugd.ports import Clock
from plugd_hil.conductor import Participant, address
from plugd_hil.script import Script

Run = Callable[[argparse.Namespace, Clock, TextIO | None, ExitStack], None]
"""What a stub does until its end: with its options, clock and ledger, and what is left for the end."""


def command_line(name: str, about: str | None, power_kw: float, tells: tuple[str, ...]) -> argparse.ArgumentParser:
    """The words that all stubs know. `tells`: when the car may tell its SOC."""
    p = argparse.ArgumentParser(prog=f"plugd_hil.{name}", description=about)
    p.add_argument("--power", type=float, default=power_kw, metavar="KW", help="the most it gives, at the plug")
    p.add_argument("--soc", type=float, default=50.0, metavar="PERCENT")
    p.add_argument("--capacity", type=float, default=50.0, metavar="KWH")
    p.add_argument("--efficiency", type=float, default=0.9)
    p.add_argument("--car", choices=("connected", "driver", "absent"), default="connected")
    p.add_argument("--tell", choices=tells, default="never", help="when the car tells its SOC")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--timezone", default="Europe/London")
    p.add_argument("--start", type=datetime.fromisoformat, metavar="ISO", help="stays before are skipped")
    p.add_argument("--clock", metavar="HOST:PORT", help="the simulated clock's conductor")
    p.add_argument("--ledger", type=Path, metavar="FILE", help="the truth, as JSON lines")
    p.add_argument("--faults", type=Path, metavar="FILE", help="a scenario: what goes wrong, and when")
    p.add_argument("--stdin", action="store_true", help="take orders from stdin, and end with it")
    return p


class Orders(Bell):
    """What the world says, on stdin and in a script. A `plugd.ports.Inbox` that only they wake."""

    def __init__(self, options: argparse.Namespace, now: datetime, bell: Doorbell | None = None) -> None:
        """Raises UsageError for a script that is none."""
        super().__init__(bell)
        self.stopped = False
        self._script = Script.read(options.faults, "plug", now, options.timezone)
        self._lines: deque[str] = deque()

    def listen(self, stdin: TextIO | None) -> None:
        """From now on SIGTERM ends the program, and so does the end of stdin, where it counts."""
        for signum in (signal.SIGTERM, signal.SIGINT):
            signal.signal(signum, self.stop)
        if stdin is not None:
            threading.Thread(target=self._read, args=(stdin,), daemon=True).start()

    def due(self) -> datetime | None:
        """When the script has the next."""
        return self._script.due()

    def pending(self) -> bool:
        """Whether there is something to do."""
        return bool(self._lines) or self.stopped

    def take(self, now: datetime) -> Iterator[str]:
        """Those that are due."""
        self._lines.extend(self._script.take(now))
        while self._lines:
            yield self._lines.popleft()

    def stop(self, _signum: int = 0, _frame: FrameType | None = None) -> None:
        """End the program."""
        self.stopped = True
        self.wake()

    def _read(self, stream: TextIO) -> None:
        for line in stream:
            self._lines.append(line)
            self.wake()
        self.stop()


def live(options: argparse.Namespace, run: Run) -> int:
    """The program, on simulated time where a conductor is named. Returns the exit status."""
    with ExitStack() as left:
        clock = Participant(*address(options.clock), "plug") if options.clock else SystemClock()
        left.enter_context(closing(clock))
        ledger = left.enter_context(options.ledger.open("w", encoding="utf-8")) if options.ledger else None
        run(options, clock, ledger, left)
    return 0
