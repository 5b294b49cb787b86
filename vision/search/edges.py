"""Refinement of quadrilateral corners by the image gradient along normals of the sides.

Blur, light and neighbours shift the threshold, and with it the boundary of a dark region. Here the brightness
is sampled along normals of each side. The edge point of a normal is the centroid of the outward increase. A
line is fitted to the edge points by iteratively reweighted least squares (Tukey's biweight). Outliers from
glare, an occlusion or a neighbour over a part of a side thus have little weight. The corners are the
intersections of the lines (`vision/native/edges.c`). The result does not depend on the marker's cells.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.native.library import library
from skyherd.vision.native.records import EdgeParameters
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
    corners_px = np.ascontiguousarray(corners_px, dtype=float)
    sides_px = np.linalg.norm(np.roll(corners_px, -1, axis=1) - corners_px, axis=2).mean(axis=1)
    refined = library().refined_corners(np.ascontiguousarray(image), corners_px, n_cells, edge_parameters())
    corners_px, spreads_px, supports, rises = refined
    return EdgeFits(corners_px, spreads_px, supports, _variances(spreads_px, supports, sides_px), rises)


@cache
def edge_parameters() -> EdgeParameters:
    """Return the parameters of the compiled refinement."""
    return EdgeParameters(
        end_share=END_SHARE,
        reach_cells=REACH_CELLS,
        min_reach_px=MIN_REACH_PX,
        max_reach_px=MAX_REACH_PX,
        tukey_sigmas=TUKEY_SIGMAS,
        min_spread_px=MIN_SPREAD_PX,
        median_per_sigma=MEDIAN_PER_SIGMA,
        min_inlier_weight=MIN_INLIER_WEIGHT,
        min_crossing=MIN_CROSSING,
        min_divisor=MIN_DIVISOR,
        normals=NORMALS,
        steps=STEPS,
        rounds=ROUNDS,
        reweightings=REWEIGHTINGS,
    )


def _variances(spreads_px: Array, supports: Array, sides_px: Array) -> Array:
    """Return variances (N, 3) of centre and heading.

    Two opposite sides determine one coordinate of the centre. All four determine the heading, each with the
    variance `12 σ² / (n l²)` over its length l.
    """
    shift = spreads_px**2 / (INDEPENDENT_POINTS * np.maximum(supports, MIN_SUPPORT)) + BIAS_PX**2
    length = (1 - 2 * END_SHARE) * np.maximum(sides_px, 1.0)
    turn = 3 * shift / length**2
    return np.column_stack([shift / 2, shift / 2, turn])
