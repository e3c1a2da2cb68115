"""A part of the chaotic nights, a night restarted a hundred times, and any events in any order."""

import random
import re
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from plugd.adapters.kept_twice import KeptTwice
from plugd.book import Book
from plugd.domain import Forecast, Intensity, Mode, SetConnected, SetMinimum, SetMode, SetSoc
from plugd.outlook import Learned
from plugd.remedies import KNOWN
from plugd.units import HALF_HOUR
from tests.chaos.__main__ import jobs, work
from tests.chaos.night import Night, Trouble, lived, single
from tests.chaos.ports import ChaosSource, down
from tests.chaos.troubles import TROUBLES

NIGHTS, PAIRS = 24, 12
RESTARTS = 100
GAP = timedelta(seconds=5)


@pytest.mark.parametrize("trouble", TROUBLES, ids=[trouble.name for trouble in TROUBLES])
def test_each_trouble_alone_is_survived_and_said(trouble: Trouble) -> None:
    outcome, _ = single(trouble)
    assert outcome.objections == ()
    assert outcome.judged is (trouble.name != "button off")


def test_every_trouble_is_said_or_there_is_a_reason_not_to() -> None:
    assert [trouble.name for trouble in TROUBLES if bool(trouble.says) is bool(trouble.silent)] == []
    assert {trouble.says for trouble in TROUBLES if re.fullmatch("[a-z_]+", trouble.says)} <= KNOWN.keys() | {""}


@pytest.mark.parametrize("job", list(jobs(NIGHTS, PAIRS, seed=90_000)), ids=str)
def test_nights_with_one_trouble_or_two(job: tuple[int, tuple[int, ...]]) -> None:
    assert work(job).objections == ()


def test_a_lie_that_begins_with_a_power_cut_is_no_press_when_it_ends() -> None:
    """The car had charged before; what flowed then says nothing of the relay after the cut."""
    two = {trouble.name: trouble for trouble in TROUBLES}
    assert lived(227, (two["lies on"], two["power cut"])).objections == ()


def test_the_oracle_sees_a_morning_that_was_missed() -> None:
    night = Night(1)
    night.arrival = night.clock.start + timedelta(hours=3)
    night.car.battery.energy_kwh = 17.5
    night.kill()  # and nothing else stands in the plug's way, whose timer was never begun
    night.run()
    (objection,) = night.outcome(()).objections
    assert objection.startswith("morning: 35.0 %")


# -- a restart is not to be seen ------------------------------------------------------------------


def moments(seed: int) -> tuple[datetime, ...]:
    """When the daemon is killed in that night."""
    dice, start = random.Random(seed), Night(seed).clock.start
    return tuple(start + timedelta(minutes=dice.uniform(1.0, 840.0)) for _ in range(RESTARTS))


def moves(seed: int, folder: Path | None, *, kills: bool) -> list[tuple[datetime, bool]]:
    """How the relay moved in that night, with the daemon killed at its moments, or only looking then.

    With a folder on the daemon's own store, with what it learns of a forecast that is revised, and with its ledger.
    """
    night = Night(seed)
    stores = ExitStack()

    def ready() -> None:
        cycle = night.cycle
        if folder is None or cycle is None:
            return
        store = KeptTwice(folder)
        stores.callback(store.close)
        cycle.store, cycle.book, cycle.learned = store, Book(store, night.home), Learned()
        cycle.source, cycle.forecast = Revised(night.clock, night.source.level), store.latest_forecast()
        cycle.memory = store.load() or cycle.memory

    def kill() -> None:
        stores.close()
        night.kill()

    def again() -> None:
        if night.cycle is None:
            night.begin(night.store.load())
            ready()

    def nothing() -> None: ...

    ready()
    for at in moments(seed):
        night.at(at, kill if kills else nothing)
        night.at(at + GAP, again if kills else nothing)
    with stores:
        night.run()
    assert night.objections == []
    return night.device.moves


@dataclass(slots=True)
class Revised(ChaosSource):
    """A forecast that is wrong by more the further ahead, and says something else half an hour later."""

    def fetch(self, now: datetime) -> Forecast:
        exact = ChaosSource.fetch(self, now)
        first, dice, error, rows = exact.expected[0].start, random.Random(now.isoformat()), 0.0, []
        for row in exact.expected:
            error = 0.97 * error + dice.gauss(0.0, 0.05)
            rows.append(replace(row, g_per_kwh=max(1.0, row.g_per_kwh * (1.0 + error))))
        over = (first - k * HALF_HOUR for k in range(50, 2, -1))
        return replace(exact, expected=tuple(rows), actual=tuple(Intensity(at, self.level(at)) for at in over))


