"""Markers on robots above the ground or on their sides, drawn as their shadows from the camera on the ground.

The image of a point equals that of its shadow from the camera's centre C on the ground: with a height z and
the camera's height h, the shadow of (x, y) is `(h (x, y) - z C) / (h - z)`. So every marker in space is a
homography of the ground, and lens, shutter and noise apply to it as to markers on the ground. Robots are
convex: a marker is visible if it faces the camera. Farther markers are drawn first.
"""

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.render.camera.camera import CameraPose


def shadows(pose: CameraPose, positions_m: Array, headings_rad: Array, side_m: float, frames: Array) -> Array:
    """Return homographies (N, 3, 3) from marker coordinates (forward, left), sides, to the ground, m.

    Args:
        pose: pose of the camera, above all markers.
        positions_m: (N, 2) reference points of the markers' robots on the ground.
        headings_rad: (N,) headings of these robots.
        side_m: side of the markers.
        frames: (N, 3, 3) of each marker: columns are its forward and left axis and its centre in the robot's
            frame, marker sides.
    """
    placed = _placed(positions_m, headings_rad, side_m, frames)
    (x_m, y_m), height_m = pose.position_m, pose.height_m
    rises = placed[:, 2] / height_m
    homographies = np.stack([placed[:, 0] - x_m * rises, placed[:, 1] - y_m * rises, -rises], axis=1)
    homographies[:, 2, 2] += 1.0
    return homographies


def facing_rows(
    pose: CameraPose, positions_m: Array, headings_rad: Array, side_m: float, frames: Array
) -> IntArray:
    """Return the rows of the markers that face the camera, the farthest first; see `shadows`."""
    placed = _placed(positions_m, headings_rad, side_m, frames)
    to_camera = np.array([*pose.position_m, pose.height_m]) - placed[:, :, 2]
    normals = np.cross(placed[:, :, 0], placed[:, :, 1])
    facing = np.flatnonzero(np.einsum("ni,ni->n", normals, to_camera) > 0)
    return facing[np.argsort(-np.linalg.norm(to_camera[facing], axis=1), kind="stable")]


def _placed(positions_m: Array, headings_rad: Array, side_m: float, frames: Array) -> Array:
    """Return axes times side, and centres, in the world, as columns (N, 3, 3), m."""
    c, s = np.cos(headings_rad)[:, None], np.sin(headings_rad)[:, None]
    placed = side_m * np.stack(
        [c * frames[:, 0] - s * frames[:, 1], s * frames[:, 0] + c * frames[:, 1], frames[:, 2]], axis=1
    )
    placed[:, :2, 2] += positions_m
    return placed
