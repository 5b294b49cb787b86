"""Positions on the ground of the markers of a rectified image, in marker sides or in metres.

A rectified image shows the ground up to a similarity (`skyherd.control.rectified`). One known length, the
side of the markers, fixes its scale. No calibration is needed.
"""

from collections.abc import Sequence

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array, IntArray
from skyherd.messages import Detections

MAX_SIDE_M = 100.0
"""Maximum side of a marker, m. Chosen: larger values are lengths in another unit."""

SIDE_SHARE = 1 / 2
"""Variance of the logarithm of a measured side over that of the heading, rad². Derived: for four corners with
equal and independent errors, as for `skyherd.control.Rectifier`."""

ROUNDS = 20
"""Rounds of medians in `recording_scales`. Chosen: markers that are seen together in few images need some."""

WINDOW = 5
"""Images of which the median scale counts. Chosen: two in succession may be blurred by a jolt."""

MEDIAN_VARIANCE = np.pi / 2
"""Variance of a median over that of a mean. Derived: for many Gaussian values."""


def check_side(where: str, side_m: float) -> float:
    """Return a marker side, m, or raise InputError if it is not a number above 0 and up to `MAX_SIDE_M`."""
    if not 0 < side_m <= MAX_SIDE_M:
        raise InputError(
            where, f"{side_m:g} m", f"the side of the black square: above 0, up to {MAX_SIDE_M:g} m"
        )
    return float(side_m)


def ground_positions(flat: Detections, side_m: float = 1.0, px_per_side: float | None = None) -> Array:
    """Return the ground positions (N, 2) of the markers of a rectified image, in the unit of `side_m`.

    The origin is the image centre, x points along +u and y along -v. With the default of 1 for `side_m` the
    unit is the marker side.

    Args:
        flat: the detections, rectified.
        side_m: side of the black squares.
        px_per_side: side of a marker in the image, px; by default the median one.
    """
    return _from_center_px(flat) * _unit_per_px(flat, side_m, px_per_side)


def recording_scales(flats: Sequence[Detections]) -> Array:
    """Return the side (T,) in px of the usual marker in each image of a recording, 1 without markers.

    Of rectified images, `log side = scale of the image + size of the marker`. Medians over the markers of an
    image and over the images of a marker are taken in turn. Markers may therefore differ in size, and one
    that is missing does not change the scale. Of `WINDOW` images the median scale counts, which keeps a
    steady climb or zoom as it is.

    Args:
        flats: the detections of each image, rectified, in the order of time.
    """
    ids = np.concatenate([np.zeros(0, dtype=np.int64), *(flat.ids for flat in flats)])
    images = np.repeat(np.arange(len(flats)), [len(flat) for flat in flats])
    markers, rows = np.unique(ids, return_inverse=True)
    logs = np.log(np.concatenate([np.zeros(0), *(flat.sides_px for flat in flats)]))
    sizes, scales = np.zeros(markers.size), np.zeros(len(flats))
    for _ in range(ROUNDS):
        scales = _medians(logs - sizes[rows], images, len(flats))
        sizes = _medians(logs - scales[images], rows, markers.size)
        sizes -= np.median(sizes) if sizes.size else 0.0
    seen = np.unique(images)
    half = np.minimum(np.minimum(np.arange(seen.size), np.arange(seen.size)[::-1]), WINDOW // 2)
    scales[seen] = [np.median(scales[seen[k - n : k + n + 1]]) for k, n in enumerate(half.tolist())]
    return np.exp(scales)


def _medians(values: Array, groups: IntArray, count: int) -> Array:
    """Return the medians (count,) of values (N,) by their groups (N,); 0 of an empty group."""
    medians = np.zeros(count)
    order = np.argsort(groups, kind="stable")
    there, begins = np.unique(groups[order], return_index=True)
    medians[there] = [np.median(part) for part in np.split(values[order], begins)[1:]]
    return medians


def ground_covariances(flat: Detections, side_m: float = 1.0, px_per_side: float | None = None) -> Array:
    """Return the covariances (N, 2, 2) of `ground_positions`, in the unit of `side_m` squared.

    They sum the covariance of the marker's centre and that of the scale, which is common to all markers. The
    origin and the axes of the image count as exact. All zero without covariances of the detector.
    """
    scale, flip = _unit_per_px(flat, side_m, px_per_side), np.diag([1.0, -1.0])
    centers = flip @ flat.covariances[:, :2, :2] @ flip
    by_side = MEDIAN_VARIANCE * SIDE_SHARE * flat.covariances[:, 2, 2]
    log_scale = float(by_side.mean()) / len(flat) if len(flat) else 0.0
    away = _from_center_px(flat)
    return np.asarray(scale**2 * (centers + log_scale * away[:, :, None] * away[:, None, :]))


def _from_center_px(flat: Detections) -> Array:
    """Return centres (N, 2), px, from the image centre, x along +u and y along -v."""
    return np.asarray((flat.centers_px - (flat.image_size_px - 1) / 2) * (1, -1))


def _unit_per_px(flat: Detections, side_m: float, px_per_side: float | None) -> float:
    if px_per_side is None:
        px_per_side = float(np.median(flat.sides_px)) if len(flat) else 1.0
    return side_m / px_per_side
