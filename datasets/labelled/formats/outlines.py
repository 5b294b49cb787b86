"""Part of a marker's outline inside the image, and its bounding box."""

import numpy as np

from skyherd.geometry import Array


def visible_outline(corners_px: Array, size_px: tuple[int, int]) -> Array:
    """Clip a square, given by its corners (4, 2), to the image; return the corners (K, 2) of the rest.

    Coordinates of the result are px from the image's upper left corner. Pixel centres, integers in
    `corners_px`, become halves. The square is clipped by one border after the other (Sutherland and Hodgman
    1974).
    """
    points = corners_px + 0.5
    for axis, sign, limit in ((0, 1, 0), (1, 1, 0), (0, -1, -size_px[0]), (1, -1, -size_px[1])):
        points = _cut(points, sign * points[:, axis] - limit)
    return points


def _cut(points: Array, inside: Array) -> Array:
    """Clip a polygon (K, 2) where an affine function, given at its corners (K,), is negative."""
    kept: list[Array] = []
    for point, following, here, there in zip(
        points, np.roll(points, -1, axis=0), inside, np.roll(inside, -1), strict=True
    ):
        if here >= 0:
            kept.append(point)
        if (here < 0) != (there < 0):
            kept.append(point + (following - point) * here / (here - there))
    return np.array(kept).reshape(-1, 2)


def bounding_box(outline: Array) -> tuple[float, float, float, float]:
    """Return the bounding box of an outline (K, 2): left, top, width, height, in its unit."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    return float(low[0]), float(low[1]), float(high[0] - low[0]), float(high[1] - low[1])


def area(outline: Array) -> float:
    """Return the area of a polygon with corners (K, 2) in order, by the shoelace formula."""
    x, y = outline.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
