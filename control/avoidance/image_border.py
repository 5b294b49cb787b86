"""What lies beyond the border of a unit's image, while robots are missing that no unit sees.

Units tell robots of the bodies that they see, and a robot that no unit sees is in no message. Where one unit
is left of several, such robots stand beyond the border of its image, for want of goals, and a robot that it
sees may drive over one of them. So while some robot has not been seen by any unit for `UNSEEN_S`, a unit
reports the four sides of its image as bodies that stand still (`BORDER_IDS`): no robot that it alone sees
comes nearer to a side than a body behind it allows. The sides are half-planes in the rectified image, and the
bound on approach speeds (`skyherd.control.avoidance.speed_bound`) holds for the nearest point of a half-plane
as for the centre of a body.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.rectification.ground_map import GroundMap
from skyherd.geometry import Array, ComplexArray, IntArray, to_complex
from skyherd.messages import Detections, UnitReport, find_rows

UNSEEN_S = 1.0
"""A robot that no unit has seen for longer may stand beyond a border, s. Chosen: several images, so that a
marker that is missed in some of them changes nothing, and below the time for which robots remember bodies
that are no longer reported (`AvoidanceRule.lifetime_s`, 2 s), so that the border takes over before that."""

HIDDEN_SIDES = 1.0
"""How far inside the image the centre of a marker may lie that is not seen, in its sides. Chosen: half the
diagonal of a marker that a border cuts is 0.71, and of a card of 1.4 sides, which detectors want whole, 1."""

POINTS_A_SIDE = 17
"""Points of each side that are rectified. Chosen: a rectified side is a straight line, or bent by the lens
over its whole length; between points so close it strays from the chords by less than 1 % of the bend."""

QUARTER_TURN = 1j
"""Turns the direction of a side, clockwise around the image, into its inward normal, as v points down."""


@dataclass(frozen=True)
class ImageBorder:
    """The largest intersection of four half-planes, one a side of the image, that the image surely shows.

    A point x = u + iv of the rectified image, px, is inside where `Re(conj(n) x) >= c` for every side.

    Attributes:
        normals: (4,) n, unit vectors that point inwards: of the upper, right, lower and left side.
        offsets_px: (4,) c.
    """

    normals: ComplexArray
    offsets_px: Array

    @classmethod
    def of(cls, image_size_px: Array, ground_map: GroundMap) -> "ImageBorder":
        """The border of an image of a size (2,), px, as `ground_map` rectifies it.

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
        """Distances (N, 4), px, of points (N,) of the rectified image from the sides, positive inside."""
        return np.asarray((self.normals.conj() * points[:, None]).real - self.offsets_px)


@dataclass(frozen=True)
class HiddenBeyond:
    """A border beyond which robots may stand that no unit sees.

    Attributes:
        border: of the image.
        concerned_ids: (B,) robots that no other unit sees, and that are to keep away from it. What lies
            beyond the border near any other robot is in that unit's image.
    """

    border: ImageBorder
    concerned_ids: IntArray


class HiddenRobots:
    """Watches whether any robot is hidden: when each was last seen by any unit that this one hears.

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
        """The border of this image if robots may stand beyond it, else None.

        At the first image all robots count as seen just now.

        Args:
            detections: all markers of the image, rectified.
            reports: the last report of each other unit.
            ground_map: by which the detections were rectified.
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
