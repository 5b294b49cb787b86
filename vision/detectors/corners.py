"""Detections from the corners that `cv2.aruco` and the peers report."""

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.markers.dictionary import pose_of_corners
from skyherd.messages import Detections
from skyherd.vision.grey import Image


def detections_of_corners(
    image: Image,
    ids: IntArray,
    corners_px: Array,
    *,
    headings_rad: Array,
    sides_px: Array,
    covariances: Array,
    time_s: float,
    unit_id: int,
) -> Detections:
    """Markers `ids` (N,) at corners (N, 4, 2), moved about their middle to sides (N,) of `sides_px`."""
    centers, _, measured_px = pose_of_corners(corners_px)
    growth = (sides_px / measured_px)[:, None, None]
    return Detections(
        unit_id=unit_id,
        time_s=time_s,
        image_size_px=np.array([image.shape[1], image.shape[0]]),
        ids=ids,
        centers_px=centers,
        headings_rad=headings_rad,
        sides_px=sides_px,
        corners_px=centers[:, None] + (corners_px - centers[:, None]) * growth,
        covariances=covariances,
    )
