"""The outlook on forecasts as NESO really issued them, 14 and 15 March 2023, with nothing known that was not then."""

from collections import defaultdict
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from plugd import outlook, series
from plugd.domain import Forecast, Intensity, SlotSource
from plugd.past import HISTORY
from plugd.series import IntensitySeries
from plugd.units import HALF_HOUR, hours, slot_start
from plugd_hil.neso_source import Snapshot, from_folder

BLOCK_H = 6
PUBLISHED = timedelta(hours=1)
"""A measured value appears so long after its half hour."""


@dataclass(frozen=True, slots=True)
class Known:
    """Everything that was known at a stamp."""

    now: datetime
    forecast: Forecast
    earlier: tuple[Forecast, ...]
    history: tuple[Intensity, ...]


class Later(AssertionError):
    """Something was asked that nobody knew yet."""


def measured(grid: IntensitySeries, slot: datetime, now: datetime) -> float | None:
    """What had been published of a half hour by `now`."""
    if slot + HALF_HOUR + PUBLISHED > now:
        raise Later(f"{slot} at {now}")
    return grid.actual_at(slot)


def issued(snapshot: Snapshot) -> Forecast:
    """A snapshot as the daemon would have it: from the half hour under way on."""
    grid, first = snapshot.regions[None], slot_start(snapshot.stamp)
    rows = ((slot, grid.forecast_at(slot)) for slot in grid.times() if slot >= first)
    return Forecast(snapshot.stamp, "national", tuple(Intensity(slot, g) for slot, g in rows if g is not None))


def known_at(snapshot: Snapshot, earlier: list[Forecast], grid: IntensitySeries) -> Known:
    """What was known at a snapshot's stamp."""
    now = snapshot.stamp
    last = slot_start(now - PUBLISHED) - HALF_HOUR
    slots = (last - k * HALF_HOUR for k in range(HISTORY // HALF_HOUR - 1, -1, -1))
    history = tuple(Intensity(s, g) for s in slots if (g := measured(grid, s, now)) is not None)
    return Known(now, issued(snapshot), tuple(earlier), history)


def ours(known: Known) -> dict[datetime, float]:
    """What plugd makes of it, where the forecast says something."""
    learned = outlook.replayed(known.earlier, known.history, known.now)
    until = known.forecast.expected[-1].start + HALF_HOUR
    found = outlook.extend(known.forecast, known.history, known.now, until, learned)
    return {slot.start: slot.g_per_kwh for slot in found.slots if slot.source is not SlotSource.TAIL}


@pytest.fixture(scope="module")
def errors(neso_data: Path) -> dict[int, list[tuple[float, float]]]:
    """By block of hours ahead: how far off the raw forecast was, and plugd's outlook."""
    grid = series.load(neso_data / "neso_national_2023.csv")
    found: dict[int, list[tuple[float, float]]] = defaultdict(list)
    earlier: list[Forecast] = []
    for snapshot in from_folder(neso_data / "neso_fw48h").snapshots:
        if None not in snapshot.regions:
            continue
        known = known_at(snapshot, earlier, grid)
        said = ours(known)
        for row in known.forecast.expected:
            true = grid.actual_at(row.start)
            if true is not None:
                lead_h = hours(row.start - slot_start(known.now))
                block = int(lead_h // BLOCK_H) * BLOCK_H
                found[block].append((abs(row.g_per_kwh - true), abs(said[row.start] - true)))
        earlier.append(known.forecast)
    return found


def mean(pairs: list[tuple[float, float]], k: int) -> float:
    """Of the raw (0) or our (1) errors."""
    return sum(pair[k] for pair in pairs) / len(pairs)


def test_at_no_distance_it_is_further_off_than_the_raw_forecast(errors: dict[int, list[tuple[float, float]]]) -> None:
    assert sorted(errors) == list(range(0, 48, BLOCK_H))
    for block, pairs in errors.items():
        assert mean(pairs, 1) <= 1.03 * mean(pairs, 0), f"{block} h ahead"


def test_over_all_it_is_nearer(errors: dict[int, list[tuple[float, float]]]) -> None:
    every = [pair for pairs in errors.values() for pair in pairs]
    assert len(every) > 1000
    assert mean(every, 1) < 0.95 * mean(every, 0)


def test_what_was_not_published_yet_cannot_be_asked(neso_data: Path) -> None:
    grid = series.load(neso_data / "neso_national_2023.csv")
    now = datetime.fromisoformat("2023-03-14T03:31Z")
    assert measured(grid, now - timedelta(minutes=91), now) is not None
    with pytest.raises(Later):
        measured(grid, now - timedelta(minutes=80), now)
