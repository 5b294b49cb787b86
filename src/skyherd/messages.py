"""Every value that passes between the parts: frozen, read-only, checked when made.

Frames: image u right, v down, an integer is a pixel centre, angles run from +u to +v; robot x forward,
y left, angles counter-clockwise. Units are in the names.
"""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from skyherd.encounter_messages import Encounters as Encounters
from skyherd.errors import MessageError
from skyherd.frozen import freeze, freeze_ids
from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.role_messages import RoleMap as RoleMap
from skyherd.tree_messages import NOBODY as NOBODY
from skyherd.tree_messages import TreeWord as TreeWord


@dataclass(frozen=True)
class Detections:
    """What one unit's detector found in one image: all that `control` ever sees of the world.

    Attributes:
        unit_id: the aerial unit whose image it is.
        time_s: when the image was taken.
        image_size_px: (2,) width and height.
        ids: (N,) marker ids, each once.
        centers_px: (N, 2) marker centres.
        headings_rad: (N,) direction of each robot's forward axis, from +u to +v.
        sides_px: (N,) side of the black square.
        corners_px: (N, 4, 2) corners, the first two ahead of the robot: left, right.
        covariances: (N, 3, 3) of (u, v, heading), in px², px·rad, rad².
    """

    unit_id: int
    time_s: float
    image_size_px: Array
    ids: IntArray
    centers_px: Array
    headings_rad: Array
    sides_px: Array
    corners_px: Array
    covariances: Array

    def __post_init__(self) -> None:
        n = freeze_ids(self, "ids")
        freeze(self, "image_size_px", (2,))
        freeze(self, "centers_px", (n, 2))
        freeze(self, "headings_rad", (n,))
        freeze(self, "sides_px", (n,))
        freeze(self, "corners_px", (n, 4, 2))
        freeze(self, "covariances", (n, 3, 3))
        if (self.sides_px <= 0).any():
            raise MessageError("Detections.sides_px: every side must be positive")

    def __len__(self) -> int:
        return int(self.ids.size)

    def select(self, ids: AbstractSet[int] | npt.ArrayLike) -> "Detections":
        """Keep only the robots named in `ids`, in the order found."""
        keep = among(self.ids, ids)
        if keep.all():
            return self
        return Detections(
            unit_id=self.unit_id,
            time_s=self.time_s,
            image_size_px=self.image_size_px,
            ids=self.ids[keep],
            centers_px=self.centers_px[keep],
            headings_rad=self.headings_rad[keep],
            sides_px=self.sides_px[keep],
            corners_px=self.corners_px[keep],
            covariances=self.covariances[keep],
        )


@dataclass(frozen=True)
class RobotGoal:
    """What one robot reads of one unit's `MotionGoals`: the message on the wire."""

    robot_id: int
    unit_id: int
    time_s: float
    rho_px: float
    bearing_rad: float
    side_px: float
    neighbor_ids: IntArray
    neighbor_distances_px: Array


@dataclass(frozen=True)
class MotionGoals:
    """Goals that one unit sends to the robots it controls (paper eq. 2-3), as arrays over robots.

    Attributes:
        unit_id: the sender.
        time_s: when its image was taken.
        ids: (N,) robots addressed.
        rho_px: (N,) length of the vector to the desired point, in the sender's pixels.
        bearings_rad: (N,) its direction in the robot's own frame, 0 ahead, positive to the left; the
            paper's angle is `alpha = pi - bearing`.
        sides_px: (N,) each robot's own marker side in the sender's image.
        neighbor_ids: (N, K) robots near each one in the image; -1 fills the row.
        neighbor_distances_px: (N, K) image distances to them; 0 where there is none.
    """

    unit_id: int
    time_s: float
    ids: IntArray
    rho_px: Array
    bearings_rad: Array
    sides_px: Array
    neighbor_ids: IntArray
    neighbor_distances_px: Array

    def __post_init__(self) -> None:
        n = freeze_ids(self, "ids")
        freeze(self, "rho_px", (n,))
        freeze(self, "bearings_rad", (n,))
        freeze(self, "sides_px", (n,))
        freeze(self, "neighbor_ids", (n, None), integer=True)
        freeze(self, "neighbor_distances_px", (n, self.neighbor_ids.shape[1]))
        if (self.rho_px < 0).any() or (self.sides_px <= 0).any():
            raise MessageError("MotionGoals: rho_px must not be negative, sides_px must be positive")

    def __len__(self) -> int:
        return int(self.ids.size)

    def for_robot(self, robot_id: int) -> RobotGoal:
        """Cut out the message for one robot; KeyError if this unit does not address it."""
        found = np.flatnonzero(self.ids == robot_id)
        if not found.size:
            raise KeyError(robot_id)
        row = int(found[0])
        near = self.neighbor_ids[row] >= 0
        return RobotGoal(
            robot_id=robot_id,
            unit_id=self.unit_id,
            time_s=self.time_s,
            rho_px=float(self.rho_px[row]),
            bearing_rad=float(self.bearings_rad[row]),
            side_px=float(self.sides_px[row]),
            neighbor_ids=self.neighbor_ids[row][near],
            neighbor_distances_px=self.neighbor_distances_px[row][near],
        )


