"""What a scenario promises, and how each promise is looked after: one function each, by name.

A check returns None where the promise is kept, else what was seen instead.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Any
from zoneinfo import ZoneInfo

from plugd.errors import UsageError
from plugd.units import to_pct
from plugd_hil.account import Line, soc_at
from plugd_hil.script import moment

SLACK_PCT = 0.5
WORDS = ("from", "to", "within_s", "saying")
State = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Promise:
    """What must hold from `start` to `end`; how is in `CHECKS` under its name."""

    name: str
    value: Any
    start: datetime
    end: datetime
    within: timedelta
    saying: str
    said: str
    """As it is written, for people."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What a run came to: the truth, what plugd said of it, what it told the plug."""

    ledger: tuple[Line, ...]
    states: tuple[tuple[datetime, State], ...]
    words: tuple[tuple[datetime, str, str], ...]
    """(at, topic, payload) of orders to the plug."""
    presence: tuple[tuple[datetime, str], ...]
    """plugd's availability."""
    asked: dict[str, float]
    """The most that a charger on CAN was ever told."""
    zone: ZoneInfo

    def clock(self, at: datetime) -> str:
        """For people."""
        return f"{at.astimezone(self.zone):%H:%M:%S}"

    def standing(self, start: datetime, end: datetime) -> Iterator[tuple[datetime, State]]:
        """What plugd's state was at `start`, and every one until `end`."""
        before = [state for at, state in self.states if at <= start]
        if before:
            yield start, before[-1]
        yield from ((at, state) for at, state in self.states if start < at <= end)

    def relay(self, start: datetime, end: datetime) -> Iterator[tuple[datetime, bool]]:
        """How the relay truly was at `start`, and whenever it moved until `end`."""
        before = [line.on for line in self.ledger if line.at <= start]
        yield start, before[-1] if before else self.ledger[0].on
        yield from ((b.at, b.on) for a, b in pairwise(self.ledger) if a.on is not b.on and start < b.at <= end)


def parsed(row: dict[str, Any], start: datetime, end: datetime, zone: ZoneInfo) -> Promise:
    """A row of `promises`. Raises UsageError."""
    names = [key for key in row if key not in WORDS]
    if len(names) != 1 or names[0] not in CHECKS:
        raise UsageError(f"{row!r}: write one of {', '.join(CHECKS)}, and beside it at most {', '.join(WORDS)}")
    return Promise(
        name=names[0],
        value=row[names[0]],
        start=moment(row["from"], start, zone) if "from" in row else start,
        end=moment(row["to"], start, zone) if "to" in row else end,
        within=timedelta(seconds=float(row.get("within_s", 0))),
        saying=str(row.get("saying", "")),
        said=", ".join(f"{key} {value}" for key, value in row.items()),
    )


def codes(state: State) -> dict[str, str]:
    """The faults that a state shows, and their texts."""
    return {fault["code"]: fault["text"] for fault in state["faults"]}


def _morning(promise: Promise, seen: Seen) -> str | None:
    """The car holds this many percent at `to`."""
    percent = to_pct(soc_at(seen.ledger, promise.end))
    return None if percent >= promise.value - SLACK_PCT else f"{percent:.1f} % at {seen.clock(promise.end)}"


def _at_most_pct(promise: Promise, seen: Seen) -> str | None:
    most = max(to_pct(line.soc) for line in seen.ledger)
    return None if most <= promise.value + SLACK_PCT else f"{most:.1f} %"


def _shows(promise: Promise, seen: Seen) -> str | None:
    """plugd's state shows the fault, at `within_s` after `from` at the latest."""
    found = [codes(state) for _, state in seen.standing(promise.start, promise.start + promise.within)]
    if any(re.search(promise.saying, faults[promise.value]) for faults in found if promise.value in faults):
        return None
    return f"only {sorted({f'{code}: {text}' for faults in found for code, text in faults.items()})}"


def _clears(promise: Promise, seen: Seen) -> str | None:
    """The fault is gone at `within_s` after `from` at the latest, and stays so until `to`."""
    at = promise.start + promise.within
    still = [when for when, state in seen.standing(at, promise.end) if promise.value in codes(state)]
    return f"still there at {seen.clock(still[0])}" if still else None


def _never_shows(promise: Promise, seen: Seen) -> str | None:
    for at, state in seen.standing(promise.start, promise.end):
        for code, text in codes(state).items():
            if promise.value in (code, "any"):
                return f"{seen.clock(at)}: {code}: {text}"
    return None


def _says(promise: Promise, seen: Seen) -> str | None:
    """The reason in plugd's state matches, at some time from `from` to `to`."""
    reasons = [state["reason"] for _, state in seen.standing(promise.start, promise.end)]
    return None if any(re.search(promise.value, reason) for reason in reasons) else f"only {sorted(set(reasons))}"


def _state(promise: Promise, seen: Seen) -> str | None:
    """plugd's state holds these values, at `within_s` after `from` at the latest."""
    wanted, last = promise.value, None
    for _, state in seen.standing(promise.start, promise.start + promise.within):
        last = {key: state.get(key) for key in wanted}
        if last == wanted:
            return None
    return f"last {last}"


def _relay(promise: Promise, seen: Seen) -> str | None:
    """The relay truly is on (off) from `within_s` after `from`, throughout until `to`."""
    for at, on in seen.relay(promise.start + promise.within, promise.end):
        if on is not promise.value:
            return f"{'on' if on else 'off'} at {seen.clock(at)}"
    return None


def _moves_at_most(promise: Promise, seen: Seen) -> str | None:
    moves = list(seen.relay(promise.start, promise.end))[1:]
    return None if len(moves) <= promise.value else f"{len(moves)}: {', '.join(seen.clock(at) for at, _ in moves)}"


def _words_at_most(promise: Promise, seen: Seen) -> str | None:
    words = [at for at, _, _ in seen.words if promise.start <= at <= promise.end]
    return None if len(words) <= promise.value else f"{len(words)} orders to the plug"


def _soc_within(promise: Promise, seen: Seen) -> str | None:
    """At `to` plugd's SOC is this many points from the truth at most."""
    told = [state["soc_pct"] for _, state in seen.standing(promise.end, promise.end)]
    truth = to_pct(soc_at(seen.ledger, promise.end))
    if told and abs(told[-1] - truth) <= promise.value:
        return None
    return f"told {told}, truly {truth:.1f}"


def _presence(promise: Promise, seen: Seen) -> str | None:
    """plugd's availability becomes this between `from` and `within_s` after."""
    said = [word for at, word in seen.presence if promise.start <= at <= promise.start + promise.within]
    return None if promise.value in said else f"only {said}"


def _most(key: str) -> Callable[[Promise, Seen], str | None]:
    """What the charger was ever told, or suffered, is no more than this."""

    def check(promise: Promise, seen: Seen) -> str | None:
        most = seen.asked.get(key)
        return None if most is not None and most <= promise.value else f"{most}"

    return check


CHECKS: dict[str, Callable[[Promise, Seen], str | None]] = {
    "morning": _morning,
    "never_above_pct": _at_most_pct,
    "shows": _shows,
    "clears": _clears,
    "never_shows": _never_shows,
    "says": _says,
    "state": _state,
    "relay": _relay,
    "moves_at_most": _moves_at_most,
    "words_at_most": _words_at_most,
    "soc_within": _soc_within,
    "presence": _presence,
    "volts_at_most": _most("voltage_v"),
    "amps_at_most": _most("current_a"),
    "invalid_at_most": _most("invalid"),
    "opened_under_load_at_most": _most("opened_under_load"),
    "silence_s_at_most": _most("longest_silence_s"),
}
