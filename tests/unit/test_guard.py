"""The guard: on from the last safe start, held until the need is gone, and on in every doubt."""

import ast
import math
import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import plugd.guard
from plugd.guard import LEAST_NEED_KWH, LONGEST_LEAD_S, Need, Verdict, believed_kw, guard, last_safe_start

END = datetime(2026, 3, 2, 7, 0, tzinfo=UTC)
# 0.9 · 2 kW · 0.8 = 1.44 kW into the battery: 1.44 kWh take exactly an hour.
NEED = Need(session_end=END, energy_kwh=1.44)
BAD = (math.nan, math.inf, -math.inf)
needs_kwh = st.floats(-5.0, 60.0)
powers_kw = st.floats(0.05, 22.0)
offsets_s = st.floats(-2e5, 1e5)


def ask(
    now: datetime = END - timedelta(hours=5),
    need: Need | None = NEED,
    *,
    observed_kw: float | None = None,
    nominal_kw: float = 2.0,
    efficiency: float = 0.8,
    margin_s: float = 1800.0,
    guarding: bool = False,
) -> Verdict:
    return guard(
        now,
        need,
        observed_kw=observed_kw,
        nominal_kw=nominal_kw,
        efficiency=efficiency,
        margin_s=margin_s,
        guarding=guarding,
    )


def test_it_fires_at_the_last_safe_start_and_not_a_second_before() -> None:
    start = END - timedelta(hours=1, seconds=1800)
    assert last_safe_start(NEED, 2.0, 0.8, 1800.0) == start
    assert ask(start - timedelta(seconds=1)) == Verdict(on=False, last_safe_start=start, late=False)
    assert ask(start) == Verdict(on=True, last_safe_start=start, late=False)
    assert ask(start + timedelta(seconds=1)) == Verdict(on=True, last_safe_start=start, late=False)


def test_without_a_margin_it_fires_when_charging_just_suffices() -> None:
    assert last_safe_start(NEED, 2.0, 0.8, 0.0) == END - timedelta(hours=1)


def test_power_is_the_observed_one_but_never_above_the_nominal() -> None:
    assert ask(observed_kw=1.0).last_safe_start == END - timedelta(hours=2, seconds=1800)
    assert ask(observed_kw=9.0) == ask(observed_kw=2.0) == ask()


@pytest.mark.parametrize("observed_kw", [None, 0.0, -1.0, *BAD])
def test_power_nobody_can_believe_is_the_nominal_one(observed_kw: float | None) -> None:
    assert believed_kw(observed_kw, 2.0) == 2.0


def test_once_fired_it_holds_while_anything_is_needed() -> None:
    assert ask(guarding=True).on
    assert ask(need=replace(NEED, energy_kwh=LEAST_NEED_KWH), guarding=True).on
    for gone_kwh in (LEAST_NEED_KWH * 0.999, 0.0, -3.0):
        verdict = ask(need=replace(NEED, energy_kwh=gone_kwh), guarding=True)
        assert verdict == Verdict(on=False, last_safe_start=None, late=False)


def test_a_measured_zero_is_a_watt_hour() -> None:
    assert LEAST_NEED_KWH == 0.001


def test_after_the_session_end_it_goes_on_and_says_late() -> None:
    assert not ask(END - timedelta(seconds=1)).late
    assert ask(END).late
    assert ask(END + timedelta(hours=30)).on
    assert ask(END + timedelta(hours=30)).late
    assert ask(END + timedelta(hours=30), replace(NEED, energy_kwh=0.0)) == Verdict(False, None, False)


def test_nobody_asks_for_anything() -> None:
    assert ask(END, None, guarding=True) == Verdict(on=False, last_safe_start=None, late=False)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", ["efficiency", "margin_s", "nominal_kw"])
@pytest.mark.parametrize("observed_kw", [None, 1.0])
def test_numbers_that_are_none_mean_on(name: str, bad: float, observed_kw: float | None) -> None:
    numbers = {"efficiency": 0.8, "margin_s": 0.0, "nominal_kw": 2.0, name: bad}
    verdict = guard(END - timedelta(days=3), NEED, observed_kw=observed_kw, guarding=False, **numbers)
    assert verdict == Verdict(on=True, last_safe_start=None, late=False)


@pytest.mark.parametrize("bad", BAD)
def test_a_need_that_is_no_number_means_on(bad: float) -> None:
    verdict = ask(END - timedelta(days=3), replace(NEED, energy_kwh=bad))
    assert verdict == Verdict(on=True, last_safe_start=None, late=False)


@pytest.mark.parametrize(
    ("power_kw", "efficiency", "margin_s"),
    [
        (0.0, 0.8, 0.0),
        (-2.0, 0.8, 0.0),
        (1e-320, 1e-9, 0.0),
        (2.0, 0.0, 0.0),
        (2.0, -0.8, 0.0),
        (-2.0, -0.8, 0.0),
        (2.0, 1.01, 0.0),
        (2.0, 0.8, -1.0),
    ],
)
def test_numbers_that_cannot_be_give_no_start_and_mean_on(power_kw: float, efficiency: float, margin_s: float) -> None:
    assert last_safe_start(NEED, power_kw, efficiency, margin_s) is None
    early = END - timedelta(days=3)
    assert ask(early, nominal_kw=power_kw, efficiency=efficiency, margin_s=margin_s).on


