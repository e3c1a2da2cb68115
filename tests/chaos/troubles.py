"""Every row of the failure table that can be said at the ports, and nights that fall on a change of the clocks."""

import math
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta

from plugd.adapters.plug_memory import PlugMemory
from plugd.domain import Capability, Fault, SetSoc
from plugd.errors import ForecastMalformed, SolveError, StoreError
from plugd.planner.condensed import Condensed, Shape
from plugd.planner.exact import Exact
from plugd.planner.problem import Problem, Solution, Solver
from plugd.planner.qp import Attempt, Pass, Qp
from plugd.units import next_slot
from tests.chaos.night import Night, Trouble
from tests.chaos.ports import down

When = Callable[[Night, datetime], datetime]


def _after(wait_s: float) -> When:
    """So long after it began."""
    return lambda _, start: start + timedelta(seconds=wait_s)


def _next_plan(_: Night, start: datetime) -> datetime:
    """The source is asked, the solver asked, and written, once a half hour."""
    return next_slot(start)


def _struck(night: Night, start: datetime) -> datetime:
    """It waited for the relay to be as it needed it."""
    return night.struck_at or night.end


def _unheeded(night: Night, start: datetime) -> datetime:
    """The first order that was not obeyed."""
    return next((at for at in night.plug.unheeded if at >= start), night.end)


def _told(on: bool, wait_s: float = 0.0) -> When:
    """So long after the first switch-on (or off) that was ordered since."""

    def known(night: Night, start: datetime) -> datetime:
        since = max(start, night.struck_at or start)
        moments = (at for at, wanted in night.plug.told if wanted.on is on and at >= since)
        return next(moments, night.end) + timedelta(seconds=wait_s)

    return known


def _on(wait_s: float) -> When:
    """So long after the relay is on."""

    def known(night: Night, start: datetime) -> datetime:
        before = [on for at, on in night.device.moves if at <= start]
        ons = (at for at, on in night.device.moves if on and at > start)
        return (start if before and before[-1] else next(ons, night.end)) + timedelta(seconds=wait_s)

    return known


def _given(kwh: float, wait_s: float = 0.0) -> When:
    """So long after so much has flowed since."""

    def known(night: Night, start: datetime) -> datetime:
        before = max((total for at, total in night.flowed if at <= start), default=0.0)
        flowed = (at for at, total in night.flowed if at > start and total - before >= kwh)
        return next(flowed, night.end) + timedelta(seconds=wait_s)

    return known


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
            night.struck_at = night.clock.at
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


def _says_on_still(night: Night) -> None:
    """Its word stands still: told off it is off, and says on."""
    _once(night, True, lambda: setattr(night.device, "says_on", True))


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
        night.struck_at = night.clock.at
        night.person_off = night.person_off or not on
        night.device.switch(on)
        night.device.timer = None

    return begin


def _fight(night: Night) -> None:
    """Another controller toggles once a minute for ten minutes."""
    for k in range(10):
        night.later(float(k), lambda: night.device.switch(not night.device.on))


def _untold_soc(night: Night) -> None:
    """A car that told of itself until yesterday."""
    night.tells_soc = False
    cycle = night.cycle
    if cycle is not None:
        cycle.memory = replace(
            cycle.memory, soc=replace(cycle.memory.soc, source="car", car_said=cycle.memory.soc.mean)
        )


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


def _much_too_late(night: Night) -> None:
    night.arrival = night.clock.start + timedelta(hours=13)


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


def _lost_store_found(night: Night) -> None:
    _restart(night)
    if night.cycle is not None:
        night.cycle.losses = (Fault("history", "the store was damaged, so a new one is begun"),)


