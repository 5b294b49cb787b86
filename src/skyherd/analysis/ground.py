"""Positions and shape error on the ground, from rectified images that show it up to a similarity."""

import numpy as np

from skyherd.control import Template
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, ComplexArray, IntArray
from skyherd.messages import Detections, among
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


def positions_in_sides(flat: Detections) -> Array:
    """Return the ground positions (N, 2) of the markers of a rectified image, in marker sides.

    The unit of length is the median marker side. The origin is the image centre, x points along +u and y
    along -v.
    """
    side_px = float(np.median(flat.sides_px)) if len(flat) else 1.0
    from_center_px = flat.centers_px - (flat.image_size_px - 1) / 2
    return np.asarray(from_center_px * (1, -1) / side_px)
