"""Programs of ours in processes of their own, and what is heard of them: for tests of the whole."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from plugd.adapters.clock import utc_now
from plugd_hil.broker import BrokerProcess

PATIENCE_S = 30.0
"""For what takes a second on a quiet machine."""
UNDER_WAY = """
[broker]
host = "{host}"
port = {port}
[plug]
topic = "ev-plug"
{plug}
[nights]
plug_in = "{plug_in:%H:%M}"
plug_in_sd_min = 0
plug_out = "{plug_out:%H:%M}"
plug_out_sd_min = 0
[forecast]
base_url = "http://127.0.0.1:{neso}"
[relay]
min_on_min = 0
min_off_min = 0
random_delay_s = 0
[state]
dir = "{folder}/state"
[web]
enabled = false
{more}
"""


def environment(**more: str) -> dict[str, str]:
    """This one's, with the modules that are tested in front, and nothing that configures plugd."""
    mine = {k: v for k, v in os.environ.items() if not k.startswith(("PLUGD_", "PYTEST_")) and k != "STATE_DIRECTORY"}
    path = os.pathsep.join(str(Path(p).resolve()) for p in sys.path if p)
    return {**mine, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1", **more}


class Heard:
    """What was heard so far, in order, and something to wait by."""

    def __init__(self) -> None:
        self.all: list[Any] = []
        self._news = threading.Condition()

    def put(self, one: Any) -> None:
        """One more."""
        with self._news:
            self.all.append(one)
            self._news.notify_all()

    def until(self, wanted: Callable[[Any], bool], within_s: float = PATIENCE_S, after: int = 0) -> Any:
        """The first from number `after` on that is wanted. Raises TimeoutError, with the last ones heard."""

        def found() -> list[Any]:
            return [one for one in self.all[after:] if wanted(one)][:1]

        with self._news:
            if not self._news.wait_for(found, within_s):
                raise TimeoutError(f"not heard in {within_s:g} s; last of {len(self.all)}: {self.all[-3:]}")
            return found()[0]


class Program:
    """`python -m ...`: its stdout as JSON lines or text, its stderr, and its end, which comes with the test's."""

    def __init__(self, *arguments: str, cwd: Path | None = None, **more: str) -> None:
        self.said, self.complained = Heard(), Heard()
        self.process = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(**more),
            cwd=cwd,
        )
        self._readers = [
            threading.Thread(target=_read, args=(stream, heard), daemon=True)
            for stream, heard in ((self.process.stdout, self.said), (self.process.stderr, self.complained))
        ]
        for reader in self._readers:
            reader.start()

    def tell(self, line: str) -> None:
        """A line to its stdin."""
        if self.process.stdin is not None:
            self.process.stdin.write(f"{line}\n")
            self.process.stdin.flush()

    def ends(self, within_s: float = PATIENCE_S) -> int:
        """Wait for its end; returns its exit status. Raises TimeoutExpired."""
        status = self.process.wait(within_s)
        for reader in self._readers:
            reader.join(PATIENCE_S)
        return status

    def kill(self) -> None:
        """Pull the plug on it."""
        self.process.kill()
        self.ends()

    def close(self) -> None:
        """End it if it has not ended."""
        if self.process.poll() is None:
            self.process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(10.0)
            self.process.kill()
        self.ends()
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _read(stream: TextIO | None, heard: Heard) -> None:
    for line in stream or ():
        try:
            heard.put(json.loads(line))
        except ValueError:
            heard.put(line.rstrip("\n"))


def under_way(broker: BrokerProcess, neso: Program, folder: Path, plug: str = "", more: str = "") -> str:
    """plugd's configuration: a session is under way, and the relay may move at any time. `plug`: more of [plug]."""
    now = utc_now()
    return UNDER_WAY.format(
        host=broker.host,
        port=broker.port,
        neso=neso.said.until(lambda line: "port" in line)["port"],
        folder=folder,
        plug=plug,
        plug_in=now - timedelta(hours=3),
        plug_out=now + timedelta(hours=12),
        more=more,
    )


class Listener:
    """Somebody else at the broker, who hears everything under some topics and may command."""

    def __init__(self, host: str, port: int, topics: Iterable[str]) -> None:
        """Returns once the broker has taken the subscription."""
        self.heard = Heard()
        subscribed = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.reconnect_delay_set(1, 1)
        self._client.on_message = self._on_message
        self._client.on_connect = lambda client, *_: client.subscribe([(topic, 1) for topic in topics])
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.connect(host, port)
        self._client.loop_start()
        if not subscribed.wait(PATIENCE_S):
            raise TimeoutError("the broker does not let us listen")

    def _on_message(self, _client: Client, _userdata: Any, message: MQTTMessage) -> None:
        self.heard.put((message.topic, message.payload.decode(), message.retain))

    def count(self) -> int:
        """How many messages were heard so far: what comes later is after this."""
        return len(self.heard.all)

    def send(self, topic: str, payload: str, retain: bool = False) -> None:
        """Publish, and wait until the broker has it."""
        self._client.publish(topic, payload, qos=1, retain=retain).wait_for_publish(PATIENCE_S)

    def until(
        self, topic: str, wanted: Callable[[Any], bool] = lambda _: True, within_s: float = PATIENCE_S, after: int = 0
    ) -> Any:
        """What is said on a topic (JSON, or text where it is none) once it is as wanted."""
        _, payload, _ = self.heard.until(lambda m: m[0] == topic and wanted(_parsed(m[1])), within_s, after)
        return _parsed(payload)

    def close(self) -> None:
        """Leave."""
        self._client.disconnect()
        self._client.loop_stop()


def _parsed(payload: str) -> Any:
    try:
        return json.loads(payload)
    except ValueError:
        return payload