def test_every_bound_of_what_is_believed_is_itself_believed() -> None:
    assert last_safe_start(replace(NEED, energy_kwh=1.8), 2.0, 1.0, 0.0) == END - timedelta(hours=1)
    assert last_safe_start(replace(NEED, energy_kwh=0.0), 2.0, 0.8, 0.0) == END
    assert last_safe_start(replace(NEED, energy_kwh=-0.1), 2.0, 0.8, 0.0) is None
    year = timedelta(seconds=LONGEST_LEAD_S)
    zero = replace(NEED, energy_kwh=0.0)
    assert last_safe_start(zero, 2.0, 0.8, LONGEST_LEAD_S) == END - year
    assert last_safe_start(zero, 2.0, 0.8, LONGEST_LEAD_S + 1.0) is None
    assert year == timedelta(days=366)


def test_power_far_below_a_kilowatt_is_believed() -> None:
    assert believed_kw(0.4, 2.0) == 0.4
    assert last_safe_start(NEED, 0.5, 0.8, 0.0) == END - timedelta(hours=4)


def test_a_verdict_is_not_late_unless_said() -> None:
    assert Verdict(on=True, last_safe_start=None) == Verdict(True, None, False)


@given(now_s=offsets_s, later_s=st.floats(0.0, 1e5), need_kwh=needs_kwh, observed_kw=powers_kw)
def test_time_never_turns_it_off(now_s: float, later_s: float, need_kwh: float, observed_kw: float) -> None:
    need = Need(END, need_kwh)
    now = END + timedelta(seconds=now_s)
    first = ask(now, need, observed_kw=observed_kw)
    second = ask(now + timedelta(seconds=later_s), need, observed_kw=observed_kw)
    assert second.on >= first.on
    assert second.late >= first.late


@given(now_s=offsets_s, need_kwh=needs_kwh, more_kwh=st.floats(0.0, 50.0), observed_kw=powers_kw)
def test_more_need_never_turns_it_off(now_s: float, need_kwh: float, more_kwh: float, observed_kw: float) -> None:
    now = END + timedelta(seconds=now_s)
    first = ask(now, Need(END, need_kwh), observed_kw=observed_kw)
    assert ask(now, Need(END, need_kwh + more_kwh), observed_kw=observed_kw).on >= first.on


@given(now_s=offsets_s, need_kwh=needs_kwh, observed_kw=powers_kw, share=st.floats(0.01, 1.0))
def test_less_power_never_turns_it_off(now_s: float, need_kwh: float, observed_kw: float, share: float) -> None:
    now = END + timedelta(seconds=now_s)
    first = ask(now, Need(END, need_kwh), observed_kw=observed_kw)
    assert ask(now, Need(END, need_kwh), observed_kw=observed_kw * share).on >= first.on


@given(now_s=offsets_s, need_kwh=needs_kwh, observed_kw=st.none() | st.floats(), guarding=st.booleans())
def test_it_is_off_only_with_time_to_spare_or_nothing_to_do(
    now_s: float, need_kwh: float, observed_kw: float | None, guarding: bool
) -> None:
    now = END + timedelta(seconds=now_s)
    verdict = ask(now, Need(END, need_kwh), observed_kw=observed_kw, guarding=guarding)
    if not verdict.on:
        spare_h = (END - now).total_seconds() / 3600.0 - 0.5
        assert need_kwh < LEAST_NEED_KWH or (
            not guarding and need_kwh <= 0.9 * believed_kw(observed_kw, 2.0) * 0.8 * spare_h + 1e-6
        )


@given(
    now_s=offsets_s,
    need_kwh=st.floats(),
    observed_kw=st.none() | st.floats(),
    nominal_kw=st.floats(),
    efficiency=st.floats(),
    margin_s=st.floats(),
)
def test_nothing_makes_it_fail(
    now_s: float,
    need_kwh: float,
    observed_kw: float | None,
    nominal_kw: float,
    efficiency: float,
    margin_s: float,
) -> None:
    verdict = ask(
        END + timedelta(seconds=now_s),
        Need(END, need_kwh),
        observed_kw=observed_kw,
        nominal_kw=nominal_kw,
        efficiency=efficiency,
        margin_s=margin_s,
    )
    known = all(map(math.isfinite, (need_kwh, nominal_kw, efficiency, margin_s)))
    assert verdict.on or known or -math.inf < need_kwh < LEAST_NEED_KWH


def test_it_imports_nothing_that_could_be_missing() -> None:
    tree = ast.parse(Path(plugd.guard.__file__).read_text(encoding="utf-8"))
    imported = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    imported |= {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    outside = {name.split(".")[0] for name in imported} - sys.stdlib_module_names
    assert outside <= {"plugd"}
    assert {name for name in imported if name.startswith("plugd")} <= {"plugd.domain", "plugd.units"}
