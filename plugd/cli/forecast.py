"""`plugd forecast`."""

import argparse
import json
import sys

from plugd.cli.parsing import Commands, config_path


def add(commands: Commands) -> None:
    """The outlook now."""
    forecast = commands.add("forecast", _forecast, "what is expected of the grid, and where each number is from")
    forecast.add_argument("--json", action="store_true", help="one JSON document")


def _forecast(options: argparse.Namespace) -> int:
    from plugd import foresight
    from plugd.config import load

    found = foresight.now(load(config_path(options)))
    if options.json:
        print(json.dumps(foresight.document(found), allow_nan=False))
        return 0
    try:
        foresight.LEGEND.encode(sys.stdout.encoding or "ascii")
        plain = False
    except UnicodeEncodeError:
        plain = True
    print("\n".join(foresight.lines(found, plain)))
    return 0
