"""Several markers on each robot, in one plane parallel to the ground.

A robot's frame has its origin at the robot's reference point, x forward and y left. Lengths are in marker
sides, so that a layout holds for every print.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import ROBOT_FRAME_CORNERS, Array, ComplexArray, IntArray


class Place(NamedTuple):
    """Place of one marker on every robot.

    Attributes:
        add_to_id: number that the marker's id exceeds the robot's id by.
        offset_sides: (forward, left) from the robot's reference point to the marker's centre, marker sides.
        yaw_rad: the marker's direction in the robot's frame, counter-clockwise.
    """

    add_to_id: int
    offset_sides: tuple[float, float]
    yaw_rad: float = 0.0


@dataclass(frozen=True)
class MarkerLayout:
    """The markers of a team's robots, M in all.

    Attributes:
        ids: (M,) markers, each once.
        robot_ids: (M,) the robot of each marker.
        offsets_sides: (M,) centres in the robot's frame, `forward + i left`, marker sides.
        yaws_rad: (M,) directions in the robot's frame, counter-clockwise.
    """

    ids: IntArray
    robot_ids: IntArray
    offsets_sides: ComplexArray
    yaws_rad: Array

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
            offsets_sides=np.array([complex(*place.offset_sides) for _, place in rows], dtype=complex),
            yaws_rad=np.array([place.yaw_rad for _, place in rows], dtype=float),
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
    def row_of(self) -> dict[int, int]:
        """Row of each marker by its id."""
        return {marker: row for row, marker in enumerate(self.ids.tolist())}

    @cached_property
    def corners_sides(self) -> ComplexArray:
        """Corners (M, 4) of the markers in the robot's frame, `forward + i left`, marker sides."""
        turned = np.exp(1j * self.yaws_rad)[:, None] * ROBOT_FRAME_CORNERS
        return np.asarray(self.offsets_sides[:, None] + turned)

    def robots_of(self, marker_ids: IntArray) -> IntArray:
        """Return the robot (N,) of each marker; markers that are not on a robot stay as they are."""
        rows = [self.row_of.get(marker) for marker in marker_ids.tolist()]
        found = [
            marker if row is None else int(self.robot_ids[row])
            for marker, row in zip(marker_ids.tolist(), rows, strict=True)
        ]
        return np.array(found, dtype=np.int64)
