"""The same runs on a real Dask cluster on loopback: a scheduler and two workers, each a process of its own."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from plugd.cli import main
from plugd.study.cluster import Cluster
from plugd.study.engine import Account
from plugd.study.runs import Failure, perform, simulated
from tests.study.test_backtest import written
from tests.study.test_runs import runs

pytestmark = pytest.mark.requires("dask")

LOOPBACK = "127.0.0.1"
WORKERS = 2


def started(stack: ExitStack, folder: Path, name: str, *arguments: str) -> "subprocess.Popen[str]":
    """A process of the cluster, ended with the stack."""
    command = [sys.executable, "-m", "distributed.cli." + name, *arguments]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, cwd=folder)

    def end() -> None:
        child.terminate()
        child.communicate(timeout=20)

    stack.callback(end)
    return child


def said(child: "subprocess.Popen[str]", word: str) -> str:
    """The line in which it says `word`."""
    assert child.stderr is not None
    heard = []
    for line in child.stderr:
        heard.append(line)
        if word in line:
            return line
    pytest.fail(f"it ended: {''.join(heard)}")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The scheduler's address."""
    folder = tmp_path_factory.mktemp("dask")
    with ExitStack() as stack:
        scheduler = started(stack, folder, "dask_scheduler", "--host", LOOPBACK, "--port", "0", "--no-dashboard")
        address = said(scheduler, "Scheduler at:").split()[-1]
        own = ("--host", LOOPBACK, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder))
        workers = [started(stack, folder, "dask_worker", address, *own) for _ in range(WORKERS)]
        for worker in workers:
            said(worker, "Registered to")
        yield address


def test_a_cluster_gives_the_same_accounts_and_loses_no_run(cluster: str) -> None:
    asked = runs("uncontrolled", "nonsense", "mpc")
    told: list[tuple[int, int]] = []
    outcomes = perform(asked, lambda: Cluster(cluster), lambda done, of: told.append((done, of)))
    assert [type(outcome) for outcome in outcomes] == [Account, Failure, Account]
    assert outcomes[0] == simulated(asked[0])
    assert outcomes[2] == simulated(asked[2])
    assert "run failed: nonsense" in str(outcomes[1])
    assert "'nonsense' is no strategy" in str(outcomes[1])
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_both_workers_work(cluster: str) -> None:
    from distributed import Client  # noqa: PLC0415 - where this runs, it is there

    perform(runs(*["mpc"] * 8), lambda: Cluster(cluster))
    with Client(cluster, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        done = client.run(lambda dask_worker: dask_worker.state.executed_count)
    assert len(done) == WORKERS
    assert min(done.values()) > 0


def test_the_same_bytes_as_from_the_pool(cluster: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "zone.csv")

    def text(*where: str) -> str:
        asked = ["study", "backtest", "--data", str(path), "--horizons", "1,2", "--to", "2023-01-07", "--json", *where]
        assert main(asked) == 0
        found = json.loads(capsys.readouterr().out)
        found.pop("wall_s")
        return json.dumps(found)

    assert text("--dask", cluster) == text("--workers", "1")


@pytest.mark.parametrize(
    ("address", "code", "words"),
    [("tcp://127.0.0.1:1", 1, "no scheduler answers"), ("nonsense://x", 2, "--dask nonsense://x")],
)
def test_a_cluster_that_is_not_there_is_one_line(
    address: str,
    code: int,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("plugd.study.cluster.ANSWER_WITHIN_S", 1)
    path = written(tmp_path / "zone.csv")
    assert main(["study", "backtest", "--data", str(path), "--horizons", "1", "--dask", address]) == code
    captured = capsys.readouterr()
    assert words in captured.err
    assert captured.err.count("\n") == 1
