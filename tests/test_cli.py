"""The commands as a person uses them: exit codes, one line of error, one JSON document, no traceback ever."""

import json
import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from plugd import __version__
from plugd.cli import main
from plugd.config import doubts, parse
from plugd_hil.broker import Mosquitto, free_port
from tests.conftest import ROOT
from tests.programs import Listener, Program, environment

SESSION = {"intensity": [200.0, 100.0, 300.0, 50.0], "morning_minimum_pct": 50.0, "daily_use_kwh": 5.0}
PROBLEM = {
    "slot_h": 0.5, "power_max_kw": 10.0, "capacity_kwh": 50.0, "efficiency": 1.0, "soc_pct": 43.0,
    "soc_min_pct": 20.0, "soc_max_pct": 80.0, "sessions": [SESSION, SESSION],
}  # fmt: skip
ANSWER = {
    *("status", "solver", "power_kw", "soc_pct", "shortfall_kwh", "reserve_short_kwh", "carbon_g", "bound_g", "gap"),
    *("raw_gap", "iterations", "solve_ms"),
}


@dataclass(frozen=True, slots=True)
class Said:
    """What became of a command."""

    status: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The one line of an error."""
        assert self.out == ""
        assert len(self.err.splitlines()) == 1, self.err
        assert self.err.startswith("plugd")
        return self.err.strip()


class Shell:
    """Commands in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: str) -> Said:
        """Run one."""
        self._capsys.readouterr()
        try:
            status = main(arguments)
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        out, err = self._capsys.readouterr()
        assert "Traceback" not in out + err
        return Said(status, out, err)


@pytest.fixture
def plugd(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Shell:
    for name in ("PLUGD_CONFIG", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    return Shell(capsys)


def apart(*arguments: str, **streams: Any) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "plugd", *arguments],
        check=False,
        env=environment(),
        stdin=subprocess.DEVNULL,
        text=True,
        timeout=60,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams},
    )


def problem(folder: Path, document: object) -> str:
    """A problem file; a string is written as it is."""
    path = folder / "problem.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return str(path)


# -- plan --problem -------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["osqp", "exact"])
def test_a_problem_file_is_answered_with_one_document(plugd: Shell, tmp_path: Path, solver: str) -> None:
    said = plugd("plan", "--problem", problem(tmp_path, PROBLEM), "--solver", solver, "--json")
    assert (said.status, said.err) == (0, "")
    found = json.loads(said.out)
    assert found.keys() == ANSWER
    assert (found["status"], found["solver"]) == ("solved", solver)
    assert [len(each) for each in found["power_kw"]] == [4, 4]
    assert found["soc_pct"][0] >= 50.0 - 1e-6


def test_without_json_it_is_told_in_words(plugd: Shell, tmp_path: Path) -> None:
    said = plugd("plan", "--problem", problem(tmp_path, PROBLEM), "--solver", "exact")
    assert said.status == 0
    first, second, last = said.out.splitlines()
    assert first.startswith("session 1: ends at ")
    assert second.startswith("session 2: ends at ")
    assert last.startswith("solved by exact: ")


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ("", "is empty; write one JSON object"),
        ("{", "line 1, column 2: "),
        ("[]", "the document is a list; an object {...} is wanted"),
        ("\x00", "line 1, column 1: "),
        ({**PROBLEM, "sessions": [{**SESSION, "intensity": [100.0, float("nan")]}]}, "sessions[0].intensity[1]"),
        ({**PROBLEM, "soc_pct": float("inf")}, "soc_pct"),
        ({**PROBLEM, "soc_pct": "half"}, 'soc_pct is "half"; a number is wanted'),
        ({k: v for k, v in PROBLEM.items() if k != "capacity_kwh"}, "capacity_kwh is missing; add it"),
        ({**PROBLEM, "colour": "red"}, "colour is not known; known are"),
        ({**PROBLEM, "sessions": [{**SESSION, "intensity": [100.0] * 20_001}]}, "20000"),
    ],
)
def test_a_problem_file_that_cannot_be_used_is_one_line_and_status_2(
    plugd: Shell, tmp_path: Path, document: object, said: str
) -> None:
    path = problem(tmp_path, document)
    answer = plugd("plan", "--problem", path, "--json")
    assert answer.status == 2
    assert answer.line.startswith(f"plugd: {path}: ")
    assert said in answer.line.replace(",", "") if said == "20000" else said in answer.line


