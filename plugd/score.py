"""How good the forecasts were: each one as issued, against what was measured, by how far it looked ahead."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

from plugd.domain import Forecast, Intensity
from plugd.units import hours

LEADS_H = (0, 6, 12, 24, 36, 48, 96)
"""Where one step of looking ahead ends and the next begins."""


@dataclass(frozen=True, slots=True)
class LeadScore:
    """Errors (forecast less measured) of all half hours forecast `from_h` to `to_h` hours ahead."""

    from_h: int
    to_h: int
    count: int
    mean_abs_g_per_kwh: float
    bias_g_per_kwh: float
    mean_abs_pct: float


def scores(forecasts: Iterable[Forecast], measured: Iterable[Intensity]) -> tuple[LeadScore, ...]:
    """One score a step of looking ahead, none for a step of which nothing is known."""
    true = {value.start: value.g_per_kwh for value in measured}
    sums: dict[tuple[int, int], list[float]] = defaultdict(lambda: [0.0] * 4)
    steps = tuple(pairwise(LEADS_H))
    for forecast in forecasts:
        for row in forecast.expected:
            actual = true.get(row.start)
            lead_h = hours(row.start - forecast.issued_at)
            step = next((step for step in steps if step[0] <= max(lead_h, 0.0) < step[1]), None)
            if actual is None or step is None:
                continue
            error = row.g_per_kwh - actual
            for k, more in enumerate((1.0, abs(error), error, actual)):
                sums[step][k] += more
    return tuple(_score(step, *sums[step]) for step in steps if step in sums)


def _score(step: tuple[int, int], count: float, absolute: float, signed: float, level: float) -> LeadScore:
    return LeadScore(
        *step,
        count=int(count),
        mean_abs_g_per_kwh=absolute / count,
        bias_g_per_kwh=signed / count,
        mean_abs_pct=100.0 * absolute / level if level > 0.0 else 0.0,
    )
