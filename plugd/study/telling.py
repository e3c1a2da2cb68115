"""What every experiment's command shares: where its runs are simulated, and how its numbers are told."""

import argparse
import csv
import json
import os
import sys
import time
from collections.abc import Iterable, Sequence
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from plugd.errors import PlugdError
from plugd.study.cluster import Cluster
from plugd.study.engine import Account
from plugd.study.runs import Failure, Run, perform, pool

BAR = 30
MAX_HORIZON = 7
"""Nights that can be planned together."""


def shared(parser: argparse.ArgumentParser, written: str = "the numbers, as CSV and JSON") -> None:
    """The arguments that every experiment with runs has."""
    add = parser.add_argument
    add("--workers", type=positive, default=min(2, os.cpu_count() or 1), metavar="N", help="processes")
    add("--dask", metavar="ADDRESS", help="simulate on the Dask cluster at tcp://HOST:PORT instead")
    answers(parser, written)


def answers(parser: argparse.ArgumentParser, written: str) -> None:
    """How an experiment answers."""
    parser.add_argument("--json", action="store_true", help="one JSON document")
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"also write there {written}")


def positive(text: str) -> int:
    """A whole number above 0."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return int(text)


def horizons(text: str) -> tuple[int, ...]:
    """A list of numbers of nights."""
    words = [word.strip() for word in text.split(",")]
    if bad := [word for word in words if not (word.isdecimal() and 1 <= int(word) <= MAX_HORIZON)]:
        raise argparse.ArgumentTypeError(f"{bad[0]!r} is not 1 to {MAX_HORIZON} nights")
    return tuple(dict.fromkeys(map(int, words)))


def day(text: str) -> date:
    """A date."""
    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no date; write it as 2023-01-31") from error


def performed(runs: Sequence[Run], options: argparse.Namespace) -> list[Account | Failure]:
    """All runs on a process pool or a cluster, with a bar on stderr where somebody looks; failures are told there."""
    make = partial(Cluster, options.dask) if options.dask else partial(pool, min(options.workers, len(runs)))
    outcomes = perform(runs, make, _bar if sys.stderr.isatty() else _silent)
    for outcome in outcomes:
        if isinstance(outcome, Failure):
            print(f"plugd: {outcome}", file=sys.stderr)
    return outcomes


def _bar(done: int, of: int) -> None:
    full = BAR * done // max(1, of)
    print(
        f"\r[{'#' * full}{'.' * (BAR - full)}] {done} of {of} runs",
        end="" if done < of else "\n",
        file=sys.stderr,
        flush=True,
    )


def _silent(done: int, of: int) -> None:
    """Nobody looks."""


def code(outcomes: Sequence[Account | Failure]) -> int:
    """The exit code: 1 where a run failed."""
    return int(any(isinstance(outcome, Failure) for outcome in outcomes))


def since(began: float) -> float:
    """Seconds of `time.perf_counter` since `began`."""
    return round(time.perf_counter() - began, 2)


def tell(
    options: argparse.Namespace,
    name: str,
    document: dict[str, Any],
    shown: Sequence[str],
    rows: Sequence[dict[str, Any]] | None = None,
) -> None:
    """Numbers to stdout, and to files where asked. `rows` are the lines of the CSV file, else the document's."""
    if options.out is not None:
        written(options.out, name, document, rows)
    if options.json:
        print(json.dumps(document, allow_nan=False))
        return
    for line in shown:
        print(line)


def written(folder: Path, name: str, document: dict[str, Any], rows: Sequence[dict[str, Any]] | None = None) -> None:
    """`name`.json with all of a document, `name`.csv with its rows. Raises PlugdError."""
    if rows is None:
        rows = [*document["rows"], *({"strategy": "perfect", **row} for row in document["perfect"])]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.json").write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
        with (folder / f"{name}.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise PlugdError(f"--out {folder}: cannot be written ({error.strerror}); name another folder") from error


def columns(rows: Iterable[Sequence[object]]) -> list[str]:
    """Rows for people, the first column to the left and the others to the right; None is `-`."""
    cells = [["-" if cell is None else str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return ["  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]).rstrip() for line in cells]
