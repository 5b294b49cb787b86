"""Dark regions in which no quadrilateral is found: of markers that are covered, faint, or cut by the border.

Each image has two passes of a threshold against wide surroundings. A region that is nearly square is taken as
one. Of a region that the image's border cuts, the corners that are left are completed to squares.
"""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray
from skyherd.vision.grey import Image, block_means

Contour = npt.NDArray[Any]
"""A contour (M, 2), px."""

SHRINK, MIN_PATCH_PX = 2, 12.0
"""Downsampling factor of the image in which dark regions are looked for, and their smallest side, px. Chosen:
a fit finds the place again, and smaller markers have no part that is worth a look."""

MIN_WINDOW_PX, DARKER = 27, (14, 6)
"""Smallest width, px of the shrunk image, of the surroundings that dark regions are compared with, and how
much darker they are in each pass, grey levels. Chosen: larger than a marker of 50 px, and a sixth of the
shorter side of larger images; the second pass for faint markers."""

MAX_SIDE_RATIO = 1.2
"""Largest ratio of the sides of a dark patch. Chosen: for markers seen from nearly straight above."""

SQUARENESS_DEG = 35.0
"""How far a corner of a cut region may differ from a right angle, degrees. Chosen: markers seen at a slant
do."""

MIN_CORNERS, MAX_CORNERS, SIMPLIFIED_SHARE = 3, 7, 0.04
"""Number of corners of a square that the border cuts, and the share of its length by which its outline is
simplified. Derived: a cut adds up to three corners. Chosen: a sixth of a side."""

MAX_GROWTH, SIZES_PER_CELL = 2.5, 4
"""Ratio of a square's side to the longest side that is left, at most, and the number of sides tried for each
cell. Chosen: of 40 % two fifths are left; a step is then a quarter of a cell."""


def dark_outlines(image: Image) -> list[Contour]:
    """Return the outer contours (M, 2), px, of regions that are darker than their wide surroundings."""
    small = block_means(image, SHRINK)
    if not small.size:
        return []
    window, outlines = max(MIN_WINDOW_PX, 2 * (min(small.shape) // 12) + 1), list[Contour]()
    for darker in DARKER:
        dark = cv2.adaptiveThreshold(
            small, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, window, darker
        )
        contours, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        # The contour of a square encloses a pixel less than its side along each axis.
        least = (MIN_PATCH_PX / SHRINK - 1) ** 2
        outlines += [contour[:, 0] for contour in contours if cv2.contourArea(contour) >= least]
    return [SHRINK * outline.astype(np.float32) + (SHRINK - 1) / 2 for outline in outlines]


def square_patches(outlines_px: list[Contour]) -> Array:
    """Return the rectangles (N, 4, 2), px, around the outlines that are nearly square."""
    rectangles = [cv2.minAreaRect(outline_px) for outline_px in outlines_px]
    near = [cv2.boxPoints(one) for one in rectangles if max(one[1]) < MAX_SIDE_RATIO * min(one[1])]
    return _grown(near)


def cut_squares(outlines_px: list[Contour], image: Image, n_cells: int) -> Array:
    """Return squares (N, 4, 2), px, through the corners left of outlines that the image's border cuts."""
    size_px, squares = np.array(image.shape[::-1]), list[Array]()
    for outline_px in outlines_px:
        left, top, width, height = cv2.boundingRect(outline_px)
        right, bottom = size_px[0] - left - width, size_px[1] - top - height
        if min(left, top, right, bottom) > SHRINK:
            continue
        hull = cv2.convexHull(outline_px)
        corners = cv2.approxPolyDP(hull, SIMPLIFIED_SHARE * cv2.arcLength(hull, True), True)[:, 0].astype(
            float
        )
        if MIN_CORNERS <= len(corners) <= MAX_CORNERS:
            squares += _completed(corners, _inside(corners, size_px, 2 * SHRINK), n_cells)
    return _grown(squares)


def _completed(corners_px: Array, inside: BoolArray, n_cells: int) -> list[Array]:
    """Return squares at the corners (M, 2) inside the image: on whole sides, or of several sizes."""
    squares: list[Array] = []
    for k in np.flatnonzero(inside):
        after = (k + 1) % len(corners_px)
        back, ahead = corners_px[k - 1] - corners_px[k], corners_px[after] - corners_px[k]
        lengths = np.linalg.norm([back, ahead], axis=1)
        angle_deg = np.degrees(np.arccos(np.clip(back @ ahead / lengths.prod(), -1, 1)))
        if abs(angle_deg - 90) > SQUARENESS_DEG:
            continue
        if inside[after]:
            squares.append(_square(corners_px[k], ahead, back))
        elif not inside[k - 1]:
            for side in lengths.max() * np.geomspace(1.0, MAX_GROWTH, SIZES_PER_CELL * n_cells):
                squares.append(_square(corners_px[k], side * ahead / lengths[1], back))
    return squares


def _square(first: Array, edge: Array, towards: Array) -> Array:
    """Return the square (4, 2), clockwise, on an edge from `first`, on the side to which `towards` points."""
    across = np.array([-edge[1], edge[0]])
    if across @ towards < 0:
        first, edge, across = first + edge, -edge, -across
    return np.array([first, first + edge, first + edge + across, first + across])


def _inside(points_px: Array, size_px: Array, margin_px: float) -> BoolArray:
    """Return which points (M, 2), px, have a distance from the border of an image of size (2,)."""
    return np.asarray(((points_px > margin_px) & (points_px < size_px - 1 - margin_px)).all(axis=1))


def _grown(quads: list[Any]) -> Array:
    """Return rectangles as an array (N, 4, 2), px, grown to the edges of the dark pixels.

    Outlines pass through the centres of these, half a pixel of the shrunk image within their edges.
    """
    corners_px = np.array(quads, dtype=float).reshape(-1, 4, 2)
    sides = np.roll(corners_px, -1, axis=1) - corners_px
    sides /= np.linalg.norm(sides, axis=2, keepdims=True)
    return np.asarray(corners_px + SHRINK / 2 * (np.roll(sides, 1, axis=1) - sides))
