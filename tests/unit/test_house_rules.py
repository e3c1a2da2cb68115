"""What must hold of the source itself: the daemon does not know simulated time, and the bench runs that daemon."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LOOP = ("plugd/daemon.py", "plugd/cycle.py")
KNOWN_VARIABLES = {"STATE_DIRECTORY", "NOTIFY_SOCKET"}
"""What the daemon reads of its environment: systemd's words for the state folder, and for where it listens."""
BENCH_WORDS = ("plugd_hil", "conductor", "simulat", "demo", "participant", "fake")
CLOCK_WORDS = {"now", "monotonic", "wait"}


def names_time(source: str) -> list[str]:
    """Words of the bench anywhere in a source, comments and texts too."""
    return [word for word in BENCH_WORDS if word in source.lower()]


def variables(source: str) -> set[str]:
    """Environment variables that a source reads; `?` for one that is not written out."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case (
                ast.Call(func=ast.Attribute(value=ast.Attribute(attr="environ")), args=[key, *_])
                | ast.Call(func=ast.Attribute(attr="getenv"), args=[key, *_])
                | ast.Subscript(value=ast.Attribute(attr="environ"), slice=key)
                | ast.Compare(left=key, comparators=[ast.Attribute(attr="environ")])
            ):
                found.add(str(key.value) if isinstance(key, ast.Constant) else "?")
            case ast.ImportFrom(module="os", names=names) if {n.name for n in names} & {"environ", "getenv"}:
                found.add("?")
    return found


def asks_the_clock(source: str) -> list[str]:
    """What a source does with a clock beyond handing it on and calling the port's three methods."""
    tree = ast.parse(source)
    parent = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    found = []
    for node in ast.walk(tree):
        is_clock = (isinstance(node, ast.Name) and node.id == "clock") or (
            isinstance(node, ast.Attribute) and node.attr == "clock"
        )
        if not is_clock:
            continue
        match parent[node]:
            case ast.Attribute(attr=attr) if attr in CLOCK_WORDS:
                continue
            case ast.Call(func=ast.Name(id=name)) if name[0].isupper() or name in ("plug_for", "cycle_for"):
                continue
            case ast.keyword(arg="clock") | ast.AnnAssign():
                continue
        found.append(ast.unparse(parent[node]))
    return found


@pytest.mark.parametrize("path", LOOP)
def test_the_loop_has_no_branch_on_simulated_time(path: str) -> None:
    source = (ROOT / path).read_text()
    assert names_time(source) == []
    assert variables(source) <= KNOWN_VARIABLES
    assert asks_the_clock(source) == []


@pytest.mark.parametrize(
    "added",
    [
        "if isinstance(clock, SystemClock): pass",
        "fast = type(clock) is not SystemClock",
        "if clock.simulated: pass",
        "speed = getattr(clock, 'speed', 1)",
        "if self.clock == other: pass",
        "match clock:\n    case SystemClock(): pass",
    ],
)
def test_a_question_to_the_clock_would_be_found(added: str) -> None:
    assert asks_the_clock(added)


@pytest.mark.parametrize(
    "added",
    [
        'os.environ.get("PLUGD_FAST")',
        'os.environ["PLUGD_FAST"]',
        'os.getenv("PLUGD_FAST")',
        '"PLUGD_FAST" in os.environ',
        "from os import environ",
    ],
)
def test_an_environment_variable_would_be_found(added: str) -> None:
    assert not variables(added) <= KNOWN_VARIABLES


def test_a_word_of_the_bench_would_be_found() -> None:
    assert names_time("import plugd_hil.conductor  # a simulated clock")


# -- the bench's daemon ---------------------------------------------------------------------------

BENCH_IMPORTS = {
    "argparse",
    "logging",
    "sys",
    "pathlib.Path",
    "plugd.daemon",
    "plugd.config.handed.load",
    "plugd.errors.PlugdError",
    "plugd_hil.conductor.Participant",
}