def _house_dark(night: Night) -> None:
    """Mains, machine and network are gone; its clock has no battery."""
    stood = night.clock.at

    def back() -> None:
        night.clock.off, night.untold = stood - night.clock.at, True
        night.source.error = down()
        night.struck_at = night.clock.at
        _power_back(night)
        _restart(night)
        night.later(night.dice.choice((night.dice.uniform(1.0, 10.0), 900.0)), lambda: _house_lit(night))

    _kill(night)
    _power_cut(night)
    night.later(night.dice.uniform(5.0, 300.0), back)


def _house_lit(night: Night) -> None:
    """The network is back some minutes later, or only after the morning, and with it the time."""
    night.source.error, night.untold = None, False
    _right_clock(night)


_nothing_begins: Callable[[Night], None] = lambda night: None  # noqa: E731
YEARS = timedelta(days=3652)
SOON = (1.0, 20.0)
OWN_TIME = "each of its half hours counts for its own time, and what it leaves out is the usual day"
NOBODY = "nobody is there to say it but the last will; afterwards `running_since` tells when it began anew"
SET = "somebody has set the clock: all is planned anew, and nobody has anything to do"
HOURS = (5.0, 240.0)


def _row(name: str, row: str, pair: tuple[Callable[[Night], None], Callable[[Night], None]], **more: object) -> Trouble:
    return Trouble(name, row, pair[0], pair[1], **more)  # type: ignore[arg-type]


