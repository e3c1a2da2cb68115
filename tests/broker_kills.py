"""The broker killed two hundred times: plugd's connection comes back each time, hears commands once, and does not grow.

python -m tests.broker_kills
"""

import argparse
import logging
import os
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path

from plugd.adapters.mqtt import Broker, MqttConnection
from plugd_hil.broker import Mosquitto, find_mosquitto

PATIENCE_S = 10.0
RETRY_S = (0.02, 0.1)
COMMAND = "plugd/ev/mode/set"


def held() -> tuple[int, int]:
    """Descriptors and threads."""
    return len(os.listdir("/proc/self/fd")), threading.active_count()  # noqa: PTH208 - it changes while it is read


def _back(connection: MqttConnection, session: int) -> bool:
    """Whether this is at least so many connections on."""
    return connection.connected and connection.session >= session


def main() -> int:
    """Exit 0: it came back every time."""
    p = argparse.ArgumentParser(prog="python -m tests.broker_kills")
    p.add_argument("--kills", type=int, default=200)
    kills = p.parse_args().kills
    program = find_mosquitto(os.environ.get("PATH", ""))
    if program is None:
        raise SystemExit("mosquitto is missing: sudo apt install mosquitto")
    logging.disable(logging.WARNING)  # a lost connection is what this is about
    objections, began = [], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        broker = Mosquitto(program, Path(folder))
        broker.start()
        address = Broker(broker.host, broker.port)
        plugd, hub = (MqttConnection(address, name, retry_s=RETRY_S) for name in ("plugd", "hub"))
        heard = plugd.subscribe(COMMAND)
        for connection in (plugd, hub):
            connection.start()
            connection.wait_connected(PATIENCE_S)
        first = held()
        for k in range(kills):
            if broker._process is not None:
                broker._process.kill()
            broker.stop()
            broker.start()
            for connection in (plugd, hub):
                connection.bell.hold(partial(_back, connection, k + 2), PATIENCE_S)
            plugd.flush()
            hub.publish(COMMAND, b"%d" % k, qos=1)
            plugd.bell.hold(plugd.pending, PATIENCE_S)
            said = [message.payload for message in heard.take()]
            if said != [b"%d" % k]:
                objections.append(f"after kill {k + 1} it heard {said}")
        last = held()
        for connection in (plugd, hub):
            connection.close()
        broker.stop()
    if last != first:
        objections.append(f"descriptors and threads: {first} -> {last}")
    for objection in objections:
        print(f"FAIL {objection}")
    print(
        f"broker: killed {kills} times in {time.monotonic() - began:.0f} s, commands heard once after "
        f"{kills - len(objections)}; descriptors {first[0]} -> {last[0]}, threads {first[1]} -> {last[1]}"
    )
    return int(bool(objections))


if __name__ == "__main__":
    sys.exit(main())
