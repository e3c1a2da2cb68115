"""Problem files: what is read, what is refused and how that is said, and the answer's shape."""

import json
import random
from math import inf, isfinite
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plugd.errors import UsageError
from plugd.planner import exact
from plugd.planner.qp import Qp
from plugd.problem_file import MAX_BYTES, answer, read

Document = dict[str, Any]


def document(**changes: Any) -> Document:
    """The example of the interface, with two sessions."""
    whole: Document = {
        "slot_h": 0.5,
        "power_max_kw": 10.0,
        "capacity_kwh": 50.0,
        "efficiency": 1.0,
        "soc_pct": 43.0,
        "soc_min_pct": 20.0,
        "soc_max_pct": 80.0,
        "sessions": [
            {"intensity": [212.0, 198.0, 150.0], "morning_minimum_pct": 50.0, "daily_use_kwh": 11.28},
            {"intensity": [100, 300], "morning_minimum_pct": 35.0, "daily_use_kwh": 11.28},
        ],
        "end_value_g_per_kwh": 0.0,
        "previous_power_kw": None,
    }
    return {**whole, **changes}


def with_session(**changes: Any) -> Document:
    """The example with its second session changed."""
    whole = document()
    whole["sessions"][1] = {**whole["sessions"][1], **changes}
    return whole


def without(key: str) -> Document:
    whole = document()
    del whole[key]
    return whole


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "night.json"


def said(file: Path, text: str | bytes) -> str:
    """The complaint about a file of this text: one line that begins with the file's name."""
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(UsageError) as refused:
        read(file)
    complaint = str(refused.value)
    assert complaint.startswith(f"{file}: ")
    assert "\n" not in complaint
    return complaint.removeprefix(f"{file}: ")


def test_a_file_becomes_a_problem(file: Path) -> None:
    file.write_text(json.dumps(document(efficiency=0.9, end_value_g_per_kwh=80)))
    problem, echo = read(file)
    first, second = problem.sessions
    assert echo.capacity_kwh == 50
    assert (problem.energy_kwh, problem.reserve_kwh, problem.efficiency) == (21.5, 10.0, 0.9)
    assert first.intensity_g_per_kwh == (212.0, 198.0, 150.0)
    assert (first.slot_h, first.power_max_kw) == ((0.5,) * 3, (10.0,) * 3)
    assert (first.minimum_kwh, first.ceiling_kwh, first.daily_use_kwh) == (25.0, 40.0, 11.28)
    assert second.intensity_g_per_kwh == (100.0, 300.0)
    assert problem.end_value == ((inf, 80.0),)
    assert problem.previous_power_kw is None


def test_a_session_may_have_its_own_slots_powers_and_ceiling(file: Path) -> None:
    own = with_session(slot_h=[0.2, 0.5], power_max_kw=[0, 7.4], power_min_kw=1.4, soc_max_pct=90)
    file.write_text(json.dumps(own))
    second = read(file)[0].sessions[1]
    assert (second.slot_h, second.power_max_kw, second.power_min_kw) == ((0.2, 0.5), (0.0, 7.4), 1.4)
    assert second.ceiling_kwh == 45
    file.write_text(json.dumps(with_session(slot_h=1, power_max_kw=3)))
    second = read(file)[0].sessions[1]
    assert (second.slot_h, second.power_max_kw) == ((1.0, 1.0), (3.0, 3.0))


def test_a_day_without_a_session(file: Path) -> None:
    file.write_text(json.dumps(with_session(intensity=[], power_min_kw=1.4)))
    assert read(file)[0].sessions[1].slot_h == ()


@pytest.mark.parametrize("given", [[1, 2, 3, 4, 5], [[1, 2, 3], [4, 5]]])
def test_the_plan_before_is_flat_or_nested(file: Path, given: object) -> None:
    file.write_text(json.dumps(document(previous_power_kw=given)))
    assert read(file)[0].previous_power_kw == ((1.0, 2.0, 3.0), (4.0, 5.0))


def test_optional_keys_may_be_left_out(file: Path) -> None:
    whole = document()
    del whole["end_value_g_per_kwh"], whole["previous_power_kw"]
    file.write_text(json.dumps(whole))
    assert read(file)[0].end_value == ()


