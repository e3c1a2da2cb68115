"""The table of docs/reliability.md in figures: runs every program of it and prints, at the end, what each came to.

python -m tests.chaos_table [-- ARGS of the nights]         STORE in the environment goes to the store's program
"""

import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """What is promised, the module that shows it, and where its last words hold the figures."""

    promise: str
    module: str
    arguments: tuple[str, ...]
    figures: str
    """A pattern that must be found in what it printed; what it matches stands in the table."""


def rows(nights: list[str], store: list[str]) -> tuple[Row, ...]:
    """The programs, in the order in which they run."""
    return (
        Row("fuzz: all that others write", "tests.fuzz_parsers", ("--inputs", "60000", "--seed", "9"),
            r"(?m)^fuzz: (\d+ inputs .*)$"),
        Row("fuzz: what plugs say", "tests.fuzz_plugs", ("--payloads", "100000", "--seed", "9"),
            r"(?m)^\d+ payloads .*$"),
        Row("fuzz: frames on CAN", "tests.fuzz_can", ("100000", "9"), r"(?m)^\d+ frames, .*? no crash"),
        Row("it does not grow", "tests.soak", (), r"(?m)^soak: (.*)$"),
        Row("it spares the card", "", (), r"(?m)^card: (.*)$"),
        Row("the store: kills, failing calls", "tests.chaos_store", tuple(store), r"(?m)^store: (.*)$"),
        Row("the broker killed", "tests.broker_kills", (), r"(?m)^broker: (.*)$"),
        Row("faults and pairs that kept every promise", "tests.chaos", tuple(nights),
            r"(?m)^(?:\w+ +\d+ of \d+|mornings judged: \d+)"),
    )  # fmt: skip


def main() -> int:
    """Exit 0: each program did, and printed its figures."""
    nights, store = sys.argv[1:], shlex.split(os.environ.get("STORE", ""))
    nights = nights[nights.index("--") + 1 :] if "--" in nights else nights
    said, table, failed = "", [], 0
    for row in rows(nights, store):
        if row.module:
            said, code = _ran([sys.executable, "-m", row.module, *row.arguments])
            failed += code != 0
        figures: list[str] = re.findall(row.figures, said)
        failed += not figures
        table.append((row.promise, "; ".join(" ".join(one.split()) for one in figures) or "NOTHING WAS SAID"))
    print("\n| what | figures |\n|---|---|")
    for promise, figures_said in table:
        print(f"| {promise} | {figures_said} |")
    print(f"{'FAILED' if failed else 'all kept'}")
    return int(failed > 0)


def _ran(command: list[str]) -> tuple[str, int]:
    """What it printed, which is shown as it comes, and how it ended."""
    lines = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            print(line, end="", flush=True)
            lines.append(line)
    return "".join(lines), process.returncode


if __name__ == "__main__":
    sys.exit(main())
