"""Two secrets, and every place where plugd writes or says something: they are in none of them."""

import http.client
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from plugd_hil.broker import HOST, BrokerProcess, find_mosquitto, free_port
from tests.programs import PATIENCE_S, Listener, Program, environment

pytestmark = [pytest.mark.requires("mosquitto"), pytest.mark.timeout(240)]

PASSWORD, TOKEN, WRONG = "canary-Password-7f31", "canary-Token-9c02", "canary-Wrong-55d8"
CANARIES = (PASSWORD, TOKEN, WRONG)
COMMANDS = (
    ("check",),
    ("plan",),
    ("plan", "--json"),
    ("history", "show"),
    ("report", "--json"),
    ("plug", "show"),
    ("dump",),
    ("-v", "check"),
)
PAGES = ("/", "/live", "/api/state", "/metrics", "/healthz", "/nowhere")


def birds(text: str | bytes) -> list[str]:
    """The canaries in a text."""
    said = text if isinstance(text, bytes) else text.encode()
    return [canary for canary in CANARIES if canary.encode() in said]


@dataclass(slots=True)
class Home:
    """A broker that asks plugd for its password and nobody else, a stub plug, a stub server, a configuration."""

    folder: Path
    broker: BrokerProcess
    locked: int
    """The port at which a password is asked for."""
    page: int
    neso: int

    def configured(self, password: str) -> str:
        """The configuration, with this in its password file."""
        for name, secret in (("password", password), ("token", TOKEN)):
            (self.folder / name).write_text(f"{secret}\n")
            (self.folder / name).chmod(0o600)
        path = self.folder / "plugd.toml"
        path.write_text(
            f'[broker]\nhost = "{HOST}"\nport = {self.locked}\nusername = "plugd"\npassword_file = "password"\n'
            f'[plug]\ntopic = "ev-plug"\n[forecast]\nbase_url = "http://{HOST}:{self.neso}"\n'
            f'[state]\ndir = "state"\n[web]\nbind = "{HOST}:{self.page}"\ntoken_file = "token"\n'
        )
        return str(path)

    def ask(self, method: str, path: str, token: str | None = None, body: str | None = None) -> tuple[int, bytes]:
        """What the page answers, head and body."""
        connection = http.client.HTTPConnection(HOST, self.page, timeout=PATIENCE_S)
        headers = {} if token is None else {"X-Plugd-Token": token, "Origin": f"http://{HOST}:{self.page}"}
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        said = str(answer.getheaders()).encode() + answer.read()
        connection.close()
        return answer.status, said

    def files(self) -> dict[str, bytes]:
        """Everything that was written anywhere here, but the secrets themselves."""
        found = (path for path in self.folder.rglob("*") if path.is_file() and path.name not in ("password", "token"))
        return {str(path): path.read_bytes() for path in found if path.name != "passwords"}


@pytest.fixture
def home(tmp_path: Path) -> Iterator[Home]:
    program = find_mosquitto(os.environ.get("PATH", ""))
    if program is None:
        pytest.skip("needs mosquitto")
    port, locked = free_port(), free_port()
    passwords, config = tmp_path / "passwords", tmp_path / "mosquitto.conf"
    passwords.write_text(f"plugd:{PASSWORD}\n")
    passwords.chmod(0o600)
    subprocess.run(["mosquitto_passwd", "-U", passwords], check=True)
    root = "user root\n" if os.geteuid() == 0 else ""
    config.write_text(
        f"{root}per_listener_settings true\npersistence false\nlog_dest stderr\n"
        f"listener {port} {HOST}\nallow_anonymous true\n"
        f"listener {locked} {HOST}\nallow_anonymous false\npassword_file {passwords}\n"
    )
    with ExitStack() as left:
        broker = BrokerProcess([program, "-c", config], port)
        broker.start()
        left.callback(broker.stop)
        neso = left.enter_context(Program("plugd_hil.neso", "--source", "synthetic"))
        plug = left.enter_context(Program("plugd_hil.plug", "--broker", f"{HOST}:{port}"))
        plug.said.until(lambda line: line.get("ready"))
        at = neso.said.until(lambda line: "port" in line)["port"]
        yield Home(tmp_path, broker, locked, free_port(), at)


