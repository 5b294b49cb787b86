"""Exact poses of markers and their corners with known noise, for tests of `skyherd.poses`."""

import numpy as np
from scipy.spatial.transform import Rotation

from skyherd.poses import Calibration
from skyherd.poses.marker_poses import MARKER_CORNERS, lens_bend, pose_difference

MATRIX = np.array([[900.0, 0.0, 330.0], [0.0, 905.0, 235.0], [0.0, 0.0, 1.0]])
"""Camera matrix of the calibrations, px."""

CALIBRATIONS = {
    "pinhole": Calibration((640, 480), MATRIX, np.zeros(0)),
    "plumb_bob": Calibration((640, 480), MATRIX, np.array([-0.3, 0.1, 0.001, -0.002, 0.01])),
    "rational": Calibration((640, 480), MATRIX, np.array([0.2, 0.1, 0.001, -0.002, 0.01, 0.3, 0.1, 0.02])),
    "fisheye": Calibration((640, 480), MATRIX * [[0.4], [0.4], [1.0]] + [[0, 0, 198], [0, 0, 141], [0, 0, 0]],
                           np.array([0.05, -0.01, 0.003, -0.001]), fisheye=True),
}  # fmt: skip
"""A calibration of each model."""


def random_pose(rng, tilt_deg, distance_m):
    """Return a rotation and a translation, m, of a marker whose normal has a tilt from the line of sight."""
    aside = rng.uniform(-0.2, 0.2, 2)
    sight = np.array([*aside, 1.0]) / np.linalg.norm([*aside, 1.0])
    across = np.cross(sight, rng.normal(size=3))
    across /= np.linalg.norm(across)
    normal = Rotation.from_rotvec(np.radians(tilt_deg) * across).apply(-sight)
    ahead = np.cross(normal, rng.normal(size=3))
    ahead /= np.linalg.norm(ahead)
    return np.stack([ahead, np.cross(normal, ahead), normal], axis=1), distance_m * sight


def drawn_corners(rng, rotation, translation, calibration, side_m, std_px):
    """Return corners (4, 2), px, as a detector finds them, with their covariance (8, 8)."""
    mixing = np.eye(8) + 0.3 * rng.normal(size=(8, 8))
    factor = std_px * mixing
    exact = calibration.project(side_m * MARKER_CORNERS @ rotation.T + translation)
    exact = exact + lens_bend(rotation, translation, calibration, side_m)
    return exact + (factor @ rng.normal(size=8)).reshape(4, 2), factor @ factor.T


def nees(true, estimate, covariance):
    """Return the normalized estimation error squared of a pose (R, t), six degrees of freedom."""
    off = pose_difference(*estimate, *true)
    return float(off @ np.linalg.solve(covariance, off))
