"""The configuration from another process: the same values, the same complaints, and no pydantic in the daemon."""

import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from plugd.config import Config, household, load
from plugd.config.handed import load as handed
from plugd.domain import Capability
from plugd.errors import ConfigError

RICH = """
name = "second"
[plug]
kind = "mqtt"
topic = "garage"
[plug.mqtt]
command_topic = "{topic}/set"
command_on = "ON"
command_off = "OFF"
state_topic = "{topic}"
state_on = "ON"
state_off = "OFF"
[nights]
ready_by = 07:30:00
[nights.week.sat]
minimum_pct = 70
[nights.week.sun]
away = true
[state]
dir = "here"
[web]
hosts = ["a", "b"]
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file with something in every shape of value."""
    path = tmp_path / "plugd.toml"
    path.write_text(RICH, encoding="utf-8")
    return path


def test_the_values_are_those_of_the_models(path: Path) -> None:
    models, values = load(path), handed(path)
    assert asdict(values) == models.model_dump()
    assert household(values, Capability(2.3)) == household(models, Capability(2.3))
    assert values.state.dir == path.parent / "here"
    with pytest.raises(AttributeError):
        values.plug.power_kw = 3.0


def test_what_is_wrong_is_said_in_the_same_words(path: Path) -> None:
    path.write_text("[plug]\npower_kw = 2300\n", encoding="utf-8")
    with pytest.raises(ConfigError) as models:
        load(path)
    with pytest.raises(ConfigError) as values:
        handed(path)
    assert str(values.value) == str(models.value)


@pytest.mark.parametrize("child", ["/nowhere/python", "false", "true"])
def test_without_a_process_it_is_read_here(path: Path, child: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", child)  # it is not there, it fails, it says nothing
    assert isinstance(handed(path), Config)


def test_what_lies_in_the_folder_one_stands_in_is_not_run(
    path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (path.parent / "fractions.py").write_text("raise SystemExit('somebody else is run')", encoding="utf-8")
    monkeypatch.chdir(path.parent)
    assert not isinstance(handed(Path(path.name)), Config)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("said", ["Site", "cd", "coverage on"])
def test_what_the_site_prints_at_every_start_is_passed_over(
    path: Path, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = path.parent / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(f"print({said!r}, flush=True)", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(site), *sys.path)))
    assert not isinstance(handed(path), Config)


def test_the_daemon_with_its_page_does_without_pydantic(path: Path) -> None:
    program = (
        "import sys, plugd.daemon, plugd.page, plugd.adapters.clock, plugd.web.app, plugd.web.server\n"
        "from pathlib import Path\n"
        "from plugd.config.handed import load\n"
        "load(Path(sys.argv[1]))\n"
        "print(*(name for name in ('pydantic', 'numpy', 'prometheus_client') if name in sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []
