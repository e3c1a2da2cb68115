"""How fast forecast errors grow with the lead: the paper's λ̂ from forecasts as they were issued.

**Derivation.** The paper's model is `|ε[l]| = |ε[1]| (1 + λ (l − 1))`, l in half hours. Taking the mean over issues,
the MAPE obeys the same line: `MAPE[l] = MAPE[1] (1 + λ (l − 1))`. What is published is the MAPE of whole days, the mean
of 48 half hours: with m_d the middle of day d, `m_4 − m_1 = 3 · 48 = 144` half hours, and

    MAPE_4 / MAPE_1 = (1 + λ (m_4 − 1)) / (1 + λ (m_1 − 1)).

The simple rule takes day 1 as the one-step error (m_1 ≈ 1): `λ̂ = (MAPE_4 / MAPE_1 − 1) / 144`, for each zone, then the
mean over zones. It leaves out the growth within day 1, so that it is a little low: with m_1 = 24.5 instead, the line
through both days has `λ = r / (144 − 23.5 r)` with `r = MAPE_4 / MAPE_1 − 1`.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean

from plugd.errors import UsageError
from plugd.study import issued
from plugd.study.measured import LEAST_G_PER_KWH

FIRST_DAY, FOURTH_DAY = range(24), range(72, 96)
"""Leads in hours."""
APART = 144
"""Half hours from the middle of the first day to that of the fourth."""
WANTED = ("lead_h", "forecast", "actual")


def growth_per_half_hour(paths: Sequence[Path]) -> float:
    """λ̂ by the simple rule: the mean over files of issued forecasts, one a zone. Raises UsageError."""
    return fmean((mape(path, FOURTH_DAY) / mape(path, FIRST_DAY) - 1.0) / APART for path in paths)


def mape(path: Path, leads_h: range) -> float:
    """Mean absolute relative error of one zone's forecasts at these leads. Raises UsageError."""
    found = [abs(f - g) / max(g, LEAST_G_PER_KWH) for lead_h, f, g in rows(path) if lead_h in leads_h]
    if not found or not any(found):
        raise UsageError(f"{path}: no forecast errors at leads of {leads_h.start} to {leads_h.stop - 1} hours")
    return fmean(found)


def rows(path: Path) -> Iterable[tuple[int, float, float]]:
    """(lead in hours, forecast, actual) of a file `issued,lead_h,forecast,actual`. Raises UsageError."""
    return [issued.numbers(path, number, line) for number, line in issued.lines(path, WANTED)]
