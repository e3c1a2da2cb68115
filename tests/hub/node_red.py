"""A real Node-RED with the example flow against plugd: `make hub-test NODE_RED=...`. Clicks every inject node."""

import argparse
import json
import shlex
import subprocess
import sys
import tempfile
from contextlib import ExitStack, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

import requests

from plugd.adapters.clock import utc_now
from plugd_hil.broker import HOST, free_port
from tests.hub.hubs import BASE, Failed, House, end_in_order, say, until

FLOW = Path(__file__).resolve().parents[2] / "docs" / "node-red-flow.json"
SETTINGS = """module.exports = {{
  uiHost: "127.0.0.1", uiPort: {port}, credentialSecret: false, flowFile: "flows.json",
  diagnostics: {{enabled: false}}, telemetry: {{enabled: false}},
}};
"""


class NodeRed:
    """The program, with the example flow; its debug nodes speak to its log too."""

    def __init__(self, command: str, folder: Path, broker_port: int) -> None:
        self.port = free_port()
        self.log = folder / "node-red.log"
        flow: list[dict[str, Any]] = json.loads(FLOW.read_text())
        for node in flow:
            if node["type"] == "mqtt-broker":
                node |= {"broker": HOST, "port": str(broker_port)}
            if node["type"] == "debug":
                node["console"] = True
        self.injects = {node["name"]: node["id"] for node in flow if node["type"] == "inject"}
        (folder / "flows.json").write_text(json.dumps(flow))
        (folder / "settings.js").write_text(SETTINGS.format(port=self.port))
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [*shlex.split(command), "-u", str(folder)], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        until(lambda: "Connected to broker" in self.said(), f"Node-RED is at the broker; see {self.log}", 90.0)

    def said(self) -> str:
        """All that it wrote so far."""
        return self.log.read_text(errors="replace")

    def click(self, name: str) -> None:
        """On an inject node's button."""
        answer = requests.post(f"http://{HOST}:{self.port}/inject/{self.injects[name]}", timeout=10)
        if not answer.ok:
            raise Failed(f"{name}: {answer.status_code} {answer.text}")

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(20)
        self.process.kill()


def clicks(red: NodeRed, house: House) -> None:
    """Each button, and what it does. Raises Failed, TimeoutError."""
    day = f"{(utc_now() + timedelta(days=1)).astimezone():%Y-%m-%d}"
    trips = [{"date": day, "minimum_pct": 75.0, "ready_by": "06:30"}]
    for name, told, answer in (
        ("the battery is at 40 %", {"soc_pct": 40.0}, "the battery is at 40 %"),
        ("charge now", {"mode": "now", "decision": "on"}, "mode is now"),
        ("off", {"mode": "off", "decision": "off"}, "mode is off"),
        ("smart", {"mode": "smart"}, "mode is smart"),
        ("trip: tomorrow 75 % by 06:30", {"trips": trips}, f"{day}: at least 75 % by 06:30"),
        ("no trip tomorrow", {"trips": []}, f"{day}: as any other day"),
    ):
        heard = house.ears.count()
        red.click(name)
        house.state(lambda state, t=told: t.items() <= {**state["settings"], **state}.items(), heard)  # type: ignore[misc]
        until(lambda a=answer: a in red.said(), f"Node-RED shows {answer!r}; see {red.log}", 10.0)  # type: ignore[misc]
        say(f"  {name}: done, and answered: {answer}")
    until(lambda: "40 %, " in red.said(), "the sentence is shown", 10.0)
    running = red.said().partition("Started flows")[2]
    if bad := [line for line in running.splitlines() if "[error]" in line or "[warn]" in line]:
        raise Failed("\n".join(bad))


def main() -> int:
    """The program. Returns the exit status."""
    p = argparse.ArgumentParser(prog="tests.hub.node_red", description=__doc__)
    p.add_argument("--node-red", required=True, help="the command that starts Node-RED")
    options = p.parse_args()
    end_in_order()
    with ExitStack() as left:
        folder = Path(left.enter_context(tempfile.TemporaryDirectory()))
        (folder / "red").mkdir()
        house = House(folder, left)
        house.open()
        try:
            red = NodeRed(options.node_red, folder / "red", house.broker.port)
            left.callback(red.close)
            say(f"Node-RED reads {BASE}")
            clicks(red, house)
        except (Failed, TimeoutError) as failure:
            say(f"FAILED: {failure}")
            return 1
    say("all is well")
    return 0


if __name__ == "__main__":
    sys.exit(main())
