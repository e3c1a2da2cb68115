"""Every row of the failure table that can be said at the ports, and nights that fall on a change of the clocks."""

import math
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta

from plugd.adapters.plug_memory import PlugMemory
from plugd.domain import Capability, SetSoc
from plugd.errors import ForecastMalformed, SolveError, StoreError
from plugd.planner.condensed import Condensed, Shape
from plugd.planner.exact import Exact
from plugd.planner.problem import Problem, Solution, Solver
from plugd.planner.qp import Attempt, Pass, Qp
from tests.chaos.night import Night, Trouble
from tests.chaos.ports import down

HALF_HOUR_S = 1860.0
NIGHT_S = 14 * 3600.0


def _source(**how: object) -> tuple[Callable[[Night], None], Callable[[Night], None]]:
    """The forecast goes wrong, and is right again."""
    right = {"error": None, "slots": 96, "shift": 0, "times": 1.0}

    def begin(night: Night) -> None:
        for name, value in how.items():
            setattr(night.source, name, value)

    def end(night: Night) -> None:
        for name in how:
            setattr(night.source, name, right[name])

    return begin, end


def _device(**how: object) -> tuple[Callable[[Night], None], Callable[[Night], None]]:
    """The plug goes wrong, and is right again."""
    right = {"silent": False, "deaf": False, "jammed": False, "says_on": None, "says_kw": None, "says_kwh": None}

    def begin(night: Night) -> None:
        for name, value in how.items():
            setattr(night.device, name, value)
        if night.device.silent or night.device.deaf:
            night.lose()

    def end(night: Night) -> None:
        for name in how:
            setattr(night.device, name, right[name])
        night.found()

    return begin, end


def _broker_away(night: Night) -> None:
    night.plug.broker = False
    night.lose()


def _broker_back(night: Night) -> None:
    night.plug.reconnected()
    night.found()


def _flaps(night: Night) -> None:
    for k in range(10):
        night.later(2.0 * k, lambda: _broker_away(night))
        night.later(2.0 * k + 1.0, lambda: _broker_back(night))


def _jam_when(on: bool) -> Callable[[Night], None]:
    """The relay sticks as soon as it is so."""
    return lambda night: _once(night, on, lambda: setattr(night.device, "jammed", True))


def _once(night: Night, on: bool, act: Callable[[], None]) -> None:
    """Do it as soon as the relay is so, and not after the trouble is over."""
    night.waits = True

    def look() -> None:
        if not night.waits:
            return
        if night.device.on is on:
            act()
        else:
            night.later(5.0, look)

    look()


def _unjam(night: Night) -> None:
    night.waits = False
    night.device.jammed = False


def _lie_on(night: Night) -> None:
    def lie() -> None:
        night.device.jammed, night.device.says_on = True, True

    _once(night, False, lie)


def _truth(night: Night) -> None:
    night.waits = False
    night.device.jammed, night.device.says_on = False, None


def _meter_reset(night: Night) -> None:
    before = night.device.total_kwh
    night.device.says_kwh = lambda total: total - before


def _freeze(night: Night) -> None:
    at = night.device.total_kwh
    night.device.says_kwh = lambda _: at


def _thaw(night: Night) -> None:
    night.device.says_kwh = None


def _power_cut(night: Night) -> None:
    night.device.cut()
    night.lose()


def _power_back(night: Night) -> None:
    night.device.power_up()
    night.found()


def _press(on: bool) -> Callable[[Night], None]:
    def begin(night: Night) -> None:
        if not on and not night.device.on:  # there is nothing to press off yet
            if night.clock.at < night.end - timedelta(minutes=6):
                night.later(5.0, lambda: begin(night))
            return
        night.person_off = night.person_off or not on
        night.device.switch(on)
        night.device.timer = None

    return begin


def _fight(night: Night) -> None:
    """Another controller toggles once a minute for ten minutes."""
    for k in range(10):
        night.later(float(k), lambda: night.device.switch(not night.device.on))


def _untold_soc(night: Night) -> None:
    night.tells_soc = False


def _stale_soc(night: Night) -> None:
    """The car repeats what it said when it came, for hours."""
    said = night.car.battery.soc
    for k in range(40):
        night.later(10.0 * k, lambda: night.say(SetSoc(said, source="car")))


def _glitch(night: Night) -> None:
    """One word that cannot be."""
    night.say(SetSoc(0.95, source="car"))


def _fraction(night: Night) -> None:
    """A percent that is a fraction: 0.6 % where 60 % was meant."""
    for k in range(10):
        night.later(10.0 * k, lambda: night.say(SetSoc(night.car.battery.soc / 100.0, source="car")))


def _unplugged(night: Night) -> None:
    night.car.leave()


