"""Nothing is decided on what was not known yet: a world that changes from some moment on is the same until then."""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from plugd import perception
from plugd.adapters.store import SqliteStore
from plugd.controller import Controller
from plugd.cycle import Cycle
from plugd.domain import Forecast, Household, Intensity, Outlook, PastRow, Plan, RelayRules
from plugd.outlook import Learned
from plugd.past import CatchUp
from plugd.planner.exact import Exact
from plugd.scoring import Scoring
from plugd.study.house import SimClock, SimHub, SimPlug
from plugd.study.world import Battery
from plugd.units import HALF_HOUR, slot_start

START = datetime(2023, 3, 6, 12, tzinfo=UTC)
TURN = START + timedelta(days=1, hours=7)
END = START + timedelta(days=2)
HOME = Household(relay=RelayRules(random_delay_s=0.0))
Grid = Callable[[datetime], float]


def before(slot: datetime) -> float:
    """Some grid."""
    return 150.0 + 50.0 * ((slot.hour * 7 + slot.day * 3) % 5) / 5.0


def dirtier(slot: datetime) -> float:
    """The same up to the turn: a half hour that is not over then is not known yet."""
    return before(slot) if slot + HALF_HOUR <= TURN else 90.0 + 200.0 * (slot.hour % 2)


@dataclass(slots=True)
class World:
    """An API that publishes what was measured an hour late and revises it a day later, and knows no future."""

    grid: Grid
    clock: SimClock
    region: str = "national"
    measures: bool = True
    told: set[tuple[datetime, datetime]] = field(default_factory=set)
    """(when, which half hour's measured value)."""

    def fetch(self, now: datetime) -> Forecast:
        """What is expected is yesterday, as far as it was measured by now."""
        first = slot_start(now)
        slots = (first + k * HALF_HOUR for k in range(96))
        expected = tuple(Intensity(slot, self._known(slot - 3 * timedelta(days=1), now) or 170.0) for slot in slots)
        return Forecast(now, self.region, expected, self._actual(first - timedelta(hours=26), first, now))

    def past(self, start: datetime, end: datetime) -> tuple[PastRow, ...]:
        """What was measured, as far as it is published."""
        rows = self._actual(start, end, self.clock.now())
        return tuple(PastRow(row.start, None, row.g_per_kwh) for row in rows)

    def _actual(self, start: datetime, end: datetime, now: datetime) -> tuple[Intensity, ...]:
        slots = (start + k * HALF_HOUR for k in range((end - start) // HALF_HOUR))
        return tuple(Intensity(s, g) for s in slots if (g := self._known(s, now)) is not None)

    def _known(self, slot: datetime, now: datetime) -> float | None:
        if slot + 3 * HALF_HOUR > now:
            return None
        self.told.add((now, slot))
        revised = slot + timedelta(days=1) <= now
        return self.grid(slot) + (0.0 if revised else 3.0)


@dataclass(slots=True)
class Diary:
    """What was planned, and expected, at each moment."""

    plans: list[tuple[datetime, Plan | None]] = field(default_factory=list)
    outlooks: list[tuple[datetime, Outlook | None]] = field(default_factory=list)
    histories: list[tuple[datetime, tuple[Intensity, ...]]] = field(default_factory=list)

    def until(self, turn: datetime) -> tuple[list[object], ...]:
        """All of it before `turn`."""
        return tuple(
            [entry for entry in kept if entry[0] <= turn] for kept in (self.plans, self.outlooks, self.histories)
        )


def lived(grid: Grid, folder: Path) -> tuple[Diary, World]:
    """Two days of the daemon's cycle with its store, history and score."""
    diary, clock = Diary(), SimClock(START)
    world = World(grid, clock)
    plug = SimPlug(clock, Battery(), HOME.capability, connected=True)
    with SqliteStore(folder) as store:
        cycle = Cycle(
            clock=clock,
            source=world,
            plug=plug,
            hub=SimHub(),
            store=store,
            controller=Controller(HOME, Exact()),
            learned=Learned(),
            memory=perception.fresh(START),
            spread=lambda: 0.0,
            errands=(CatchUp(world, store, lambda: 0.0), Scoring(store)),
        )
        while (now := clock.now()) < END:
            due = cycle.step()
            assert cycle.decision is not None
            if cycle.planned_at == now:
                diary.plans.append((now, cycle.memory.plan))
                diary.outlooks.append((now, cycle.decision.outlook))
                diary.histories.append((now, store.history(now - timedelta(days=2))))
            plug.pass_time(now, due)
            clock.wait(due)
        for forecast in store.issued(START):
            assert all(row.start + 3 * HALF_HOUR <= forecast.issued_at for row in forecast.actual)
    return diary, world


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> tuple[Diary, Diary]:
    """The same days in two worlds that part at the turn."""
    folder = tmp_path_factory.mktemp("worlds")
    one, world = lived(before, folder / "one")
    assert world.told
    return one, lived(dirtier, folder / "other")[0]


def test_plans_outlooks_and_history_are_the_same_until_what_differs_is_published(twice: tuple[Diary, Diary]) -> None:
    one, other = twice
    published = TURN + 2 * HALF_HOUR  # the first half hour that differs is over half an hour after the turn
    assert one.until(published) == other.until(published)
    assert len(one.until(published)[0]) > 60


def test_and_differ_soon_after(twice: tuple[Diary, Diary]) -> None:
    """Else the test above would hold for a daemon that learns nothing."""
    one, other = twice
    soon = TURN + timedelta(hours=3)
    assert one.until(soon)[2] != other.until(soon)[2]
    assert one.until(END)[1] != other.until(END)[1]


def test_history_holds_no_half_hour_that_is_not_over(twice: tuple[Diary, Diary]) -> None:
    for now, known in twice[0].histories:
        assert all(row.start + HALF_HOUR <= now for row in known)
        assert len({row.start for row in known}) == len(known)
