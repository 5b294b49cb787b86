"""One time for a whole team whose members' clocks all show something else.

Every message carries the team's time of its image, and no message arrives before it was sent: who hears one
knows that the team's time is by now its stamp and the least delay of the radio, at least. Each member keeps
the greatest such bound; for members that send messages themselves their own clock's reading is the first. So
the sending clock that is farthest ahead sets the team's time, all others follow it, and nobody need know
whose it is (L. Lamport, Time, clocks, and the ordering of events in a distributed system, 1978).

Clocks run at slightly different rates, for which a bound gives way with its age (`OffsetBound`), but for
one's own clock. With δ the least delay and δ + d the delay of a message, a member's time then never runs
ahead of the leading clock's, and right after the message it lags behind its sender's by at most d: an age
that a member takes of a message is too small by d at most, and by `2 DRIFT` times the age of the fastest
recent one. Only a member that starts, or that hears of a clock that leads by more, sees a jump.
"""

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.messages.checks import check_count, check_numbers
from skyherd.messages.clock_offset import OffsetBound

MAX_MEMBERS = 10_000
"""Most members of a team. Chosen: as many robots as a scenario may have."""


class TeamClock:
    """The team's time as N members know it, each by its own clock and by what it has heard.

    Attributes:
        min_delay_s: no message takes less from its image to its receiver.
        listens: whether the members hear and do not send, so that their own clocks say nothing of the team's.

    Args:
        min_delay_s: as the attribute.
        members: N.
        listens: as the attribute.

    Raises:
        InputError: `min_delay_s` is negative or no number, or `members` is no number of robots or units.
    """

    def __init__(self, min_delay_s: float = 0.0, members: int = 1, *, listens: bool = False) -> None:
        self.min_delay_s, self.listens = min_delay_s, listens
        check_numbers(self, not_negative=("min_delay_s",))
        check_count("TeamClock.members", members, most=MAX_MEMBERS)
        self._ahead = OffsetBound(members)

    def hear(self, stamp_s: float, own_s: Array, rows: IntArray | None = None) -> None:
        """Take in that a message arrived.

        Args:
            stamp_s: the team's time of its image, as its sender knew it.
            own_s: (N,) what the members' own clocks show.
            rows: members that it arrived at; all if None.
        """
        at = slice(None) if rows is None else rows
        self._ahead.tighten(stamp_s + self.min_delay_s - own_s[at], own_s, at)

    def time_s(self, own_s: Array) -> Array:
        """The team's time (N,), by what the members' own clocks show (N,); these until it has heard."""
        ahead_s = self._ahead.at(own_s)
        is_own = np.isneginf(ahead_s) if self.listens else ahead_s < TIME_TOLERANCE_S
        return own_s + np.where(is_own, 0.0, ahead_s)
