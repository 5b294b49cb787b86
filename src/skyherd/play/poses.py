"""Poses as viser takes them: rotations as quaternions, and the observer's first view."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from skyherd.geometry import Array
from skyherd.render import Camera

VIEW_FOV_RAD = np.radians(40.0)
"""Vertical field of view of the observer, rad. Chosen: little perspective, so that distances compare."""

VIEW_DOWN_RAD = np.radians(32.0)
"""Angle of the first view below the horizon, rad. Chosen: the units are above the robots in the picture."""

ROTATION_GRID = 2.0**-12
"""Grid of the quaternions' components. Chosen: angles to 0.03 degrees, too little to be seen."""

PHONE_PX = 576
"""Width of a window below which viser puts the panel at its bottom, px. Defined by viser."""

PANEL_SHARE = 0.5
"""Share of the height of a phone's window that the panel covers. Chosen: as much as the scene."""

Wxyz = tuple[float, float, float, float]
Place = tuple[float, float, float]


def on_grid(values: Array, grid: float) -> Array:
    """Return values rounded to multiples of a power of two.

    A smaller motion then sends nothing, and numbers with few digits compress well.
    """
    return np.round(values / grid) * grid


def wxyz_of(rotation: Array) -> Wxyz:
    """Return the quaternion (w, x, y, z) of a rotation matrix (3, 3), of length 1 within 0.0003."""
    x, y, z, w = on_grid(Rotation.from_matrix(rotation).as_quat(), ROTATION_GRID).tolist()
    return w, x, y, z


def wxyz_about_z(angle_rad: float) -> Wxyz:
    """Return the quaternion (w, x, y, z) of a rotation about the vertical, of length 1 within 0.0003."""
    w, z = on_grid(np.array([np.cos(angle_rad / 2), np.sin(angle_rad / 2)]), ROTATION_GRID).tolist()
    return w, 0.0, 0.0, z


FACE_UP: Wxyz = (0.0, 1.0, 0.0, 0.0)
"""Rotation of a picture so that it faces up, its right to +x and its top to +y."""

FACE_UP_AHEAD = wxyz_of(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
"""Rotation of a picture so that it faces up, its top to +x: forward, in the frame of a robot."""


def field_of_view_rad(camera: Camera, zoom: float) -> float:
    """Return a camera's vertical field of view, rad, without its lens's distortion."""
    return float(2 * np.arctan(camera.size_px[1] / (2 * camera.aspect * camera.focal_px * zoom)))


@dataclass(frozen=True)
class Window:
    """Part of a window that no panel covers, in normalized device coordinates: -1 to 1, right and up.

    Attributes:
        aspect: width over height of the whole window.
        u: left and right end.
        v: lower and upper end.
    """

    aspect: float
    u: tuple[float, float]
    v: tuple[float, float]

    @classmethod
    def of(cls, width_px: int, height_px: int) -> "Window":
        """Return the free part of a window, beside viser's panel of 335 px, or above that of a phone."""
        aspect = width_px / height_px
        if width_px <= PHONE_PX:
            return cls(aspect, (-0.92, 0.92), (2 * PANEL_SHARE - 1 + 0.04, 0.92))
        return cls(aspect, (-0.95, 1 - 2 * 350 / width_px), (-0.92, 0.92))


def view_of(points_m: Array | Sequence[Place], window: Window) -> tuple[Place, Place]:
    """Return the nearest place to see all points in a window from the south, and a point looked at, m.

    Args:
        points_m: (N, 3) points that must be seen.
        window: the free part of the window.
    """
    sin, cos = np.sin(VIEW_DOWN_RAD), np.cos(VIEW_DOWN_RAD)
    axes = np.array([[1.0, 0.0, 0.0], [0.0, sin, cos], [0.0, cos, -sin]])  # right, up, ahead
    *sides, depths = axes @ np.asarray(points_m).T
    tangent = np.tan(VIEW_FOV_RAD / 2)
    bounds = []
    for along, (low, high), scale in zip(sides, (window.u, window.v), (window.aspect, 1.0), strict=True):
        # A point p is seen from c if low t (p_z - c_z) <= p_x - c_x <= high t (p_z - c_z): linear in c.
        low_slope, high_slope = low * scale * tangent, high * scale * tangent
        upper, lower = (along - low_slope * depths).min(), (along - high_slope * depths).max()
        bounds.append((lower, high_slope, upper, low_slope))
    depth = min((upper - lower) / (high - low) for lower, high, upper, low in bounds)
    centers = [(lower + high * depth + upper + low * depth) / 2 for lower, high, upper, low in bounds]
    place = np.array([*centers, depth])
    looked_at = np.array([*centers, depths.mean()])
    x, y, z = (place @ axes).tolist()
    to_x, to_y, to_z = (looked_at @ axes).tolist()
    return (x, y, z), (to_x, to_y, to_z)
