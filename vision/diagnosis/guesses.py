"""Markers whose outline no search finds: those that the image's border cuts, and those without a margin.

The corners that are left of a dark region at the border are completed to squares. Around groups of bright
spots on dark, a square is guessed for every way in which a marker's white cells may span the group. A guess
counts if all of its cells read right.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import border_cells, cells_per_side
from skyherd.messages import Detections
from skyherd.vision.diagnosis.places import on_detections
from skyherd.vision.diagnosis.reading import (
    WHITE_PERCENTILE,
    Named,
    cell_middles,
    in_image,
    is_border,
    name_quads,
    percentiles,
    read_markers,
)
from skyherd.vision.grey import Image, block_means, sample_squares
from skyherd.vision.photometric.evidence.readings import Readings, black_cells
from skyherd.vision.search.decode import DecodedQuads, no_decoded_quads

Contour = npt.NDArray[Any]
"""A contour as OpenCV has it: (M, 1, 2) points, px."""

SURE, SURE_OF_CUT = 0.93, 0.85
"""Smallest likeness of a guess, and of one that the border cuts. Chosen high, since many squares are guessed
and chance is like some marker too; lower for those that have a frame and a margin."""

MIN_VISIBLE = 0.4
"""Smallest share of the cells in the image. Chosen: half of a code's bits."""

SQUARENESS_DEG = 35.0
"""How far a corner of a cut region may differ from a right angle, degrees. Chosen: markers seen at a slant
do."""

SHRINK, MIN_PATCH_PX = 2, 12.0
"""Downsampling factor of the image in which dark regions are looked for, and their smallest side, px. Chosen:
a fit finds the place again, and smaller markers have no part that is worth a guess."""

MIN_WINDOW_PX, DARKER = 27, (14, 6)
"""Smallest width, px of the shrunk image, of the surroundings that dark regions are compared with, and how
much darker they are in each pass, grey levels. Chosen: larger than a marker of 50 px, and a sixth of the
shorter side of larger images; the second pass for faint markers."""

MAX_SIDE_RATIO = 1.2
"""Largest ratio of the sides of a dark patch. Chosen: for markers seen from nearly straight above."""

MIN_SIDE_PX = 6.0
"""Smallest side of a guess, px. Chosen: a 4x4 marker then has a pixel a cell."""

SHRINKS, CLOSINGS_PX = (1, 2, 4, 8), (3, 5)
"""Downsampling factors of the images in which bright spots are grouped, and the gaps, px of these images,
over which they are taken as one group. Chosen: each gap is about twice the last, for markers of any size."""

BRIGHT_WINDOW_PX, BRIGHTER = 41, 20
"""Bright spots are so many grey levels above the mean of a window of this width, px of the shrunk image.
Chosen: larger than a small marker."""

HULL_EDGES, HULL_ERROR_PX = 2, 1.5
"""Number of edges of a group's hull along which rectangles are laid, and by how much the hull may be
simplified, px. Measured: of 600 markers with cells of 4 to 20 px and without a margin 527 are guessed, with
one edge 512, without 492."""

MAX_GROUP_RATIO = 2.5
"""Largest ratio of a group's sides. Derived: up to two of four columns are black, with a fifth for errors."""

DARK_SHARE = 0.9
"""Share of the border's cells that must be dark around a group of bright spots. Chosen: nearly all, since
there are many groups."""

MAX_GROUPS = 400
"""Largest number of groups that are looked at for each closing, the largest first. Chosen: for the time."""

SQUARES_AT_ONCE = 8192
"""Number of squares whose borders are looked at at once. Chosen: bounds the memory."""


def guess_markers(image: Image, dictionary: str, detections: Detections) -> Named:
    """Return the markers of a grey image (height, width) that are guessed and read without a fault.

    Bright spots within detected markers are no groups.
    """
    groups = name_quads(image, bright_groups(image, dictionary, detections), dictionary)
    at = cell_middles(cells_per_side(dictionary))[1:-1]
    whole = np.asarray(in_image(image, groups.decoded.corners_px, at).all(axis=(1, 2)))
    groups = groups.take(whole)
    cut = cut_markers(image, dictionary)
    guesses = groups.joined(cut)
    least: Array = np.repeat([SURE, SURE_OF_CUT], [groups.mirrored.size, cut.mirrored.size])
    readings = read_markers(image, guesses, guesses.decoded.corners_px, dictionary)
    likeness: Array = np.array([one.likeness if one.wrong_bits == 0 else -1.0 for one in readings])
    guesses = replace(guesses, decoded=replace(guesses.decoded, correlations=likeness))
    return guesses.take(np.flatnonzero(likeness >= least))


