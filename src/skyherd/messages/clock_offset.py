"""Offset between clocks, estimated from time-stamped messages alone.

Let θ be the reading of another clock minus the reading of the own clock. A message cannot arrive before it
was sent. Each one therefore bounds θ under any delay:

- a message sent at their reading s and received at our reading r implies `θ >= s - r`;
- a message sent at our reading s and received at their reading r implies `θ <= r - s`.

The fastest messages give the tightest bounds, so that slow messages have no effect. A delay that differs
between the two directions widens the interval without excluding the true offset. Clocks run at slightly
different rates, so that bounds decay with their age (`OffsetBound`). Messages in both directions give the
offset of one clock with its uncertainty (`ClockOffset`). Messages in one direction are sufficient for a
common time of a team (`skyherd.control.TeamClock`).
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.messages.checks import check_numbers

DRIFT = 2e-4
"""Maximum relative drift of two clocks, s/s. Chosen: crystals are within 5e-5 each and the kernel slews by up
to 5e-4; at this rate a bound of 1 ms holds for 5 s, dozens of messages."""


class OffsetBound:
    """Greatest lower bound of N clocks on the lead of another time over theirs.

    A bound decays by `drift` per second of its age. A greater new bound replaces it.

    Attributes:
        drift: maximum relative drift of clocks, s/s.
    """

    def __init__(self, members: int = 1, drift: float = DRIFT) -> None:
        self.drift = drift
        self._bounds_s: Array = np.full(members, -np.inf)
        self._made_s: Array = np.zeros(members)

    def at(self, own_s: Array) -> Array:
        """Return the bounds (N,), s, at clock readings `own_s` (N,); -inf where unknown."""
        return self._bounds_s - self.drift * np.maximum(own_s - self._made_s, 0.0)

    def tighten(self, bounds_s: Array, own_s: Array, rows: IntArray | slice = slice(None)) -> None:
        """Update with bounds (M,), s, of the clocks in `rows` (M,) at clock readings `own_s` (N,)."""
        is_greater = bounds_s >= self.at(own_s)[rows]
        self._bounds_s[rows] = np.where(is_greater, bounds_s, self._bounds_s[rows])
        self._made_s[rows] = np.where(is_greater, own_s[rows], self._made_s[rows])


@dataclass(frozen=True)
class OffsetEstimate:
    """Estimate of another clock's offset.

    Attributes:
        offset_s: its reading minus ours; 0 while unknown.
        uncertainty_s: maximum error of `offset_s`; infinite while a bound is missing.
    """

    offset_s: float
    uncertainty_s: float

    @property
    def is_known(self) -> bool:
        """True if messages in both directions were compared."""
        return self.uncertainty_s < float("inf")


class ClockOffset:
    """Bounds on one other clock's offset, from the time stamps of the messages exchanged with it.

    If the two bounds contradict each other, a clock was set, and the former bounds are dropped.

    Attributes:
        drift: maximum relative drift of the two clocks, s/s.
        resets: number of contradictions so far.

    Raises:
        InputError: `drift` is negative or not a number.
    """

    def __init__(self, drift: float = DRIFT) -> None:
        self.drift, self.resets = drift, 0
        check_numbers(self, not_negative=("drift",))
        self._at_least = OffsetBound(drift=drift)
        self._less_at_least = OffsetBound(drift=drift)  # on -θ

    def hear(self, their_sent_s: float, our_received_s: float) -> None:
        """Update with the time stamps of a received message: `θ >= sent - received`."""
        now_s, bound_s = np.array([our_received_s]), np.array([their_sent_s - our_received_s])
        if bound_s > -self._less_at_least.at(now_s):
            self.resets += 1
            self._at_least, self._less_at_least = OffsetBound(drift=self.drift), OffsetBound(drift=self.drift)
        self._at_least.tighten(bound_s, now_s)

    def confirm(self, our_sent_s: float, their_received_s: float, now_s: float) -> None:
        """Update with the reported arrival of a message of ours: `θ <= received - sent`."""
        # The bound is as old as the message, and has decayed since.
        aged_s = self.drift * max(0.0, now_s - our_sent_s)
        now, bound_s = np.array([now_s]), np.array([their_received_s - our_sent_s + aged_s])
        if bound_s < self._at_least.at(now):
            self.resets += 1
            self._at_least, self._less_at_least = OffsetBound(drift=self.drift), OffsetBound(drift=self.drift)
        self._less_at_least.tighten(-bound_s, now)

    def estimate(self, now_s: float) -> OffsetEstimate:
        """Return the middle of the present interval of θ, with half its width."""
        now = np.array([now_s])
        lowest_s, highest_s = float(self._at_least.at(now)[0]), -float(self._less_at_least.at(now)[0])
        if lowest_s == float("-inf") or highest_s == float("inf"):
            return OffsetEstimate(0.0, float("inf"))
        return OffsetEstimate((lowest_s + highest_s) / 2, (highest_s - lowest_s) / 2)
