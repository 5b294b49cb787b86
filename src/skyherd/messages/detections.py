"""What one unit's detector found in one image, and the image lengths that rules on detections use."""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.errors import MessageError
from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.messages.frozen_arrays import freeze, freeze_ids


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


def among(ids: IntArray, members: AbstractSet[int] | npt.ArrayLike) -> BoolArray:
    """(N,) which of the robots `ids` are members; for the few in an image faster than sorting arrays."""
    wanted = members if isinstance(members, AbstractSet) else set(np.asarray(members).tolist())
    return np.array([robot in wanted for robot in ids.tolist()], dtype=bool)


def centred(points_px: Array, image_size_px: Array) -> Array:
    """Image points (N, 2) from the image centre, in halves of the image's shorter side.

    In these units a rule on distances from the centre means the same for every camera.
    """
    return np.asarray((points_px - (image_size_px - 1) / 2) / (image_size_px.min() / 2))
