"""Detection of dark quadrilaterals in an image.

Boundaries of dark regions (`skyherd.vision.search.regions`) are filtered by the compactness of their area.
Four corner points are selected on each boundary, and a line is fitted to each side. All boundaries of an
image are processed together, by NumPy operations on all their points.
"""

import math

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_points
from skyherd.vision.grey import Image, block_means
from skyherd.vision.search.regions import (
    ENLARGEMENT,
    Boundaries,
    Mosaic,
    crowded_places,
    dark_boundaries,
    dark_regions,
)

MIN_QUAD_SIDE_PX = 7.0
"""Shortest side of a dark region, px between the centres of its outermost pixels. Chosen: a marker of 8 px,
which is half a pixel longer at either end, is the smallest that can be decoded."""

MIN_AREA_PX2 = MIN_QUAD_SIDE_PX**2 / 2
"""Smallest area within a boundary, px². Chosen: half of the smallest square's, so that tilted squares
pass."""

MIN_COMPACTNESS = 0.035
"""Smallest ratio of the area to the squared boundary length. Chosen: a little over half of a square's 1/16
(1/8 for diagonal steps), so that tilted squares pass and lines do not."""

GROWTH_PX = 0.5
"""Outward shift of the sides, px. Derived: boundaries pass through the centres of a region's outermost
pixels, half a pixel within its edge."""

ERODED_PX = 1.0
"""Inward shift of a region's sides by erosion, px. Derived: `DarkRegions.eroded` removes one pixel."""

MAX_EROSIONS = 2
"""Erosions of the enlarged image after which regions are looked at, each by half a pixel of the image.
Chosen: they part small squares that touch at their corners, which a whole pixel would destroy."""

SHRINKS = (1, 2, 4)
"""Downsampling factors of the images in which erosion separates touching regions. Chosen: erosion breaks
bridges of two pixels in each, thus of up to eight pixels; larger factors lose most markers."""

ROUNDED_SHARE = 0.125
"""Share of a side that the line fit ignores at either end, because blur rounds the corners. Chosen: a larger
share leaves fewer points, a smaller one tilts the line."""

SIDE_END_WEIGHT = 1e-6
"""Weight of the points at the rounded ends, so that a side of a few pixels still has a line. Chosen: far
below 1, the weight of the other points."""

MIN_LENGTH_PX = 1e-12
"""Smallest divisor of a direction, px; a side of one point has no direction. Chosen."""

MIN_CROSSING = 1e-6
"""Smallest sine of the angle between adjacent sides. Chosen: quadrilaterals with more parallel sides are
rejected."""

MIN_POINTS = math.ceil(4 * MIN_QUAD_SIDE_PX / math.sqrt(2))
"""Smallest number of boundary points. Derived: a square rotated by 45 degrees has `side / sqrt(2)` boundary
pixels a side."""

MAX_SIDE_RATIO = 4.0
"""Largest ratio of a quadrilateral's sides. Derived: a tilt of 75 degrees shortens a side 3.9 times."""

MAX_AREA_MISMATCH = 0.3
"""Largest relative difference between the areas of a region and its quadrilateral. Chosen: quadrilaterals
through points of other outlines differ more."""