def _plugged(night: Night) -> None:
    night.car.arrive()


def _late(night: Night) -> None:
    night.arrival = night.clock.start + timedelta(hours=night.dice.uniform(6.5, 14.0))


def _slow(night: Night) -> None:
    """It has always charged slower than the plug could, and was seen to."""
    night.car.most_kw = night.dice.uniform(1.2, 2.1)
    if night.cycle is not None:
        night.cycle.memory = replace(night.cycle.memory, observed_kw=night.car.most_kw)


class _Broken:
    """A workspace that answers as OSQP was seen to."""

    def __init__(self, status: int, value: float) -> None:
        self.status, self.value = status, value

    def __call__(self, shape: Shape, settings: Pass) -> "_Broken":
        return self

    def solve(self, form: Condensed) -> Attempt:
        """What it was made to."""
        return Attempt(self.status, 1500, (self.value,) * len(form.cost))


class _Fallen:
    """A workspace whose C code fails."""

    def __init__(self, shape: Shape, settings: Pass) -> None: ...

    def solve(self, form: Condensed) -> Attempt:
        """Never."""
        raise RuntimeError("segments")


def _without_timer(night: Night) -> None:
    """A plug that does not come on by itself: nothing but the guard is left."""
    night.home = replace(night.home, capability=Capability(2.3))
    night.plug.capability, night.plug.memory = night.home.capability, PlugMemory(None)
    if night.cycle is not None:
        night.cycle.controller.household = night.home


class _Lazy:
    """A planner that would rather wait, whatever is needed: the guard stands behind it."""

    def solve(self, problem: Problem) -> Solution:
        """Nothing, ever."""
        found = Exact().solve(problem)
        return replace(found, power_kw=tuple((0.0,) * len(powers) for powers in found.power_kw))


class _Raises:
    """A solver that fails altogether."""

    def solve(self, problem: Problem) -> Solution:
        """Never."""
        raise SolveError("the solver fell over")


def _solver(solver: Callable[[], Solver]) -> tuple[Callable[[Night], None], Callable[[Night], None]]:
    def begin(night: Night) -> None:
        night.solver = solver()
        if night.cycle is not None:
            night.cycle.controller.solver = night.solver

    def end(night: Night) -> None:
        night.solver = Exact()
        if night.cycle is not None:
            night.cycle.controller.solver = night.solver

    return begin, end


def _store_fails(which: Callable[[int], bool]) -> tuple[Callable[[Night], None], Callable[[Night], None]]:
    def begin(night: Night) -> None:
        first = night.store.writes
        night.store.fails = lambda n: which(n - first)

    def end(night: Night) -> None:
        night.store.fails = lambda _: False

    return begin, end


def _kill(night: Night) -> None:
    night.kill()
    night.lose()


def _restart(night: Night) -> None:
    if night.cycle is not None:
        return
    try:
        memory = night.store.load()
    except StoreError:
        memory = None
    night.begin(memory)
    night.found()


def _lose_store(night: Night) -> None:
    night.store.lost = True
    _kill(night)


def _step_clock(off: timedelta) -> Callable[[Night], None]:
    def begin(night: Night) -> None:
        night.clock.off = off

    return begin


def _right_clock(night: Night) -> None:
    night.clock.off = timedelta(0)


def _boot_1970(night: Night) -> None:
    """Killed, and started without a clock."""
    _kill(night)
    night.clock.off = timedelta(days=-53 * 365)
    night.later(0.5, lambda: _restart(night))


_nothing_begins: Callable[[Night], None] = lambda night: None  # noqa: E731
YEARS = timedelta(days=3652)
SOON = (1.0, 20.0)
HOURS = (5.0, 240.0)


def _row(name: str, row: str, pair: tuple[Callable[[Night], None], Callable[[Night], None]], **more: object) -> Trouble:
    return Trouble(name, row, pair[0], pair[1], **more)  # type: ignore[arg-type]


