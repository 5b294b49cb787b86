"""The law for shapes that are given by the distances of neighbours: rigid frameworks, of a fixed size."""

import numpy as np

from skyherd.geometry import ComplexArray
from skyherd.sim.baseline_laws.graphs import Law, neighbors, pull_together, stiffest


def distance_law(shape: ComplexArray, gain_ps: float) -> Law:
    """The law `u_i = -m Σ_j (|z_i - z_j|² - d_ij²) (z_i - z_j)`, with the distances d of the shape.

    From Krick, Broucke and Francis (Krick 2009): the gradient of `Σ (|z_i - z_j|² - d_ij²)² / 4`. Each robot
    needs the positions of its neighbours relative to its own, in its own frame, and all know the size of the
    shape. Place and rotation are free, and so is the handedness: the mirrored shape is an equilibrium too.
    Convergence is proven from near the shape alone.

    Args:
        shape: (N,) points that the robots are to form, m.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points lie in a line.
    """
    first, second = neighbors(shape).T
    apart = shape[second] - shape[first]
    gain = gain_ps / (2 * stiffest(apart, first, second, shape.size))

    def law(positions: ComplexArray) -> ComplexArray:
        sides = positions[second] - positions[first]
        excess = np.abs(sides) ** 2 - np.abs(apart) ** 2
        return gain * pull_together(excess * sides, first, second, positions.size)

    return law
