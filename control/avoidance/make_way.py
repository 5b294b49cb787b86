"""Way for robots that retreat: others enlarge their margins towards them.

A robot that retreats from a body slows down before it reaches another robot. That robot stands and does not
know of the retreat. The unit therefore reports it a larger margin, so that it leaves in time, and the next
robot behind it as well.
"""

import numpy as np

from skyherd.geometry import Array, BoolArray

YIELD_SIDES = 1.0
"""Additional margin towards a robot that retreats, marker sides. Derived: the speed bound allows a speed u at
the gap `2 e u / γ` (docs/bodies.md), which is 0.8 sides at 0.25 sides/s and γ = 1.7 /s."""


def yielding_sides(gaps_sides: Array, is_robot: BoolArray) -> Array:
    """Return the additional margin (M, M) of each robot, by row, towards each body of an image.

    Robots with another body within their margin have the rank 1. A robot that is nearer than `YIELD_SIDES`
    to one of rank n, and has no rank up to n, has the rank n + 1. Robots yield to lower ranks only, so that
    no two robots yield to each other.

    Args:
        gaps_sides: (M, M) gaps between the bodies beyond the margin, infinite on the diagonal.
        is_robot: (M,) robots of the team; they yield to each other, and other bodies yield to none.
    """
    between = is_robot[:, None] & is_robot
    rank = np.full(is_robot.size, np.inf)
    leaving = is_robot & (gaps_sides[:, ~is_robot] <= 0).any(axis=1)
    number = 1
    while leaving.any():
        rank[leaving] = number
        close = (between & (gaps_sides < YIELD_SIDES))[:, leaving].any(axis=1)
        leaving, number = close & np.isinf(rank), number + 1
    return np.where(between & (rank < rank[:, None]), YIELD_SIDES, 0.0)
