"""What one process knows of the others' clocks, by the stamps on their messages."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from skyherd.live.wire import Envelope, Heartbeat
from skyherd.messages import MotionGoals, Proximity
from skyherd.messages.clock_offset import ClockOffset, OffsetEstimate

M = TypeVar("M", MotionGoals, Proximity)

FORGET_S = 60.0
"""A process that was silent for so long is forgotten, s. Chosen: a restart takes seconds, and a day of
restarts under new names fills no memory."""

MAX_PEERS = 2000
"""Processes that are remembered at most. Chosen: twice the robots of the largest team that is simulated."""


@dataclass(frozen=True)
class ClockLimits:
    """When another clock is not to be trusted.

    Attributes:
        offset_s: greatest offset; a clock that is farther off was set wrongly, and what it says is not used.
        uncertainty_s: greatest uncertainty of the offset at which stamps still mean something.
    """

    offset_s: float = 1.0
    uncertainty_s: float = 0.1


class PeerClocks:
    """Offsets of the clocks of all processes that one process hears.

    Attributes:
        name: of this process.
        limits: when a clock is not to be trusted.
    """

    def __init__(self, name: str, limits: ClockLimits) -> None:
        self.name, self.limits = name, limits
        self._offsets: dict[str, ClockOffset] = {}
        self._last: dict[str, tuple[float, float]] = {}

    def hear(self, envelope: Envelope, now_s: float) -> None:
        """Take in the stamps of a message that arrived now."""
        if envelope.sender not in self._offsets and len(self._offsets) >= MAX_PEERS:
            return
        offset = self._offsets.setdefault(envelope.sender, ClockOffset())
        offset.hear(envelope.sent_s, now_s)
        self._last[envelope.sender] = envelope.sent_s, now_s
        if isinstance(envelope.message, Heartbeat) and self.name in envelope.message.heard:
            our_sent_s, their_received_s = envelope.message.heard[self.name]
            if our_sent_s <= now_s:  # else it is of a run of ours with another clock
                offset.confirm(our_sent_s, their_received_s, now_s)

    def heard(self, now_s: float) -> Mapping[str, tuple[float, float]]:
        """By process, the stamps of its last message; those that fell silent are forgotten."""
        for name in [name for name, (_, at_s) in self._last.items() if at_s < now_s - FORGET_S]:
            del self._last[name], self._offsets[name]
        return dict(self._last)

    def estimate(self, name: str, now_s: float) -> OffsetEstimate:
        """What is known of one process's clock."""
        offset = self._offsets.get(name)
        return OffsetEstimate(0.0, float("inf")) if offset is None else offset.estimate(now_s)

    def resets(self) -> int:
        """How often a clock was set, in all."""
        return sum(offset.resets for offset in self._offsets.values())

    def distrust(self, name: str, now_s: float) -> str | None:
        """Why the stamps of a process are not used now; None where they are."""
        known = self.estimate(name, now_s)
        if not known.is_known:
            return f"clock of {name} not compared yet"
        if abs(known.offset_s) - known.uncertainty_s > self.limits.offset_s:
            return f"clock of {name} is {known.offset_s:+.2g} s off, more than {self.limits.offset_s:g} s"
        if known.uncertainty_s > self.limits.uncertainty_s:
            return f"clock of {name} is known to {known.uncertainty_s:.2g} s only"
        return None

    def in_our_time(self, message: M, name: str, now_s: float) -> M:
        """The same message, with the time of its image by our clock."""
        return replace(message, time_s=message.time_s - self.estimate(name, now_s).offset_s)
