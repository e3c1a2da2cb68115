"""The page's speed and size, and what fifty clients cost the cycle: `python bench/page.py [--seconds 10]`.

A cycle with a fortnight of ledger and the page in front of it, as in the daemon; the clients are a process of their
own. Ends with 1 where the first byte takes 50 ms or more, or all of the page is 150 kB or more.
"""

import argparse
import http.client
import statistics
import subprocess
import sys
import threading
import time
from datetime import timedelta
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "hil")]

from tests.web.serving import Served  # noqa: E402 # the checkout's own tests are not installed

FIRST_BYTE_MS, ALL_BYTES = 50.0, 150_000
CLIENTS = 50
LOADS = 60


def first_byte_ms(host: str, path: str) -> tuple[float, int]:
    """(until the first byte of an answer, its size)."""
    connection = http.client.HTTPConnection(host, timeout=30)
    connection.connect()
    began = time.perf_counter()
    connection.request("GET", path)
    answer = connection.getresponse()
    first = answer.read(1)
    took_ms = 1000.0 * (time.perf_counter() - began)
    size = len(first) + len(answer.read())
    connection.close()
    return took_ms, size


def ticks_ms(served: Served, seconds: float) -> list[float]:
    """How long each tick took, one after the other for a while."""
    found = []
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        began = time.perf_counter()
        served.later(minutes=30)
        found.append(1000.0 * (time.perf_counter() - began))
        time.sleep(0.05)
    return found


def told(name: str, values: list[float], unit: str = "ms") -> None:
    """A line of the result."""
    ordered = sorted(values)
    worst = ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]
    print(f"{name:<44} median {statistics.median(values):7.1f}  p99 {worst:7.1f} {unit}  ({len(values)})")


def hammer(host: str) -> None:
    """Fifty clients that ask without a pause, until this process is ended."""

    def client() -> None:
        while True:
            try:
                first_byte_ms(host, "/")
            except OSError:
                time.sleep(0.01)

    for _ in range(CLIENTS):
        threading.Thread(target=client, daemon=True).start()
    while sys.stdin.read(1):
        pass


def measured(served: Served, seconds: float) -> int:
    """Every figure. Returns the exit code."""
    served.room.run(served.room.clock.at + timedelta(days=14))
    drawn = []
    for _ in range(LOADS):
        served.later(seconds=10)  # every load sees a new snapshot, and so a new drawing
        drawn.append(first_byte_ms(served.host, "/")[0])
    told("first byte of the page, drawn anew", drawn)
    told("first byte of the page, as drawn before", [first_byte_ms(served.host, "/")[0] for _ in range(LOADS)])
    told("first byte of what keeps it fresh", [first_byte_ms(served.host, "/live")[0] for _ in range(LOADS)])
    paths = ("/", "/static/style.css", "/static/page.js", "/static/icon.svg")
    sizes = {path: first_byte_ms(served.host, path)[1] for path in paths}
    print(
        f"{'all of it':<44} {sum(sizes.values()) / 1000:14.1f} kB  " + ", ".join(f"{p} {n}" for p, n in sizes.items())
    )
    told("a tick alone", ticks_ms(served, seconds))
    clients = subprocess.Popen([sys.executable, __file__, "--hammer", served.host], stdin=subprocess.PIPE)
    try:
        time.sleep(1.0)
        told(f"a tick while {CLIENTS} clients ask without a pause", ticks_ms(served, seconds))
    finally:
        clients.kill()
        clients.wait()
    return int(statistics.median(drawn) >= FIRST_BYTE_MS or sum(sizes.values()) >= ALL_BYTES)


def main() -> int:
    """The programme."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="how long each of the tick's measurements lasts")
    parser.add_argument("--hammer", metavar="HOST:PORT", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.hammer:
        hammer(options.hammer)
        return 0
    served = Served()
    try:
        return measured(served, options.seconds)
    finally:
        served.close()


if __name__ == "__main__":
    sys.exit(main())
