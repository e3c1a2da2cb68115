"""A real Home Assistant against plugd: `make hub-test`. Prints what it tries; fails at the first thing amiss.

Everything listens on loopback alone: broker, stub plug, stub forecast server, plugd, and the Home Assistant named
with --hass (a command line; "chroot /somewhere /opt/ha/bin/hass" will do where --folder is seen inside too).
"""

import argparse
import json
import re
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any

from plugd.adapters import homeassistant
from plugd.adapters.clock import utc_now
from plugd.domain import Household
from tests.hub.hubs import BASE, Failed, HomeAssistant, House, end_in_order, say, until

ROOT = Path(__file__).resolve().parents[2]
DASHBOARD = ROOT / "docs" / "home-assistant-dashboard.yaml"
BACK_S = 30.0
EXPECTED: dict[str, dict[str, Any]] = homeassistant.device(BASE, Household())["components"]


class Try:
    """One run, step after step."""

    def __init__(self, house: House, hub: HomeAssistant) -> None:
        self.house = house
        self.hub = hub
        self.ids: dict[str, str] = {}
        """Entity ids by our keys."""

    def everything_is_there(self) -> None:
        """The device, every entity of ours and none besides, and none unavailable."""

        def found() -> dict[str, str]:
            entries = self.hub.ask(type="config/entity_registry/list")
            ours = {e["unique_id"]: e["entity_id"] for e in entries if e["platform"] == "mqtt"}
            ids = {key: ours.get(component["unique_id"], "") for key, component in EXPECTED.items()}
            return ids if all(ids.values()) and len(ours) == len(ids) else {}

        self.ids = until(found, "all entities are registered, and none besides")
        (device,) = [d for d in self.hub.ask(type="config/device_registry/list") if d["manufacturer"] == "plugd"]
        self.all_available("after the start")
        say(f"  {device['name']} {device['sw_version']}: {len(self.ids)} entities, none unavailable")
        for key, entity in self.ids.items():
            name = re.sub(r"[^a-z0-9]+", "_", EXPECTED[key]["name"].lower())
            if entity != f"{EXPECTED[key]['platform']}.plugd_ev_{name}":
                raise Failed(f"{key} is called {entity}")

    def all_available(self, when: str, within_s: float = BACK_S) -> float:
        """Every entity has a state, within this time. Returns how long it took, in seconds."""
        began = time.monotonic()
        until(lambda: not self._unavailable(), f"none is unavailable {when}: {self._unavailable()}", within_s)
        return time.monotonic() - began

    def _unavailable(self) -> list[str]:
        states = self.hub.states()
        return [e for e in self.ids.values() if states.get(e, {"state": "unavailable"})["state"] == "unavailable"]

    def shows(self, key: str, wanted: str) -> Any:
        """The entity once this is its state."""

        def look() -> Any:
            entity = self.hub.states().get(self.ids[key])
            return entity if entity and entity["state"] == wanted else None

        return until(look, f"{self.ids[key]} shows {wanted!r}", 15.0)

    def documents_are_attributes(self) -> None:
        """Plan, outlook and faults."""
        states = self.hub.states()
        for key, name in (("next_start", "plan"), ("intensity", "outlook"), ("trips", "trips")):
            found = states[self.ids[key]]["attributes"].get(name)
            if not isinstance(found, list):
                raise Failed(f"{self.ids[key]} has no {name}")
            size = len(json.dumps(states[self.ids[key]]["attributes"]))
            say(f"  {self.ids[key]}: {name} of {len(found)}, attributes {size} bytes")
        if len(said := states[self.ids["reason"]]["state"]) < 20:
            raise Failed(f"the reason is {said!r}")

    def control(self, service: str, key: str, what: dict[str, Any], shown: str, told: dict[str, Any]) -> None:
        """A service call changes plugd's state, and comes back as the entity's."""
        heard, began = self.house.ears.count(), time.monotonic()
        self.hub.call(service, entity_id=self.ids[key], **what)
        self.house.state(lambda state: told.items() <= {**state, **state["settings"]}.items(), heard)
        took_s = time.monotonic() - began
        self.shows(key, shown)
        say(f"  {service} {self.ids[key]} {what or ''}: plugd knows after {took_s:.2f} s")

    def controls_change_plugd(self) -> None:
        """Each control in turn."""
        clock = f"{utc_now() + timedelta(hours=8):%H:00}"
        for service, key, value, shown, told in (
            ("number.set_value", "minimum", 60, "60.0", {"minimum_pct": 60.0}),
            ("number.set_value", "minimum", 55, "55.0", {"minimum_pct": 55.0}),
            ("number.set_value", "horizon", 2, "2", {"horizon": 2}),
            ("number.set_value", "battery_now", 71, "71.0", {"soc_pct": 71.0, "soc_source": "hub"}),
            ("text.set_value", "ready_by", clock, clock, {"ready_by": clock}),
            ("text.set_value", "ready_by", "", "", {"ready_by": None}),
            ("switch.turn_off", "connected", None, "off", {"connected": False}),
            ("switch.turn_on", "connected", None, "on", {"connected": True}),
        ):
            self.control(service, key, {} if value is None else {"value": value}, shown, told)
        heard = self.house.ears.count()
        self.hub.call("button.press", entity_id=self.ids["replan"])
        self.house.ears.until(f"{BASE}/result", lambda a: a["command"] == "replan" and a["ok"], 10.0, heard)
        say("  button.press: planned anew")

    def the_mode_moves_the_plug(self) -> None:
        """On and off, within 2 s of the click."""
        for option, on in (("now", True), ("off", False), ("now", True), ("smart", False)):
            seen, began = len(self.house.plug.said.all), time.monotonic()
            self.hub.call("select.select_option", entity_id=self.ids["mode"], option=option)
            self.house.moved(on, seen)
            say(f"  mode {option}: the relay is {'on' if on else 'off'} after {time.monotonic() - began:.2f} s")
            self.shows("mode", option)
        self.shows("charging", "off")

    def a_trip_is_set_and_cleared(self) -> None:
        """By the service that a script or automation uses."""
        day = (utc_now() + timedelta(days=2)).date().isoformat()
        trip = {"date": day, "minimum_pct": 78}
        for sent, count in ((trip, "1"), ({"date": day, "clear": True}, "0"), (trip, "1")):
            self.hub.call("mqtt.publish", topic=f"{BASE}/trip/set", payload=json.dumps(sent), qos="1")
            listed = self.shows("trips", count)["attributes"]["trips"]
            if len(listed) != int(count):
                raise Failed(f"{count} trips, and listed are {listed}")
        self.hub.call("button.press", entity_id=self.ids["clear_trips"])
        self.shows("trips", "0")
        say("  a trip is set, listed and cleared, by its date and by the button")

    def a_fault_is_shown(self) -> None:
        """As the problem's attribute, and gone again."""
        self.house.ears.send("car/soc", "0.64")
        found = self.shows("problem", "on")["attributes"]
        if "looks like a fraction" not in found.get("car_soc", "") or "Set soc_topic" not in found["car_soc"]:
            raise Failed(f"the fault is no attribute: {found}")
        self.house.ears.send("car/soc", "70")
        self.shows("soc_source", "car")
        self.shows("problem", "off")
        say("  a fault shows with its text and what to do, and goes")

    def the_dashboard_loads(self) -> None:
        """Its cards name entities that are there, and its texts can be made."""
        board = self.hub.ask(type="lovelace/config", url_path="plugd-car", force=True)
        states = self.hub.states()
        text = json.dumps(board)
        named = set(re.findall(r"(?:sensor|binary_sensor|number|select|switch|text|button)\.plugd_\w+", text))
        if missing := sorted(named - states.keys() - {"binary_sensor.plugd_ev_problem.attributes"}):
            raise Failed(f"the dashboard names what is not there: {missing}")
        cards = board["views"][0]["cards"]
        day = (utc_now() + timedelta(days=2)).date().isoformat()
        self.hub.call(
            "mqtt.publish", topic=f"{BASE}/trip/set", payload=json.dumps({"date": day, "away": True}), qos="1"
        )
        self.shows("trips", "1")
        texts = [self.hub.render(card["content"]) for card in cards if card["type"] == "markdown"]
        if not any(f"{day}: away" in text for text in texts):
            raise Failed(f"no card lists the trip: {texts}")
        self.hub.call("button.press", entity_id=self.ids["clear_trips"])
        self.shows("trips", "0")
        for card in (c for c in cards if c["type"] == "markdown"):
            shown = self.hub.render(card["content"])
            if "None" in shown or "unknown" in shown:
                raise Failed(f"a card shows {shown!r}")
        say(f"  dashboard: {len(cards)} cards, {len(named)} entities")

    def back(self, what: str, stop: Callable[[], None], start: Callable[[], None], gone: bool) -> None:
        """Something restarts, and all is as before within 30 s."""
        before = {key: self.hub.states()[self.ids[key]]["state"] for key in ("mode", "minimum", "soc")}
        stop()
        if gone:
            until(lambda: len(self._unavailable()) == len(self.ids), f"all is unavailable without {what}", 90.0)
        began = time.monotonic()
        start()
        if not gone:  # how long it takes to start is its own affair
            say(f"  {what} answers {time.monotonic() - began:.1f} s after its start")
            began = time.monotonic()
        self.all_available(f"after {what} restarted")
        for key, was in before.items():
            self.shows(key, was)
        took_s = time.monotonic() - began
        say(f"  {what}: everything back {took_s:.1f} s after that")
        if took_s > BACK_S:
            raise Failed(f"{what}: not back within {BACK_S:g} s")
        for option, on in (("now", True), ("smart", False)):
            seen = len(self.house.plug.said.all)
            self.hub.call("select.select_option", entity_id=self.ids["mode"], option=option)
            self.house.moved(on, seen, 5.0)
            self.shows("mode", option)

    def restarts(self) -> None:
        """Home Assistant, the broker, plugd."""
        self.back("Home Assistant", self.hub.stop, self.hub.start, gone=False)
        self.back("the broker", self.house.broker.stop, self.house.broker.start, gone=True)
        self.back("plugd", self.house.kill_plugd, self.house.begin_plugd, gone=True)

    def nobody_complained(self) -> None:
        """No warning of us in Home Assistant's log; what it says of the broker that was away is its own affair."""
        about_us = [line for line in self.hub.complaints() if "plugd" in line.lower()]
        others = [line for line in self.hub.complaints() if line not in about_us]
        say(f"  log: {len(about_us)} warnings about plugd, {len(others)} about MQTT else")
        for line in others[:5]:
            say(f"    {line}")
        if about_us:
            raise Failed("\n".join(about_us))


