"""Every command, setting and link in the documentation is one that there is.

What is in a shell block, or between backticks and begins with `make` or `plugd`, is read as a shell would read it. Ours
is given to its own parser, a make target is looked up, a program of this repository is asked for its help, and a file
that is named must be there. Of other people's programs only the names are known here.
"""

import contextlib
import io
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import pytest
import yaml

from plugd.cli import parsing, program
from plugd.config import parse
from plugd.study import command as study
from plugd_hil import demo
from tests.programs import environment

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    path.relative_to(ROOT) for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "hil" / "README.md")
)
SYSTEM = """
apt apt-get base64 bash candump cat cd chmod chown cp curl docker export git head install ip journalctl loginctl ls
mkdir modprobe mosquitto mosquitto_passwd mosquitto_pub mosquitto_sub nano openssl pip pipx printf rm rsync scp sh
ssh systemctl systemd-analyze systemd-creds tee usermod
"""
OTHERS = frozenset(SYSTEM.split())
"""Programs that are not ours."""
MORE = "…"
"""Stands for the arguments that a text leaves out."""
PLACEHOLDERS = {"N": "5", "AMPS": "8", "DATE": "2023-01-01", "KIND": "tasmota"}
OPERATORS = frozenset(("&&", "||", ";", "|", "&", "(", ")"))


class Understood(Exception):
    """The arguments were taken."""


class OnlyReads(parsing.Parser):
    """A parser that goes no further."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> NoReturn:
        """Read all, do nothing."""
        super().parse_args(args, namespace)
        raise Understood


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in a language."""
    return re.findall(rf"^ *```{language}\n(.*?)^ *```$", (ROOT / page).read_text("utf-8"), re.MULTILINE | re.DOTALL)


def commands(text: str) -> Iterator[list[str]]:
    """The simple commands of a shell's text, each as its words, without redirections and assignments."""
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.shlex(line, posix=True, punctuation_chars=True)
        words.whitespace_split = True
        found: list[str] = []
        for word in (*words, ";"):
            if word in OPERATORS:
                plain = _plain(found)
                if plain:
                    yield plain
                found = []
            else:
                found.append(word)


def _plain(words: list[str]) -> list[str]:
    """Without `sudo`, assignments in front and where output goes."""
    while words and (words[0] == "sudo" or re.match(r"[A-Z_]+=", words[0])):
        words = words[1:]
    if ">" in words:
        words = words[: words.index(">")]
    return [word for word in words if word not in (">", "<", "2")] if words else []


