"""The program. See the package."""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import combinations
from random import Random

from tests.chaos.night import Outcome, lived, single
from tests.chaos.troubles import TROUBLES

Job = tuple[int, tuple[int, ...]]
"""A seed and the places of the troubles in the table."""


ONE_LIE_TOO_MANY = (("lies on", "power nonsense"), ("lies on", "power negative"))
"""A relay that lies, beside a meter that says nothing of power: that is as when a person switches it off."""


def jobs(nights: int, pairs: int, seed: int) -> Iterator[Job]:
    """Nights with one trouble after the other of the table, every fourth without; then nights with two."""
    for k in range(nights):
        yield seed + k, () if k % 50 == 0 else (k % len(TROUBLES),)
    every = [
        (a, b) for a, b in combinations(range(len(TROUBLES)), 2)
        if (TROUBLES[a].name, TROUBLES[b].name) not in ONE_LIE_TOO_MANY
    ]  # fmt: skip
    dice = Random(f"pairs {seed}")
    dice.shuffle(every)
    for k in range(pairs):
        yield seed + nights + k, every[k % len(every)]


def work(job: Job) -> Outcome:
    """One night."""
    seed, places = job
    return lived(seed, tuple(TROUBLES[place] for place in places))


def main() -> int:
    """Exit 0: every promise was kept in every night."""
    p = argparse.ArgumentParser(prog="python -m tests.chaos")
    p.add_argument("--nights", type=int, default=2000)
    p.add_argument("--pairs", default="500", help="how many, or `all`")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--jobs", type=int, default=2)
    options = p.parse_args()
    every = len(TROUBLES) * (len(TROUBLES) - 1) // 2 - len(ONE_LIE_TOO_MANY)
    pairs = every if options.pairs == "all" else int(options.pairs)
    began, found, bad = time.monotonic(), Counter[str](), Counter[str]()
    judged = 0
    for trouble in TROUBLES:
        outcome, _ = single(trouble)
        found["single"] += 1
        if outcome.objections:
            bad["single"] += 1
            print(f"FAIL single {trouble.name}: {'; '.join(outcome.objections)}")
    with ProcessPoolExecutor(options.jobs) as pool:
        for outcome in pool.map(partial(work), jobs(options.nights, pairs, options.seed), chunksize=20):
            if sum(found.values()) % 250 == 0:
                print(f"{sum(found.values())} nights, {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
            kind = ("calm", "nights", "pairs")[len(outcome.faults)]
            found[kind] += 1
            judged += outcome.judged
            if outcome.objections:
                bad[kind] += 1
                said = "; ".join(outcome.objections)
                print(f"FAIL seed {outcome.seed} {' + '.join(outcome.faults)}: {said}", flush=True)
    for kind, tried in found.items():
        print(f"{kind:8} {tried - bad[kind]} of {tried} kept every promise")
    print(f"mornings judged: {judged}; {time.monotonic() - began:.0f} s")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
