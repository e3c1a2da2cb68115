"""The package and the tests on 64-bit ARM, emulated by qemu some ten times slower. Needs root."""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from deploy.build_deb import MACHINES, ROOT, TARGETS, build, wheels
from deploy.machine import CACHE, PATH, Failed, inside, require, root, runnable, say
from deploy.test_deb import PROBLEM

ARCHITECTURE = "arm64"
EXTRAS = ("can", "web", "hil", "demo", "dev")
TESTS = ("tests/unit", "tests/adapters", "--ignore=tests/unit/test_house.py")
"""What runs where no others are named; all of it is for a night. What is left out asks make and the checkout."""
SLOW_S = 3600
ENVIRONMENT = (
    "PYTHONPATH=/site:.:hil",
    "PYTHONDONTWRITEBYTECODE=1",
    "OMP_NUM_THREADS=1",
    "HYPOTHESIS_STORAGE_DIRECTORY=/tmp/hypothesis",
)


def tried(tree: Path, *command: str, binds: tuple[str, ...] = ()) -> str:
    """What a program in the root says. Raises Failed unless it ends with 0."""
    options = [f"--bind-ro={bind}" for bind in binds] + [f"--setenv=PATH={PATH}"]
    ran = subprocess.run(
        [*inside(tree, *options), *command], check=False, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
    )
    if ran.returncode:
        raise Failed(f"{' '.join(command)}: exit {ran.returncode}\n{ran.stdout}")
    return ran.stdout


def package(tree: Path, deb: Path) -> None:
    """It installs, and OSQP plans."""
    question = json.dumps(PROBLEM)
    script = (
        "dpkg --install /packages/plugd.deb >/dev/null && uname -m && plugd --version"
        f" && echo '{question}' > /tmp/problem.json && plugd plan --json --problem /tmp/problem.json"
    )
    *said, answer = tried(tree, "sh", "-c", script, binds=(f"{deb}:/packages/plugd.deb",)).splitlines()
    found = json.loads(answer)
    if found["solver"] != "osqp":
        raise Failed(f"the plan is not OSQP's: {answer}")
    say(f"{deb.name}: installed ({', '.join(said[-2:])}); OSQP plans in {found['solve_ms']:.0f} ms")


def tests(tree: Path, wanted: list[str]) -> int:
    """The exit code of the tests."""
    target = TARGETS["bookworm"]
    lock = hashlib.sha256((ROOT / "requirements.lock").read_bytes()).hexdigest()
    site = CACHE / f"bookworm-{ARCHITECTURE}-site-{lock[:12]}"
    if not site.exists():
        unfinished = site.with_suffix(".unfinished")
        with tempfile.TemporaryDirectory() as work:
            wheels(unfinished, target, MACHINES[ARCHITECTURE], Path(work), EXTRAS)
        unfinished.rename(site)
    options = [f"--bind-ro={ROOT}:/plugd", f"--bind-ro={site}:/site", "--chdir=/plugd"]
    options += [f"--setenv={word}" for word in (*ENVIRONMENT, f"PATH={PATH}")]
    pytest = ["python3", "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--override-ini=timeout={SLOW_S}"]
    return subprocess.run([*inside(tree, *options), *pytest, *wanted], check=False, stdin=subprocess.DEVNULL).returncode


def main() -> int:
    """Try both. Returns the exit code."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--package", type=Path, metavar="DEB", help="default: one built now")
    options.add_argument("tests", nargs="*", help=f"for pytest (default: {' '.join(TESTS)})")
    given, more = options.parse_known_args()
    os.nice(10)
    try:
        require("debootstrap", "systemd-nspawn", "qemu-aarch64-static")
        with runnable("qemu-aarch64"):
            tree = root("bookworm", ARCHITECTURE)
            package(
                tree,
                (given.package or build(TARGETS["bookworm"], ARCHITECTURE, "1", CACHE / "dist", quick=True)).resolve(),
            )
            return tests(tree, [*(given.tests or TESTS), *more])
    except Failed as failure:
        print(f"FAILED  {failure}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