def find_quads(image: Image, known_px: Array | None = None, min_darkness: float = 0.0) -> Array:
    """Return the corners (N, 4, 2), px, of the dark quadrilaterals in a grey image (height, width).

    The corners run clockwise in the image and begin with any of the four. A quadrilateral may be found
    several times, because regions are searched as they are and after erosion. Erosion separates markers from
    dark squares that touch their corners. It is also applied to images of half and a quarter of the size,
    where it breaks wider bridges.

    Args:
        image: grey.
        known_px: (K, 4, 2) corners of known squares, px, to exclude in order to save time. Measured for
            markers at a distance of 1.6 sides from known ones: all of 14 px or more are found, and a third of
            those of 10 px.
        min_darkness: as in `crowded_places`. Measured under typical blur, as a share of the contrast: at
            least 0.075 for squares of 9 px or more, and 0.05 for squares of 8 px.
    """
    found = []
    for shrink in SHRINKS:
        small = image if shrink == 1 else block_means(image, shrink)
        middle = (shrink - 1) / 2
        known = None if known_px is None else (known_px - middle) / shrink
        mosaic = crowded_places(small, known, min_darkness)
        if mosaic is None:
            continue
        regions = dark_regions(mosaic)
        if shrink == 1:
            found.append(_quads_of(dark_boundaries(regions, MIN_POINTS), GROWTH_PX))
        apart = _quads_of(dark_boundaries(regions.eroded(), MIN_POINTS), GROWTH_PX + ERODED_PX)
        found.append(shrink * apart + middle)
    return np.concatenate(found) if found else np.zeros((0, 4, 2))