def told(config: str, *command: str) -> tuple[int, str]:
    """What a command of plugd's ends with, and says on both channels."""
    program = [sys.executable, "-m", "plugd", "-c", config, *command]
    done = subprocess.run(program, capture_output=True, text=True, env=environment(), check=False, timeout=PATIENCE_S)
    return done.returncode, done.stdout + done.stderr


def arguments_and_environment(pid: int) -> bytes:
    """What others on the machine may see of a process, and of those it started."""
    said = b""
    for task in (pid, *children(pid)):
        for name in ("cmdline", "environ"):
            said += Path("/proc", str(task), name).read_bytes()
    return said


def children(pid: int) -> list[int]:
    """The processes that a process has started."""
    return [
        int(word) for task in Path(f"/proc/{pid}/task").iterdir() for word in (task / "children").read_text().split()
    ]


def test_a_secret_is_nowhere_but_in_its_file(home: Home) -> None:
    config = home.configured(PASSWORD)
    everything = Listener(HOST, home.broker.port, ("#", "$SYS/#"))
    with Program("plugd", "-c", config, "-v", "run") as daemon:
        everything.until("plugd/ev/plan", lambda plan: isinstance(plan, list) and len(plan) > 0)
        assert not birds(arguments_and_environment(daemon.process.pid))
        shown = [home.ask("GET", path) for path in PAGES]
        assert shown[0][0] == 200
        shown.append(home.ask("POST", "/command/minimum", TOKEN, "60"))
        assert shown[-1][0] == 200, shown[-1]
        shown.append(home.ask("POST", "/command/minimum", WRONG, "60"))
        assert shown[-1][0] == 401
        shown.append(home.ask("POST", f"/command/minimum?token={WRONG}", TOKEN[:-1], "61"))
        assert shown[-1][0] == 401
        for status, said in shown:
            assert not birds(said), status
        for command in COMMANDS:
            words = told(config, *command)[1]
            assert words
            assert not birds(words), command
        daemon.process.terminate()
        assert daemon.ends() == 0
    everything.close()
    assert len(everything.heard.all) > 10
    assert not birds(str(everything.heard.all))
    assert not birds(str(daemon.said.all + daemon.complained.all))
    assert any("runs: " in str(line) for line in daemon.complained.all)
    written = home.files()
    assert any(path.endswith("plugd.db") for path in written)
    assert [path for path, content in written.items() if birds(content)] == []


def test_a_wrong_password_is_refused_without_being_told(home: Home) -> None:
    with Program("plugd", "-c", home.configured(WRONG), "-v", "run") as daemon:
        daemon.complained.until(lambda line: "broker" in str(line) and "password" in str(line))
        daemon.process.terminate()
        assert daemon.ends() == 0
    assert not birds(str(daemon.said.all + daemon.complained.all))
    assert not [path for path, content in home.files().items() if birds(content)]


@pytest.mark.parametrize(
    "wrong",
    [
        f'[broker]\npassword = "{PASSWORD}"\n',
        f'[web]\ntoken = "{PASSWORD}"\n',
        f'[broker]\nhost = "plugd:{PASSWORD}@broker"\n',
        f'[forecast]\nbase_url = "https://me:{PASSWORD}@example.org"\n',
        f'[broker]\npassword_file = ["{PASSWORD}"]\n',
        f'[broker]\nusername = "a"\npassword_file = "x"\npasword = "{PASSWORD}"\n',
    ],
)
def test_a_secret_in_the_wrong_place_is_refused_without_being_told(tmp_path: Path, wrong: str) -> None:
    path = tmp_path / "plugd.toml"
    path.write_text(f'[plug]\ntopic = "ev-plug"\n{wrong}')
    status, said = told(str(path), "run")
    assert status == 78
    assert said.count("\n") == 1
    assert not birds(said), said
