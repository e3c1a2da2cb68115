"""The relay: planned power to minutes, with dwell, budget and delay; the energy stays, the guard sleeps."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugd.domain import PlanSlot, RelayRules, Session, SessionPlan, Switch, Switching
from plugd.guard import Need, guard
from plugd.relay import RelayHistory, delay_s, realise, slot_shares
from plugd.units import pieces

T0 = datetime(2026, 3, 1, 20, 0, tzinfo=UTC)
KW = 2.0
RULES = RelayRules()
OFF = RelayHistory()


def at(minutes: float) -> datetime:
    return T0 + timedelta(minutes=minutes)


def planned(
    shares: Sequence[float],
    g_per_kwh: Sequence[float] | None = None,
    *,
    now: datetime = T0,
    limits_kw: Sequence[float] | None = None,
) -> SessionPlan:
    """A session of half hours from T0 on, each at a share of its limit; the first cut at `now`."""
    end = at(30 * len(shares))
    slots = tuple(
        PlanSlot(max(now, at(30 * i)), at(30 * (i + 1)), share * limit, limit, g)
        for i, (share, g, limit) in enumerate(
            zip(shares, g_per_kwh or [100.0] * len(shares), limits_kw or [KW] * len(shares), strict=True)
        )
        if at(30 * (i + 1)) > now
    )
    return SessionPlan(Session(T0, end, 0.5, 0.0, 0.8), slots, 0.5, 0.0)


def run(
    plan: SessionPlan,
    now: datetime = T0,
    history: RelayHistory = OFF,
    rules: RelayRules = RULES,
    *,
    surplus_kwh: float = 0.0,
    must_kwh: float = 0.0,
    margin_s: float = 0.0,
    delay: Callable[[datetime], float] | None = None,
) -> Switching:
    return realise(
        plan,
        now,
        history,
        rules,
        surplus_kwh=surplus_kwh,
        must_kwh=must_kwh,
        margin_s=margin_s,
        delay=delay,
    )


def ons(switching: Switching) -> list[tuple[float, float]]:
    """Blocks as minutes from T0."""
    minutes = [round((s.at - T0).total_seconds() / 60.0, 6) for s in switching.switches]
    assert [s.on for s in switching.switches] == [True, False] * (len(minutes) // 2)
    return list(zip(minutes[::2], minutes[1::2], strict=True))


def on_min(switching: Switching) -> float:
    return sum(b - a for a, b in ons(switching))


# -- fractional slots -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shares", "blocks"),
    [
        pytest.param([0, 1, 1, 0], [(30, 90)], id="whole slots"),
        pytest.param([0, 1, 0.5, 0], [(30, 75)], id="after the one that is on"),
        pytest.param([0, 0.5, 1, 0], [(45, 90)], id="before the one that is on"),
        pytest.param([0, 0.5, 0, 0], [(30, 45)], id="alone, at its start"),
        pytest.param([0, 0.5, 0.5, 0], [(45, 75)], id="two join each other"),
        pytest.param([1, 0.5, 1, 0], [(0, 45), (60, 90)], id="between two, with the first"),
        pytest.param([1, 0.5, 0.3, 0], [(0, 30), (45, 69)], id="between two, with the one too short alone"),
        pytest.param([0, 0, 0, 0], [], id="nothing"),
    ],
)
def test_part_of_a_slot_runs_beside_the_slot_that_is_on(shares: list[float], blocks: list[tuple[float, float]]) -> None:
    assert ons(run(planned(shares))) == blocks


def test_parts_are_switched_to_the_second() -> None:
    ((start, end),) = ons(run(planned([1, 0.123, 0])))
    assert (start, round(end * 60, 3)) == (0, 1800 + math.ceil(0.123 * 1800))


def test_a_slot_without_power_is_off_whatever_is_planned() -> None:
    assert ons(run(planned([1, 0, 0], limits_kw=[0.0, KW, KW]))) == []


def test_a_part_of_the_slot_under_way_goes_on_where_the_relay_is_on() -> None:
    history = RelayHistory(on=True, since=at(-60))
    assert ons(run(planned([0.2, 1, 0]), history=history)) == [(0, 6), (30, 60)]
    assert ons(run(planned([0.2, 1, 0]))) == [(24, 60)]


def test_the_same_plan_realised_again_later_gives_the_same_switches() -> None:
    plan = planned([0, 0.5, 1, 0.5, 0])
    first = run(plan)
    assert ons(run(plan, now=at(20))) == ons(first)
    running = RelayHistory(on=True, since=at(45))
    assert ons(run(plan, now=at(50), history=running)) == [(50, 105)]


# -- dwell ----------------------------------------------------------------------------------------


def test_a_relay_on_for_four_minutes_stays_on_until_fifteen() -> None:
    history = RelayHistory(on=True, since=at(-4))
    plan = planned([0, 0, 1, 1, 0], [150, 150, 90, 100, 150])
    assert ons(run(plan, history=history)) == [(0, 11), (60, 109)]


def test_a_relay_off_for_three_minutes_waits_for_ten() -> None:
    assert ons(run(planned([1, 1, 0]), history=RelayHistory(on=False, since=at(-3)))) == [(7, 67)]
    assert ons(run(planned([1, 1, 0]), history=RelayHistory(on=False, since=at(-10)))) == [(0, 60)]


def test_what_no_time_is_left_for_after_the_wait_runs_elsewhere() -> None:
    plan = planned([0, 0, 1], now=at(60))
    assert ons(run(plan, now=at(60), history=RelayHistory(on=False, since=at(57)))) == [(67, 90)]


def test_a_clock_that_stepped_back_makes_no_dwell_longer_than_itself() -> None:
    assert ons(run(planned([1, 0]), history=RelayHistory(on=False, since=at(600)))) == [(10, 40)]
    assert ons(run(planned([0, 0]), history=RelayHistory(on=True, since=at(600)))) == [(0, 15)]


def test_a_relay_that_nobody_timed_may_move_at_once() -> None:
    assert ons(run(planned([0, 1]), history=RelayHistory(on=True))) == [(30, 60)]


def test_a_short_gap_is_closed_and_the_dearest_minutes_pay() -> None:
    plan = planned([1, 0.8, 1, 1, 0], [100, 100, 100, 120, 150])
    assert ons(run(plan)) == [(0, 114)]


def test_the_running_block_is_not_cut_for_a_moment() -> None:
    plan = planned([0.8, 1, 0], [100, 120, 150])
    history = RelayHistory(on=True, since=at(-3))
    assert ons(run(plan, history=history)) == [(0, 54)]
    # The relay is on and the plan begins in 6 min: no point in going off.
    plan = planned([0.8, 1, 0.0], [100, 100, 150])
    assert ons(run(plan, history=RelayHistory(on=True, since=at(1)))) == [(0, 54)]


def test_a_lone_part_becomes_min_on_at_the_cost_of_the_dearest_minutes() -> None:
    plan = planned([0, 0.2, 0, 0, 0, 1, 1, 0], [200, 90, 200, 200, 200, 95, 100, 200])
    assert ons(run(plan)) == [(30, 45), (150, 201)]


def test_a_lone_part_joins_a_block_that_is_hardly_dearer() -> None:
    plan = planned([0, 0.2, 0, 0, 0, 1, 1, 0], [200, 90, 200, 200, 200, 95, 91, 94.9])
    assert ons(run(plan)) == [(150, 216)]


def test_a_lone_part_with_nothing_to_pay_is_left_to_a_later_session() -> None:
    assert ons(run(planned([0, 0.2, 0]))) == []
    assert ons(run(planned([0, 0.2, 0]), surplus_kwh=10.0)) == []


def test_a_lone_part_of_half_min_on_is_rounded_up_where_there_is_room() -> None:
    assert ons(run(planned([0, 0.3, 0]), surplus_kwh=6 / 60 * KW)) == [(30, 45)]
    assert ons(run(planned([0, 0.3, 0]), surplus_kwh=5 / 60 * KW)) == []


def test_a_lone_part_that_the_minimum_needs_runs() -> None:
    plan = planned([0, 0.2, 0])
    assert ons(run(plan, must_kwh=0.01)) == [(30, 45)]
    # With no room under soc_max either; and sooner where the session ends.
    assert ons(run(planned([0, 0, 0.2]), must_kwh=0.2, margin_s=1500)) == [(51, 66)]


def test_what_the_minimum_needs_joins_a_block_where_soc_max_leaves_no_room() -> None:
    now = at(15)
    plan = planned([1, 0, 0, 0.2, 0], [100, 130, 130, 100, 130], now=now)
    must_kwh = 21 / 60 * KW
    assert ons(run(plan, now, must_kwh=must_kwh)) == [(15, 36)]
    assert ons(run(plan, now, must_kwh=must_kwh, surplus_kwh=9 / 60 * KW)) == [(15, 30), (90, 105)]


def test_too_late_for_min_on() -> None:
    plan = planned([0, 0.2], now=at(50))
    assert ons(run(plan, now=at(50), must_kwh=0.1)) == [(50, 52)]
    assert ons(run(plan, now=at(50))) == []


# -- budget ---------------------------------------------------------------------------------------

HOLES = [1, 0, 1, 0, 0.9, 0, 1, 0]
PRICES = [100.0, 150.0, 100.0, 140.0, 100.0, 160.0, 100.0, 170.0]


def test_over_budget_the_smallest_blocks_move_to_the_cheapest_ends() -> None:
    rules = replace(RULES, max_switch_on=3)
    blocks = ons(run(planned(HOLES, PRICES), rules=rules))
    assert len(blocks) == 3
    assert sum(b - a for a, b in blocks) == pytest.approx(117, abs=0.1)


def test_switch_ons_already_made_count_and_the_running_block_does_not() -> None:
    made = tuple(at(-60 + 10 * i) for i in range(4))
    off = RelayHistory(on=False, since=at(-30), switch_ons=made)
    on = RelayHistory(on=True, since=at(-30), switch_ons=made)
    assert len(ons(run(planned(HOLES, PRICES), history=off))) == 2
    assert len(ons(run(planned(HOLES, PRICES), history=on))) == 3


def test_without_a_switch_on_left_an_off_relay_stays_off() -> None:
    spent = RelayHistory(on=False, since=at(-30), switch_ons=tuple(at(-60) for _ in range(7)))
    assert ons(run(planned([0, 1, 0]), history=spent, must_kwh=1.0)) == []


def test_without_a_switch_on_left_a_running_relay_stays_on_for_the_minimum() -> None:
    spent = RelayHistory(on=True, since=at(-30), switch_ons=tuple(at(-60) for _ in range(6)))
    assert ons(run(planned([0, 1, 0]), history=spent, must_kwh=0.5)) == [(0, 15)]
    assert ons(run(planned([0, 1, 0]), history=spent)) == []
    assert ons(run(planned([1, 0, 1, 0]), history=spent)) == [(0, 60)]


# -- delay ----------------------------------------------------------------------------------------


def test_a_block_is_delayed_start_and_end_alike() -> None:
    assert ons(run(planned([0, 1, 0]), delay=lambda _: 300.0)) == [(35, 65)]


def test_a_delay_stays_within_rule_margin_and_gap() -> None:
    assert ons(run(planned([0, 1, 0]), delay=lambda _: 9000.0)) == [(40, 70)]
    assert ons(run(planned([0, 1, 0]), delay=lambda _: -9.0)) == [(30, 60)]
    assert ons(run(planned([0, 1, 0]), delay=lambda _: 500.0, margin_s=1500.0)) == [(35, 65)]
    assert ons(run(planned([0, 0, 1]), delay=lambda _: 500.0, margin_s=1500.0)) == [(60, 90)]
    first, second = ons(run(planned([1, 0.5, 1, 0]), delay=lambda s: 600.0 if s == at(0) else 0.0))
    assert second[0] - first[1] == pytest.approx(10.0)


def test_the_running_block_is_not_delayed_again() -> None:
    history = RelayHistory(on=True, since=at(-20))
    assert ons(run(planned([1, 0]), history=history, delay=lambda _: 300.0)) == [(0, 30)]


def test_a_start_that_was_drawn_is_kept() -> None:
    first = run(planned([0, 1, 1, 0]), delay=lambda _: 500.0)
    again = RelayHistory(orders=first)
    now = at(30)
    plan = planned([0, 1, 1, 0], now=now)
    assert run(plan, now, again, delay=lambda _: 100.0).switches[0].at == first.switches[0].at
    now = at(35)
    plan = planned([0, 1, 1, 0], now=now)
    assert run(plan, now, again, delay=lambda _: 100.0).switches[0].at == first.switches[0].at
    # Its moment has come and the relay is not on yet: now.
    now = first.switches[0].at
    plan = planned([0, 1, 1, 0], now=now)
    assert run(plan, now, again, delay=lambda _: 100.0).switches[0] == Switch(now, on=True)
    # What was ordered for much later says nothing about now.
    now = at(15)
    plan = planned([1, 1, 1, 0], now=now)
    assert run(plan, now, again, delay=lambda _: 100.0).switches[0].at == now + timedelta(seconds=100)


@given(minute=st.integers(0, 29), slot=st.integers(0, 47), most_s=st.sampled_from([0.0, 60.0, 600.0, 1800.0]))
def test_a_draw_is_whole_seconds_the_same_for_a_half_hour(minute: int, slot: int, most_s: float) -> None:
    drawn = delay_s(at(30 * slot + minute), seed="house/2026-03-01", most_s=most_s)
    assert drawn == delay_s(at(30 * slot), seed="house/2026-03-01", most_s=most_s)
    assert 0.0 <= drawn <= most_s
    assert drawn == int(drawn)


def test_draws_fill_the_range_and_differ_by_seed_and_start() -> None:
    drawn = [delay_s(at(30 * i), seed="house", most_s=600.0) for i in range(2000)]
    assert sum(drawn) / 2000 == pytest.approx(300.0, abs=15.0)
    assert min(drawn) < 5
    assert max(drawn) > 595
    other = [delay_s(at(30 * i), seed="other", most_s=600.0) for i in range(2000)]
    assert sum(a == b for a, b in zip(drawn, other, strict=True)) < 20


# -- shares ---------------------------------------------------------------------------------------


def test_shares_of_slots() -> None:
    plan = planned([0, 0.5, 1, 0.2, 0])
    assert slot_shares(run(plan), plan.slots) == pytest.approx((0, 0.5, 1, 0.2, 0))
    running = Switching((Switch(at(15), on=True),), until=at(45))
    assert slot_shares(running, plan.slots) == pytest.approx((0.5, 0.5, 0, 0, 0))


# -- properties -----------------------------------------------------------------------------------

shares_of = st.lists(st.sampled_from([0.0, 0.0, 0.0, 1.0, 1.0]) | st.floats(0.0, 1.0), min_size=1, max_size=24)


@st.composite
def nights(draw: st.DrawFn) -> tuple[SessionPlan, datetime, RelayHistory, float, float]:
    """A plan with many fractional slots, more than an optimum has, and a relay in any state."""
    shares = draw(shares_of)
    g_per_kwh = draw(st.lists(st.floats(0.0, 400.0), min_size=len(shares), max_size=len(shares)))
    now = T0 + timedelta(seconds=draw(st.integers(-3600, 1799)))
    history = RelayHistory(
        on=draw(st.booleans()),
        since=draw(st.none() | st.integers(0, 4000).map(lambda s: now - timedelta(seconds=s))),
        switch_ons=tuple(at(-10) for _ in range(draw(st.integers(0, 7)))),
    )
    plan = planned(shares, g_per_kwh, now=now)
    must_kwh = draw(st.sampled_from([0.0, 0.3, 0.9, 1.0])) * plan.energy_kwh
    return plan, now, history, draw(st.floats(0.0, 5.0)), must_kwh


@settings(max_examples=600)
@given(night=nights(), seed=st.none() | st.integers(0, 9))
def test_dwell_budget_and_energy_hold_for_any_plan(
    night: tuple[SessionPlan, datetime, RelayHistory, float, float], seed: int | None
) -> None:
    plan, now, history, surplus_kwh, must_kwh = night
    delay = None if seed is None else partial(delay_s, seed=str(seed), most_s=600.0)
    switching = run(plan, now, history, surplus_kwh=surplus_kwh, must_kwh=must_kwh, delay=delay)
    blocks = [(a.at, b.at) for a, b in zip(switching.switches[::2], switching.switches[1::2], strict=True)]
    end = plan.session.end
    runs = history.on and bool(blocks) and blocks[0][0] <= now
    fresh = blocks[1:] if runs else blocks
    room = (end - max(now, plan.slots[0].start)).total_seconds() >= 1500

    # In order, in the session, to the relay's liking.
    assert all(now <= a < b <= end for a, b in blocks)
    moves = [s.at for s in switching.switches]
    assert moves == sorted(moves)
    millisecond = timedelta(milliseconds=2)
    assert all(b - a >= timedelta(seconds=600) - millisecond for (_, a), (b, _) in pairwise(blocks))
    if room:
        assert all(b - a >= timedelta(seconds=900) - millisecond for a, b in fresh)
    if history.since is not None and history.on:
        held = min(history.since + timedelta(seconds=900), end)
        assert held <= now or (runs and blocks[0][1] >= held)
    if history.since is not None and not history.on and blocks:
        assert blocks[0][0] >= history.since + timedelta(seconds=600)
    if history.on and not runs and blocks:
        assert blocks[0][0] >= now + timedelta(seconds=600) - millisecond
    assert len(fresh) <= max(0, 6 - len(history.switch_ons))

    # The energy: what is missing is at most what was too short to run, or too much for the budget.
    flows_kwh = sum(KW * share * (s.end - s.start).total_seconds() / 3600.0 for share, s in shares(plan, switching))
    off_until = now if history.on or history.since is None else history.since + timedelta(seconds=600)
    first = max(now, plan.slots[0].start, off_until)
    possible_kwh = (end - first).total_seconds() / 3600.0 * KW
    spent = len(history.switch_ons) >= 6
    stays_on = history.on and now >= plan.slots[0].start
    if end - first >= timedelta(minutes=45) and (stays_on or not spent):
        assert flows_kwh >= min(must_kwh, possible_kwh) - 1e-4
        assert spent or flows_kwh >= min(plan.energy_kwh, possible_kwh) - 12 * 900 / 3600 * KW
    dwell_kwh = 900 / 3600 * KW * 2
    assert flows_kwh <= plan.energy_kwh + max(surplus_kwh, dwell_kwh) + 24 / 3600 * KW


def shares(plan: SessionPlan, switching: Switching) -> list[tuple[float, PlanSlot]]:
    return list(zip(slot_shares(switching, plan.slots), plan.slots, strict=True))


# -- with a battery and the guard -------------------------------------------------------------------

MARGIN_S, SLACK_S, EFFICIENCY = 2400.0, 1200.0, 0.9


@dataclass(slots=True)
class Loop:
    """A plug of true power, a battery that misses some energy, and a planner that picks slots as told."""

    end: datetime
    need_kwh: float
    power_kw: float
    pick: Callable[[int, int], float]
    """Rank of a slot (tick, slot): the lowest are filled first."""
    seed: str
    history: RelayHistory = OFF
    guard_fired: bool = False

    def plan(self, now: datetime, tick: int) -> SessionPlan:
        """What is needed, at 0.9 of the power, before the deadline; what finds no room there after it."""
        deadline = self.end - timedelta(seconds=MARGIN_S + SLACK_S)
        limit_kw = 0.9 * self.power_kw
        slots = list(pieces(now, min(deadline, self.end))) + list(pieces(max(now, deadline), self.end))
        late = [end > deadline for _, end in slots]
        order = sorted(range(len(slots)), key=lambda i: (late[i], 0.0 if late[i] else self.pick(tick, i), i))
        left_kwh = max(0.0, self.need_kwh) / EFFICIENCY
        powers_kw = [0.0] * len(slots)
        for i in order:
            length_h = (slots[i][1] - slots[i][0]).total_seconds() / 3600.0
            powers_kw[i] = min(limit_kw, left_kwh / length_h)
            left_kwh -= powers_kw[i] * length_h
        planned_slots = tuple(
            PlanSlot(a, b, kw, limit_kw, 100.0 + 50.0 * self.pick(tick, i))
            for i, ((a, b), kw) in enumerate(zip(slots, powers_kw, strict=True))
        )
        return SessionPlan(Session(T0, self.end, 0.5, 0.0, 0.8), planned_slots, 0.5, 0.0)

    def live(self, now: datetime, switching: Switching, until: datetime) -> None:
        """Beats of 10 s as the daemon has them, until the next tick."""
        while now < until:
            need = Need(self.end, self.need_kwh)
            verdict = guard(
                now,
                need,
                observed_kw=self.power_kw,
                nominal_kw=self.power_kw,
                efficiency=EFFICIENCY,
                margin_s=MARGIN_S,
                guarding=False,
            )
            self.guard_fired |= verdict.on
            on = switching.state(now)
            if on is not self.history.on:
                made = (*self.history.switch_ons, now) if on else self.history.switch_ons
                self.history = RelayHistory(on, now, made, switching)
            step = min(timedelta(seconds=10), until - now)
            if on:
                self.need_kwh -= self.power_kw * EFFICIENCY * step.total_seconds() / 3600.0
            now += step

    def run(self, start: datetime) -> None:
        """Tick every half hour to the session end."""
        for tick, (now, until) in enumerate(pieces(start, self.end)):
            switching = realise(
                self.plan(now, tick),
                now,
                self.history,
                RULES,
                surplus_kwh=0.0,
                must_kwh=max(0.0, self.need_kwh) / EFFICIENCY,
                margin_s=MARGIN_S,
                delay=partial(delay_s, seed=self.seed, most_s=600.0),
            )
            self.history = replace(self.history, orders=switching)
            self.live(now, switching, until)


def latest(_tick: int, slot: int) -> float:
    return 1.0 - slot / 100.0


def cheapest(_tick: int, slot: int) -> float:
    return (slot * 7919 % 13) / 13.0


def anything(seed: int) -> Callable[[int, int], float]:
    """A planner that changes its mind at every tick."""
    return lambda tick, slot: delay_s(at(30 * (97 * tick + slot)), seed=str(seed), most_s=1000.0) / 1000.0


@settings(max_examples=150)
@given(
    share=st.floats(0.01, 1.0),
    power_kw=st.sampled_from([1.2, 2.3, 3.6, 7.4, 10.0]),
    start_min=st.integers(-300, 300),
    end_min=st.integers(420, 700),
    seed=st.integers(0, 10_000),
    kind=st.sampled_from(["latest", "cheapest", "anything"]),
)
def test_a_plan_made_before_the_deadline_never_wakes_the_guard(
    share: float, power_kw: float, start_min: int, end_min: int, seed: int, kind: str
) -> None:
    pick = {"latest": latest, "cheapest": cheapest, "anything": anything(seed)}[kind]
    start, end = at(start_min), at(end_min)
    time_h = (end - start).total_seconds() / 3600.0 - (MARGIN_S + SLACK_S) / 3600.0
    need_kwh = share * time_h * 0.9 * power_kw * EFFICIENCY
    loop = Loop(end, need_kwh, power_kw, pick, str(seed))
    loop.run(start)
    assert not loop.guard_fired
    assert loop.need_kwh <= 0.001
    assert len(loop.history.switch_ons) <= 6
    # Too much by no more than dwell asks for: one min on, and the steps of the beat.
    assert loop.need_kwh >= -power_kw * EFFICIENCY * (900 + 600) / 3600.0
