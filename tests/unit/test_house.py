"""The house: what is left out and what is required, the lock, the layers, the rules, the Makefile, CI."""

import os
import re
import socket
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from plugd_hil.broker import Mosquitto, find_mosquitto
from tests.conftest import COMPONENTS

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CLEAN = {key: value for key, value in os.environ.items() if not key.startswith(("PLUGD_", "MAKE", "PYTEST_"))}


def run(*command: str, cwd: Path = ROOT, **environment: str) -> subprocess.CompletedProcess[str]:
    """A program's answer, its stdin empty."""
    return subprocess.run(
        command,
        check=False,
        cwd=cwd,
        env=CLEAN | environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )


# -- left out, and required -----------------------------------------------------------------------

NEEDY = """
import pytest

def test_plain(): pass
def test_series(neso_data): assert (neso_data / "neso_national_2023.csv").is_file()
@pytest.mark.requires("data")
def test_marked(): pass
"""
PLAIN = "def test_plain(): pass\n"


@pytest.fixture
def series(tmp_path: Path) -> Path:
    folder = tmp_path / "series"
    folder.mkdir()
    (folder / "neso_national_2023.csv").write_text("from,forecast,actual\n")
    return folder


def suite(pytester: pytest.Pytester, source: str, **environment: str) -> tuple[int, str]:
    """Exit code and output of a small suite under this project's own conftest."""
    (pytester.path / "conftest.py").write_text((ROOT / "tests" / "conftest.py").read_text())
    (pytester.path / "test_small.py").write_text(source)
    (pytester.path / "pytest.ini").write_text(
        "[pytest]\naddopts = -p no:cacheprovider --strict-markers\nmarkers = requires(component): as here"
    )
    result = run(
        sys.executable,
        "-m",
        "pytest",
        cwd=pytester.path,
        PYTHONPATH=f"{ROOT}:{ROOT / 'hil'}",
        COLUMNS="200",
        **environment,
    )
    return result.returncode, result.stdout + result.stderr


def test_what_is_missing_is_left_out_and_named(pytester: pytest.Pytester) -> None:
    code, said = suite(pytester, NEEDY, PLUGD_DATA="nowhere")
    assert code == 0
    assert "1 passed, 2 skipped" in said
    assert re.search(r"= left out =+\n(.*\n)*data: 2 tests; set PLUGD_DATA", said)


def test_what_is_there_is_used(pytester: pytest.Pytester, series: Path) -> None:
    code, said = suite(pytester, NEEDY, PLUGD_DATA=str(series), PLUGD_REQUIRE="data")
    assert code == 0
    assert "3 passed" in said
    assert "data: " not in said


@pytest.mark.parametrize("source", [NEEDY, PLAIN])
def test_a_required_component_that_is_missing_fails_the_run(pytester: pytest.Pytester, source: str) -> None:
    code, said = suite(pytester, source, PLUGD_DATA="nowhere", PLUGD_REQUIRE="data")
    assert code == pytest.ExitCode.USAGE_ERROR
    assert "PLUGD_REQUIRE: data is missing; set PLUGD_DATA" in said


def test_requiring_what_nobody_knows_fails_the_run(pytester: pytest.Pytester) -> None:
    code, said = suite(pytester, PLAIN, PLUGD_REQUIRE="mosqito")
    assert code == pytest.ExitCode.USAGE_ERROR
    assert "unknown component mosqito; known: mosquitto, data, dask, chromium, multicast" in said


def test_a_mark_that_nobody_knows_fails_the_run(pytester: pytest.Pytester) -> None:
    source = "import pytest\n@pytest.mark.requires('mosqito')\ndef test_it(): pass\n"
    code, said = suite(pytester, source)
    assert code == pytest.ExitCode.USAGE_ERROR
    assert "requires unknown mosqito" in said


def test_a_runaway_test_is_ended() -> None:
    assert 0 < PROJECT["tool"]["pytest"]["ini_options"]["timeout"] <= 120
    assert "pytest-timeout" in {re.split(r"[<>=]", each)[0] for each in extras()["dev"]}


# -- the broker -----------------------------------------------------------------------------------


def test_the_broker_is_found_off_the_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "mosquitto"
    monkeypatch.setattr("plugd_hil.broker.SBIN", (str(tmp_path),))
    assert find_mosquitto("/nowhere") is None
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    assert find_mosquitto("/nowhere") == program


def greet(broker: Mosquitto) -> socket.socket:
    """A connection that the broker has accepted, in MQTT 3.1.1."""
    connection = socket.create_connection((broker.host, broker.port), timeout=10)
    connection.sendall(b"\x10\x0c\x00\x04MQTT\x04\x02\x00\x3c\x00\x00")
    assert connection.recv(4) == b"\x20\x02\x00\x00"
    return connection


