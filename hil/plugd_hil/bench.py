"""`python -m plugd_hil bench SCENARIO…`: run scenarios, say which promises were kept, draw what happened.

For each a folder under `--out`: the timeline, the ledger, what every program wrote; for all of them `junit.xml`.
"""

import argparse
import json
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from types import FrameType
from xml.etree import ElementTree as ET  # nosec B405 # it only writes

from plugd.errors import PlugdError, UsageError
from plugd_hil.account import read_ledger
from plugd_hil.house import BASE, SWITCHES, House, natural_start
from plugd_hil.promises import CHECKS, Seen
from plugd_hil.scenario import ZONE, Scenario, load
from plugd_hil.timeline import draw


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a scenario went: each promise, and None or what was seen instead."""

    name: str
    title: str
    promises: tuple[tuple[str, str | None], ...]
    wall_s: float

    @property
    def kept(self) -> bool:
        """Whether all were."""
        return all(objection is None for _, objection in self.promises)


def run(path: Path, out: Path, natural: bool = False) -> Verdict:
    """Run one. Raises UsageError for the file."""
    scenario = load(path, natural_start() if natural else None)
    if natural and scenario.written.seconds is None:
        raise UsageError(f"{path}: is a night long; only those with `seconds` run at natural speed")
    began = time.monotonic()
    folder = out / scenario.name
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.log"):
        old.unlink()
    with tempfile.TemporaryDirectory(prefix="plugd-bench-") as state, ExitStack() as left:
        try:
            house = House(scenario, folder, Path(state), natural, left)
            house.live()
        except PlugdError as error:
            failed = ((f"it runs to its end: {error}", str(error)),)
            return Verdict(scenario.name, scenario.written.title, failed, time.monotonic() - began)
    seen = _seen(house)
    draw(scenario, seen, folder / "timeline.png")
    promises = tuple((promise.said, CHECKS[promise.name](promise, seen)) for promise in scenario.promises)
    promises += (("no traceback", _traceback(folder)),)
    return Verdict(scenario.name, scenario.written.title, promises, time.monotonic() - began)


def _seen(house: House) -> Seen:
    heard = house.heard
    last = json.loads(house.ledger.read_text(encoding="utf-8").splitlines()[-1])
    return Seen(
        ledger=read_ledger(house.ledger),
        states=tuple((at, json.loads(said)) for at, topic, said in heard if topic == f"{BASE}/state"),
        words=tuple(
            (at, topic, said)
            for at, topic, said in heard
            if not topic.startswith(BASE) and any(word in f"{topic} {said}" for word in SWITCHES)
        ),
        presence=tuple((at, said) for at, topic, said in heard if topic == f"{BASE}/availability"),
        asked={key: value for key, value in last.items() if key in ASKED},
        zone=ZONE,
    )


ASKED = ("voltage_v", "current_a", "invalid", "opened_under_load", "longest_silence_s")


def _traceback(folder: Path) -> str | None:
    found = [log.name for log in sorted(folder.glob("*.log")) if "Traceback" in log.read_text(encoding="utf-8")]
    return f"in {', '.join(found)}" if found else None


# -- the command ----------------------------------------------------------------------------------


def write_junit(verdicts: Sequence[Verdict], to: Path) -> None:
    """A suite a scenario, a case a promise."""
    suites = ET.Element("testsuites", name="bench")
    for verdict in verdicts:
        failures = sum(objection is not None for _, objection in verdict.promises)
        suite = ET.SubElement(
            suites, "testsuite", name=verdict.name, tests=str(len(verdict.promises)), failures=str(failures),
            time=f"{verdict.wall_s:.1f}",
        )  # fmt: skip
        for promise, objection in verdict.promises:
            case = ET.SubElement(suite, "testcase", classname=verdict.name, name=promise)
            if objection is not None:
                ET.SubElement(case, "failure", message=objection)
    ET.indent(suites)
    ET.ElementTree(suites).write(to, encoding="utf-8", xml_declaration=True)


def _tell(verdict: Verdict) -> None:
    print(f"{'ok  ' if verdict.kept else 'FAIL'} {verdict.name} ({verdict.wall_s:.1f} s): {verdict.title}", flush=True)
    for promise, objection in verdict.promises:
        if objection is not None:
            print(f"     not kept: {promise}\n     seen: {objection}", flush=True)


def _unwound() -> None:
    """SIGTERM ends a run as Ctrl-C does, by way of every `finally`: no process stays behind."""

    def end(signum: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + signum)

    signal.signal(signal.SIGTERM, end)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(prog="plugd_hil bench", description=__doc__)
    p.add_argument("scenarios", nargs="+", type=Path, metavar="SCENARIO", help="YAML files, or folders of them")
    p.add_argument("--out", type=Path, default=Path("bench-out"), metavar="DIR")
    p.add_argument("--jobs", type=int, default=1, metavar="N", help="how many at once")
    p.add_argument("--natural", action="store_true", help="on the real clock; leaves out those that last a night")
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Exit 0: every promise was kept; 1: not; 2: usage."""
    options = parser().parse_args(arguments)
    try:
        paths = [
            p for given in options.scenarios for p in (sorted(given.glob("*.yaml")) if given.is_dir() else [given])
        ]
        scenarios: list[Scenario] = [load(path) for path in paths]
        if options.natural:
            scenarios = [one for one in scenarios if one.written.seconds is not None]
            if not scenarios:
                raise UsageError("--natural: each lasts a night; only those with `seconds` run on the real clock")
        if not scenarios:
            raise UsageError("there is no scenario in what was given")
        began, verdicts = time.monotonic(), []
        work = partial(run, out=options.out, natural=options.natural)
        _unwound()
        with ProcessPoolExecutor(options.jobs, initializer=_unwound) as pool:
            try:
                for verdict in pool.map(work, [one.path for one in scenarios]):
                    _tell(verdict)
                    verdicts.append(verdict)
            finally:
                pool.shutdown(wait=False, cancel_futures=True)  # what runs ends by itself, nothing more begins
    except UsageError as error:
        print(f"plugd_hil bench: {error}", file=sys.stderr)
        return 2
    write_junit(verdicts, options.out / "junit.xml")
    kept = sum(verdict.kept for verdict in verdicts)
    took = timedelta(seconds=round(time.monotonic() - began))
    print(f"{kept} of {len(verdicts)} scenarios kept every promise, in {took}; see {options.out}")
    return 0 if kept == len(verdicts) else 1