def imported(tree: ast.AST) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def strays(source: str) -> list[str]:
    """What a program does to the daemon beyond `daemon.run(load(<path>), clock)`, once, with a Participant."""
    tree = ast.parse(source)
    uses = [n for n in ast.walk(tree) if isinstance(n, ast.Attribute) and ast.unparse(n.value) == "daemon"]
    found = [f"daemon.{use.attr}" for use in uses if use.attr != "run"]
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and ast.unparse(n.func) == "daemon.run"]
    found += [ast.unparse(c) for c in calls if ast.unparse(c) != "daemon.run(load(options.config), clock)"]
    found += sorted(imported(tree) - BENCH_IMPORTS)
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "clock":
            found += [] if ast.unparse(node.value).startswith("Participant(") else [ast.unparse(node)]
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("setattr", "exec", "eval", "__import__"):
            found.append(ast.unparse(node))
        if isinstance(node, ast.Assign | ast.AugAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found += [ast.unparse(node) for t in targets if not isinstance(t, ast.Name | ast.Tuple)]
    return found if len(uses) == len(calls) == 1 else [*found, f"{len(uses)} uses of the daemon"]


def test_the_bench_runs_the_daemon_with_another_clock_and_nothing_else() -> None:
    assert strays((ROOT / "hil/plugd_hil/daemon.py").read_text()) == []


@pytest.mark.parametrize(
    "added",
    [
        "daemon.Qp = Exact",
        "daemon.BROKER_PATIENCE_S = 0",
        "import plugd.cycle",
        "from plugd.adapters import tasmota",
        "setattr(daemon, 'Tasmota', None)",
        "logging.Logger.info = None",
        "daemon.run(load(options.config), clock)",
        "daemon.run(load(options.config), clock, fast=True)",
        "clock = SystemClock()",
    ],
)
def test_anything_else_would_be_found(added: str) -> None:
    source = (ROOT / "hil/plugd_hil/daemon.py").read_text()
    assert strays(f"{source}\n{added}\n")


def test_the_command_and_the_demo_run_the_same_daemon() -> None:
    run = next(
        node
        for node in ast.walk(ast.parse((ROOT / "plugd/cli/run.py").read_text()))
        if isinstance(node, ast.FunctionDef) and node.name == "_run"
    )
    assert "daemon.run(load(config_path(options)), clock, unset)" in ast.unparse(run)
    started = ast.unparse(ast.parse((ROOT / "hil/plugd_hil/demo_run.py").read_text()))
    assert "children.start('plugd', 'plugd_hil.daemon', '-c', str(config), '--clock', clock, *look)" in started


# -- without numbers' libraries -------------------------------------------------------------------

BLOCKED = """
import sys
sys.modules.update(dict.fromkeys(("numpy", "scipy", "osqp")))
import plugd.guard, plugd.planner.exact, plugd.planner.problem
from datetime import UTC, datetime, timedelta
now = datetime(2023, 1, 2, 5, tzinfo=UTC)
need = plugd.guard.Need(now + timedelta(hours=1), 10.0)
verdict = plugd.guard.guard(
    now, need, observed_kw=None, nominal_kw=2.3, efficiency=0.9, margin_s=1800.0, guarding=False
)
print(verdict.on)
"""


def test_guard_and_exact_planner_work_where_numpy_and_osqp_cannot_be_imported() -> None:
    said = subprocess.run(
        [sys.executable, "-c", BLOCKED],
        check=False,
        capture_output=True,
        text=True,
        env={"PYTHONPATH": str(ROOT)},
    )
    assert (said.stdout, said.stderr) == ("True\n", "")


HEAVY = ("can", "cantools", "matplotlib", "numpy", "osqp", "prometheus_client", "scipy")


def test_the_daemon_and_its_page_start_without_what_they_do_not_need() -> None:
    """OSQP and its arrays are half of the memory of a daemon that has them; the others are for few."""
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({HEAVY}))\n"
        "import plugd.adapters.clock, plugd.adapters.planner_child, plugd.daemon, plugd.web.app, plugd.web.server"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stderr == ""
