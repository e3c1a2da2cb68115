"""A month of plugd in one process, on its real store: does it grow, and what does it write?

The house has been running before: its store holds eight weeks, and five days are lived before the first look. Then
what is resident, allocated, open and running is looked at after every simulated day; growth is the slope of the line
through all those days. The cycle is the daemon's, with ledger, learning and scoring, and tidies as the daemon does.
Bytes are counted as the kernel sees them, syncs by strace where that is there.

    python -m tests.soak [--days 30]
"""

import argparse
import gc
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from statistics import linear_regression

from plugd import ledger, perception
from plugd.adapters.allocator import Allocator
from plugd.adapters.kept_twice import KeptTwice
from plugd.book import KEPT_NIGHTS, Book
from plugd.domain import Forecast, Household, Intensity, Outlook, OutlookSlot, SlotSource
from plugd.outlook import Learned
from plugd.past import HISTORY
from plugd.planner.qp import Qp
from plugd.scoring import Scoring
from plugd.study.house import House, SimClock
from plugd.study.world import Driver
from plugd.units import HALF_HOUR, slot_start

START = datetime(2023, 3, 9, 12, tzinfo=UTC)
DAY = timedelta(days=1)
WARM_UP_DAYS = 5
FORECAST_SLOTS, OUTLOOK_SLOTS = 96, 192
PUBLISHED = timedelta(hours=1)
"""After a half hour's end until it is known what it was."""
MOST_GROWTH_MB, MOST_MB_A_DAY, MOST_SYNCS_A_DAY = 1.0, 2.0, 100.0
"""In ten days; what is handed to the kernel to write; and how often the card must say that it has it."""
COUNTED = "PLUGD_SOAK_SYNCS"
"""In the environment: the file in which strace writes down the syncs of this process."""


@dataclass(frozen=True, slots=True)
class Size:
    """What the process holds, and what it has written until then."""

    resident_mb: float
    blocks: int
    """Objects, by Python's own count."""
    descriptors: int
    threads: int
    written_mb: float
    syncs: int


def size() -> Size:
    """Now."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    said = dict(line.split(": ") for line in Path("/proc/self/io").read_text(encoding="ascii").splitlines())
    return Size(
        resident_mb=pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        blocks=sys.getallocatedblocks(),
        descriptors=len(os.listdir("/proc/self/fd")),  # noqa: PTH208 - it changes while it is read
        threads=threading.active_count(),
        written_mb=int(said["wchar"]) / 1e6,
        syncs=Path(os.environ[COUNTED]).read_bytes().count(b"sync(") if COUNTED in os.environ else 0,
    )


def level(issued: datetime, start: datetime) -> float:
    """Clean at night, and never twice the same."""
    return 120.0 + 80.0 * ((start.hour - 2) % 24 > 5) + (hash((issued.day, start.hour)) % 40)


class Grid:
    """The source: two days of forecast, and what was measured of the last one."""

    def fetch(self, now: datetime) -> Forecast:
        """As the real one's answers."""
        first = slot_start(now)
        known = slot_start(now - PUBLISHED)
        measured = (known - k * HALF_HOUR for k in range(48, 0, -1))
        return Forecast(
            now,
            "simulated",
            expected=tuple(Intensity(s, level(now, s)) for s in (first + k * HALF_HOUR for k in range(FORECAST_SLOTS))),
            actual=tuple(Intensity(s, level(s, s)) for s in measured),
        )


@dataclass(slots=True)
class Tidying:
    """The daemon's allocator, at every round as there."""

    clock: SimClock
    allocator: Allocator = field(default_factory=Allocator)
    at: datetime | None = None

    def step(self, now: datetime, wait: bool = False) -> None:
        """Give back what is free."""
        self.allocator.tidy(self.clock.monotonic())