def cut_markers(image: Image, dictionary: str) -> Named:
    """Return squares at dark regions that the border cuts, each with every marker whose cells it shows.

    The margin must be there as far as it is in the image.
    """
    squares_px = _cut_squares(image, cells_per_side(dictionary))
    if not len(squares_px):
        return Named(no_decoded_quads(), np.zeros(0, dtype=bool))
    cells, has_margin = _cut_cells(image, squares_px, dictionary)
    codes = 1 - 2 * black_cells(dictionary)
    alike = cells.reshape(len(cells), -1).astype(np.float32) @ codes.reshape(len(codes), -1).T
    fits = alike == np.abs(cells).sum(axis=(1, 2))[:, None]
    rows, found = np.nonzero(fits & has_margin[:, None])
    ids, turns = np.divmod(found, 4)
    order = (turns[:, None] + np.arange(4)) % 4
    corners_px = np.take_along_axis(squares_px[rows], order[..., None], axis=1)
    ones = np.ones(ids.size)
    return Named(DecodedQuads(ids, corners_px, ones, ones), np.zeros(ids.size, dtype=bool))


def _cut_cells(image: Image, squares_px: Array, dictionary: str) -> tuple[IntArray, BoolArray]:
    """Return the cells (N, n, n) of squares, 1 for white, -1 for black and 0 off the image.

    Also returned is which squares (N,) have a bright margin, as far as it is in the image, and enough cells
    in it.
    """
    n, frame = cells_per_side(dictionary), np.pad(is_border(dictionary), 1)
    margin = np.pad(np.zeros((n, n), dtype=bool), 1, constant_values=True)
    seen = in_image(image, squares_px, cell_middles(n))
    levels = np.where(seen, Readings.read(image, squares_px, n).cells, np.nan)
    middles = (percentiles(levels[:, frame], 50) + percentiles(levels[:, margin], 50)) / 2
    cells = np.where(seen, np.where(levels > middles[:, None, None], 1, -1), 0)
    inner, seen = cells[:, 1:-1, 1:-1], seen[:, 1:-1, 1:-1]
    return inner, (cells[:, margin] >= 0).all(axis=1) & (seen.mean(axis=(1, 2)) >= MIN_VISIBLE)


def _dark_outlines(image: Image) -> list[Contour]:
    """Return the outer contours (M, 2), px, of what is dark against its wider surroundings."""
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


def dark_patches(image: Image) -> Array:
    """Return the rectangles (N, 4, 2), px, around large dark regions that are nearly square.

    Markers that are covered in part have such regions.
    """
    rectangles = [cv2.minAreaRect(outline_px) for outline_px in _dark_outlines(image)]
    near = [cv2.boxPoints(one) for one in rectangles if max(one[1]) < MAX_SIDE_RATIO * min(one[1])]
    return _stacked(near)


def _cut_squares(image: Image, n: int) -> Array:
    """Return squares (N, 4, 2), px, through the corners left of dark regions that the image's border cuts."""
    size_px = np.array(image.shape[::-1])
    squares: list[Array] = []
    for outline_px in _dark_outlines(image):
        if not _inside(outline_px, size_px, SHRINK).all():
            squares += _complete(outline_px, size_px, n)
    return _stacked(squares)


def _complete(outline_px: Contour, size_px: Array, n: int) -> list[Array]:
    """Return squares that have the corners of an outline (M, 2), px, which lie inside the image."""
    hull = cv2.convexHull(outline_px)
    corners = cv2.approxPolyDP(hull, 0.04 * cv2.arcLength(hull, True), True)[:, 0, :].astype(float)
    if not 3 <= len(corners) <= 7:
        return []
    inside = _inside(corners, size_px, 2 * SHRINK)
    squares: list[Array] = []
    for k in np.flatnonzero(inside):
        before, here, after = corners[k - 1], corners[k], corners[(k + 1) % len(corners)]
        back, ahead = before - here, after - here
        cosine = back @ ahead / np.linalg.norm(back) / np.linalg.norm(ahead)
        if abs(np.degrees(np.arccos(np.clip(cosine, -1, 1))) - 90) > SQUARENESS_DEG:
            continue
        if inside[(k + 1) % len(corners)]:
            squares.append(_square(here, after, back))
        elif not inside[k - 1]:
            longest = max(float(np.linalg.norm(back)), float(np.linalg.norm(ahead)))
            direction = ahead / np.linalg.norm(ahead)
            for side in longest * np.geomspace(1.0, 2.5, 4 * n):
                squares.append(_square(here, here + side * direction, back))
    return squares


def _inside(points_px: Array, size_px: Array, margin_px: float) -> BoolArray:
    """Return which points (M, 2), px, have a distance from the border of an image of size (2,)."""
    return np.asarray(((points_px > margin_px) & (points_px < size_px - 1 - margin_px)).all(axis=1))


def _stacked(quads: list[Any]) -> Array:
    """Return quadrilaterals as an array (N, 4, 2)."""
    return np.array(quads, dtype=float).reshape(-1, 4, 2)


def _square(first: Array, second: Array, towards: Array) -> Array:
    """Return the square (4, 2), clockwise, with the edge given, on the side to which `towards` points."""
    edge = second - first
    across = np.array([-edge[1], edge[0]])
    if across @ towards < 0:
        return np.array([second, first, first - across, second - across])
    return np.array([first, second, second + across, first + across])


