"""Helpers for detectors that report corners: OpenCV's result as arrays, and detections from corners."""

import cv2
import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.markers.dictionary import pose_of_corners
from skyherd.messages import Detections
from skyherd.vision.grey import Image


def opencv_corners(detector: cv2.aruco.ArucoDetector, image: Image) -> tuple[IntArray, Array]:
    """Return the ids (K,), possibly repeated, and corners (K, 4, 2), px, from an OpenCV detector."""
    corners, ids, _ = detector.detectMarkers(image)
    if len(corners) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2))
    return np.ravel(ids).astype(np.int64), np.reshape(corners, (-1, 4, 2)).astype(float)


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
    """Return detections from marker corners, each quadrilateral scaled about its centre to a given side.

    Args:
        image: source of the corners; only its size is used.
        ids: (N,) marker ids, ascending and unique.
        corners_px: (N, 4, 2) in the order of `skyherd.geometry.SQUARE_CORNERS`; their means are the centres.
        headings_rad: (N,) from +u to +v.
        sides_px: (N,) corrected sides; the corners are scaled to them.
        covariances: (N, 3, 3) of (u, v, heading); all zero if unknown.
        time_s: time of the image.
        unit_id: aerial unit of the image.
    """
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
