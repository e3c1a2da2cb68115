"""`plugd check`."""

import argparse

from plugd.cli.parsing import Commands, config_path


def add(commands: Commands) -> None:
    """What works, and what is to be mended."""
    check = commands.add("check", _check, "configuration, broker, plug, forecast, clock, disk: ok, or what to mend")
    check.add_argument("--click", action="store_true", help="also switch on, look at the power, switch off")


def _check(options: argparse.Namespace) -> int:
    from plugd.config import load
    from plugd.inspection import check

    path = config_path(options)
    config = load(path)
    print(f"ok    configuration: {path}")
    good = True
    for finding in check(config, click=options.click):
        good = good and finding.ok
        print(f"{'ok   ' if finding.ok else 'MEND '} {finding.what}: {finding.text}")
    return 0 if good else 1
