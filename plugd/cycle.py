"""Fetch, observe, decide, apply, save, publish. Every failed port becomes a None and a fault; nothing else stops."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from functools import partial
from typing import TypeVar

from plugd import commands, safe_mode
from plugd.actuator import Actuator
from plugd.beat import Action
from plugd.beat import Cause as By
from plugd.book import Book
from plugd.controller import Controller
from plugd.domain import (
    Command,
    Decision,
    Fault,
    Forecast,
    Intensity,
    Memory,
    Observation,
    Reading,
    Record,
    Setpoint,
)
from plugd.errors import ForecastError, ForecastLate, StoreError
from plugd.outlook import Learned, replayed
from plugd.past import HISTORY, LATE
from plugd.plausible import believed
from plugd.ports import Clock, Errand, ForecastSource, Hub, Inbox, Plug, Store, Tended
from plugd.register import Register
from plugd.retry import Retry
from plugd.units import in_local_time, next_slot, slot_start
from plugd.wall import Wall, newest, shifted

LOOK_S = 10.0
FETCH_RETRY_S = (60.0, 120.0, 240.0, 480.0, 960.0, 1800.0)
LOSS_TOLD_S = 24 * 3600.0
TIMELESS = ("save", "history")
"""What is asked of the store without a clock too: nothing that is entered under a date."""
Kept = TypeVar("Kept")


@dataclass(slots=True)
class Cycle:
    """One household's loop body. `step` is called whenever something is due or arrived."""

    clock: Clock
    source: ForecastSource
    plug: Plug
    hub: Hub
    store: Store
    controller: Controller
    memory: Memory
    spread: Callable[[], float]
    """A number in 0..1 for pauses between retries."""
    forecast: Forecast | None = None
    learned: Learned | None = None
    """Of the grid and its forecasts, from all that was seen; None where forecasts are taken as they are."""
    book: Book | None = None
    """The ledger, where one is kept."""
    errands: Sequence[Errand] = ()
    """What is done beside all this when there is time."""
    unset: Callable[[], bool] = lambda: False
    """Whether nobody has told this machine the time since it was switched on."""
    ails: Callable[[], tuple[Fault, ...]] = tuple
    """What ails the machine itself."""
    faults: Register = field(default_factory=Register)
    decision: Decision | None = None
    shown: Decision | None = None
    """The decision as it was last published."""
    planned_at: datetime | None = None
    fetch: Retry = field(default_factory=lambda: Retry(FETCH_RETRY_S))
    actuator: Actuator = field(init=False)
    wall: Wall = field(init=False)
    began_s: float = 0.0
    """When it was made, by the monotonic clock."""
    began: datetime | None = None
    """The same by the time that is believed."""
    ahead: timedelta = timedelta(0)
    """How far the clock is ahead of the time that is believed."""
    losses: Sequence[Fault] = ()
    """What of the store was found damaged at the start. It is said for a day."""

    def __post_init__(self) -> None:
        self.actuator = Actuator(self.plug, self.faults)
        self.wall = Wall(known=newest(self.memory))
        self.began_s = self.clock.monotonic()

    def step(self) -> datetime:
        """Look, decide and act once. Returns when to be called again at the latest."""
        now = self._now()
        if self.controller.safe and self.clock.monotonic() - self.began_s >= safe_mode.LASTS_S:
            self.controller.safe, self.planned_at, self.memory = False, None, replace(self.memory, orders=None)
        was_on, cut = self.memory.relay_on, self.memory.flow.cut
        reading = self.actuator.read()
        orders = tuple(order for order in self.hub.commands() if commands.is_news(order, self.memory, now))
        pressed = reading is not None and reading.changed_by_other is not None
        due = self._tick_due(now)
        if due:  # a command or a press does not wait for the network
            self._fetch(now)
        ticks = bool(orders) or pressed or due
        if ticks:
            self._tick(now, reading, orders)
        elif self.decision is None:
            seen = self._seen(reading, history=self._history(now))
            self.decision = self.controller.resume(now, seen, self.memory, self._learn(now, seen))
        # What the tick has seen of the plug is in the memory: `act` looks at it only where none was.
        action = self._timely(self.controller.act(now, self._seen(None if ticks else reading), self.memory))
        changed = _lasting(action.memory) != _lasting(self.memory)
        self.memory = action.memory
        self.memory, moved = self.actuator.apply(now, action, reading, self.memory, was_on)
        if moved or changed:
            self._save(said=self.memory.flow.cut is not cut)
        self.actuator.tend(self.clock.now())
        self._keep_book(now, reading, settle=due)
        self._publish(now, reading)
        self._run_errands(now, fetched=due)
        return self._next(now, action) + self.ahead

    def rest(self, due: datetime, inbox: Inbox, stopped: Callable[[], bool]) -> None:
        """Wait until `due` or a message. A plug that wants a word a second gets it, and is looked at every `LOOK_S`."""
        plug = self.plug
        if not isinstance(plug, Tended):
            self.clock.wait(due, inbox)
            return
        look_s = self.clock.monotonic() + LOOK_S
        while not (stopped() or inbox.pending()) and self.clock.now() < due and self.clock.monotonic() < look_s:
            self.clock.wait(min(due, plug.due() or due), plug.line)
            self.actuator.tend(self.clock.now())

    # -- the time ---------------------------------------------------------------------------------

    def _now(self) -> datetime:
        """The time as it is believed. After a step of the clock all is planned anew."""
        shown = self.clock.now()
        now = self.wall.look(shown, self.clock.monotonic(), self.unset())
        self.ahead = shown - now
        self.began = now if self.began is None else self.began + self.wall.jumped
        if self.wall.jumped:
            ran_s = self.clock.monotonic() - self.began_s
            self.memory = shifted(self.memory, self.wall.jumped, began=now - timedelta(seconds=ran_s))
            self.planned_at = None
        return now

    def _timely(self, action: Action) -> Action:
        """Without a clock: as it is, and after ten minutes on, unless a person or safety says off."""
        if self.wall.believed or action.cause in (By.CUT, By.PERSON_OFF):
            return action
        most_kw = self.controller.household.capability.power_max_kw
        wanted = self.wall.wanted(action.wanted, self.memory.relay_on, self.clock.monotonic(), most_kw)
        return replace(action, wanted=wanted, cause=By.GUARD)  # not on the plan's budget

    # -- looking ----------------------------------------------------------------------------------

    def _seen(
        self, reading: Reading | None, orders: tuple[Command, ...] = (), history: tuple[Intensity, ...] = ()
    ) -> Observation:
        lost = self.losses if self.clock.monotonic() - self.began_s < LOSS_TOLD_S else ()
        found = (*lost, *self.faults, *self.wall.faults(), *self.plug.warnings, *self.hub.warnings, *self.ails())
        zone = self.controller.household.timezone
        faults = {fault.code: replace(fault, text=in_local_time(fault.text, zone)) for fault in found}
        return Observation(reading, self.forecast, history, orders, tuple(faults.values()))

    def _tick_due(self, now: datetime) -> bool:
        """A new half hour since the last plan, no plan, its setpoint run out, or a forecast to be tried again."""
        if self.planned_at is None:
            plan = self.memory.plan
            if plan is None:
                return True
            self.planned_at = plan.made_at
        new_half_hour = slot_start(now) != slot_start(self.planned_at)
        orders = self.memory.orders  # a slot may end inside a half hour: where the session begins, or is due
        run_out = isinstance(orders, Setpoint) and now >= orders.until
        return new_half_hour or run_out or (self.fetch.at is not None and self.fetch.due(now))

    def _fetch(self, now: datetime) -> None:
        """A newer forecast, at most one a half hour; the last good one stays until then."""
        if not self.wall.believed or self.controller.safe:
            return
        issued = self.forecast.issued_at if self.forecast else None
        if issued is not None and slot_start(issued) == slot_start(now):
            return
        if not self.fetch.due(now):
            return
        try:
            self.forecast = believed(self.source.fetch(now), self._history(now))
        except ForecastLate:
            self.fetch.later(now, LATE)
            return
        except ForecastError as error:
            self.fetch.failed(now, self.spread())
            self.faults.stand("forecast", f"{error}; {self._forecast_age(now)}")
            return
        self.fetch.succeeded()
        self.faults.end("forecast")
        forecast = self.forecast
        self._stored("keep", lambda: self.store.keep(forecast), None)

    def _forecast_age(self, now: datetime) -> str:
        if self.forecast is None:
            return "planning with the usual day until it comes back"
        hours_old = (now - self.forecast.issued_at).total_seconds() / 3600.0
        return f"planning with the forecast of {hours_old:.1f} h ago"

    # -- deciding ---------------------------------------------------------------------------------

    def _tick(self, now: datetime, reading: Reading | None, orders: tuple[Command, ...]) -> None:
        seen = self._seen(reading, orders, self._history(now))
        self.decision = self.controller.tick(now, seen, self.memory, self._learn(now, seen))
        self.memory = self.decision.memory
        self.planned_at = now
        self._save(said=bool(orders) or (reading is not None and reading.changed_by_other is not None))
        self.hub.answer(self.decision.answers)
        self._log(now, reading)
        outlook = self.decision.outlook
        if outlook is not None:
            self._stored("expect", lambda: self.store.expect(now, outlook), None)

    def _learn(self, now: datetime, seen: Observation) -> Learned | None:
        """What is known with what was just seen."""
        if self.learned is None:
            return None
        if self.learned.lacks(seen.history):  # after a start, and with every page of the past
            again = self._stored("issued", lambda: replayed(self.store.issued(now - HISTORY), seen.history, now), None)
            self.learned = again or replayed((), seen.history, now)
        forecasts = () if seen.forecast is None else (seen.forecast,)
        self.learned = self.learned.advanced(now, forecasts, seen.history)
        return self.learned

    def _history(self, now: datetime) -> tuple[Intensity, ...]:
        nothing: tuple[Intensity, ...] = ()
        return self._stored("history", lambda: self.store.history(now - HISTORY), nothing)

    def _log(self, now: datetime, reading: Reading | None) -> None:
        if self.decision is None:
            return
        outlook = self.decision.outlook
        intensity = outlook.slots[0].g_per_kwh if outlook and outlook.slots else None
        record = Record(
            at=now,
            soc=self.memory.soc.mean,
            power_kw=reading.power_kw if reading else None,
            energy_kwh=reading.energy_kwh if reading else None,
            on=bool(self.memory.relay_on),
            status=self.decision.status,
            reason=self.decision.reason,
            intensity_g_per_kwh=intensity,
        )
        self._stored("append", lambda: self.store.append(record), None)

    # -- telling ----------------------------------------------------------------------------------

    def _publish(self, now: datetime, reading: Reading | None) -> None:
        if self.decision is None:
            return
        seen = self._seen(reading)
        fresh = self.controller.describe(now, seen, self.memory, self.decision.outlook)
        fresh = replace(fresh, saved=self.book.saved(now) if self.book else None, running_since=self.began)
        self.shown = replace(fresh, answers=self.decision.answers if self.planned_at == now else ())
        self.hub.publish(fresh, reading)

    def _keep_book(self, now: datetime, reading: Reading | None, settle: bool) -> None:
        """Enter what happened into the ledger, after all that matters more."""
        book, decision = self.book, self.decision
        if book is None or decision is None:
            return
        self._stored("book", lambda: book.note(now, reading, decision, self.memory), None)
        if settle:
            self._stored("settle", lambda: book.settle(now), None)

    def _run_errands(self, now: datetime, fetched: bool) -> None:
        """After all else, and not where the source was asked: one that is slow holds nobody up for long."""
        for errand in self.errands:
            self._stored(type(errand).__name__, partial(errand.step, now, wait=fetched), None)

    def _save(self, said: bool = False) -> None:
        """Keep the memory; in safe mode only for what a person `said`, or a cut, which outlive every end."""
        if said or not self.controller.safe:
            self._stored("save", lambda: self.store.save(self.memory), None)

    def _stored(self, what: str, act: Callable[[], Kept], otherwise: Kept) -> Kept:
        """What the store answers. Where it fails a fault stands until the same succeeds; decisions go on."""
        if (self.controller.safe and what != "save") or (not self.wall.believed and what not in TIMELESS):
            return otherwise
        try:
            answer = act()
        except StoreError as error:
            self.faults.stand("store", str(error), what)
            return otherwise
        self.faults.end("store", what)
        return answer

    def _next(self, now: datetime, action: Action) -> datetime:
        moments = [next_slot(now), action.until, None if isinstance(self.plug, Tended) else self.plug.due()]
        moments += [self.fetch.at, self.actuator.retry.at, *(errand.at for errand in self.errands)]
        return min(m for m in moments if m is not None and m > now)


def _lasting(memory: Memory) -> tuple[object, ...]:
    """What is saved at once when it changes between two ticks, though the relay does not move."""
    return memory.guarding, memory.flow.cut, memory.flow.wakes, memory.flow.flowed, memory.on_by
