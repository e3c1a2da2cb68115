"""`plugd init`."""

import argparse
import io
import os
import shutil
import sys
from collections import Counter
from getpass import getpass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from plugd.cli.parsing import DEFAULT_CONFIG, Commands, config_path
from plugd.errors import PlugdError, UsageError

if TYPE_CHECKING:
    from plugd.first_run.interview import Draft, Found

UNITS = tuple(Path(folder, "systemd/system/plugd.service") for folder in ("/usr/lib", "/etc"))
"""Where the service is, where there is one."""
TRIES = 20
"""How often lines on stdin, which may never end, are asked the same; a person may try for ever."""


def add(commands: Commands) -> None:
    """The first configuration."""
    init = commands.add("init", _init, "write the configuration from your answers to some questions")
    init.add_argument("--out", type=Path, metavar="FILE", help="where to (default: the configuration's own place)")


class Terminal:
    """The person at stdin and stdout, or lines on stdin."""

    def __init__(self) -> None:
        self._asked: Counter[str] = Counter()
        self.present = sys.stdin.isatty() and sys.stdout.isatty()
        if isinstance(sys.stdin, io.TextIOWrapper):
            sys.stdin.reconfigure(errors="surrogateescape")  # what is no UTF-8 is refused as any other answer
        if self.present:
            import readline  # noqa: F401 # lets input() be edited

    def say(self, text: str) -> None:
        """Print it, on a terminal without a break within a word."""
        for line in text.splitlines() or [""]:
            width = shutil.get_terminal_size().columns if self.present else len(line) + 1
            print(fill(line, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False))

    def ask(self, prompt: str) -> str:
        """A line of theirs."""
        return input(prompt) if self.present else self._line(prompt, shown=True)

    def ask_secret(self, prompt: str) -> str:
        """A line that is not shown."""
        return getpass(prompt) if self.present else self._line(prompt, shown=False)

    def _line(self, prompt: str, shown: bool) -> str:
        from plugd.config.complaint import one_line

        self._asked[prompt] += 1
        if self._asked[prompt] > TRIES:
            raise UsageError(
                f"init: {TRIES} answers to {prompt.rstrip(': ')!r} and none that can be taken; nothing was written"
            )
        print(prompt, end="", flush=True)
        line = sys.stdin.readline()
        text = line.rstrip("\r\n")
        print(one_line(text) if shown else "***" if text else "")
        if not line:
            raise EOFError
        return text


def _init(options: argparse.Namespace) -> int:
    from plugd.config import load
    from plugd.first_run.interview import confirmed, interview
    from plugd.first_run.writing import writable, write

    path = Path(os.path.realpath(options.out or config_path(options)))  # a link stays, and its target is written
    writable(path)
    person, written = Terminal(), False
    try:
        replace = path.exists()
        if replace and not confirmed(person, f"{path} is there already. Replace it?", default=False):
            raise PlugdError(f"{path}: left as it is; name another file with --out")
        person.say(f"Some questions for {path}.")
        person.say("Enter takes what stands in brackets; Ctrl-C ends it, and writes nothing.")
        draft = interview(person, path.parent, _state_folder(path.parent), _look)
        write(path, draft, replace)
        written = True
        load(path)
        print(f"{path} is written.")
        return _next(person, path)
    except KeyboardInterrupt:
        print("" if written else "\nNothing was written.")
        raise


def _look(draft: "Draft") -> "Found":
    from plugd.first_run.looking import look  # only here: what it stands on takes a second to import

    return look(draft)


def _state_folder(folder: Path) -> str:
    """The usual place where this user may write there, else one beside the configuration."""
    from plugd.first_run.answers import DEFAULTS

    usual = DEFAULTS.state.dir
    there = usual if usual.exists() else usual.parent
    return str(usual if os.access(there, os.W_OK | os.X_OK) else folder / "plugd-state")


def _next(person: Terminal, path: Path) -> int:
    """Say what comes next, and look at once whether all is well, where somebody sits there."""
    from plugd.cli.check import told
    from plugd.config import load
    from plugd.first_run.interview import confirmed

    if person.present and confirmed(person, "Look now whether all of it works?", default=True):
        told(load(path), path, click=False)
    usual = path == DEFAULT_CONFIG
    plugd = "plugd" if usual else f"plugd -c {path}"
    served = usual and any(unit.exists() for unit in UNITS)
    run = "sudo systemctl enable --now plugd" if served else f"{plugd} run"
    print(f"Next: `{plugd} check --click` switches the plug on and off once; then `{run}`.")
    return 0
