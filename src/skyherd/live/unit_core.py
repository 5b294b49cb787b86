"""The computer of one aerial unit without sockets: detections, messages and clock readings in, messages out.

The decisions are the simulator's (`AerialController`), and so is the team's time
(`skyherd.control.TeamClock`), which stamps the units' reports: slots and turns are the same for all units,
whatever their clocks show. Robots receive the time of the image by the unit's own clock, which they compare
with theirs. A live unit leaves out reports with times that it does not trust, and images that are too old to
decide on. While a stop is in force it sends no goals.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from skyherd.control import AerialController, Decision
from skyherd.live.peers import CONFLICT_S, ClockLimits, PeerClocks
from skyherd.live.robot_core import FUTURE_S, MAX_GAP_S
from skyherd.live.stop_latch import NO_COMMAND, StopLatch
from skyherd.live.wire import Envelope, Heartbeat, Message, Sighting
from skyherd.messages import Detections, UnitReport


@dataclass(frozen=True)
class UnitNews:
    """A unit's decision on one image, and the messages that follow.

    Attributes:
        decision: of its controller.
        messages: to robots and units, in the order in which they are to be sent.
    """

    decision: Decision
    messages: tuple[Message, ...]


class UnitCore:
    """One unit, from the markers in its images to the messages that it sends.

    Its decisions follow from the calls alone, so that a recording of the calls gives the same decisions.

    Attributes:
        unit_id: its number.
        clocks: what it knows of the other processes' clocks.
        latch: the commands that it knows of.
        trouble: why the last image was not decided on, or a report not used; empty if nothing is wrong.

    Args:
        unit_id: as the attribute.
        controller: decides.
        oldest_s: age up to which an image is decided on.
        clock_limits: when another clock is not trusted.
    """

    def __init__(
        self, unit_id: int, controller: AerialController, *, oldest_s: float, clock_limits: ClockLimits
    ) -> None:
        self.unit_id, self.name, self.trouble = unit_id, f"unit/{unit_id}", ""
        self.clocks = PeerClocks(self.name, clock_limits)
        self.latch: StopLatch = NO_COMMAND
        self._controller, self._oldest_s = controller, oldest_s
        self._reports: dict[int, UnitReport] = {}
        self._imaged_s = self._namesake_s = -math.inf
        self._called_s: float | None = None
        self._woke_s, self._heard_since_woken = math.inf, False

    def withheld(self, now_s: float) -> str:
        """Return why the unit sends no goals; empty if it does."""
        if self.latch.stopped:
            return "stopped"
        if now_s - self._namesake_s <= CONFLICT_S:
            return f"another process is named {self.name}"
        return "" if self._heard_since_woken else "no heartbeat since the process started or woke up"

    def receive(self, envelope: Envelope, now_s: float) -> None:
        """Take in a message that arrives now."""
        self.latch = self.latch.merge(envelope.latch)
        if envelope.sender == self.name:
            self._namesake_s = now_s
            return
        self._note_call(now_s)
        self.clocks.hear(envelope, now_s)
        self._heard_since_woken |= self.clocks.was_sent_after(envelope, self._woke_s, now_s)
        message = envelope.message
        if not isinstance(message, UnitReport) or message.unit_id == self.unit_id:
            return
        if why := self.clocks.distrust(envelope.sender, now_s):
            self.trouble = why
            return
        ahead_s = message.time_s - now_s
        if ahead_s > self.clocks.limits.offset_s + FUTURE_S:
            self.trouble = f"image of {envelope.sender} is {ahead_s:.2g} s in the future"
            return
        if self._controller.clock is not None:
            self._controller.clock.hear(message.time_s, np.array([now_s]))
        last = self._reports.get(message.unit_id)
        if last is None or message.time_s >= last.time_s:
            self._reports[message.unit_id] = message

    def heartbeat(self, now_s: float, state: str) -> Heartbeat:
        """Return a sign of life of this unit."""
        self._note_call(now_s)
        return Heartbeat(self.clocks.heard(now_s), state)

    def see(self, detections: Detections, now_s: float) -> UnitNews | None:
        """Decide on the markers of an image with a time by this unit's clock; None if it is left out."""
        self._note_call(now_s)
        age_s = now_s - detections.time_s
        if age_s > self._oldest_s:
            self.trouble = f"stale image: {age_s:.2g} s old"
            return None
        if age_s < -FUTURE_S:
            self.trouble = f"image {-age_s:.2g} s in the future"
            return None
        if detections.time_s <= self._imaged_s:
            self.trouble = "image older than one before"
            return None
        self.trouble = ""
        self._imaged_s = detections.time_s
        decision = self._controller.step(detections, list(self._reports.values()))
        decision = _stamped(decision, detections.time_s)
        sighting = Sighting(
            self.unit_id,
            detections.time_s,
            detections.unambiguous().ids,
            np.unique(detections.ids[detections.repeated]),
        )
        commands = () if self.withheld(now_s) else (decision.goals, decision.proximity)
        news = [message for message in commands if message is not None]
        return UnitNews(decision, (sighting, *news, decision.report))

    def _note_call(self, now_s: float) -> None:
        """Notice from the time since the last call that the process started, slept, or had its clock set."""
        last_s, self._called_s = self._called_s, now_s
        if last_s is None or not 0 <= now_s - last_s <= max(MAX_GAP_S, self._oldest_s):
            self._woke_s, self._heard_since_woken = now_s, False


def _stamped(decision: Decision, time_s: float) -> Decision:
    """Return the decision by the unit's own time of the image; its report keeps the team's time."""
    goals, proximity = decision.goals, decision.proximity
    return replace(
        decision,
        detections=replace(decision.detections, time_s=time_s),
        goals=None if goals is None else replace(goals, time_s=time_s),
        proximity=None if proximity is None else replace(proximity, time_s=time_s),
    )
