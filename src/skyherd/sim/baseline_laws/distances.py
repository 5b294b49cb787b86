"""Distance-based law: rigid frameworks of a fixed size."""

import numpy as np

from skyherd.geometry import ComplexArray
from skyherd.sim.baseline_laws.graphs import Law, neighbors, pull_together, stiffest


def distance_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return the law `u_i = -m Σ_j (|z_i - z_j|² - d_ij²) (z_i - z_j)`, with the shape's distances d.

    From Krick, Broucke and Francis (Krick 2009): the gradient of `Σ (|z_i - z_j|² - d_ij²)² / 4`. Each robot
    needs the relative positions of its neighbours in its own frame, and the size of the shape. Place and
    rotation are free. The handedness is free as well: the mirrored shape is another equilibrium. Only local
    convergence is proven.

    Args:
        shape: (N,) points of the desired shape, m.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear.
    """
    first, second = neighbors(shape).T
    apart = shape[second] - shape[first]
    gain = gain_ps / (2 * stiffest(apart, first, second, shape.size))

    def law(positions: ComplexArray) -> ComplexArray:
        sides = positions[second] - positions[first]
        excess = np.abs(sides) ** 2 - np.abs(apart) ** 2
        return gain * pull_together(excess * sides, first, second, positions.size)

    return law
