"""Bearing-based laws, in a frame whose orientation all robots share."""

import numpy as np

from skyherd.geometry import ComplexArray
from skyherd.sim.baseline_laws.graphs import Law, bearings, neighbors, pull_together, spread, stiffest


def bearing_only_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return the law `u_i = -m Σ_j (I - g_ij g_ijᵀ) g*_ij`, with `g_ij = (z_j - z_i) / |z_j - z_i|`.

    From Zhao and Zelazo (Zhao-Zelazo 2016); g are the bearings, and g* those in the shape. Each robot needs
    the bearings of its neighbours in a frame of common orientation. The rotation of the shape is fixed. The
    robots' centroid and RMS distance from it are invariant. The gain m, m/s, follows from this distance.

    Args:
        shape: (N,) points of the desired shape, in the common frame.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear.
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
    """Return the law `u_i = -m Σ_j (I - g*_ij g*_ijᵀ) (z_i - z_j)`, which corrects errors across bearings.

    From Zhao and Zelazo (Zhao-Zelazo 2017), without leaders. The matrix is their bearing Laplacian, the
    best-known matrix-weighted Laplacian. Each robot needs the bearings *and ranges* of its neighbours in a
    frame of common orientation. The rotation of the shape is fixed; its size and place are free. The law is
    linear. It moves the robots to the nearest point of its kernel, in the least-squares sense.

    Args:
        shape: (N,) points of the desired shape, in the common frame.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear.
    """
    first, second = neighbors(shape).T
    across = 1j * bearings(shape, first, second)
    gain_ps /= stiffest(across, first, second, shape.size)

    def law(positions: ComplexArray) -> ComplexArray:
        off = across * (across.conj() * (positions[second] - positions[first])).real
        return gain_ps * pull_together(off, first, second, positions.size)

    return law
