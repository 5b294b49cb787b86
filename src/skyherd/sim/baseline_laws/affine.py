"""Laws whose equilibria are all affine images of the shape: stretched and sheared ones too.

They ask for less than a similar shape, and more than the shape is left open: `skyherd study methods` tells
how near the robots come to the best affine image as well as to the best similar one.
"""

import numpy as np

from skyherd.geometry import Array, ComplexArray
from skyherd.sim.baseline_laws.graphs import Law, modules

ROUNDS = 300
"""Rounds in which the weights of `stress_matrix` are made better. Chosen: the slowest rate of the star of 16
then changes by less than a thousandth a hundred rounds more; they take 30 ms."""


def affine_modules_law(shape: ComplexArray, gain_ps: float) -> Law:
    """The law `dz/dt = -k ∂γ/∂z / λ_max`, where γ is the sum of the modules' costs.

    From Aranda and Perez-Yus (Aranda-PerezYus 2024). A module is four robots; its cost is half of the least
    sum of squared distances of their positions from an affine image of their points in the shape. Each robot
    needs the positions of those that it shares a module with, relative to its own, in its own frame. Any
    affine image of the shape is an equilibrium, and nothing else.

    Args:
        shape: (N,) points that the robots are to form.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points lie in a line, or there are fewer than four.
    """
    rows = module_rows(shape)
    return _gradient_law(rows.T @ rows, gain_ps)


def affine_stress_law(shape: ComplexArray, gain_ps: float) -> Law:
    """The law `dz/dt = -k L z / λ_max(L)`, with a real Laplacian L whose weights are a stress of the shape.

    From Bautista, Morella, Wang and Garcia de Marina (Bautista 2025), with the collective motion that their
    modified weights add left at zero: the task has none. L 1 = 0 and L shape = 0, L is positive semidefinite
    of rank N - 3, and weights may be negative (Zhao 2018). Needs and equilibria are those of
    `affine_modules_law`; `stress_matrix` says how the weights are chosen.

    Args:
        shape: (N,) points that the robots are to form.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points lie in a line, or there are fewer than four.
    """
    return _gradient_law(stress_matrix(shape), gain_ps)


def module_rows(shape: ComplexArray) -> Array:
    """A row (M, N) a module: the unit vector η over its robots with `Σ η = 0` and `Σ η s = 0` at the shape s.

    The points of four robots, centred, span two of the three dimensions that are left beside their sum; η is
    the third. What no affine map explains of positions z is therefore `η (η · z)`, and the cost of a module
    `|η · z|² / 2`.
    """
    groups = modules(shape)
    rows = np.zeros((len(groups), shape.size))
    for row, robots in enumerate(groups):
        points = np.stack([np.ones(4), shape[robots].real, shape[robots].imag])
        rows[row, robots] = np.linalg.svd(points)[2][-1]
    return rows


def stress_matrix(shape: ComplexArray) -> Array:
    """A Laplacian L (N, N) on the modules' graph with well chosen weights: `L = Σ_m w_m η_m η_mᵀ`, w > 0.

    The papers take any weights that make L positive semidefinite of rank N - 3. Here they are those with the
    least `trace(L⁺) trace(L)`, so that no mode is much slower than the others (an A-optimal design): each
    weight is multiplied by the square root of its share in the trace of the pseudo-inverse, which lessens
    the product round by round (Silvey 1978).
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
