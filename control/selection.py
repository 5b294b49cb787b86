"""Which robots a unit controls: those within a safety radius of its image centre (paper, Section VII).

A robot enters the set inside the radius and leaves it outside a wider one (hysteresis). Sets change only
at instants of a clock common to all units, a dwell time apart, so that every topology is kept for at
least that long. A unit keeps a robot, however far out, unless another reports to hold it securely.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.messages import Detections, UnitReport, centred

NO_ROBOTS: IntArray = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class SafetyRadius:
    """Settings of the rule.

    Attributes:
        radius: as a fraction of half the image's shorter side.
        hysteresis: a robot leaves at `radius (1 + hysteresis)`.
        dwell_s: least time between changes.
    """

    radius: float = 0.8
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
    ids: IntArray = field(default_factory=lambda: NO_ROBOTS)
    _slot: int | None = None

    def update(self, seen: Detections, reports: Sequence[UnitReport]) -> IntArray:
        """S_j^c after an image, given what the other units reported last."""
        slot = int(np.floor(seen.time_s / self.rule.dwell_s + 1e-9))
        if slot != self._slot:
            started = self._slot is not None
            self._slot = slot
            self.ids = self._select(seen, reports) if started else self._inside(seen)
        return self.ids

    def secure(self, seen: Detections) -> IntArray:
        """Robots of the set that stay in it whatever the others do: inside the radius."""
        return np.intersect1d(self.ids, self._inside(seen))

    def _inside(self, seen: Detections) -> IntArray:
        return np.sort(seen.ids[centre_distances(seen) < self.rule.radius])

    def _select(self, seen: Detections, reports: Sequence[UnitReport]) -> IntArray:
        leaving_radius = self.rule.radius * (1 + self.rule.hysteresis)
        within = seen.ids[centre_distances(seen) < leaving_radius]
        secured = np.concatenate([NO_ROBOTS, *(report.secure_ids for report in reports)])
        kept = np.intersect1d(self.ids, np.union1d(within, np.setdiff1d(self.ids, secured)))
        return np.union1d(kept, self._inside(seen))
