"""Decisions of one aerial unit without I/O: detections, messages and clock readings in, messages out.

The controller is the simulator's (`AerialController`). The team clock (`skyherd.control.TeamClock`) stamps
the units' reports, so that slots and turns agree between units whose clocks differ. Messages to robots carry
the time of the image on the unit's own clock, which each robot compares with its clock. A live unit ignores
reports with untrusted times, and stale images. While a stop is in force it sends no goals, and hovers if it
flies. While it suspects its camera (`skyherd.control.camera_check`) it sends only heartbeats. Robots count
there only while their heartbeats say that they drive. A suspicion that recurs is latched, until the unit
receives an arm command that clears a newer stop than all that were cleared before.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from skyherd.control import AerialController, Decision
from skyherd.live.peers import CONFLICT_S, ClockLimits, PeerClocks
from skyherd.live.plausible import Roster
from skyherd.live.robot_core import DRIVING, FUTURE_S, MAX_GAP_S
from skyherd.live.stop_latch import NO_COMMAND, StopLatch
from skyherd.live.wire import Envelope, Heartbeat, Message
from skyherd.messages import Detections, FlightCommand, Sighting, UnitReport

HEARTBEAT_LIFE_S = 1.0
"""Time for which a robot's heartbeat shows that it drives, s. Chosen: four heartbeats."""

CLEAR_CAMERA = ": repair the camera, then stop the team and arm it again"
"""End of the reason why a unit sends nothing while a suspicion of its camera is latched."""


@dataclass(frozen=True)
class UnitNews:
    """A unit's decision on one image, and the resulting messages.

    Attributes:
        decision: decision of its controller.
        messages: messages to robots and units, in the order of sending.
    """

    decision: Decision
    messages: tuple[Message, ...]


