"""What systemd hears: a real datagram socket stands for it."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from plugd.adapters.systemd import Supervisor


class Listener:
    """systemd's end."""

    def __init__(self, address: str) -> None:
        self.line = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.line.setblocking(False)
        self.line.bind("\0" + address[1:] if address.startswith("@") else address)
        self.supervisor = Supervisor(address)

    def heard(self) -> list[str]:
        """Every word since the last call, in order."""
        words: list[str] = []
        while True:
            try:
                words += self.line.recv(4096).decode().split("\n")
            except BlockingIOError:
                return words


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Listener]:
    address = str(tmp_path / "notify")
    listener = Listener(address if request.param == "path" else f"@{address}")
    yield listener
    listener.line.close()


def test_ready_once_and_the_status_when_it_changes(systemd: Listener) -> None:
    for status in ("Waiting.", "Waiting.", "Charging."):
        systemd.supervisor.beat(None, status)
    assert systemd.heard() == [
        "READY=1",
        "WATCHDOG=1",
        "STATUS=Waiting.",
        "WATCHDOG=1",
        "WATCHDOG=1",
        "STATUS=Charging.",
    ]


def test_a_loop_that_is_ill_neither_becomes_ready_nor_feeds_the_watchdog(systemd: Listener) -> None:
    systemd.supervisor.beat("no thread", "Waiting.")
    assert systemd.heard() == ["STATUS=no thread"]
    systemd.supervisor.beat(None, "Waiting.")
    assert systemd.heard()[:2] == ["READY=1", "WATCHDOG=1"]
    systemd.supervisor.beat("no thread", "Waiting.")
    assert systemd.heard() == ["STATUS=no thread"]


def test_an_ailment_is_logged_once(systemd: Listener, caplog: pytest.LogCaptureFixture) -> None:
    for ailment in ("no thread", "no thread", None, "no thread"):
        systemd.supervisor.beat(ailment, "Waiting.")
    assert [record.levelname for record in caplog.records] == ["ERROR", "ERROR"]


def test_a_status_is_one_line_whatever_is_in_it(systemd: Listener) -> None:
    systemd.supervisor.beat(None, "Waiting\nWATCHDOG=1\n")
    assert systemd.heard() == ["READY=1", "WATCHDOG=1", "STATUS=Waiting WATCHDOG=1"]


def test_the_end_is_told(systemd: Listener) -> None:
    systemd.supervisor.stopping()
    assert systemd.heard() == ["STOPPING=1"]


def test_ready_is_said_again_until_somebody_hears_it(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    supervisor = Supervisor(address)
    supervisor.beat(None, "Waiting.")
    listener = Listener(address)
    supervisor.beat(None, "Waiting.")
    assert listener.heard() == ["READY=1", "WATCHDOG=1", "STATUS=Waiting."]
    listener.line.close()


def test_without_systemd_nothing_is_said() -> None:
    supervisor = Supervisor()
    supervisor.beat(None, "Waiting.")
    supervisor.stopping()
