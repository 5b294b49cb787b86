"""What a rectified image tells about the ground, which it shows up to a similarity: places, and the shape."""

import numpy as np

from skyherd.control import Template
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, ComplexArray, IntArray
from skyherd.messages import Detections, among
from skyherd.sim.truth_metrics import fit_shape

MIN_ROBOTS = 3
"""Robots of a shape that an image has to show for an error. *Derived*: two points always fit any shape."""


def shape_residual(template: Template, ids: IntArray, points: ComplexArray) -> tuple[float, int]:
    """How far robots are from a shape, and how many of the shape's they are.

    Args:
        template: the shape.
        ids: (N,) markers that were seen; those that are not of the shape are left out.
        points: (N,) where they are on the ground, `u + iv` in the template's sense of rotation, in any unit.

    Returns:
        RMS distance to the best-fitting similarity of the shape over the RMS radius of its robots that were
        seen, NaN of fewer than three; and the number of these.
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
    """Positions (N, 2) on the ground of the markers of a rectified image, in marker sides.

    The median marker's side is the unit of length, x runs along +u and y against +v, and the image's centre
    is the origin.
    """
    side_px = float(np.median(flat.sides_px)) if len(flat) else 1.0
    from_center_px = flat.centers_px - (flat.image_size_px - 1) / 2
    return np.asarray(from_center_px * (1, -1) / side_px)
