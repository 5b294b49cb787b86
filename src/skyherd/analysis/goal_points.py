"""Where units ask robots to be: in the image, and how far off that is on the ground, as only truth knows."""

import numpy as np

from skyherd.control import fit_similarity
from skyherd.errors import DegenerateSetError, InputError
from skyherd.geometry import Array, ComplexArray, IntArray, apply_homography, inverse, to_complex, to_points
from skyherd.loop import UnitFrame
from skyherd.messages import Detections
from skyherd.render import Camera, CameraPose, homography_image_ground, undistort


def rectified_goals_px(frame: UnitFrame) -> Array:
    """Points (N, 2) of the rectified image where a unit wants the robots of its goals.

    The robot hears a length rho and a bearing in its own frame, counter-clockwise from its heading;
    in the image, whose angles are clockwise, rho points along `heading - bearing`.
    """
    goals = frame.decision.goals
    if goals is None:
        return np.zeros((0, 2))
    robots = frame.decision.detections
    row = rows_of(robots, goals.ids)
    rho = goals.rho_px * np.exp(1j * (robots.headings_rad[row] - goals.bearings_rad))
    return np.asarray(robots.centers_px[row] + to_points(rho))


def desired_points_px(frame: UnitFrame) -> Array:
    """Image points (N, 2) where a unit wants the robots of its goals, back from the rectified image."""
    desired_px = rectified_goals_px(frame)
    if frame.decision.ground_map.ideal:
        return desired_px
    return frame.decision.ground_map.image_px(desired_px, frame.sight.detections.image_size_px)


def rows_of(robots: Detections, ids: IntArray) -> IntArray:
    """Rows (N,) of the detections that are of robots `ids`, all of which were detected."""
    order = np.argsort(robots.ids)
    return np.asarray(order[np.searchsorted(robots.ids, ids, sorter=order)])


def desired_on_ground(template: ComplexArray, positions: ComplexArray) -> ComplexArray:
    """x^d (N,) as no camera but the truth has it: the template's similarity that fits positions (N,) best."""
    return np.asarray(fit_similarity(template, positions)(template))


def goal_error_m(
    frame: UnitFrame, camera: Camera, pose: CameraPose, template: ComplexArray, positions: ComplexArray
) -> float:
    """Largest distance on the ground from a unit's desired points to those of the truth.

    Args:
        frame: the unit's image and decision.
        camera: that took it.
        pose: where it was.
        template: (N,) points of the robots of the unit's goals, map sense.
        positions: (N,) where these robots truly are.

    Returns:
        NaN where there are no goals, or where no ray of the camera leads.
    """
    if frame.decision.goals is None:
        return float("nan")
    try:
        straight = undistort(camera, pose.zoom, desired_points_px(frame))
        truth = desired_on_ground(template, positions)
    except (InputError, DegenerateSetError):
        return float("nan")
    found = apply_homography(inverse(homography_image_ground(camera, pose)), straight)
    return float(np.abs(to_complex(found) - truth).max())
