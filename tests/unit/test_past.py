"""What the store lacks of the past: asked for politely, once, and gone on with after a restart."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from plugd.adapters.store import SqliteStore
from plugd.domain import Forecast, Intensity, PastRow
from plugd.errors import ForecastError, ForecastLate, ForecastUnavailable
from plugd.past import HISTORY, LATE, PAGE, CatchUp
from plugd.units import HALF_HOUR, slot_start

NOW = datetime(2023, 3, 14, 17, 7, tzinfo=UTC)


@dataclass(slots=True)
class Api:
    """A source of the past with moods; of the time before `since` it knows nothing."""

    since: datetime = NOW - timedelta(days=400)
    moods: list[ForecastError] = field(default_factory=list)
    level: float = 150.0
    region: str = "national"
    measures: bool = True
    asked: list[tuple[datetime, datetime]] = field(default_factory=list)

    def past(self, start: datetime, end: datetime) -> Sequence[PastRow]:
        """As the mood is."""
        self.asked.append((start, end))
        if self.moods:
            raise self.moods.pop(0)
        slots = (start + k * HALF_HOUR for k in range((end - start) // HALF_HOUR))
        return [
            PastRow(slot, self.level, self.level if self.measures else None) for slot in slots if slot >= self.since
        ]


def run(catch_up: CatchUp, until: datetime, now: datetime = NOW) -> list[datetime]:
    """Step when it is due, from `now` on. Returns the moments at which something was asked."""
    moments, api = [], catch_up.source
    assert isinstance(api, Api)
    while now < until:
        before = len(api.asked)
        catch_up.step(now)
        moments += [now] * (len(api.asked) - before)
        assert catch_up.at is not None
        assert catch_up.at > now
        now = catch_up.at
    return moments


def test_the_first_start_asks_for_eight_weeks_newest_first_one_page_a_second(tmp_path: Path) -> None:
    api = Api()
    with SqliteStore(tmp_path) as store:
        moments = run(CatchUp(api, store, lambda: 0.0), NOW + timedelta(minutes=5))
        assert store.lacks("national", slot_start(NOW) - HISTORY, slot_start(NOW), measured=True) == 0
        assert len(store.history(slot_start(NOW) - HISTORY)) == 56 * 48
    assert 4 <= len(moments) <= 5
    assert all((b - a) >= timedelta(seconds=1) for a, b in itertools.pairwise(moments))
    assert moments[-1] - NOW < timedelta(seconds=10)
    assert [start for start, _ in api.asked] == sorted((start for start, _ in api.asked), reverse=True)
    assert all(end - start <= PAGE for start, end in api.asked)


def test_nothing_is_asked_twice_not_after_a_restart_either_nor_what_nobody_knows(tmp_path: Path) -> None:
    api = Api(since=NOW - timedelta(days=30))  # what is older the API does not know
    with SqliteStore(tmp_path) as store:
        run(CatchUp(api, store, lambda: 0.0), NOW + timedelta(days=2))
    unknown = [page for page in api.asked if page[1] <= api.since]
    assert len(unknown) == len(set(unknown)) > 0
    assert len(api.asked) <= 5 + 2 * 24  # nobody else brings what was measured meanwhile
    api.asked.clear()
    with SqliteStore(tmp_path) as store:
        run(CatchUp(api, store, lambda: 0.0), NOW + timedelta(days=2, hours=1), NOW + timedelta(days=2))
    assert all(start < api.since or end > NOW for start, end in api.asked)  # not what it brought


def test_it_goes_on_where_it_was_after_a_kill(tmp_path: Path) -> None:
    api = Api()
    with SqliteStore(tmp_path) as store:
        catch_up = CatchUp(api, store, lambda: 0.0)
        run(catch_up, NOW + timedelta(seconds=2.5))
    done = set(api.asked)
    assert len(done) == 2
    with SqliteStore(tmp_path) as store:
        run(CatchUp(api, store, lambda: 0.0), NOW + timedelta(minutes=1))
        assert store.lacks("national", slot_start(NOW) - HISTORY, slot_start(NOW), measured=True) == 0
    assert len(set(api.asked)) == len(api.asked)


def test_what_an_outage_left_out_is_asked_for_afterwards(tmp_path: Path) -> None:
    api = Api()
    with SqliteStore(tmp_path) as store:
        run(CatchUp(api, store, lambda: 0.0), NOW + timedelta(minutes=1))
        later = NOW + timedelta(days=5)
        run(CatchUp(api, store, lambda: 0.0), later + timedelta(minutes=1), later)
        assert store.lacks("national", slot_start(later) - HISTORY, slot_start(later), measured=True) == 0


def test_after_a_failure_the_pauses_grow_and_the_other_pages_come_first(tmp_path: Path) -> None:
    api = Api(moods=[ForecastUnavailable("no answer")] * 3)
    with SqliteStore(tmp_path) as store:
        moments = run(CatchUp(api, store, lambda: 1.0), NOW + timedelta(hours=6))
        assert store.lacks("national", slot_start(NOW) - HISTORY, slot_start(NOW), measured=True) == 0
    waits = [(b - a).total_seconds() for a, b in itertools.pairwise(moments)]
    assert waits[:3] == [90.0, 900.0, 5400.0]
    assert len({start for start, _ in api.asked[:4]}) == 4


def test_looked_at_every_ten_seconds_it_asks_no_oftener_than_the_pauses_say(tmp_path: Path) -> None:
    """The daemon looks all the time, not only when something is due."""
    api = Api(moods=[ForecastUnavailable("no answer")] * 100)
    with SqliteStore(tmp_path) as store:
        catch_up = CatchUp(api, store, lambda: 1.0)
        for seconds in range(0, 2 * 86400, 10):
            catch_up.step(NOW + timedelta(seconds=seconds))
    assert len(api.asked) <= 4 + 2 * 24 / 9


def test_a_moment_from_before_the_clock_was_set_back_is_not_waited_for(tmp_path: Path) -> None:
    api = Api()
    with SqliteStore(tmp_path) as store:
        catch_up = CatchUp(api, store, lambda: 0.0)
        catch_up.step(NOW + timedelta(days=300))
        catch_up.step(NOW)
        catch_up.step(NOW + timedelta(seconds=2))
    assert api.asked


def test_an_answer_that_is_late_is_come_back_for_and_no_failure(tmp_path: Path) -> None:
    api = Api(moods=[ForecastLate("not yet")])
    with SqliteStore(tmp_path) as store:
        catch_up = CatchUp(api, store, lambda: 0.0)
        moments = run(catch_up, NOW + timedelta(seconds=7))
    assert moments[1] - moments[0] == LATE
    assert api.asked[0] == api.asked[1]
    assert catch_up.retry.failures == 0


def test_it_waits_a_moment_where_the_source_was_just_asked(tmp_path: Path) -> None:
    api = Api()
    with SqliteStore(tmp_path) as store:
        catch_up = CatchUp(api, store, lambda: 0.0)
        for _ in range(5):
            catch_up.step(NOW, wait=True)
        assert catch_up.at is not None
        catch_up.step(catch_up.at, wait=True)
        assert api.asked == []
        catch_up.step(catch_up.at)
    assert len(api.asked) == 1


def test_values_off_by_a_factor_of_ten_are_not_learned(tmp_path: Path) -> None:
    api = Api(region="13", measures=False, level=60.0)
    with SqliteStore(tmp_path) as store:
        run(CatchUp(api, store, lambda: 0.0), NOW + timedelta(minutes=1))
        store.keep(Forecast(NOW, "13", (Intensity(slot_start(NOW), 60.0),)))
        later = NOW + timedelta(days=3)
        api.level = 600.0
        run(CatchUp(api, store, lambda: 0.0), later + timedelta(minutes=1), later)
        store.keep(Forecast(later, "13", (Intensity(slot_start(later), 60.0),)))
        assert {value.g_per_kwh for value in store.history(later - HISTORY)} == {60.0}
