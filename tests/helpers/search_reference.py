"""Reference of the search for quadrilaterals: OpenCV filters and NumPy formulas in double precision."""

from dataclasses import dataclass

import cv2
import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_points
from skyherd.vision.grey import Image, block_means
from skyherd.vision.search.faint import stretched_contrasts
from skyherd.vision.search.quads import (
    ENLARGEMENT,
    ERODED_PX,
    GROWTH_PX,
    MAX_AREA_MISMATCH,
    MAX_EROSIONS,
    MAX_SIDE_RATIO,
    MIN_AREA_PX2,
    MIN_COMPACTNESS,
    MIN_CROSSING,
    MIN_LENGTH_PX,
    MIN_POINTS,
    MIN_QUAD_SIDE_PX,
    ROUNDED_SHARE,
    SHRINKS,
    SIDE_END_WEIGHT,
)
from skyherd.vision.search.regions import (
    DARKER,
    SHARPENING_PX,
    SMOOTHING_PX,
    WINDOWS_PX,
    Mosaic,
    crowded_places,
)

MIN_SIDE_POINTS = 2
"""Smallest number of points of a side. Derived: the direction of a single point is undefined."""


@dataclass(frozen=True)
class Boundaries:
    """B closed boundaries of dark regions, anticlockwise in the image; boundaries of holes run clockwise.

    Attributes:
        points: (P,) points of all boundaries, one boundary after the other, u + iv, px.
        lengths: (B,) number of points of each boundary.
    """

    points: ComplexArray
    lengths: IntArray


@dataclass(frozen=True)
class DarkRegions:
    """Dark regions of an image.

    Attributes:
        dark: 255 where the mosaic's image is dark.
        mosaic: the searched places of the image.
    """

    dark: Image
    mosaic: Mosaic

    def eroded(self) -> "DarkRegions":
        """Return the regions eroded by one pixel, which separates regions that touch at a corner."""
        square = np.ones((3, 3), dtype=np.uint8)
        return DarkRegions(np.asarray(cv2.erode(self.dark, square), dtype=np.uint8), self.mosaic)


def dark_regions(mosaic: Mosaic) -> DarkRegions:
    """Return the dark regions in a mosaic, by the adaptive threshold."""
    mask = cv2.resize(mosaic.mask, mosaic.image.shape[::-1], interpolation=cv2.INTER_NEAREST)
    return DarkRegions(np.asarray(cv2.bitwise_and(_dark(mosaic.image), mask), dtype=np.uint8), mosaic)


def enlarged(mosaic: Mosaic) -> Mosaic:
    """Return a mosaic enlarged by `ENLARGEMENT`."""
    size = {"fx": ENLARGEMENT, "fy": ENLARGEMENT}
    image = cv2.resize(mosaic.image, None, **size, interpolation=cv2.INTER_LINEAR)
    mask = cv2.resize(mosaic.mask, None, **size, interpolation=cv2.INTER_NEAREST)
    return Mosaic(
        np.asarray(image, dtype=np.uint8),
        np.asarray(mask, dtype=np.uint8),
        ENLARGEMENT * mosaic.begins,
        ENLARGEMENT * mosaic.offsets,
    )


def dark_boundaries(regions: DarkRegions, min_points: int) -> Boundaries:
    """Return the boundaries of dark regions with at least `min_points` points."""
    mosaic = regions.mosaic
    contours, _ = cv2.findContours(regions.dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    boundaries = [contour for contour in contours if len(contour) >= min_points]
    if not boundaries:
        return Boundaries(np.zeros(0, dtype=complex), np.zeros(0, dtype=np.int64))
    lengths = np.array([len(boundary) for boundary in boundaries])
    joined = np.concatenate(boundaries)[:, 0].astype(float)
    shifts = mosaic.shifts(joined[np.cumsum(lengths) - lengths, 0])
    return Boundaries(joined[:, 0] + 1j * joined[:, 1] + np.repeat(shifts, lengths), lengths)


def _dark(image: Image) -> Image:
    """Return the dark pixels of an image as 255, by the adaptive threshold."""
    smooth, wide = _mean(image, SMOOTHING_PX), _mean(_mean(image, SHARPENING_PX), SHARPENING_PX)
    sharp = np.asarray(cv2.addWeighted(smooth, 2.0, wide, -1.0, 0.0), dtype=np.uint8)
    surroundings = cv2.max(*(_mean(sharp, width) for width in WINDOWS_PX))
    _, dark = cv2.threshold(cv2.subtract(surroundings, sharp), DARKER, 255, cv2.THRESH_BINARY)
    return np.asarray(dark, dtype=np.uint8)


def _mean(image: Image, width: int) -> Image:
    """Return the mean over a box around each pixel."""
    return np.asarray(cv2.blur(image, (width, width)), dtype=np.uint8)


def find_quads(
    image: Image,
    known_px: Array | None = None,
    min_darkness: float = 0.0,
    shrinks: tuple[int, ...] = SHRINKS,
) -> Array:
    """Return the quadrilaterals of `skyherd.vision.search.quads.find_quads`."""
    found = []
    for shrink in shrinks:
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
    """Return the quadrilaterals of `skyherd.vision.search.quads.small_quads`."""
    regions, found = dark_regions(enlarged(mosaic)), []
    min_area_px2 = ENLARGEMENT**2 * MIN_AREA_PX2
    for erosions in range(MAX_EROSIONS + 1):
        boundaries = dark_boundaries(regions, ENLARGEMENT * MIN_POINTS // 2)
        found.append(_quads_of(boundaries, GROWTH_PX + erosions * ERODED_PX, min_area_px2=min_area_px2))
        regions = regions.eroded()
    return (np.concatenate(found) + 0.5) / ENLARGEMENT - 0.5


def find_faint_quads(image: Image, known_px: Array, noise: float) -> Array:
    """Return the quadrilaterals of `skyherd.vision.search.faint.find_faint_quads`."""
    fine, coarse = stretched_contrasts(image, noise)
    return np.concatenate([find_quads(fine, known_px, shrinks=(1,)), find_quads(coarse, known_px)])


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
    rows = _corner_rows(points, starts, lengths)
    corners = _lines_met(*_sides(points, starts, lengths, rows), growth_px)
    counts = np.diff(rows, axis=1, append=rows[:, :1] + lengths[:, None])
    directed = (counts >= MIN_SIDE_POINTS).all(axis=1)
    return to_points(corners[directed & is_quad(corners, area, growth_px)])


def _cross(a: ComplexArray, b: ComplexArray) -> Array:
    return np.asarray((a.conj() * b).imag)


def _squared(a: ComplexArray) -> Array:
    return np.asarray(a.real**2 + a.imag**2)


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
    # Multiples of the distances, in whole numbers, so that equal distances are equal in any arithmetic.
    origin = np.repeat(points[starts], lengths)
    middle = np.add.reduceat(points - origin, starts)
    off_middle = np.repeat(lengths, lengths) * (points - origin) - np.repeat(middle, lengths)
    first = _rows_of_largest(_squared(off_middle), starts, lengths)
    third = _rows_of_largest(_squared(points - np.repeat(points[first], lengths)), starts, lengths)
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


def is_quad(corners: ComplexArray, area: Array, growth_px: float) -> BoolArray:
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
