"""Control sets by a safety radius: a unit controls the robots near its image centre (paper, Section VII)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.policy import NO_ROBOTS, Selection, SelectionPolicy
from skyherd.control.topology.slots import slot_at
from skyherd.geometry import IntArray
from skyherd.messages import Detections, UnitReport, among
from skyherd.messages.checks import check_numbers


@dataclass
class SafetyRadius(SelectionPolicy):
    """Control set of one unit: the robots inside a radius about its image centre.

    Sets of several units overlap freely. A robot enters the set inside `radius`. It may leave outside `radius
    (1 + hysteresis)`, or after a dwell time without detection. The set changes only at the first image of a
    slot (control/topology/slots.py). Every topology therefore lasts at least a dwell time; with unequal frame
    rates, minus one image period. A unit releases a robot only if another unit reports it inside its own
    radius. Two units therefore cannot both release a robot to each other.

    Attributes:
        radius: in halves of the image's shorter side. Chosen: inside the image with room for a robot to move
            during a dwell time; at half of it units share too few robots.
        hysteresis: share of the radius. Chosen: larger than the motion of a robot in the image in one step.
        dwell_s: length of a slot, and time for which an undetected robot counts at its last position.
    """

    radius: float = 0.85
    hysteresis: float = 0.06
    dwell_s: float = 2.0
    _ids: IntArray = field(default_factory=lambda: NO_ROBOTS, init=False)
    _slot: int | None = field(default=None, init=False)
    _last_seen: dict[int, tuple[float, float]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        check_numbers(self, positive=("radius", "dwell_s"), not_negative=("hysteresis",))

    def choose(
        self, seen: Detections, reports: Sequence[UnitReport], shape: Template, last: UnitReport | None
    ) -> Selection:
        """Return the control set after an image; its robots inside the radius now are secure."""
        distances = seen.centre_distances
        inside = np.sort(seen.ids[distances < self.radius])
        for robot, distance in zip(seen.ids.tolist(), distances.tolist(), strict=True):
            self._last_seen[robot] = (seen.time_s, distance)
        slot = slot_at(seen.time_s, self.dwell_s)
        if slot != self._slot:
            self._ids = inside if self._slot is None else self._next_set(inside, seen.time_s, reports)
            self._slot = slot
        return Selection(self._ids, self._ids[among(self._ids, inside)])

    def _next_set(self, inside: IntArray, time_s: float, reports: Sequence[UnitReport]) -> IntArray:
        """Return the robots inside, and the present robots that may not be released.

        A present robot is kept while it is inside the leaving radius, or if no other unit holds it securely.
        """
        secured = np.concatenate([NO_ROBOTS, *(report.secure_ids for report in reports)])
        leaving = [robot for robot in self._ids.tolist() if self._may_leave(robot, time_s)]
        kept = np.setdiff1d(self._ids, np.intersect1d(leaving, secured))
        return np.union1d(kept, inside).astype(np.int64)

    def _may_leave(self, robot: int, time_s: float) -> bool:
        """Return whether a robot was last seen outside the leaving radius, or not at all for a dwell time."""
        seen_s, distance = self._last_seen[robot]
        return time_s - seen_s >= self.dwell_s or distance >= self.radius * (1 + self.hysteresis)
