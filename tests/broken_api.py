"""Weeks in the simulated house with an API that is broken: `python -m tests.broken_api` prints a table.

The stub's answers and faults and the daemon's own reading of them, without a network between. The yardstick is a
house that knows no forecast at all: it charges what each night needs in the hours that its last eight weeks make the
cheapest.
"""

import argparse
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from plugd import series
from plugd.adapters.neso_body import NATIONAL, parse, parse_past
from plugd.domain import Forecast, Household, Intensity, Nights, PastRow, RelayRules
from plugd.errors import ForecastUnavailable
from plugd.outlook import Learned
from plugd.past import HISTORY, CatchUp
from plugd.planner.exact import Exact
from plugd.series import IntensitySeries
from plugd.study.house import FunctionSource, House
from plugd.study.world import Driver
from plugd.units import HALF_HOUR, slot_start
from plugd_hil.neso_answers import answer_to
from plugd_hil.neso_faults import CONTENT, Answer, rows_in
from plugd_hil.neso_source import SeriesSource

HOME = Household(nights=Nights(), relay=RelayRules(random_delay_s=0.0))
START = datetime(2023, 3, 1, 12, tzinfo=UTC)
DAY = timedelta(days=1)
Fault = Callable[[timedelta], str | None]
"""What is wrong, by the time since the start."""


def tenth(answer: Answer) -> Answer:
    """All values a tenth of what they are."""
    rows = [
        {**row, "intensity": {**row["intensity"], "forecast": row["intensity"]["forecast"] // 10}}
        for row in rows_in(answer)
    ]
    return {"data": rows}


CONTENTS = {**CONTENT, "tenth": tenth}
FAULTS: dict[str, Fault] = {
    "nothing for five days": lambda since: "away" if DAY <= since < 6 * DAY else None,
    "nothing, ever": lambda since: "away",
    "29 of 96 slots": lambda since: "short29",
    "last week's answer": lambda since: "lastweek" if since >= DAY else None,
    "ten times too much": lambda since: "x10" if since >= DAY else None,
    "a tenth": lambda since: "tenth" if since >= DAY else None,
}


@dataclass(slots=True)
class Api:
    """The stub's answers, as the daemon reads them. Implements `plugd.ports.ForecastSource`."""

    source: SeriesSource
    fault: Fault
    start: datetime
    now: datetime = START
    region: str = NATIONAL
    measures: bool = True

    def fetch(self, now: datetime) -> Forecast:
        """The forecast, and what was measured of the last day. Raises ForecastError."""
        self.now, slot = now, slot_start(now)
        forecast = parse(self._answer(f"{slot:%Y-%m-%dT%H:%MZ}/fw48h", now), now, NATIONAL)
        rows = self.past(slot - timedelta(hours=26), slot)
        return replace(forecast, actual=tuple(Intensity(r.start, r.actual) for r in rows if r.actual is not None))

    def past(self, start: datetime, end: datetime) -> tuple[PastRow, ...]:
        """As the daemon's, by the time of the last forecast. Raises ForecastError."""
        return parse_past(
            self._answer(f"{start:%Y-%m-%dT%H:%MZ}/{end:%Y-%m-%dT%H:%MZ}", self.now), start, end, NATIONAL
        )

    def _answer(self, question: str, now: datetime) -> bytes:
        fault = self.fault(now - self.start)
        if fault == "away":
            raise ForecastUnavailable("the name api.carbonintensity.org.uk cannot be resolved; check network and DNS")
        answer = answer_to(f"/intensity/{question}", self.source, now)
        return json.dumps(CONTENTS[fault](answer) if fault else answer).encode()


@dataclass(slots=True)
class Climatology:
    """What the last eight weeks make of each half hour of the day, for as long as anybody asks."""

    grid: IntensitySeries
    made: dict[tuple[datetime, int], float] = field(default_factory=dict)

    def __call__(self, issued: datetime, slot: datetime) -> float:
        """The mean of that half hour of the day, over the days before today."""
        today = issued.replace(hour=0, minute=0, second=0, microsecond=0)
        key = today, (slot - today) // HALF_HOUR % 48
        if key not in self.made:
            same = (today + key[1] * HALF_HOUR - timedelta(days=day) for day in range(1, HISTORY.days + 1))
            values = [value for at in same if (value := self.grid.actual_at(at)) is not None]
            self.made[key] = sum(values) / len(values)
        return self.made[key]


@dataclass(frozen=True, slots=True)
class Outcome:
    """How the weeks went."""

    g_per_kwh: float
    kwh: float
    missed: int
    guarded: int
    faults: frozenset[str]


def lived(
    grid: IntensitySeries, household: Household, source: FunctionSource | Api, start: datetime, days: int
) -> Outcome:
    """The weeks in the house, with eight weeks of history behind it."""
    stays = Driver().stays(start)
    house = House(household, Exact(), source, stays, start, learned=Learned())
    house.store.keep_past(NATIONAL, _before(grid, start))
    if isinstance(source, Api):
        house.cycle.errands = (CatchUp(source, house.store, lambda: 0.0),)
    house.run(start + timedelta(days=days))
    carbon_g = sum(kwh * (grid.actual_at(slot) or 0.0) for slot, kwh in house.plug.flows.items())
    kwh = sum(house.plug.flows.values())
    missed = sum(morning.missed for morning in house.mornings)
    return Outcome(carbon_g / kwh, kwh, missed, len(house.guarded), frozenset(house.hub.faults))


def _before(grid: IntensitySeries, now: datetime) -> Iterator[PastRow]:
    """What had been measured by `now` of the eight weeks before."""
    slot = slot_start(now - HISTORY)
    while slot + HALF_HOUR + timedelta(hours=1) <= now:
        value = grid.actual_at(slot)
        if value is not None:
            yield PastRow(slot, None, value)
        slot += HALF_HOUR


def broken(grid: IntensitySeries, fault: Fault, days: int, start: datetime = START) -> Outcome:
    """The weeks with a fault of the API."""
    return lived(grid, HOME, Api(SeriesSource({None: grid}), fault, start), start, days)


def by_climatology(grid: IntensitySeries, days: int, start: datetime = START) -> Outcome:
    """The weeks with what each night needs in the hours that are cheapest by climatology."""
    one_night = replace(HOME, nights=replace(HOME.nights, horizon=1), end_value=False)
    return lived(grid, one_night, FunctionSource(Climatology(grid)), start, days)


def main() -> None:
    """Print the table; end with 1 where a promise is not kept."""
    parser = argparse.ArgumentParser(prog="tests.broken_api", description=__doc__)
    parser.add_argument("--days", type=int, default=14)
    parser.add_argument("--from", dest="start", type=datetime.fromisoformat, default=START)
    options = parser.parse_args()
    days, start = options.days, options.start
    grid = series.load(Path(os.environ["PLUGD_DATA"]) / "neso_national_2023.csv").held()
    usual = by_climatology(grid, days, start)
    rows = [("cheapest hours by climatology", usual), ("a sound API", broken(grid, lambda since: None, days, start))]
    rows += [(name, broken(grid, fault, days, start)) for name, fault in FAULTS.items()]
    for name, found in rows:
        more = 100.0 * (found.g_per_kwh / usual.g_per_kwh - 1.0)
        print(f"{name:<30} {found.g_per_kwh:6.1f} g/kWh {more:+6.1f} %  {found.kwh:6.1f} kWh  "
              f"{found.missed} missed  {found.guarded} guarded  {', '.join(sorted(found.faults))}")  # fmt: skip
    if any(found.missed or found.g_per_kwh > 1.02 * usual.g_per_kwh for _, found in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
