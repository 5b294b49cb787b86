"""The message of a unit about the markers in one image."""

from dataclasses import dataclass

from skyherd.errors import MessageError
from skyherd.geometry import Array, IntArray
from skyherd.messages.checks import check_time, shown
from skyherd.messages.frozen_arrays import freeze, freeze_ids


@dataclass(frozen=True)
class Sighting:
    """The markers detected in one image.

    Attributes:
        unit_id: the unit that took the image.
        time_s: time of capture.
        ids: (N,) markers detected once.
        repeated_ids: (M,) markers detected at several places, so that the robot's position is ambiguous.
        centers_px: (N, 2) their centres, by which robots check their own motion.
        headings_rad: (N,) headings of their robots in the image, from +u to +v.
        sides_px: (N,) their sides.

    Raises:
        MessageError: a shape is wrong, an id is negative or occurs twice, a value is not finite, or a side is
            not positive.
    """

    unit_id: int
    time_s: float
    ids: IntArray
    repeated_ids: IntArray
    centers_px: Array
    headings_rad: Array
    sides_px: Array

    def __post_init__(self) -> None:
        check_time(self)
        n = freeze_ids(self, "ids")
        freeze_ids(self, "repeated_ids")
        freeze(self, "centers_px", (n, 2))
        freeze(self, "headings_rad", (n,))
        freeze(self, "sides_px", (n,))
        if (self.sides_px <= 0).any():
            raise MessageError("Sighting.sides_px", shown(self.sides_px.tolist()), "positive sides")
