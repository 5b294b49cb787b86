"""Laws on the angles, or on the ratios of distances, within the triangles of the shape.

Both are parts of one analytic function. With the sides `e_ij = z_j - z_i`, corner i of a triangle (i, j, k)
has

    w = log(e_ik) - log(e_ij),

whose imaginary part is the signed angle of the corner, and whose real part is the logarithm of the ratio of
its sides. Neither depends on place, rotation and size.
"""

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray, wrap_angle
from skyherd.sim.baseline_laws.graphs import MIN_DISTANCE_M, Law, spread, triangles


def angle_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return the gradient law of `Σ (α - α*)² / 2` over the corners α of the Delaunay triangles.

    From Jing, Zhang, Lee and Wang (Jing 2019) and Chen, Cao and Li (Chen 2021), who have other signals of the
    angles. Here they are signed, so that the mirrored shape is no equilibrium. Each robot needs the bearings
    of its neighbours in its own frame, and the errors of the angles that they measure. Place, rotation and
    size are free. The robots' centroid and RMS distance from it are invariant; the gain follows from the
    latter. Only local convergence is proven.

    Args:
        shape: (N,) points of the desired shape.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear.
    """
    return _corner_law(shape, gain_ps, direction=1j)


def distance_ratio_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return the gradient law of `Σ (log r - log r*)² / 2` over the ratios r of two sides at each corner.

    From Cao, Han, Li and Xie (Cao 2020), who use the ratios instead of their logarithms. Each robot needs the
    relative places of its neighbours in its own frame and unit of length, and the errors of the ratios that
    they measure. Place, rotation and size are free, and the handedness as well. Only local convergence is
    proven.

    Args:
        shape: (N,) points of the desired shape.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear.
    """
    return _corner_law(shape, gain_ps, direction=1.0)


def corners(shape: ComplexArray) -> IntArray:
    """Return the corners (3 T, 3) of the triangles of a shape: the corner i, and its neighbours j and k."""
    found = triangles(shape)
    return np.concatenate([np.roll(found, -turn, axis=1) for turn in range(3)])


def _corner_law(shape: ComplexArray, gain_ps: float, direction: complex) -> Law:
    """Return the gradient law of the parts `Re(conj(direction) w)` of all corners, at the rate k."""
    at = corners(shape)
    wanted = _parts(shape, at, direction)
    rows = _gradients(shape, at, direction) * spread(shape)
    stiffness = float(np.linalg.eigvalsh(np.real(rows @ rows.conj().T))[-1])

    def law(positions: ComplexArray) -> ComplexArray:
        errors = _parts(positions, at, direction) - wanted
        if direction == 1j:
            errors = wrap_angle(errors)
        gain = gain_ps * spread(positions) ** 2 / stiffness
        return np.asarray(-gain * (errors @ _gradients(positions, at, direction)))

    return law


def _sides(positions: ComplexArray, at: IntArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the sides e_ij (C,) and e_ik (C,) of corners (C, 3); coincident robots are set apart."""
    first, second = (positions[at[:, column]] - positions[at[:, 0]] for column in (1, 2))
    return np.where(first == 0, MIN_DISTANCE_M, first), np.where(second == 0, MIN_DISTANCE_M, second)


def _parts(positions: ComplexArray, at: IntArray, direction: complex) -> Array:
    """Return the angles, rad, or the logarithms of the ratios of distances (C,)."""
    first, second = _sides(positions, at)
    return np.asarray((np.conj(direction) * np.log(second / first)).real)


def _gradients(positions: ComplexArray, at: IntArray, direction: complex) -> ComplexArray:
    """Return the gradients (C, N) of the parts by the positions, `∂/∂x + i ∂/∂y`.

    The part of w changes by `Re(conj(direction) dw)`, and `dw = de_ik / e_ik - de_ij / e_ij`. So its
    gradient by e_ik is `direction / conj(e_ik)`.
    """
    first, second = _sides(positions, at)
    by_first, by_second = -direction / first.conj(), direction / second.conj()
    gradients = np.zeros((len(at), positions.size), dtype=np.complex128)
    rows = np.arange(len(at))
    gradients[rows, at[:, 0]] = -by_first - by_second
    gradients[rows, at[:, 1]] = by_first
    gradients[rows, at[:, 2]] = by_second
    return gradients
