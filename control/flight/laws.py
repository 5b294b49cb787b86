"""Flight laws of the paper and its companion: hover, follow the robots, fly along their convex hull.

Lengths are in halves of the image's shorter side, measured from the image centre. Gains therefore do not
depend on the camera. The autopilot is part of the world. `skyherd.control.policy.FlightLaw` is the contract
of a law.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from skyherd.control.policy import NO_ROBOTS, FlightLaw, FlightTask
from skyherd.geometry import Array, IntArray
from skyherd.messages import Detections, FlightCommand, UnitReport, among
from skyherd.messages.checks import check_numbers


@dataclass(frozen=True)
class Hover(FlightLaw):
    """Flight law that holds the position, with a constant turn rate if requested."""

    yaw_rate_radps: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(self, finite=("yaw_rate_radps",))

    def command(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        """Return a command without translation."""
        return FlightCommand.hold(seen.unit_id, self.yaw_rate_radps)


@dataclass
class Follow(FlightLaw):
    """Algorithm 1 of the companion paper (Aranda et al., T-RO 2015): keep certain robots in view.

    The unit keeps two groups in view: for each neighbour in the initial graph the two common robots nearest
    to the image centre, and the robots for which it is responsible. Let c be their centroid in the image and
    d the distance of the farthest one, both from the image centre. The lateral velocity is `lateral_gain c`
    and the climb `climb_gain (d - desired_radius)`.

    In the companion paper a unit is responsible for the robots that only it sees. Two units that see one
    robot may then each leave it to the other. One that descends hands all its robots to one that climbs. Here
    a robot that several units control at the start is permanently the responsibility of the unit that sees it
    nearest to its image centre. A robot that no other unit controls is always this unit's responsibility.

    Attributes:
        desired_radius: image distance of the farthest robot to keep, in halves of the image's shorter side.
        lateral_gain_mps: speed per half image of offset of the centroid.
        climb_gain_mps: climb per half image of excess of the farthest robot.
        dead_band: climb error without effect, so that noise does not move the unit.
    """

    desired_radius: float = 0.7
    lateral_gain_mps: float = 1.0
    climb_gain_mps: float = 1.0
    dead_band: float = 0.02
    _neighbors: dict[int, bool] = field(default_factory=dict, init=False)
    _responsible_for: IntArray = field(default_factory=lambda: NO_ROBOTS, init=False)
    _start: dict[int, float] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        gains = ("lateral_gain_mps", "climb_gain_mps", "dead_band")
        check_numbers(self, positive=("desired_radius",), not_negative=gains)

    def command(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        """Return a command towards the centroid of the robots to keep, with a climb to keep them in view."""
        controlled = task.controlled_ids
        if self._start is None:
            self._start, self._responsible_for = _distances(seen), controlled
        for report in reports:
            if report.unit_id not in self._neighbors:
                shared = np.intersect1d(controlled, report.controlled_ids)
                self._neighbors[report.unit_id] = shared.size >= 2
                self._responsible_for = np.setdiff1d(
                    self._responsible_for, _nearer_there(shared, self._start, seen.unit_id, report)
                )
        kept = self._robots_to_keep(seen, controlled, reports)
        keep = among(seen.ids, kept.union(task.sought_ids.tolist()))
        if not keep.any():
            return FlightCommand.hold(seen.unit_id)
        points = seen.centred[keep]
        excess = float(seen.centre_distances[keep].max()) - self.desired_radius
        climb = excess - min(max(excess, -self.dead_band), self.dead_band)
        return FlightCommand(
            seen.unit_id,
            self.lateral_gain_mps * points.mean(axis=0) + task.drift_mps,
            climb_mps=self.climb_gain_mps * climb,
            yaw_rate_radps=0.0,
        )

    def _robots_to_keep(
        self, seen: Detections, controlled: IntArray, reports: Sequence[UnitReport]
    ) -> set[int]:
        """Return the robots for which this unit is responsible, and two in common with each neighbour."""
        ours = set(controlled.tolist())
        theirs = [report.controlled for report in reports]
        keep = set(self._responsible_for.tolist()) | ours.difference(*theirs)
        nearest_first = seen.ids[np.argsort(seen.centre_distances)].tolist()
        for report, members in zip(reports, theirs, strict=True):
            if self._neighbors.get(report.unit_id, False):
                common = ours & members
                if len(common) < 2:
                    common = set(report.ids.tolist())
                keep.update([robot for robot in nearest_first if robot in common][:2])
        return keep


def _distances(seen: Detections | UnitReport) -> dict[int, float]:
    """Return the distance from the image centre of each robot seen."""
    return dict(zip(seen.ids.tolist(), seen.centre_distances.tolist(), strict=True))


def _nearer_there(shared: IntArray, start: dict[int, float], unit_id: int, report: UnitReport) -> IntArray:
    """Return the robots of `shared` that the reporting unit saw nearer to its image centre.

    Ties go to the lower unit.

    Both units compare their own first images. Each robot is therefore the responsibility of exactly one of
    the two.
    """
    there = _distances(report)
    theirs = [
        robot
        for robot in shared.tolist()
        if (there.get(robot, np.inf), report.unit_id) < (start.get(robot, np.inf), unit_id)
    ]
    return np.array(theirs, dtype=np.int64)


@dataclass(frozen=True)
class Perimeter(FlightLaw):
    """Flight law along the perimeter of the robots' convex hull (the paper's one-camera case).

    The velocity is along the hull's edge nearest to the image centre, plus a pull towards that edge. The unit
    may turn slowly.

    Attributes:
        desired_radius: image distance of the farthest robot, regulated by the height.
        speed_mps: speed along the perimeter.
        lateral_gain_mps: pull per half image of distance from the perimeter.
        climb_gain_mps: climb per half image of excess of the farthest robot.
        yaw_rate_radps: turn rate, counter-clockwise seen from above.
    """

    desired_radius: float = 0.7
    speed_mps: float = 0.1
    lateral_gain_mps: float = 1.0
    climb_gain_mps: float = 1.0
    yaw_rate_radps: float = 0.0

    def __post_init__(self) -> None:
        gains = ("lateral_gain_mps", "climb_gain_mps")
        rates = ("speed_mps", "yaw_rate_radps")
        check_numbers(self, positive=("desired_radius",), not_negative=gains, finite=rates)

    def command(self, seen: Detections, task: FlightTask, reports: Sequence[UnitReport]) -> FlightCommand:
        """Return the velocity along the hull of the controlled robots."""
        robots = seen.select(task.controlled_ids)
        points = robots.centred
        edge = _nearest_hull_edge(points)
        if edge is None:
            return FlightCommand.hold(seen.unit_id, self.yaw_rate_radps)
        foot, along = edge
        excess = float(np.linalg.norm(points, axis=1).max()) - self.desired_radius
        return FlightCommand(
            seen.unit_id,
            self.speed_mps * along + self.lateral_gain_mps * foot + task.drift_mps,
            climb_mps=self.climb_gain_mps * excess,
            yaw_rate_radps=self.yaw_rate_radps,
        )


def _nearest_hull_edge(points: Array) -> tuple[Array, Array] | None:
    """Return the hull's boundary point nearest to the origin and the unit vector along its edge, or None."""
    try:
        corners = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return None
    along = np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(along, axis=1)
    at = np.clip(-np.einsum("nd,nd->n", corners, along) / length**2, 0.0, 1.0)
    feet = corners + at[:, None] * along
    nearest = int(np.argmin(np.linalg.norm(feet, axis=1)))
    return feet[nearest], along[nearest] / length[nearest]