def small_quads(mosaic: Mosaic) -> Array:
    """Return the corners (N, 4, 2), px, of dark quadrilaterals in enlarged parts of an image.

    Relative to the enlarged image, the smoothing filters are half as wide. Cells of 1.5 px stay separate from
    the surroundings, and narrow quadrilaterals stay whole. The search takes three times as long as at the
    original size.
    """
    regions, found = dark_regions(mosaic.enlarged()), []
    min_area_px2 = (ENLARGEMENT * MIN_QUAD_SIDE_PX) ** 2 / 2
    for erosions in range(MAX_EROSIONS + 1):
        boundaries = dark_boundaries(regions, ENLARGEMENT * MIN_POINTS // 2)
        found.append(_quads_of(boundaries, GROWTH_PX + erosions * ERODED_PX, min_area_px2=min_area_px2))
        regions = regions.eroded()
    return (np.concatenate(found) + 0.5) / ENLARGEMENT - 0.5


def _quads_of(boundaries: Boundaries, growth_px: float, *, min_area_px2: float = MIN_AREA_PX2) -> Array:
    """Return corners (N, 4, 2) of the quadrilaterals among boundaries, with sides shifted outwards."""
    points, lengths = boundaries.points, boundaries.lengths
    if not lengths.size:
        return np.zeros((0, 4, 2))
    starts = np.cumsum(lengths) - lengths
    area = _areas(points, starts, lengths)
    # Outer boundaries have a positive area, those of holes a negative area.
    square = (area > min_area_px2) & (area > MIN_COMPACTNESS * lengths**2)
    if not square.any():
        return np.zeros((0, 4, 2))
    points, lengths, area = points[np.repeat(square, lengths)], lengths[square], area[square]
    starts = np.cumsum(lengths) - lengths
    sides = _sides(points, starts, lengths, _corner_rows(points, starts, lengths))
    corners = _lines_met(*sides, growth_px)
    return to_points(corners[_is_quad(corners, area, growth_px)])


def _cross(a: ComplexArray, b: ComplexArray) -> Array:
    return np.asarray((a.conj() * b).imag)


def _areas(points: ComplexArray, starts: IntArray, lengths: IntArray) -> Array:
    """Return the signed area within each boundary; positive around dark regions."""
    following = np.roll(points, -1)
    following[starts + lengths - 1] = points[starts]
    return np.asarray(-np.add.reduceat(_cross(points, following), starts) / 2)


def _rows_of_largest(values: Array, starts: IntArray, lengths: IntArray) -> IntArray:
    """Return for each boundary the row of its largest value, the first of equals."""
    largest = np.repeat(np.maximum.reduceat(values, starts), lengths)
    rows = np.flatnonzero(values == largest)
    return np.asarray(rows[np.searchsorted(rows, starts)])


def _corner_rows(points: ComplexArray, starts: IntArray, lengths: IntArray) -> IntArray:
    """Return the rows (N, 4) of four corner points on each boundary, in ascending order.

    One is farthest from the boundary's mean, and the opposite one is farthest from it. The other two are
    farthest from the diagonal between them, on either side.
    """
    middle = np.add.reduceat(points, starts) / lengths
    first = _rows_of_largest(np.abs(points - np.repeat(middle, lengths)), starts, lengths)
    third = _rows_of_largest(np.abs(points - np.repeat(points[first], lengths)), starts, lengths)
    off_diagonal = _cross(
        np.repeat(points[third] - points[first], lengths), points - np.repeat(points[first], lengths)
    )
    second = _rows_of_largest(off_diagonal, starts, lengths)
    fourth = _rows_of_largest(-off_diagonal, starts, lengths)
    return np.sort(np.stack([first, second, third, fourth], axis=1), axis=1)


def _sides(
    points: ComplexArray, starts: IntArray, lengths: IntArray, rows: IntArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return a point on each side (N, 4) and its direction, by total least squares between corner `rows`."""
    # Rotate each boundary so that it begins at its first corner. The points of a side are then contiguous.
    shift = rows[:, 0] - starts
    within = np.arange(points.size) - np.repeat(starts, lengths)
    ring = np.repeat(starts, lengths) + (within + np.repeat(shift, lengths)) % np.repeat(lengths, lengths)
    points = points[ring]
    begins = (rows - shift[:, None]).ravel()
    counts = np.maximum(np.diff(np.append(begins, points.size)), 0)
    # Blur rounds the ends of a side, so they have a negligible weight.
    share = (np.arange(points.size) - np.repeat(begins, counts)) / np.repeat(np.maximum(counts, 1), counts)
    weight = (np.abs(share - 0.5) <= 0.5 - ROUNDED_SHARE).astype(float) + SIDE_END_WEIGHT
    mean = np.add.reduceat(weight * points, begins) / np.add.reduceat(weight, begins)
    # The line passes through the mean, along the complex square root of Σ (p - mean)².
    along = np.sqrt(np.add.reduceat(weight * (points - np.repeat(mean, counts)) ** 2, begins))
    chord = np.roll(points[begins].reshape(-1, 4), -1, axis=1).ravel() - points[begins]
    along = np.where((along.conj() * chord).real < 0, -along, along)
    along /= np.maximum(np.abs(along), MIN_LENGTH_PX)
    return np.asarray(mean.reshape(-1, 4), dtype=complex), np.asarray(along.reshape(-1, 4))


def _lines_met(means: ComplexArray, along: ComplexArray, growth_px: float) -> ComplexArray:
    """Return the intersections (N, 4), clockwise, of adjacent sides shifted outwards by `growth_px`."""
    # Boundaries run anticlockwise in the image, so outwards is to the right of the direction (v is down).
    means = means + growth_px * 1j * along
    before_means = np.take(means, [3, 0, 1, 2], axis=1)
    before = np.take(along, [3, 0, 1, 2], axis=1)
    crossing = _cross(before, along)
    crossing = np.where(np.abs(crossing) < MIN_CROSSING, np.inf, crossing)
    corners = before_means + before * (_cross(means - before_means, along) / crossing)
    return np.asarray(corners[:, ::-1])


def _is_quad(corners: ComplexArray, area: Array, growth_px: float) -> BoolArray:
    """Return the mask (N,) of convex quadrilaterals with valid side ratio, side and area."""
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.abs(sides)
    following, products = np.roll(sides, -1, axis=1), lengths * np.roll(lengths, -1, axis=1)
    convex = (_cross(sides, following) > MIN_CROSSING * products).all(axis=1)
    inside = _cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
    grown = area + growth_px * lengths.sum(axis=1)
    shortest = lengths.min(axis=1)
    return np.asarray(
        convex
        & (shortest >= MIN_QUAD_SIDE_PX)
        & (lengths.max(axis=1) <= MAX_SIDE_RATIO * shortest)
        & (np.abs(inside - grown) <= MAX_AREA_MISMATCH * inside)
    )
