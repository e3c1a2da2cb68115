"""What the daemon costs to have: `python bench/footprint.py [--days 30]`, some ten minutes; `--quick` is two days.

The daemon's own process, of the demo, with the page on and looked at: resident memory after simulated days, with the
planner in a process of its own and with OSQP in the daemon; on a day in which it looks every 10 s as on the real clock,
processor time, bytes and syncs (strace counts them where it is there). On the real clock, the time from the start of
`plugd run` to the first plan on MQTT, and what is resident then, with a new store and with eight weeks in it. What its
packages take on disk. Ends with 1 where a goal is missed.

A simulated day costs more than a real one: every look is a turn with the conductor and an echo through the broker.
Three things of the real daemon are not in the demo's: APScheduler, TLS to the forecast's source, and the command line.
What they add is measured apart and counted in.
"""

import argparse
import json
import os
import re
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from plugd.adapters.store import SqliteStore
from plugd.domain import Forecast, Household, Intensity
from plugd.ledger import HalfHour, night_of
from plugd.past import HISTORY
from plugd.planner.problem import Problem, ProblemSession
from plugd.units import HALF_HOUR, slot_start
from plugd_hil.broker import HOST, any_broker
from plugd_hil.children import Children
from plugd_hil.neso_source import SeriesSource, Shifted, shift_to
from plugd_hil.synthetic import synthetic_year

MIB, MB = float(1 << 20), 1e6
PEERS = (
    ("evcc", "80-100 MB", "issues 18072, ProxmoxVE PR 8915"),
    ("Zigbee2MQTT", "150 MB", "issue 21030"),
    ("Home Assistant", "260 MB", "its users' reports; 359 MB in a rival's benchmark"),
)
"""What their users report of resident memory; nothing of it was measured here."""
INSIDE = "\n[planner]\nchild = false\n"
PLANS = 56
"""A day: each half hour, and some commands."""
PAGE_S, SETTLE_S = 3.0, 2.0
PATIENCE_S = 120.0
MEASURED_SLOTS = 52
"""It is asked what was measured of the last 26 hours."""
STARTS = 3


@dataclass(frozen=True, slots=True)
class Look:
    """A process as /proc shows it."""

    resident_mib: float
    peak_mib: float
    cpu_s: float
    """Its own and its ended children's."""
    written_mb: float
    """What it had the kernel write to a disk; 0 on a file system in memory."""


