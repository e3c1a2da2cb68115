"""`plugd demo --plug KIND`: every kind keeps every morning; a week of each with --every-plug, else two days of one."""

import json
import subprocess
import sys

import pytest

from plugd_hil.plug import DIALECTS
from tests.programs import environment


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """All of them where they are asked for."""
    every = metafunc.config.getoption("--every-plug")
    kinds = [kind for kind in DIALECTS if kind != "tasmota"] if every else ["shelly2"]
    days = metafunc.config.getoption("--plug-days") if every else 2
    metafunc.parametrize(("kind", "days"), [(kind, days) for kind in kinds])


@pytest.mark.requires("mosquitto")
@pytest.mark.timeout(600)
def test_every_morning_is_kept(kind: str, days: int) -> None:
    said = subprocess.run(
        [sys.executable, "-m", "plugd", "demo", "--plug", kind, "--days", str(days), "--json"],
        capture_output=True,
        text=True,
        env=environment(),
        check=False,
    )
    assert (said.returncode, said.stderr) == (0, "")
    found = json.loads(said.stdout)
    assert len(found["nights"]) == days
    assert found["missed_mornings"] == 0
    assert all(night["morning_soc_pct"] >= night["minimum_pct"] - 0.5 for night in found["nights"])
    assert found["reduction_pct"] > 10.0
    assert found["guard_interventions"] <= 1, "on the first evening nothing is known of the car"
