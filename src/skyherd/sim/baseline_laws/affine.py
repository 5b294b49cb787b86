"""Laws whose equilibria are all affine images of the shape, including stretched and sheared ones.

Their goal is weaker than a similar shape, because stretch and shear are undetermined. `skyherd study methods`
therefore reports the distance to the best affine image as well as to the best similar one.
"""

import numpy as np

from skyherd.geometry import Array, ComplexArray
from skyherd.sim.baseline_laws.graphs import Law, modules

ROUNDS = 300
"""Number of iterations for the weights of `stress_matrix`. Chosen: 100 more change the slowest rate of the
star of 16 by less than a thousandth; they take 30 ms."""


def affine_modules_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return the law `dz/dt = -k ∂γ/∂z / λ_max`, where γ is the sum of the modules' costs.

    From Aranda and Perez-Yus (Aranda-PerezYus 2024). A module is four robots. Its cost is half of the minimum
    sum of squared distances of their positions from an affine image of their points in the shape. Each robot
    needs the relative positions of the robots that share a module with it, in its own frame. The equilibria
    are exactly the affine images of the shape.

    Args:
        shape: (N,) points of the desired shape.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear, or there are fewer than four.
    """
    rows = module_rows(shape)
    return _gradient_law(rows.T @ rows, gain_ps)


def affine_stress_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return the law `dz/dt = -k L z / λ_max(L)`, with a real Laplacian L whose weights are a stress.

    From Bautista, Morella, Wang and Garcia de Marina (Bautista 2025), without the collective motion of their
    modified weights. L 1 = 0 and L shape = 0. L is positive semidefinite of rank N - 3, and weights may be
    negative (Zhao 2018). Required data and equilibria are those of `affine_modules_law`; see `stress_matrix`
    for the weights.

    Args:
        shape: (N,) points of the desired shape.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear, or there are fewer than four.
    """
    return _gradient_law(stress_matrix(shape), gain_ps)


def module_rows(shape: ComplexArray) -> Array:
    """Return one row (M, N) per module: a unit vector η with `Σ η = 0` and `Σ η s = 0` at the shape s.

    The points of four centred robots span two of the three dimensions orthogonal to their sum; η is the
    third. The affine residual of positions z is therefore `η (η · z)`, and the cost of a module is
    `|η · z|² / 2`.
    """
    groups = modules(shape)
    rows = np.zeros((len(groups), shape.size))
    for row, robots in enumerate(groups):
        points = np.stack([np.ones(4), shape[robots].real, shape[robots].imag])
        rows[row, robots] = np.linalg.svd(points)[2][-1]
    return rows


def stress_matrix(shape: ComplexArray) -> Array:
    """Return a Laplacian L (N, N) on the modules' graph: `L = Σ_m w_m η_m η_mᵀ`, with weights w > 0.

    The papers allow any weights that make L positive semidefinite of rank N - 3. Here the weights minimize
    `trace(L⁺) trace(L)`, so that no mode is much slower than the others (A-optimal design). Each iteration
    multiplies each weight by the square root of its share in the trace of the pseudo-inverse, which decreases
    the product (Silvey 1978).
    """
    rows = module_rows(shape)
    weights = np.full(len(rows), 1 / len(rows))
    for _ in range(ROUNDS):
        inverse = np.linalg.pinv((rows.T * weights) @ rows, hermitian=True)
        gain = ((rows @ inverse) ** 2).sum(axis=1)
        weights *= np.sqrt(gain)
        weights /= weights.sum()
    return np.asarray((rows.T * weights) @ rows)


def _gradient_law(matrix: Array, gain_ps: float) -> Law:
    scaled = matrix * (gain_ps / np.linalg.eigvalsh(matrix)[-1])
    return lambda positions: -(scaled @ positions)