@dataclass(frozen=True)
class VelocityCommand:
    """Wheel commands of the team: (N,) ids, forward speed and counter-clockwise turn rate."""

    ids: IntArray
    v_mps: Array
    omega_radps: Array

    def __post_init__(self) -> None:
        n = freeze_ids(self, "ids")
        freeze(self, "v_mps", (n,))
        freeze(self, "omega_radps", (n,))


@dataclass(frozen=True)
class UnitReport:
    """What one aerial unit tells the others.

    Attributes:
        unit_id: the sender.
        time_s: when its image was taken.
        image_size_px: (2,) width and height of its images.
        ids: (N,) robots it sees.
        points_px: (N, 2) where it sees them.
        controlled_ids: (M,) robots it controls.
        secure_ids: (L,) those of them that it sees inside its safety radius now.
        tree: its standing in the tree of units; None where sets come from the safety radius alone.
        cost_sides2: its share V_j of the cost function, in marker sides squared.
        side_px: a marker side in its image, as agreed with its neighbours; 0 where sizes are free.
        roles: the map from robots to template points that it follows; None where roles are fixed.
    """

    unit_id: int
    time_s: float
    image_size_px: Array
    ids: IntArray
    points_px: Array
    controlled_ids: IntArray
    secure_ids: IntArray
    tree: TreeWord | None = None
    cost_sides2: float = 0.0
    side_px: float = 0.0
    roles: RoleMap | None = None

    def __post_init__(self) -> None:
        n = freeze_ids(self, "ids")
        freeze(self, "image_size_px", (2,))
        freeze(self, "points_px", (n, 2))
        freeze_ids(self, "controlled_ids")
        freeze_ids(self, "secure_ids")

    @cached_property
    def controlled(self) -> frozenset[int]:
        """Robots it controls, as a set."""
        return frozenset(self.controlled_ids.tolist())

    @cached_property
    def distances(self) -> dict[int, float]:
        """Distances of the robots it sees from its image centre, in halves of its image's shorter side."""
        distances = np.linalg.norm(centred(self.points_px, self.image_size_px), axis=1)
        return dict(zip(self.ids.tolist(), distances.tolist(), strict=True))


@dataclass(frozen=True)
class FlightCommand:
    """Velocity that a unit asks of its own autopilot, in its camera's frame.

    Attributes:
        unit_id: the unit.
        lateral_mps: (2,) along the image's +u and +v.
        climb_mps: upwards.
        yaw_rate_radps: counter-clockwise seen from above.
        zoom_rate_ps: relative change of the focal length, 1/s.
    """

    unit_id: int
    lateral_mps: Array
    climb_mps: float
    yaw_rate_radps: float
    zoom_rate_ps: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "lateral_mps", (2,))
        if not np.isfinite([self.climb_mps, self.yaw_rate_radps, self.zoom_rate_ps]).all():
            raise MessageError("FlightCommand: climb_mps, yaw_rate_radps and zoom_rate_ps must be finite")


def among(ids: IntArray, members: AbstractSet[int] | npt.ArrayLike) -> BoolArray:
    """(N,) which of the robots `ids` are members; for the few in an image faster than sorting arrays."""
    wanted = members if isinstance(members, AbstractSet) else set(np.asarray(members).tolist())
    return np.array([robot in wanted for robot in ids.tolist()], dtype=bool)


def centred(points_px: Array, image_size_px: Array) -> Array:
    """Image points (N, 2) from the image centre, in halves of the image's shorter side.

    In these units a rule on distances from the centre means the same for every camera.
    """
    return np.asarray((points_px - (image_size_px - 1) / 2) / (image_size_px.min() / 2))


def shared_ids(own: npt.ArrayLike, reports: Sequence[UnitReport]) -> IntArray:
    """Robots of `own` that at least one other unit reports to control."""
    others: set[int] = set().union(*(report.controlled for report in reports))
    return np.array(sorted(others.intersection(np.asarray(own).tolist())), dtype=np.int64)