def inline(page: Path) -> Iterator[list[str]]:
    """Commands of ours within the text."""
    text = re.sub(r"^ *```.*?^ *```$", "", (ROOT / page).read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    for said in re.findall(r"`([^`\n]+)`", text):
        if re.match(r"(make|plugd) [a-z-]", said):
            yield from commands(re.sub(r"\|\w+|[\[\]]", "", said))  # the first of on|off, and what may be left out


@cache
def targets() -> frozenset[str]:
    """What can be made."""
    return frozenset(re.findall(r"^([a-z][\w-]*):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))


@cache
def help_of(*words: str) -> str:
    """What a program of ours says to `--help`."""
    done = subprocess.run(
        [sys.executable, *words, "--help"], cwd=ROOT, env=environment(), capture_output=True, text=True, check=False
    )
    return done.stdout if done.returncode == 0 else f"there is no {' '.join(words)}: {done.stderr[-300:]}"


def understood(words: Sequence[str]) -> str | None:
    """Why a command is none; None for one that is."""
    name, rest = Path(words[0]).name, list(words[1:])
    if name == "make":
        return _made(rest)
    if name == "plugd":
        return _plugd(rest)
    if name in ("python", "python3", "python3.11", "python3.13"):
        return _python(rest)
    if name not in OTHERS:
        return f"{name} is no program that this test knows; add it to OTHERS if it is somebody else's"
    if name in ("pip", "pipx"):
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
        asked = [extra for word in rest for extra in re.findall(r"\[(.*?)\]", word)]
        unknown = [extra for group in asked for extra in group.split(",") if extra not in extras]
        if unknown:
            return f"there is no extra {unknown}"
    ours = [word for word in rest if re.match(r"(etc|systemd|deploy|docs|bench|hil|requirements)[/.]", word)]
    missing = [word for word in ours if not list(ROOT.glob(word))]
    return f"{missing} is not there" if missing else None


def _made(rest: list[str]) -> str | None:
    wanted = [word for word in rest if "=" not in word and not word.startswith("-")]
    settings = dict(word.split("=", 1) for word in rest if "=" in word)
    unknown = [word for word in wanted if word not in targets()]
    if unknown:
        return f"there is no target {unknown}"
    if "BENCH" in settings and not (ROOT / settings["BENCH"]).is_file():
        return f"there is no {settings['BENCH']}"
    arguments = shlex.split(settings.get("ARGS", ""))
    if wanted == ["demo"]:
        return _plugd(["demo", *arguments])
    if wanted == ["bench"] and "BENCH" in settings:
        return _python([settings["BENCH"], *arguments])
    return None


def _plugd(rest: list[str]) -> str | None:
    """Whether plugd takes these arguments; placeholders in capitals stand for a value."""
    filled = [PLACEHOLDERS.get(word, word) for word in rest if word != MORE]
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            if filled[:1] == ["demo"]:
                demo._parsed(filled[1:])
            elif filled[:1] == ["study"]:
                study.main(OnlyReads(prog="plugd study"), filled[1:])
            else:
                options, unread = program.parser().parse_known_args(filled)
                return f"{unread} is not read" if unread and not options.reads_rest else None
    except Understood:
        return None
    except SystemExit as error:
        whole = MORE not in rest and any(word.startswith("-") for word in rest)
        return None if error.code == 0 or (not whole and "required" in said.getvalue()) else said.getvalue()
    return None


def _python(rest: list[str]) -> str | None:
    if rest[:2] == ["-m", "venv"] or rest[:2] == ["-m", "pip"]:
        return None
    count = (3 if rest[:2] == ["-m", "plugd_hil"] else 2) if rest[:1] == ["-m"] else 1
    said = help_of(*rest[:count])
    if "usage:" not in said:
        return said
    unknown = [word for word in rest[count:] if word.startswith("--") and word.split("=")[0] not in said]
    return f"{rest[:count]} knows no {unknown}" if unknown else None


CASES = [
    pytest.param(words, id=f"{page}: {' '.join(words)}")
    for page in PAGES
    for words in (*(c for block in blocks(page, "sh") for c in commands(block)), *inline(page))
]


@pytest.mark.parametrize("words", CASES)
def test_a_documented_command_is_one_that_there_is(words: list[str]) -> None:
    assert understood(words) is None


@pytest.mark.parametrize(
    "words",
    [
        "make tea",
        "make bench BENCH=bench/tea.py",
        "make demo ARGS='--days many'",
        "make demo ARGS=--tea",
        "plugd brew",
        "plugd check --tea",
        "plugd plan --solver tea",
        "plugd plug amps much",
        "plugd study table --tea",
        "python bench/tea.py",
        "python bench/relay.py --tea",
        "python -m plugd_hil.tea",
        "pip install 'plugd[tea]'",
        "install -m 644 etc/tea.toml /etc/tea.toml",
        "teapot",
    ],
)
def test_one_that_there_is_not_is_noticed(words: str) -> None:
    """The test above can fail."""
    assert understood(next(commands(words))) is not None


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_what_a_page_names_is_there(page: Path) -> None:
    """Its links, its pictures, and the programs' files in its text."""
    text = (ROOT / page).read_text("utf-8")
    linked = [to for to in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in to and not to.startswith("#")]
    assert [to for to in linked if not (ROOT / page.parent / to.partition("#")[0]).exists()] == []
    headings = {to: _anchors(ROOT / page.parent / to.partition("#")[0]) for to in linked if "#" in to}
    assert [to for to, anchors in headings.items() if to.partition("#")[2] not in anchors] == []
    named = re.findall(r"`((?:plugd|hil|tests|bench|etc|docs|systemd|deploy)/[\w/.-]+\.\w+)`", text)
    assert [name for name in named if not (ROOT / name).exists()] == []


def _anchors(page: Path) -> set[str]:
    """How the headings of a page are linked to."""
    titles = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_a_documented_configuration_is_one(page: Path) -> None:
    for block in blocks(page, "toml"):
        topic = "" if "[plug]" in block else '[plug]\ntopic = "ev-plug"\n'
        limits = (
            "" if "[can]" in block or "can_elcon" not in block else "[can]\nmax_voltage_v = 405\nmax_current_a = 12\n"
        )
        parse(f"{block}\n{topic}{limits}")
    for block in blocks(page, "yaml"):
        assert yaml.safe_load(block)
