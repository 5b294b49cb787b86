"""Control sets by a safety radius: a unit controls the robots near its image centre (paper, Section VII)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.control.policy import NO_ROBOTS, Selection, SelectionPolicy
from skyherd.control.topology.slots import slot_at
from skyherd.geometry import Array, IntArray
from skyherd.messages import Detections, UnitReport, centred
from skyherd.messages.checks import check_numbers


def centre_distances(seen: Detections | UnitReport) -> Array:
    """Distances (N,) of the robots seen from the image centre, in halves of the image's shorter side."""
    points_px = seen.centers_px if isinstance(seen, Detections) else seen.points_px
    return np.asarray(np.linalg.norm(centred(points_px, seen.image_size_px), axis=1))


@dataclass
class SafetyRadius(SelectionPolicy):
    """One unit's control set: the robots inside a radius about its image centre.

    Sets of several units overlap freely. A robot enters the set inside `radius`, and may leave it outside
    `radius (1 + hysteresis)`, or once it has not been detected for a dwell time. The set changes only at the
    first image of a slot (control/topology/slots.py), a dwell time apart, so that every topology lasts for at
    least that long; with units of unequal frame rates, less one image. A unit gives up a robot only if
    another one reports to hold it inside its own radius, so that no robot is left to nobody because two units
    each count on the other.

    Attributes:
        radius: in halves of the image's shorter side. Chosen: inside the image with room for a robot to move
            during a dwell time; at half of it units share too few robots.
        hysteresis: share of the radius. Chosen: larger than what a robot moves in the image in one step.
        dwell_s: length of a slot, and how long a robot that is not detected counts as where it was seen last.
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
        """The control set after an image; the robots of it that are inside the radius now are secure."""
        distances = centre_distances(seen)
        inside = np.sort(seen.ids[distances < self.radius])
        for robot, distance in zip(seen.ids.tolist(), distances.tolist(), strict=True):
            self._last_seen[robot] = (seen.time_s, distance)
        slot = slot_at(seen.time_s, self.dwell_s)
        if slot != self._slot:
            self._ids = inside if self._slot is None else self._next_set(inside, seen.time_s, reports)
            self._slot = slot
        return Selection(self._ids, np.intersect1d(self._ids, inside))

    def _next_set(self, inside: IntArray, time_s: float, reports: Sequence[UnitReport]) -> IntArray:
        """The robots inside, and of those controlled so far all that may not be given up.

        Those are still inside the leaving radius, or no other unit holds them securely.
        """
        secured = np.concatenate([NO_ROBOTS, *(report.secure_ids for report in reports)])
        leaving = [robot for robot in self._ids.tolist() if self._may_leave(robot, time_s)]
        kept = np.setdiff1d(self._ids, np.intersect1d(leaving, secured))
        return np.union1d(kept, inside).astype(np.int64)

    def _may_leave(self, robot: int, time_s: float) -> bool:
        """Whether a robot was last seen outside the leaving radius, or not at all for a dwell time."""
        seen_s, distance = self._last_seen.get(robot, (-np.inf, np.inf))
        return time_s - seen_s >= self.dwell_s or distance >= self.radius * (1 + self.hysteresis)