def look(pid: int) -> Look:
    """Raises OSError once the process is gone."""
    folder = Path("/proc", str(pid))
    status = (folder / "status").read_text()
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    written = (folder / "io").read_text().split("\nwrite_bytes: ")[1].split("\n")[0]
    resident, peak = (int(status.split(name)[1].split()[0]) * 1024 / MIB for name in ("VmRSS:", "VmHWM:"))
    return Look(resident, peak, sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK"), int(written) / MB)


def found(*words: str) -> int | None:
    """The process whose command line holds all of the words."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):
                said = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                if all(word in said for word in words):
                    return int(folder.name)
    return None


def opened(url: str) -> None:
    """Look at the page, as somebody's browser does."""
    with suppress(OSError), urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
        answer.read()


def free_port() -> int:
    """A port that nothing listens on now."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


@contextmanager
def folder_on_disk() -> Iterator[Path]:
    """Beside the checkout's own files: /tmp may be in memory, where nothing is ever written to a disk."""
    with tempfile.TemporaryDirectory(prefix="footprint-", dir=Path.cwd()) as name:
        yield Path(name)


def demo(days: int, *more: str, tables: str = "", strace: bool = False) -> tuple[Look, Look | None, int | None]:
    """The daemon after `days` of the demo with its page looked at, mosquitto beside it, and syncs where counted."""
    with folder_on_disk() as folder:
        keep, added, counted, words = (folder / name for name in ("keep", "more.toml", "syncs", "words"))
        port = free_port()
        added.write_text(tables, encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "plugd_hil.demo",
            "--days",
            str(days),
            "--page",
            str(port),
            "--keep",
            str(keep),
        ]
        with words.open("w") as stderr:
            process = subprocess.Popen(
                [*command, "--more", str(added), *more], stdout=subprocess.DEVNULL, stderr=stderr
            )
        tracer: subprocess.Popen[bytes] | None = None
        try:
            daemon, url = None, f"http://{HOST}:{port}/"
            while "page is at" not in words.read_text():
                if process.poll() is not None:
                    raise SystemExit(f"the demo ended with {process.returncode}: {words.read_text()}")
                daemon = daemon or found("plugd_hil.daemon", str(keep))
                if daemon and strace and tracer is None:
                    trace = ["strace", "-f", "-qq", "-e", "trace=fsync,fdatasync", "-o", str(counted)]
                    tracer = subprocess.Popen([*trace, "-p", str(daemon)], stderr=subprocess.DEVNULL)
                time.sleep(PAGE_S)
                opened(url)
            time.sleep(SETTLE_S)
            opened(url)
            broker = found("mosquitto", str(keep))
            seen = look(daemon or process.pid), look(broker) if broker else None
        finally:
            if tracer is not None:
                tracer.terminate()
                tracer.wait()
            process.terminate()
            process.wait(2.0 * PATIENCE_S)
        syncs = len(re.findall(r"f(data)?sync\(", counted.read_text())) if tracer is not None else None
        return *seen, syncs


LOADED = """
import argparse, ctypes, gc, sys
real = sys.argv[1] == "real"
if real:
    from plugd.cli import program
    program._parsed(["run"])
import plugd.config.handed, plugd.daemon, plugd.page, plugd.web.app, plugd.web.server
from plugd.adapters.allocator import Allocator
Allocator()
if real:
    import ssl
    from plugd.adapters.clock import SystemClock
    clock = SystemClock()
    for _ in range(3):
        ssl.create_default_context()
gc.collect()
ctypes.CDLL(None).malloc_trim(0)
print(open("/proc/self/status").read().split("VmRSS:")[1].split()[0])
if real:
    clock.close()
"""


def added_mib() -> float:
    """What the command line, the real clock and trusting this machine's certificates add to the demo's daemon."""
    demo_kib, real_kib = (
        int(subprocess.run([sys.executable, "-c", LOADED, which], check=True, capture_output=True, text=True).stdout)
        for which in ("demo", "real")
    )
    return (real_kib - demo_kib) / 1024


def fill(folder: Path) -> None:
    """A store as it is after eight weeks: a forecast and a half hour of the ledger for each half hour."""
    year = SeriesSource({None: synthetic_year()})
    now = slot_start(datetime.now(UTC))
    source = Shifted(year, shift_to(year.span(), now))
    home = Household()
    with SqliteStore(folder) as store:
        for issued_at in (now - k * HALF_HOUR for k in range(HISTORY // HALF_HOUR, 0, -1)):
            told = [source.row(None, issued_at + k * HALF_HOUR, issued_at) for k in range(-MEASURED_SLOTS, 96)]
            rows = [row for row in told if row is not None and row.forecast is not None]
            expected = (Intensity(row.start, round(row.forecast or 0.0)) for row in rows if row.start >= issued_at)
            actual = (Intensity(row.start, round(row.actual)) for row in rows if row.actual is not None)
            store.keep(Forecast(issued_at, "national", tuple(expected), tuple(actual)))
            night = night_of(issued_at, home)
            arrival = datetime.combine(night, home.nights.plug_in, UTC)
            store.enter(
                [HalfHour(issued_at, 0.3, 120.0, 118.0, 0.5, 0, night, arrival, True, 2.3, None, 0.5, None, None)]
            )


def first_plan(filled: bool) -> tuple[float, Look]:
    """From the start of `plugd run` to its first plan on MQTT, and the process then. Real clock, stubs around it."""
    with folder_on_disk() as folder:
        if filled:
            fill(folder / "state")
        broker = any_broker(os.environ.get("PATH", ""), folder)
        broker.start()
        children = Children(folder)
        try:
            neso = children.start("neso", "plugd_hil.neso", says=True)
            children.start("plug", "plugd_hil.plug", "--broker", f"{HOST}:{broker.port}", says=True)
            config, page = folder / "plugd.toml", f"{HOST}:{free_port()}"
            config.write_text(
                f'[broker]\nhost = "{HOST}"\nport = {broker.port}\n[plug]\ntopic = "ev-plug"\n[web]\n'
                f'bind = "{page}"\n[forecast]\nbase_url = "http://{HOST}:{neso["port"]}"\n'
                f'[state]\ndir = "{folder / "state"}"\n'
            )
            planned_s = _until_planned(children, broker.port, str(config))
            time.sleep(SETTLE_S)
            opened(f"http://{page}/")
            return planned_s, look(children.running["plugd"].pid)
        finally:
            children.close()
            broker.stop()


def _until_planned(children: Children, port: int, config: str) -> float:
    planned: list[float] = []
    client = Client(CallbackAPIVersion.VERSION2)

    def heard(_client: Client, _user: object, message: MQTTMessage) -> None:
        if len(message.payload) > len("[]"):
            planned.append(time.monotonic())

    client.on_message = heard
    client.connect(HOST, port)
    client.subscribe("plugd/ev/plan")
    client.loop_start()
    began = time.monotonic()
    children.start("plugd", "plugd", "-c", config, "run")
    while not planned and time.monotonic() < began + PATIENCE_S:
        time.sleep(0.01)
    client.loop_stop()
    if not planned:
        raise SystemExit(f"no plan in {PATIENCE_S:g} s; {children.last_words('plugd')}")
    return planned[0] - began


def child_cpu_s() -> float:
    """Processor time of one plan in a planner's process that was just started."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    question = json.dumps(asdict(_everyday())).encode() + b"\n"
    subprocess.run(
        [sys.executable, "-m", "plugd.adapters.planner_child"], input=question, check=True, capture_output=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _everyday() -> Problem:
    """Four nights of 22 half hours."""
    night = ProblemSession(tuple(map(float, range(100, 210, 5))), (0.5,) * 22, (2.3,) * 22, 25.0, 40.0, 11.28)
    return Problem(25.0, 10.0, 0.9, (night,) * 4)


def installed() -> dict[str, float]:
    """MB on disk of plugd with its page, and of each package that it needs for that."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    waiting = [Requirement(text) for text in (*project["dependencies"], *project["optional-dependencies"]["web"])]
    source = (file for file in Path("plugd").rglob("*") if file.is_file() and file.suffix != ".pyc")
    sizes = {"plugd": sum(file.stat().st_size for file in source) / MB}
    while waiting:
        need = waiting.pop()
        name = need.name.lower().replace("_", "-")
        if name in sizes or (need.marker is not None and not need.marker.evaluate({"extra": ""})):
            continue
        package = distribution(name)
        files = (Path(str(package.locate_file(file))) for file in package.files or ())
        sizes[name] = sum(file.stat().st_size for file in files if file.is_file()) / MB
        waiting += map(Requirement, package.requires or ())
    return sizes


def main() -> int:
    """The programme."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--quick", action="store_true", help="two days instead of thirty, one instead of two")
    options = parser.parse_args()
    days, day = (2, 1) if options.quick else (options.days, 2)
    rows: list[tuple[str, float, float | None, str]] = []

    def told(what: str, value: float, goal: float | None, unit: str) -> None:
        rows.append((what, value, goal, unit))
        mark = "" if goal is None else f"goal {goal:g}" + ("" if value <= goal else "  MISSED")
        print(f"{what:<60} {value:9.2f} {unit:<8} {mark}", flush=True)

    added = added_mib()
    told("APScheduler, TLS, command line: not in the demo", added, None, "MiB")
    seen, mosquitto, _ = demo(days)
    told(f"resident after {days} days, planner in a child, with those", seen.resident_mib + added, 50.0, "MiB")
    told("  of the demo's daemon at its highest", seen.peak_mib, None, "MiB")
    if mosquitto is not None:
        told("  mosquitto beside it", mosquitto.resident_mib, None, "MiB")
    seen, _, _ = demo(days, tables=INSIDE)
    told(f"resident after {days} days, OSQP in the daemon, with those", seen.resident_mib + added, 90.0, "MiB")
    for name, told_mb, where in PEERS:
        print(f"  {name}: {told_mb} ({where})")
    seen, _, _ = demo(day, "--look", "10")
    cpu_s = seen.cpu_s / day + PLANS * child_cpu_s()
    told(f"processor time, looking every 10 s, {PLANS} plans a day", cpu_s / 864.0, 0.5, "% core")
    told("written", seen.written_mb / day, 2.0, "MB/day")
    if shutil.which("strace"):
        _, _, syncs = demo(1, "--look", "10", strace=True)
        told("syncs", float(syncs or 0), 200.0, "a day")
    for filled, store in ((False, "a new store"), (True, "eight weeks in the store")):
        starts = [first_plan(filled) for _ in range(STARTS)]
        told(f"start of `plugd run` to the first plan, {store}", min(s for s, _ in starts), 2.0, "s")
        told("  processor time until then, the page opened once", min(look.cpu_s for _, look in starts), None, "s")
        told("  resident then", max(look.resident_mib for _, look in starts), None, "MiB")
    sizes = installed()
    told(f"installed, {len(sizes)} packages with the page's", sum(sizes.values()), None, "MB")
    largest = sorted(sizes.items(), key=lambda item: -item[1])[:6]
    print("  " + ", ".join(f"{name} {size:.1f}" for name, size in largest))
    return int(any(goal is not None and value > goal for _, value, goal, _ in rows))


if __name__ == "__main__":
    sys.exit(main())
