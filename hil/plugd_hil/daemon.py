"""The daemon itself on simulated time: `plugd run` with another clock, and nothing else."""

import argparse
import logging
import sys
from pathlib import Path

from plugd import daemon
from plugd.config.handed import load
from plugd.errors import PlugdError
from plugd_hil.conductor import Participant


def main() -> int:
    """Run until told to end."""
    parser = argparse.ArgumentParser(prog="plugd_hil.daemon", description=__doc__)
    parser.add_argument("-c", "--config", type=Path, required=True)
    parser.add_argument("--clock", required=True, metavar="HOST:PORT")
    parser.add_argument("--look", type=float, metavar="S", help="the longest wait (default: as long as nothing is due)")
    options = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="%(name)s: %(message)s")
    host, port = options.clock.rsplit(":", 1)
    clock = Participant(host, int(port), "plugd", options.look)
    try:
        daemon.run(load(options.config), clock)
    except PlugdError as error:
        print(f"plugd: {error}", file=sys.stderr)
        return 1
    finally:
        clock.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
