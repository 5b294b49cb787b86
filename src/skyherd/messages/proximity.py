"""Distances and bearings to bodies nearby, which units send to robots that have no sensors of their own."""

from dataclasses import dataclass

from skyherd.errors import MessageError
from skyherd.geometry import Array, IntArray
from skyherd.messages.checks import check_time
from skyherd.messages.frozen_arrays import freeze, freeze_ids


@dataclass(frozen=True)
class Proximity:
    """Bodies near the robots that one unit sees, as arrays over P pairs of a robot and another body.

    Two bodies that are both in `ids` and form no pair are farther apart than the horizon. The sides of the
    sender's image stand among the bodies, by the ids `BORDER_IDS`, while something may be hidden beyond them.

    Attributes:
        unit_id: the sender.
        time_s: when its image was taken.
        horizon_sides: pairs whose bodies are farther apart than this are left out, in marker sides.
        ids: (N,) bodies seen, each once; the robots among them are addressed, whether the unit controls
            them or not.
        robot_ids: (P,) the robot of each pair, which is the receiver.
        other_ids: (P,) the other body of each pair: a robot, an obstacle or a side of the image.
        distances_sides: (P,) distances between the two centres, or from a side, in marker sides.
        bearings_rad: (P,) directions to the other body in the robot's own frame, 0 ahead, positive to the
            left.
        reaches_sides: (P,) distances between the centres at which the bodies touch, margin included.
        shares: (P,) share of the gap that the robot may use up: 1/2 where the other body is a robot, which
            receives the same pair, and 1 where it stands still.

    Raises:
        MessageError: a shape is wrong, an id in `ids` occurs twice, or a distance is negative.
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
        check_time(self)
        freeze_ids(self, "ids")
        freeze(self, "robot_ids", (None,), integer=True)
        pairs = self.robot_ids.size
        freeze(self, "other_ids", (pairs,), integer=True)
        for name in ("distances_sides", "bearings_rad", "reaches_sides", "shares"):
            freeze(self, name, (pairs,))
        if (self.distances_sides < 0).any() or (self.reaches_sides < 0).any():
            raise MessageError("Proximity: distances_sides and reaches_sides must not be negative")

    def __len__(self) -> int:
        return int(self.ids.size)
