"""What one design choice is worth: a charger that takes any power or a relay, with and without the end value."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import product
from typing import Any

from plugd.domain import Capability, Household
from plugd.study import table
from plugd.study.engine import Account
from plugd.study.forecasts import Noise
from plugd.study.measured import Measured
from plugd.study.runs import PAPER, Failure, Run, paper_run
from plugd.study.table import Choice

POWERS_KW = (10.0, 2.3)


@dataclass(frozen=True, slots=True)
class Variant:
    """One way to build it."""

    power_kw: float
    modulating: bool
    end_value: bool

    @property
    def household(self) -> Household:
        """The paper's, with this plug."""
        return replace(PAPER, capability=Capability(self.power_kw, modulating=self.modulating))

    def row(self) -> dict[str, Any]:
        """For programs."""
        return {
            "power_kw": self.power_kw,
            "plug": "charger" if self.modulating else "relay",
            "end_value": "on" if self.end_value else "off",
        }


VARIANTS = tuple(Variant(*chosen) for chosen in product(POWERS_KW, (True, False), (True, False)))


def runs(
    found: Measured, start: datetime, end: datetime, horizons: Iterable[int], noise: Noise, seeds: int
) -> Iterator[tuple[Variant, Run]]:
    """Every variant with every horizon, beside uncontrolled charging at the same power."""
    chosen = [Choice(table.BASE), *(Choice("mpc", horizon) for horizon in horizons)]
    for variant, choice, seed in product(VARIANTS, chosen, range(seeds)):
        house, value = variant.household, variant.end_value
        yield variant, paper_run(
            choice.name, found, start, end, horizon=choice.horizon, seed=seed, noise=noise, end_value=value,
            household=house,
        )  # fmt: skip


def rows(outcomes: Iterable[tuple[Variant, Run, Account | Failure]]) -> list[dict[str, Any]]:
    """A row a variant and horizon."""
    of: dict[Variant, list[tuple[Run, Account | Failure]]] = {}
    for variant, run, outcome in outcomes:
        of.setdefault(variant, []).append((run, outcome))
    return [
        {**variant.row(), **row}
        for variant, found in of.items()
        for row in table.document(table.tabulated(*zip(*found, strict=True)))["rows"]
        if row["strategy"] != table.BASE
    ]
