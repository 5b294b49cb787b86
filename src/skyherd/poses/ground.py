"""Positions on the ground of the markers of a rectified image, in marker sides or in metres.

A rectified image shows the ground up to a similarity (`skyherd.control.rectified`). One known length, the
side of the markers, fixes its scale. No calibration is needed.
"""

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.messages import Detections

MAX_SIDE_M = 100.0
"""Maximum side of a marker, m. Chosen: larger values are lengths in another unit."""

SIDE_SHARE = 1 / 2
"""Variance of the logarithm of a measured side over that of the heading, rad². Derived: for four corners with
equal and independent errors, as for `skyherd.control.Rectifier`."""

MEDIAN_VARIANCE = np.pi / 2
"""Variance of a median over that of a mean. Derived: for many Gaussian values."""


def check_side(where: str, side_m: float) -> float:
    """Return a marker side, m, or raise InputError if it is not a number above 0 and up to `MAX_SIDE_M`."""
    if not 0 < side_m <= MAX_SIDE_M:
        raise InputError(
            where, f"{side_m:g} m", f"the side of the black square: above 0, up to {MAX_SIDE_M:g} m"
        )
    return float(side_m)


def ground_positions(flat: Detections, side_m: float = 1.0) -> Array:
    """Return the ground positions (N, 2) of the markers of a rectified image, in the unit of `side_m`.

    The origin is the image centre, x points along +u and y along -v. The median marker side of the image has
    the length `side_m`; with the default of 1 the unit is the marker side.

    Args:
        flat: the detections, rectified.
        side_m: side of the black squares.
    """
    return _from_center_px(flat) * _unit_per_px(flat, side_m)


def ground_covariances(flat: Detections, side_m: float = 1.0) -> Array:
    """Return the covariances (N, 2, 2) of `ground_positions`, in the unit of `side_m` squared.

    They sum the covariance of the marker's centre and that of the scale, which is common to all markers. The
    origin and the axes of the image count as exact. All zero without covariances of the detector.
    """
    scale, flip = _unit_per_px(flat, side_m), np.diag([1.0, -1.0])
    centers = flip @ flat.covariances[:, :2, :2] @ flip
    by_side = MEDIAN_VARIANCE * SIDE_SHARE * flat.covariances[:, 2, 2]
    log_scale = float(by_side.mean()) / len(flat) if len(flat) else 0.0
    away = _from_center_px(flat)
    return np.asarray(scale**2 * (centers + log_scale * away[:, :, None] * away[:, None, :]))


def _from_center_px(flat: Detections) -> Array:
    """Return centres (N, 2), px, from the image centre, x along +u and y along -v."""
    return np.asarray((flat.centers_px - (flat.image_size_px - 1) / 2) * (1, -1))


def _unit_per_px(flat: Detections, side_m: float) -> float:
    return side_m / float(np.median(flat.sides_px)) if len(flat) else side_m
