"""Refinement of quadrilateral corners by the image gradient along normals of the sides.

Blur, light and neighbours shift the threshold, and with it the boundary of a dark region. Here the brightness
is sampled along normals of each side. The edge point of a normal is the centroid of the outward increase. A
line is fitted to the edge points by iteratively reweighted least squares (Tukey's biweight). Outliers from
glare, an occlusion or a neighbour over a part of a side thus have little weight. The corners are the
intersections of the lines. The result does not depend on the marker's cells.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray, to_complex, to_points
from skyherd.vision.grey import Image, sample_grey
from skyherd.vision.row_record import RowRecord

NORMALS = 24
"""Number of normals of a side. Chosen: more add little, because neighbouring normals share pixels."""

END_SHARE = 0.1
"""Share of a side without normals at either end. Chosen: blur rounds the corners."""

STEPS = 8
"""Samples of a normal on either side of the line. Chosen: spacing of half a pixel at most."""

REACH_CELLS, MIN_REACH_PX, MAX_REACH_PX = 0.8, 1.5, 4.0
"""Length of a normal on either side, with its limits. Chosen: within the black border, and at least the
error of a quadrilateral."""

ROUNDS, REWEIGHTINGS = 2, 4
"""Iterations of sampling about the last line, and of reweighting in each line fit. Chosen."""

TUKEY_SIGMAS, MIN_SPREAD_PX = 4.7, 0.1
"""Cut-off of the biweight in standard deviations (95 % efficiency: Huber, Robust Statistics, 1981), and the
smallest standard deviation of residuals. Chosen."""

INDEPENDENT_POINTS, MIN_SUPPORT, BIAS_PX = 3.0, 0.3, 0.04
"""Edge points of a side whose errors are independent, the smallest share of them that counts, and what light
and processing shift a side by, px. Measured over 16 of the conditions of `benchmarks/odd_conditions.py`:
centres are off by 0.45 times the spread in the median."""

MEDIAN_PER_SIGMA, MIN_INLIER_WEIGHT, MIN_CROSSING = 0.6745, 0.2, 1e-3
"""Median of the absolute value of a normal deviate; weight from which on an edge point is an inlier; smallest
sine between two sides that meet. Derived; chosen; chosen."""

MIN_DIVISOR = 1e-9
"""Smallest length and weight that is divided by."""


@dataclass(frozen=True)
class EdgeFits(RowRecord):
    """Refined corners of N quadrilaterals.

    Attributes:
        corners_px: (N, 4, 2).
        spreads_px: (N,) standard deviation of an edge point about its line.
        supports: (N,) share of the edge points that are inliers.
        variances: (N, 3) of the centre along both image axes, px², and of the heading, rad².
        rises: (N,) median brightening outwards on the normals, grey levels.
    """

    corners_px: Array
    spreads_px: Array
    supports: Array
    variances: Array
    rises: Array

    def turned(self, turns: IntArray) -> "EdgeFits":
        """Return the fits with corner `turns` (N,) of each as the first."""
        order = (turns[:, None] + np.arange(4)) % 4
        return replace(self, corners_px=np.take_along_axis(self.corners_px, order[..., None], axis=1))


def fit_edges(image: Image, corners_px: Array, n_cells: int) -> EdgeFits:
    """Return the corners of dark quadrilaterals, refined by the gradient along normals of their sides.

    A side without an edge within reach does not change.

    Args:
        image: grey, (height, width).
        corners_px: (N, 4, 2) corners, clockwise in the image, with an error of a pixel or two.
        n_cells: cells along a marker's side, border included.
    """
    corners = to_complex(corners_px)
    spreads, supports, rises = np.zeros((3, len(corners)))
    sides_px = np.abs(np.roll(corners, -1, axis=1) - corners).mean(axis=1)
    for _ in range(ROUNDS if len(corners) else 0):
        sides = np.roll(corners, -1, axis=1) - corners
        lengths = np.maximum(np.abs(sides), MIN_DIVISOR)
        outward = -1j * sides / lengths
        reach = np.clip(REACH_CELLS * lengths.mean(axis=1) / n_cells, MIN_REACH_PX, MAX_REACH_PX)
        along = END_SHARE + (1 - 2 * END_SHARE) * (np.arange(NORMALS) + 0.5) / NORMALS
        feet = corners[..., None] + sides[..., None] * along
        offsets = reach[:, None] * np.arange(-STEPS, STEPS + 1) / STEPS
        at = feet[..., None] + outward[..., None, None] * offsets[:, None, None, :]
        grey = sample_grey(image, at)
        edges, weights = _edges_on_normals(grey, offsets)
        rises = np.median(np.maximum(np.diff(grey, axis=-1), 0.0).sum(axis=-1), axis=(1, 2))
        shift, tilt, spreads, supports = _robust_lines(along - 0.5, edges, weights)
        points = corners + sides * 0.5 + outward * shift
        directions = sides / lengths + outward * tilt / lengths
        corners = _meeting(points, directions, corners)
    variances = _variances(spreads, supports, sides_px)
    return EdgeFits(to_points(corners), spreads, supports, variances, rises)


def _variances(spreads_px: Array, supports: Array, sides_px: Array) -> Array:
    """Return variances (N, 3) of centre and heading.

    Two opposite sides determine one coordinate of the centre. All four determine the heading, each with the
    variance `12 σ² / (n l²)` over its length l.
    """
    shift = spreads_px**2 / (INDEPENDENT_POINTS * np.maximum(supports, MIN_SUPPORT)) + BIAS_PX**2
    length = (1 - 2 * END_SHARE) * np.maximum(sides_px, 1.0)
    turn = 3 * shift / length**2
    return np.column_stack([shift / 2, shift / 2, turn])


def _edges_on_normals(grey: Array, offsets: Array) -> tuple[Array, Array]:
    """Return centroids (N, 4, M) of the brightness increase, px outward, and weights (N, 4, M)."""
    steps = np.maximum(np.diff(grey, axis=-1), 0.0) ** 2
    middles = (offsets[:, 1:] + offsets[:, :-1]) / 2
    total = steps.sum(axis=-1)
    centroid = (steps * middles[:, None, None, :]).sum(axis=-1) / np.maximum(total, MIN_DIVISOR)
    return centroid, np.sqrt(total)


def _robust_lines(along: Array, edges: Array, weights: Array) -> tuple[Array, Array, Array, Array]:
    """Return shift and tilt (N, 4), px, of lines through edges (N, 4, M); spread and support (N,)."""
    base = weights / np.maximum(np.median(weights, axis=-1, keepdims=True), MIN_DIVISOR)
    base = np.minimum(base, 1.0)
    current, spread = base, np.zeros(edges.shape[:1])
    for _ in range(REWEIGHTINGS):
        total = np.maximum(current.sum(axis=-1), MIN_DIVISOR)
        mean_x = (current * along).sum(axis=-1) / total
        mean_y = (current * edges).sum(axis=-1) / total
        x, y = along - mean_x[..., None], edges - mean_y[..., None]
        slope = (current * x * y).sum(axis=-1) / np.maximum((current * x * x).sum(axis=-1), MIN_DIVISOR)
        left = y - slope[..., None] * x
        spread = np.maximum(np.median(np.abs(left), axis=(1, 2)) / MEDIAN_PER_SIGMA, MIN_SPREAD_PX)
        away = left / (TUKEY_SIGMAS * spread[:, None, None])
        inlier = np.where(np.abs(away) < 1, (1 - away**2) ** 2, 0.0)
        current = base * inlier
    return mean_y - slope * mean_x, slope, spread, (inlier > MIN_INLIER_WEIGHT).mean(axis=(1, 2))


def _meeting(points: ComplexArray, directions: ComplexArray, otherwise: ComplexArray) -> ComplexArray:
    """Return the intersections (N, 4) of adjacent sides, or `otherwise` for parallel sides."""
    before, its = np.roll(points, 1, axis=1), np.roll(directions, 1, axis=1)
    crossing = (its.conj() * directions).imag
    meets = np.abs(crossing) > MIN_CROSSING
    ahead = ((points - before).conj() * directions).imag / np.where(meets, crossing, 1.0)
    return np.asarray(np.where(meets, before + its * ahead, otherwise))
