"""What a unit knew as it decided on an image, for people: where its goals lie, and how far the shape is.

Nothing decides by it. Where robots really are is not known, nor are metres: points are pixels of the camera's
own image.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.analysis.goal_points import desired_points_px
from skyherd.analysis.ground import shape_residual
from skyherd.control import Decision, Template
from skyherd.geometry import Array, IntArray, to_complex


@dataclass(frozen=True)
class View:
    """One image as a unit decided on it.

    Attributes:
        captured_s: when it was taken, by the unit's clock.
        ids: (N,) robots that have a goal from it.
        goals_px: (N, 2) where these goals lie, px of the camera's image.
        shape_error: RMS distance of the robots in the image, on the ground that the unit has learned, to the
            best-fitting similarity of the shape, over their RMS radius; NaN of fewer than three robots.
        robots: number of robots of the shape in the image.
    """

    captured_s: float
    ids: IntArray
    goals_px: Array
    shape_error: float
    robots: int


def view_of(decision: Decision, template: Template) -> View:
    """The view of a decision, held against the template, with the roles that the unit knows."""
    roles = decision.report.roles
    shape = template if roles is None else Template(template.ids, template.points_px[roles.roles])
    seen = decision.detections.unambiguous()
    error, robots = shape_residual(shape, seen.ids, to_complex(seen.centers_px))
    ids = np.zeros(0, dtype=np.int64) if decision.goals is None else decision.goals.ids
    return View(seen.time_s, ids, desired_points_px(decision), error, robots)
