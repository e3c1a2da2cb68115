"""The daemon: builds the adapters from the configuration and steps the cycle until told to stop."""

import logging
import os
import random
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import timedelta
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from plugd import __version__, perception, safe_mode
from plugd.adapters.allocator import Allocator
from plugd.adapters.house_mark import house_mark
from plugd.adapters.hub import MqttHub, Topics
from plugd.adapters.kept_twice import KeptTwice
from plugd.adapters.mqtt import Broker, MqttConnection
from plugd.adapters.neso import Neso, Wait, to_the_end
from plugd.adapters.openevse import OpenEvse, whole_amps
from plugd.adapters.plain import PRESETS, Plain
from plugd.adapters.planner_child import PlannerChild
from plugd.adapters.shelly2 import Shelly2
from plugd.adapters.starts import Starts
from plugd.adapters.store import SqliteStore
from plugd.adapters.supply import Supply
from plugd.adapters.switched import SwitchedPlug
from plugd.adapters.systemd import Supervisor
from plugd.adapters.tasmota import Tasmota
from plugd.book import Book
from plugd.config import household
from plugd.config.reading import MODULATING
from plugd.controller import Controller
from plugd.cycle import Cycle
from plugd.domain import Capability, Decision, Fault, Forecast, Memory
from plugd.errors import ConfigError, StoreError
from plugd.journal import Journal
from plugd.outlook import Learned
from plugd.page import opened_page
from plugd.past import CatchUp
from plugd.planner.problem import Solver
from plugd.ports import Clock, Inbox, Plug, Tended
from plugd.scoring import Scoring
from plugd.units import kw_of

if TYPE_CHECKING:
    from plugd.config import Config

BROKER_PATIENCE_S = 10.0
"""How long a start waits for the broker before it goes on without."""

PATIENCE_S = 1.5
"""How long the loop waits for an answer of the source before it goes on and comes back for it."""
CAN_PLAN_S = 1.5
"""How long a plan may take the planner's process where a charger on CAN stops that hears nothing for 5 s."""

log = logging.getLogger("plugd")


def connect(config: "Config", client: str = "") -> MqttConnection:
    """The one MQTT connection, not yet begun. The daemon's has a last will; give another `client` a name."""
    broker = config.broker
    return MqttConnection(
        Broker(
            host=broker.host,
            port=broker.port,
            username=broker.username,
            password_file=broker.password_file,
            tls=broker.tls,
            ca_file=broker.ca_file,
        ),
        name=client or f"plugd-{config.name}",
        will=None if client else (f"{base_topic(config)}/availability", b"offline"),
    )


def base_topic(config: "Config") -> str:
    """Where this plugd's topics begin."""
    return f"{config.broker.topic}/{config.name}"


def capability_of(config: "Config") -> Capability:
    """What the configured plug can be told, without asking it."""
    plug, can = config.plug, config.can
    if plug.kind not in MODULATING:
        fixed_timer_s = float(plug.dead_man_s) if plug.kind == "tasmota" else None
        return Capability(plug.power_kw, dead_man=plug.kind not in PRESETS, fixed_timer_s=fixed_timer_s)
    most_kw = min(plug.power_kw, kw_of(plug.max_current_a, plug.mains_voltage_v))
    if plug.kind == "can_elcon" and can.max_voltage_v is not None and can.max_current_a is not None:
        most_kw = min(most_kw, kw_of(can.max_current_a, can.max_voltage_v) / config.car.efficiency)
    least_kw = min(most_kw, kw_of(plug.min_current_a, plug.mains_voltage_v))
    capability = Capability(most_kw, modulating=True, power_min_kw=least_kw)
    return whole_amps(capability, plug.mains_voltage_v) if plug.kind == "openevse" else capability


