"""Neighbour graphs of a shape, and computations shared by the families of laws."""

from collections.abc import Callable
from itertools import permutations

import numpy as np
from scipy.spatial import Delaunay, QhullError

from skyherd.errors import InputError
from skyherd.geometry import ComplexArray, IntArray

Law = Callable[[ComplexArray], ComplexArray]
"""Law: velocities (N,), m/s, of robots at positions (N,), m, both complex in the ground frame."""

MIN_DISTANCE_M = 1e-12
"""Minimum divisor of distances, m. Chosen: it gives coincident robots a bearing of 0 instead of 0 / 0."""


MIN_HEIGHT = 1e-6
"""Minimum height of a triangle, as a share of its longest side. Chosen: far above the rounding of
coordinates, 1e-16, which makes triangles of collinear points, and far below the triangles of any shape of
robots with bodies."""


def triangles(shape: ComplexArray) -> IntArray:
    """Return the corners (T, 3) of the Delaunay triangles of a shape (N,), without degenerate ones.

    Raises:
        InputError: the points are collinear.
    """
    try:
        corners = np.asarray(Delaunay(np.column_stack([shape.real, shape.imag])).simplices, dtype=np.int64)
    except (QhullError, ValueError):
        corners = np.zeros((0, 3), dtype=np.int64)
    sides = shape[np.roll(corners, -1, axis=1)] - shape[corners]
    height = np.abs((sides[:, 0].conj() * sides[:, 1]).imag) / np.maximum(np.abs(sides).max(axis=1), 1e-300)
    corners = np.asarray(corners[height > MIN_HEIGHT * np.abs(sides).max(axis=1)])
    if not corners.size:
        raise InputError(
            "control.method", "the shape's points lie in a line", "a shape that has triangles, or similarity"
        )
    return corners


def neighbors(shape: ComplexArray) -> IntArray:
    """Return the edges (E, 2) of the Delaunay triangulation of a shape (N,), each once.

    Raises:
        InputError: the points are collinear.
    """
    corners = triangles(shape)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return np.unique(np.sort(sides, axis=1), axis=0)


def modules(shape: ComplexArray) -> IntArray:
    """Return groups of four points (M, 4): two Delaunay triangles with a common side form one group.

    Two groups that share a triangle have three points in common. Triangles are connected by their sides, and
    so are all groups. They are interlaced modules, as required by Aranda and Perez-Yus (Aranda-PerezYus
    2024). The last two points of each row are those that the triangles do not share.

    Raises:
        InputError: the points are collinear, or there are fewer than four.
    """
    by_side: dict[tuple[int, int], list[int]] = {}
    for corners in triangles(shape).tolist():
        for number, corner in enumerate(corners):
            first, second = sorted(corners[:number] + corners[number + 1 :])
            by_side.setdefault((first, second), []).append(corner)
    found = [(*side, *apart) for side, apart in sorted(by_side.items()) if len(apart) == 2]
    if not found:
        raise InputError("control.method", f"a shape of {shape.size} points", "at least 4, for modules")
    return np.array(found, dtype=np.int64)


def both_ways(pairs: IntArray) -> IntArray:
    """Return directed links (2 E, 2), from robot to required robot, for undirected pairs (E, 2)."""
    return np.concatenate([pairs, pairs[:, ::-1]])


def within(groups: IntArray) -> IntArray:
    """Return directed links (L, 2), each once, from each robot to all others of its groups (M, G)."""
    pairs = [groups[:, [i, j]] for i, j in permutations(range(groups.shape[1]), 2)]
    return np.unique(np.concatenate(pairs), axis=0)


def bearings(positions: ComplexArray, first: IntArray, second: IntArray) -> ComplexArray:
    """Return unit vectors (E,) from the first to the second robot of each pair; 0 for coincident robots."""
    apart = positions[second] - positions[first]
    return np.asarray(apart / np.maximum(np.abs(apart), MIN_DISTANCE_M))


def pull_together(pulls: ComplexArray, first: IntArray, second: IntArray, count: int) -> ComplexArray:
    """Return the sums (N,) of pairwise terms (E,): positive at the first robot, negative at the second."""
    total = np.zeros(count, dtype=np.complex128)
    np.add.at(total, first, pulls)
    np.add.at(total, second, -pulls)
    return total


def spread(positions: ComplexArray) -> float:
    """Return the RMS distance of positions (N,) from their centroid."""
    return float(np.sqrt(np.mean(np.abs(positions - positions.mean()) ** 2)))


def stiffest(directions: ComplexArray, first: IntArray, second: IntArray, count: int) -> float:
    """Return the largest eigenvalue of `RᵀR`, where row e of R (E, 2 N) has direction e at both robots.

    R maps velocities to the relative speeds of the pairs along their directions. A direction is a complex
    number, whose magnitude is a weight.

    Args:
        directions: (E,) direction of each pair.
        first: (E,) first robot of each pair.
        second: (E,) second robot of each pair.
        count: number N of robots.
    """
    rows, edge = np.zeros((first.size, 2 * count)), np.arange(first.size)
    for end, sign in ((first, -1.0), (second, 1.0)):
        rows[edge, end] = sign * directions.real
        rows[edge, count + end] = sign * directions.imag
    return float(np.linalg.eigvalsh(rows.T @ rows)[-1])
