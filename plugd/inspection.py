"""What a person asks beside the daemon: does it all work, what would be planned now, switch the plug by hand."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from plugd import daemon, perception
from plugd.adapters.clock import SystemClock, utc_now
from plugd.adapters.mqtt import Mailbox, MqttConnection, Retained
from plugd.adapters.store import SqliteStore
from plugd.config import Config, household
from plugd.controller import Controller
from plugd.domain import Decision, Fault, Forecast, Intensity, Observation, Reading, Relay, Setpoint
from plugd.errors import ForecastError, PlugdError, PlugRefused, PlugTimeout, StoreError, UsageError
from plugd.explanation import Names, dated
from plugd.outlook import Learned, replayed
from plugd.past import HISTORY
from plugd.planner.marginal import Explanation, explain
from plugd.planner.nights import layout
from plugd.planner.problem import Problem, Solution, Solver
from plugd.planner.qp import Qp
from plugd.plausible import believed
from plugd.ports import Clock, Plug, Tended
from plugd.remedies import NO_COVER
from plugd.units import kw_of, slot_start, to_w

SETTLE = timedelta(seconds=6)
"""A plug tells its power 2 to 5 s after it was switched on."""
NO_PLUG = "; is it on, and at this broker, and are plug.kind and plug.topic right?"
LEAST_FREE_MB = 50
"""With less than that a database soon cannot be written."""
OLDEST = datetime(2026, 1, 1, tzinfo=UTC)
"""A clock before it was never set."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of `plugd check`."""

    what: str
    ok: bool
    text: str


@contextmanager
def _connected(config: Config, for_plug: bool = True) -> Iterator[tuple[MqttConnection, Plug, Clock, Mailbox]]:
    """A connection of its own beside the daemon's, the plug over it, and the daemon's availability.

    Raises PlugTimeout without a broker, but for a plug that is not reached through one.
    """
    clock = SystemClock()
    connection = daemon.connect(config, client=f"plugd-{config.name}-{os.getpid()}")
    plug = daemon.plug_for(config, connection, clock)
    others = connection.subscribe((f"{daemon.base_topic(config)}/availability", Retained.REPLAYED))
    connection.start()
    try:
        apart = for_plug and isinstance(plug, Tended)
        if not connection.wait_connected(1.0 if apart else daemon.BROKER_PATIENCE_S) and not apart:
            raise PlugTimeout(f"{connection.refusal or 'no answer'}; is it running, and is [broker] right?")
        connection.flush()
        yield connection, plug, clock, others
    finally:
        if isinstance(plug, Tended):
            plug.close()
        connection.close()
        clock.close()


def _daemon_runs(others: Mailbox) -> bool:
    """Whether a daemon of this name says that it is there."""
    return any(message.payload == b"online" for message in others.take()[-1:])


def _told(reading: Reading) -> str:
    power = "power unknown" if reading.power_kw is None else f"{to_w(reading.power_kw):.0f} W"
    total = "" if reading.energy_kwh is None else f", {reading.energy_kwh:.3f} kWh in total"
    return f"{'on' if reading.on else 'off'}, {power}{total}"


def switch(config: Config, do: str, amps: float | None = None) -> str:
    """Show, switch or set (`amps`) the plug by hand, and say how it is then. Raises PlugError, UsageError."""
    with _connected(config) as (connection, plug, clock, others):
        if do == "show":
            return _told(plug.read())
        running = _daemon_runs(others)
        if isinstance(plug, Tended) and running:
            raise PlugRefused("the running plugd tells the charger what to do every second; stop it first")
        plug.set(
            Relay(do == "on", held=do == "off")
            if amps is None
            else _current(plug, clock, amps, config.plug.mains_voltage_v)
        )
        told = _told(_settled(plug, clock, connection))
        if isinstance(plug, Tended):
            return f"{told}; it is stopped again now: without a word every second it gives nothing"
        if running:
            return f"{told}; the running plugd takes this as a press of the plug's button"
        return f"{told}; it stays so until somebody switches it, or plugd starts"


