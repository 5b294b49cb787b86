"""Dark quadrilaterals in an image: where markers may be.

Of the boundaries of the dark regions (`skyherd.vision.search.regions`) those that enclose an area as a square
does are kept, four corners are taken on each, and a line is fitted to each of the four sides. All boundaries
of an image are treated at once.
"""

import math

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_points
from skyherd.vision.search.regions import dark_boundaries

MIN_SIDE_PX = 7.0
"""Shortest side of a dark region that is looked at, between centres of its outermost pixels."""

MIN_COMPACTNESS = 0.035
"""Least area over squared length; a square's is 1/16, or 1/8 when its steps run diagonally."""

GROWTH_PX = 0.5
"""Dark regions end at the centres of their outermost pixels: the edge is half a pixel further out."""

ROUNDED = 0.125
"""Share of a side at either end that is not used to fit its line."""

LEAST_POINTS = math.ceil(4 * MIN_SIDE_PX / math.sqrt(2))
"""A square whose sides run diagonally has a boundary of side / sqrt(2) pixels a side."""

MAX_SIDE_RATIO = 3.0
MAX_AREA_MISMATCH = 0.3
"""Largest ratio of sides, and relative difference between the areas of a region and its quadrilateral."""


def find_quads(image: npt.NDArray[np.uint8]) -> Array:
    """Corners (N, 4, 2) of the dark quadrilaterals in a grey image, clockwise as seen, in no set order."""
    boundaries = dark_boundaries(image, LEAST_POINTS)
    points, lengths = boundaries.points, boundaries.lengths
    if not lengths.size:
        return np.zeros((0, 4, 2))
    starts = np.cumsum(lengths) - lengths
    area = _areas(points, starts, lengths)
    # Outer boundaries run one way round, those of holes the other.
    square = (area > MIN_SIDE_PX**2 / 2) & (area > MIN_COMPACTNESS * lengths**2)
    if not square.any():
        return np.zeros((0, 4, 2))
    points, lengths, area = points[np.repeat(square, lengths)], lengths[square], area[square]
    starts = np.cumsum(lengths) - lengths
    corners = _lines_met(*_sides(points, starts, lengths, _corner_rows(points, starts, lengths)))
    return to_points(corners[_is_quad(corners, area)])


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
    weight = (np.abs(share - 0.5) <= 0.5 - ROUNDED).astype(float) + 1e-6
    mean = np.add.reduceat(weight * points, begins) / np.add.reduceat(weight, begins)
    along = np.sqrt(np.add.reduceat(weight * (points - np.repeat(mean, counts)) ** 2, begins))
    chord = np.roll(points[begins].reshape(-1, 4), -1, axis=1).ravel() - points[begins]
    along = np.where((along.conj() * chord).real < 0, -along, along)
    along /= np.maximum(np.abs(along), 1e-12)
    return np.asarray(mean.reshape(-1, 4), dtype=complex), np.asarray(along.reshape(-1, 4))


def _lines_met(means: ComplexArray, along: ComplexArray) -> ComplexArray:
    """Corners (N, 4), clockwise, where each side, half a pixel further out, meets the one before it."""
    # Boundaries run anticlockwise as seen: outwards is to the right of the way along, +v being down.
    means = means + GROWTH_PX * 1j * along
    before_means = np.take(means, [3, 0, 1, 2], axis=1)
    before = np.take(along, [3, 0, 1, 2], axis=1)
    crossing = _cross(before, along)
    crossing = np.where(np.abs(crossing) < 1e-6, np.inf, crossing)
    corners = before_means + before * (_cross(means - before_means, along) / crossing)
    return np.asarray(corners[:, ::-1])


def _is_quad(corners: ComplexArray, area: Array) -> BoolArray:
    """Which corners (N, 4) make a convex quadrilateral, not too oblong, of the region's own area."""
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.abs(sides)
    convex = (_cross(sides, np.roll(sides, -1, axis=1)) > 0).all(axis=1)
    inside = _cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
    grown = area + GROWTH_PX * lengths.sum(axis=1)
    shortest = lengths.min(axis=1)
    return np.asarray(
        convex
        & (shortest >= MIN_SIDE_PX)
        & (lengths.max(axis=1) <= MAX_SIDE_RATIO * shortest)
        & (np.abs(inside - grown) <= MAX_AREA_MISMATCH * inside)
    )