def test_falling_steps_of_the_end_value(file: Path) -> None:
    file.write_text(json.dumps(document(end_value_g_per_kwh=[[5, 120], [2.5, 120], [1, 0]])))
    assert read(file)[0].end_value == ((5.0, 120.0), (2.5, 120.0), (1.0, 0.0))


def test_a_byte_order_mark_does_no_harm(file: Path) -> None:
    file.write_text(json.dumps(document()), encoding="utf-8-sig")
    assert len(read(file)[0].sessions) == 2


REFUSED = [
    (document(capacity_kwh=-50), "capacity_kwh is -50; it must lie above 0"),
    (document(capacity_kwh=0), "capacity_kwh is 0; it must lie above 0"),
    (document(capacity_kwh="50"), 'capacity_kwh is "50"; a number is wanted'),
    (document(capacity_kwh=True), "capacity_kwh is true; a number is wanted"),
    (document(capacity_kwh=None), "capacity_kwh is null; a number is wanted"),
    (document(capacity_kwh=[50]), "capacity_kwh is a list; a number is wanted"),
    (document(capacity_kwh={}), "capacity_kwh is an object; a number is wanted"),
    (document(capacity_kwh=10**400), "capacity_kwh is Infinity; a finite number is wanted"),
    (document(capacity_kwh=1e7), "capacity_kwh is 10000000; it must lie above 0 up to 1000000"),
    (document(power_max_kw=0), "power_max_kw is 0; it must lie above 0"),
    (document(power_max_kw=[10]), "power_max_kw is a list; a number is wanted"),
    (document(slot_h=0), "slot_h is 0; it must lie above 0"),
    (document(efficiency=0), "efficiency is 0; it must lie from 0.01 to 1"),
    (document(efficiency=90), "efficiency is 90; it must lie from 0.01 to 1"),
    (document(soc_pct=101), "soc_pct is 101; it must lie from 0 to 100"),
    (document(soc_pct=-1), "soc_pct is -1; it must lie from 0 to 100"),
    (document(soc_min_pct=-1), "soc_min_pct is -1; it must lie from 0 to 100"),
    (document(soc_max_pct=101), "soc_max_pct is 101; it must lie from 0 to 100"),
    (document(soc_max_pct=20), "soc_max_pct is 20; it must lie above soc_min_pct, 20"),
    (document(colour="red"), "colour is not known; known are"),
    (document(**{"two words\n": 1}), '"two words\\n" is not known; known are'),
    (without("capacity_kwh"), "capacity_kwh is missing; add it"),
    (without("sessions"), "sessions is missing; add it"),
    (document(sessions=[]), "sessions is a list; a list of at least one session is wanted"),
    (document(sessions={}), "sessions is an object; a list of at least one"),
    (document(sessions=[[1.0]]), "sessions[0] is a list; an object {...} is wanted"),
    (document(sessions=[{}]), "sessions[0].daily_use_kwh is missing; add it"),
    (with_session(intensity=[1.0, float("nan")]), "sessions[1].intensity[1] is NaN; a finite number is wanted"),
    (with_session(intensity=[-inf, 1.0]), "sessions[1].intensity[0] is -Infinity; a finite number is wanted"),
    (with_session(intensity=[[1.0], 1.0]), "sessions[1].intensity[0] is a list; a number is wanted"),
    (with_session(intensity=[None, 1.0]), "sessions[1].intensity[0] is null; a number is wanted"),
    (with_session(intensity=[1.0, False]), "sessions[1].intensity[1] is false; a number is wanted"),
    (with_session(intensity=200), "sessions[1].intensity is 200; a list of numbers is wanted"),
    (with_session(intensity=[1e300, 1]), "sessions[1].intensity[0] is 1e+300; it must lie from -1000000 to"),
    (with_session(intensity=[1.0] * 20_001), "sessions[1].intensity has 20001 slots; at most 20000"),
    (with_session(intensity=[1.0] * 19_998), "sessions has 20001 slots in all; at most 20000"),
    (with_session(power_max_kw=[1.0]), "sessions[1].power_max_kw has 1 numbers; its session has 2 slots"),
    (with_session(power_max_kw=[1.0, -1.0]), "sessions[1].power_max_kw[1] is -1; it must lie from 0"),
    (with_session(power_max_kw=0), "sessions[1].power_max_kw is 0; it must lie above 0"),
    (with_session(slot_h=[0.5, 0.0]), "sessions[1].slot_h[1] is 0; it must lie above 0"),
    (with_session(power_min_kw=11), "sessions[1].power_min_kw is 11; it must not exceed power_max_kw, 10"),
    (with_session(power_min_kw=-1), "sessions[1].power_min_kw is -1; it must lie from 0"),
    (with_session(soc_max_pct=10), "sessions[1].soc_max_pct is 10; it must lie above soc_min_pct, 20"),
    (with_session(morning_minimum_pct=150), "sessions[1].morning_minimum_pct is 150; it must lie from 0 to 100"),
    (with_session(daily_use_kwh=-1), "sessions[1].daily_use_kwh is -1; it must lie from 0"),
    (with_session(note="x"), "sessions[1].note is not known; known are"),
    (document(end_value_g_per_kwh=-1), "end_value_g_per_kwh is -1; it must lie from 0"),
    (document(end_value_g_per_kwh="x"), 'end_value_g_per_kwh is "x"; a number is wanted'),
    (document(end_value_g_per_kwh=[1, 2]), "end_value_g_per_kwh[0] is not a pair; write [kWh, g per kWh]"),
    (document(end_value_g_per_kwh=[[1, 2, 3]]), "end_value_g_per_kwh[0] is not a pair"),
    (document(end_value_g_per_kwh=[[1, 2], [1, 3]]), "end_value_g_per_kwh[1][1] is 3, more than the step before"),
    (document(end_value_g_per_kwh=[[0, 2]]), "end_value_g_per_kwh[0][0] is 0; it must lie above 0"),
    (document(end_value_g_per_kwh=[[1, -2]]), "end_value_g_per_kwh[0][1] is -2; it must lie from 0"),
    (document(end_value_g_per_kwh=[[1, 2]] * 1001), "end_value_g_per_kwh has 1001 steps; at most 1000"),
    (document(previous_power_kw=7), "previous_power_kw is 7; null, a number per slot or a list per session"),
    (document(previous_power_kw=[1, 2]), "previous_power_kw has 2 numbers; the sessions have 5 slots"),
    (document(previous_power_kw=[[1, 2, 3]]), "previous_power_kw has 1 lists; there are 2 sessions"),
    (document(previous_power_kw=[[1, 2, 3], [4]]), "previous_power_kw[1] has 1 numbers; its session has 2 slots"),
    (document(previous_power_kw=[[1, 2, 3], 4]), "previous_power_kw[1] is 4; a list of numbers is wanted"),
    (document(previous_power_kw=[1, 2, 3, 4, -1]), "previous_power_kw[4] is -1; it must lie from 0"),
]


@pytest.mark.parametrize(("whole", "complaint"), REFUSED, ids=[text[:40] for _, text in REFUSED])
def test_what_cannot_be_used_is_named_with_its_key_and_the_remedy(file: Path, whole: Document, complaint: str) -> None:
    assert said(file, json.dumps(whole)).startswith(complaint)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "is empty; write one JSON object"),
        (" \n\t", "is empty; write one JSON object"),
        ("{", "line 1, column 2: Expecting property name enclosed in double quotes; write one JSON object"),
        ('{\n "a": 1,,\n}', "line 2, column 9: "),
        ("{} {}", "line 1, column 4: Extra data"),
        ("[]", "the document is a list; an object {...} is wanted"),
        ("null", "the document is null; an object"),
        ("7", "the document is 7; an object"),
        ("NaN", "the document is NaN; an object"),
        ('{"slot_h": 1, "slot_h": 2}', '"slot_h" is given twice in one object; keep one'),
        ("[" * 1_000_000, "is nested too deeply"),
        ('{"a":' * 1_000_000, "is nested too deeply"),
        (b'{"\xff": 1}', "is not UTF-8 (byte 2); save it as UTF-8"),
        (json.dumps(document()).encode("utf-16"), "is not UTF-8 (byte 0)"),
        ('{"\\ud800": 1}', '"\\ud800" is not known'),
        (" " * (MAX_BYTES + 1), "is larger than 8 MB; give a problem of at most 20000 slots"),
        (json.dumps(document()).replace("43.0", "1e999"), "soc_pct is Infinity; a finite number is wanted"),
        (json.dumps(document()).replace("43.0", "9" * 6000), "soc_pct is Infinity; a finite number is wanted"),
    ],
    ids=range(18),
)
def test_what_is_no_document(file: Path, text: str | bytes, complaint: str) -> None:
    assert said(file, text).startswith(complaint)