def main() -> int:
    """The program. Returns the exit status."""
    p = argparse.ArgumentParser(prog="tests.hub.home_assistant", description=__doc__)
    p.add_argument("--hass", required=True, help="the command that starts Home Assistant")
    p.add_argument("--folder", type=Path, help="where everything is written (a new one)")
    p.add_argument("--keep", action="store_true", help="go on running at the end, until Ctrl-C")
    options = p.parse_args()
    end_in_order()
    with ExitStack() as left:
        folder = options.folder or Path(left.enter_context(tempfile.TemporaryDirectory()))
        (folder / "hass").mkdir(parents=True)
        house = House(folder, left)
        house.open()
        hub = HomeAssistant(options.hass, folder / "hass", house.broker.port)
        hub.seed(DASHBOARD)
        left.callback(hub.stop)
        began = time.monotonic()
        hub.start()
        hub.log_in()
        say(f"Home Assistant {hub.ask(type='get_config')['version']} answers after {time.monotonic() - began:.0f} s")
        run = Try(house, hub)
        try:
            for step in (
                run.everything_is_there,
                run.documents_are_attributes,
                run.controls_change_plugd,
                run.the_mode_moves_the_plug,
                run.a_trip_is_set_and_cleared,
                run.a_fault_is_shown,
                run.the_dashboard_loads,
                run.restarts,
                run.nobody_complained,
            ):
                say(step.__name__.replace("_", " "))
                step()
        except (Failed, TimeoutError) as failure:
            say(f"FAILED: {failure}")
            say(f"plugd said at last: {[m[1] for m in house.ears.heard.all if m[0] == f'{BASE}/state'][-1:]}")
            return 1
        if options.keep and hub.process is not None:
            say(f"running at {hub.url} with user and password `try`; Ctrl-C ends it")
            hub.process.wait()
    say("all is well")
    return 0


if __name__ == "__main__":
    sys.exit(main())
