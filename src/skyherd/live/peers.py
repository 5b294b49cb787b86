"""Knowledge about the other processes: the offsets of their clocks, and names used twice."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

from skyherd.live.wire import Envelope, Heartbeat
from skyherd.messages import MotionGoals, Proximity
from skyherd.messages.clock_offset import ClockOffset, OffsetEstimate

M = TypeVar("M", MotionGoals, Proximity)

FORGET_S = 60.0
"""Silence after which a process is forgotten, s. Chosen: well above the seconds of a restart. Restarts under
new names do not fill the memory."""

MAX_PEERS = 2000
"""Largest number of remembered processes. Chosen: twice the robots of the largest simulated team."""

CONFLICT_S = 3.0
"""Time for which a name conflict lasts after its last evidence, s. Chosen: a dozen heartbeats."""

MAX_FORMER = 8
"""Largest number of former instances kept per name. Chosen: more than restarts within `FORGET_S`."""


@dataclass(frozen=True)
class ClockLimits:
    """Limits beyond which another clock is not trusted.

    Attributes:
        offset_s: largest offset; a larger one means that the clock was set wrongly.
        uncertainty_s: largest uncertainty of the offset at which times are used.
    """

    offset_s: float = 1.0
    uncertainty_s: float = 0.1


@dataclass
class Instances:
    """The instances that sent messages under one name.

    A restart changes the instance once. Two processes of one name alternate, so that a former instance is
    heard again.

    Attributes:
        current: instance of the last message.
        former: earlier instances, the most recent one last.
        conflict_s: time at which a former instance was last heard again; -inf if never.
    """

    current: str
    former: list[str] = field(default_factory=list)
    conflict_s: float = -math.inf

    def hear(self, instance: str, now_s: float) -> None:
        """Process the instance of a message that arrives now."""
        if instance == self.current:
            return
        if instance in self.former:
            self.conflict_s = now_s
            self.former.remove(instance)
        self.former = [*self.former, self.current][-MAX_FORMER:]
        self.current = instance

    def conflict(self, now_s: float) -> bool:
        """Return whether two processes use the name now."""
        return now_s - self.conflict_s <= CONFLICT_S


class PeerClocks:
    """Estimated clock offsets of all processes that one process hears, and whose messages it trusts.

    Attributes:
        name: of this process.
        limits: limits of trust in a clock.

    Args:
        name: of this process.
        limits: of trust in a clock.
        lab: digest of the lab file of this process; processes with another one are not trusted.
    """

    def __init__(self, name: str, limits: ClockLimits, lab: str = "") -> None:
        self.name, self.limits, self._lab = name, limits, lab
        self._labs: dict[str, str] = {}
        self._offsets: dict[str, ClockOffset] = {}
        self._last: dict[str, tuple[float, float]] = {}
        self._instances: dict[str, Instances] = {}

    def hear(self, envelope: Envelope, now_s: float) -> None:
        """Process the time stamps of a message that arrives now."""
        sender = envelope.sender
        if sender not in self._offsets and len(self._offsets) >= MAX_PEERS:
            return
        self._instances.setdefault(sender, Instances(envelope.instance)).hear(envelope.instance, now_s)
        offset = self._offsets.setdefault(sender, ClockOffset())
        offset.hear(envelope.sent_s, now_s)
        self._last[sender] = envelope.sent_s, now_s
        if isinstance(envelope.message, Heartbeat):
            self._labs[sender] = envelope.message.lab
        if isinstance(envelope.message, Heartbeat) and self.name in envelope.message.heard:
            our_sent_s, their_received_s = envelope.message.heard[self.name]
            # A stamp in the future is from an earlier run of this process, with another clock.
            if our_sent_s <= now_s:
                offset.confirm(our_sent_s, their_received_s, now_s)

    def heard(self, now_s: float) -> Mapping[str, tuple[float, float]]:
        """Return the time stamps of the last message of each process, and forget silent processes."""
        for name in [name for name, (_, at_s) in self._last.items() if at_s < now_s - FORGET_S]:
            del self._last[name], self._offsets[name], self._instances[name]
            self._labs.pop(name, None)
        return dict(self._last)

    def estimate(self, name: str, now_s: float) -> OffsetEstimate:
        """Return the estimated clock offset of one process."""
        offset = self._offsets.get(name)
        return OffsetEstimate(0.0, float("inf")) if offset is None else offset.estimate(now_s)

    def resets(self) -> int:
        """Return the number of detected clock resets of all processes."""
        return sum(offset.resets for offset in self._offsets.values())

    def distrust(self, name: str, now_s: float) -> str | None:
        """Return the reason why the messages of a process are not used now, or None."""
        if name in self._instances and self._instances[name].conflict(now_s):
            return f"two processes are named {name}"
        if self._labs.get(name, "") not in ("", self._lab):
            return f"{name} has another lab file: end and start all processes"
        known = self.estimate(name, now_s)
        if not known.is_known:
            return f"clock of {name} is not compared yet"
        if abs(known.offset_s) - known.uncertainty_s > self.limits.offset_s:
            return f"clock of {name} is {known.offset_s:+.2g} s off, more than {self.limits.offset_s:g} s"
        if known.uncertainty_s > self.limits.uncertainty_s:
            return f"clock of {name} is uncertain by {known.uncertainty_s:.2g} s"
        return None

    def was_sent_after(self, envelope: Envelope, since_s: float, now_s: float) -> bool:
        """Return whether a message that arrives now was sent after a time on our clock."""
        if self.distrust(envelope.sender, now_s):
            return False
        known = self.estimate(envelope.sender, now_s)
        return envelope.sent_s - known.offset_s - known.uncertainty_s > since_s

    def in_our_time(self, message: M, name: str, now_s: float) -> M:
        """Return the message with the time of its image on this process's clock."""
        return replace(message, time_s=message.time_s - self.estimate(name, now_s).offset_s)