def plug_for(config: "Config", connection: MqttConnection, clock: Clock) -> Plug:
    """The plug of the configured kind. Raises ConfigError for one whose libraries are not installed."""
    plug = config.plug
    topic = plug.topic or ""
    match plug.kind:
        case "tasmota":
            return Tasmota(connection, clock, topic, plug.power_kw, plug.dead_man_s)
        case "shelly2":
            dialect = Shelly2(topic, reply_topic=f"{base_topic(config)}/{connection.name}")
            return SwitchedPlug(connection, clock, topic, dialect, plug.power_kw, plug.dead_man_s)
        case "openevse":
            return OpenEvse(connection, clock, topic, capability_of(config), plug.mains_voltage_v)
        case "can_elcon":
            return _can_charger(config, clock=clock)
        case kind:
            words = replace(PRESETS[kind], **{name: word for name, word in vars(plug.mqtt).items() if word is not None})
            return SwitchedPlug(connection, clock, topic, Plain(topic, words), plug.power_kw)


def _can_charger(config: "Config", clock: Clock) -> Plug:
    """The charger on CAN. Raises ConfigError without its libraries, its battery's limits, or a DBC that was named."""
    if missing := [name for name in ("can", "cantools", "msgpack", "serial") if find_spec(name) is None]:
        remedy = "pip install 'plugd[can]', or all of requirements.lock"
        raise ConfigError(f'plug.kind = "can_elcon": needs {" and ".join(missing)}; {remedy}')
    from plugd.adapters.can_charger import charger  # only where it is wanted: others need not have its libraries

    return charger(config, capability_of(config), clock=clock)


def source_for(config: "Config", wait: Wait = to_the_end) -> Neso:
    """The source for the configured place; `wait` is how long its answers are waited for."""
    home = config.home
    return Neso(config.forecast.base_url, home.region_id, home.postcode, wait=wait)


def patience(clock: Clock) -> Wait:
    """Waits no longer than the loop may be held up."""

    def wait(answer: Inbox) -> None:
        until_s = clock.monotonic() + PATIENCE_S
        while not answer.pending() and (left_s := until_s - clock.monotonic()) > 0.0:
            clock.wait(clock.now() + timedelta(seconds=left_s), answer)

    return wait


def solver_for(config: "Config") -> Solver:
    """OSQP, in a process of its own unless the configuration wants it here."""
    if config.planner.child:
        return PlannerChild(CAN_PLAN_S) if config.plug.kind == "can_elcon" else PlannerChild()
    from plugd.planner.qp import Qp  # only where it is wanted: it is half of the daemon's memory

    return Qp()


def hub_for(config: "Config", connection: MqttConnection, plug: Plug) -> MqttHub:
    """The hub's end of the connection."""
    topics = Topics(
        base=base_topic(config),
        soc_topic=config.car.soc_topic,
        soc_json_key=config.car.soc_json_key,
        soc_fraction=config.car.soc_unit == "fraction",
        discovery_prefix=config.broker.discovery_prefix,
    )
    return MqttHub(connection, topics, household(config, plug.capability))


def cycle_for(
    config: "Config", clock: Clock, connection: MqttConnection, store: SqliteStore, *, safe: bool = False
) -> Cycle:
    """The cycle with its ports, and the memory of the last run, or in safe mode what may be taken over of it."""
    plug = plug_for(config, connection, clock)
    kept, losses = _remembered(store)
    remembered = kept or perception.fresh(clock.now())
    home = household(config, plug.capability)
    seed = house_mark(state_folder(config))
    source = source_for(config, patience(clock=clock))
    spread = random.Random(seed).random
    return Cycle(
        clock=clock,
        source=source,
        plug=plug,
        hub=hub_for(config, connection, plug),
        store=store,
        controller=Controller(home, solver_for(config), seed, safe=safe),
        learned=Learned(),
        memory=safe_mode.begun(clock.now(), remembered) if safe else remembered,
        spread=spread,
        forecast=kept_forecast(store, config),
        book=Book(store, home),
        errands=(CatchUp(source, store, spread), Scoring(store)),
        losses=losses,
    )


def state_folder(config: "Config") -> Path:
    """Where the daemon keeps its state: systemd's folder for it, else the configured one."""
    return Path(os.environ.get("STATE_DIRECTORY") or config.state.dir)


