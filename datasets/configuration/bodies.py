"""Round bodies on the ground: gaps between robots, and between robots and obstacles.

Bodies are discs about the centres of their markers. This definition of a gap is used by the check of a start,
the summary's count of collisions and the video. It is ground truth in metres. The controller knows bodies
only by marker sides in images (`skyherd.control.avoidance.proximity`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist, pdist

from skyherd.geometry import Array, IntArray


@dataclass(frozen=True)
class Bodies:
    """Robots with bodies of one radius, and K static obstacles.

    The methods number the N robots 0 to N - 1 and the obstacles N to N + K - 1. Pairs have a fixed order: all
    pairs of robots first, then each robot with each obstacle. Two obstacles form no pair; they may touch.

    Attributes:
        radius_m: radius of the robots' bodies about the centres of their markers; 0 for points.
        obstacles_m: (K, 2) centres of the obstacles.
        obstacle_radii_m: (K,) radii of the obstacles.
    """

    radius_m: float
    obstacles_m: Array
    obstacle_radii_m: Array

    def pairs(self, count: int) -> IntArray:
        """Return the body numbers (P, 2) of each pair, `P = N (N - 1) / 2 + N K` for N = `count` robots."""
        robots = np.stack(np.triu_indices(count, 1), axis=1)
        first, second = np.meshgrid(np.arange(count), count + np.arange(len(self.obstacles_m)), indexing="ij")
        return np.concatenate([robots, np.stack([first.ravel(), second.ravel()], axis=1)])

    def gaps_m(self, positions_m: Array) -> Array:
        """Return gaps (P,), m, of each pair for robots at positions (N, 2); negative in an overlap."""
        robots = pdist(positions_m) - 2 * self.radius_m
        obstacles = cdist(positions_m, self.obstacles_m) - (self.radius_m + self.obstacle_radii_m)
        return np.concatenate([robots, obstacles.ravel()])

    def overlapping(self, positions_m: Array, tolerance_m: float = 0.0) -> IntArray:
        """Return the body numbers (Q, 2) of the pairs that overlap by more than `tolerance_m`."""
        return self.pairs(len(positions_m))[self.gaps_m(positions_m) < -tolerance_m]
