"""Bodies in the video: discs about robots, safety margins, obstacles, overlaps."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from skyherd.datasets import Mission
from skyherd.drawing.canvas import Color, circle_dashes, draw_circle, draw_lines, draw_segments
from skyherd.drawing.palette import INK, MUTED, PAPER, WARNING, rgb
from skyherd.geometry import Array, BoolArray, RgbImage

CLEAR: Color = (237, 239, 242)
BODY: Color = (222, 226, 231)
BODY_RIM: Color = (164, 170, 178)
STONE: Color = (190, 195, 201)
STRUCK: Color = (247, 205, 208)
"""Colours: safety margin, body and rim, obstacle, and an overlapping body, whose rim is WARNING."""

HATCH_PX = 7.0
"""Distance between the lines of an obstacle's hatching."""


@dataclass(frozen=True)
class BodySizes:
    """Sizes of robots and obstacles, in marker sides.

    Attributes:
        radius: radius of the robots' bodies; 0 for points.
        safety: radius of the discs that must not overlap, a body and half of the margin; 0 without avoidance.
        obstacles: radius of each obstacle, by id.
    """

    radius: float = 0.0
    safety: float = 0.0
    obstacles: Mapping[int, float] = field(default_factory=dict)

    @classmethod
    def of(cls, mission: Mission) -> "BodySizes":
        """Return the sizes of a mission's bodies."""
        scenario = mission.scenario
        radius, rule = scenario.robots.body_radius_sides, scenario.avoidance
        safety = radius + rule.margin_sides / 2 if rule.on and radius else 0.0
        return cls(radius, safety, {obstacle.id: obstacle.radius_sides for obstacle in scenario.obstacles})


def overlapping_ids(mission: Mission, positions_m: Array) -> frozenset[int]:
    """Return the ids of overlapping robots and obstacles for robot positions (N, 2), m."""
    everybody = np.concatenate([mission.ids, mission.obstacle_ids])
    return frozenset(everybody[mission.bodies.overlapping(positions_m)].ravel().tolist())


def draw_bodies(image: RgbImage, centers: Array, radius_px: float, struck: BoolArray) -> None:
    """Draw bodies as discs around centres (N, 2), px; overlapping ones (N,) in a warning colour."""
    for center, is_struck in zip(centers.tolist(), struck.tolist(), strict=True):
        draw_circle(image, center, radius_px, STRUCK if is_struck else BODY, -1)
        if not is_struck:
            draw_circle(image, center, radius_px, BODY_RIM, 1)
    for center in centers[struck].tolist():
        draw_warning(image, center, radius_px)


def draw_warning(image: RgbImage, center: list[float], radius_px: float) -> None:
    """Draw a thick rim around a body that overlaps another."""
    draw_circle(image, center, radius_px + 2, rgb(PAPER), 7)
    draw_circle(image, center, radius_px + 2, rgb(WARNING), 4)


def draw_safety(image: RgbImage, centers: Array, radii_px: Array, color: Color = BODY_RIM) -> None:
    """Draw safety margins as dashed circles, px, around centres (N, 2) with radii (N,)."""
    for center, radius_px in zip(centers, radii_px.tolist(), strict=True):
        draw_lines(image, circle_dashes(center, radius_px, 4.0), color, 1)


def draw_obstacle(image: RgbImage, center: Array, radius_px: float, inner_px: float, *, struck: bool) -> None:
    """Draw an obstacle as a hatched disc with a dark rim.

    The area within `inner_px` of its centre stays empty, so that a marker in a camera's picture is visible.
    """
    if not inner_px:
        draw_circle(image, center.tolist(), radius_px, STRUCK if struck else STONE, -1)
    else:
        draw_circle(image, center.tolist(), radius_px, rgb(PAPER), 5)
    starts, ends = _hatching(center, radius_px, inner_px)
    draw_segments(image, starts, ends, rgb(MUTED), 1)
    draw_circle(image, center.tolist(), radius_px, rgb(INK), 2)
    if struck:
        draw_warning(image, center.tolist(), radius_px)


def _hatching(center: Array, radius_px: float, inner_px: float) -> tuple[Array, Array]:
    """Return slanted lines (M, 2) to (M, 2) over the ring between two radii."""
    count = int(radius_px // HATCH_PX)
    off = HATCH_PX * np.arange(-count, count + 1)
    outer = np.sqrt(np.maximum(radius_px**2 - off**2, 0.0))
    inner = np.sqrt(np.maximum(inner_px**2 - off**2, 0.0))
    along, across = np.array([1.0, -1.0]) / np.sqrt(2), np.array([1.0, 1.0]) / np.sqrt(2)
    middles = center + off[:, None] * across
    near, far = inner[:, None] * along, outer[:, None] * along
    return np.concatenate([middles + near, middles - near]), np.concatenate([middles + far, middles - far])
