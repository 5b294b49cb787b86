"""Round bodies on the ground: how much room there is between robots, and between robots and obstacles."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist, pdist

from skyherd.geometry import Array, IntArray


@dataclass(frozen=True)
class Bodies:
    """N robots with bodies of one radius, and K obstacles that stand still.

    Pairs are numbered: all pairs of robots first, then each robot with each obstacle, which counts as
    number N + k. Obstacles may touch each other.

    Attributes:
        radius_m: of the robots' bodies, about the middles of their markers; 0 for points.
        obstacles_m: (K, 2) middles of the obstacles.
        obstacle_radii_m: (K,).
    """

    radius_m: float
    obstacles_m: Array
    obstacle_radii_m: Array

    def pairs(self, count: int) -> IntArray:
        """Numbers (P, 2) of the bodies of each pair, for N robots: `P = N (N - 1) / 2 + N K`."""
        robots = np.stack(np.triu_indices(count, 1), axis=1)
        first, second = np.meshgrid(np.arange(count), count + np.arange(len(self.obstacles_m)), indexing="ij")
        return np.concatenate([robots, np.stack([first.ravel(), second.ravel()], axis=1)])

    def gaps_m(self, positions_m: Array) -> Array:
        """Room (P,) between the bodies of each pair, robots at positions (N, 2); negative in an overlap."""
        robots = pdist(positions_m) - 2 * self.radius_m
        obstacles = cdist(positions_m, self.obstacles_m) - (self.radius_m + self.obstacle_radii_m)
        return np.concatenate([robots, obstacles.ravel()])

    def overlapping(self, positions_m: Array, tolerance_m: float = 0.0) -> IntArray:
        """Numbers (Q, 2) of the bodies that overlap by more than a tolerance."""
        return self.pairs(len(positions_m))[self.gaps_m(positions_m) < -tolerance_m]
