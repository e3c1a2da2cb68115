"""The store: what is saved comes back, after a kill too; damage is set aside; errors say what to do."""

import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plugd.adapters import store as store_module
from plugd.adapters import store_past
from plugd.adapters.store import SqliteStore
from plugd.adapters.store_pack import pack, unpack
from plugd.controller import Controller
from plugd.domain import (
    Capability,
    Forecast,
    Intensity,
    Memory,
    Mode,
    Observation,
    Outlook,
    OutlookSlot,
    Overrides,
    PastRow,
    Plan,
    PlanSlot,
    Presence,
    Reading,
    Record,
    Session,
    SessionPlan,
    Setpoint,
    SlotSource,
    SocEstimate,
    Status,
    Switch,
    Switching,
    Trip,
)
from plugd.errors import AlreadyRunning, StoreError
from plugd.ledger import HalfHour
from plugd.perception import fresh
from plugd.planner.exact import Exact
from plugd.ports import Store, Tally
from plugd.units import HALF_HOUR
from plugd.wall import shifted
from tests.unit.deciding import HOME

T0 = datetime(2023, 3, 14, 17, 0, tzinfo=UTC)
SOC = SocEstimate(mean=0.43, sd=0.02, source="hub", told_at=T0, driven_to=T0, meter_kwh=123.456)


def planned(count: int = 3) -> Plan:
    session = Session(T0, T0 + timedelta(hours=11), minimum=0.5, daily_use_kwh=11.28, ceiling=0.8)
    slots = tuple(
        PlanSlot(T0 + k * HALF_HOUR, T0 + (k + 1) * HALF_HOUR, 2.3 / (k + 1), 2.3, 100.0 + k) for k in range(count)
    )
    return Plan(T0, (SessionPlan(session, slots, 0.61, 0.0),), "solved", "osqp", 1234.5, 1e-6)


FULL = Memory(
    soc=SOC,
    overrides=Overrides(
        mode=Mode.NOW,
        minimum=0.6,
        ready_by=time(7, 30),
        horizon=3,
        trips=(Trip(date(2023, 3, 15), time(5, 0), 0.8), Trip(date(2023, 3, 16), away=True)),
    ),
    presence=Presence(True, T0 + timedelta(microseconds=1)),
    plan=planned(),
    orders=Switching((Switch(T0, True), Switch(T0 + HALF_HOUR, False)), T0 + timedelta(hours=9)),
    relay_on=True,
    relay_since=T0,
    switch_ons=(T0, T0 + HALF_HOUR),
    guarding=True,
    observed_kw=2.21,
)


def forecast(issued_at: datetime, *values: float, region: str = "national") -> Forecast:
    start = issued_at.replace(minute=issued_at.minute // 30 * 30, second=0)
    return Forecast(issued_at, region, tuple(Intensity(start + k * HALF_HOUR, v) for k, v in enumerate(values)))


def record(at: datetime, soc: float = 0.5) -> Record:
    return Record(at, soc, 2.3, 10.0, True, Status.CHARGING, "charging: the cleanest hours are now", 87.0)


def test_the_first_start_remembers_nothing(tmp_path: Path) -> None:
    with SqliteStore(tmp_path / "state") as opened:
        store: Store = opened
        assert store.load() is None
        assert store.latest_forecast() is None
        assert store.history(T0) == ()
        assert opened.records(T0) == ()
        assert opened.notices == ()
    assert (tmp_path / "state").stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("orders", [FULL.orders, Setpoint(1.4, T0), Setpoint(0.0, T0), Switching((), T0), None])
def test_a_saved_memory_comes_back_whole_after_a_restart(tmp_path: Path, orders: Switching | Setpoint | None) -> None:
    memory = replace(FULL, orders=orders)
    with SqliteStore(tmp_path) as store:
        store.save(Memory(soc=SOC))
        store.save(memory)
    with SqliteStore(tmp_path) as store:
        loaded = store.load()
    assert loaded == memory
    assert loaded is not None
    assert type(loaded.orders) is type(orders)
    assert loaded.soc.driven_to.utcoffset() == timedelta(0)


moments = st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1), timezones=st.just(UTC))  # noqa: DTZ001
numbers = st.floats(-1e6, 1e6)
fractions = st.floats(0.0, 1.0)
switchings = st.builds(Switching, st.lists(st.builds(Switch, moments, st.booleans()), max_size=3).map(tuple), moments)
memories = st.builds(
    Memory,
    soc=st.builds(SocEstimate, fractions, numbers, st.text(), st.none() | moments, moments, st.none() | numbers),
    overrides=st.builds(
        Overrides, mode=st.sampled_from(Mode), minimum=st.none() | fractions, ready_by=st.none() | st.times()
    ),
    orders=st.none() | switchings | st.builds(Setpoint, st.floats(0, 22), moments),
    relay_on=st.none() | st.booleans(),
    switch_ons=st.lists(moments, max_size=3).map(tuple),
    observed_kw=st.none() | st.floats(0.05, 22.0),
)


