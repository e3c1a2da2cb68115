"""What the Debian package is made of, before it is: the lock's entries for a target, the man page, the completion."""

import re
import subprocess
from pathlib import Path

import pytest

from deploy.build_deb import MACHINES, TARGETS, locked, needed
from deploy.manual import commands, completion, man_page
from plugd.cli import parser

LOCK = (Path(__file__).parents[2] / "requirements.lock").read_text(encoding="utf-8")


@pytest.mark.parametrize("machine", MACHINES.values())
@pytest.mark.parametrize("suite", TARGETS)
def test_each_target_gets_one_entry_of_what_it_needs_with_hashes_and_without_marker(suite: str, machine: str) -> None:
    environment = TARGETS[suite].environment(machine)
    names = needed(environment)
    entries = list(locked(LOCK, names, environment))
    assert len(entries) == len(names)
    for entry in entries:
        assert re.fullmatch(r"\S+==\S+( \\\n    --hash=sha256:[0-9a-f]{64})+", entry), entry
    assert {"numpy", "paho-mqtt", "uvicorn", "cantools"} <= names
    assert not {"pytest", "matplotlib", "rich", "joblib", "colorama"} & names


def test_the_lock_offers_each_python_its_own_numpy() -> None:
    found = {
        suite: next(e for e in locked(LOCK, {"numpy"}, target.environment("x86_64")))
        for suite, target in TARGETS.items()
    }
    assert found["bookworm"] != found["trixie"]


def test_what_the_lock_lacks_is_said() -> None:
    with pytest.raises(SystemExit, match=r"no nonesuch; run make lock"):
        list(locked(LOCK, {"nonesuch", "numpy"}, TARGETS["bookworm"].environment("x86_64")))


def test_the_man_page_tells_every_command() -> None:
    page = man_page(parser(), "1.2.3")
    for command in commands(parser()):
        assert f".SS plugd {command}\n" in page
    assert ".B \\-\\-click\n" in page
    assert "%(" not in page


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("plugd pl", {"plan", "plug"}),
        ("plugd plug o", {"on", "off"}),
        ("plugd -c /etc/plugd/plugd.toml check --c", {"--click"}),
        ("plugd history fetch --r", {"--region"}),
        ("plugd history zz", set()),
    ],
)
def test_bash_completes(line: str, offered: set[str]) -> None:
    words = line.split()
    script = f"""{completion(parser())}
COMP_WORDS=({" ".join(words)}); COMP_CWORD={len(words) - 1}; _plugd; printf '%s\\n' "${{COMPREPLY[@]}}" """
    ran = subprocess.run(["bash", "-c", script], check=True, capture_output=True, text=True)
    assert set(ran.stdout.split()) == offered