@pytest.mark.parametrize(("name", "complaint"), [("none.json", "No such file"), (".", "Is a directory")])
def test_what_is_no_file(tmp_path: Path, name: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=f"cannot be read: {complaint}"):
        read(tmp_path / name)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
KEYS = [*document(), *(f"sessions.{key}" for key in ("intensity", "daily_use_kwh", "power_max_kw", "slot_h"))]


@settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(key=st.sampled_from(KEYS), value=JSON)
def test_any_value_anywhere_is_planned_finitely_or_refused_in_one_line(file: Path, key: str, value: object) -> None:
    session, _, own = key.partition(".")
    whole = with_session(**{own: value}) if own else document(**{session: value})
    file.write_text(json.dumps(whole))
    complaint = ""
    try:
        problem, echo = read(file)
    except UsageError as refused:
        complaint = str(refused)
    else:
        json.dumps(answer(echo, exact.solve(problem), 0.1), allow_nan=False)
    assert "\n" not in complaint


def test_the_answer_has_the_keys_of_the_interface(file: Path) -> None:
    file.write_text(json.dumps(document()))
    problem, echo = read(file)
    told = answer(echo, Qp().solve(problem), 0.25)
    assert list(told) == [
        *("status", "solver", "power_kw", "soc_pct", "shortfall_kwh", "reserve_short_kwh"),
        *("carbon_g", "bound_g", "gap", "raw_gap", "iterations", "solve_ms"),
    ]
    assert (told["status"], told["solver"], told["solve_ms"]) == ("solved", "osqp", 0.25)
    assert [len(powers) for powers in told["power_kw"]] == [3, 2]
    assert told["soc_pct"] == pytest.approx([50.0, 35.0], abs=0.01)
    assert told["carbon_g"] == pytest.approx(3.5 * 150 + 3.78 * 100, rel=5e-4)
    assert told["bound_g"] == pytest.approx(3.5 * 150 + 3.78 * 100)


def test_an_unreachable_minimum_is_a_repaired_plan_with_its_shortfall(file: Path) -> None:
    file.write_text(json.dumps(document(soc_pct=14)))
    problem, echo = read(file)
    for told in (answer(echo, exact.solve(problem), 0.1), answer(echo, Qp().solve(problem), 0.1)):
        assert told["status"] == "repaired"
        assert told["power_kw"][0] == [10.0, 10.0, 10.0]
        assert told["soc_pct"][0] == 44.0
        assert told["shortfall_kwh"] == [3.0, 0.0]


@pytest.mark.parametrize(("sessions", "slots"), [(1, 20_000), (909, 22), (20_000, 1), (20, 1000)])
def test_twenty_thousand_slots_are_planned(file: Path, sessions: int, slots: int) -> None:
    rng = random.Random(5)
    own = [
        {"intensity": [rng.uniform(50, 300) for _ in range(slots)], "morning_minimum_pct": 50, "daily_use_kwh": 11}
        for _ in range(sessions)
    ]
    file.write_text(json.dumps(document(sessions=own)))
    problem, echo = read(file)
    best = answer(echo, exact.solve(problem), 0.1)
    told = answer(echo, Qp().solve(problem), 0.1)
    assert told["carbon_g"] == pytest.approx(best["carbon_g"], rel=5e-4)
    assert told["status"] in (best["status"], "fallback")
    assert all(isfinite(pct) for pct in told["soc_pct"])
