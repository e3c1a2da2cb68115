"""`plugd report`."""

import argparse
import json
from pathlib import Path

from plugd.cli.parsing import Commands, config_path, progress
from plugd.errors import PlugdError, UsageError


def add(commands: Commands) -> None:
    """What was charged."""
    report = commands.add("report", _report, "what was charged, how clean it was, and what it is compared with")
    report.add_argument("--days", type=int, default=30, help="how many nights (default 30)")
    report.add_argument("--out", type=Path, metavar="FILE", help="an HTML page that needs nothing else")
    as_text = report.add_mutually_exclusive_group()
    as_text.add_argument("--json", action="store_true", help="one JSON document")
    as_text.add_argument("--csv", action="store_true", help="one line a night")
    report.add_argument(
        "--horizons", type=_counts, metavar="N,N", help="replay with these; a page and JSON have 1,2,4,7 by themselves"
    )


def _counts(text: str) -> tuple[int, ...]:
    """Horizons from "1,2,4"."""
    found = tuple(int(part) for part in text.split(","))
    if not all(1 <= count <= 7 for count in found):
        raise ValueError(text)
    return found


def _report(options: argparse.Namespace) -> int:
    from plugd import report
    from plugd.config import load

    if options.days < 1:
        raise UsageError(f"--days {options.days}: choose at least 1")
    config = load(config_path(options))
    whole = options.json or options.out is not None
    horizons = report.HORIZONS if options.horizons is None and whole else options.horizons or ()
    found = report.gathered(config, options.days, horizons, progress)
    if options.out is not None:
        from plugd.report_page import page

        try:
            options.out.write_text(page(found), encoding="utf-8")
        except OSError as error:
            raise PlugdError(f"{options.out}: cannot be written ({error.strerror}); name another with --out") from error
        if not options.json:
            print(f"{options.out}: {report.headline(found)}")
    if options.json:
        print(json.dumps(report.document(found), allow_nan=False))
    elif options.csv:
        print(report.table(found), end="")
    elif options.out is None:
        print("\n".join(report.lines(found)))
    return 0
