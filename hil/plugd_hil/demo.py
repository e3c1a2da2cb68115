"""`plugd demo`: the daemon, a broker, a stub plug with a car and a stub of the API, on a simulated clock.

Every part is a process of its own and speaks the real protocol. Nothing is left behind.
"""

import json
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import date, datetime
from datetime import time as clock_time
from pathlib import Path
from types import FrameType
from zoneinfo import ZoneInfo

from rich.console import Console
from rich.progress import Progress

from plugd.cli import Parser
from plugd.domain import Capability, Household
from plugd.errors import PlugdError, UsageError
from plugd.units import require_utc
from plugd_hil.demo_outcome import Outcome, reckoned, summary, table
from plugd_hil.demo_run import CAN, POWER_KW, SYNTHETIC, Options, folder_of, look_for_port, series_for, simulate, span
from plugd_hil.plug import DIALECTS

MOST_DAYS = 366
MOST_PORT = 65535


def run(options: Options, progress: Callable[[float], None] = lambda _: None) -> Outcome:
    """Run the whole system. Raises UsageError for the arguments, PlugdError where a part fails."""
    began_s = time.monotonic()
    series = series_for(options)
    household = Household(capability=Capability(POWER_KW, dead_man=True))
    start, end = span(options, series, ZoneInfo(household.timezone))
    look_for_port(options)
    with folder_of(options) as folder:
        places = simulate(options, folder, start, end, progress)
        found = reckoned(options, household, series, (start, end), places)
    return replace(found, wall_s=time.monotonic() - began_s)


@contextmanager
def _bar(console: Console) -> Iterator[Callable[[float], None]]:
    """A progress bar on stderr, where somebody looks."""
    if not console.is_terminal:
        yield lambda _: None
        return
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("simulating", total=1.0)
        yield lambda share: progress.update(task, completed=share)


def _parsed(arguments: Sequence[str] | None) -> Options:
    parser = Parser(prog="plugd demo", description="The daemon against a stub plug with a car, through a real broker.")
    parser.add_argument("--days", type=int, default=7, help="how many days (default 7)")
    parser.add_argument("--from", dest="start", metavar="DATE", help="first day; it starts at local noon")
    parser.add_argument("--seed", type=int, default=0, help="another driver, other forecast errors")
    parser.add_argument("--source", default=SYNTHETIC, metavar="synthetic|FILE", help="whose intensity")
    parser.add_argument("--plug", default="tasmota", choices=(*DIALECTS, CAN), help="which dialect the plug speaks")
    parser.add_argument("--soc", default="arrival", choices=("arrival", "never"), help="when the car tells its SOC")
    parser.add_argument("--json", action="store_true", help="one JSON document, and nothing else")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the daemon's state there, for plugd report")
    parser.add_argument(
        "--page", type=int, nargs="?", const=8480, metavar="PORT", help="show the page, and let time go on at the end"
    )
    parser.add_argument(
        "--look", type=float, metavar="S", help="the daemon looks this often (10 as on the real clock; slower)"
    )
    parser.add_argument("--more", type=Path, metavar="FILE", help="tables to add to the daemon's configuration")
    asked = parser.parse_args(arguments)
    if not 1 <= asked.days <= MOST_DAYS:
        parser.error(f"--days {asked.days}: choose 1 to {MOST_DAYS}")
    if asked.page is not None and not 1 <= asked.page <= MOST_PORT:
        parser.error(f"--page {asked.page}: choose 1 to {MOST_PORT}")
    zone = ZoneInfo(Household().timezone)
    start = None
    if asked.start is not None:
        try:
            start = require_utc(datetime.combine(date.fromisoformat(asked.start), clock_time(12), zone))
        except ValueError:
            parser.error(f"--from {asked.start}: write a date as 2023-01-02")
    return Options(
        days=asked.days,
        start=start,
        seed=asked.seed,
        source=asked.source,
        plug=asked.plug,
        soc=asked.soc,
        json=asked.json,
        keep=asked.keep,
        page=asked.page,
        look_s=asked.look,
        more=asked.more,
    )


@contextmanager
def _unwound() -> Iterator[None]:
    """SIGTERM ends the demo as Ctrl-C does, by way of every `finally`: no process stays behind."""

    def end(signum: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + signum)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _told(options: Options, outcome: Outcome, household: Household) -> None:
    if options.json:
        print(json.dumps(outcome.document(ZoneInfo(household.timezone)), indent=2))
        return
    console = Console(width=None if sys.stdout.isatty() else 140)
    if options.source == SYNTHETIC:
        console.print("The intensity is synthetic: a GB-like year of plugd's own making.", style="italic")
    console.print(table(outcome, household))
    console.print(summary(outcome))
    if options.keep is not None:
        console.print(f"Kept: plugd -c {options.keep / 'plugd.toml'} report --out report.html", soft_wrap=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Exit 0 done, 1 failed, 2 usage."""
    try:
        options = _parsed(arguments)
        with _unwound(), _bar(Console(stderr=True)) as progress:
            outcome = run(options, progress)
        _told(options, outcome, Household())
        sys.stdout.flush()
    except PlugdError as error:
        print(f"plugd demo: {error}", file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        with suppress(OSError):
            sys.stdout.close()
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