@pytest.mark.parametrize(("seed", "on_disk"), [(11, False), (12, False), (53, False), (13, True), (30, True)])
def test_killed_a_hundred_times_the_relay_moves_as_if_it_never_was(seed: int, on_disk: bool, tmp_path: Path) -> None:
    ways = ("undisturbed", "killed")
    folders = [tmp_path / way if on_disk else None for way in ways]
    whole, killed = (moves(seed, folder, kills=kills) for folder, kills in zip(folders, (False, True), strict=True))
    assert [on for _, on in killed] == [on for _, on in whole]
    assert len(whole) >= 2
    late = [abs(b - a) for (a, _), (b, _) in zip(whole, killed, strict=True)]
    assert max(late) <= GAP + timedelta(seconds=1)


# -- any events in any order ----------------------------------------------------------------------


class Events(RuleBasedStateMachine):
    """A night in which anything may happen at any time; what is promised holds after every event."""

    @initialize(seed=st.integers(0, 10_000))
    def begin(self, seed: int) -> None:
        self.night = Night(seed)
        self.night.at(self.night.arrival, self.night._arrive)
        # A plug that plugd never reached has no timer running, and nobody to switch it on.
        self.night.live(self.night.clock.at + timedelta(minutes=1))
        self.by_person = False
        self.faulty = False

    @rule(minutes=st.sampled_from([1, 7, 30, 120, 300]))
    def time_passes(self, minutes: int) -> None:
        self.night.live(min(self.night.end, self.night.clock.at + timedelta(minutes=minutes)))

    @rule(here=st.booleans())
    def car(self, here: bool) -> None:
        night = self.night
        if here is night.car.connected or night.clock.at < night.arrival:
            return
        (night.car.arrive if here else night.car.leave)()
        night.say(SetConnected(here))

    @rule(works=st.booleans(), slots=st.sampled_from([0, 3, 29, 96]))
    def forecast(self, works: bool, slots: int) -> None:
        self.night.source.error = None if works else down()
        self.night.source.slots = slots

    @rule(up=st.booleans())
    def broker(self, up: bool) -> None:
        night = self.night
        if up and not night.plug.broker:
            night.plug.reconnected()
            night.found()
        elif not up and night.plug.broker:
            night.plug.broker = False
            night.lose()

    @rule(mode=st.sampled_from(list(Mode)))
    def mode(self, mode: Mode) -> None:
        if self.night.plug.broker and self.night.cycle is not None:
            self.night.say(SetMode(mode))
            self.by_person = self.by_person or mode is Mode.OFF

    @rule(minimum=st.floats(0.6, 0.8))  # never less than it is judged by
    def minimum(self, minimum: float) -> None:
        self.night.say(SetMinimum(minimum))

    @rule()
    def soc(self) -> None:
        self.night.say(SetSoc(self.night.car.battery.soc, source="car"))

    @rule(minutes=st.sampled_from([0, 1, 40]))
    def restart(self, minutes: int) -> None:
        night = self.night
        night.kill()
        night.lose()
        night.live(min(night.end, night.clock.at + timedelta(minutes=minutes)))
        night.begin(night.store.load())
        night.found()

    @rule(hours=st.sampled_from([-1, 1, 24 * 3652]))
    def clock(self, hours: int) -> None:
        night = self.night
        night.clock.off = timedelta(hours=hours)
        night.live(min(night.end, night.clock.at + timedelta(minutes=3)))
        night.clock.off = timedelta(0)

    @invariant()
    def it_lives(self) -> None:
        assert self.night.objections == []

    @invariant()
    def the_plan_keeps_its_budget(self) -> None:
        cycle = self.night.cycle
        assert cycle is None or len(cycle.memory.switch_ons) <= self.night.home.relay.max_switch_on + 3

    @precondition(lambda self: self.night.reachable())
    @rule()
    def a_persons_off_is_off(self) -> None:
        night = self.night
        if night.clock.at >= night.end:
            return
        self.by_person = True
        night.say(SetMode(Mode.NOW))
        night.live(min(night.end, night.clock.at + timedelta(seconds=5)))
        night.say(SetMode(Mode.OFF))
        night.live(min(night.end, night.clock.at + timedelta(seconds=1)))
        assert not night.device.on or night.clock.at >= night.end
        night.say(SetMode(Mode.SMART))

    def teardown(self) -> None:
        night = self.night
        night.live(night.end)
        if not self.by_person:
            assert night.outcome(()).objections == ()


Events.TestCase.settings = settings(max_examples=15, stateful_step_count=12, suppress_health_check=list(HealthCheck))
TestEvents = Events.TestCase
