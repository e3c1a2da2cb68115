"""`plugd demo` from the outside: the same numbers every time, nothing left behind, and words when a part fails."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from plugd.study.world import Stay
from plugd_hil import broker as brokers
from plugd_hil import demo, demo_run
from plugd_hil.account import Night, read_ledger
from plugd_hil.broker import HOST, Amqtt, Mosquitto, any_broker
from plugd_hil.conductor import Conductor, Line
from plugd_hil.demo_outcome import Outcome
from tests.conftest import find_data
from tests.programs import environment

OUTCOME_KEYS = {
    *("source", "nights", "carbon_g_per_kwh", "uncontrolled_g_per_kwh", "perfect_g_per_kwh", "reduction_pct"),
    *("missed_mornings", "energy_kwh", "wall_s"),
}
NIGHT_KEYS = {
    *("date", "arrival_soc_pct", "charged_kwh", "carbon_g_per_kwh", "switch_ons", "morning_soc_pct", "minimum_pct"),
    "reason",
}
WITHOUT_MOSQUITTO = """
import os, sys
import plugd_hil.broker
plugd_hil.broker.SBIN = ()
os.environ["PATH"] = "/nowhere"
from plugd_hil.demo import main
sys.exit(main())
"""
PROGRAM = ("-m", "plugd", "demo")
LONGEST_S = 100.0
START = datetime(2023, 1, 2, 12, tzinfo=UTC)


@dataclass(slots=True)
class Run:
    """A demo under way in a process of its own, with a home, a temporary folder and a mark of its own."""

    folder: Path
    mark: str
    process: subprocess.Popen[str]

    def ends(self) -> tuple[int, str, str]:
        """Exit status, stdout, stderr."""
        out, err = self.process.communicate(timeout=LONGEST_S)
        return self.process.returncode, out, err

    def written(self) -> list[str]:
        """What it has left in the folders that it might write to."""
        return sorted(str(path.relative_to(self.folder)) for path in self.folder.glob("*/*"))

    def left(self) -> list[str]:
        """Processes of it that still run."""
        return [command for _, command in marked(self.mark)]


def marked(mark: str) -> Iterator[tuple[int, str]]:
    """The processes, with their command lines, whose environment carries a mark."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            with suppress(OSError):
                if mark.encode() in (folder / "environ").read_bytes():
                    yield int(folder.name), (folder / "cmdline").read_text().replace("\0", " ")


def begin(folder: Path, *arguments: str, program: tuple[str, ...] = PROGRAM) -> Run:
    """A demo; it has not ended yet."""
    mark = f"mark-{uuid.uuid4().hex}"
    for name in ("cwd", "home", "tmp"):
        (folder / name).mkdir(parents=True)
    return Run(
        folder,
        mark,
        subprocess.Popen(
            [sys.executable, *program, *arguments],
            cwd=folder / "cwd",
            env=environment(HOME=str(folder / "home"), TMPDIR=str(folder / "tmp"), PLUGD_MARK=mark),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ),
    )


RUNS: dict[str, tuple[str, ...]] = {
    "first": ("--days", "2", "--json"),
    "again": ("--days", "2", "--json"),
    "other seed": ("--days", "1", "--seed", "1", "--json"),
    "amqtt": ("--days", "1", "--json"),
    "never": ("--days", "1", "--soc", "never", "--json"),
    "kept": ("--days", "3", "--json", "--keep", "kept"),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], tuple[Run, int, str, str]]]:
    """By name: the run, its exit status, stdout, stderr. All begin at once: each is a world of its own."""
    wanted = dict(RUNS)
    if series := find_data():
        wanted["measured"] = ("--source", str(series / "neso_national_2023.csv"), "--days", "3", "--json")
    under_way = {
        name: begin(
            tmp_path_factory.mktemp("demo") / name.replace(" ", "-"),
            *arguments,
            program=("-c", WITHOUT_MOSQUITTO) if name == "amqtt" else PROGRAM,
        )
        for name, arguments in wanted.items()
    }
    ended: dict[str, tuple[Run, int, str, str]] = {}

    def end(name: str) -> tuple[Run, int, str, str]:
        if name not in ended:
            ended[name] = (under_way[name], *under_way[name].ends())
        return ended[name]

    yield end
    for run in under_way.values():
        if run.process.poll() is None:
            run.process.terminate()
            run.ends()


