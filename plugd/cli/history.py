"""`plugd history`."""

import argparse
from pathlib import Path

from plugd.cli.parsing import Commands, configured, day, progress
from plugd.errors import UsageError


def add(commands: Commands) -> None:
    """Fetch and show."""
    past = commands.add("history", _history, "past carbon intensity: fetch it, or show what is known")
    does = past.add_subparsers(dest="do", required=True, metavar="fetch|show")
    fetch = does.add_parser("fetch", help="from the API into the store, or a CSV file")
    fetch.add_argument("--from", dest="since", type=day, required=True, metavar="DATE")
    fetch.add_argument("--to", dest="until", type=day, required=True, metavar="DATE", help="not included")
    fetch.add_argument("--region", type=int, metavar="ID", help="1 to 17; default: the configured place, or the nation")
    fetch.add_argument("--out", type=Path, metavar="CSV", help="instead of the store; needs no configuration")
    does.add_parser("show", help="what the store knows")


def _history(options: argparse.Namespace) -> int:
    from plugd import history

    if options.do == "show":
        config = configured(options)
        if config is None:
            raise UsageError("history show: there is no configuration; name it with -c")
        print("\n".join(history.shown(config)))
        return 0
    print(history.fetch(configured(options), options.region, options.since, options.until, options.out, progress))
    return 0
