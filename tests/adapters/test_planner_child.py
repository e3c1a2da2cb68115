"""The planner's process: its answers, and what becomes of a plan when it hangs, dies or talks nonsense."""

import json
import os
import random
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, replace

import pytest

from plugd.adapters.planner_child import PlannerChild
from plugd.planner.exact import Exact
from plugd.planner.qp import Qp
from tests.unit.planner_problems import everyday, problem

ASKED = everyday(random.Random(1))
EXACT = replace(Exact().solve(ASKED), status="fallback")
GOOD = Exact().solve(ASKED)


@pytest.fixture(scope="module")
def shared() -> Iterator[PlannerChild]:
    """One that lives as long as it is asked, with time for a machine under load."""
    with closing(PlannerChild(patience_s=60.0)) as planner:
        yield planner


def program(text: str, patience_s: float = 60.0) -> PlannerChild:
    """A child of another kind."""
    return PlannerChild(patience_s, (sys.executable, "-S", "-c", text))


def saying(answer: object) -> PlannerChild:
    """One that answers every question with this."""
    line = answer if isinstance(answer, str) else json.dumps(answer)
    return program(f"import sys\nfor _ in sys.stdin:\n    print({line!r}, flush=True)")


@pytest.mark.parametrize("seed", range(12))
def test_its_answers_are_those_of_the_daemon_itself(shared: PlannerChild, seed: int) -> None:
    asked = problem(random.Random(seed))
    assert shared.solve(asked) == Qp().solve(asked)


def test_a_child_that_was_killed_is_started_again(shared: PlannerChild) -> None:
    assert shared.solve(ASKED).status == "solved"
    child = shared._child
    assert child is not None
    os.kill(child.pid, signal.SIGKILL)
    child.wait(10.0)
    assert shared.solve(ASKED).status == "solved"
    assert shared._child is not None
    assert shared._child.pid != child.pid


def test_it_ends_by_itself_and_leaves_nothing_defunct() -> None:
    with closing(PlannerChild(patience_s=60.0)) as planner:
        before = planner.solve(ASKED)
        child = planner._child
        assert child is not None
        assert child.wait(20.0) == 0
        assert planner.solve(ASKED) == before
    assert planner._child is None


def test_it_ends_with_the_daemon() -> None:
    planner = PlannerChild(patience_s=60.0)
    planner.solve(ASKED)
    child = planner._child
    planner.close()
    assert child is not None
    assert child.returncode == -signal.SIGKILL


def test_one_that_hangs_costs_its_time_once_and_the_plan_is_the_exact_one(caplog: pytest.LogCaptureFixture) -> None:
    with closing(program("import signal; signal.pause()", patience_s=0.2)) as planner:
        assert planner.solve(ASKED) == EXACT
        assert planner._child is None  # and is not left behind
        assert planner.solve(ASKED) == EXACT
    assert [record.getMessage() for record in caplog.records] == [
        "the planner's process failed (no answer within 0.2 s); plans are the exact solver's for a while"
    ]


def test_one_that_never_reads_does_not_hold_the_daemon() -> None:
    much = replace(ASKED, sessions=ASKED.sessions * 60)  # more than a pipe holds
    with closing(program("import signal; signal.pause()", patience_s=0.2)) as planner:
        assert planner.solve(much).status == "fallback"


@pytest.mark.parametrize(
    ("planner", "why"),
    [
        (program("raise SystemExit(3)"), "it ended with 3"),
        (program("import os; os.abort()"), "it ended with -6"),
        (program("print('x' * 11_000_000)"), "it talks without end"),
        (PlannerChild(command=("/nowhere/python",)), "No such file"),
        (saying(""), "Expecting value"),
        (saying("[" * 5000), "maximum recursion depth|Expecting value"),
        (saying([]), "mapping"),
        (saying({}), "missing"),
        (saying(asdict(GOOD) | {"more": 1}), "unexpected keyword"),
        (saying(asdict(GOOD) | {"power_kw": GOOD.power_kw[:2]}), "shorter"),
        (saying(asdict(GOOD) | {"power_kw": [p[:-1] for p in GOOD.power_kw]}), "shorter"),
        (saying(asdict(GOOD) | {"power_kw": [[-1.0] * len(p) for p in GOOD.power_kw]}), "-1.0 kW"),
        (saying(asdict(GOOD) | {"power_kw": [[float("nan")] * len(p) for p in GOOD.power_kw]}), "nan kW"),
        (saying(asdict(GOOD) | {"power_kw": [["1"] * len(p) for p in GOOD.power_kw]}), "not supported"),
    ],
)
def test_one_that_errs_is_done_without(planner: PlannerChild, why: str, caplog: pytest.LogCaptureFixture) -> None:
    with closing(planner):
        assert planner.solve(ASKED) == EXACT
    assert len(caplog.records) == 1
    assert re.search(why, caplog.text)


def test_a_sound_answer_is_believed() -> None:
    """The counterpart of the test before: it is what they say that is refused, not who they are."""
    with closing(saying(asdict(GOOD))) as planner:
        assert planner.solve(ASKED) == GOOD
