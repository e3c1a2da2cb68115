"""`plugd plug`."""

import argparse

from plugd.cli.parsing import Commands, config_path


def add(commands: Commands) -> None:
    """The plug by hand."""
    plug = commands.add("plug", _plug, "the plug by hand")
    by_hand = plug.add_subparsers(dest="do", required=True, metavar="DO")
    for name, text in (("show", "how it is"), ("on", "switch it on"), ("off", "switch it off, and leave it so")):
        by_hand.add_parser(name, help=text, description=text)
    amps = by_hand.add_parser("amps", help="a charger's current", description="A charger's current; 0 pauses it.")
    amps.add_argument("amps", type=float, metavar="N", help="amperes")


def _plug(options: argparse.Namespace) -> int:
    from plugd.config import load
    from plugd.inspection import switch

    print(switch(load(config_path(options)), options.do, getattr(options, "amps", None)))
    return 0