Runs = Callable[[str], tuple[Run, int, str, str]]


def outcome(ended: tuple[Run, int, str, str]) -> dict[str, Any]:
    """The JSON of a run that went well and said nothing else."""
    _, status, out, err = ended
    assert (status, err) == (0, "")
    document: dict[str, Any] = json.loads(out)
    assert document.pop("wall_s") > 0.0
    return document


def test_the_report_on_a_kept_demo_agrees_with_the_plugs_own_ledger(runs: Runs) -> None:
    """The stub plug wrote down what really flowed; plugd's ledger knows only what the meter told it."""
    told = outcome(runs("kept"))
    folder = runs("kept")[0].folder / "cwd" / "kept"
    report = json.loads(
        subprocess.run(
            [sys.executable, "-m", "plugd", "-c", str(folder / "plugd.toml"), "report", "--json", "--horizons", "1"],
            capture_output=True, check=True, text=True, env=environment(), timeout=LONGEST_S,
        ).stdout
    )  # fmt: skip
    assert len(report["nights"]) == 3
    assert report["total"]["kwh"] == pytest.approx(told["energy_kwh"], rel=0.01)
    assert report["total"]["g_per_kwh"] == pytest.approx(told["carbon_g_per_kwh"], rel=0.05)
    lines = read_ledger(folder / "ledger.jsonl")
    assert report["total"]["switch_ons"] == sum(b.on and not a.on for a, b in pairwise(lines))
    assert report["total"]["missed_mornings"] == told["missed_mornings"]
    for ours, theirs in zip(report["nights"], told["nights"], strict=True):
        assert ours["night"] == theirs["date"]
        assert ours["kwh"] == pytest.approx(theirs["charged_kwh"], abs=0.05)
        assert ours["morning_soc_pct"] == pytest.approx(theirs["morning_soc_pct"], abs=2.0)


def test_the_same_seed_gives_the_same_document(runs: Runs) -> None:
    assert outcome(runs("first")) == outcome(runs("again"))


def test_another_seed_gives_another_driver(runs: Runs) -> None:
    assert outcome(runs("other seed"))["nights"][0] != outcome(runs("first"))["nights"][0]


def test_the_document_has_every_key_and_adds_up(runs: Runs) -> None:
    found = outcome(runs("first"))
    assert OUTCOME_KEYS - {"wall_s"} <= found.keys()
    assert len(found["nights"]) == 2
    for night in found["nights"]:
        assert night.keys() == NIGHT_KEYS
        assert night["minimum_pct"] == 50.0
        assert night["morning_soc_pct"] >= 49.5
    assert [night["date"] for night in found["nights"]] == ["2023-01-01", "2023-01-02"]
    assert found["source"] == "synthetic"
    assert found["missed_mornings"] == 0
    kwh = sum(night["charged_kwh"] for night in found["nights"])
    grams = sum(night["charged_kwh"] * (night["carbon_g_per_kwh"] or 0.0) for night in found["nights"])
    assert found["energy_kwh"] == pytest.approx(kwh, abs=0.01)
    assert found["carbon_g_per_kwh"] == pytest.approx(grams / kwh, abs=0.05)
    less = 100.0 * (1.0 - found["carbon_g_per_kwh"] / found["uncontrolled_g_per_kwh"])
    assert found["reduction_pct"] == pytest.approx(less, abs=0.01)
    assert found["perfect_g_per_kwh"] < found["uncontrolled_g_per_kwh"]


def test_a_car_that_never_tells_its_soc_is_ready_too(runs: Runs) -> None:
    found = outcome(runs("never"))
    assert found["missed_mornings"] == 0
    assert found["nights"][0]["morning_soc_pct"] >= 50.0
    assert found["nights"] != outcome(runs("first"))["nights"][:1]


