"""Formation controllers from the literature; each is told what it needs of the truth.

Robots are single integrators here, places z (N,) complex, m, on the ground; robots i and j are neighbours
where the Delaunay triangulation of the shape joins them. Gains are such that at the shape the fastest mode
dies out at rate k, as one unit's does (control/topology/convergence_rate.py): so all are as far from
instability in discrete time.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial import Delaunay, QhullError

from skyherd.errors import InputError
from skyherd.geometry import ComplexArray, IntArray

Law = Callable[[ComplexArray], ComplexArray]
"""Velocities (N,), m/s, of robots at places (N,), m."""


def complex_laplacian_law(shape: ComplexArray, gain_ps: float) -> Law:
    """dz/dt = -k L z / λ_max(L), with a complex Laplacian: L 1 = 0 and L shape = 0.

    Lin, Wang, Han and Fu, "Distributed formation control of multi-agent systems using complex Laplacian",
    IEEE TAC 59 (2014) 1765. Each robot needs the places of its neighbours relative to its own, in its own
    frame, in one unit of length; place, turn and size of the shape are free, the robots' points of it
    fixed. The weights are theirs to choose: the sum over triangles of the projectors that a similar
    triangle leaves at zero makes L Hermitian and not negative, so that it is stable without the diagonal
    matrix that other weights need.

    Args:
        shape: (N,) points that robots are to form.
        gain_ps: k, 1/s.

    Raises:
        InputError: the points lie in a line.
    """
    matrix = complex_laplacian(shape)
    matrix *= gain_ps / np.linalg.eigvalsh(matrix)[-1]
    return lambda places: -(matrix @ places)


def complex_laplacian(shape: ComplexArray) -> ComplexArray:
    """L (N, N) of the triangles of a shape (N,): Hermitian, not negative, of rank N - 2."""
    corners = _triangles(shape)
    ahead, behind = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    weights = shape[behind] - shape[ahead]
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    rows = np.zeros((len(corners), shape.size), dtype=np.complex128)
    np.put_along_axis(rows, corners, weights, axis=1)
    return np.asarray(rows.conj().T @ rows)


def bearing_only_law(shape: ComplexArray, gain_ps: float) -> Law:
    """u_i = -m Σ_j (I - g_ij g_ijᵀ) g*_ij, with bearings g_ij = (z_j - z_i) / |z_j - z_i|.

    g* are the bearings in the shape. Zhao and Zelazo, "Bearing rigidity and almost global bearing-only
    formation stabilization", IEEE TAC 61 (2016) 1255. Each robot needs the bearings of its neighbours in a
    frame whose orientation all have in common. The shape's turn is given; the robots' centroid and RMS
    distance from it stay what they were at the start. The gain m, m/s, follows from the size that the shape
    will have, which is known once the start is.

    Args:
        shape: (N,) points that robots are to form, in the common frame.
        gain_ps: k, 1/s.

    Raises:
        InputError: the points lie in a line.
    """
    first, second = neighbors(shape).T
    wanted = _bearings(shape, first, second)
    stiffness = _bearing_rate(shape / _spread(shape), first, second)

    def law(places: ComplexArray) -> ComplexArray:
        bearings = _bearings(places, first, second)
        pulls = 1j * bearings * (bearings.conj() * wanted).imag
        gain_mps = gain_ps * _spread(places) / stiffness
        total = np.zeros(places.size, dtype=np.complex128)
        np.add.at(total, first, -pulls)
        np.add.at(total, second, pulls)
        return gain_mps * total

    return law


def neighbors(shape: ComplexArray) -> IntArray:
    """Pairs (E, 2) that the triangulation of a shape joins, each once."""
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


def _bearings(places: ComplexArray, first: IntArray, second: IntArray) -> ComplexArray:
    """Directions (E,) from the first to the second of each pair; 0 for robots on one spot."""
    apart = places[second] - places[first]
    return np.asarray(apart / np.maximum(np.abs(apart), 1e-12))


def _spread(places: ComplexArray) -> float:
    """RMS distance from the centroid."""
    return float(np.sqrt(np.mean(np.abs(places - places.mean()) ** 2)))


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
