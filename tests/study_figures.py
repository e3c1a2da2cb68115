"""The study's commands on measured intensity, with two seeds. Fails where a figure leaves its tolerance.

Reductions against charging on arrival, in per cent. REFERENCE: an independent calculation with a linear programme
(docs/study.md), within 1.5 points for a year of the nation and 2 for a fortnight of the regions. LEAST: what the end
value must bring at least. No longer horizon may be worse than a shorter one by more than 0.3 points, no year may miss
more than two mornings, and OSQP must charge with the same carbon as the exact solver within 0.1 %.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

DATA = Path(os.environ.get("PLUGD_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
NATION = ("table", "--actual", str(DATA / "neso_national_2023.csv"))
HOURLY = ("table", "--actual", str(DATA / "gb_actual_hourly_2020_2023.csv"), "--year", "2022")
BORROWED = ("--error-from", str(DATA / "neso_national_2023.csv"))
REGIONS = ("regions", "--actual", str(DATA / "neso_regional_2023-03.csv"))
OFF = ("--end-value", "off")

REFERENCE: tuple[tuple[str, tuple[str, ...], dict[int, float], float], ...] = (
    ("2023", (*NATION, *OFF), {1: 24.4, 2: 37.8, 4: 41.4, 7: 41.6}, 1.5),
    ("2022", (*HOURLY, *BORROWED, *OFF), {1: 18.3, 2: 31.2, 4: 35.0, 7: 35.0}, 1.5),
    ("regions", REGIONS, {1: 40.0, 2: 53.1, 4: 55.5}, 2.0),
)
LEAST = {1: 35.5, 2: 39.5, 4: 41.0}
LONGER_MAY_LOSE = 0.3
MISSED_A_YEAR = 2
SOLVERS_AGREE = 1e-3


def asked(*arguments: str, seeds: int = 2) -> dict[str, Any]:
    """What the study answers."""
    command = [sys.executable, "-m", "plugd", "study", *arguments, "--seeds", str(seeds), "--json"]
    found: dict[str, Any] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    return found


def reductions(found: dict[str, Any]) -> dict[int, float]:
    """By horizon; of regions their mean."""
    rows = found.get("means", found["rows"])
    return {row["horizon"]: row["reduction_pct"] for row in rows if row["strategy"] == "mpc"}


def missed(found: dict[str, Any]) -> int:
    """The most that a strategy missed in all its seeds."""
    return max(int(row["missed_mornings"]) for row in found["rows"])


def told(name: str, found: dict[str, Any], kept: bool) -> bool:
    """Say it; returns `kept`."""
    cuts = ", ".join(f"N={n} {cut:.2f} %" for n, cut in reductions(found).items())
    sys.stdout.write(f"{'ok  ' if kept else 'FAIL'} {name}: {cuts}; {missed(found)} missed; {found['wall_s']:.0f} s\n")
    sys.stdout.flush()
    return kept


def as_in_the_reference(name: str, arguments: tuple[str, ...], reference: dict[int, float], points: float) -> bool:
    """One line of the table."""
    found = asked(*arguments)
    cuts = reductions(found)
    near = all(abs(cuts[n] - cut) <= points for n, cut in reference.items())
    return told(name, found, near and missed(found) <= 2 * MISSED_A_YEAR)


def with_the_end_value() -> bool:
    """What it brings, and that planning further never harms."""
    found = asked(*NATION)
    cuts = list(reductions(found).values())
    ordered = all(b >= a - LONGER_MAY_LOSE for k, a in enumerate(cuts) for b in cuts[k:])
    enough = all(reductions(found)[n] >= least for n, least in LEAST.items())
    return told("2023, end value on", found, ordered and enough and missed(found) <= 2 * MISSED_A_YEAR)


def by_every_solver() -> bool:
    """OSQP beside the exact solver, one seed."""
    chosen = (*NATION, *OFF, "--strategies", "1,2,4")
    exact, osqp = (asked(*chosen, "--solver", solver, seeds=1) for solver in ("exact", "osqp"))
    pairs = zip(exact["rows"], osqp["rows"], strict=True)
    same = all(abs(b["carbon_g_per_kwh"] / a["carbon_g_per_kwh"] - 1.0) <= SOLVERS_AGREE for a, b in pairs)
    return told("2023, one seed, osqp", osqp, same)


def main() -> int:
    """Run all; returns the exit status."""
    kept = [as_in_the_reference(*line) for line in REFERENCE]
    kept += [with_the_end_value(), by_every_solver()]
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main())
