"""Whether somebody has told the machine the time: systemd-timesyncd's own mark."""

import time
from pathlib import Path

import pytest

from plugd import wall
from plugd.adapters import clock


def test_a_time_that_timesyncd_has_not_heard_is_not_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = tmp_path / "timesync" / "synchronized"
    assert not clock.unset(told), "somebody else keeps the time"
    told.parent.mkdir()
    monkeypatch.setattr(time, "monotonic", lambda: wall.PATIENCE_S - 1.0)
    assert clock.unset(told)
    monkeypatch.setattr(time, "monotonic", lambda: wall.PATIENCE_S)
    assert not clock.unset(told), "after a day it is believed"
    monkeypatch.setattr(time, "monotonic", lambda: 60.0)
    told.touch()
    assert not clock.unset(told)
