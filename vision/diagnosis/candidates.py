"""Where in an image a marker could be whose outline the detector's search does not find.

Three kinds of candidates are searched for: dark patches that are nearly square; dark shapes that are cut by
the image's border, with squares laid through their remaining corners; and groups of bright spots, around
which a square is guessed whose own outline cannot be seen. Many of them are no markers;
`skyherd.vision.diagnosis.quad_reading` reads them.
"""

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import border_cells, cells_per_side
from skyherd.vision.grey import Image

Contour = npt.NDArray[Any]
"""A contour as OpenCV has it: (M, 1, 2) points, px."""

MIN_CANDIDATE_SIDE_PX = 6.0
"""Smallest side of a candidate, px. Chosen smaller than that of any detector, so that what is too small to be
detected is found and can be explained: a 4x4 marker then has a pixel a cell."""

THRESHOLDS = (14, 6)
"""How much darker than its surroundings a shape must be in each pass, grey levels. Chosen: the second for
faint markers."""

MIN_WINDOW_PX = 53
"""Smallest width, px, of the surroundings that dark shapes are compared with. Chosen: larger than a marker of
50 px; in images of more than 300 px it is a sixth of the shorter side."""

CLOSINGS_PX = (3, 5, 9, 17, 33)
"""Gaps, px, over which bright spots are taken as one group, one after the other. Chosen: each about twice the
last, for markers of any size."""

BRIGHT_WINDOWS_PX, BRIGHTER = (41, 121), 20
"""Bright spots are so many grey levels above the mean of windows of these widths, px. Chosen: windows larger
than a small and a large marker's cells."""

DARK_SHARE = 0.9
"""Share of the border's cells that must be dark around a group of bright spots. Chosen: nearly all, since
there are many groups."""

MAX_GROUPS = 400
"""Largest number of groups that are looked at for each closing, the largest first. Chosen: for the time."""

SQUARES_AT_ONCE = 8192
"""Number of squares whose borders are looked at at once. Chosen: bounds the memory."""

MAX_EDGES, SAME_DIRECTION_RAD = 6, 0.07
"""Of a group, the directions of so many edges of its hull are tried for the grid, those that differ by less
than the second value, rad, once. Chosen: 4 degrees, a cell in the length of two markers."""

SQUARENESS_DEG = 35.0
"""How far a corner of a cut shape may differ from a right angle, degrees. Chosen: markers seen at a slant
do."""


