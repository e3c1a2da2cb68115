"""A broken API costs no morning, and little more carbon than knowing no forecast; `make broken` runs all."""

from pathlib import Path

import pytest

from plugd import series
from plugd.series import IntensitySeries
from tests.broken_api import FAULTS, Outcome, broken, by_climatology

DAYS = 7


@pytest.fixture(scope="module")
def grid(neso_data: Path) -> IntensitySeries:
    """GB in 2023."""
    return series.load(neso_data / "neso_national_2023.csv").held()


@pytest.fixture(scope="module")
def usual(grid: IntensitySeries) -> Outcome:
    """What each night needs in the hours that are cheapest by climatology."""
    return by_climatology(grid, DAYS)


@pytest.mark.parametrize("name", ["nothing for five days", "ten times too much"])
def test_mornings_are_kept_and_carbon_is_that_of_the_usual_day_at_worst(
    name: str, grid: IntensitySeries, usual: Outcome
) -> None:
    found = broken(grid, FAULTS[name], DAYS)
    assert found.missed == usual.missed == 0
    assert found.g_per_kwh <= 1.02 * usual.g_per_kwh
    assert "forecast" in found.faults
