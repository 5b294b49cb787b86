"""Dark quadrilaterals in an image: where markers may be.

Of the boundaries of the dark regions (`skyherd.vision.search.regions`), those are kept that enclose an area
as a square does. Four corners are taken on each, and a line is fitted to each of the four sides. All
boundaries of an image are treated at once, by NumPy operations on all of their points.
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
"""Shortest side of a dark region that is looked at, px between the centres of its outermost pixels. Chosen: a
marker of 8 px, half a pixel further out on either side, is the smallest that can be told from others."""

MIN_AREA_PX2 = MIN_QUAD_SIDE_PX**2 / 2
"""Smallest area within a boundary, px². Chosen: half of the smallest square's, so that squares at a slant
pass."""

MIN_COMPACTNESS = 0.035
"""Smallest area over squared length of the boundary. Chosen: a little over half of a square's 1/16 (1/8 when
its steps run diagonally), so that squares seen at a slant pass and lines do not."""

GROWTH_PX = 0.5
"""By how much the sides are moved outwards, px. Derived: boundaries run through the centres of the outermost
pixels of a region, whose edge is half a pixel further out."""

ERODED_PX = 1.0
"""By how much erosion moves a region's sides inwards, px. Derived: `DarkRegions.eroded` takes off one."""

MAX_EROSIONS = 2
"""Erosions of the enlarged image after which regions are looked at, each by half a pixel of the image.
Chosen: they part small squares that touch at their corners, which a whole pixel would destroy."""

SHRINKS = (1, 2, 4)
"""By how much images are shrunk in which regions are parted from what touches them. Chosen: bridges of two
pixels break in each, so that those of up to eight do; more would lose all but the largest markers."""

ROUNDED_SHARE = 0.125
"""Share of a side at either end that is not used to fit its line, since blur rounds the corners. Chosen:
larger leaves fewer points, smaller bends the line."""

SIDE_END_WEIGHT = 1e-6
"""Weight of the points at the rounded ends, so that a side of a few pixels still has a line. Chosen far below
1, the weight of the others."""

MIN_LENGTH_PX = 1e-12
"""Smallest length that a direction is divided by; a side of one point has no direction."""

MIN_CROSSING = 1e-6
"""Smallest sine of the angle between two sides that are made to meet; sides more parallel than this have no
corner, and the quadrilateral is refused."""

MIN_POINTS = math.ceil(4 * MIN_QUAD_SIDE_PX / math.sqrt(2))
"""Smallest number of boundary points. Derived: a square whose sides run diagonally has a boundary of
`side / sqrt(2)` pixels a side."""

MAX_SIDE_RATIO = 4.0
"""Largest ratio of a quadrilateral's sides. Derived: a tilt of 75 degrees shortens a side by 3.9."""

MAX_AREA_MISMATCH = 0.3
"""Largest relative difference between the areas of a region and of its quadrilateral. Chosen: a quadrilateral
through four corners of some other outline misses more."""


