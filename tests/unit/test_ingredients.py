"""What plugd is made of, and whom it talks to."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MOST_NAMED = 12
"""Packages that the daemon with its page may name: each one more is one more to trust."""
SPOKEN_TO = {"api.carbonintensity.org.uk"}
"""The only host that plugd knows by itself: broker and forecast are in the owner's configuration."""
NOT_SPOKEN_TO = {"www.w3.org", "HOST", "host"}
"""A name space, and examples."""


def project() -> dict[str, list[str]]:
    """Dependencies by extra; the daemon's own under ''."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {"": table["dependencies"], **table["optional-dependencies"]}


def pinned(lock: str) -> dict[str, int]:
    """Package by package of a lock, how many hashes it has."""
    found = {}
    for entry in re.split(r"\n(?=\S)", lock.strip()):
        name = re.match(r"[a-z0-9.-]+(?===[0-9])", entry)
        assert name, f"not pinned: {entry.splitlines()[0]}"
        found[name[0]] = entry.count("--hash=sha256:")
    return found


def test_the_list_of_ingredients_is_short() -> None:
    needs = project()
    assert len(needs[""] + needs["web"]) <= MOST_NAMED


def test_every_package_is_pinned_with_its_hashes_and_bandit_is_there() -> None:
    for lock in ("requirements.lock", "requirements-bench.lock"):
        found = pinned((ROOT / lock).read_text(encoding="utf-8"))
        assert [name for name, hashes in found.items() if not hashes] == []
    locked = pinned((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    for extra, needs in project().items():
        for need in needs if extra != "bench" else ():
            assert re.split(r"[<>=;\[ ]", need)[0].lower() in locked, f"{need} is in no lock: make lock"


def test_it_talks_to_nobody_but_the_forecast_unasked() -> None:
    hosts = set()
    for path in (ROOT / "plugd").rglob("*"):
        if path.suffix in (".py", ".html", ".js", ".css"):
            hosts |= set(re.findall(r"(?:https?:)?//([A-Za-z][\w.-]*[A-Za-z])", path.read_text(encoding="utf-8")))
    assert hosts - NOT_SPOKEN_TO == SPOKEN_TO