def test_a_problem_file_that_is_not_there_is_named(plugd: Shell, tmp_path: Path) -> None:
    answer = plugd("plan", "--problem", str(tmp_path / "none.json"))
    assert (answer.status, answer.line) == (
        2,
        f"plugd: {tmp_path}/none.json: cannot be read: No such file or directory",
    )
    answer = plugd("plan", "--problem", str(tmp_path))
    assert answer.status == 2
    assert "Is a directory" in answer.line


@pytest.mark.parametrize("solver", ["osqp", "exact"])
def test_an_unreachable_minimum_is_repaired_and_the_shortfall_told(plugd: Shell, tmp_path: Path, solver: str) -> None:
    path = problem(tmp_path, {**PROBLEM, "sessions": [{**SESSION, "morning_minimum_pct": 90.0}]})
    found = json.loads(plugd("plan", "--problem", path, "--solver", solver, "--json").out)
    assert found["status"] == "repaired"
    assert found["shortfall_kwh"] == [pytest.approx(5.0, abs=0.01)]  # soc_max lies at 80 %
    assert found["soc_pct"] == [pytest.approx(80.0, abs=0.01)]
    told = plugd("plan", "--problem", path, "--solver", solver)
    assert told.status == 0
    assert "session 1: ends at 80.0 %, 5.00 kWh short of its minimum" in told.out


@pytest.mark.parametrize("solver", ["osqp", "exact"])
def test_twenty_thousand_slots_are_planned(plugd: Shell, tmp_path: Path, solver: str) -> None:
    dice = random.Random(0)
    long = {**SESSION, "intensity": [round(dice.uniform(40.0, 300.0), 1) for _ in range(20_000)]}
    said = plugd("plan", "--problem", problem(tmp_path, {**PROBLEM, "sessions": [long]}), "--solver", solver, "--json")
    assert said.status == 0
    found = json.loads(said.out)
    assert found["status"] in ("solved", "fallback")
    assert found["soc_pct"] == [pytest.approx(50.0, abs=0.01)]


# -- usage ----------------------------------------------------------------------------------------


def test_the_example_of_the_docs_runs_and_is_explained_as_it_says(plugd: Shell, tmp_path: Path) -> None:
    section = (ROOT / "docs" / "plan.md").read_text()
    written, shown = section.split("```json")[1].split("```")[0], section.split("```\n")[-2]
    path = problem(tmp_path, written)
    said = plugd("plan", "--problem", path, "--explain")
    assert (said.status, said.err) == (0, "")
    gap = said.out.splitlines()[2].rpartition(" ")[2]  # the last digits are the machine's
    assert float(gap) < 1e-4
    assert said.out.replace(f"gap {gap}", "gap 0") == shown
    told = json.loads(plugd("plan", "--problem", path, "--explain", "--json").out)
    assert told.keys() == ANSWER | {"explain"}
    assert told["explain"]["sessions"][0]["dearest_used"] == {"slot": 2, "g_per_kwh": 160.0}
    assert told["explain"]["sessions"][0]["minimum"]["less_saves_g_per_pct"] == pytest.approx(0.5 * (160 - 95))


@pytest.mark.parametrize("command", [(), ("run",), ("init",), ("check",), ("plan",), ("plug",)])
def test_every_command_explains_itself(plugd: Shell, command: tuple[str, ...]) -> None:
    said = plugd(*command, "--help")
    assert (said.status, said.err) == (0, "")
    assert said.out.startswith(" ".join(("usage: plugd", *command)).rstrip())


def test_the_demo_explains_itself_whatever_stands_before_it() -> None:
    for before in ((), ("-v",)):
        said = apart(*before, "demo", "--help")
        assert (said.returncode, said.stderr) == (0, "")
        assert said.stdout.startswith("usage: plugd demo")
        assert "--days" in said.stdout
    assert apart("-v", "demo", "--days", "0").returncode == 2


def test_the_version(plugd: Shell) -> None:
    assert plugd("--version").out == f"plugd {__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "plugd: the following arguments are required: COMMAND; plugd --help tells more"),
        (("dance",), "invalid choice: 'dance'"),
        (("run", "--fast"), "unrecognized arguments: --fast"),
        (("plan", "--solver", "guess"), "invalid choice: 'guess'"),
        (("plug",), "plugd plug: the following arguments are required: DO"),
        (("plug", "amps"), "plugd plug amps: the following arguments are required: N"),
        (("plug", "amps", "much"), "plugd plug amps: argument N: invalid float value: 'much'"),
    ],
)
def test_a_wrong_command_is_one_line_and_status_2(plugd: Shell, arguments: tuple[str, ...], said: str) -> None:
    answer = plugd(*arguments)
    assert answer.status == 2
    assert said in answer.line
    assert "--help" in answer.line


def test_a_closed_pipe_is_quiet(tmp_path: Path) -> None:
    for arguments in (("plan", "--json", "--solver", "exact", "--problem", problem(tmp_path, PROBLEM)), ("--help",)):
        read, write = os.pipe()
        os.close(read)
        with os.fdopen(write, "w") as closed:
            assert apart(*arguments, stdout=closed).stderr == ""


def test_ctrl_c_is_quiet(tmp_path: Path) -> None:
    """While the problem is read from a pipe that nobody fills."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with Program("plugd", "plan", "--problem", str(pipe)) as waiting:
        with pipe.open("w"):  # opens once the command reads
            waiting.process.send_signal(signal.SIGINT)
            assert waiting.ends() == 130
        assert waiting.complained.all == []


# -- the configuration ----------------------------------------------------------------------------


@pytest.mark.parametrize("command", [("run",), ("check",), ("plan",), ("plug", "show")])
def test_without_a_configuration_the_remedy_is_named(plugd: Shell, tmp_path: Path, command: tuple[str, ...]) -> None:
    answer = plugd("-c", str(tmp_path / "plugd.toml"), *command)
    assert answer.status == 78
    assert answer.line == (
        f"plugd: {tmp_path}/plugd.toml: no such file; plugd init writes one, or name another with -c"
    )


def test_the_configuration_is_named_by_option_before_environment(
    plugd: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLUGD_CONFIG", str(tmp_path / "environment.toml"))
    assert "environment.toml" in plugd("run").line
    assert "option.toml" in plugd("-c", str(tmp_path / "option.toml"), "run").line


def test_an_unknown_key_is_named_with_its_file(plugd: Shell, tmp_path: Path) -> None:
    path = tmp_path / "plugd.toml"
    path.write_text('[plug]\ntopic = "ev-plug"\n[car]\ncapacity = 50\n')
    for command in ("run", "check"):
        answer = plugd("-c", str(path), command)
        assert answer.status == 78
        assert answer.line.startswith(f"plugd: {path}: car.capacity")
        assert "car.capacity_kwh" in answer.line


def test_a_charger_on_can_without_its_batterys_limits_is_a_configuration_error(plugd: Shell, tmp_path: Path) -> None:
    path = tmp_path / "plugd.toml"
    path.write_text(f'[plug]\nkind = "can_elcon"\n[state]\ndir = "{tmp_path}/state"\n')
    answer = plugd("-c", str(path), "run")
    assert answer.status == 78
    assert answer.line.startswith("plugd: can.max_voltage_v: write the highest voltage that the battery bears")


# -- beside a plug, a broker, a server ------------------------------------------------------------


@dataclass(slots=True)
class Bench:
    """A broker, a stub plug, a stub server, and a configuration that names them."""

    broker: Mosquitto
    plug: Program
    neso: Program
    folder: Path
    left: ExitStack

    def config(
        self, topic: str = "ev-plug", broker: int | None = None, neso: int | None = None, kind: str = "tasmota"
    ) -> str:
        """With another topic or port, where nothing is."""
        path = self.folder / "plugd.toml"
        path.write_text(
            f'[broker]\nhost = "127.0.0.1"\nport = {broker or self.broker.port}\n[plug]\ntopic = "{topic}"\n'
            f'kind = "{kind}"\npower_kw = 2.3\n[forecast]\n'
            f'base_url = "http://127.0.0.1:{neso or self.neso.said.all[0]["port"]}"\n'
            f'[state]\ndir = "{self.folder}/state"\n[web]\nenabled = false\n'
        )
        return str(path)

    def relay(self) -> list[str]:
        """What the plug's relay has done."""
        seen = len(self.plug.said.all)
        self.plug.tell("soc 50")
        self.plug.said.until(lambda line: line["event"] == "soc", after=seen)
        return [line["event"] for line in self.plug.said.all if line.get("event") in ("on", "off")]