def test_the_broker_stops_and_comes_back(mosquitto: Mosquitto) -> None:
    with greet(mosquitto) as connection:
        mosquitto.stop()
        assert connection.recv(1) == b""
    with pytest.raises(ConnectionRefusedError):
        greet(mosquitto)
    mosquitto.stop()
    mosquitto.start()
    greet(mosquitto).close()


@pytest.mark.requires("mosquitto")
def test_a_broker_that_cannot_start_says_why(mosquitto: Mosquitto, tmp_path: Path) -> None:
    program = COMPONENTS["mosquitto"].find()
    assert program
    folder = tmp_path / "second"
    folder.mkdir()
    second = Mosquitto(program, folder)
    (folder / "mosquitto.conf").write_text(f"listener {mosquitto.port} {mosquitto.host}\n")
    with pytest.raises(RuntimeError, match="Address already in use"):
        second.start()


# -- the lock -------------------------------------------------------------------------------------


def extras() -> dict[str, list[str]]:
    found: dict[str, list[str]] = PROJECT["project"]["optional-dependencies"]
    return found


LOCKS = "requirements.lock", "requirements-bench.lock"


def locked(name: str) -> dict[str, list[str]]:
    """A lock's lines by package: each version, marker and hash."""
    packages: dict[str, list[str]] = {}
    for entry in re.split(r"(?m)^(?=\w)", (ROOT / name).read_text()):
        if entry.strip():
            packages.setdefault(entry.split("==")[0], []).append(entry)
    return packages


@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_holds_every_dependency_with_hashes(name: str) -> None:
    packages, bench = locked(name), name == "requirements-bench.lock"
    chosen = [each for extra, wanted in extras().items() for each in wanted if (extra == "bench") == bench]
    wanted = [*PROJECT["project"]["dependencies"], *chosen]
    assert {re.split(r"[<>=]", each)[0] for each in wanted} <= packages.keys()
    for entries in packages.values():
        for entry in entries:
            assert re.match(r"[\w.-]+==[\w.]+ (; [^\n]+ )?\\\n(    --hash=sha256:[0-9a-f]{64}( \\)?\n)+\Z", entry)


@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_names_no_host_and_no_path(name: str) -> None:
    assert not re.search(r"://|/|@|--(index|extra|find|trusted)", (ROOT / name).read_text())


def test_the_bench_times_the_versions_that_are_tested() -> None:
    tested, timed = (locked(name) for name in LOCKS)
    assert all(timed[package] == tested[package] for package in tested.keys() & timed.keys())


# -- the layers and the rules ---------------------------------------------------------------------

SINGLE = (
    "cli",
    "daemon",
    "cycle",
    "ports",
    "controller",
    "relay",
    "guard",
    "outlook",
    "soc",
    "sessions",
    "series",
)
CORE = (
    *("reasons", "commands", "command_words", "perception", "beat", "flow", "ledger", "remedies", "score", "charts"),
    *("habits", "past", "plausible", "retry", "scoring", "contest", "safe_mode", "wall"),
)
PACKAGED = "config.loading", "adapters.store", "planner.qp", "planner.exact", "study.world"
MODULES = ("__main__", *SINGLE, *CORE, *PACKAGED, "domain", "units", "errors")


@pytest.fixture
def skeleton(tmp_path: Path) -> Path:
    """Empty modules of the project's names beside the project's own contracts."""
    for module in MODULES:
        path = tmp_path / "plugd" / (module.replace(".", "/") + ".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        (path.parent / "__init__.py").touch()
        path.touch()
    (tmp_path / "plugd_hil").mkdir()
    (tmp_path / "plugd_hil" / "__init__.py").touch()
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text())
    return tmp_path


