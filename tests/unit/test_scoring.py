"""The score: the same half hours for all, a day at a time, nothing before its measured values stand."""

from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta

import pytest

from plugd.domain import Forecast, Intensity
from plugd.ports import Tally
from plugd.scoring import NESO, OURS, PERSISTENCE, SETTLED, Scoring, lines, summed, tallies
from plugd.units import HALF_HOUR

DAY = date(2023, 3, 14)
MIDNIGHT = datetime(2023, 3, 14, tzinfo=UTC)
SLOTS = [MIDNIGHT + k * HALF_HOUR for k in range(-5 * 48, 48)]
TRUE = {slot: 100.0 + 10.0 * slot.day for slot in SLOTS}
"""Each day 10 g/kWh dirtier than the one before: persistence is 10 too low a day."""


def issued(at: datetime, hours: int = 48, off: float = 20.0) -> Forecast:
    rows = (at + k * HALF_HOUR for k in range(2 * hours))
    return Forecast(at, "national", tuple(Intensity(slot, TRUE.get(slot, 0.0) + off) for slot in rows))


def nothing(_: datetime) -> dict[datetime, float]:
    return {}


def by_whom(found: tuple[Tally, ...]) -> dict[tuple[str, int], tuple[int, float, float]]:
    return {(t.who, t.from_h): (t.half_hours, t.absolute / t.half_hours, t.signed / t.half_hours) for t in found}


def test_all_three_are_held_to_the_same_half_hours() -> None:

    def ours(at: datetime) -> dict[datetime, float]:
        return {slot: TRUE[slot] - 5.0 for slot in SLOTS[-48:]} if at == MIDNIGHT else {}

    short = issued(MIDNIGHT, hours=14)  # the last two of the twelve hours from 12 on are beyond it
    found = by_whom(tallies([short], ours, TRUE, DAY))
    assert found[NESO, 0] == (12, 20.0, 20.0)
    assert found[OURS, 0] == (12, 5.0, -5.0)
    assert found[PERSISTENCE, 0] == (12, 10.0, -10.0)
    assert {found[who, 12][0] for who in (NESO, OURS, PERSISTENCE)} == {4}


def test_persistence_takes_the_last_day_that_was_known_when_it_was_issued() -> None:
    found = by_whom(tallies([issued(MIDNIGHT - timedelta(days=1))], nothing, TRUE, DAY))
    assert found[PERSISTENCE, 24][1:] == (20.0, -20.0)
    late = issued(MIDNIGHT + timedelta(hours=1))
    assert by_whom(tallies([late], nothing, TRUE, DAY))[PERSISTENCE, 0][1] == 10.0


def test_beyond_the_sources_end_plugds_own_is_scored_too() -> None:
    at = MIDNIGHT - timedelta(days=3)
    found = by_whom(tallies([issued(at)], lambda _: dict.fromkeys(SLOTS, 0.0), TRUE, DAY))
    assert (OURS, 48) in found
    assert (NESO, 48) not in found


def test_days_add_up() -> None:
    one = tallies([issued(MIDNIGHT, off=10.0)], nothing, TRUE, DAY)
    other = tallies([issued(MIDNIGHT, off=-30.0)], nothing, TRUE, DAY)
    near = summed((*one, *other))[NESO][0]
    assert (near.count, near.mean_abs_g_per_kwh, near.bias_g_per_kwh) == (24, 20.0, -10.0)
    assert near.mean_abs_pct == pytest.approx(100.0 * 20.0 / 240.0)
    assert lines(summed(())) == []
    assert lines(summed(one))[-1].split() == [
        "12",
        "to",
        "24",
        "h",
        "-",
        "10",
        "11",
    ]  # two hours of yesterday were not known yet


@dataclass(slots=True)
class Shelf:
    """What was said and measured, and the scores."""

    days: list[date] = field(default_factory=list)

    def issued(self, since: datetime) -> list[Forecast]:
        """One every six hours."""
        return [issued(at) for at in SLOTS[::12] if at >= since]

    def measured(self, since: datetime) -> tuple[Intensity, ...]:
        """All of it."""
        return tuple(Intensity(slot, g) for slot, g in TRUE.items() if slot >= since)

    def outlook(self, at: datetime) -> dict[datetime, float]:
        """None."""
        return nothing(at)

    def scored(self) -> date | None:
        """The last one."""
        return self.days[-1] if self.days else None

    def score(self, day: date, found: object) -> None:
        """Keep."""
        self.days.append(day)


def test_a_day_is_scored_once_when_its_measured_values_stand_and_a_week_is_made_up_for() -> None:
    shelf = Shelf()
    scoring = Scoring(shelf)
    now = MIDNIGHT + timedelta(days=1) + SETTLED - timedelta(minutes=1)
    while now < MIDNIGHT + timedelta(days=3) + SETTLED:
        scoring.step(now)
        if now < MIDNIGHT + timedelta(days=1) + SETTLED:
            assert DAY not in shelf.days
        assert scoring.at is not None
        now = scoring.at
    assert shelf.days == [DAY + timedelta(days=k) for k in range(-7, 2)]
