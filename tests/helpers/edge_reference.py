"""The refinement of corners by edges in NumPy and double precision, as a reference of the compiled one."""

import numpy as np

from skyherd.geometry import Array, ComplexArray, to_complex, to_points
from skyherd.vision.search.edges import (
    END_SHARE,
    MAX_REACH_PX,
    MEDIAN_PER_SIGMA,
    MIN_CROSSING,
    MIN_DIVISOR,
    MIN_INLIER_WEIGHT,
    MIN_REACH_PX,
    MIN_SPREAD_PX,
    NORMALS,
    REACH_CELLS,
    REWEIGHTINGS,
    ROUNDS,
    STEPS,
    TUKEY_SIGMAS,
)


def bilinear(image: np.ndarray, places: ComplexArray) -> Array:
    """Return grey levels at places u + iv, px; places outside read the nearest pixel of the border."""
    height, width = image.shape
    u, v = np.clip(places.real, 0, width - 1), np.clip(places.imag, 0, height - 1)
    left, top = u.astype(int), v.astype(int)
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    grey, s, t = image.astype(float), u - left, v - top
    upper = grey[top, left] + s * (grey[top, right] - grey[top, left])
    lower = grey[below, left] + s * (grey[below, right] - grey[below, left])
    return np.asarray(upper + t * (lower - upper))


def reference_edges(image: np.ndarray, corners_px: Array, n_cells: int) -> tuple[Array, Array, Array, Array]:
    """Return corners (N, 4, 2), spreads, supports and rises (N,) as `refined_corners` of the library does."""
    corners = to_complex(corners_px)
    spreads, supports, rises = np.zeros((3, len(corners)))
    for _ in range(ROUNDS if len(corners) else 0):
        sides = np.roll(corners, -1, axis=1) - corners
        lengths = np.maximum(np.abs(sides), MIN_DIVISOR)
        outward = -1j * sides / lengths
        reach = np.clip(REACH_CELLS * lengths.mean(axis=1) / n_cells, MIN_REACH_PX, MAX_REACH_PX)
        along = END_SHARE + (1 - 2 * END_SHARE) * (np.arange(NORMALS) + 0.5) / NORMALS
        feet = corners[..., None] + sides[..., None] * along
        offsets = reach[:, None] * np.arange(-STEPS, STEPS + 1) / STEPS
        at = feet[..., None] + outward[..., None, None] * offsets[:, None, None, :]
        grey = bilinear(image, at)
        edges, weights = _edges_on_normals(grey, offsets)
        rises = np.median(np.maximum(np.diff(grey, axis=-1), 0.0).sum(axis=-1), axis=(1, 2))
        shift, tilt, spreads, supports = _robust_lines(along - 0.5, edges, weights)
        points = corners + sides * 0.5 + outward * shift
        directions = sides / lengths + outward * tilt / lengths
        corners = _meeting(points, directions, corners)
    return to_points(corners), spreads, supports, rises


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
