"""The planner in a short-lived process of its own: OSQP, numpy and scipy, half of the daemon's memory, are needed for
half a second every half hour.

The child is started at a tick's first problem, answers a line for a line, and ends by itself when nothing is asked for
`IDLE_S`, so it outlives the passes of one tick and no more. It solves each problem in a fresh workspace: an answer does
not depend on how long the child has lived. Whatever becomes of it (killed, hung, out of memory, talking nonsense), the
answer is the exact chain solver's, which needs no arrays, within the time allowed.
"""

import json
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

from plugd.config.handed import python
from plugd.planner.exact import Exact
from plugd.planner.problem import Problem, ProblemSession, Solution

IDLE_S = 2.0
PATIENCE_S = 5.0
"""What a tick may wait for the child. A slow machine needs some 2 s to import what it stands on."""
REST_S = 120.0
"""After a failure no child is started for so long: a tick asks several times, and each would wait anew."""
MOST_BYTES = 10_000_000
LIMIT_KW = 1e-6
"""Rounding that a power may lie beyond its limit."""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
PRIVATE = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "CREDENTIALS_DIRECTORY")
"""The daemon's own dealings with systemd."""

log = logging.getLogger("plugd.planner")


class PlannerChild:
    """The OSQP planner as a `Solver`, from another process. One thread at a time; `close` ends the child."""

    def __init__(self, patience_s: float = PATIENCE_S, command: Sequence[str] | None = None) -> None:
        self._patience_s = patience_s
        self._command = command or python("plugd.adapters.planner_child")
        self._child: subprocess.Popen[bytes] | None = None
        self._rest_until_s = 0.0

    def solve(self, problem: Problem) -> Solution:
        """The child's plan, or with status `fallback` the exact one."""
        if time.monotonic() >= self._rest_until_s:
            try:
                return self._asked(problem)
            except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
                self._rest_until_s = time.monotonic() + REST_S
                self.close()
                log.warning("the planner's process failed (%s); plans are the exact solver's for a while", error)
        return replace(Exact().solve(problem), status="fallback")

    def close(self) -> None:
        """End the child, where there is one."""
        child, self._child = self._child, None
        if child is not None and child.stdin is not None and child.stdout is not None:
            child.kill()
            child.wait()
            child.stdin.close()
            child.stdout.close()

    def _asked(self, problem: Problem) -> Solution:
        """Raises OSError for a child that ends or hangs, ValueError, TypeError, KeyError for one that errs."""
        question = json.dumps(asdict(problem)).encode() + b"\n"
        until_s = time.monotonic() + self._patience_s
        if self._child is not None:
            try:
                return _checked(problem, self._answer(self._child, question, until_s))
            except (BrokenPipeError, EOFError):
                self.close()  # it had been idle for long enough, or was just about to end
        self._child = self._started()
        try:
            return _checked(problem, self._answer(self._child, question, until_s))
        except (BrokenPipeError, EOFError):
            status = self._child.wait()
            raise OSError(f"it ended with {status}") from None

    def _started(self) -> subprocess.Popen[bytes]:
        environment = {name: value for name, value in os.environ.items() if name not in PRIVATE}
        child = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env=environment | ONE_THREAD
        )
        # Waited for as soon as it ends, so that no defunct process stands in the list until the next tick.
        threading.Thread(target=child.wait, name="planner-end", daemon=True).start()
        return child

    def _answer(self, child: subprocess.Popen[bytes], question: bytes, until_s: float) -> bytes:
        """The line for a line. Raises EOFError where there is no more, TimeoutError, BrokenPipeError."""
        if child.stdin is None or child.stdout is None:
            raise OSError("it was started without pipes")
        os.set_blocking(child.stdin.fileno(), False)
        left, said = memoryview(question), bytearray()
        while not said.endswith(b"\n"):
            to_write = [child.stdin] if left else []
            readable, writable, _ = select.select([child.stdout], to_write, [], max(0.0, until_s - time.monotonic()))
            if not readable and not writable:
                raise TimeoutError(f"no answer within {self._patience_s:g} s")
            if writable:
                left = left[os.write(child.stdin.fileno(), left) :]
            if readable:
                part = os.read(child.stdout.fileno(), 65536)
                if not part:
                    raise EOFError
                said += part
                if len(said) > MOST_BYTES:
                    raise ValueError("it talks without end")
        return bytes(said)


def _checked(problem: Problem, line: bytes) -> Solution:
    """The answer in `line`, believed if its powers fit the problem. Raises ValueError, TypeError, KeyError."""
    solution = Solution(**_frozen(json.loads(line)))
    for session, power_kw in zip(problem.sessions, solution.power_kw, strict=True):
        for most_kw, kw in zip(session.power_max_kw, power_kw, strict=True):
            if not 0.0 <= kw <= most_kw + LIMIT_KW:  # a NaN is not
                raise ValueError(f"it planned {kw} kW where {most_kw} kW can flow")
    return solution


def _problem(line: bytes) -> Problem:
    found = _frozen(json.loads(line))
    return Problem(**found | {"sessions": tuple(ProblemSession(**session) for session in found["sessions"])})


def _frozen(value: Any) -> Any:
    """What JSON made a list is a tuple again."""
    if isinstance(value, dict):
        return {key: _frozen(item) for key, item in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _lines() -> Any:
    """What the daemon asks, a line at a time, until it is silent for `IDLE_S` or gone."""
    said = bytearray()
    while select.select([0], [], [], IDLE_S)[0]:
        part = os.read(0, 65536)
        if not part:
            return
        said += part
        while b"\n" in said:
            line, _, said = said.partition(b"\n")
            yield bytes(line)


def main() -> int:
    """The child."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the daemon, which ends this one
    from plugd.planner.qp import Qp  # noqa: PLC0415 - what the daemon is spared

    for line in _lines():
        answer = json.dumps(asdict(Qp().solve(_problem(line)))).encode() + b"\n"
        while answer:
            answer = answer[os.write(1, answer) :]
    return 0


if __name__ == "__main__":
    sys.exit(main())
