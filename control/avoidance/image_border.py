"""Image border as an obstacle while some robots are visible to no unit.

Units report to robots the bodies that they see. A robot that no unit sees is in no message. If only one of
several units survives, such robots stand beyond the border of its image, since they get no goals. A visible
robot could then drive over one of them.

If some robot has been unseen by all units for `UNSEEN_S`, a unit reports the four sides of its image as
static bodies (`BORDER_IDS`). A robot that only this unit sees then keeps the distance to a side that a body
behind it requires. The sides are half-planes in the rectified image. The bound on approach speeds
(`skyherd.control.avoidance.speed_bound`) applies to the nearest point of a half-plane as to the centre of a
body.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.rectification.ground_map import GroundMap
from skyherd.geometry import Array, ComplexArray, IntArray, to_complex
from skyherd.messages import Detections, UnitReport, find_rows

UNSEEN_S = 1.0
"""Time after which an unseen robot may stand beyond a border, s. Chosen: several images, so that missed
markers have no effect, and below the robots' memory of bodies (`AvoidanceRule.lifetime_s`, 2 s)."""

HIDDEN_SIDES = 1.0
"""Maximum depth inside the image of the centre of an undetected marker, marker sides. Chosen: 0.71 is half
the diagonal of a cut marker, 1 that of a card of 1.4 sides."""

POINTS_A_SIDE = 17
"""Number of points per side that are rectified. Chosen: a lens bends a side over its whole length; between 17
points the curve deviates from its chords by less than 1 % of the bend."""

QUARTER_TURN = 1j
"""Rotates the direction of a side, clockwise around the image, to its inward normal, since v points down."""


@dataclass(frozen=True)
class ImageBorder:
    """Largest intersection of four half-planes, one per side, that the image is certain to show.

    A point x = u + iv of the rectified image, px, is inside where `Re(conj(n) x) >= c` for every side.

    Attributes:
        normals: (4,) n, unit vectors that point inwards: of the upper, right, lower and left side.
        offsets_px: (4,) c.
    """

    normals: ComplexArray
    offsets_px: Array

    @classmethod
    def of(cls, image_size_px: Array, ground_map: GroundMap) -> "ImageBorder":
        """Return the border of an image of a size (2,), px, as `ground_map` rectifies it.

        Each side is replaced by the line parallel to its chord through its innermost point.
        """
        width, height = np.asarray(image_size_px, dtype=float)
        corners = np.array([0, width, width + 1j * height, 1j * height]) - (0.5 + 0.5j)
        along = np.linspace(0.0, 1.0, POINTS_A_SIDE)
        points = corners[:, None] * (1 - along) + np.roll(corners, -1)[:, None] * along
        if not ground_map.ideal:
            raw_px = np.stack([points.real.ravel(), points.imag.ravel()], axis=1)
            points = to_complex(ground_map.rectified_px(raw_px, image_size_px)).reshape(points.shape)
        chords = points[:, -1] - points[:, 0]
        normals = QUARTER_TURN * chords / np.abs(chords)
        return cls(normals, (normals.conj()[:, None] * points).real.max(axis=1))

    def depths_px(self, points: ComplexArray) -> Array:
        """Return distances (N, 4), px, of rectified points (N,) from the sides, positive inside."""
        return np.asarray((self.normals.conj() * points[:, None]).real - self.offsets_px)


@dataclass(frozen=True)
class HiddenBeyond:
    """Image border beyond which unseen robots may stand.

    Attributes:
        border: border of the image.
        concerned_ids: (B,) robots that no other unit sees and that must avoid the border. Any other robot
            gets the bodies beyond the border from another unit.
    """

    border: ImageBorder
    concerned_ids: IntArray


class HiddenRobots:
    """Monitor of the time at which each robot was last seen by any unit in radio range.

    Args:
        ids: (N,) the team, ascending.
    """

    def __init__(self, ids: IntArray) -> None:
        self._ids = ids
        self._seen_s: Array | None = None
        self._by_others_s: Array = np.full(ids.size, -np.inf)

    def beyond(
        self, detections: Detections, reports: Sequence[UnitReport], ground_map: GroundMap
    ) -> HiddenBeyond | None:
        """Return the border of this image if robots may stand beyond it, or None.

        At the first image all robots count as just seen.

        Args:
            detections: all markers of the image, rectified.
            reports: the last report of each other unit.
            ground_map: rectification map of the detections.
        """
        now_s = detections.time_s
        if self._seen_s is None:
            self._seen_s = np.full(self._ids.size, now_s)
        if reports:
            ids = np.concatenate([report.ids for report in reports])
            times_s = np.repeat(
                [report.time_s for report in reports], [report.ids.size for report in reports]
            )
            rows, is_robot = find_rows(self._ids, ids)
            np.maximum.at(self._by_others_s, rows[is_robot], times_s[is_robot])
        rows, is_robot = find_rows(self._ids, detections.ids)
        self._seen_s[rows[is_robot]] = now_s
        np.maximum(self._seen_s, self._by_others_s, out=self._seen_s)
        if (self._seen_s >= now_s - UNSEEN_S).all():
            return None
        border = ImageBorder.of(detections.image_size_px, ground_map)
        return HiddenBeyond(border, self._ids[self._by_others_s < now_s - UNSEEN_S])
