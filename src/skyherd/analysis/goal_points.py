"""Desired points of robots in the image, and their ground-truth errors.

Only this module compares goals with the true cameras and robot positions. Reports use the errors; the loop
does not.
"""

from collections.abc import Sequence

import numpy as np

from skyherd.control import Decision, Template, fit_similarity
from skyherd.errors import DegenerateSetError, InputError
from skyherd.geometry import Array, ComplexArray, IntArray, apply_homography, inverse, to_complex, to_points
from skyherd.loop import UnitFrame
from skyherd.messages import Detections
from skyherd.render import Camera, CameraPose, homography_image_ground, undistort


def rectified_goals_px(decision: Decision) -> Array:
    """Return the desired points (N, 2) of a unit's goals, px, in its rectified image.

    A goal is a length rho and a bearing in the robot's own frame, counter-clockwise from its heading. Image
    angles are clockwise seen from above, so that rho points along `heading - bearing` there. The result has
    no rows if the unit set no goals.
    """
    goals, robots = decision.goals, decision.detections
    if goals is None:
        return np.zeros((0, 2))
    row = rows_of(robots, goals.ids)
    rho = goals.rho_px * np.exp(1j * (robots.headings_rad[row] - goals.bearings_rad))
    return np.asarray(robots.centers_px[row] + to_points(rho))


def desired_points_px(decision: Decision) -> Array:
    """Return the desired points (N, 2) of a unit's goals, px, in the camera's original image."""
    desired_px = rectified_goals_px(decision)
    if decision.ground_map.ideal:
        return desired_px
    return decision.ground_map.image_px(desired_px, decision.detections.image_size_px)


def rectified_outline_px(
    decision: Decision, template: Template, lines: Sequence[ComplexArray]
) -> list[Array]:
    """Return the lines of a unit's desired shape as polylines (M, 2), px, in its rectified image.

    The similarity from the template to the unit's desired points maps the lines, so that they show the unit's
    knowledge only.

    Args:
        decision: the unit's decision.
        template: the shape, its points assigned to the robots.
        lines: polylines (M,) of the shape, in the template's units and sense.

    Returns:
        no lines for fewer than two goals, or goals that define no similarity.
    """
    if decision.goals is None or decision.goals.ids.size < 2:
        return []
    desired = to_complex(rectified_goals_px(decision))
    try:
        fit = fit_similarity(template.points_of(decision.goals.ids), desired)
    except DegenerateSetError:
        return []
    return [to_points(fit(line)) for line in lines]


def outline_px(decision: Decision, template: Template, lines: Sequence[ComplexArray]) -> list[Array]:
    """Return the lines of `rectified_outline_px` in the camera's original image."""
    fitted = rectified_outline_px(decision, template, lines)
    if decision.ground_map.ideal:
        return fitted
    return [decision.ground_map.image_px(line, decision.detections.image_size_px) for line in fitted]


def rows_of(robots: Detections, ids: IntArray) -> IntArray:
    """Return the rows (N,) of the detections of the robots `ids`, all of which must be detected."""
    order = np.argsort(robots.ids)
    return np.asarray(order[np.searchsorted(robots.ids, ids, sorter=order)])


def desired_on_ground(template: ComplexArray, positions: ComplexArray) -> ComplexArray:
    """Return the desired points x^d (N,) on the ground for true positions (N,), in the same sense.

    x^d = a p + b, with the similarity (a, b) that minimises Σ |a p_i + b - x_i|² for the template's points p.

    Raises:
        DegenerateSetError: the template's or the robots' points are all one point.
    """
    return np.asarray(fit_similarity(template, positions)(template))


def goal_error_m(
    frame: UnitFrame, camera: Camera, pose: CameraPose, template: ComplexArray, positions: ComplexArray
) -> float:
    """Return the largest ground distance, m, between a unit's desired points and the true ones.

    Args:
        frame: the unit's image and decision.
        camera: the camera that took the image.
        pose: pose of the camera.
        template: (N,) template points of the robots in the unit's goals, in map sense (y up).
        positions: (N,) true positions of these robots, m.

    Returns:
        NaN without goals, or if a desired point is not on a ray of the camera.
    """
    if frame.decision.goals is None:
        return float("nan")
    try:
        straight = undistort(camera, pose.zoom, desired_points_px(frame.decision))
        truth = desired_on_ground(template, positions)
    except InputError:
        return float("nan")
    found = apply_homography(inverse(homography_image_ground(camera, pose)), straight)
    return float(np.abs(to_complex(found) - truth).max())
