"""The closed loop of the study: it conserves energy, agrees with the whole cycle, and leaves nothing out."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, time, timedelta
from itertools import count

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugd import habits
from plugd.domain import Capability, Household, Nights, Orders, Session, Setpoint, SocEstimate, Switch, Switching
from plugd.planner.exact import Exact
from plugd.study.engine import Account, World, simulate
from plugd.study.forecasts import Noise, Synthetic
from plugd.study.house import FunctionSource, House
from plugd.study.measured import Measured, measured
from plugd.study.runs import PAPER, Run, paper_run, simulated
from plugd.study.strategies import Strategy, strategy
from plugd.study.world import Battery, Driver
from plugd.units import next_slot
from plugd_hil.synthetic import synthetic_year

START = datetime(2023, 1, 1, 12, tzinfo=UTC)
ERRORS = (0.05, -0.1, 0.0, 0.15, -0.05, 0.08, 0.02)


def noisy() -> Measured:
    """The synthetic year with errors of some percent."""
    found = measured("a synthetic year", synthetic_year(days=40))
    return replace(found, error=tuple(ERRORS[k % len(ERRORS)] for k in range(len(found.actual))))


FOUND = noisy()


def run(name: str, days: int = 7, noise: Noise = Noise.TARGET, household: Household = PAPER, horizon: int = 2) -> Run:
    end = START + timedelta(days=days)
    return paper_run(name, FOUND, START, end, horizon=horizon, noise=noise, household=household)


@dataclass(slots=True)
class Scripted:
    """A strategy that says anything at all, for as long as it likes."""

    said: Iterator[tuple[float, float, bool]]

    def plugged_in(self, now: datetime, coming: tuple[Session, ...], household: Household) -> None:
        """Nothing to prepare."""

    def orders(self, now: datetime, estimate: SocEstimate) -> Orders:
        kw, length_h, relay = next(self.said)
        until = now + timedelta(hours=length_h)
        if relay:
            return Switching((Switch(now + timedelta(hours=length_h / 3), True),), until)
        return Setpoint(kw, until)


@settings(max_examples=60)
@given(
    script=st.lists(st.tuples(st.floats(0, 22), st.floats(0.01, 20), st.booleans()), min_size=1, max_size=7),
    efficiency=st.floats(0.5, 1.0),
    seed=st.integers(0, 1000),
    soc=st.floats(0, 1),
)
def test_the_world_conserves_energy(
    script: list[tuple[float, float, bool]], efficiency: float, seed: int, soc: float
) -> None:
    house = replace(PAPER, car=replace(PAPER.car, efficiency=efficiency))
    world = World(house, Driver(timezone="UTC", seed=seed), START, START + timedelta(days=6), soc)
    account = simulate(world, Scripted(script[k % len(script)] for k in count()), FOUND)
    into_kwh = efficiency * sum(flow.kwh for flow in account.flows)
    out_kwh = sum(night.driven_kwh for night in account.nights)
    assert account.end_kwh == pytest.approx(50 * soc + into_kwh - out_kwh, abs=1e-9)
    assert account.energy_kwh == pytest.approx(sum(flow.kwh for flow in account.flows), abs=1e-9)
    assert all(0.0 <= flow.soc <= 1.0 + 1e-9 for flow in account.flows)
    assert all(flow.kwh <= 22 * (flow.end - flow.start).total_seconds() / 3600 + 1e-9 for flow in account.flows)


@dataclass(slots=True)
class EveryHalfHour:
    """The same strategy asked anew at every half hour of the stay, whatever it said."""

    inner: Strategy
    asked: int = 0

    def plugged_in(self, now: datetime, coming: tuple[Session, ...], household: Household) -> None:
        self.inner.plugged_in(now, coming, household)

    def orders(self, now: datetime, estimate: SocEstimate) -> Orders:
        self.asked += 1
        orders = self.inner.orders(now, estimate)
        return replace(orders, until=min(orders.until, next_slot(now)))


@pytest.mark.parametrize("name", ["uncontrolled", "latest-start", "cheapest-tonight", "mpc"])
def test_what_is_not_asked_does_not_matter(name: str) -> None:
    """Waiting out a strategy's word gives the carbon of a loop that asks at every half hour."""
    asked = run(name)
    house = asked.world.household
    forecasts = Synthetic(FOUND, asked.noise, asked.seed, START)
    every = EveryHalfHour(strategy(name, house, forecasts, Exact(), previous=False))
    honest, quick = simulate(asked.world, every, FOUND), simulated(asked)
    assert every.asked > 6 * 28
    assert quick.carbon_g == pytest.approx(honest.carbon_g, rel=1e-6)
    assert quick.energy_kwh == pytest.approx(honest.energy_kwh, rel=1e-6)
    assert [n.morning.missed for n in quick.nights] == [n.morning.missed for n in honest.nights]


