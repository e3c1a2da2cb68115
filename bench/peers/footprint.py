"""What a solver costs to have: time to import and memory, each in a process of its own."""

import subprocess
import sys
from statistics import median

IMPORTS = {
    "exact": "import plugd.planner.exact",
    "OSQP": "import plugd.planner.qp",
    "HiGHS": "import highspy, numpy",
    "scipy linprog": "import scipy.optimize",
    "CVXPY": "import cvxpy",
    "PuLP": "import pulp",
}
PROGRAM = """
from time import perf_counter
start = perf_counter()
{0}
took = perf_counter() - start
status = open("/proc/self/status").read()  # the peak that getrusage gives is inherited from the bench
print(took, status.split("VmRSS:")[1].split()[0])
"""


def footprint(repeats: int) -> dict[str, tuple[float, float]]:
    """Per solver ms to import, the median of `repeats`, and MiB of the process after it; the missing left out."""
    found = {}
    for name, statement in {"nothing": "pass", **IMPORTS}.items():
        lines = []
        for _ in range(repeats):
            command = [sys.executable, "-c", PROGRAM.format(statement)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode == 0:
                lines.append([float(number) for number in done.stdout.split()])
        if lines:
            took_s, memory_kib = map(median, zip(*lines, strict=True))
            found[name] = 1000 * took_s, memory_kib / 1024
    return found
