"""`plugd demo` and `plugd study`, which read their own arguments."""

import argparse
import os
import sys
from contextlib import closing
from datetime import date
from importlib.util import find_spec
from typing import TYPE_CHECKING

from plugd.cli.parsing import Commands, Parser, configured, progress
from plugd.errors import PlugdError

if TYPE_CHECKING:
    from plugd.series import IntensitySeries


def add(commands: Commands) -> None:
    """Both."""
    commands.add_apart("demo", _demo, "the daemon against a stub plug, a week in a minute")
    commands.add_apart("study", _study, "the paper's experiments and ours; `plugd study -h` lists them")


def _demo(options: argparse.Namespace) -> int:
    """Hand over to the bench, which is a program of its own."""
    missing = [name for name in ("plugd_hil", "rich") if find_spec(name) is None]
    if missing:
        raise PlugdError(f"the demo needs {' and '.join(missing)}: pip install 'plugd[demo]'")
    os.execv(sys.executable, [sys.executable, "-m", "plugd_hil.demo", *options.rest])


def _study(options: argparse.Namespace) -> int:
    from plugd.study import command

    def regions(since: date, until: date) -> dict[int, "IntensitySeries"]:
        from plugd import history
        from plugd.adapters.clock import SystemClock

        with closing(SystemClock()) as clock:
            return history.regions(configured(options), since, until, clock, progress)

    parser = Parser(prog="plugd study", description="The paper's experiments, and ours.")
    return command.main(parser, options.rest, regions)
