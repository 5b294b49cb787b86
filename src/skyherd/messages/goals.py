"""Motion goals that an aerial unit sends to the robots that it controls."""

from dataclasses import dataclass

import numpy as np

from skyherd.errors import MessageError
from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.messages.checks import check_time, shown
from skyherd.messages.frozen_arrays import freeze, freeze_ids
from skyherd.messages.short_repr import short_repr


@dataclass(frozen=True)
class RobotGoal:
    """Part of one unit's `MotionGoals` for one robot: the transmitted message.

    Attributes:
        robot_id: the receiver.
        unit_id: the sender.
        time_s: time of the sender's image.
        rho_px: length of the vector from the robot to its desired point, in the sender's pixels.
        bearing_rad: direction of that vector in the robot's own frame, 0 ahead, positive to the left.
        side_px: side of the robot's own marker in the sender's image.
        neighbor_ids: (K,) robots with an image distance in this message.
        neighbor_distances_px: (K,) image distances from the robot to them.
    """

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
    """Goals of one unit for the robots it controls (paper, eq. 2-3), as arrays over robots.

    The vector of robot i is `rho_i = p_i^d - p_i`, from its observed to its desired image point in unit j's
    image. With the distances to neighbours a robot computes the ratio of the scales of several units' images.

    Attributes:
        unit_id: the sender.
        time_s: time of its image.
        ids: (N,) receivers, each once.
        rho_px: (N,) lengths of the vectors, in the sender's pixels.
        bearings_rad: (N,) directions of the vectors, each in the robot's own frame, 0 ahead, positive to the
            left; the paper's angle (eq. 3) is `alpha = pi - bearing`.
        sides_px: (N,) side of each robot's own marker in the sender's image.
        neighbor_ids: (N, K) robots near each one in the image; NO_ID pads the rows.
        neighbor_distances_px: (N, K) image distances to them; 0 as padding.

    Raises:
        MessageError: a shape is wrong, an id occurs twice, a length is negative or a side not positive.
    """

    unit_id: int
    time_s: float
    ids: IntArray
    rho_px: Array
    bearings_rad: Array
    sides_px: Array
    neighbor_ids: IntArray
    neighbor_distances_px: Array

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_time(self)
        n = freeze_ids(self, "ids")
        freeze(self, "rho_px", (n,))
        freeze(self, "bearings_rad", (n,))
        freeze(self, "sides_px", (n,))
        freeze(self, "neighbor_ids", (n, None), integer=True)
        freeze(self, "neighbor_distances_px", (n, self.neighbor_ids.shape[1]))
        if (self.rho_px < 0).any():
            raise MessageError("MotionGoals.rho_px", shown(self.rho_px.tolist()), "0 or more")
        if (self.sides_px <= 0).any():
            raise MessageError("MotionGoals.sides_px", shown(self.sides_px.tolist()), "positive sides")

    def __len__(self) -> int:
        return int(self.ids.size)

    def take(self, rows: BoolArray) -> "MotionGoals":
        """Return the goals of the robots in a mask (N,)."""
        return MotionGoals(
            unit_id=self.unit_id,
            time_s=self.time_s,
            ids=self.ids[rows],
            rho_px=self.rho_px[rows],
            bearings_rad=self.bearings_rad[rows],
            sides_px=self.sides_px[rows],
            neighbor_ids=self.neighbor_ids[rows],
            neighbor_distances_px=self.neighbor_distances_px[rows],
        )

    def for_robot(self, robot_id: int) -> RobotGoal:
        """Return the part for one robot.

        Raises:
            KeyError: these goals are not for that robot.
        """
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
