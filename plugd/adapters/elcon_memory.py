"""What a charger on CAN has told so far: its last word, the energy so far, how long something has been so."""

from dataclasses import dataclass
from datetime import datetime, timedelta

from plugd.adapters.elcon_words import DEAF, HARDWARE, HEAT, MAINS, Status
from plugd.units import hours, kw_of

PATIENCE = 5
"""Beats without a word after which either side counts the other as silent."""
IDLE_A = 0.3
"""Less is no current."""
STOPPED_BY = {
    HARDWARE: ("charger_hardware", "the charger reports a failure of its hardware"),
    HEAT: ("charger_hot", "the charger is too hot"),
    MAINS: ("charger_mains", "the charger finds its mains voltage wrong"),
}
"""Bits with which it gives nothing whatever it is told: a fault's code, and its text."""


@dataclass(frozen=True, slots=True)
class Heard:
    """The charger's last word."""

    status: Status
    at: datetime
    at_s: float
    """Monotonic."""


class ChargerMemory:
    """Made of the charger's words alone. Energy is at the plug, since plugd's start: the charger has no meter."""

    def __init__(self, efficiency: float, patience_s: float) -> None:
        self.last: Heard | None = None
        self.words = 0
        self.nonsense = 0
        """How many of its frames could not be."""
        self.energy_kwh = 0.0
        self.came_back = False
        """It was silent for a while, and speaks again."""
        self.cut = False
        """It gave more than the battery bears for so long that it is stopped until a person has looked."""
        self._efficiency = efficiency
        self._patience_s = patience_s
        self._over_s: float | None = None

    def at_plug_kw(self, status: Status) -> float:
        """The power of a word at the plug: it measures on the battery's side."""
        return kw_of(status.current_a, status.voltage_v) / self._efficiency

    def absorb(self, status: Status | None, over: bool, now: datetime, now_s: float) -> None:
        """A word (None: one that cannot be), and whether it is more than the battery bears.

        The energy between two words is that of their mean power; for a gap none is made up.
        """
        self._watch(over or status is None, now_s)
        if status is None:
            self.nonsense += 1
            return
        if self.last is not None:
            passed_s = now_s - self.last.at_s
            gap = passed_s > self._patience_s
            self.came_back = self.came_back or gap
            mean_kw = (self.at_plug_kw(self.last.status) + self.at_plug_kw(status)) / 2.0
            self.energy_kwh += 0.0 if gap else mean_kw * hours(timedelta(seconds=passed_s))
        self.last = Heard(status, now, now_s)
        self.words += 1

    def _watch(self, over: bool, now_s: float) -> None:
        if not over:
            self._over_s = None
        elif self._over_s is None:
            self._over_s = now_s
        self.cut = self.cut or (self._over_s is not None and now_s - self._over_s >= self._patience_s)

    def fresh(self, now_s: float) -> bool:
        """Whether its last word still counts."""
        return self.last is not None and now_s - self.last.at_s <= self._patience_s

    def flowing(self, now_s: float) -> bool:
        """Whether it gives a current, as far as is known now."""
        return self.last is not None and self.fresh(now_s) and self.last.status.current_a > IDLE_A

    @property
    def bits(self) -> tuple[str, ...]:
        """The status bits of its last word."""
        return self.last.status.bits if self.last is not None else ()

    @property
    def stopped(self) -> bool:
        """Whether it gives nothing whatever it is told."""
        return DEAF in self.bits or any(bit in self.bits for bit in STOPPED_BY)
