"""What other clocks show when ours shows something, learnt from nothing but stamped messages.

Let θ be what another clock shows less what ours shows. A message cannot arrive before it was sent, so that
each one bounds θ, whatever the delays were:

- one that they send when their clock shows s, and that we receive when ours shows r, tells `θ >= s - r`;
- one that we send when ours shows s, and that they tell us to have received at r, tells `θ <= r - s`.

The fastest messages give the tightest bounds, so that slow ones do no harm, and a delay that differs between
the two directions widens the interval and never moves it off the truth. Clocks run at slightly different
rates, for which bounds give way with their age (`OffsetBound`). Messages in both directions tell the offset
of one clock and how far it may be off (`ClockOffset`); messages in one direction are enough to agree on one
time for all (`skyherd.control.TeamClock`).
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.messages.checks import check_numbers

DRIFT = 2e-4
"""By how much two clocks may run apart, s/s. Chosen: crystals are within 50 parts in a million each, and the
kernel slews a clock that it corrects by up to 500; twice the crystals' sum lets a bound of 1 ms hold for 5
seconds, in which dozens of messages pass."""


class OffsetBound:
    """The greatest lower bound that N clocks have on how far another time is ahead of theirs.

    A bound gives way by `drift` for each second of its age, and a new one takes its place where it is
    greater.

    Attributes:
        drift: by how much clocks may run apart, s/s.
    """

    def __init__(self, members: int = 1, drift: float = DRIFT) -> None:
        self.drift = drift
        self._bounds_s: Array = np.full(members, -np.inf)
        self._made_s: Array = np.zeros(members)

    def at(self, own_s: Array) -> Array:
        """The bounds (N,), s, when the clocks show `own_s` (N,); -inf where there is none."""
        return self._bounds_s - self.drift * np.maximum(own_s - self._made_s, 0.0)

    def tighten(self, bounds_s: Array, own_s: Array, rows: IntArray | slice = slice(None)) -> None:
        """Take in bounds (M,), s, that clocks in `rows` (M,) have when the clocks show `own_s` (N,)."""
        is_greater = bounds_s >= self.at(own_s)[rows]
        self._bounds_s[rows] = np.where(is_greater, bounds_s, self._bounds_s[rows])
        self._made_s[rows] = np.where(is_greater, own_s[rows], self._made_s[rows])


@dataclass(frozen=True)
class OffsetEstimate:
    """What is known of another clock.

    Attributes:
        offset_s: what it shows less what ours shows; 0 while nothing is known.
        uncertainty_s: the truth is within this of `offset_s`; infinite while a bound is missing.
    """

    offset_s: float
    uncertainty_s: float

    @property
    def is_known(self) -> bool:
        """Whether messages in both directions were compared."""
        return self.uncertainty_s < float("inf")


class ClockOffset:
    """The bounds on one other clock's offset, from the stamps of the messages exchanged with it.

    Where the two bounds contradict each other, a clock was set, and what was known before is dropped.

    Attributes:
        drift: by how much the two clocks may run apart, s/s.
        resets: how often the bounds contradicted each other.

    Raises:
        InputError: `drift` is negative or no number.
    """

    def __init__(self, drift: float = DRIFT) -> None:
        self.drift, self.resets = drift, 0
        check_numbers(self, not_negative=("drift",))
        self._at_least = OffsetBound(drift=drift)
        self._less_at_least = OffsetBound(drift=drift)  # on what ours shows less what theirs shows

    def hear(self, their_sent_s: float, our_received_s: float) -> None:
        """Take in the stamps of a message that came from there: `θ >= sent - received`."""
        now_s, bound_s = np.array([our_received_s]), np.array([their_sent_s - our_received_s])
        if bound_s > -self._less_at_least.at(now_s):
            self.resets += 1
            self._at_least, self._less_at_least = OffsetBound(drift=self.drift), OffsetBound(drift=self.drift)
        self._at_least.tighten(bound_s, now_s)

    def confirm(self, our_sent_s: float, their_received_s: float, now_s: float) -> None:
        """Take in when a message of ours arrived there, as they told us: `θ <= received - sent`."""
        # The bound is as old as the message; until now it has given way like all others.
        aged_s = self.drift * max(0.0, now_s - our_sent_s)
        now, bound_s = np.array([now_s]), np.array([their_received_s - our_sent_s + aged_s])
        if bound_s < self._at_least.at(now):
            self.resets += 1
            self._at_least, self._less_at_least = OffsetBound(drift=self.drift), OffsetBound(drift=self.drift)
        self._less_at_least.tighten(-bound_s, now)

    def estimate(self, now_s: float) -> OffsetEstimate:
        """The middle of what is possible now, and how far off it may be."""
        now = np.array([now_s])
        lowest_s, highest_s = float(self._at_least.at(now)[0]), -float(self._less_at_least.at(now)[0])
        if lowest_s == float("-inf") or highest_s == float("inf"):
            return OffsetEstimate(0.0, float("inf"))
        return OffsetEstimate((lowest_s + highest_s) / 2, (highest_s - lowest_s) / 2)