@pytest.fixture
def bench(mosquitto: Mosquitto, tmp_path: Path) -> Iterator[Bench]:
    with ExitStack() as left:
        server = left.enter_context(Program("plugd_hil.neso", "--source", "synthetic"))
        at = f"{mosquitto.host}:{mosquitto.port}"
        plug = left.enter_context(Program("plugd_hil.plug", "--broker", at, "--stdin", "--ledger", "/dev/stdout"))
        plug.said.until(lambda line: line.get("ready"))
        server.said.until(lambda line: "port" in line)
        yield Bench(mosquitto, plug, server, tmp_path, left)


def findings(said: Said) -> dict[str, tuple[bool, str]]:
    """What `check` found: (ok, text) by what it looked at."""
    assert said.err == ""
    found = {}
    for line in said.out.splitlines():
        word, rest = line[:5].strip(), line[6:]
        what, _, text = rest.partition(": ")
        assert word in ("ok", "MEND")
        found[what] = word == "ok", text
    return found


def test_check_says_that_all_is_well_and_clicks_when_asked(plugd: Shell, bench: Bench) -> None:
    said = plugd("-c", bench.config(), "check")
    found = findings(said)
    assert list(found) == ["configuration", "broker", "plug", "forecast", "clock", "disk"]
    assert all(ok for ok, _ in found.values()), said.out
    assert said.status == 0
    assert "half hours" in found["forecast"][1]
    assert bench.relay() == []
    clicked = plugd("-c", bench.config(), "check", "--click")
    assert clicked.status == 0
    assert "clicked on: on, 2300 W" in findings(clicked)["plug"][1]
    assert bench.relay() == ["on", "off"]
    assert not (bench.folder / "state").exists()  # who only looks leaves nothing