TROUBLES: tuple[Trouble, ...] = (
    _row("forecast down", "Forecast API down", _source(error=down()), says="forecast", within_s=HALF_HOUR_S),
    _row("forecast null", "null, NaN", _source(error=ForecastMalformed("null")), says="forecast", within_s=HALF_HOUR_S),
    _row("forecast short", "200 with short list", _source(slots=8)),
    _row("forecast empty", "200 with {}", _source(slots=0)),
    _row("forecast shifted", "Time-shifted", _source(shift=6)),
    _row("forecast past", "Time-shifted, past", _source(shift=-48)),
    _row("forecast ten times", "1e9", _source(times=10.0)),
    _row("broker away", "MQTT broker down", (_broker_away, _broker_back), says="plug_silent", within_s=130.0),
    Trouble("broker flaps", "MQTT broker flapping", _flaps),
    _row("plug silent", "Plug unresponsive", _device(silent=True), says="plug_silent", within_s=130.0),
    _row("plug deaf", "Plug unresponsive", _device(deaf=True), says="plug_refuses", within_s=NIGHT_S),
    _row("stuck off", "Stuck OFF", (_jam_when(False), _unjam), says="plug_refuses", within_s=NIGHT_S, lasts_min=HOURS),
    _row("welded", "Stuck ON / welded", (_jam_when(True), _unjam), says="plug_refuses", within_s=NIGHT_S),
    _row("lies on", "Says ON, is OFF", (_lie_on, _truth), says="no_current", within_s=NIGHT_S, lasts_min=HOURS),
    _row("power nonsense", "Nonsense power", _device(says_kw=1e6)),
    _row("power negative", "Nonsense power", _device(says_kw=-1.0)),
    _row("total absurd", "Nonsense power", _device(says_kwh=lambda _: 1e9), says="meter", within_s=NIGHT_S),
    _row("total large", "Nonsense power", _device(says_kwh=lambda _: 9e6), says="meter", within_s=NIGHT_S),
    _row("total frozen", "Nonsense power, frozen", (_freeze, _thaw), says="meter", within_s=NIGHT_S),
    _row("meter reset", "Meter total reset", (_meter_reset, _thaw)),
    _row("power cut", "Plug power-cut", (_power_cut, _power_back), lasts_min=(0.1, 120.0), says="plug_silent"),
    Trouble("button off", "Button pressed", _press(on=False), says="you switched it off", at_h=13.5, within_s=NIGHT_S),
    Trouble("button on", "Button pressed", _press(on=True), says="you switched it on"),
    Trouble("two controllers", "Two controllers", _fight, says="fought_over", within_s=600.0),
    Trouble("soc missing", "SOC missing", _nothing_begins, before=_untold_soc),
    Trouble("soc stale", "SOC stale", _stale_soc),
    Trouble("soc glitch", "SOC wrong", _glitch),
    Trouble("soc fraction", "SOC percent vs 0-1", _fraction),
    _row("unplugged", "Unplugged mid-slot", (_unplugged, _plugged), lasts_min=(10.0, 90.0), span_h=(7.0, 14.0)),
    Trouble("late", "Plugged in late", _nothing_begins, before=_late),
    Trouble("slow", "Charges slower", _nothing_begins, before=_slow),
    _row("solver nan", "Solver NaN", _solver(lambda: Qp(_Broken(1, math.nan))), says="solver", within_s=HALF_HOUR_S),
    _row("solver wild", "Solver infeasible", _solver(lambda: Qp(_Broken(1, 2143289344.0))), says="solver",
         within_s=HALF_HOUR_S),
    _row("solver unsolved", "Solver max_iter", _solver(lambda: Qp(_Broken(7, 0.5))), says="solver",
         within_s=HALF_HOUR_S),
    _row("solver falls over", "Solver crashes", _solver(lambda: Qp(_Fallen)), says="solver", within_s=HALF_HOUR_S),
    _row("planner waits", "Guard: ON whatever the planner says", _solver(_Lazy), before=_without_timer,
         lasts_min=(1200.0, 1200.0), span_h=(0.0, 2.0)),
    _row("solver raises", "Solver crashes", _solver(_Raises), says="solver", within_s=HALF_HOUR_S),
    _row("store fails", "Disk full, read-only", _store_fails(lambda _: True), says="store", within_s=HALF_HOUR_S),
    _row("store fails at times", "Disk I/O error", _store_fails(lambda n: n % 3 == 0)),
    _row("store lost", "DB corrupt", (_lose_store, _restart), lasts_min=SOON),
    _row("killed", "Process kill -9", (_kill, _restart), lasts_min=(0.1, 5.0)),
    _row("dead for long", "Process kill -9", (_kill, _restart), lasts_min=(60.0, 600.0)),
    _row("boot in 1970", "Clock not synced at boot", (_boot_1970, _right_clock), lasts_min=HOURS, says="clock",
         within_s=150.0),
    _row("clock an hour on", "Clock steps", (_step_clock(timedelta(hours=1)), _right_clock), lasts_min=SOON),
    _row("clock an hour back", "Clock steps", (_step_clock(timedelta(hours=-1)), _right_clock), lasts_min=SOON),
    _row("clock ten years on", "Clock steps", (_step_clock(YEARS), _right_clock), lasts_min=HOURS),
    _row("clock ten years back", "Clock steps", (_step_clock(-YEARS), _right_clock), lasts_min=HOURS, says="clock"),
)  # fmt: skip
