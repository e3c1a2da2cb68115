"""A month of plugd in one process, on its real store: does it grow, and what does it write?

Thirty simulated days of the daemon's cycle with ledger and file; after a third, and at the end, what is resident,
allocated, open and running is compared. Bytes are counted as the kernel sees them.

    python -m tests.soak
"""

import argparse
import gc
import os
import sys
import tempfile
import threading
import time
import tracemalloc
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from plugd.adapters.kept_twice import KeptTwice
from plugd.book import Book
from plugd.domain import Household
from plugd.planner.qp import Qp
from plugd.study.house import FunctionSource, House
from plugd.study.world import Driver

START = datetime(2023, 1, 9, 12, tzinfo=UTC)
MOST_GROWTH_MB, MOST_MB_A_DAY = 1.0, 2.0
"""In ten days; and what is handed to the kernel to write."""


@dataclass(frozen=True, slots=True)
class Size:
    """What the process holds."""

    resident_mb: float
    allocated_mb: float
    descriptors: int
    threads: int


def size() -> Size:
    """Now."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return Size(
        resident_mb=pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        allocated_mb=tracemalloc.get_traced_memory()[0] / 1e6,
        descriptors=len(os.listdir("/proc/self/fd")),  # noqa: PTH208 - it changes while it is read
        threads=threading.active_count(),
    )


def written_mb() -> float:
    """What this process has handed to the kernel to write."""
    said = dict(line.split(": ") for line in Path("/proc/self/io").read_text(encoding="ascii").splitlines())
    return int(said["wchar"]) / 1e6


def level(issued: datetime, start: datetime) -> float:
    """Clean at night, and never twice the same."""
    return 120.0 + 80.0 * ((start.hour - 2) % 24 > 5) + (hash((issued.day, start.hour)) % 40)


def house(store: KeptTwice) -> House:
    """The daemon's cycle with its file and its ledger."""
    home = Household()
    found = House(home, Qp(), FunctionSource(level), Driver(seed=1).stays(START), START)
    found.cycle.store = store
    found.cycle.book = Book(store, home)
    return found


def main() -> int:
    """Exit 0: flat, and gentle to the card."""
    p = argparse.ArgumentParser(prog="python -m tests.soak")
    p.add_argument("--days", type=int, default=30)
    days = p.parse_args().days
    with tempfile.TemporaryDirectory(prefix="plugd-soak-") as folder, KeptTwice(Path(folder)) as store:
        tracemalloc.start()
        lived, began = house(store), time.process_time()
        sizes: list[Size] = []
        wrote_mb = 0.0
        for day in range(1, days + 1):
            lived.run(START + timedelta(days=day))
            if day % max(1, days // 3) == 0:
                sizes.append(size())
            if day == max(1, days // 3):
                wrote_mb = written_mb()
        left_days = days - max(1, days // 3)
        a_day_mb = (written_mb() - wrote_mb) / left_days
        file_mb = sum(path.stat().st_size for path in Path(folder).iterdir()) / 1e6
    first, last = sizes[0], sizes[-1]
    per_ten_days = 10.0 / left_days
    resident, allocated = (
        (getattr(last, name) - getattr(first, name)) * per_ten_days for name in ("resident_mb", "allocated_mb")
    )
    kept = (
        resident < MOST_GROWTH_MB
        and last.descriptors == first.descriptors
        and last.threads == first.threads
        and a_day_mb <= MOST_MB_A_DAY
    )
    print(
        f"soak: {days} days in {time.process_time() - began:.0f} s of processor; resident {last.resident_mb:.0f} MB, "
        f"{resident:+.2f} MB in ten days ({allocated:+.2f} MB by Python's count); descriptors {first.descriptors} -> "
        f"{last.descriptors}, threads {first.threads} -> {last.threads}; {a_day_mb:.2f} MB written a "
        f"day, files {file_mb:.2f} MB"
    )
    return int(not kept)


if __name__ == "__main__":
    sys.exit(main())
