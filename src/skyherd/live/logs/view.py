"""Goals and shape error of an image as the unit estimated them, for people.

A view does not affect decisions. Points are pixels of the camera's image: the true positions and the metric
scale are unknown.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.analysis.goal_points import desired_points_px
from skyherd.analysis.ground import shape_residual
from skyherd.control import Decision, Template
from skyherd.geometry import Array, IntArray, to_complex


@dataclass(frozen=True)
class View:
    """Goals and shape error of one image.

    Attributes:
        captured_s: time of capture on the unit's clock.
        ids: (N,) robots with a goal.
        goals_px: (N, 2) positions of their goals, px of the camera's image.
        shape_error: RMS distance of the robots to the best-fitting similarity of the shape, divided by their
            RMS radius. The unit estimates both on the ground. NaN with fewer than three robots.
        robots: number of robots of the shape in the image.
    """

    captured_s: float
    ids: IntArray
    goals_px: Array
    shape_error: float
    robots: int


def view_of(decision: Decision, template: Template) -> View:
    """Return the view of a decision, relative to the template with the roles known to the unit."""
    roles = decision.report.roles
    shape = template if roles is None else Template(template.ids, template.points_px[roles.roles])
    seen = decision.detections.unambiguous()
    error, robots = shape_residual(shape, seen.ids, to_complex(seen.centers_px))
    ids = np.zeros(0, dtype=np.int64) if decision.goals is None else decision.goals.ids
    return View(seen.time_s, ids, desired_points_px(decision), error, robots)
