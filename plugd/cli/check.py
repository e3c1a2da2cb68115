"""`plugd check`."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from plugd.cli.parsing import Commands, config_path

if TYPE_CHECKING:
    from plugd.config import Config


def add(commands: Commands) -> None:
    """What works, and what is to be mended."""
    check = commands.add("check", _check, "configuration, broker, plug, forecast, clock, disk: ok, or what to mend")
    check.add_argument("--click", action="store_true", help="also switch on, look at the power, switch off")


def _check(options: argparse.Namespace) -> int:
    from plugd.config import load

    path = config_path(options)
    return 0 if told(load(path), path, options.click) else 1


def told(config: "Config", path: Path, click: bool) -> bool:
    """Print each finding as it comes. Returns whether all is well."""
    from plugd.config import doubts
    from plugd.inspection import check

    doubted = doubts(config)
    print(f"{_word(not doubted)} configuration: {'; '.join([str(path), *doubted])}")
    good = not doubted
    for finding in check(config, click=click):
        good = good and finding.ok
        print(f"{_word(finding.ok)} {finding.what}: {finding.text}", flush=True)
    return good


def _word(ok: bool) -> str:
    return "ok   " if ok else "MEND "
