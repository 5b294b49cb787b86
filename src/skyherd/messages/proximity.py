"""What a unit tells robots about what is near them: robots have no sensors of their own."""

from dataclasses import dataclass

from skyherd.errors import MessageError
from skyherd.geometry import Array, IntArray
from skyherd.messages.frozen_arrays import freeze, freeze_ids


@dataclass(frozen=True)
class Proximity:
    """Bodies near the robots that one unit sees, as arrays over pairs (robot, other).

    Two bodies that are both seen and make no pair are far apart.

    Attributes:
        unit_id: the sender.
        time_s: when its image was taken.
        horizon_sides: gaps wider than this are not told of.
        ids: (N,) bodies seen; the robots among them are addressed, whether the unit controls them or not.
        robot_ids: (P,) who is told,
        other_ids: (P,) of whom: a robot or an obstacle.
        distances_sides: (P,) between the two centres, in marker sides.
        bearings_rad: (P,) direction to the other in the robot's own frame, 0 ahead, positive to the left.
        reaches_sides: (P,) the distance at which the two bodies touch, with a margin.
        shares: (P,) part of the gap that is the robot's to use: 1/2 where the other one is told as well.
    """

    unit_id: int
    time_s: float
    horizon_sides: float
    ids: IntArray
    robot_ids: IntArray
    other_ids: IntArray
    distances_sides: Array
    bearings_rad: Array
    reaches_sides: Array
    shares: Array

    def __post_init__(self) -> None:
        freeze_ids(self, "ids")
        freeze(self, "robot_ids", (None,), integer=True)
        pairs = self.robot_ids.size
        freeze(self, "other_ids", (pairs,), integer=True)
        for name in ("distances_sides", "bearings_rad", "reaches_sides", "shares"):
            freeze(self, name, (pairs,))
        if (self.distances_sides < 0).any() or (self.reaches_sides < 0).any():
            raise MessageError("Encounters: distances_sides and reaches_sides must not be negative")

    def __len__(self) -> int:
        return int(self.ids.size)
