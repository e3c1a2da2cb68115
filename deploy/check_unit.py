"""Whether systemd understands every key of the shipped unit, and how exposed it leaves plugd."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

RUN = Path("/run/systemd")
SYSTEMD = Path(__file__).parents[1] / "systemd"
MOST_EXPOSED = 1.5
"""On the scale of `systemd-analyze security`, 0 to 10."""
BACKOFF_SINCE = 254
"""The systemd that knows the keys of plugd-backoff.conf."""
NEEDED: tuple[tuple[Callable[[], bool], str], ...] = (
    (lambda: shutil.which("systemd-analyze") is not None, "systemd-analyze is missing: sudo apt install systemd"),
    # It makes that folder where it is not there, as in a container that no systemd has booted, if it may.
    (lambda: RUN.is_dir() or os.access(RUN.parent, os.W_OK), f"systemd-analyze needs {RUN}: sudo mkdir -p {RUN}"),
)
"""(whether it is there, what to say where it is not)."""


def said(*arguments: str) -> str:
    """Everything that systemd-analyze says."""
    command = ["systemd-analyze", *arguments]
    ran = subprocess.run(command, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return ran.stdout.strip()


def complaints(unit: str) -> list[str]:
    """What systemd does not understand in a unit: unknown keys leave its exit code at 0, so any word counts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "plugd.service")
        # The program need not be installed here.
        path.write_text(re.sub("(?m)^ExecStart=plugd run$", "ExecStart=/bin/true", unit), encoding="utf-8")
        return said("verify", "--man=no", str(path)).splitlines()


def exposure(unit: str) -> float:
    """The unit's score."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "plugd.service")
        path.write_text(unit, encoding="utf-8")
        answer = said("security", "--offline=true", str(path))
    found = re.search(r"exposure level for plugd\.service: ([0-9.]+)", answer)
    if found is None:
        raise SystemExit(f"systemd-analyze security does not say a score:\n{answer}")
    return float(found[1])


def main() -> int:
    """Check the unit alone and with its drop-ins. Returns the exit code."""
    missing = next((what for there, what in NEEDED if not there()), None)
    if missing is not None:
        print(f"unit: NOT CHECKED, {missing}", file=sys.stderr)
        return 1 if os.environ.get("CI") else 0
    version = re.match(r"systemd (\d+)", said("--version"))
    dropins = ["plugd-can.conf"]
    if version is not None and int(version[1]) >= BACKOFF_SINCE:
        dropins.append("plugd-backoff.conf")
    alone = (SYSTEMD / "plugd.service").read_text(encoding="utf-8")
    good = True
    for name in ("", *dropins):
        # A section may be opened again, so that what follows acts as the drop-in does.
        unit = f"{alone}\n{(SYSTEMD / name).read_text(encoding='utf-8')}" if name else alone
        what = f"plugd.service with {name}" if name else "plugd.service"
        found = complaints(unit)
        score = exposure(unit)
        good = good and not found and (bool(name) or score <= MOST_EXPOSED)
        print(f"unit: {what}: exposure {score} (the unit alone: at most {MOST_EXPOSED})")
        for line in found:
            print(f"unit: {what}: {line}", file=sys.stderr)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
