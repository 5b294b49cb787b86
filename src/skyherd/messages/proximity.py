"""Distances and bearings to nearby bodies, which units send to robots without own sensors."""

from dataclasses import dataclass, field

import numpy as np

from skyherd.errors import MessageError
from skyherd.geometry import Array, IntArray
from skyherd.messages.checks import check_time, shown
from skyherd.messages.frozen_arrays import freeze, freeze_ids


def _no_ways() -> Array:
    return np.zeros(0)


@dataclass(frozen=True)
class Proximity:
    """Bodies near the robots that one unit sees, as arrays over P pairs of a robot and another body.

    Two bodies that are both in `ids` and form no pair are farther apart than the horizon. The sides of the
    sender's image are among the bodies, with the ids `BORDER_IDS`, while bodies may be hidden beyond them.
    Bodies without identity have `ANONYMOUS_ID`. A robot whose id occurs at several places receives the
    neighbours of each place as anonymous bodies, since it may be at any of them.

    Attributes:
        unit_id: the sender.
        time_s: time of its image.
        horizon_sides: maximum distance of the bodies of a pair, in marker sides.
        ids: (N,) bodies seen, each once; the robots among them are receivers, whether the unit controls them
            or not.
        robot_ids: (P,) the robot of each pair, which is the receiver.
        other_ids: (P,) the other body of each pair: a robot, an obstacle, a side of the image, or an
            anonymous body.
        distances_sides: (P,) distances between the two centres, or from a side, in marker sides.
        bearings_rad: (P,) directions to the other body in the robot's own frame, 0 ahead, positive to the
            left.
        reaches_sides: (P,) distances between the centres at which the bodies touch, margin included.
        shares: (P,) share of the gap that the robot may use up: 1/2 if the other body is or may be a robot,
            which receives the same pair, and 1 if it is static.
        ways_sides: (P,) additional gap by which the robot makes way for another one that leaves a body; all 0
            if left out.

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
    ways_sides: Array = field(default_factory=_no_ways)

    def __post_init__(self) -> None:
        check_time(self)
        freeze_ids(self, "ids")
        freeze(self, "robot_ids", (None,), integer=True)
        pairs = self.robot_ids.size
        freeze(self, "other_ids", (pairs,), integer=True)
        if not np.size(self.ways_sides):
            object.__setattr__(self, "ways_sides", np.zeros(pairs))
        for name in ("distances_sides", "bearings_rad", "reaches_sides", "shares", "ways_sides"):
            freeze(self, name, (pairs,))
        for name in ("distances_sides", "reaches_sides", "ways_sides"):
            if ((values := getattr(self, name)) < 0).any():
                raise MessageError(f"Proximity.{name}", shown(values.tolist()), "0 or more")

    def __len__(self) -> int:
        return int(self.ids.size)
