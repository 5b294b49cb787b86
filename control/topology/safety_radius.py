"""Which robots a unit controls: those within a safety radius of its image centre (paper, Section VII).

A robot enters the set inside the radius and may leave it outside a wider one (hysteresis). Sets change only
at instants of a clock common to all units, a dwell time apart, so that every topology is kept for at
least that long. A unit keeps a robot, however far out, unless another reports to hold it securely; one that
it did not detect just now is where it was last seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.template import Template
from skyherd.geometry import Array, IntArray
from skyherd.messages import Detections, UnitReport, centred

NO_ROBOTS: IntArray = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class SafetyRadius:
    """Settings of the rule.

    Attributes:
        radius: as a fraction of half the image's shorter side.
        hysteresis: a robot may leave at `radius (1 + hysteresis)`.
        dwell_s: least time between changes, and how long a robot that is not detected counts as where it was.
    """

    radius: float = 0.85
    hysteresis: float = 0.06
    dwell_s: float = 2.0


def centre_distances(seen: Detections | UnitReport) -> Array:
    """Distances (N,) of the robots seen from the image centre, in halves of the image's shorter side."""
    points_px = seen.centers_px if isinstance(seen, Detections) else seen.points_px
    return np.asarray(np.linalg.norm(centred(points_px, seen.image_size_px), axis=1))


@dataclass
class ControlSet:
    """S_j^c of one unit as it evolves."""

    rule: SafetyRadius
    ready: bool = field(default=True, init=False)
    searches: bool = field(default=False, init=False)
    sought: IntArray = field(default_factory=lambda: NO_ROBOTS, init=False)
    ids: IntArray = field(default_factory=lambda: NO_ROBOTS, init=False)
    _slot: int | None = field(default=None, init=False)
    _last_seen: dict[int, tuple[float, float]] = field(default_factory=dict, init=False)

    def update(self, seen: Detections, reports: Sequence[UnitReport]) -> IntArray:
        """S_j^c after an image, given what the other units reported last."""
        for robot, distance in zip(seen.ids.tolist(), centre_distances(seen).tolist(), strict=True):
            self._last_seen[robot] = (seen.time_s, distance)
        slot = int(np.floor(seen.time_s / self.rule.dwell_s + 1e-9))
        if slot != self._slot:
            started = self._slot is not None
            self._slot = slot
            self.ids = self._select(seen, reports) if started else self._inside(seen)
        return self.ids

    def secure(self, seen: Detections) -> IntArray:
        """Robots of the set that are well held now: detected inside the radius."""
        return np.intersect1d(self.ids, self._inside(seen))

    def reshape(self, template: Template) -> None:
        """Sets do not depend on the shape."""

    def word(self, time_s: float) -> None:
        """No word of a tree: sets overlap as they will."""

    def note(self, time_s: float, own: UnitReport, reports: Sequence[UnitReport]) -> None:
        """Sets do not depend on V."""

    def _inside(self, seen: Detections) -> IntArray:
        return np.sort(seen.ids[centre_distances(seen) < self.rule.radius])

    def _select(self, seen: Detections, reports: Sequence[UnitReport]) -> IntArray:
        """The robots inside, and of those held so far all that may not leave."""
        secured = np.concatenate([NO_ROBOTS, *(report.secure_ids for report in reports)])
        leaving = [robot for robot in self.ids.tolist() if self._is_out(robot, seen.time_s)]
        kept = np.setdiff1d(self.ids, np.intersect1d(leaving, secured))
        return np.union1d(kept, self._inside(seen)).astype(np.int64)

    def _is_out(self, robot: int, time_s: float) -> bool:
        """Whether a robot was last seen outside the leaving radius, or not at all for a dwell time."""
        at_s, distance = self._last_seen.get(robot, (-np.inf, np.inf))
        unseen = time_s - at_s >= self.rule.dwell_s
        return unseen or distance >= self.rule.radius * (1 + self.rule.hysteresis)
