"""`plugd run`."""

import argparse

from plugd.cli.parsing import Commands, config_path


def add(commands: Commands) -> None:
    """The daemon."""
    commands.add("run", _run, "the daemon")


def _run(options: argparse.Namespace) -> int:
    from plugd import daemon
    from plugd.adapters.clock import SystemClock, unset
    from plugd.config.handed import load

    clock = SystemClock()
    try:
        daemon.run(load(config_path(options)), clock, unset)
    finally:
        clock.close()
    return 0
