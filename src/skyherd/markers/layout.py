"""Several markers on each robot, in one plane parallel to the ground or on several faces of the robot.

A robot's frame has its origin at the robot's reference point, x forward, y left and z up. Lengths are in
marker sides, so that a layout holds for every print.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import ROBOT_FRAME_CORNERS, Array, ComplexArray, IntArray, to_points

Face = Literal["top", "front", "left", "back", "right"]
"""Side of the robot that a marker lies on."""

FACES: dict[Face, tuple[tuple[int, int, int], tuple[int, int, int]]] = {
    "top": ((1, 0, 0), (0, 1, 0)),
    "front": ((0, 0, 1), (0, -1, 0)),
    "left": ((0, 0, 1), (1, 0, 0)),
    "back": ((0, 0, 1), (0, 1, 0)),
    "right": ((0, 0, 1), (-1, 0, 0)),
}
"""Forward and left axis of a marker with a yaw of 0 on each face, in the robot's frame. Derived: a marker on
top points forward, and one on a side points up; forward, left and the outward normal are right-handed."""


class Place(NamedTuple):
    """Place of one marker on every robot.

    Attributes:
        add_to_id: number that the marker's id exceeds the robot's id by.
        offset_sides: (forward, left) from the robot's reference point to the marker's centre, marker sides.
        yaw_rad: the marker's direction on its face, counter-clockwise as seen from outside.
        height_sides: height of the centre above the reference point, marker sides.
        face: side of the robot that the marker lies on.
    """

    add_to_id: int
    offset_sides: tuple[float, float]
    yaw_rad: float = 0.0
    height_sides: float = 0.0
    face: Face = "top"

    @property
    def frame(self) -> Array:
        """The marker's forward axis, left axis and centre in the robot's frame, columns (3, 3)."""
        forward, left = np.array(FACES[self.face], dtype=float)
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.column_stack(
            [c * forward + s * left, c * left - s * forward, [*self.offset_sides, self.height_sides]]
        )

    @property
    def lowest_sides(self) -> float:
        """Height of the lowest corner above the reference point, marker sides."""
        frame = self.frame
        return float((frame[2, 2] + to_points(ROBOT_FRAME_CORNERS) @ frame[2, :2]).min())


@dataclass(frozen=True)
class MarkerLayout:
    """The markers of a team's robots, M in all.

    Attributes:
        ids: (M,) markers, each once.
        robot_ids: (M,) the robot of each marker.
        frames: (M, 3, 3) of each marker: columns are its forward axis, its left axis and its centre in the
            robot's frame, marker sides.
    """

    ids: IntArray
    robot_ids: IntArray
    frames: Array

    @classmethod
    def make(cls, robot_ids: Sequence[int] | IntArray, places: Sequence[Place]) -> "MarkerLayout":
        """Return the layout of robots that all have markers at the same places.

        Raises:
            InputError: two markers have one id.
        """
        rows = [(int(robot), place) for robot in robot_ids for place in places]
        layout = cls(
            ids=np.array([robot + place.add_to_id for robot, place in rows], dtype=np.int64),
            robot_ids=np.array([robot for robot, _ in rows], dtype=np.int64),
            frames=np.array([place.frame for _, place in rows]).reshape(-1, 3, 3),
        )
        ids, counts = np.unique(layout.ids, return_counts=True)
        if (counts > 1).any():
            raise InputError(
                "add_to_id",
                f"two robots would share the marker {ids[counts > 1][0]}",
                "numbers that differ by more than the robots' ids",
            )
        return layout

    @cached_property
    def is_flat(self) -> bool:
        """True if all markers lie in the plane of the reference points, parallel to the ground."""
        return not self.frames[:, 2].any()

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Row of each marker by its id."""
        return {marker: row for row, marker in enumerate(self.ids.tolist())}

    @cached_property
    def offsets_sides(self) -> ComplexArray:
        """Centres (M,) above the ground in the robot's frame, `forward + i left`, marker sides."""
        return np.asarray(self.frames[:, 0, 2] + 1j * self.frames[:, 1, 2])

    @cached_property
    def yaws_rad(self) -> Array:
        """Directions (M,) of markers of a flat layout in the robot's frame, counter-clockwise."""
        return np.arctan2(self.frames[:, 1, 0], self.frames[:, 0, 0])

    @cached_property
    def corners_sides(self) -> ComplexArray:
        """Corners (M, 4) of markers of a flat layout, `forward + i left`, marker sides."""
        x, y, _ = np.moveaxis(self.points_sides, -1, 0)
        return np.asarray(x + 1j * y)

    @cached_property
    def points_sides(self) -> Array:
        """Corners (M, 4, 3) of the markers in the robot's frame, marker sides."""
        axes, centers = self.frames[:, :, :2], self.frames[:, None, :, 2]
        return np.asarray(centers + to_points(ROBOT_FRAME_CORNERS) @ axes.transpose(0, 2, 1))

    def rows_of(self, marker_ids: IntArray) -> IntArray:
        """Return the row (N,) of each marker; -1 for markers that are not on a robot."""
        return np.array([self.row_of.get(marker, -1) for marker in marker_ids.tolist()], dtype=np.int64)

    def robots_of(self, marker_ids: IntArray) -> IntArray:
        """Return the robot (N,) of each marker; markers that are not on a robot stay as they are."""
        rows = self.rows_of(marker_ids)
        return np.where(rows < 0, marker_ids, self.robot_ids[rows])