def find_quads(image: Image, known_px: Array | None = None, min_darkness: float = 0.0) -> Array:
    """Return the corners (N, 4, 2), px, of the dark quadrilaterals in a grey image (height, width).

    Corners run clockwise as seen and begin with any of the four. A quadrilateral may be found several times:
    regions are looked at as they are, and without their outermost pixels, which parts markers from dark
    squares that touch their corners; the latter also in images of half and a quarter of the size, where wider
    bridges break.

    Args:
        image: grey.
        known_px: (K, 4, 2) corners of squares, px, that need not be found again, which takes time. Measured:
            of markers beside them, 1.6 sides from middle to middle, all are found from 14 px on, and a third
            of those of 10 px.
        min_darkness: of `crowded_places`. Measured under usual blur: squares of 9 px and more have 0.075 of
            their contrast or more, those of 8 px 0.05.
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
    """Return the corners (N, 4, 2), px, of dark quadrilaterals that places of an image show when enlarged.

    The filters that keep noise off are then half as wide: cells of a pixel and a half do not run together
    with what is around the marker, and slim quadrilaterals stay whole. It takes three times as long as the
    search of the same places in their own size.
    """
    regions, found = dark_regions(mosaic.enlarged()), []
    min_area_px2 = (ENLARGEMENT * MIN_QUAD_SIDE_PX) ** 2 / 2
    for erosions in range(MAX_EROSIONS + 1):
        boundaries = dark_boundaries(regions, ENLARGEMENT * MIN_POINTS // 2)
        found.append(_quads_of(boundaries, GROWTH_PX + erosions * ERODED_PX, min_area_px2=min_area_px2))
        regions = regions.eroded()
    return (np.concatenate(found) + 0.5) / ENLARGEMENT - 0.5


def _quads_of(boundaries: Boundaries, growth_px: float, *, min_area_px2: float = MIN_AREA_PX2) -> Array:
    """Corners (N, 4, 2) of the quadrilaterals among boundaries, their sides moved outwards by `growth_px`."""
    points, lengths = boundaries.points, boundaries.lengths
    if not lengths.size:
        return np.zeros((0, 4, 2))
    starts = np.cumsum(lengths) - lengths
    area = _areas(points, starts, lengths)
    # Outer boundaries run one way round, those of holes the other.
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
    """Area within each boundary; positive for those around dark regions."""
    following = np.roll(points, -1)
    following[starts + lengths - 1] = points[starts]
    return np.asarray(-np.add.reduceat(_cross(points, following), starts) / 2)


def _rows_of_largest(values: Array, starts: IntArray, lengths: IntArray) -> IntArray:
    """For each boundary the row of its largest value, the first of equals."""
    largest = np.repeat(np.maximum.reduceat(values, starts), lengths)
    rows = np.flatnonzero(values == largest)
    return np.asarray(rows[np.searchsorted(rows, starts)])


def _corner_rows(points: ComplexArray, starts: IntArray, lengths: IntArray) -> IntArray:
    """RowRecord (N, 4) of four corners along each boundary.

    The first is farthest from the boundary's middle, the second farthest from the first, the others
    farthest from the diagonal between them on either side.
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
    """A point on each side (N, 4) and its direction, by lines fitted to the stretches between corner `rows`.

    Each line is the total least-squares one: through the mean, along the square root of `Σ (p - mean)²`.
    """
    # Turn each boundary so that it begins at its first corner: the stretches are then contiguous.
    shift = rows[:, 0] - starts
    within = np.arange(points.size) - np.repeat(starts, lengths)
    ring = np.repeat(starts, lengths) + (within + np.repeat(shift, lengths)) % np.repeat(lengths, lengths)
    points = points[ring]
    begins = (rows - shift[:, None]).ravel()
    counts = np.maximum(np.diff(np.append(begins, points.size)), 0)
    # The ends of a stretch are rounded by blur and left out.
    share = (np.arange(points.size) - np.repeat(begins, counts)) / np.repeat(np.maximum(counts, 1), counts)
    weight = (np.abs(share - 0.5) <= 0.5 - ROUNDED_SHARE).astype(float) + SIDE_END_WEIGHT
    mean = np.add.reduceat(weight * points, begins) / np.add.reduceat(weight, begins)
    along = np.sqrt(np.add.reduceat(weight * (points - np.repeat(mean, counts)) ** 2, begins))
    chord = np.roll(points[begins].reshape(-1, 4), -1, axis=1).ravel() - points[begins]
    along = np.where((along.conj() * chord).real < 0, -along, along)
    along /= np.maximum(np.abs(along), MIN_LENGTH_PX)
    return np.asarray(mean.reshape(-1, 4), dtype=complex), np.asarray(along.reshape(-1, 4))


def _lines_met(means: ComplexArray, along: ComplexArray, growth_px: float) -> ComplexArray:
    """Corners (N, 4), clockwise, where each side, `growth_px` further out, meets the one before it."""
    # Boundaries run anticlockwise as seen: outwards is to the right of the way along, +v being down.
    means = means + growth_px * 1j * along
    before_means = np.take(means, [3, 0, 1, 2], axis=1)
    before = np.take(along, [3, 0, 1, 2], axis=1)
    crossing = _cross(before, along)
    crossing = np.where(np.abs(crossing) < MIN_CROSSING, np.inf, crossing)
    corners = before_means + before * (_cross(means - before_means, along) / crossing)
    return np.asarray(corners[:, ::-1])


def _is_quad(corners: ComplexArray, area: Array, growth_px: float) -> BoolArray:
    """Which corners (N, 4) make a convex quadrilateral, not too oblong, of the region's own area."""
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