def eight_weeks(store: KeptTwice, home: Household) -> None:
    """What a house that has been running has in its store: forecasts, measured values, outlooks, ledger."""
    grid = Grid()
    at = START - HISTORY
    while at < START:
        forecast = grid.fetch(at)
        store.keep(forecast)
        slots = (forecast.expected * 2)[:OUTLOOK_SLOTS]
        ahead = (OutlookSlot(at + k * HALF_HOUR, s.g_per_kwh, 20.0, SlotSource.NESO) for k, s in enumerate(slots))
        store.expect(at, Outlook(tuple(ahead), None))
        at += HALF_HOUR
    count = KEPT_NIGHTS * 48
    starts = (START - k * HALF_HOUR for k in range(count, 0, -1))
    store.enter([ledger.opened(start, perception.fresh(start), home, level(start, start)) for start in starts])


def house(store: KeptTwice) -> House:
    """The daemon's cycle with its file, its ledger and its errands."""
    home = Household()
    found = House(home, Qp(), Grid(), Driver(seed=1).stays(START), START)
    found.cycle.store, found.cycle.book, found.cycle.learned = store, Book(store, home), Learned()
    found.cycle.errands = (Scoring(store), Tidying(found.clock))
    return found


def days_of(lived: House, days: int) -> Iterator[Size]:
    """Live them. The house's own records of each day are put away, so that plugd alone is measured."""
    for _ in range(days):
        lived.start = lived.clock.now()
        lived.run(lived.start + DAY)
        for records in (lived.mornings, lived.guarded, lived.hub.answers, lived.plug.flows):
            records.clear()
        yield size()


def slope(values: Sequence[float]) -> float:
    """A day's growth, by the line through all days."""
    return linear_regression(range(len(values)), values).slope


def soak(days: int) -> int:
    """Exit 0: flat, and gentle to the card."""
    began = time.process_time()
    with tempfile.TemporaryDirectory(prefix="plugd-soak-") as folder, KeptTwice(Path(folder)) as store:
        eight_weeks(store, Household())
        lived = house(store)
        for last in days_of(lived, WARM_UP_DAYS):
            before = last
        sizes = [before, *days_of(lived, days)]
        file_mb = sum(path.stat().st_size for path in Path(folder).iterdir()) / 1e6
    first, last = sizes[0], sizes[-1]
    resident, blocks = (10.0 * slope([getattr(one, name) for one in sizes]) for name in ("resident_mb", "blocks"))
    a_day_mb, syncs = (last.written_mb - first.written_mb) / days, (last.syncs - first.syncs) / days
    kept = (
        resident < MOST_GROWTH_MB
        and last.descriptors == first.descriptors
        and last.threads == first.threads
        and a_day_mb <= MOST_MB_A_DAY
        and (COUNTED not in os.environ or 0.0 < syncs <= MOST_SYNCS_A_DAY)
    )
    print(
        f"soak: {days} days after {WARM_UP_DAYS}, in {time.process_time() - began:.0f} s of processor; resident "
        f"{last.resident_mb:.0f} MB, {resident:+.2f} MB in ten days ({blocks:+.0f} of {last.blocks} "
        f"objects); descriptors {first.descriptors} -> {last.descriptors}, threads {first.threads} -> {last.threads}\n"
        f"card: {a_day_mb:.2f} MB written a day, {f'{syncs:.0f}' if COUNTED in os.environ else 'without strace no'} "
        f"syncs; files {file_mb:.2f} MB"
    )
    return int(not kept)


def main() -> int:
    """The program; below strace itself again, where that is there."""
    p = argparse.ArgumentParser(prog="python -m tests.soak")
    p.add_argument("--days", type=int, default=30)
    days = p.parse_args().days
    if COUNTED in os.environ or shutil.which("strace") is None:
        return soak(days)
    with tempfile.NamedTemporaryFile(prefix="plugd-syncs-") as syncs:
        trace = ["strace", "-f", "--seccomp-bpf", "-qq", "-e", "trace=fsync,fdatasync", "-e", "signal=none"]
        again = [*trace, "-o", syncs.name, sys.executable, "-m", "tests.soak", *sys.argv[1:]]
        return subprocess.run(again, env=os.environ | {COUNTED: syncs.name}, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
