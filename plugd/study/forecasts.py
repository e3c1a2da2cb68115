"""What a strategy may know of the intensity to come: the paper's synthetic long-range forecast (section III-A).

`Ĉ[l] = C[l] (1 + a[l] |ε[1]| (1 + λ (l − 1)))`, with random signs a[l] and l = 1 the half hour under way. The paper
leaves open whose one-step error |ε[1]| is: that of the moment of issue, the same for the whole forecast (`datum`), or
that of each half hour forecast (`target`). `none` is perfect foresight.
"""

import random
from collections.abc import Sequence
from datetime import datetime
from enum import StrEnum
from typing import Protocol

from plugd.domain import Intensity
from plugd.past import HISTORY
from plugd.study.measured import Measured
from plugd.units import HALF_HOUR, SLOT_H, slot_start, span_h

PAPER_GROWTH = 9.97e-3
"""λ: growth of the relative error a half hour ahead, as a share of the one-step error."""
MOST_SLOTS = 48 * 16
"""How far ahead signs are drawn, whatever is asked for: one issue is the same for every strategy."""


class Noise(StrEnum):
    """Whose one-step error the synthetic forecast grows from."""

    DATUM = "datum"
    TARGET = "target"
    NONE = "none"


class Forecasts(Protocol):
    """Something that expects an intensity for half hours to come."""

    def expected(self, now: datetime, slots: Sequence[datetime]) -> Sequence[float]:
        """What is expected at `now` of each of `slots`, none of them over, g/kWh (len(slots),)."""

    def history(self, now: datetime) -> tuple[Intensity, ...]:
        """What is remembered at `now` of the half hours that are over."""


class Synthetic:
    """The paper's forecast, issued anew every half hour; the same for the same seed and half hour."""

    def __init__(
        self,
        found: Measured,
        noise: Noise,
        seed: int,
        since: datetime,
        growth: float = PAPER_GROWTH,
    ) -> None:
        self._found, self._noise, self._seed, self._growth = found, noise, seed, growth
        self._index = {at: k for k, at in enumerate(found.slots())}
        self._off = [abs(g * e) for g, e in zip(found.actual, found.error, strict=True)]
        exact = noise is Noise.NONE
        known = zip(found.slots(), found.actual, found.error, strict=True)
        self._stored = tuple(Intensity(at, g if exact else max(0.0, g * (1.0 + e))) for at, g, e in known)
        self._since = max(0, found.index(since))

    def expected(self, now: datetime, slots: Sequence[datetime]) -> list[float]:
        """See Forecasts."""
        actual, index, growth = self._found.actual, self._index, self._growth
        targets = [index[at] for at in slots]
        if self._noise is Noise.NONE:
            return [actual[k] for k in targets]
        issued = self._found.index(now)
        signs = random.Random(f"{self._seed}/issue {issued}").getrandbits(MOST_SLOTS)
        if self._noise is Noise.DATUM:
            share = abs(self._found.error[issued])
            offs = [actual[k] * share for k in targets]
        else:
            offs = [self._off[k] for k in targets]
        return [
            actual[k] + (off if signs >> (k - issued) & 1 else -off) * (1.0 + growth * (k - issued))
            for k, off in zip(targets, offs, strict=True)
        ]

    def history(self, now: datetime) -> tuple[Intensity, ...]:
        """The stored one-step forecasts since the world began."""
        return self._stored[max(self._since, self._found.index(now - HISTORY)) : self._found.index(now)]


class Delayed:
    """A forecast seen later than it is, by a length drawn anew each night. Implements Forecasts."""

    def __init__(self, inner: Forecasts, seed: int, most_h: float) -> None:
        self._inner, self._seed, self._most_h = inner, seed, most_h
        self._seen: dict[datetime, float] = {}

    def expected(self, now: datetime, slots: Sequence[datetime]) -> list[float]:
        """See Forecasts. What is over is remembered; what was never seen is worth no charging."""
        night = (now - span_h(12.0)).date()
        delay = random.Random(f"{self._seed}/delay {night}").randint(0, round(self._most_h / SLOT_H)) * HALF_HOUR
        first = slot_start(now)
        ahead = sorted({*slots, *(at - delay for at in slots if at - delay >= first)})
        self._seen |= zip(ahead, self._inner.expected(now, ahead), strict=True)
        never = max(self._seen[at] for at in slots)
        return [self._seen.get(at - delay, never) for at in slots]

    def history(self, now: datetime) -> tuple[Intensity, ...]:
        """See Forecasts."""
        return self._inner.history(now)
