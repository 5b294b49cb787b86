"""One aerial unit's computer without sockets: detections, messages and clock readings in, messages out.

The decisions are the simulator's `AerialController`, and so is the team's time (`skyherd.control.TeamClock`),
which stamps the units' reports, so that slots and turns are the same for all of them however their clocks
differ. What robots receive has the time of the image by the unit's own clock, which they compare with theirs.
What is added here is what a live unit needs around it: clocks that are not to be trusted, and images that are
not worth deciding on, are left out.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.control import AerialController, Decision
from skyherd.live.peers import ClockLimits, PeerClocks
from skyherd.live.robot_core import FUTURE_S
from skyherd.live.wire import Envelope, Heartbeat, Message, Sighting
from skyherd.messages import Detections, UnitReport


@dataclass(frozen=True)
class UnitNews:
    """What a unit decided on an image.

    Attributes:
        decision: of its controller.
        messages: to robots and units, in the order in which they are to be sent.
    """

    decision: Decision
    messages: tuple[Message, ...]


class UnitCore:
    """One unit, from the markers in its images to what it sends.

    Everything that it does follows from the calls, so that a recording of them gives the same again.

    Attributes:
        unit_id: its number.
        clocks: what it knows of the others' clocks.
        trouble: why the last image was not decided on, or a report not used; empty if nothing is wrong.

    Args:
        unit_id: as the attribute.
        controller: decides.
        oldest_s: age up to which an image is worth deciding on.
        clock_limits: when another clock is not trusted.
    """

    def __init__(
        self, unit_id: int, controller: AerialController, *, oldest_s: float, clock_limits: ClockLimits
    ) -> None:
        self.unit_id, self.name, self.trouble = unit_id, f"unit/{unit_id}", ""
        self.clocks = PeerClocks(self.name, clock_limits)
        self._controller, self._oldest_s = controller, oldest_s
        self._reports: dict[int, UnitReport] = {}
        self._imaged_s = float("-inf")

    def receive(self, envelope: Envelope, now_s: float) -> None:
        """Take in a message that arrives now."""
        self.clocks.hear(envelope, now_s)
        message = envelope.message
        if not isinstance(message, UnitReport) or message.unit_id == self.unit_id:
            return
        if why := self.clocks.distrust(envelope.sender, now_s):
            self.trouble = why
            return
        ahead_s = message.time_s - now_s
        if ahead_s > self.clocks.limits.offset_s + FUTURE_S:
            self.trouble = f"{envelope.sender} tells of an image {ahead_s:.2g} s from now"
            return
        if self._controller.clock is not None:
            self._controller.clock.hear(message.time_s, np.array([now_s]))
        last = self._reports.get(message.unit_id)
        if last is None or message.time_s >= last.time_s:
            self._reports[message.unit_id] = message

    def heartbeat(self, now_s: float, state: str) -> Heartbeat:
        """A sign of life of this unit."""
        return Heartbeat(self.clocks.heard(now_s), state)

    def see(self, detections: Detections, now_s: float) -> UnitNews | None:
        """Decide on the markers of an image, whose time is by this unit's clock; None if it is left out."""
        age_s = now_s - detections.time_s
        if age_s > self._oldest_s:
            self.trouble = f"image {age_s:.2g} s old"
            return None
        if age_s < -FUTURE_S:
            self.trouble = f"image {-age_s:.2g} s from now"
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
        news: list[Message] = [sighting]
        news += [message for message in (decision.goals, decision.proximity) if message is not None]
        return UnitNews(decision, (*news, decision.report))


def _stamped(decision: Decision, time_s: float) -> Decision:
    """The same decision by a unit's own time of the image, but for its report, which keeps the team's."""
    goals, proximity = decision.goals, decision.proximity
    return replace(
        decision,
        detections=replace(decision.detections, time_s=time_s),
        goals=None if goals is None else replace(goals, time_s=time_s),
        proximity=None if proximity is None else replace(proximity, time_s=time_s),
    )
