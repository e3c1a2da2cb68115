"""What is learned, in numbers: sums that forget by the day, and what they say."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache

from plugd.domain import Series
from plugd.outlook.typical import typical_g_per_kwh
from plugd.units import HALF_HOUR

DAY = 48
"""Half hours. Times are counted in half hours of UTC since 1970, so that `at % DAY` is the time of day."""
LEAD_DAYS = 4
PROFILE_KEEPS, BIAS_KEEPS, WEIGHT_KEEPS = 0.95, 0.97, 0.99
"""Share of what was learned that is left a day later: it lasts 20, 33 and 100 days."""
TYPICAL_DAYS = 0.5
"""The built-in day counts like this much of own history at first, and ever less."""
TRUST_DAYS = 3.0
"""With as much own history the usual day is believed by half."""
BIAS_PAIRS = 8.0
"""Evidence of this many forecasts of a half hour corrects half of its bias."""


@dataclass(frozen=True, slots=True)
class Means:
    """Weighted sums of one number for each of some keys. Both: (keys,)."""

    sums: Series
    weights: Series

    @classmethod
    def none(cls, keys: int) -> "Means":
        """Nothing seen yet."""
        return cls((0.0,) * keys, (0.0,) * keys)

    def aged(self, share: float) -> "Means":
        """The same, of which only a share still counts."""
        return Means(tuple(share * s for s in self.sums), tuple(share * w for w in self.weights))

    def with_values(self, seen: Sequence[tuple[int, float]]) -> "Means":
        """The same with (key, value) added."""
        sums, weights = list(self.sums), list(self.weights)
        for key, value in seen:
            sums[key] += value
            weights[key] += 1.0
        return Means(tuple(sums), tuple(weights))


def trust(profile: Means) -> float:
    """How far own history is believed to know the usual day, 0..1."""
    days = sum(profile.weights) / DAY
    return days / (days + TRUST_DAYS)


def usual_day(profile: Means, at: int) -> Series:
    """The usual day around half hour `at`, g/kWh (48,): own means, leaning on the built-in day while they are thin."""
    built_in = _typical_day(at // DAY)
    at_first = TYPICAL_DAYS * sum(built_in)
    seen = sum(w * g for w, g in zip(profile.weights, built_in, strict=True))
    level = (sum(profile.sums) + at_first) / (seen + at_first)
    priors = [TYPICAL_DAYS / (1.0 + w) for w in profile.weights]
    return tuple(
        (s + prior * level * g) / (w + prior)
        for s, w, g, prior in zip(profile.sums, profile.weights, built_in, priors, strict=True)
    )


@lru_cache(maxsize=8)
def _typical_day(day: int) -> Series:
    """The built-in day, g/kWh (48,), on a day counted from 1970."""
    midnight = datetime.fromtimestamp(day * 86400, UTC)
    return tuple(typical_g_per_kwh(midnight + k * HALF_HOUR) for k in range(DAY))


def biases(found: Means) -> Series:
    """Measured less forecast by day ahead and time of day, g/kWh (LEAD_DAYS * 48,), shrunk to the mean over the days
    ahead, and that to 0, where evidence is thin."""
    pooled = []
    for k in range(DAY):
        keys = range(k, LEAD_DAYS * DAY, DAY)
        total, weight = sum(found.sums[j] for j in keys), sum(found.weights[j] for j in keys)
        pooled.append(total / (weight + LEAD_DAYS * BIAS_PAIRS))
    return tuple(
        (s + BIAS_PAIRS * pooled[j % DAY]) / (w + BIAS_PAIRS)
        for j, (s, w) in enumerate(zip(found.sums, found.weights, strict=True))
    )


@dataclass(frozen=True, slots=True)
class Fit:
    """Evidence for the three weights of one stretch ahead, and how far off what was said there turned out.

    Normal equations of `measured - usual = slow * a + fast * b + late * c`.
    """

    products: Series = (0.0,) * 6
    """Sums of slow², slow fast, slow late, fast², fast late, late²."""
    found: Series = (0.0,) * 3
    """Sums of each with measured - usual."""
    pairs: float = 0.0
    squares: float = 0.0
    """Of the errors of what was said, from `said` half hours."""
    said: float = 0.0

    def aged(self, share: float) -> "Fit":
        """The same, of which only a share still counts."""
        return Fit(
            tuple(share * p for p in self.products),
            tuple(share * f for f in self.found),
            share * self.pairs,
            share * self.squares,
            share * self.said,
        )

    def with_pairs(self, seen: Sequence[tuple[float, float, float, float]]) -> "Fit":
        """With (slow, fast, late, measured - usual) of some half hours."""
        a11, a12, a13, a22, a23, a33 = self.products
        b1, b2, b3 = self.found
        for x, y, z, g in seen:
            a11 += x * x
            a12 += x * y
            a13 += x * z
            a22 += y * y
            a23 += y * z
            a33 += z * z
            b1 += x * g
            b2 += y * g
            b3 += z * g
        return replace(self, products=(a11, a12, a13, a22, a23, a33), found=(b1, b2, b3), pairs=self.pairs + len(seen))

    def with_errors(self, errors: Sequence[float]) -> "Fit":
        """With what was measured less what had been said of some half hours, g/kWh."""
        return replace(self, squares=self.squares + sum(e * e for e in errors), said=self.said + len(errors))

    def weights(self, prior: Series, prior_pairs: float) -> Series:
        """The three weights by ridge regression: `prior` counts like `prior_pairs` half hours of evidence."""
        if self.pairs <= 0.0:
            return prior
        a11, a12, a13, a22, a23, a33 = self.products
        share = prior_pairs / self.pairs
        extra = [share * a + 1e-6 * prior_pairs for a in (a11, a22, a33)]
        (b1, b2, b3) = (b + e * p for b, e, p in zip(self.found, extra, prior, strict=True))
        a11, a22, a33 = a11 + extra[0], a22 + extra[1], a33 + extra[2]
        # Cholesky, written out for three
        l11 = a11**0.5
        l21, l31 = a12 / l11, a13 / l11
        l22 = (a22 - l21 * l21) ** 0.5
        l32 = (a23 - l31 * l21) / l22
        l33 = (a33 - l31 * l31 - l32 * l32) ** 0.5
        y1 = b1 / l11
        y2 = (b2 - l21 * y1) / l22
        y3 = (b3 - l31 * y1 - l32 * y2) / l33
        w3 = y3 / l33
        w2 = (y2 - l32 * w3) / l22
        return ((y1 - l21 * w2 - l31 * w3) / l11, w2, w3)
