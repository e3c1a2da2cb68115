"""A weak supply is told of, from files as a Raspberry Pi's kernel has them."""

import time
from pathlib import Path

import pytest

from plugd.adapters.supply import STANDS_S, Supply


def hwmon(folder: Path, name: str, alarm: str) -> Path:
    """A folder with one sensor beside another."""
    for k, called in enumerate(("cpu_thermal", name)):
        sensor = folder / f"hwmon{k}"
        sensor.mkdir()
        (sensor / "name").write_text(f"{called}\n")
        (sensor / "in0_lcrit_alarm").write_text(f"{alarm}\n")
    return folder


def test_a_dip_is_told_for_an_hour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    supply = Supply(hwmon(tmp_path, "rpi_volt", "0"))
    assert supply.faults() == ()
    (tmp_path / "hwmon1" / "in0_lcrit_alarm").write_text("1\n")
    (fault,) = supply.faults()
    assert fault.code == "weak_supply"
    (tmp_path / "hwmon1" / "in0_lcrit_alarm").write_text("0\n")
    now_s += STANDS_S
    assert supply.faults() == (fault,)
    now_s += 1.0
    assert supply.faults() == ()


def test_other_machines_have_no_such_alarm(tmp_path: Path) -> None:
    assert Supply(tmp_path / "nothing").faults() == ()
    assert Supply(hwmon(tmp_path, "acpitz", "1")).faults() == ()
