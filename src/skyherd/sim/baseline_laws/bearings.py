"""Laws for shapes that are given by the bearings of neighbours, in a frame that all robots have in common."""

import numpy as np

from skyherd.geometry import ComplexArray
from skyherd.sim.baseline_laws.graphs import Law, bearings, neighbors, pull_together, spread, stiffest


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
    desired, apart = bearings(shape, first, second), np.abs(shape[second] - shape[first]) / spread(shape)
    stiffness = stiffest(1j * desired / np.sqrt(apart), first, second, shape.size)

    def law(positions: ComplexArray) -> ComplexArray:
        seen = bearings(positions, first, second)
        across = 1j * seen * (seen.conj() * desired).imag
        gain_mps = gain_ps * spread(positions) / stiffness
        return -gain_mps * pull_together(across, first, second, positions.size)

    return law


def bearings_with_ranges_law(shape: ComplexArray, gain_ps: float) -> Law:
    """The law `u_i = -m Σ_j (I - g*_ij g*_ijᵀ) (z_i - z_j)`: neighbours are pulled onto their bearings.

    From Zhao and Zelazo (Zhao-Zelazo 2017), without leaders. The matrix is their bearing Laplacian, the
    best-known matrix-weighted one. Each robot needs the bearings *and ranges* of its neighbours in a frame
    whose orientation all have in common. The rotation of the shape is given, its size and place are free:
    the law is linear, and takes the robots to the nearest point of its kernel, by least squares.

    Args:
        shape: (N,) points that the robots are to form, in the common frame.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points lie in a line.
    """
    first, second = neighbors(shape).T
    across = 1j * bearings(shape, first, second)
    gain_ps /= stiffest(across, first, second, shape.size)

    def law(positions: ComplexArray) -> ComplexArray:
        off = across * (across.conj() * (positions[second] - positions[first])).real
        return gain_ps * pull_together(off, first, second, positions.size)

    return law