@pytest.mark.parametrize(("horizon", "modulating"), [(1, True), (3, True), (2, False)])
def test_the_light_loop_agrees_with_the_whole_cycle(horizon: int, modulating: bool) -> None:
    """The daemon's own cycle in its house, told the SOC on arrival, on the same forecasts."""
    days = 5
    capability = Capability(10.0 if modulating else 3.6, modulating)
    asked = run("mpc", days, Noise.NONE, replace(PAPER, capability=capability), horizon)
    light = simulated(asked)
    household = asked.world.household
    source = FunctionSource(lambda issued, slot: FOUND.actual[FOUND.index(slot)], 48 * (horizon + 1))
    household = replace(household, relay=replace(household.relay, random_delay_s=0.0))
    house = House(household, Exact(), source, asked.world.driver.stays(START), START, Battery(efficiency=1.0))
    house.run(START + timedelta(days=days))
    whole_kwh = sum(house.plug.flows.values())
    whole_g = sum(kwh * FOUND.actual[FOUND.index(at)] for at, kwh in house.plug.flows.items())
    agreed = 1e-6 if modulating else 0.01  # the whole cycle's relay moves at whole seconds of its own
    assert light.energy_kwh == pytest.approx(whole_kwh, rel=agreed)
    assert light.carbon_g == pytest.approx(whole_g, rel=agreed)
    assert light.missed == sum(morning.missed for morning in house.mornings) == 0


def test_what_is_left_in_the_battery_is_settled() -> None:
    """A full battery at the end is no saving, and an empty one no waste: at one intensity all strategies are equal."""
    flat = replace(FOUND, actual=(80.0,) * len(FOUND.actual))
    full, planned = (simulated(replace(run(name, 4), found=flat)) for name in ("uncontrolled", "mpc"))
    assert full.end_kwh > planned.end_kwh + 5.0
    assert full.used_kwh == pytest.approx(planned.used_kwh)
    assert full.carbon_g_per_kwh == pytest.approx(80.0)
    assert planned.carbon_g_per_kwh == pytest.approx(80.0)


def test_energy_left_is_worth_the_mean_but_never_more_than_it_cost() -> None:
    account = Account((), (), end_kwh=30.0, used_kwh=10.0, mean_g_per_kwh=100.0)
    night = simulated(run("uncontrolled", 2)).nights[0]

    def g_per_kwh(charged_kwh: float, carbon_g: float) -> float | None:
        return replace(account, nights=(replace(night, charged_kwh=charged_kwh, carbon_g=carbon_g),)).carbon_g_per_kwh

    assert g_per_kwh(15.0, 15.0 * 200.0) == pytest.approx((15.0 * 200.0 - 5.0 * 100.0) / 10.0)
    assert g_per_kwh(15.0, 15.0 * 40.0) == pytest.approx(40.0)
    assert g_per_kwh(15.0, 0.0) == 0.0
    assert g_per_kwh(6.0, 6.0 * 40.0) == pytest.approx((6.0 * 40.0 + 4.0 * 100.0) / 10.0)
    assert replace(account, used_kwh=0.0).carbon_g_per_kwh is None


def first(account: Account) -> tuple[float, float, float]:
    """Hours from plug-in to the first flow, from the last one to the session's end, and the SOC there."""
    night = account.nights[0]
    flows = [flow for flow in account.flows if flow.start < night.departure]
    since_h = (flows[0].start - night.arrival).total_seconds() / 3600
    return since_h, (night.morning.end - flows[-1].end).total_seconds() / 3600, night.departure_soc


def test_uncontrolled_charges_at_once_to_the_ceiling() -> None:
    since_h, _, soc = first(simulated(run("uncontrolled")))
    assert since_h == 0.0
    assert soc == pytest.approx(0.8, abs=1e-6)


