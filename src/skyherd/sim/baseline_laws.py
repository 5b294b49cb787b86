"""Formation control laws from the literature, for comparison; each is given the true positions it needs.

Robots are single integrators here, at positions z (N,), complex, m, on the ground. Robots i and j are
neighbours where the Delaunay triangulation of the shape joins them. Gains are normalised such that at the
shape the fastest mode decays at the rate k, as it does under one unit's goals
(`skyherd.control.topology.convergence_rate`): all laws are then equally far from instability in discrete
time.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial import Delaunay, QhullError

from skyherd.errors import InputError
from skyherd.geometry import ComplexArray, IntArray

Law = Callable[[ComplexArray], ComplexArray]
"""A law: velocities (N,), m/s, of robots at positions (N,), m, both complex in the ground frame."""

LEAST_DISTANCE_M = 1e-12
"""Distances are divided by at least this, m. Chosen: robots nearer than that are in one place; their bearing
is then 0 instead of 0 / 0."""


def complex_laplacian_law(shape: ComplexArray, gain_ps: float) -> Law:
    """The law `dz/dt = -k L z / λ_max(L)`, with a complex Laplacian L: L 1 = 0 and L shape = 0.

    From Lin, Wang, Han and Fu (Lin 2014). Each robot needs the positions of its neighbours relative to its
    own, in its own frame, in a unit of length that all have in common. Place, rotation and size of the shape
    are free; each robot's point in it is fixed.

    Args:
        shape: (N,) points that the robots are to form.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points lie in a line.
    """
    matrix = complex_laplacian(shape)
    matrix *= gain_ps / np.linalg.eigvalsh(matrix)[-1]
    return lambda positions: -(matrix @ positions)


def complex_laplacian(shape: ComplexArray) -> ComplexArray:
    """The Laplacian L (N, N) of a shape (N,): Hermitian, positive semidefinite, of rank N - 2.

    The paper leaves the weights open. Here L is the sum over the triangles of the shape of `w wᴴ`, where
    `wᴴ z` is zero for the triangles similar to it. This makes L stable without the diagonal matrix that other
    weights need.

    Raises:
        InputError: the points lie in a line.
    """
    corners = _triangles(shape)
    ahead, behind = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    weights = shape[behind] - shape[ahead]
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    rows = np.zeros((len(corners), shape.size), dtype=np.complex128)
    np.put_along_axis(rows, corners, weights, axis=1)
    return np.asarray(rows.conj().T @ rows)


def bearing_only_law(shape: ComplexArray, gain_ps: float) -> Law:
    """The law `u_i = -m Σ_j (I - g_ij g_ijᵀ) g*_ij`, with bearings `g_ij = (z_j - z_i) / |z_j - z_i|`.

    From Zhao and Zelazo (Zhao-Zelazo 2016); g* are the bearings in the shape. Each robot needs the bearings
    of its neighbours in a frame whose orientation all have in common. The rotation of the shape is given; the
    robots' centroid and RMS distance from it stay what they were at the start. The gain m, m/s, follows from
    the size that the shape will have, which is known from the start.

    Args:
        shape: (N,) points that the robots are to form, in the common frame.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points lie in a line.
    """
    first, second = neighbors(shape).T
    desired = _bearings(shape, first, second)
    stiffness = _bearing_rate(shape / _spread(shape), first, second)

    def law(positions: ComplexArray) -> ComplexArray:
        bearings = _bearings(positions, first, second)
        pulls = 1j * bearings * (bearings.conj() * desired).imag
        gain_mps = gain_ps * _spread(positions) / stiffness
        total = np.zeros(positions.size, dtype=np.complex128)
        np.add.at(total, first, -pulls)
        np.add.at(total, second, pulls)
        return gain_mps * total

    return law


def neighbors(shape: ComplexArray) -> IntArray:
    """Pairs (E, 2) of points of a shape (N,) that its Delaunay triangulation joins, each once.

    Raises:
        InputError: the points lie in a line.
    """
    corners = _triangles(shape)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return np.unique(np.sort(sides, axis=1), axis=0)


def _triangles(shape: ComplexArray) -> IntArray:
    try:
        return np.asarray(Delaunay(np.column_stack([shape.real, shape.imag])).simplices, dtype=np.int64)
    except (QhullError, ValueError):
        raise InputError(
            "control.method", "the shape's points lie in a line", "a shape that has triangles, or similarity"
        ) from None


def _bearings(positions: ComplexArray, first: IntArray, second: IntArray) -> ComplexArray:
    """Unit vectors (E,) from the first to the second robot of each pair; 0 for robots in one place."""
    apart = positions[second] - positions[first]
    return np.asarray(apart / np.maximum(np.abs(apart), LEAST_DISTANCE_M))


def _spread(positions: ComplexArray) -> float:
    """RMS distance of positions (N,) from their centroid."""
    return float(np.sqrt(np.mean(np.abs(positions - positions.mean()) ** 2)))


def _bearing_rate(shape: ComplexArray, first: IntArray, second: IntArray) -> float:
    """Largest eigenvalue of the bearing law's linearisation at the shape, with m = 1."""
    count, apart = shape.size, shape[second] - shape[first]
    across = 1j * apart / np.abs(apart)
    rows = np.zeros((first.size, 2 * count))
    edge = np.arange(first.size)
    weight = 1 / np.sqrt(np.abs(apart))
    for end, sign in ((first, -1.0), (second, 1.0)):
        rows[edge, end] = sign * across.real * weight
        rows[edge, count + end] = sign * across.imag * weight
    return float(np.linalg.eigvalsh(rows.T @ rows)[-1])
