"""The explanation in words and JSON: what a person reads of each case, and the local times of a house."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from plugd import explanation, outlook, sessions
from plugd.domain import Household, Overrides, Presence
from plugd.planner import exact, nights
from plugd.planner.marginal import explain
from plugd.planner.problem import Problem, ProblemSession


def session(intensity: tuple[float, ...], minimum_kwh: float, use_kwh: float = 5.0) -> ProblemSession:
    n = len(intensity)
    return ProblemSession(intensity, (0.5,) * n, (10.0,) * n, minimum_kwh, 40.0, use_kwh)


def words(asked: Problem) -> list[str]:
    found = explain(asked, exact.solve(asked))
    return explanation.lines(found, 50.0, explanation.numbered(found))


CASES = {
    "the dearest slot used, the cheapest left, the price of a per cent": (
        Problem(20.0, 10.0, 1.0, (session((300.0, 100.0, 200.0), 27.0),)),
        [
            "session 1: 7.0 kWh; dearest used slot 3 (200 g/kWh), cheapest unused slot 1 (300 g/kWh)",
            "  ends at its morning minimum: 1 % less saves 100.0 g, 1 % more costs 100.0 g",
        ],
    ),
    "nothing charged": (
        Problem(30.0, 10.0, 1.0, (session((300.0, 100.0), 25.0),)),
        [
            "session 1: nothing charged; cheapest unused slot 2 (100 g/kWh)",
            "  no bound holds it: it ends where more would cost more than it saves",
        ],
    ),
    "a day without a session": (
        Problem(30.0, 10.0, 1.0, (session((), 25.0),)),
        [
            "session 1: nothing to charge; no slot has room",
            "  no bound holds it: it ends where more would cost more than it saves",
        ],
    ),
    "out of reach": (
        Problem(20.0, 10.0, 1.0, (session((100.0,), 27.0),)),
        [
            "session 1: 5.0 kWh; dearest used slot 1 (100 g/kWh), no slot left unused",
            "  ends 2.0 kWh short of its morning minimum, which cannot be reached",
        ],
    ),
    "the reserve, and energy left for its worth": (
        Problem(
            15.0,
            10.0,
            1.0,
            (session((200.0,) * 2, 11.0, 9.0), session((50.0, 90.0), 10.0)),
            end_value=((20.0, 80.0),),
        ),
        [
            "session 1: 4.0 kWh; dearest used slot 1 (200 g/kWh), cheapest unused slot 2 (200 g/kWh)",
            "  ends at what the way home and the reserve need: 1 % less saves 60.0 g, 1 % more costs 60.0 g",
            "session 2: 5.0 kWh; dearest used slot 1 (50 g/kWh), cheapest unused slot 2 (90 g/kWh)",
            "  no bound holds it: it ends where more would cost more than it saves",
            "5.0 kWh charged early in session 2, to be left after the last one: 50 against 80 g/kWh that it is worth "
            "there",
        ],
    ),
    "a ceiling, and energy moved to a cleaner night": (
        Problem(
            25.0,
            10.0,
            1.0,
            (replace(session((50.0,) * 2, 25.0, 10.0), ceiling_kwh=30.0), session((200.0,) * 3, 25.0)),
        ),
        [
            "session 1: 5.0 kWh; dearest used slot 1 (50 g/kWh), cheapest unused slot 2 (50 g/kWh)",
            "  ends at its ceiling; 1 % more ceiling would save 75.0 g",
            "session 2: 5.0 kWh; dearest used slot 1 (200 g/kWh), cheapest unused slot 2 (200 g/kWh)",
            "  ends at its morning minimum: 1 % less saves 100.0 g, 1 % more costs 100.0 g",
            "5.0 kWh charged early in session 1, not in session 2: 50 against 200 g/kWh",
        ],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_a_person_reads(case: str) -> None:
    asked, wanted = CASES[case]
    assert words(asked) == wanted


def test_as_json_what_cannot_be_had_is_null_and_all_is_finite() -> None:
    asked = CASES["out of reach"][0]
    found = explain(asked, exact.solve(asked))
    told = explanation.document(found, 50.0, explanation.numbered(found))
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert told["sessions"][0] == {
        "session": 0,
        "charged_kwh": 5.0,
        "dearest_used": {"slot": 0, "g_per_kwh": 100.0},
        "cheapest_unused": None,
        "ends_at": "minimum",
        "minimum": {"less_saves_g_per_pct": 50.0, "more_costs_g_per_pct": None},
        "reserve": {"less_saves_g_per_pct": 0.0, "more_costs_g_per_pct": 0.0},
        "ceiling": {"more_saves_g_per_pct": 0.0},
        "short_kwh": 2.0,
    }
    moved = CASES["a ceiling, and energy moved to a cleaner night"][0]
    found = explain(moved, exact.solve(moved))
    told = explanation.document(found, 50.0, explanation.numbered(found))
    assert told["moved"] == [
        {"kwh": 5.0, "charged_in": 0, "instead_of": 1, "g_per_kwh": 50.0, "instead_g_per_kwh": 200.0}
    ]


def test_a_house_has_local_times_in_words_and_utc_in_json() -> None:
    house = Household()
    now = datetime(2023, 7, 3, 12, tzinfo=UTC)
    coming = sessions.expected(now, house, Overrides(), Presence(), 2)
    parts = nights.layout(coming, now, 20.0, 2.3, house)
    asked = nights.problem(parts, outlook.extend(None, (), now, coming[-1].end), 20.0, None, house)
    found = explain(asked, exact.solve(asked))
    names = explanation.dated(parts, house.timezone)
    text = explanation.lines(found, 50.0, names)
    assert text[0].startswith("Mon 03 Jul 20:03 to Tue ")
    slot = found.margins[0].dearest_used
    assert slot is not None
    start = parts[0].pieces[slot.slot].start
    told = explanation.document(found, 50.0, names)["sessions"][0]["dearest_used"]
    assert told["start"] == f"{start:%Y-%m-%dT%H:%M:%S}Z"
    assert f"dearest used {(start.hour + 1) % 24:02d}:{start:%M} (" in text[0]  # British Summer Time
