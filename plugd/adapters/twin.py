"""Whether another program is at the broker under our client id: then each pushes the other out, for ever.

MQTT 5 lets a broker say so as it closes. Not every one does (mosquitto 2.0.11 does not), and before it none: then
there is only the end of a connection, soon after it was made, and a broker that is there when it is asked again at
once. Three of those in a row are no accident. Who was pushed out stays away, each time for longer, up to half an
hour; what the plug does meanwhile is its own timer's business.
"""

from dataclasses import dataclass

SOON_S = 10.0
MOST_SOON = 3
AT_PEACE_S = 600.0
"""A connection that has lasted so long shows that the other one is gone."""
LONGEST_AWAY_S = 1800.0
"""Within the guard's margin: a plug without a timer of its own is still told in time that it has to charge."""


@dataclass(slots=True)
class Twin:
    """What was seen of it. All times by the monotonic clock."""

    pushed_out: int = 0
    """How often in a row; 0: as far as is known there is no other."""
    _soon: int = 0

    def ended(self, lasted_s: float, told: bool | None) -> bool:
        """A connection has ended. Returns whether we were pushed out.

        `told`: that it was for another of our name, or (False) for something else; None: nobody said why.
        """
        self.lasting(lasted_s)
        self._soon = self._soon + 1 if lasted_s < SOON_S and told is None else 0
        pushed = told is True or self._soon >= MOST_SOON
        if pushed:
            self.pushed_out, self._soon = self.pushed_out + 1, 0
        return pushed

    @property
    def suspected(self) -> bool:
        """Whether to ask the broker at once: a twin leaves it where it is, an end of its own does not."""
        return self._soon > 0

    @property
    def about(self) -> bool:
        """Whether it may have had our place a moment ago, and have done there what we did not see."""
        return self.pushed_out > 0 or self._soon > 0

    def not_made(self) -> None:
        """There was no connection to be had: it was the broker, and nobody else."""
        self._soon = 0

    def lasting(self, lasted_s: float) -> None:
        """A connection is there, for so long now."""
        if lasted_s >= SOON_S:
            self._soon = 0
        if lasted_s >= AT_PEACE_S:
            self.pushed_out = 0

    def away_s(self, first_s: float) -> float:
        """How long to stay away after we were pushed out: twice as long each time."""
        return float(min(first_s * 2.0 ** max(0, self.pushed_out - 1), max(first_s, LONGEST_AWAY_S)))