@given(memory=memories)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_memory_comes_back(tmp_path: Path, memory: Memory) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(memory)
        assert store.load() == memory


def test_an_unchanged_memory_writes_nothing(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(FULL)
        before = (tmp_path / "plugd.db-wal").stat().st_size
        store.save(replace(FULL))
        assert (tmp_path / "plugd.db-wal").stat().st_size == before
        store.save(replace(FULL, observed_kw=0.0))
        assert (tmp_path / "plugd.db-wal").stat().st_size > before


def test_a_memory_that_could_not_be_read_again_is_refused_and_the_last_one_stays(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(FULL)
        with pytest.raises(StoreError, match="cannot be saved"):
            store.save(replace(FULL, observed_kw=float("nan")))
        assert store.load() == FULL


def test_a_plan_for_more_than_can_be_charged_is_kept_as_any_other(tmp_path: Path) -> None:
    """6 A at an old socket, and 75 km a day: by the fourth night it counts on less than nothing."""
    home = replace(HOME, capability=Capability(1.4, dead_man=True), car=replace(HOME.car, daily_use_kwh=15.0))
    planned = Controller(home, Exact()).tick(T0, Observation(reading=Reading(T0, False)), fresh(T0)).memory
    assert planned.plan is not None
    assert planned.plan.sessions[-1].soc_end < -0.05
    with SqliteStore(tmp_path) as store:
        store.save(planned)
        assert store.load() == planned


def test_what_was_said_long_ago_is_kept_after_a_clock_of_2150_was_set_right(tmp_path: Path) -> None:
    memory = shifted(FULL, T0 - datetime(2150, 1, 1, tzinfo=UTC), T0)
    with SqliteStore(tmp_path) as store:
        store.save(memory)
        assert store.load() == memory


def test_an_unreadable_memory_is_an_error_and_the_next_save_mends_it(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(FULL)
    with sqlite3.connect(tmp_path / "plugd.db") as db:
        db.execute("UPDATE memory SET body = 'x'")
    db.close()
    with SqliteStore(tmp_path) as store:
        with pytest.raises(StoreError, match="memory cannot be read"):
            store.load()
        store.save(FULL)
        assert store.load() == FULL


def test_log_lines_come_back_in_order_of_time(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        for k in (2, 0, 1):
            store.append(record(T0 + k * HALF_HOUR, soc=0.1 * k))
    with SqliteStore(tmp_path) as store:
        assert store.records(T0 + HALF_HOUR) == (record(T0 + HALF_HOUR, 0.1), record(T0 + 2 * HALF_HOUR, 0.2))


def test_a_forecast_comes_back_as_issued(tmp_path: Path) -> None:
    issued = T0 + timedelta(minutes=7, seconds=3, microseconds=21)
    kept = Forecast(
        issued,
        "13",
        expected=(Intensity(T0, 0.0), Intensity(T0 + 3 * HALF_HOUR, 101.5)),
        actual=(Intensity(T0 - HALF_HOUR, 99.0),),
        dropped=("2 rows with a null forecast",),
    )
    with SqliteStore(tmp_path) as store:
        store.keep(forecast(T0, 1.0, 2.0))
        store.keep(kept)
    with SqliteStore(tmp_path) as store:
        assert store.latest_forecast() == kept
        assert tuple(store.issued(T0)) == (kept,)  # the other one is of another place
        assert tuple(store.issued(issued + HALF_HOUR)) == ()


@given(
    st.lists(st.tuples(st.integers(0, 800_000), st.floats(0, 1000)), max_size=50),
    st.lists(st.text(), max_size=3),
)
def test_packing_loses_nothing(rows: list[tuple[int, float]], dropped: list[str]) -> None:
    values = tuple(Intensity(datetime.fromtimestamp(1800 * k, UTC), value) for k, value in sorted(dict(rows).items()))
    kept = Forecast(T0, "national", values, values[:2], tuple(dropped))
    assert unpack(T0, "national", pack(kept)) == kept


def test_a_forecast_takes_few_bytes() -> None:
    assert len(pack(forecast(T0, *(100.0 + 37 * k % 150 for k in range(96))))) < 500


def test_history_is_what_was_last_expected_of_half_hours_that_are_over(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.keep(forecast(T0, 100.0, 110.0, 120.0, 130.0))
        assert store.history(T0) == ()
        store.keep(forecast(T0 + HALF_HOUR + timedelta(minutes=1), 115.0, 125.0, 135.0))
        store.keep(forecast(T0 + 2 * HALF_HOUR, 126.0, 136.0))
        assert store.history(T0) == (Intensity(T0, 100.0), Intensity(T0 + HALF_HOUR, 115.0))
        assert store.history(T0 + HALF_HOUR) == (Intensity(T0 + HALF_HOUR, 115.0),)


def test_history_prefers_what_was_measured_and_a_measured_zero_counts(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.keep(forecast(T0, 100.0, 110.0, 120.0))
        later = forecast(T0 + 2 * HALF_HOUR, 121.0)
        store.keep(replace(later, actual=(Intensity(T0, 0.0), Intensity(T0 + HALF_HOUR, 95.0))))
        assert store.history(T0) == (Intensity(T0, 0.0), Intensity(T0 + HALF_HOUR, 95.0))
        store.keep(forecast(T0 + 2 * HALF_HOUR, 122.0))
        assert store.history(T0)[1] == Intensity(T0 + HALF_HOUR, 95.0)


def test_history_fills_an_outage_with_what_was_expected_before_it(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.keep(forecast(T0, *range(100, 110)))
        store.keep(forecast(T0 + 5 * HALF_HOUR, 205.0))
        assert [value.g_per_kwh for value in store.history(T0)] == [100.0, 101.0, 102.0, 103.0, 104.0]


def test_history_is_of_the_last_forecasts_region(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.keep(forecast(T0, 100.0, 110.0))
        store.keep(forecast(T0, 50.0, 60.0, region="1"))
        store.keep(forecast(T0 + HALF_HOUR, 61.0, region="1"))
        assert store.history(T0) == (Intensity(T0, 50.0),)


def test_old_rows_go_by_number_so_a_clock_years_ahead_empties_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_module, "MOST_RECORDS", 4)
    for name, most in (("MOST_FORECASTS", 4), ("MOST_SEEN", 4), ("SWEPT_EVERY", 1)):
        monkeypatch.setattr(store_past, name, most)
    with SqliteStore(tmp_path) as store:
        for k in range(10):
            store.keep(forecast(T0 + k * HALF_HOUR, 100.0 + k))
            store.append(record(T0 + k * HALF_HOUR))
        assert [kept.issued_at for kept in store.issued(T0)] == [T0 + k * HALF_HOUR for k in (6, 7, 8, 9)]
        assert len(store.records(T0)) == 4
        assert len(store.history(T0)) <= 4
        store.keep(forecast(T0.replace(year=2033), 100.0))
        assert len(list(store.issued(T0))) == 4


def test_thirty_days_fit_their_share_of_20_mb_in_13_months(tmp_path: Path) -> None:
    days = 30
    with SqliteStore(tmp_path) as store:
        for k in range(days * 48):
            now = T0 + k * HALF_HOUR
            store.keep(forecast(now, *(float((k * k + 7919 * j * j) % 260 + 40) for j in range(96))))
            store.append(record(now))
            if k % 48 == 0:  # a page or two, always the same ones
                store.save(replace(FULL, plan=planned(88), observed_kw=float(k)))
    assert (tmp_path / "plugd.db").stat().st_size < 16e6 * days / 396  # 4 MB are the write-ahead log's


def test_forecasts_in_order_tell_what_was_measured_as_it_became_known(tmp_path: Path) -> None:
    """A value is kept with the first forecast that told it, and once more when it is revised."""
    first, second = (Intensity(T0 - k * HALF_HOUR, 90.0) for k in (4, 3))
    revised = replace(first, g_per_kwh=88.0)
    with SqliteStore(tmp_path) as store:
        for k, actual in enumerate(((first,), (first, second), (first, second), (revised, second), (revised, second))):
            store.keep(replace(forecast(T0 + k * HALF_HOUR, 100.0), actual=actual))
        assert [kept.actual for kept in store.issued(T0)] == [(first,), (second,), (), (revised,), ()]
        assert store.measured(T0 - timedelta(days=1)) == (revised, second)
        latest = store.latest_forecast()
        assert latest is not None
        assert latest.issued_at == T0 + 4 * HALF_HOUR


def test_history_is_known_before_there_ever_was_a_forecast(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.keep_past("national", [PastRow(T0 + k * HALF_HOUR, 100.0, None if k == 1 else 90.0) for k in range(3)])
        assert [row.g_per_kwh for row in store.history(T0)] == [90.0, 100.0, 90.0]


def test_what_is_swept_out_becomes_part_of_its_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, most in (("MOST_SEEN", 10), ("SWEPT_EVERY", 1)):
        monkeypatch.setattr(store_past, name, most)
    start = T0.replace(hour=0)
    with SqliteStore(tmp_path) as store:
        for k in range(48 + 10):
            store.keep(forecast(start + k * HALF_HOUR, 100.0 + k))
        assert store.days() == (("national", "2023-03-14", 48, 123.5, 100.0, 147.0),)
        assert len(store.history(start)) == 9


def test_what_was_expected_comes_back_once_a_half_hour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_past, "MOST_OUTLOOKS", 2)

    def outlook(level: float) -> Outlook:
        return Outlook((OutlookSlot(T0, level, 1.0, SlotSource.TAIL),), None)

    with SqliteStore(tmp_path) as store:
        for minute, level in ((0, 1.0), (30, 2.0), (60, 3.0), (65, 4.04)):
            store.expect(T0 + timedelta(minutes=minute), outlook(level))
        assert [store.outlook(T0 + k * HALF_HOUR) for k in range(4)] == [{}, {T0: 2.0}, {T0: 4.0}, {}]


def test_scores_come_back_and_a_day_without_any_counts_as_scored(tmp_path: Path) -> None:
    day = date(2023, 3, 12)
    tally = Tally(day, "ours", 0, 6, 48, 480.0, -48.0, 7200.0)
    with SqliteStore(tmp_path) as store:
        assert store.scored() is None
        store.score(day, (tally,))
        store.score(day + timedelta(days=1), ())
    with SqliteStore(tmp_path) as store:
        assert store.scored() == day + timedelta(days=1)
        assert store.tallies(day) == (tally,)
        assert store.tallies(day + timedelta(days=1)) == ()


def written_bytes() -> int:
    """What this process has handed to the system to write, so far."""
    lines = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
    return int(next(line for line in lines if line.startswith("wchar:")).split()[1])


def test_a_day_writes_less_than_its_share_of_2_mb(tmp_path: Path) -> None:
    """With a real day's revisions, and the outlook of four nights; the memory of every half hour comes on top."""
    with SqliteStore(tmp_path) as store:
        for k in range(96):
            if k == 48:  # the write-ahead log has its size by then
                before = written_bytes()
            now = T0 + k * HALF_HOUR
            values = (float((k * k + 7919 * j * j) % 260 + 40) for j in range(96))
            actual = (Intensity(now - j * HALF_HOUR, 90.0 + (k - j) % 7 + (j > 20)) for j in range(52, 2, -1))
            store.keep(replace(forecast(now, *values), actual=tuple(actual)))
            slots = (OutlookSlot(now + j * HALF_HOUR, 100.0 + k + j % 50, 9.0, SlotSource.TAIL) for j in range(180))
            store.expect(now, Outlook(tuple(slots), None))
            store.append(record(now))
            store.save(replace(FULL, plan=planned(88), observed_kw=float(k)))
        assert written_bytes() - before < 1.5e6


def test_a_second_daemon_is_turned_away_and_a_reader_is_not(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(FULL)
        with pytest.raises(AlreadyRunning, match=rf"another plugd \(process {os.getpid()}\)"):
            SqliteStore(tmp_path)
        with SqliteStore(tmp_path, hold=False) as reader:
            assert reader.load() == FULL
    with SqliteStore(tmp_path) as store:
        assert store.load() == FULL


KILLED = """
import os, signal, sys
from pathlib import Path
from plugd.adapters.store import SqliteStore
sys.path.insert(0, {tests!r})
from tests.adapters.test_store import FULL, T0, forecast, record
store = SqliteStore(Path({folder!r}))
store.save(FULL)
store.keep(forecast(T0, 1.0))
store.append(record(T0))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_was_written_survives_a_kill(tmp_path: Path) -> None:
    root = str(Path(__file__).parents[2])
    program = KILLED.format(tests=root, folder=str(tmp_path))
    ended = subprocess.run([sys.executable, "-c", program], cwd=root, check=False, capture_output=True)
    assert ended.returncode == -signal.SIGKILL, ended.stderr.decode()
    with SqliteStore(tmp_path) as store:
        assert store.load() == FULL
        assert store.latest_forecast() == forecast(T0, 1.0)
        assert store.records(T0) == (record(T0),)


def _zeros(path: Path) -> None:
    path.write_bytes(bytes(4096))


def _text(path: Path) -> None:
    path.write_text("this is not a database " * 300, encoding="ascii")


def _torn(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def _flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[5000:9000] = bytes(255 - byte for byte in content[5000:9000])
    path.write_bytes(content)


@pytest.mark.parametrize("damage", [_zeros, _text, _torn, _flipped])
def test_a_damaged_store_is_set_aside_and_a_new_one_begun(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(FULL)
        for k in range(40):
            store.keep(forecast(T0 + k * HALF_HOUR, *map(float, range(96))))
    damage(tmp_path / "plugd.db")
    with SqliteStore(tmp_path) as store:
        assert store.load() is None
        assert len(store.notices) == 1
        assert "damaged" in store.notices[0]
        store.save(FULL)
        assert store.load() == FULL
    aside = [path.name for path in tmp_path.iterdir() if ".corrupt." in path.name]
    assert len(aside) == 1
    assert aside[0].endswith("Z")


def test_a_reader_before_the_first_start_finds_nothing_and_makes_nothing(tmp_path: Path) -> None:
    with SqliteStore(tmp_path / "state", hold=False) as reader:
        assert reader.load() is None
        assert reader.history(T0) == ()
    assert list(tmp_path.iterdir()) == []


def test_a_reader_leaves_a_damaged_store_alone(tmp_path: Path) -> None:
    _text(tmp_path / "plugd.db")
    with pytest.raises(StoreError, match="no database; restart plugd"):
        SqliteStore(tmp_path, hold=False)
    assert [path.name for path in tmp_path.iterdir()] == ["plugd.db"]


def test_a_newer_plugds_store_is_refused_untouched_and_the_folder_let_go(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(FULL)
    with sqlite3.connect(tmp_path / "plugd.db") as db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    for _ in range(2):
        with pytest.raises(StoreError, match="newer plugd"):
            SqliteStore(tmp_path)


def fill(store: SqliteStore) -> None:
    for k in range(200):
        store.append(record(T0 + k * HALF_HOUR))


def test_a_full_disk_is_told_and_what_was_there_stays(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store.save(FULL)
        pages = store._db.execute("PRAGMA page_count").fetchone()[0]
        store._db.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(StoreError, match="the disk is full; make room"):
            fill(store)
        assert store.load() == FULL
        store._db.execute("PRAGMA max_page_count = 100000")
        store.append(record(T0 + 500 * HALF_HOUR))
        assert store.records(T0 + 500 * HALF_HOUR) == (record(T0 + 500 * HALF_HOUR),)


def test_a_store_that_may_not_be_written_is_told(tmp_path: Path) -> None:
    with SqliteStore(tmp_path) as store:
        store._db.execute("PRAGMA query_only = ON")
        with pytest.raises(StoreError, match="may not be written"):
            store.save(FULL)


def test_a_folder_that_cannot_be_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="ascii")
    with pytest.raises(StoreError, match=r"check state\.dir"):
        SqliteStore(tmp_path / "file" / "state")


# -- the ledger -----------------------------------------------------------------------------------

ENTRY = HalfHour(
    *(T0, 0.75, 120.0, None, 0.43, 1, date(2023, 3, 14), T0 + timedelta(minutes=7), True, 2.3),
    *(T0 + timedelta(hours=11), 0.5, 12.25, T0 + timedelta(minutes=29)),
)


def test_half_hours_come_back_as_they_were_and_are_replaced(tmp_path: Path) -> None:
    bare = replace(ENTRY, start=T0 + HALF_HOUR, session_end=None, minimum=None, meter_kwh=None, metered_at=None)
    with SqliteStore(tmp_path) as store:
        store.enter((bare, ENTRY))
        assert store.half_hours() == (ENTRY, bare)
        store.enter((replace(ENTRY, final_g_per_kwh=99.5),))
    with SqliteStore(tmp_path) as store:
        assert store.half_hours() == (replace(ENTRY, final_g_per_kwh=99.5), bare)
        assert store.half_hours(T0 + HALF_HOUR) == (bare,)


def test_measured_values_are_history_from_then_on(tmp_path: Path) -> None:
    begin = T0 - timedelta(hours=2)
    with SqliteStore(tmp_path) as store:
        store.keep(Forecast(begin, "national", tuple(Intensity(begin + k * HALF_HOUR, 100.0) for k in range(4))))
        store.keep(Forecast(T0, "national", (Intensity(T0, 100.0),)))
        store.keep_past("national", (PastRow(begin, None, 77.0),))
        store.keep_past("13", (PastRow(begin + HALF_HOUR, None, 11.0),))
        assert [value.g_per_kwh for value in store.history(begin)] == [77.0, 100.0, 100.0, 100.0]
        assert store.measured(begin) == (Intensity(begin, 77.0),)


def test_a_store_of_the_first_version_gets_its_ledger(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "plugd.db") as db:
        db.executescript(f"{store_module.MIGRATIONS[0]} PRAGMA user_version = 1;")
    db.close()
    with SqliteStore(tmp_path) as store:
        store.enter((ENTRY,))
        assert store.half_hours() == (ENTRY,)