def dark_shapes(image: Image) -> list[Contour]:
    """Return the outer contours (M, 1, 2), px, of what is dark against its wider surroundings.

    Those that are smaller than any candidate are left out.
    """
    window = max(MIN_WINDOW_PX, 2 * (min(image.shape) // 12) + 1)
    shapes: list[Contour] = []
    for constant in THRESHOLDS:
        dark = cv2.adaptiveThreshold(
            image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, window, constant
        )
        contours, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        # The contour of a square encloses a pixel less than its side along each axis.
        least = (MIN_CANDIDATE_SIDE_PX - 1) ** 2
        shapes += [contour for contour in contours if cv2.contourArea(contour) >= least]
    return shapes


def dark_patches(shapes: list[Contour]) -> Array:
    """Return the smallest rectangles (N, 4, 2), px, around dark shapes, if they are nearly square.

    Markers that are covered in part look like this.
    """
    quads: list[Array] = []
    for shape in shapes:
        rectangle = cv2.minAreaRect(shape)
        shorter, longer = sorted(rectangle[1])
        if shorter > MIN_CANDIDATE_SIDE_PX and longer < 1.2 * shorter:
            quads.append(cv2.boxPoints(rectangle).astype(float))
    return _stacked(quads)


def cut_squares(shapes: list[Contour], image_size_px: IntArray, dictionary: str) -> Array:
    """Return squares (N, 4, 2), px, through the corners left of dark shapes that the image's border cuts."""
    width, height = image_size_px.tolist()
    squares: list[Array] = []
    for shape in shapes:
        left, top, wide, high = cv2.boundingRect(shape)
        touches = left < 1 or top < 1 or left + wide > width - 1 or top + high > height - 1
        if touches and cv2.contourArea(shape) > MIN_CANDIDATE_SIDE_PX**2:
            squares += _complete(shape, (width, height), cells_per_side(dictionary))
    return _stacked(squares)


def _complete(contour: Contour, size_px: tuple[int, int], n: int) -> list[Array]:
    """Return squares that have the corners of a contour (M, 1, 2) which lie inside the image."""
    hull = cv2.convexHull(contour)
    outline = cv2.approxPolyDP(hull, 0.04 * cv2.arcLength(hull, True), True)[:, 0, :].astype(float)
    if not 3 <= len(outline) <= 7:
        return []
    limit = np.array(size_px) - 1.0
    inside: BoolArray = np.all((outline > 1.5) & (outline < limit - 1.5), axis=1)
    squares: list[Array] = []
    for k in np.flatnonzero(inside):
        before, here, after = outline[k - 1], outline[k], outline[(k + 1) % len(outline)]
        back, ahead = before - here, after - here
        angle = np.degrees(
            np.arccos(np.clip(back @ ahead / np.linalg.norm(back) / np.linalg.norm(ahead), -1, 1))
        )
        if abs(angle - 90) > SQUARENESS_DEG:
            continue
        if inside[(k + 1) % len(outline)]:
            squares.append(_square(here, after, back))
        elif not inside[k - 1]:
            longest = max(float(np.linalg.norm(back)), float(np.linalg.norm(ahead)))
            direction = ahead / np.linalg.norm(ahead)
            for side in longest * np.geomspace(1.0, 2.5, 4 * n):
                squares.append(_square(here, here + side * direction, back))
    return squares


def _square(first: Array, second: Array, towards: Array) -> Array:
    """Return the square (4, 2) with the edge given, on the side to which `towards` points."""
    edge = second - first
    across = np.array([-edge[1], edge[0]])
    across = across if across @ towards > 0 else -across
    return np.array([first, second, second + across, first + across])


def bright_groups(image: Image, dictionary: str) -> Array:
    """Return squares (N, 4, 2), px, around groups of bright spots on dark: outlines that cannot be seen.

    A rectangle around a marker's white cells is that of its bits, or lacks a row or two that are all black;
    every such completion is tried, and kept if its border of cells is dark.
    """
    n, border = cells_per_side(dictionary), border_cells(dictionary)
    bits = n - 2 * border
    groups: list[Contour] = []
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.uint8)
    for window in BRIGHT_WINDOWS_PX:
        bright = cv2.adaptiveThreshold(
            smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, window, -BRIGHTER
        )
        for closing in CLOSINGS_PX:
            square = np.ones((closing, closing), dtype=np.uint8)
            closed = cv2.morphologyEx(bright, cv2.MORPH_CLOSE, square)
            contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
            large = [c for c in contours if cv2.contourArea(c) > (MIN_CANDIDATE_SIDE_PX * bits / n) ** 2]
            groups += sorted(large, key=cv2.contourArea, reverse=True)[:MAX_GROUPS]
    squares = _complete_bits(_rectangles_around(groups), bits, border)
    return np.concatenate(
        [
            _with_dark_border(smooth, squares[first : first + SQUARES_AT_ONCE], n, border)
            for first in range(0, max(len(squares), 1), SQUARES_AT_ONCE)
        ]
    )


def _stacked(quads: list[Array]) -> Array:
    """Return quadrilaterals as an array (N, 4, 2)."""
    return np.array(quads).reshape(-1, 4, 2)


def _with_dark_border(image: Image, corners: Array, n: int, border: int) -> Array:
    """Return the squares (N, 4, 2) of n x n cells that have a dark border and a lighter inside."""
    at = (np.arange(n) + 0.5) / n
    right, down = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    places = (
        corners[:, None, None, 0]
        + at[:, None] * right[:, None, None]
        + at[:, None, None] * down[:, None, None]
    )
    u, v = np.rint(places).astype(int).clip(0, np.array(image.shape[::-1]) - 1).transpose(3, 0, 1, 2)
    levels = image[v, u].astype(float)
    rim = np.ones((n, n), dtype=bool)
    rim[border:-border, border:-border] = False
    black = np.median(levels[:, rim], axis=1)
    white = np.percentile(levels[:, ~rim], 85, axis=1)
    dark = (levels[:, rim] < ((black + white) / 2)[:, None]).mean(axis=1) >= DARK_SHARE
    return np.asarray(corners[dark & (white - black > BRIGHTER)])


def _rectangles_around(contours: list[Contour]) -> Array:
    """Return rectangles (N, 4, 2), px, around contours along the longer edges of their hulls."""
    hulls: list[Contour] = [cv2.convexHull(contour) for contour in contours]
    outlines: list[Contour] = [cv2.approxPolyDP(hull, 1.5, True) for hull in hulls]
    angles, kept = _edge_angles(outlines)
    points = _padded(hulls, max(map(len, hulls), default=1))
    right = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    down = np.stack([-right[..., 1], right[..., 0]], axis=-1)
    # A contour runs through the middles of the outermost pixels.
    (left, across), (top, along) = (
        (places.min(axis=1) - 0.5, np.ptp(places, axis=1) + 1.0)
        for places in (points @ axis.transpose(0, 2, 1) for axis in (right, down))
    )
    first = left[..., None] * right + top[..., None] * down
    across_px, along_px = across[..., None] * right, along[..., None] * down
    corners = [first, first + across_px, first + across_px + along_px, first + along_px]
    return np.asarray(np.stack(corners, axis=2)[kept])


def _edge_angles(outlines: list[Contour]) -> tuple[Array, BoolArray]:
    """Return directions (N, `MAX_EDGES`), rad, of the longest edges of outlines, within a quarter turn.

    Also returned is which of them (N, `MAX_EDGES`) are unlike all longer ones, and edges at all.
    """
    ends = max(MAX_EDGES, *map(len, outlines), 1)
    points = _padded(outlines, ends)
    edges = np.roll(points, -1, axis=1) - points
    lengths = np.hypot(edges[..., 0], edges[..., 1])
    longest = np.argsort(-lengths, axis=1, kind="stable")[:, :MAX_EDGES]
    edges, lengths = (np.take_along_axis(edges, longest[..., None], axis=1), np.sort(lengths, axis=1))
    angles = np.arctan2(edges[..., 1], edges[..., 0]) % (math.pi / 2)
    kept = lengths[:, ::-1][:, :MAX_EDGES] > 0
    for later in range(1, angles.shape[1]):
        near = _between_axes(angles[:, later, None] - angles[:, :later]) <= SAME_DIRECTION_RAD
        kept[:, later] &= ~(near & kept[:, :later]).any(axis=1)
    return angles, kept


def _padded(outlines: list[Contour], count: int) -> Array:
    """Return points (N, count, 2) of outlines (M, 1, 2), the last of each repeated."""
    points = np.empty((len(outlines), count, 2))
    for row, outline in enumerate(outlines):
        points[row, : len(outline)], points[row, len(outline) :] = outline[:, 0], outline[-1, 0]
    return points


def _between_axes(turn_rad: Array) -> Array:
    """Return the angles between two crosses of axes of which one is turned, rad, 0 to pi / 4."""
    return np.abs((turn_rad + math.pi / 4) % (math.pi / 2) - math.pi / 4)


def _complete_bits(rectangles_px: Array, bits: int, border: int) -> Array:
    """Return the outlines (N, 4, 2) of markers whose white cells may span rectangles (R, 4, 2).

    The bits are `bits` x `bits` inside a border. Up to two rows and columns of them may be black.
    """
    fewer = range(bits - 2, bits + 1)
    spans = [
        (columns, rows, left, top)
        for columns in fewer
        for rows in fewer
        for left in range(bits - columns + 1)
        for top in range(bits - rows + 1)
    ]
    columns, rows, left, top = np.array(spans, dtype=float).T
    first, n = rectangles_px[:, None, 0], bits + 2 * border
    across, along = rectangles_px[:, 1] - rectangles_px[:, 0], rectangles_px[:, 3] - rectangles_px[:, 0]
    width, height = np.linalg.norm(across, axis=1)[:, None], np.linalg.norm(along, axis=1)[:, None]
    right, down = (across / width)[:, None], (along / height)[:, None]
    cells = (width / columns + height / rows) / 2
    square = abs(width / columns - height / rows) <= 0.2 * cells
    usable = square & (cells * n >= MIN_CANDIDATE_SIDE_PX)
    corners = first - cells[..., None] * ((left + border)[:, None] * right + (top + border)[:, None] * down)
    steps = np.stack([0 * right, right, right + down, down], axis=2)
    outlines = corners[:, :, None] + n * cells[..., None, None] * steps
    return np.asarray(outlines[usable])
