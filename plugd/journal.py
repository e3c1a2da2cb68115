"""What the daemon says in its log: what it does and why, what fails, what works again; and each only once."""

import logging
import re

from plugd import remedies
from plugd.domain import Decision, Fault

log = logging.getLogger("plugd")

NUMBER = re.compile(r"[0-9]+(?:[:.][0-9]+)?")
CLOCK = re.compile(r"\b([0-9]{2}):([0-9]{2})\b")
NEWS_MIN = 60
"""A time that moves by less is no news: plans move by a few minutes every half hour."""
DAY_MIN = 24 * 60


class Journal:
    """Says in the log what has changed since the last step."""

    def __init__(self) -> None:
        self._said = self._reason = ""
        self._faults: dict[str, str] = {}

    def note(self, decision: Decision | None) -> None:
        """Compare and say."""
        if decision is None:
            return
        self._fault(decision.faults)
        for answer in decision.answers:
            log.info("command %s%s: %s", answer.command, "" if answer.ok else " refused", answer.message)
        if is_news(decision.reason, self._said):
            log.info("%s", decision.reason)
            self._said = decision.reason
        elif decision.reason != self._reason:
            log.debug("%s", decision.reason)
        self._reason = decision.reason

    def _fault(self, found: tuple[Fault, ...]) -> None:
        faults = {fault.code: f"{fault.text}. {remedies.remedy(fault)}" for fault in found}
        for code in sorted(faults.keys() - self._faults.keys()):
            log.warning("%s: %s", code, faults[code])
        for code in sorted(self._faults.keys() - faults.keys()):
            log.info("%s: works again", code)
        self._faults = faults


def is_news(reason: str, said: str) -> bool:
    """Whether a reason says something else than the one before, and not only the same with other figures."""
    if NUMBER.sub("", reason) != NUMBER.sub("", said):
        return True
    return any(_apart_min(one, other) >= NEWS_MIN for one, other in zip(_times(reason), _times(said), strict=False))


def _times(reason: str) -> list[int]:
    return [60 * int(hour) + int(minute) for hour, minute in CLOCK.findall(reason)]


def _apart_min(one: int, other: int) -> int:
    """Between two clock times, the shorter way round."""
    return min((one - other) % DAY_MIN, (other - one) % DAY_MIN)