def _remembered(store: SqliteStore) -> tuple[Memory | None, tuple[Fault, ...]]:
    """The last run's memory, and what is to be said of a store that was damaged; it is done without what is lost."""
    try:
        memory = store.load()
    except StoreError as error:
        return None, _lost(*store.notices, str(error))
    if isinstance(store, KeptTwice) and store.fell_back:
        return memory, _lost(*store.notices, "what was set is taken from the copy beside the store")
    return memory, _lost(*store.notices)


def _lost(*notices: str) -> tuple[Fault, ...]:
    return (Fault("history", "; ".join(notices)),) if notices else ()


def kept_forecast(store: SqliteStore, config: "Config") -> Forecast | None:
    """The last one kept, if it can be read and is for the configured place."""
    try:
        forecast = store.latest_forecast()
    except StoreError as error:
        log.warning("%s", error)
        return None
    return forecast if forecast is not None and forecast.region == source_for(config).region else None


class Stop:
    """Whether a signal has asked the daemon to end."""

    def __init__(self) -> None:
        self.asked = False


@contextmanager
def _signals(stop: Stop, connection: MqttConnection) -> Iterator[None]:
    """SIGTERM and SIGINT end the loop at its next turn, at once where it waits."""

    def handle(signum: int, frame: FrameType | None) -> None:
        stop.asked = True
        connection.wake()

    before = {s: signal.signal(s, handle) for s in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler)


def _told(config: "Config") -> str:
    """What it runs for, on one line."""
    plug, broker, home = config.plug, config.broker, config.home
    where = config.can.channel if plug.kind == "can_elcon" else plug.topic
    place = home.postcode or (f"region {home.region_id}" if home.region_id else "Great Britain")
    at_broker = f"broker {broker.host}:{broker.port}"
    return f"{config.name}, {plug.kind} at {where}, {at_broker}, forecast of {place}, state in {state_folder(config)}"


def ailment(decision: Decision | None, connection: MqttConnection) -> str | None:
    """Why the loop that has just gone round is not to be trusted, though it did. None where it is."""
    if decision is None:
        return "nothing could be decided"
    return None if connection.alive else "the thread of the broker's connection has ended"


def run(config: "Config", clock: Clock, unset: Callable[[], bool] = lambda: False) -> None:
    """Run until a signal. Raises ConfigError, AlreadyRunning, StoreError before anything is switched.

    `unset`: whether nobody has told this machine the time since it was switched on.
    """
    stop, allocator = Stop(), Allocator()
    with ExitStack() as left:
        store = KeptTwice(state_folder(config))
        starts = Starts(state_folder(config))
        safe = starts.begun(clock.now())
        left.callback(store.close)
        connection = connect(config)
        left.callback(connection.close)
        left.enter_context(_signals(stop, connection))
        cycle = cycle_for(config, clock, connection, store, safe=safe)
        cycle.unset, cycle.ails = unset, Supply().faults
        log.info("plugd %s runs: %s", __version__, _told(config))
        connection.start()
        connection.wait_connected(BROKER_PATIENCE_S)
        hub, solver = cycle.hub, cycle.controller.solver
        if isinstance(solver, PlannerChild):
            left.callback(solver.close)
        inbox = left.enter_context(opened_page(config, state_folder(config), cycle, connection))
        journal, supervisor = Journal(), Supervisor(os.environ.get("NOTIFY_SOCKET", ""))
        while not stop.asked:
            due = cycle.step()
            journal.note(cycle.shown)
            supervisor.beat(ailment(cycle.decision, connection), cycle.shown.reason if cycle.shown else "")
            allocator.tidy(clock.monotonic())
            cycle.rest(due, inbox, lambda: stop.asked)
        starts.ended()
        supervisor.stopping()
        if isinstance(hub, MqttHub):
            hub.close()
            connection.flush()
        if isinstance(cycle.plug, Tended):
            cycle.plug.close()
            log.info("plugd ends; the charger is stopped, and stays so until plugd runs again")
        else:
            cover = "comes on by its own timer" if cycle.plug.capability.dead_man else "stays off"
            log.info("plugd ends; a plug that is off %s", cover)
