"""Who is whose neighbour in a shape, and what laws of several families compute of neighbours."""

from collections.abc import Callable
from itertools import permutations

import numpy as np
from scipy.spatial import Delaunay, QhullError

from skyherd.errors import InputError
from skyherd.geometry import ComplexArray, IntArray

Law = Callable[[ComplexArray], ComplexArray]
"""A law: velocities (N,), m/s, of robots at positions (N,), m, both complex in the ground frame."""

MIN_DISTANCE_M = 1e-12
"""Distances are divided by at least this, m. Chosen: robots nearer than that are in one place; their bearing
is then 0 instead of 0 / 0."""


MIN_HEIGHT = 1e-6
"""Triangles that are lower than this share of their longest side are left out. Chosen: far above the rounding
of coordinates, 1e-16, by which points along a line make triangles, and far below the triangles of any shape
that robots with bodies could form."""


def triangles(shape: ComplexArray) -> IntArray:
    """Corners (T, 3) of the Delaunay triangles of a shape (N,), but for those that are flat by rounding.

    Raises:
        InputError: the points lie in a line.
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
    """Pairs (E, 2) of points of a shape (N,) that its Delaunay triangulation joins, each once.

    Raises:
        InputError: the points lie in a line.
    """
    corners = triangles(shape)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return np.unique(np.sort(sides, axis=1), axis=0)


def modules(shape: ComplexArray) -> IntArray:
    """Groups of four points (M, 4): two Delaunay triangles that share a side make one.

    Two groups that share a triangle have three points in common. Triangles hang together by their sides, so
    that all groups do: the team is made of interlaced modules, as Aranda and Perez-Yus demand
    (Aranda-PerezYus 2024). In each row the two points that the triangles do not share come last.

    Raises:
        InputError: the points lie in a line, or there are fewer than four.
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
    """Links (2 E, 2), who needs to know of whom, of pairs (E, 2) that need to know of one another."""
    return np.concatenate([pairs, pairs[:, ::-1]])


def within(groups: IntArray) -> IntArray:
    """Links (L, 2), each once, of robots that need to know all others of their groups (M, G)."""
    pairs = [groups[:, [i, j]] for i, j in permutations(range(groups.shape[1]), 2)]
    return np.unique(np.concatenate(pairs), axis=0)


def bearings(positions: ComplexArray, first: IntArray, second: IntArray) -> ComplexArray:
    """Unit vectors (E,) from the first to the second robot of each pair; 0 for robots in one place."""
    apart = positions[second] - positions[first]
    return np.asarray(apart / np.maximum(np.abs(apart), MIN_DISTANCE_M))


def pull_together(pulls: ComplexArray, first: IntArray, second: IntArray, count: int) -> ComplexArray:
    """Sums (N,) at each robot of what pairs (E,) pull: the first robot with `pulls`, the second against."""
    total = np.zeros(count, dtype=np.complex128)
    np.add.at(total, first, pulls)
    np.add.at(total, second, -pulls)
    return total


def spread(positions: ComplexArray) -> float:
    """RMS distance of positions (N,) from their centroid."""
    return float(np.sqrt(np.mean(np.abs(positions - positions.mean()) ** 2)))


def stiffest(directions: ComplexArray, first: IntArray, second: IntArray, count: int) -> float:
    """The largest eigenvalue of `RᵀR`, where row e of R (E, 2 N) has direction e at both its robots.

    R takes velocities to how fast the first robot of each pair moves against the second, along the pair's
    direction (a complex number, whose length is a weight).

    Args:
        directions: (E,) one a pair.
        first: (E,) a robot of each pair.
        second: (E,) the other.
        count: N.
    """
    rows, edge = np.zeros((first.size, 2 * count)), np.arange(first.size)
    for end, sign in ((first, -1.0), (second, 1.0)):
        rows[edge, end] = sign * directions.real
        rows[edge, count + end] = sign * directions.imag
    return float(np.linalg.eigvalsh(rows.T @ rows)[-1])
