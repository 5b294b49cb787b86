"""The motion goals that a unit sends to its robots, and the view that one robot reads."""

from dataclasses import dataclass

import numpy as np

from skyherd.errors import MessageError
from skyherd.geometry import Array, IntArray
from skyherd.messages.frozen_arrays import freeze, freeze_ids


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
