"""`plugd dump`."""

import argparse
import json

from plugd.cli.parsing import Commands, config_path


def add(commands: Commands) -> None:
    """Configuration and state for a bug report."""
    commands.add("dump", _dump, "configuration and state for a bug report, without secrets")


def _dump(options: argparse.Namespace) -> int:
    from plugd.adapters.clock import utc_now
    from plugd.config import load
    from plugd.dump import dumped

    print(json.dumps(dumped(load(config_path(options)), utc_now()), indent=1))
    return 0