def test_the_latest_start_ends_with_the_session() -> None:
    since_h, before_h, soc = first(simulated(run("latest-start")))
    assert since_h > 6.0
    assert before_h == pytest.approx(0.0, abs=1e-4)
    assert soc == pytest.approx(0.8, abs=1e-6)


def test_the_cheapest_of_tonight_charges_as_much_in_the_cleanest_half_hours() -> None:
    account = simulated(run("cheapest-tonight", noise=Noise.NONE))
    night = account.nights[0]
    assert 0.8 <= night.departure_soc <= 0.83  # on the cautious estimate
    begin = night.morning.end.replace(day=1, hour=20, minute=30)
    offered = [FOUND.actual[FOUND.index(at)] for at in FOUND.slots() if begin <= at < night.morning.end]
    full, rest = divmod(night.charged_kwh, 5.0)
    cleanest = sorted(offered)[: int(full) + 1]
    assert night.carbon_g == pytest.approx(5.0 * sum(cleanest[:-1]) + rest * cleanest[-1], rel=0.03)


def test_a_longer_horizon_and_a_better_forecast_save_more() -> None:
    def g_per_kwh(horizon: int, noise: Noise = Noise.NONE) -> float:
        asked = run("mpc", 28, noise, horizon=horizon)
        house = replace(asked.world.household, end_value=False)
        return simulated(replace(asked, world=replace(asked.world, household=house))).carbon_g_per_kwh or 0.0

    assert g_per_kwh(4) < 0.95 * g_per_kwh(1)
    assert g_per_kwh(4) < g_per_kwh(4, Noise.TARGET)


def test_a_car_below_the_reserve_charges_before_its_session() -> None:
    asked = run("mpc", 3)
    account = simulated(replace(asked, world=replace(asked.world, start_soc=0.1)))
    night = account.nights[0]
    assert account.flows[0].start == night.arrival
    at_reserve = next(flow for flow in account.flows if flow.soc >= 0.2)
    assert at_reserve.end < night.morning.end - timedelta(hours=8)


def test_an_unreachable_morning_is_short_and_not_missed() -> None:
    weak = replace(PAPER, capability=Capability(0.3, modulating=True), nights=Nights(minimum=0.8))
    account = simulated(run("mpc", 3, household=weak))
    assert account.nights[0].morning.soc < 0.8
    assert account.missed == 0
    assert account.nights[0].morning.missed_by == 0.0


def test_a_relay_only_switches() -> None:
    relay = replace(PAPER, capability=Capability(3.6))
    account = simulated(run("mpc", 14, household=relay))
    hours = [(flow.end - flow.start).total_seconds() / 3600 for flow in account.flows]
    assert all(flow.kwh == pytest.approx(3.6 * h) for flow, h in zip(account.flows, hours, strict=True))
    assert account.missed == 0
    assert all(night.switch_ons <= 6 for night in account.nights)
    modulating = simulated(run("mpc", 14, household=replace(PAPER, capability=Capability(3.6, modulating=True))))
    assert account.carbon_g_per_kwh == pytest.approx(modulating.carbon_g_per_kwh, rel=0.03)


def test_a_regular_driver_is_learned_after_four_weeks_and_leaves_no_morning_short() -> None:
    days = 56
    found = measured("eight weeks", synthetic_year(days=days + 5))
    regular = Driver("UTC", time(17, 30), time(10), sd_h=0.3, use_kwh=4.0, use_sd_kwh=0.5)

    def driven(learn: bool) -> Account:
        asked = paper_run("mpc", found, START, START + timedelta(days=days), horizon=2, noise=Noise.NONE, learn=learn)
        return simulated(replace(asked, world=replace(asked.world, driver=regular)))

    learned, configured = driven(learn=True), driven(learn=False)
    least = habits.LEAST_NIGHTS
    assert learned.nights[:least] == configured.nights[:least]
    assert learned.nights[least:] != configured.nights[least:]
    ends = [night.morning.end.time() for night in learned.nights]
    assert ends[0] < time(7)
    assert ends[-1] > time(8)
    assert learned.missed == learned.left_short == 0
    assert learned.carbon_g_per_kwh is not None
    assert configured.carbon_g_per_kwh is not None
    assert learned.carbon_g_per_kwh < configured.carbon_g_per_kwh
