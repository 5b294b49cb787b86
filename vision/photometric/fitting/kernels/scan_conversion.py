"""Which pixels of an image are a marker's, line by line, and where on the marker they lie.

With a pixel's offset p from the centre, its marker coordinates are

    z = (Re(X̄ p) + i Re(Ȳ p)) / (1 - Re(h̄ p))

of the axes X and Y and the horizon h of `LocalHomographies.axes`. A marker has the pixels where neither |x|
nor |y| is above its `limit`. They lie between two strips about its axes, which are wider by what the horizon
adds, so that only these are looked through.
"""

import math
from typing import Any

import numpy as np
from numba import float32, int32, int64, njit

from skyherd.jobs.compilation import FLAGS, INLINE, PARTS
from skyherd.vision.photometric.fitting.kernels.marker_record import MARKERS

MIN_AXIS_PER_PX = 1e-12
"""Smallest slope along a line, in marker sides per pixel, that is divided by; an axis that is exactly at
right angles to a line would divide by zero. Chosen far below 1 / image width, so that the bounds it gives lie
outside any image."""

_NEXT = np.uintp(1)


@njit(**INLINE)
def _first_and_last(low: float, high: float, size: int) -> tuple[int, int]:
    """Return the whole numbers from `low` to `high` within 0 to `size - 1`; none if `high` is smaller."""
    if not low <= high:
        return 0, -1
    first, last = max(math.ceil(low), 0.0), min(math.floor(high), size - 1.0)
    return (int(first), int(last)) if first <= last else (0, -1)


@njit(**PARTS)
def _lines(marker: Any, height: int) -> Any:
    """First and last line of an image of `height` lines that may have pixels of a marker.

    There are none if the marker's geometry has numbers that are not finite, as a fit that ran away may.
    """
    total = abs(marker.center) + abs(marker.x_axis) + abs(marker.y_axis) + abs(marker.perspective)
    total += abs(marker.keystone) + abs(marker.anisotropy) + marker.strip + marker.height_px + marker.sigma
    if not total < np.inf:
        return 0, -1
    middle = marker.center.imag
    return _first_and_last(middle - marker.height_px, middle + marker.height_px, height)


@njit(**PARTS)
def _columns_of_line(marker: Any, v: int, width: int) -> Any:
    """First and last column of line v within both strips `|Re(X̄ p)|, |Re(Ȳ p)| <= strip` about the centre."""
    below = v - marker.center.imag
    low, high = -np.inf, np.inf
    for axis in (marker.x_axis, marker.y_axis):
        per_u = axis.real if abs(axis.real) > MIN_AXIS_PER_PX else MIN_AXIS_PER_PX
        middle, half = -axis.imag / per_u * below, marker.strip / abs(per_u)
        low, high = max(low, middle - half), min(high, middle + half)
    return _first_and_last(low + marker.center.real, high + marker.center.real, width)


@njit(int64(MARKERS, int64, int64), **FLAGS)
def count_pixels(markers: Any, height: int, width: int) -> int:
    """Return how many pixels N markers (`MARKER`) have in an image of that size, or a few more.

    They are those between the strips; `list_pixels` leaves out those that only the strips' extra width takes
    in. No marker has more than the image.
    """
    count = 0
    for number in range(markers.size):
        first_line, last_line = _lines(markers[number], height)
        for v in range(first_line, last_line + 1):
            first, last = _columns_of_line(markers[number], v, width)
            count += last - first + 1
    return count


@njit(**INLINE)
def growth(horizon: Any, right: Any, below: Any) -> Any:
    """`1 / (1 - Re(h̄ p))` of a pixel so far right of and below the centre, px: 1 / w of the homography."""
    return 1 / (1 - (horizon.real * right + horizon.imag * below))


@njit(int64(MARKERS, int64, int64, int64[::1], float32[:, ::1], int32[:, ::1]), **FLAGS)
def list_pixels(markers: Any, height: int, width: int, bounds: Any, places: Any, pixels: Any) -> Any:
    """List the pixels of N markers, line by line and one marker after another, without gaps.

    Args:
        markers: (N,) of `MARKER`.
        height: of the image, px.
        width: of the image, px.
        bounds: (N + 1,) result: marker k has the rows from `bounds[k]` to `bounds[k + 1]`.
        places: (P, 2) result: marker coordinates x and y.
        pixels: (P, 2) result: line v and column u in the image.

    Returns:
        How many there are; P may be larger.
    """
    row = np.uintp(0)
    bounds[0] = 0
    for number in range(np.uintp(markers.size)):
        marker = markers[number]
        center, x_axis, y_axis, horizon = marker.center, marker.x_axis, marker.y_axis, marker.perspective
        first_line, last_line = _lines(marker, height)
        for v in range(first_line, last_line + 1):
            below = v - center.imag
            first, last = _columns_of_line(marker, v, width)
            for u in range(first, last + 1):
                right = u - center.real
                far = growth(horizon, right, below)
                x = (x_axis.real * right + x_axis.imag * below) * far
                y = (y_axis.real * right + y_axis.imag * below) * far
                if far > 0 and abs(x) <= marker.limit and abs(y) <= marker.limit:
                    places[row, 0], places[row, 1] = x, y
                    pixels[row, 0], pixels[row, 1] = v, u
                    row += _NEXT
        bounds[number + _NEXT] = row
    return row
