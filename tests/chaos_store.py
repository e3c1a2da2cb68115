"""The store killed, and its disk failing, at every write, sync and rename: nothing that was acknowledged is lost.

A child keeps memories, lines of the log and forecasts, and says after each what is kept; strace kills it at the N-th
call, or lets that call, or all from it on, fail; for every N until a run passes untouched.

    python -m tests.chaos_store            needs strace
"""

import argparse
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path

from plugd.adapters.kept_twice import KeptTwice
from plugd.domain import Memory, Overrides, Record, Status
from plugd.errors import StoreError
from tests.unit.deciding import EVENING, forecast, knows, plan, planned, session

CALLS = ("write", "pwrite64", "fdatasync", "fsync", "rename", "unlink", "ftruncate")
ROUNDS = 5
MOST_N = 400
ALL_WELL, NO_STORE = 0, 7


def memory(k: int) -> Memory:
    """The k-th that is saved."""
    made = plan(planned(session()), made_at=EVENING + k * timedelta(hours=3))
    return replace(knows(0.5), plan=made, overrides=Overrides(minimum=0.3 + 0.01 * k))


def child(folder: Path, line: socket.socket) -> int:
    """Keep, and say so. Whatever the disk does, nothing but StoreError comes of it."""
    try:
        store = KeptTwice(folder)
    except StoreError:
        return NO_STORE
    for k in range(ROUNDS):
        at = EVENING + k * timedelta(hours=3)
        with suppress(StoreError):
            store.save(memory(k))
            line.send(bytes([k]))
        with suppress(StoreError):
            store.append(Record(at, 0.5, 2.0, 10.0 + k, True, Status.CHARGING, "because", 100.0))
        with suppress(StoreError):
            store.keep(forecast(at))
    with suppress(StoreError):
        store.load()
    store.close()
    return ALL_WELL


@dataclass(frozen=True, slots=True)
class Run:
    """How a child ended, and the last memory that it said was kept."""

    code: int
    acknowledged: int


def run(folder: Path, inject: str) -> Run:
    """One child under strace."""
    ours, theirs = socket.socketpair()
    pid = os.fork()
    if pid == 0:
        ours.close()
        os.kill(os.getpid(), signal.SIGSTOP)
        code = 99
        try:
            code = child(folder, theirs)
        finally:
            os._exit(code)
    theirs.close()
    os.waitpid(pid, os.WUNTRACED)
    call = inject.split(":", 1)[0]
    tracer = subprocess.Popen(
        ["strace", "-qq", "-o", "/dev/null", "-p", str(pid), "-e", f"trace={call}", "-e", f"inject={inject}"],
        stderr=subprocess.DEVNULL,
    )
    while "TracerPid:\t0" in Path(f"/proc/{pid}/status").read_text(encoding="ascii"):
        if tracer.poll() is not None:
            os.kill(pid, signal.SIGKILL)
            raise SystemExit("strace cannot attach: it needs the right to trace (root, or ptrace_scope 0)")
        time.sleep(0.002)
    os.kill(pid, signal.SIGCONT)
    said = b""
    while more := ours.recv(64):
        said += more
    ours.close()
    _, status = os.waitpid(pid, 0)
    tracer.wait()
    return Run(os.waitstatus_to_exitcode(status), said[-1] if said else -1)


def objections(folder: Path, ended: Run) -> Iterator[str]:
    """What is not as it should be afterwards, with the disk in order again."""
    with KeptTwice(folder) as store:
        if store.notices:
            yield f"damaged: {store.notices}"
        found = store.load()
        saved = [k for k in range(ROUNDS) if found == memory(k)]
        if found is not None and not saved:
            yield "it loads what was never saved"
        if ended.acknowledged >= 0 and (not saved or saved[0] < ended.acknowledged):
            yield f"{ended.acknowledged} was acknowledged, {saved} is there"
        store.records(EVENING)
        tuple(store.issued(EVENING))
        store.save(memory(ROUNDS))
        if store.load() != memory(ROUNDS):
            yield "it does not take anything any more"


def points(call: str, how: str, root: Path, every: int) -> Iterator[tuple[str, Run, list[str]]]:
    """Each N of a call until a run passes: (what was done, how it ended, what is wrong)."""
    for n in range(1, MOST_N, every):
        folder = Path(tempfile.mkdtemp(dir=root))
        inject = f"{call}:{how.format(n=n)}"
        ended = run(folder, inject)
        wrong = [] if ended.code in (ALL_WELL, NO_STORE, -signal.SIGKILL) else [f"it ended with {ended.code}"]
        try:
            wrong += objections(folder, ended)
        except StoreError as error:
            wrong.append(f"afterwards: {error}")
        shutil.rmtree(folder)
        yield inject, ended, wrong
        if "KILL" in how and ended.code == ALL_WELL:
            return  # there is no N-th call


def main() -> int:
    """Exit 0: nothing was lost."""
    p = argparse.ArgumentParser(prog="python -m tests.chaos_store")
    p.add_argument("--every", type=int, default=1, help="only every so many calls")
    options = p.parse_args()
    if shutil.which("strace") is None:
        raise SystemExit("strace is missing: sudo apt install strace")
    tried, bad = Counter[str](), 0
    with tempfile.TemporaryDirectory(prefix="plugd-store-") as root:
        for call in CALLS:
            counted = 0
            for inject, _, wrong in points(call, "signal=KILL:when={n}", Path(root), options.every):
                counted += 1
                tried["killed"] += 1
                bad += bool(wrong)
                if wrong:
                    print(f"FAIL {inject}: {'; '.join(wrong)}", flush=True)
            for how in ("error=ENOSPC:when={n}", "error=EIO:when={n}", "error=ENOSPC:when={n}+", "error=EIO:when={n}+"):
                for place, (inject, _, wrong) in enumerate(points(call, how, Path(root), 2 * options.every), start=1):
                    tried["once" if not how.endswith("+") else "from then on"] += 1
                    bad += bool(wrong)
                    if wrong:
                        print(f"FAIL {inject}: {'; '.join(wrong)}", flush=True)
                    if 2 * place >= counted:
                        break
    print(
        f"store: killed at {tried['killed']} calls, failing once at {tried['once']}, from then on at "
        f"{tried['from then on']}: {bad} lost or broken"
    )
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