def test_a_click_leaves_a_plug_that_was_on_on_and_sees_when_nothing_flows(
    plugd: Shell, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("plugd.inspection.SETTLE", timedelta(seconds=0.5))
    bench.plug.tell("car leave")
    bench.plug.tell("press")
    bench.plug.said.until(lambda line: line.get("event") == "on")
    said = findings(plugd("-c", bench.config(), "check", "--click"))["plug"]
    assert said[0]
    assert "nothing flows: is the car plugged in" in said[1]
    assert said[1].endswith("on again")
    assert bench.relay() == ["on"]


def test_check_says_what_to_mend(plugd: Shell, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plugd.daemon.BROKER_PATIENCE_S", 0.5)
    monkeypatch.setattr("plugd.adapters.plug_line.PATIENCE_S", 0.2)
    nowhere = free_port()
    (bench.folder / "state").write_text("a file where a folder should be")
    said = plugd("-c", bench.config(broker=nowhere, neso=nowhere), "check")
    assert said.status == 1
    found = findings(said)
    assert [what for what, (ok, _) in found.items() if not ok] == ["broker", "plug", "forecast", "disk"]
    assert f"127.0.0.1:{nowhere} refuses the connection" in found["broker"][1]
    assert "is it running, and is [broker] right?" in found["broker"][1]
    assert found["plug"][1] == "cannot be asked without the broker; mend that first"
    assert "check forecast.base_url" in found["forecast"][1]
    assert found["disk"][1] == f"{bench.folder}/state: is no folder; move it away, or set state.dir"
    (bench.folder / "state").unlink()
    found = findings(plugd("-c", bench.config(topic="toaster"), "check"))
    assert [what for what, (ok, _) in found.items() if not ok] == ["plug"]
    assert "toaster" in found["plug"][1]
    assert "are plug.kind and plug.topic right?" in found["plug"][1]
    monkeypatch.setattr("plugd.inspection.LEAST_FREE_MB", 2**50)
    found = findings(plugd("-c", bench.config(), "check"))
    assert [what for what, (ok, _) in found.items() if not ok] == ["disk"]
    assert "make room" in found["disk"][1]


def test_check_says_where_the_plug_would_be_cut_for_its_current(plugd: Shell, bench: Bench) -> None:
    path = Path(bench.config())
    for power, most, kind, ok in (
        ("2.3", "10", "tasmota", True),
        ("2.9", "10.5", "tasmota", False),
        ("2.9", "13", "tasmota", True),
        ("7.36", "32", "tasmota", True),
        ("7.36", "10.5", "openevse", True),  # a charger is told what it may give, and is not cut
    ):
        text = f'[plug]\nkind = "{kind}"\ntopic = "ev-plug"\npower_kw = {power}\nmax_current_a = {most}\n'
        assert doubts(parse(text)) == () if ok else len(doubts(parse(text))) == 1
    path.write_text(path.read_text().replace("power_kw = 2.3", "power_kw = 2.9"))
    said = plugd("-c", str(path), "check")
    assert said.status == 1
    found = findings(said)
    assert [what for what, (ok, _) in found.items() if not ok] == ["configuration"]
    assert (
        "plug.power_kw = 2.9: is 12.6 A at 230 V, and the plug is cut off above plug.max_current_a = 10.5" in said.out
    )
    assert "write 2.41, or raise plug.max_current_a where plug, socket and cable bear it" in said.out


def test_the_plug_by_hand(plugd: Shell, bench: Bench) -> None:
    config = bench.config()
    shown = plugd("-c", config, "plug", "show")
    assert (shown.status, shown.err) == (0, "")
    assert shown.out == "off, 0 W, 0.000 kWh in total\n"
    on = plugd("-c", config, "plug", "on")
    assert on.out.startswith("on, 2300 W, ")
    assert "it stays so until somebody switches it, or plugd starts" in on.out
    off = plugd("-c", config, "plug", "off")
    assert off.out.startswith("off, ")
    assert bench.relay() == ["on", "off"]


def test_a_charger_is_told_amperes_and_a_plug_is_not(plugd: Shell, bench: Bench) -> None:
    answer = plugd("-c", bench.config(), "plug", "amps", "8")
    assert answer.status == 2
    assert "knows on and off only" in answer.line
    at = f"{bench.broker.host}:{bench.broker.port}"
    options = ("--dialect", "openevse", "--topic", "evse", "--tele-period", "1", "--stdin")
    stub = bench.left.enter_context(Program("plugd_hil.plug", "--broker", at, *options))
    stub.said.until(lambda line: line.get("ready"))
    config = bench.config(topic="evse", kind="openevse")
    assert plugd("-c", config, "plug", "amps", "8").out.startswith("on, 1840 W, ")
    for amps in ("5", "11", "400"):
        answer = plugd("-c", config, "plug", "amps", amps)
        assert answer.status == 1
        assert "from 6 to 10 A, or nothing" in answer.line
    assert plugd("-c", config, "plug", "amps", "0").out.startswith("off, ")
    shown = plugd("-c", config, "check")
    assert shown.status == 0
    assert "no timer of its own" in findings(shown)["plug"][1]


def test_beside_a_running_daemon_a_switch_is_a_press_and_a_click_is_refused(plugd: Shell, bench: Bench) -> None:
    config = bench.config()
    listener = Listener(bench.broker.host, bench.broker.port, ["plugd/ev/+"])
    bench.left.callback(listener.close)
    bench.left.enter_context(Program("plugd", "-c", config, "run"))
    listener.until("plugd/ev/availability", lambda said: said == "online")
    listener.send("plugd/ev/mode/set", "now")
    listener.until("plugd/ev/state", lambda state: state["mode"] == "now" and state["decision"] == "on")
    assert "the running plugd takes this as a press of the plug's button" in plugd("-c", config, "plug", "off").out
    listener.until("plugd/ev/state", lambda state: "you switched it off at the plug" in state["reason"])
    moves = bench.relay()
    said = plugd("-c", config, "check", "--click")
    assert said.status == 1
    assert "not clicked: the running plugd would take it for a press" in findings(said)["plug"][1]
    assert bench.relay() == moves


def test_no_plug_to_switch_is_one_line(plugd: Shell, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plugd.daemon.BROKER_PATIENCE_S", 0.5)
    answer = plugd("-c", bench.config(broker=free_port()), "plug", "on")
    assert answer.status == 1
    assert "is it running, and is [broker] right?" in answer.line


def test_the_plan_now_with_and_without_a_state_folder(plugd: Shell, bench: Bench) -> None:
    config = bench.config()
    said = plugd("-c", config, "plan", "--json")
    assert (said.status, said.err) == (0, "")
    found = json.loads(said.out)
    assert found["plan"]
    assert found["reason"]
    assert not (bench.folder / "state").exists()
    words = plugd("-c", config, "plan").out.splitlines()
    assert words[0]
    assert len(words) == 1 + len(found["plan"])
    with Program("plugd", "-c", config, "run") as daemon:
        listener = Listener(bench.broker.host, bench.broker.port, ["plugd/ev/+"])
        bench.left.callback(listener.close)
        listener.until("plugd/ev/plan")
        before = listener.count()
        listener.send("plugd/ev/soc/set", "80")
        listener.until("plugd/ev/state", lambda state: state["soc_pct"] == 80.0, after=before)
        said = plugd("-c", config, "plan", "--json")  # beside the daemon, which holds the folder
        assert said.status == 0
        assert len(json.loads(said.out)["plan"]) < len(found["plan"])  # 80 % is what the daemon was told
        assert daemon.process.poll() is None


def test_the_plan_of_the_house_is_explained_in_its_own_times(plugd: Shell, bench: Bench) -> None:
    config = bench.config()
    said = plugd("-c", config, "plan", "--explain")
    assert (said.status, said.err) == (0, "")
    words = said.out.splitlines()
    assert len([line for line in words if " to " in line and (" kWh; dearest" in line or "nothing " in line)]) >= 4
    found = json.loads(plugd("-c", config, "plan", "--explain", "--json").out)
    planned = {slot["start"] for slot in found["plan"] if slot["power_kw"] > 0}
    used = [own["dearest_used"]["start"] for own in found["explain"]["sessions"] if own["dearest_used"]]
    assert used
    assert set(used) <= planned


def test_a_plan_without_a_forecast_says_so(plugd: Shell, bench: Bench) -> None:
    said = plugd("-c", bench.config(neso=free_port()), "plan")
    assert said.status == 0
    assert said.out
    assert said.err == "plugd: no new forecast: 127.0.0.1 refuses the connection; check forecast.base_url\n"
