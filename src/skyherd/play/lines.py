"""Lines in the scene, as segments (N, 2, 3), m."""

from typing import TYPE_CHECKING

import numpy as np

from skyherd.geometry import Array
from skyherd.play.poses import Place

if TYPE_CHECKING:
    import viser

CIRCLE_SEGMENTS = 24
"""Segments of a circle. Chosen: looks round."""

SRGB_GAMMA = 2.2
"""Exponent from sRGB values to light. Defined by IEC 61966-2-1, to a per cent."""


def chain(points: Array) -> Array:
    """Return the segments (N, 2, 3) of a polyline (N + 1, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


def lifted(points_m: Array, height_m: float) -> Array:
    """Return ground points (..., 2) as points (..., 3) at a height."""
    return np.concatenate([points_m, np.full((*points_m.shape[:-1], 1), height_m)], axis=-1)


def circles(centers_m: Array, radius_m: float) -> Array:
    """Return the segments of horizontal circles about points (N, 3), one circle after the other."""
    return (centers_m[:, None, None] + radius_m * UNIT_CIRCLE).reshape(-1, 2, 3)


def circle(radius_m: float, height_m: float) -> Array:
    """Return the segments of a horizontal circle above the origin."""
    return circles(np.array([[0.0, 0.0, height_m]]), radius_m)


def _circle() -> Array:
    angles_rad = np.linspace(0.0, 2 * np.pi, CIRCLE_SEGMENTS + 1)
    return chain(lifted(np.column_stack([np.cos(angles_rad), np.sin(angles_rad)]), 0.0))


UNIT_CIRCLE = _circle()
"""Segments (CIRCLE_SEGMENTS, 2, 3) of a circle of radius 1."""


class Lines:
    """A set of line segments that changes at each step. Unchanged parts are not sent again.

    Args:
        scene: the scene of the server.
        name: name of the node.
        thickness_px: width on the screen.
    """

    def __init__(self, scene: "viser.SceneApi", name: str, thickness_px: float) -> None:
        self._node = scene.add_line_segments(
            name,
            np.zeros((1, 2, 3), np.float32),
            np.zeros((1, 2, 3), np.uint8),
            thickness=thickness_px,
            thickness_units="screen",
            visible=False,
        )

    def show(self, segments: Array, colors: Array) -> None:
        """Show segments (N, 2, 3), m, in 8-bit sRGB colours (3,) or (N, 3)."""
        self._node.visible = bool(len(segments))
        if len(segments):
            # viser draws the colours of lines as linear light, unlike those of all other objects.
            linear = np.rint(255 * (np.asarray(colors) / 255) ** SRGB_GAMMA).astype(np.uint8)
            each = np.broadcast_to(linear, (len(segments), 3))
            self._node.points = segments.astype(np.float32)
            self._node.colors = np.repeat(each[:, None], 2, axis=1)

    def move(self, place_m: Place) -> None:
        """Move the origin of the segments to a place, m."""
        self._node.position = place_m
