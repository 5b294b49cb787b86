"""A common time for a team whose members' clocks differ.

Every message carries the team's time of its image, and no message arrives before it was sent. The team's time
at reception is therefore at least the stamp plus the minimum radio delay. Each member keeps the greatest such
bound. For members that send messages, the first bound is the reading of their own clock. The sending clock
that is farthest ahead thus defines the team's time, and all others follow it without knowing which clock it
is (L. Lamport, Time, clocks, and the ordering of events in a distributed system, 1978).

Clocks run at slightly different rates, so a bound decays with its age (`OffsetBound`); the bound of the own
clock does not. Let δ be the minimum delay and δ + d the delay of a message. A member's time never runs ahead
of the leading clock. Right after the message it lags behind the sender's by at most d. The age that a member
computes for a message is too small by at most d, plus `2 DRIFT` times the age of the fastest recent one. Only
a member that starts, or that receives the stamp of a clock farther ahead, sees a jump.
"""

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.messages.checks import check_count, check_numbers
from skyherd.messages.clock_offset import OffsetBound

MAX_MEMBERS = 10_000
"""Maximum number of members of a team. Chosen: the maximum number of robots of a scenario."""


class TeamClock:
    """Estimate of the team's time for N members, from each own clock and the received time stamps.

    Attributes:
        min_delay_s: minimum delay of a message from its image to its receiver.
        listens: whether members only receive, so that their own clocks do not define the team's time.

    Args:
        min_delay_s: as the attribute.
        members: N.
        listens: as the attribute.

    Raises:
        InputError: `min_delay_s` is negative or not a number, or `members` is not a valid count.
    """

    def __init__(self, min_delay_s: float = 0.0, members: int = 1, *, listens: bool = False) -> None:
        self.min_delay_s, self.listens = min_delay_s, listens
        check_numbers(self, not_negative=("min_delay_s",))
        check_count("TeamClock.members", members, most=MAX_MEMBERS)
        self._ahead = OffsetBound(members)

    def hear(self, stamp_s: float, own_s: Array, rows: IntArray | None = None) -> None:
        """Update the estimate with the time stamp of a received message.

        Args:
            stamp_s: the team's time of its image, as estimated by its sender.
            own_s: (N,) readings of the members' own clocks.
            rows: members that received it; all if None.
        """
        at = slice(None) if rows is None else rows
        self._ahead.tighten(stamp_s + self.min_delay_s - own_s[at], own_s, at)

    def time_s(self, own_s: Array) -> Array:
        """Return the team's time (N,) for readings (N,) of the members' own clocks.

        Members without a received stamp use their own clock.
        """
        ahead_s = self._ahead.at(own_s)
        is_own = np.isneginf(ahead_s) if self.listens else ahead_s < TIME_TOLERANCE_S
        return own_s + np.where(is_own, 0.0, ahead_s)