class UnitCore:
    """Decisions of one unit, from the markers in its images to messages.

    Decisions depend only on the calls, so that a replay of recorded calls reproduces them.

    Attributes:
        unit_id: its number.
        clocks: estimated offsets of the other processes' clocks.
        latch: commands known to the unit.
        trouble: reason why the last image or report was not used; empty without one.

    Args:
        unit_id: as the attribute.
        controller: makes the decisions.
        oldest_s: age above which an image is stale.
        clock_limits: limits of trust in another clock.
        lab: digest of the lab file.
        unit_ids: numbers of the team's units; None if they are not known.
    """

    def __init__(
        self,
        unit_id: int,
        controller: AerialController,
        *,
        oldest_s: float,
        clock_limits: ClockLimits,
        lab: str = "",
        unit_ids: Iterable[int] | None = None,
    ) -> None:
        self.unit_id, self.name, self.trouble = unit_id, f"unit/{unit_id}", ""
        self.clocks, self._lab = PeerClocks(self.name, clock_limits, lab), lab
        self.latch: StopLatch = NO_COMMAND
        self._controller, self._oldest_s = controller, oldest_s
        units = None if unit_ids is None else frozenset(unit_ids)
        self._roster = Roster(frozenset(controller.template.ids.tolist()), units)
        self._reports: dict[int, UnitReport] = {}
        self._driving_s: dict[int, float] = {}
        self._imaged_s = self._namesake_s = -math.inf
        self._called_s: float | None = None
        self._woke_s, self._heard_since_woken = math.inf, False

    def withheld(self, now_s: float) -> str:
        """Return the reason why the unit sends no goals, or an empty string."""
        if self.latch.stopped:
            return "stopped"
        if now_s - self._namesake_s <= CONFLICT_S:
            return f"another process is named {self.name}"
        return "" if self._heard_since_woken else "no heartbeat since the process started or woke up"

    def receive(self, envelope: Envelope, now_s: float) -> None:
        """Process a message that arrives now. A new arm command after a stop ends suspicion of the camera."""
        before, self.latch = self.latch, self.latch.merge(envelope.latch)
        if self.latch.is_armed_since(before) and self._controller.camera_check is not None:
            self._controller.camera_check.reset()
        if envelope.sender == self.name:
            self._namesake_s = now_s
            return
        self._note_call(now_s)
        self.clocks.hear(envelope, now_s)
        self._heard_since_woken |= self.clocks.was_sent_after(envelope, self._woke_s, now_s)
        message = envelope.message
        if isinstance(message, Heartbeat):
            self._note_robot(envelope.sender, message, now_s)
        if not isinstance(message, UnitReport) or message.unit_id == self.unit_id:
            return
        if why := self.clocks.distrust(envelope.sender, now_s):
            self.trouble = why
            return
        ahead_s = message.time_s - now_s
        if ahead_s > self.clocks.limits.offset_s + FUTURE_S:
            self.trouble = f"image of {envelope.sender} is {ahead_s:.2g} s in the future"
            return
        if unknown := self._roster.unknown_in(message):
            self.trouble = f"report of {envelope.sender} with unknown ids ({unknown})"
            return
        if self._controller.clock is not None:
            self._controller.clock.hear(message.time_s, np.array([now_s]))
        last = self._reports.get(message.unit_id)
        if last is None or message.time_s >= last.time_s:
            self._reports[message.unit_id] = message

    def heartbeat(self, now_s: float, state: str) -> Heartbeat:
        """Return the next heartbeat of this unit."""
        self._note_call(now_s)
        return Heartbeat(self.clocks.heard(now_s), state, lab=self._lab)

    def see(self, detections: Detections, now_s: float) -> UnitNews | None:
        """Decide on the markers of an image, stamped by this unit's clock. None for a rejected image."""
        self._note_call(now_s)
        age_s = now_s - detections.time_s
        if age_s > self._oldest_s:
            self.trouble = f"stale image: {age_s:.2g} s old"
            return None
        if age_s < -FUTURE_S:
            self.trouble = f"image {-age_s:.2g} s in the future"
            return None
        if detections.time_s <= self._imaged_s:
            self.trouble = "image out of order: older than an earlier one"
            return None
        self.trouble = ""
        self._imaged_s = detections.time_s
        obeying = frozenset[int]() if self.withheld(now_s) else self._driving(now_s)
        decision = self._controller.step(detections, list(self._reports.values()), obeying_ids=obeying)
        decision = _stamped(decision, detections.time_s)
        if self.withheld(now_s):
            decision = replace(decision, flight=FlightCommand.hold(self.unit_id))
        if decision.suspicion:
            check = self._controller.camera_check
            is_latched = check is not None and check.is_latched
            self.trouble = decision.suspicion + CLEAR_CAMERA * is_latched
            return UnitNews(decision, ())
        single = detections.unambiguous()
        sighting = Sighting(
            unit_id=self.unit_id,
            time_s=detections.time_s,
            ids=single.ids,
            repeated_ids=np.array(sorted(detections.repeated_ids), dtype=np.int64),
            centers_px=single.centers_px,
            headings_rad=single.headings_rad,
            sides_px=single.sides_px,
        )
        commands = () if self.withheld(now_s) else (decision.goals, decision.proximity)
        news = [message for message in commands if message is not None]
        return UnitNews(decision, (sighting, *news, decision.report))

    def _note_robot(self, sender: str, heartbeat: Heartbeat, now_s: float) -> None:
        """Note whether a robot drives, by its heartbeat."""
        kind, _, number = sender.partition("/")
        if kind != "robot" or not number.isdecimal():
            return
        if heartbeat.armed and heartbeat.state == DRIVING:
            self._driving_s[int(number)] = now_s
        else:
            self._driving_s.pop(int(number), None)

    def _driving(self, now_s: float) -> frozenset[int]:
        """Return the robots that drive, by their recent heartbeats."""
        return frozenset(
            robot for robot, heard_s in self._driving_s.items() if now_s - heard_s <= HEARTBEAT_LIFE_S
        )

    def _note_call(self, now_s: float) -> None:
        """Detect a start, a sleep or a clock reset from the time since the last call."""
        last_s = self._called_s
        if last_s is not None and 0 < last_s - now_s <= MAX_GAP_S:
            return  # a message that waited while the unit worked on an image
        self._called_s = now_s
        if last_s is None or not 0 <= now_s - last_s <= max(MAX_GAP_S, self._oldest_s):
            self._woke_s, self._heard_since_woken = now_s, False


def _stamped(decision: Decision, time_s: float) -> Decision:
    """Return the decision with the image time on the unit's own clock. The report keeps the team's time."""
    goals, proximity = decision.goals, decision.proximity
    return replace(
        decision,
        detections=replace(decision.detections, time_s=time_s),
        goals=None if goals is None else replace(goals, time_s=time_s),
        proximity=None if proximity is None else replace(proximity, time_s=time_s),
    )
