"""An MQTT broker on a free loopback port: mosquitto where it is installed, else amqtt."""

import os
import shutil
import socket
import subprocess
import sys
import threading
from collections import deque
from contextlib import ExitStack, suppress
from importlib.util import find_spec
from pathlib import Path

from plugd.errors import PlugdError

SBIN = ("/usr/sbin", "/usr/local/sbin")
"""Where Debian puts servers; an ordinary user's PATH lacks both."""

HOST = "127.0.0.1"

AMQTT = """
import asyncio, signal, sys
from amqtt.broker import Broker

async def serve(port):
    broker = Broker({
        "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}"}},
        "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
    })
    await broker.start()
    print("running", file=sys.stderr, flush=True)
    end = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, end.set)
    await end.wait()
    await broker.shutdown()

asyncio.run(serve(int(sys.argv[1])))
"""


def find_mosquitto(path: str) -> Path | None:
    """The server's program: on `path` (as in $PATH), or where an ordinary user does not look."""
    found = shutil.which("mosquitto", path=":".join((path, *SBIN)))
    return Path(found) if found else None


def free_port() -> int:
    """A port that nothing listens on now."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


class BrokerProcess:
    """A broker in a process of its own, that can be stopped and started again on the same port."""

    def __init__(self, command: list[str | Path], port: int) -> None:
        self.host = HOST
        self.port = port
        self.log: deque[str] = deque(maxlen=500)
        self._command = command
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None

    def start(self) -> None:
        """Returns once it accepts connections. Raises RuntimeError, in its words, if it ends."""
        process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self._process = process
        lines = process.stderr
        if lines is None:
            raise RuntimeError("the broker was started without a pipe")
        for line in lines:
            self.log.append(line)
            if "running" in line:
                break
        else:
            self.stop()
            raise RuntimeError(f"the broker ended at once: {''.join(self.log)}")
        self._reader = threading.Thread(target=self.log.extend, args=(lines,), daemon=True)
        self._reader.start()

    @property
    def ended(self) -> bool:
        """Whether it has ended by itself."""
        return self._process is not None and self._process.poll() is not None

    @property
    def last_words(self) -> str:
        """The last line that it wrote."""
        return self.log[-1].strip() if self.log else "it said nothing"

    def stop(self) -> None:
        """Ends it and every connection to it. Nothing happens where it does not run."""
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(5)
        process.kill()
        process.wait()
        if self._reader:
            self._reader.join()
        if process.stderr:
            process.stderr.close()


class Mosquitto(BrokerProcess):
    """mosquitto, without memory of before."""

    def __init__(self, program: Path, folder: Path, port: int | None = None) -> None:
        """Writes the broker's configuration into `folder`; nothing runs yet."""
        port = port or free_port()
        config = folder / "mosquitto.conf"
        config.write_text(
            f"listener {port} {HOST}\nallow_anonymous true\nset_tcp_nodelay true\npersistence false\nlog_dest stderr\n"
        )
        super().__init__([program, "-c", config], port)


class Amqtt(BrokerProcess):
    """The broker written in Python, for machines without mosquitto. MQTT 3.1.1 only."""

    def __init__(self) -> None:
        port = free_port()
        super().__init__([sys.executable, "-W", "ignore", "-c", AMQTT, str(port)], port)


def any_broker(path: str, folder: Path) -> BrokerProcess:
    """mosquitto if it is there, else amqtt. Raises LookupError, with the remedy, where there is neither."""
    program = find_mosquitto(path)
    if program is not None:
        return Mosquitto(program, folder)
    if find_spec("amqtt") is not None:
        return Amqtt()
    raise LookupError("no MQTT broker: sudo apt install mosquitto, or pip install 'plugd[demo]'")


def running_broker(folder: Path, left: ExitStack) -> BrokerProcess:
    """One that runs until `left` is unwound. Raises PlugdError, in its words or with the remedy."""
    try:
        broker = any_broker(os.environ.get("PATH", ""), folder)
        left.callback(broker.stop)
        broker.start()
    except (LookupError, RuntimeError) as error:
        raise PlugdError(str(error).strip()) from error
    return broker
