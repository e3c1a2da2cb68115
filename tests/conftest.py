"""What the tests need of the machine, what is left out where it is missing, and the fixtures to use it by.

`PLUGD_REQUIRE=mosquitto,data` turns a missing component into a failure of the whole run.
"""

import importlib.util
import os
import shutil
import signal
import socket
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import settings

from plugd_hil.broker import Mosquitto, find_mosquitto

pytest_plugins = ["pytester"]

settings.register_profile("plugd", deadline=None)  # a busy machine is no fault of what is tested
settings.load_profile("plugd")

ROOT = Path(__file__).resolve().parents[1]


def find_data() -> Path | None:
    """The folder of measured series, if it is there."""
    folder = Path(os.environ.get("PLUGD_DATA", ROOT.parent / "shared" / "data"))
    return folder if (folder / "neso_national_2023.csv").is_file() else None


def find_chromium() -> Path | None:
    """A browser for the status page."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    return Path(found) if found else None


def find_dask() -> Path | None:
    """Dask's scheduler and worker, which are an extra of their own."""
    found = importlib.util.find_spec("distributed")
    return Path(found.origin) if found is not None and found.origin else None


def find_chromedriver() -> Path | None:
    """What drives the browser."""
    found = shutil.which("chromedriver")
    return Path(found) if found else None


def find_multicast() -> Path | None:
    """A way for multicast; a machine without any network but loopback has none, even to itself."""
    group = socket.inet_aton("239.74.163.2") + socket.inet_aton("0.0.0.0")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        except OSError:
            return None
    return Path("/sys/class/net")


@dataclass(frozen=True, slots=True)
class Component:
    """Something of the machine that some tests cannot do without."""

    find: Callable[[], Path | None]
    remedy: str
    fixtures: tuple[str, ...]
    """A test that asks for one of these needs the component, marked or not."""


COMPONENTS = {
    "mosquitto": Component(
        lambda: find_mosquitto(os.environ.get("PATH", "")), "sudo apt install mosquitto", ("mosquitto",)
    ),
    "data": Component(find_data, "set PLUGD_DATA to the folder with neso_national_2023.csv", ("neso_data",)),
    "dask": Component(find_dask, "pip install '.[dask]', or set up by make", ()),
    "chromium": Component(
        lambda: find_chromium() if find_chromedriver() else None,
        "sudo apt install chromium chromium-driver",
        ("chromium", "chromedriver"),
    ),
    "multicast": Component(find_multicast, "connect it to a network; nothing is sent to it", ()),
}
MISSING = pytest.StashKey[list[str]]()
NEEDS = "needs "
"""What the reason of a test that is left out begins with."""


LONGEST_FIRST = ("study", "hil", "adapters")
"""Folders whose files take the longest: begun last, one of them would keep one core busy and leave the others idle."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """What takes too long for every run."""
    parser.addoption("--every-plug", action="store_true", help="the whole contract suite, and a week, of every plug")
    parser.addoption("--plug-days", type=int, default=7, help="how long that week is")


def pytest_configure(config: pytest.Config) -> None:
    """Ends the run at once where a component that was promised is unknown or missing."""
    # A shell that runs us in the background has our children ignore Ctrl-C, which some tests send.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    missing = {name for name, component in COMPONENTS.items() if component.find() is None}
    config.stash[MISSING] = sorted(missing)
    for name in filter(None, (n.strip() for n in os.environ.get("PLUGD_REQUIRE", "").split(","))):
        if name not in COMPONENTS:
            raise pytest.UsageError(f"PLUGD_REQUIRE: unknown component {name}; known: {', '.join(COMPONENTS)}")
        if name in missing:
            raise pytest.UsageError(f"PLUGD_REQUIRE: {name} is missing; {COMPONENTS[name].remedy}")


def _needs(item: pytest.Item) -> set[str]:
    marked = {name for mark in item.iter_markers("requires") for name in mark.args}
    fixtures = set(getattr(item, "fixturenames", ()))
    asked = {name for name, component in COMPONENTS.items() if fixtures.intersection(component.fixtures)}
    if unknown := marked - COMPONENTS.keys():
        raise pytest.UsageError(f"{item.nodeid} requires unknown {', '.join(unknown)}")
    return marked | asked


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest first; marks what this machine cannot run."""
    places = {name: place for place, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: places.get(item.path.parent.name, len(places)))
    for item in items:
        needs = _needs(item)
        if missing := [name for name in config.stash[MISSING] if name in needs]:
            item.add_marker(pytest.mark.skip(reason=NEEDS + ", ".join(missing)))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Says last what was left out, and how to have it next time."""
    missing = config.stash[MISSING]
    if missing:
        terminalreporter.section("left out")
    # From the reports, as the tests may have run in other processes.
    reasons = [report.longrepr[2] for report in terminalreporter.stats.get("skipped", [])]
    left_out = Counter(name for reason in reasons if NEEDS in reason for name in reason.partition(NEEDS)[2].split(", "))
    for name in missing:
        tests = left_out[name]
        terminalreporter.line(f"{name}: {tests} test{'' if tests == 1 else 's'}; {COMPONENTS[name].remedy}")


def _found(name: str) -> Path:
    found = COMPONENTS[name].find()
    if found is None:
        pytest.skip(NEEDS + name)
    return found


@pytest.fixture
def mosquitto(tmp_path: Path) -> Iterator[Mosquitto]:
    """A running broker of this test's own; `stop()` and `start()` it at will."""
    broker = Mosquitto(_found("mosquitto"), tmp_path)
    broker.start()
    yield broker
    broker.stop()


@pytest.fixture(scope="session")
def neso_data() -> Path:
    """The folder of measured series."""
    return _found("data")


@pytest.fixture(scope="session")
def chromium() -> Path:
    """The browser's program."""
    return _found("chromium")


@pytest.fixture(scope="session")
def chromedriver() -> Path:
    """What drives it."""
    found = find_chromedriver()
    if found is None:
        pytest.skip("needs chromium-driver")
    return found
