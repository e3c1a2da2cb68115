"""Every fault that plugd can show has a name for people and says what to do: on the page, at the hub, in the docs."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from plugd import remedies
from plugd.adapters.elcon_memory import STOPPED_BY
from plugd.domain import Fault
from plugd.remedies import KNOWN

ROOT = Path(__file__).resolve().parents[2]
PASSED_ON = {("plugd/register.py", "code"), ("plugd/adapters/can_elcon.py", "STOPPED_BY[bit]")}
"""Where a fault's code is not written down, but comes from a call or a table that is looked at as well."""
IMPERATIVES = (
    "Clear", "Find", "Give", "Have", "Look", "Nothing", "Set", "Stop", "Take", "To stop", "Unplug", "Update",
)  # fmt: skip


def calls() -> Iterator[tuple[str, ast.expr]]:
    """(file, first argument) of every call that makes a fault."""
    for path in sorted((ROOT / "plugd").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and node.args:
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                if name == "Fault" or (name == "stand" and len(node.args) > 1):
                    yield str(path.relative_to(ROOT)), node.args[0]


def codes() -> set[str]:
    """Every fault code there is."""
    written = {arg.value for _, arg in calls() if isinstance(arg, ast.Constant)}
    return {str(code) for code in written} | {code for code, _ in STOPPED_BY.values()}


def test_no_code_escapes_this_test() -> None:
    others = {(file, ast.unparse(arg).lstrip("*")) for file, arg in calls() if not isinstance(arg, ast.Constant)}
    assert others == PASSED_ON
    assert len(codes()) >= 20


def test_every_fault_has_a_name_and_a_remedy_and_there_are_no_others() -> None:
    assert codes() == set(KNOWN)


@pytest.mark.parametrize("code", KNOWN)
def test_a_remedy_is_a_sentence_that_tells_somebody_to_act(code: str) -> None:
    known = KNOWN[code]
    assert known.remedy.startswith(IMPERATIVES)
    assert known.remedy.endswith(".")
    assert len(known.remedy) <= 120
    assert known.title[0].isupper()
    assert not known.title.endswith(".")
    assert (remedies.title(Fault(code, "")), remedies.remedy(Fault(code, ""))) == known


def test_a_fault_that_nobody_knows_is_still_named() -> None:
    assert remedies.title(Fault("plug_socket", "warm")) == "Plug socket"
    assert "log" in remedies.remedy(Fault("plug_socket", "warm"))


def test_the_documentation_lists_them_all_in_the_same_words() -> None:
    rows = [f"| `{code}` | {known.title} | {known.remedy} |" for code, known in KNOWN.items()]
    text = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if line.startswith("| `")] == rows


def test_every_fault_is_tried_in_a_scenario_or_a_test() -> None:
    tried = "".join(path.read_text() for path in (ROOT / "hil" / "scenarios").glob("*.yaml"))
    assert {code for code in KNOWN if f"shows: {code}," not in tried} <= NOT_IN_A_SCENARIO.keys()
    for code, path in NOT_IN_A_SCENARIO.items():
        assert code in (ROOT / path).read_text(encoding="utf-8")


NOT_IN_A_SCENARIO = {
    "can_babble": "tests/adapters/test_can_elcon.py",  # a pseudo terminal holds fewer frames than that
    "can_bus": "tests/adapters/test_can_bus.py",  # nor has it error frames
    "plug_dead_man": "tests/adapters/test_switched.py",
    "plug_meter": "tests/adapters/test_switched.py",
    "store": "tests/unit/test_cycle.py",
    "clock": "tests/unit/test_wall.py",
    "safe_mode": "tests/unit/test_safe_mode.py",
    "solver": "tests/unit/test_cycle.py",
    "weak_supply": "tests/adapters/test_supply.py",
    "taken_over": "tests/adapters/test_mqtt.py",
    "soc_stale": "tests/chaos/troubles.py",
    "history": "tests/unit/test_daemon.py",
}
"""And where it is tried instead."""
