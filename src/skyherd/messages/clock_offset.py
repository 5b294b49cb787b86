"""What another machine's clock shows when ours shows something, learnt from nothing but stamped messages.

Let θ be what the other clock shows less what ours shows. A message cannot arrive before it was sent, so that
each one bounds θ, whatever the delays were:

- one that they send when their clock shows s, and that we receive when ours shows r, tells `θ >= s - r`;
- one that we send when ours shows s, and that they tell us to have received at r, tells `θ <= r - s`.

The fastest messages give the tightest bounds, so that slow ones do no harm, and a delay that differs between
the two directions widens the interval and never moves it off the truth. Clocks run at slightly different
rates, for which bounds give way with their age. Where the two bounds contradict each other, a clock was set:
what was known before is dropped. A lower and an upper bound are all that needs to be remembered.
"""

from dataclasses import dataclass

from skyherd.messages.checks import check_numbers

DRIFT = 2e-4
"""By how much two clocks may run apart, s/s. Chosen: crystals are within 50 parts in a million each, and the
kernel slews a clock that it corrects by up to 500; twice the crystals' sum lets a bound of 1 ms hold for 5
seconds, in which dozens of messages pass."""


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


@dataclass(frozen=True)
class NewsAge:
    """How old something is that another clock stamped, by our clock.

    Attributes:
        age_s: now less the instant of the stamp; negative for a stamp in the future.
        uncertainty_s: the truth is within this of `age_s`.
    """

    age_s: float
    uncertainty_s: float


class ClockOffset:
    """The bounds on one other clock's offset, from the stamps of the messages exchanged with it.

    Attributes:
        drift: by how much the two clocks may run apart, s/s.
        resets: how often the bounds contradicted each other, which says that a clock was set.

    Raises:
        InputError: `drift` is negative or no number.
    """

    def __init__(self, drift: float = DRIFT) -> None:
        self.drift, self.resets = drift, 0
        check_numbers(self, not_negative=("drift",))
        self._lowest_s, self._highest_s = float("-inf"), float("inf")
        self._bounded_s = float("-inf")

    def hear(self, their_sent_s: float, our_received_s: float) -> None:
        """Take in the stamps of a message that came from there: `θ >= sent - received`."""
        self._widen(our_received_s)
        bound_s = their_sent_s - our_received_s
        if bound_s > self._highest_s:
            self.resets += 1
            self._lowest_s, self._highest_s = bound_s, float("inf")
        self._lowest_s = max(self._lowest_s, bound_s)

    def confirm(self, our_sent_s: float, their_received_s: float, now_s: float) -> None:
        """Take in when a message of ours arrived there, as they told us: `θ <= received - sent`."""
        self._widen(now_s)
        # The bound is as old as the message; until now it has given way like all others.
        bound_s = their_received_s - our_sent_s + self.drift * max(0.0, now_s - our_sent_s)
        if bound_s < self._lowest_s:
            self.resets += 1
            self._lowest_s, self._highest_s = float("-inf"), bound_s
        self._highest_s = min(self._highest_s, bound_s)

    def estimate(self, now_s: float) -> OffsetEstimate:
        """The middle of what is possible now, and how far off it may be."""
        aged_s = self._aged_s(now_s)
        lowest_s, highest_s = self._lowest_s - aged_s, self._highest_s + aged_s
        if lowest_s == float("-inf") or highest_s == float("inf"):
            return OffsetEstimate(0.0, float("inf"))
        return OffsetEstimate((lowest_s + highest_s) / 2, (highest_s - lowest_s) / 2)

    def age(self, their_stamp_s: float, now_s: float) -> NewsAge:
        """How old what they stamped is now."""
        known = self.estimate(now_s)
        return NewsAge(now_s - (their_stamp_s - known.offset_s), known.uncertainty_s)

    def _aged_s(self, now_s: float) -> float:
        """By how much the bounds have given way since they were last moved."""
        return self.drift * max(0.0, now_s - self._bounded_s) if self._bounded_s > float("-inf") else 0.0

    def _widen(self, now_s: float) -> None:
        """Let both bounds give way for the time since they were last moved."""
        aged_s = self._aged_s(now_s)
        self._lowest_s, self._highest_s = self._lowest_s - aged_s, self._highest_s + aged_s
        self._bounded_s = max(self._bounded_s, now_s)