def bright_groups(image: Image, dictionary: str, detections: Detections) -> Array:
    """Return squares (N, 4, 2), px, around groups of bright spots on dark: outlines that cannot be seen.

    A rectangle around a marker's white cells is that of its bits, or lacks a row or two that are all black;
    every such completion is tried, and kept if its border is dark and its bits are a marker's.
    """
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.uint8)
    n, border = cells_per_side(dictionary), border_cells(dictionary)
    found = [np.zeros((0, 4, 2))]
    for shrink in SHRINKS:
        small, middle = block_means(smooth, shrink), (shrink - 1) / 2
        contours = _bright_contours(small, n - 2 * border, n, shrink)
        rectangles = _stacked(
            [rectangle for contour in contours for rectangle in _rectangles_around(contour)]
        )
        rectangles = rectangles[~on_detections(shrink * rectangles + middle, detections, dictionary)]
        squares = _complete_bits(rectangles, n - 2 * border, border)
        for first in range(0, len(squares), SQUARES_AT_ONCE):
            shown = _with_codes(small, squares[first : first + SQUARES_AT_ONCE], dictionary)
            found.append(shrink * shown + middle)
    return np.concatenate(found)


def _bright_contours(image: Image, bits: int, n: int, shrink: int) -> list[Contour]:
    """Return the contours of groups of bright spots in a smooth image that is shrunk by a factor."""
    if not image.size:
        return []
    bright = cv2.adaptiveThreshold(
        image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, BRIGHT_WINDOW_PX, -BRIGHTER
    )
    groups: list[Contour] = []
    for closing in CLOSINGS_PX if shrink == 1 else CLOSINGS_PX[-1:]:
        closed = cv2.morphologyEx(bright, cv2.MORPH_CLOSE, np.ones((closing, closing), dtype=np.uint8))
        contours, _ = cv2.findContours(closed, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        large = [c for c in contours if cv2.contourArea(c) > (MIN_SIDE_PX * bits / n) ** 2]
        groups += sorted(large, key=cv2.contourArea, reverse=True)[:MAX_GROUPS]
    return groups


def _rectangles_around(contour: Contour) -> list[Array]:
    """Return the smallest rectangle (4, 2) around a contour, and those along long edges of its hull.

    A contour that is too long for a marker's bits has none.
    """
    hull = cv2.convexHull(contour)
    smallest = cv2.minAreaRect(hull)
    if max(smallest[1]) > MAX_GROUP_RATIO * min(smallest[1]):
        return []
    corners = cv2.approxPolyDP(hull, HULL_ERROR_PX, True)[:, 0].astype(float)
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    found = [np.asarray(cv2.boxPoints(smallest), dtype=float)]
    for edge in np.argsort(-lengths)[:HULL_EDGES]:
        along = edges[edge] / lengths[edge]
        axes = np.array([along, (-along[1], along[0])])
        (left, top), (right, bottom) = (limit(hull[:, 0] @ axes.T, axis=0) for limit in (np.min, np.max))
        found.append(np.array([(left, top), (right, top), (right, bottom), (left, bottom)]) @ axes)
    return found


def _with_codes(image: Image, corners: Array, dictionary: str) -> Array:
    """Return the squares (N, 4, 2) with a dark border and the bits of a marker, in any turn, or mirrored."""
    n, outer = cells_per_side(dictionary), is_border(dictionary)
    levels = sample_squares(image, corners, (np.arange(n) + 0.5) / n)
    black = np.median(levels[:, outer], axis=1)
    white = np.percentile(levels[:, ~outer], WHITE_PERCENTILE, axis=1)
    is_white = levels > ((black + white) / 2)[:, None, None]
    framed = (is_white[:, outer].mean(axis=1) <= 1 - DARK_SHARE) & (white - black > BRIGHTER)
    return np.asarray(corners[framed & np.isin(_numbers(is_white[:, ~outer]), _all_codes(dictionary))])


def _numbers(bits: BoolArray) -> IntArray:
    """Return the numbers (N,) whose binary digits are bits (N, B), up to 63."""
    return np.asarray(bits @ (1 << np.arange(bits.shape[1])))


@lru_cache(maxsize=4)
def _all_codes(dictionary: str) -> IntArray:
    """Return the numbers (8 D,) of the markers of a dictionary in all turns, as they are and mirrored."""
    white = black_cells(dictionary) == 0
    inner = ~is_border(dictionary)
    return np.concatenate([_numbers(side[:, inner]) for side in (white, white[:, :, ::-1])])


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
    usable = square & (cells * n >= MIN_SIDE_PX)
    corners = first - cells[..., None] * ((left + border)[:, None] * right + (top + border)[:, None] * down)
    steps = np.stack([0 * right, right, right + down, down], axis=2)
    outlines = corners[:, :, None] + n * cells[..., None, None] * steps
    return np.asarray(outlines[usable])