TROUBLES: tuple[Trouble, ...] = (
    _row("forecast down", "Forecast API down", _source(error=down()), says="forecast", known=_next_plan),
    _row("forecast null", "null, NaN", _source(error=ForecastMalformed("null")), says="forecast", known=_next_plan),
    _row("forecast short", "200 with short list", _source(slots=8), says="The forecast ends at", known=_next_plan),
    _row("forecast empty", "200 with {}", _source(slots=0), says="There is no forecast", known=_next_plan),
    _row("forecast shifted", "Time-shifted", _source(shift=6), silent=OWN_TIME),
    _row("forecast past", "Time-shifted, past", _source(shift=-48), silent=OWN_TIME),
    _row("forecast ten times", "1e9", _source(times=10.0), says="forecast", known=_next_plan),
    _row("broker away", "MQTT broker down", (_broker_away, _broker_back), says="plug_silent", known=_after(60.0)),
    Trouble("broker flaps", "MQTT broker flapping", _flaps,
            silent="it is back before a reading is a minute old, and orders are told again"),
    _row("plug silent", "Plug unresponsive", _device(silent=True), says="plug_silent", known=_after(60.0)),
    _row("plug deaf", "Plug unresponsive", _device(deaf=True), says="plug_refuses", known=_unheeded),
    _row("stuck off", "Stuck OFF", (_jam_when(False), _unjam), says="plug_refuses", known=_unheeded, lasts_min=HOURS),
    _row("welded", "Stuck ON / welded", (_jam_when(True), _unjam), says="plug_refuses", known=_unheeded),
    _row("lies on", "Says ON, is OFF", (_lie_on, _truth), says="no_current", known=_told(True, 120.0), lasts_min=HOURS),
    _row("says on still", "Says ON, is OFF", (_says_on_still, _truth), says="plug_refuses", known=_told(False)),
    _row("power nonsense", "Nonsense power", _device(says_kw=1e6), says="meter"),
    _row("power negative", "Nonsense power", _device(says_kw=-1.0), says="meter"),
    _row("total absurd", "Nonsense power", _device(says_kwh=lambda _: 1e9), says="meter", known=_given(0.3)),
    _row("total large", "Nonsense power", _device(says_kwh=lambda _: 9e6), says="meter", known=_given(0.3)),
    _row("total frozen", "Nonsense power, frozen", (_freeze, _thaw), says="meter", known=_given(0.3)),
    _row("meter reset", "Meter total reset", (_meter_reset, _thaw),
         silent="it is counted on from zero, and nothing is lost"),
    _row("power cut", "Plug power-cut", (_power_cut, _power_back), lasts_min=(0.1, 120.0), says="plug_silent",
         known=_after(60.0)),
    Trouble("button off", "Button pressed", _press(on=False), says="you switched it off", at_h=13.5, known=_struck),
    Trouble("button on", "Button pressed", _press(on=True), says="you switched it on"),
    Trouble("two controllers", "Two controllers", _fight, says="fought_over", known=_after(120.0)),
    Trouble("soc missing", "SOC missing", _nothing_begins, before=_untold_soc, says="soc_stale", at_h=3.0,
            known=_after(1800.0)),
    Trouble("soc stale", "SOC stale", _stale_soc, says="soc_stale", known=_given(0.04 * 50.0 / 0.9, 1800.0)),
    Trouble("soc glitch", "SOC wrong", _glitch, silent="one word that is not said again is not believed either"),
    Trouble("soc fraction", "SOC percent vs 0-1", _fraction, says="car_soc"),
    _row("unplugged", "Unplugged mid-slot", (_unplugged, _plugged), lasts_min=(10.0, 90.0), span_h=(7.0, 14.0),
         says="no_current", at_h=13.5, known=_on(120.0)),
    Trouble("late", "Plugged in late", _nothing_begins, before=_late,
            silent="late is not yet too late: see the next one"),
    Trouble("much too late", "Plugged in late: infeasible", _nothing_begins, before=_much_too_late, says="short of",
            at_h=13.0),
    Trouble("slow", "Charges slower", _nothing_begins, before=_slow, says="kW, not 2.3", known=_told(True)),
    _row("solver nan", "Solver NaN", _solver(lambda: Qp(_Broken(1, math.nan))), says="solver", known=_next_plan),
    _row("solver wild", "Solver infeasible", _solver(lambda: Qp(_Broken(1, 2143289344.0))), says="solver",
         known=_next_plan),
    _row("solver unsolved", "Solver max_iter", _solver(lambda: Qp(_Broken(7, 0.5))), says="solver",
         known=_next_plan),
    _row("solver falls over", "Solver crashes", _solver(lambda: Qp(_Fallen)), says="solver", known=_next_plan),
    _row("planner waits", "Guard: ON whatever the planner says", _solver(_Lazy), before=_without_timer,
         lasts_min=(1200.0, 1200.0), span_h=(0.0, 2.0), says="the last safe start", known=_told(True)),
    _row("solver raises", "Solver crashes", _solver(_Raises), says="solver", known=_next_plan),
    _row("store fails", "Disk full, read-only", _store_fails(lambda _: True), says="store", known=_next_plan),
    _row("store fails at times", "Disk I/O error", _store_fails(lambda n: n % 3 == 0), says="store", known=_next_plan),
    _row("store lost", "DB corrupt", (_lose_store, _lost_store_found), lasts_min=SOON, says="history",
         known=_after(60.0 * SOON[1])),
    _row("killed", "Process kill -9", (_kill, _restart), lasts_min=(0.1, 5.0), silent=NOBODY),
    _row("dead for long", "Process kill -9", (_kill, _restart), lasts_min=(60.0, 600.0), silent=NOBODY),
    _row("boot in 1970", "Clock not synced at boot", (_boot_1970, _right_clock), lasts_min=HOURS, says="clock",
         known=_after(30.0)),
    Trouble("clock stood still", "Clock not synced at boot", _house_dark, says="clock", known=_struck),
    _row("clock an hour on", "Clock steps", (_step_clock(timedelta(hours=1)), _right_clock), lasts_min=SOON,
         silent=SET),
    _row("clock an hour back", "Clock steps", (_step_clock(timedelta(hours=-1)), _right_clock), lasts_min=SOON,
         silent=SET),
    _row("clock ten years on", "Clock steps", (_step_clock(YEARS), _right_clock), lasts_min=HOURS, says="forecast"),
    _row("clock ten years back", "Clock steps", (_step_clock(-YEARS), _right_clock), lasts_min=HOURS, says="clock"),
)  # fmt: skip