def _current(plug: Plug, clock: Clock, amps: float, voltage_v: float) -> Setpoint:
    """A charger's setpoint for a day. Raises UsageError for a plain plug."""
    if not plug.capability.modulating:
        raise UsageError("this plug knows on and off only: plugd plug on, or off")
    return Setpoint(kw_of(max(amps, 0.0), voltage_v), clock.now() + timedelta(days=1))


def _settled(plug: Plug, clock: Clock, connection: MqttConnection) -> Reading:
    """A reading that tells the power, which takes a while after switching on; the last one where none comes."""
    until = clock.now() + SETTLE
    reading = plug.read()
    while reading.on and not reading.power_kw and clock.now() < until:
        clock.wait(min(until, plug.due() or until), connection)
        plug.tend(clock.now())
        reading = plug.read()
    return reading


class Witness:
    """A solver that keeps what it was last asked, and what it answered."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self.last: tuple[Problem, Solution] | None = None

    def solve(self, problem: Problem) -> Solution:
        """The plan of the solver behind it."""
        solution = self._solver.solve(problem)
        self.last = problem, solution
        return solution


def explained_now(config: Config) -> tuple[Decision, tuple[Explanation, float, Names] | None]:
    """What would be decided now and why: the explanation, the battery's kWh, and what to call the slots.

    None where no session is coming, and so nothing is planned.
    """
    witness = Witness(Qp())
    decision = decision_now(config, witness)
    if witness.last is None:
        return decision, None
    home = household(config, daemon.capability_of(config))
    problem, solution = witness.last
    # The times are those of any layout of these sessions at this moment, whatever the power.
    parts = layout(decision.sessions, decision.at, problem.energy_kwh, home.capability.power_max_kw, home)
    return decision, (explain(problem, solution), home.car.capacity_kwh, dated(parts, home.timezone))


def decision_now(config: Config, solver: Solver | None = None) -> Decision:
    """What would be decided now, on what the daemon knows. Nothing is switched or saved."""
    now = utc_now()
    home = household(config, daemon.capability_of(config))
    memory = perception.fresh(now)
    forecast: Forecast | None = None
    history: tuple[Intensity, ...] = ()
    learned = Learned()
    folder = readable(daemon.state_folder(config))
    if folder is not None:
        with SqliteStore(folder, hold=False) as store:
            memory = store.load() or memory
            forecast = daemon.kept_forecast(store, config)
            history = store.history(now - HISTORY)
            learned = replayed(store.issued(now - HISTORY), history, now)
    faults: tuple[Fault, ...] = ()
    if forecast is None or slot_start(forecast.issued_at) != slot_start(now):
        try:
            forecast = believed(daemon.source_for(config).fetch(now), history)
        except ForecastError as error:
            faults = (Fault("forecast", f"no new forecast: {error}"),)
    seen = Observation(forecast=forecast, history=history, faults=faults)
    return Controller(home, solver or Qp()).tick(now, seen, memory, learned)


def readable(folder: Path) -> Path | None:
    """The folder, None where there is none yet. Raises StoreError for one that this user may not look into."""
    if not os.access(folder, os.F_OK):
        return None
    if not folder.is_dir():
        raise StoreError(f"{folder}: is no folder; move it away, or set state.dir")
    if not os.access(folder, os.R_OK | os.X_OK):
        raise StoreError(f"{folder}: this user may not look into it; run as plugd's user, or sudo")
    return folder


# -- plugd check ----------------------------------------------------------------------------------


def _forecast(config: Config, click: bool) -> str:
    forecast = daemon.source_for(config).fetch(utc_now())
    dropped = f"; left out: {', '.join(forecast.dropped)}" if forecast.dropped else ""
    until = forecast.expected[-1].start + timedelta(minutes=30)
    return f"{len(forecast.expected)} half hours, to {until:%a %H:%M} UTC{dropped}"


def _broker(config: Config, click: bool) -> str:
    with _connected(config, for_plug=False):
        return f"{config.broker.host}:{config.broker.port} lets us in"


def _plug(config: Config, click: bool) -> str:
    with _connected(config) as (connection, plug, clock, others):
        try:
            told = _told(plug.read())
        except PlugTimeout as error:
            raise PlugTimeout(f"{error}{'' if isinstance(plug, Tended) else NO_PLUG}") from error
        if click:
            told = _clicked(plug, clock, connection, _daemon_runs(others))
        better = "docs/hardware.md names plugs that switch on by themselves"
        cover = "" if plug.capability.dead_man else f"; {NO_COVER}; {better}"
        if isinstance(plug, Tended):
            cover = "; it stops by itself 5 s after plugd's last word, so a dead plugd leaves it OFF"
        return told + cover + "".join(f"; {w.text}" for w in plug.warnings)


def _clicked(plug: Plug, clock: Clock, connection: MqttConnection, daemon_runs: bool) -> str:
    """On, a look at the power, and back to how it was. Raises PlugRefused beside a running daemon."""
    if daemon_runs:
        raise PlugRefused("not clicked: the running plugd would take it for a press of the button; stop it first")
    before = plug.read().on
    plug.set(Relay(True))
    clicked = _settled(plug, clock, connection)
    plug.set(Relay(before))
    car = "" if clicked.power_kw else " (nothing flows: is the car plugged in, and not full?)"
    return f"clicked on: {_told(clicked)}{car}; {'on' if before else 'off'} again"


def _clock(config: Config, click: bool) -> str:
    now = utc_now()
    if now < OLDEST:
        raise PlugdError(f"it says {now:%Y-%m-%d %H:%M} UTC; set it, or let it be set: timedatectl set-ntp true")
    return f"{now:%Y-%m-%d %H:%M} UTC"


def _disk(config: Config, click: bool) -> str:
    folder = daemon.state_folder(config)
    if readable(folder) is not None:
        with SqliteStore(folder, hold=False) as store:
            store.load()
        if not os.access(folder, os.W_OK):
            raise StoreError(f"{folder}: this user may not write there; run as plugd's user, or chown it")
        return f"{folder}, {_free_mb(folder)} MB free"
    parent = next((p for p in folder.parents if p.is_dir()), folder)
    if not os.access(parent, os.W_OK):
        raise PlugdError(f"{folder} is not there and cannot be made; mkdir it for plugd's user, or set state.dir")
    return f"{folder} will be made at the first start, {_free_mb(parent)} MB free"


def _free_mb(folder: Path) -> int:
    """Room beside the state. Raises StoreError where it is too little."""
    free_mb = shutil.disk_usage(folder).free // 2**20
    if free_mb < LEAST_FREE_MB:
        raise StoreError(f"{folder}: only {free_mb} MB free; make room, or nothing can be remembered")
    return free_mb


CHECKS: tuple[tuple[str, Callable[[Config, bool], str]], ...] = (
    ("broker", _broker),
    ("plug", _plug),
    ("forecast", _forecast),
    ("clock", _clock),
    ("disk", _disk),
)

NEEDS = {"plug": "broker"}
"""What cannot be looked at without another."""


def check(config: Config, click: bool = False) -> Iterator[Finding]:
    """One finding after the other; none of them stops the next, but a plug is not looked for without a broker."""
    ok: dict[str, bool] = {}
    for what, look in CHECKS:
        try:
            if not ok.get(NEEDS.get(what, ""), True) and config.plug.kind != "can_elcon":
                raise PlugdError(f"cannot be asked without the {NEEDS[what]}; mend that first")
            text = look(config, click)
        except PlugdError as error:
            text = str(error)
            ok[what] = False
        else:
            ok[what] = True
        yield Finding(what, ok[what], text)
