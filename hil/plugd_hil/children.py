"""The processes of one run: started together, watched, and ended together."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from plugd.errors import PlugdError

FAREWELL_S = 10.0


@dataclass(slots=True)
class Children:
    """Programs of ours by name; what they write to stderr goes to a log in `folder`. `close` ends them all."""

    folder: Path
    running: dict[str, subprocess.Popen[str]] = field(default_factory=dict)

    def start(self, name: str, *arguments: str, says: bool = False) -> dict[str, object]:
        """Start one; returns the JSON line with which it says that it is ready, if it does. Raises PlugdError."""
        environment = {k: v for k, v in os.environ.items() if k != "STATE_DIRECTORY"}
        with (self.folder / f"{name}.log").open("a", encoding="utf-8") as log:
            child = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env={**environment, "PYTHONUNBUFFERED": "1"},
            )
        self.running[name] = child
        if not says or child.stdout is None:
            return {}
        line = child.stdout.readline()
        if not line:
            raise PlugdError(f"{name} did not start: {self.last_words(name)}")
        ready: dict[str, object] = json.loads(line)
        return ready

    def last_words(self, name: str) -> str:
        """The end of what a child wrote to stderr."""
        said = (self.folder / f"{name}.log").read_text(encoding="utf-8").strip().splitlines()
        return said[-1] if said else "it said nothing"

    def ended(self, name: str) -> bool:
        """Whether a child is gone."""
        return self.running[name].poll() is not None

    def look(self, patience_s: float = 0.0) -> None:
        """Raises PlugdError for a child that has ended, or does so within `patience_s`: which, and its last words."""
        for name, child in self.running.items():
            with suppress(subprocess.TimeoutExpired):
                status = child.wait(patience_s) if patience_s else child.poll()
                if status is not None:
                    words = self.last_words(name)
                    raise PlugdError(f"the demo stopped: {name} ended before its time (status {status}): {words}")

    def close(self) -> None:
        """End them all."""
        for child in self.running.values():
            if child.poll() is None:
                child.terminate()
        for child in self.running.values():
            try:
                child.wait(FAREWELL_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
            if child.stdout is not None:
                child.stdout.close()