def test_the_table_has_a_line_a_night_and_a_comparison_last(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stay = Stay(START + timedelta(hours=6), START + timedelta(hours=21), 5.0)
    night = Night(stay, START + timedelta(hours=19), 0.4, 0.5, 0.8, 0.5, 5.0, 500.0, 1, "It was clean.")
    late = replace(night, morning_soc=0.4, charged_kwh=0.0, carbon_g=0.0, reason="It was not.")
    found = Outcome("synthetic", (night, late), (5.0, 500.0), (5.0, 1000.0), (5.0, 400.0), 0, 1.0)
    monkeypatch.setattr(demo, "run", lambda options, progress: found)
    assert demo.main([]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert err == ""
    assert "synthetic" in lines[0]
    assert [[cell.strip() for cell in line.strip("│").split("│")] for line in lines if line.startswith("│")] == [
        ["Mon 02 Jan", "40 %", "5.0 kWh", "100", "1", "50 %", "It was clean."],
        ["Mon 02 Jan", "40 %", "0.0 kWh", "-", "1", "40 % missed", "It was not."],
    ]
    assert lines[-1] == (
        "100 g/kWh against 200 when charging on arrival: 50 % less (with perfect foresight 80 g/kWh). "
        "Missed mornings: 1."
    )


@pytest.mark.requires("data")
def test_on_measured_intensity_there_is_less_carbon_and_no_missed_morning(runs: Runs) -> None:
    found = outcome(runs("measured"))
    assert len(found["nights"]) == 3
    assert found["reduction_pct"] > 0.0
    assert found["missed_mornings"] == 0


@pytest.mark.parametrize("name", [name for name in RUNS if name != "kept"])
def test_nothing_is_left_behind(runs: Runs, name: str) -> None:
    run, status, _, _ = runs(name)
    assert status == 0
    assert run.left() == []
    assert run.written() == []


# -- the broker -----------------------------------------------------------------------------------


def test_through_amqtt_the_night_is_the_same_to_the_last_digit(runs: Runs) -> None:
    assert outcome(runs("amqtt"))["nights"] == outcome(runs("first"))["nights"][:1]


def test_mosquitto_is_taken_before_amqtt_and_neither_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "mosquitto"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setattr(brokers, "SBIN", ())
    assert isinstance(any_broker(str(tmp_path), tmp_path), Mosquitto)
    assert isinstance(any_broker("/nowhere", tmp_path), Amqtt)
    monkeypatch.setattr(brokers, "find_spec", lambda name: None)
    with pytest.raises(LookupError, match=r"sudo apt install mosquitto, or pip install 'plugd\[demo\]'"):
        any_broker("/nowhere", tmp_path)


def test_a_demo_without_any_broker_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(brokers, "SBIN", ())
    monkeypatch.setattr(brokers, "find_spec", lambda name: None)
    monkeypatch.setenv("PATH", "/nowhere")
    assert demo.main(["--days", "1"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("plugd demo: no MQTT broker: sudo apt install mosquitto")
    assert len(said.splitlines()) == 1


# -- what cannot be done --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--days", "0"], "--days 0: choose 1 to 366"),
        (["--days", "367"], "--days 367: choose 1 to 366"),
        (["--days", "many"], "--days: invalid int value: 'many'"),
        (["--from", "yesterday"], "--from yesterday: write a date as 2023-01-02"),
        (["--from", "1999-01-01"], "synthetic: covers 2023-01-01 to 2024-01-01, not 1999-01-01 and 7 days"),
        (["--from", "2023-12-31"], "choose --from and --days within"),
        (["--source", "/nowhere/at-all.csv"], "/nowhere/at-all.csv: cannot be read"),
        (["--source", __file__], "needs the columns `from` and `actual` or `forecast`"),
        (["--plug", "toaster"], "invalid choice: 'toaster'"),
        (["--soc", "always"], "invalid choice: 'always'"),
        (["--fast"], "unrecognized arguments: --fast"),
        (["--page", "70000"], "--page 70000: choose 1 to 65535"),
    ],
)
def test_a_wrong_argument_is_one_line_and_status_2(
    capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    try:
        status: object = demo.main(arguments)
    except SystemExit as end:
        status = end.code
    out, err = capsys.readouterr()
    assert (status, out) == (2, "")
    assert err.startswith("plugd demo: ")
    assert said in err
    assert len(err.splitlines()) == 1


def test_a_page_whose_port_is_taken_is_said_before_a_week_passes(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server((HOST, 0)) as other:
        port = other.getsockname()[1]
        assert demo.main(["--page", str(port)]) == 2
    assert capsys.readouterr().err.startswith(f"plugd demo: --page {port}: cannot be had; is another page there?")


# -- a part fails ---------------------------------------------------------------------------------


def _kill_at(share: float, mark: str, what: str, kill: signal.Signals) -> Callable[[object], Any]:
    """A progress bar that ends a part of the demo on the way."""
    done = False

    def progress(now: float) -> None:
        nonlocal done
        if now >= share and not done:
            done = True
            (pid,) = (pid for pid, command in marked(mark) if what in command and pid != os.getpid())
            os.kill(pid, kill)

    @contextmanager
    def bar(_console: object) -> Iterator[Callable[[float], None]]:
        yield progress

    return bar


@pytest.mark.parametrize(
    ("part", "what", "kill"),
    [
        ("plugd", "plugd_hil.daemon", signal.SIGKILL),
        ("neso", "plugd_hil.neso", signal.SIGTERM),
        ("the broker", "mosquitto -c", signal.SIGTERM),
    ],
)
@pytest.mark.requires("mosquitto")
def test_a_part_that_dies_midway_ends_the_demo_with_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], part: str, what: str, kill: signal.Signals
) -> None:
    mark = f"mark-{uuid.uuid4().hex}"
    for name, value in environment(PLUGD_MARK=mark).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(demo, "_bar", _kill_at(0.0005, mark, what, kill))
    assert demo.main(["--days", "300", "--json"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"plugd demo: the demo stopped: {part} ended before its time")
    assert len(err.splitlines()) == 1
    assert [command for _, command in marked(mark)] == []


def test_a_daemon_that_does_not_start_is_named_at_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(demo_run, "CONFIG", demo_run.CONFIG.replace('dir = "{state}"', 'dir = "/dev/null" # {state}'))
    assert demo.main(["--days", "1"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("plugd demo: the demo stopped: plugd ended before its time (status 1): plugd: /dev/null")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(("told", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_demo_that_is_told_to_end_leaves_nothing(tmp_path: Path, told: signal.Signals, status: int) -> None:
    run = begin(tmp_path / "run", "--days", "300", program=("-u", "-c", TALKING))
    assert run.process.stdout is not None
    assert run.process.stdout.readline() == "under way\n"
    assert len(run.left()) >= 5
    run.process.send_signal(told)
    try:
        ended, _, err = run.ends()
        assert run.left() == []
    finally:
        for pid, _ in marked(run.mark):
            os.kill(pid, signal.SIGKILL)
    assert (ended, err) == (status, "")
    assert run.written() == []


TALKING = """
import sys
from contextlib import contextmanager
from plugd_hil import demo
from plugd_hil.account import Night, read_ledger
said = []

@contextmanager
def bar(_console):
    yield lambda share: said or said.append(print("under way"))

demo._bar = bar
sys.exit(demo.main())
"""


def test_a_closed_pipe_is_quiet() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        said = subprocess.run(
            [sys.executable, "-m", "plugd", "demo", "--help"],
            check=False,
            env=environment(),
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert said.stderr == ""


# -- the conductor's patience ---------------------------------------------------------------------


def test_a_participant_that_keeps_the_turn_is_named() -> None:
    conductor = Conductor(START, ("sleeper",), patience_s=0.1)
    line = Line(socket.create_connection(("127.0.0.1", conductor.port)))
    line.send(name="sleeper")
    line.receive()
    line.send(until=(START + timedelta(hours=1)).isoformat(), active=False)
    conductor.gather()
    with pytest.raises(TimeoutError, match="hangs, silent for 0 s: sleeper"):
        conductor.run_until(START + timedelta(days=1))
    line.close()
    conductor.close()


def test_what_is_seen_while_waiting_for_the_start_ends_the_wait() -> None:
    conductor = Conductor(START, ("late",))

    def look() -> None:
        raise LookupError("it has died")

    with pytest.raises(LookupError, match="it has died"):
        conductor.gather(look=look)
    conductor.close()


def test_who_waits_for_the_turn_is_told_when_the_conductor_leaves() -> None:
    conductor = Conductor(START, ("patient",))
    line = Line(socket.create_connection(("127.0.0.1", conductor.port)))
    line.send(name="patient")
    line.receive()
    told: list[str] = []

    def wait() -> None:
        try:
            line.receive()
        except ConnectionError as error:
            told.append(str(error))

    waiting = threading.Thread(target=wait)
    waiting.start()
    conductor.hang_up()
    waiting.join(5.0)
    assert told
    line.close()
    conductor.close()