def layers_say(folder: Path, module: str, source: str) -> subprocess.CompletedProcess[str]:
    (folder / "plugd" / module).write_text(source)
    # The script beside this Python; its path first, so that the skeleton is what `plugd` means.
    script = "from importlinter.cli import lint_imports_command as main; main()"
    return run(sys.executable, "-c", script, "--no-cache", cwd=folder, PYTHONPATH=str(folder))


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("cli.py", "import plugd.daemon, plugd.study.world"),
        ("daemon.py", "import plugd.adapters.store, plugd.config, apscheduler"),
        ("planner/qp.py", "import numpy, osqp"),
        ("study/world.py", "import plugd.cycle, plugd.series, plugd.config"),
    ],
)
def test_what_the_layers_allow(skeleton: Path, module: str, source: str) -> None:
    result = layers_say(skeleton, module, source)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(
    ("module", "source", "contract"),
    [
        ("controller.py", "import plugd.cycle", "Layers of plugd"),
        ("soc.py", "import plugd.sessions", "Layers of plugd"),
        ("study/world.py", "import plugd.daemon", "Layers of plugd"),
        ("extra.py", "", "Layers of plugd"),
        ("guard.py", "import logging", "The core knows no network, disk, scheduler or log"),
        ("planner/exact.py", "import numpy", "Only planner.qp knows the solver and its arrays"),
        ("guard.py", "import plugd.errors", "The guard stands on domain and units alone"),
        ("cli.py", "import plugd_hil", "plugd knows nothing of the bench or the tests"),
        ("cli.py", "import tests", "plugd knows nothing of the bench or the tests"),
        ("study/world.py", "import plugd.adapters.store", "The study runs without adapters"),
    ],
)
def test_what_the_layers_forbid(skeleton: Path, module: str, source: str, contract: str) -> None:
    result = layers_say(skeleton, module, source)
    assert result.returncode == 1, result.stdout + result.stderr
    assert f"{contract} BROKEN" in re.sub(r"\x1b\[\d*m", "", result.stdout)


@pytest.mark.parametrize(
    "banned",
    [
        "import time\ntime.sleep(1)",
        "import time\ntime.time()",
        "from time import monotonic\nmonotonic()",
        "from datetime import UTC, datetime\ndatetime.now(UTC)",
        "from unittest import mock\nmock.Mock()",
    ],
)
def test_time_is_a_port(banned: str) -> None:
    def broken(name: str) -> bool:
        ruff = (
            sys.executable,
            "-m",
            "ruff",
            "check",
            "--no-cache",
            "--select=TID251",
            "--stdin-filename",
            name,
        )
        said = subprocess.run(ruff, check=False, cwd=ROOT, input=f"{banned}\n", capture_output=True, text=True)
        assert said.returncode == 0 or "TID251" in said.stdout, said.stdout + said.stderr
        return said.returncode != 0

    assert [broken(f"{folder}/x.py") for folder in ("plugd", "plugd/study", "tests/unit")] == [True] * 3
    assert [broken(f"{folder}/x.py") for folder in ("plugd/adapters", "hil/plugd_hil")] == [False] * 2


# -- the Makefile and CI --------------------------------------------------------------------------

FAKES = {
    "old": ("exit 1", "plugd needs Python 3.11 or newer"),
    "no venv": ('case "$2" in *venv*) exit 1;; *) echo 3.11;; esac', "cannot make a virtual environment"),
}


@pytest.mark.parametrize("case", FAKES)
def test_make_says_what_to_install(tmp_path: Path, case: str) -> None:
    body, said = FAKES[case]
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\n{body}\n")
    python.chmod(0o755)
    result = run("make", "test", f"PYTHON={python}", f"VENV={tmp_path / 'venv'}")
    assert result.returncode != 0
    assert said in result.stderr
    assert "sudo apt install make python3-venv" in result.stderr
    assert not (tmp_path / "venv").exists()


def test_make_alone_lists_what_can_be_made() -> None:
    result = run("make")
    assert result.returncode == 0
    for target in ("demo", "test", "weeks", "check", "bench", "lock", "clean"):
        assert f"make {target}" in result.stdout


def test_ci_fails_with_what_it_runs(tmp_path: Path) -> None:
    """In a checkout whose `make test` fails, and in one where only `make check` does."""
    (tmp_path / ".ci").mkdir()
    script = tmp_path / ".ci" / "run"
    script.write_text((ROOT / ".ci" / "run").read_text())
    tools = tmp_path / "bin"
    tools.mkdir()
    for name, body in {
        "id": "echo 1000",
        "make": """for word in "$@"; do
          case "$word" in
            -*|*=*) ;;
            "$FAILING") exit 1;;
            *) echo "$word needs $PLUGD_REQUIRE";;
          esac
        done""",
    }.items():
        (tools / name).write_text(f"#!/bin/sh\n{body}\n")
        (tools / name).chmod(0o755)

    def ci(failing: str) -> subprocess.CompletedProcess[str]:
        return run("bash", str(script), PATH=f"{tools}:{CLEAN['PATH']}", FAILING=failing)

    good = ci("")
    assert good.returncode == 0
    targets = [line.split() for line in good.stdout.splitlines() if " needs " in line]
    assert [target for target, *_ in targets][:2] == ["test", "check"]
    assert len(targets) > 5
    for target, _, required in targets:
        assert required == "mosquitto,data,dask,chromium,multicast"
        assert ci(target).returncode != 0
