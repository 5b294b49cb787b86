"""Shape error on the ground, from rectified images that show it up to a similarity."""

import numpy as np

from skyherd.control import Template
from skyherd.errors import DegenerateSetError
from skyherd.geometry import ComplexArray, IntArray
from skyherd.messages import among
from skyherd.sim.truth_metrics import fit_shape

MIN_ROBOTS = 3
"""Fewest robots for a shape error. *Derived*: a similarity maps any two points onto any others."""


def shape_residual(template: Template, ids: IntArray, points: ComplexArray) -> tuple[float, int]:
    """Return the shape error of the detected robots, and their number.

    Args:
        template: the shape.
        ids: (N,) detected markers; markers outside the shape are ignored.
        points: (N,) positions on the ground, `u + iv` in the template's sense of rotation, in any unit.

    Returns:
        RMS distance to the best-fitting similarity of the shape, divided by the RMS radius of the detected
        robots; NaN with fewer than three. Then the number of detected robots of the shape.
    """
    keep = among(ids, template.members)
    count = int(keep.sum())
    if count < MIN_ROBOTS:
        return np.nan, count
    try:
        return fit_shape(template.points_of(ids[keep]), points[keep]).error, count
    except DegenerateSetError:
        return np.nan, count
