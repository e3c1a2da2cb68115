"""The planner's bench still runs: every solver that is installed, a few ticks of each."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_it_runs_and_every_solver_gives_the_same_optimum(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    command = [sys.executable, str(ROOT / "bench" / "planner.py"), "--quick", "--json", str(figures)]
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=tmp_path, env={**os.environ, "PYTHONPATH": paths}
    )
    assert (done.returncode, done.stderr) == (0, "")  # it ends with an error where an optimum differs
    found = json.loads(figures.read_text())
    assert {f"{power} kW, N = {n}" for power in ("10", "2.3") for n in (1, 2, 4, 7)} <= found.keys()
    for name, case in found.items():
        if "N =" in name:
            peers = set() if "end value" in name else {"OSQP, cold", "HiGHS, warm", "HiGHS, new model", "scipy linprog"}
            assert {"OSQP, warm", "exact"} | peers <= case["times"].keys()
            assert case["osqp"]["fallbacks"] == 0
            assert case["osqp"]["bound_off_points"] < 0.01
    assert found["year, 10 kW, exact"]["gap_mean_pct"] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["figures.json"]
