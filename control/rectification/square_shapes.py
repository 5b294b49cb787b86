"""What the image of a square tells of the map to the ground: its size, and by how much it is squeezed."""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray, to_complex
from skyherd.messages import Detections, centred

CORNERS: ComplexArray = np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])
"""Corners 0-3 of a marker, right + i down, in sides."""

TINY = 1e-24
"""Areas of corners that all lie on one spot are held above this."""

HEADING_SHARE = 1 / 2
"""Variance of each of a square's three numbers over that of its heading, as of four corners with equal and
independent errors. Of markers fitted to their pixels, of 18 to 40 px, squeezes have 0.4 to 0.6 and sides
0.32 to 0.39."""

UNKNOWN_ERROR_PX = 0.1
"""Error of a corner, per axis, where a detector tells no covariance: a first guess."""


@dataclass(frozen=True)
class Arms:
    """Least-squares affine images of squares: `p = center + m z + k z̄`, all (N,)."""

    arms: ComplexArray
    crosses: ComplexArray

    @classmethod
    def of_corners(cls, corners: ComplexArray) -> "Arms":
        """Of corners (N, 4)."""
        power = float(np.sum(np.abs(CORNERS) ** 2))
        return cls(corners @ CORNERS.conj() / power, corners @ CORNERS / power)

    def squeezes(self) -> ComplexArray:
        """ε = k / m̄, which does not depend on how the square is turned."""
        return np.asarray(self.crosses * self.arms / np.maximum(np.abs(self.arms) ** 2, TINY))

    def log_sides(self) -> Array:
        """Logarithms of the sides of squares of the same area."""
        areas = np.abs(self.arms) ** 2 - np.abs(self.crosses) ** 2
        return np.asarray(np.log(np.maximum(np.abs(areas), TINY)) / 2)

    def headings_rad(self) -> Array:
        """Directions of forward, z = -i, that fit both of the square's axes."""
        return np.angle(-1j * self.arms)


@dataclass(frozen=True)
class Squares:
    """N markers, in the units of `skyherd.control.rectification.ground_map`.

    Attributes:
        ids: (N,).
        points: (N,) centres.
        log_sides: (N,) logarithms of their sides.
        squeezes: (N,).
        variances: (N,) of each log side and of each component of a squeeze.
        told: whether the variances come from the detector.
    """

    ids: IntArray
    points: ComplexArray
    log_sides: Array
    squeezes: ComplexArray
    variances: Array
    told: bool

    @classmethod
    def of(cls, seen: Detections) -> "Squares":
        """What detections tell."""
        arms = Arms.of_corners(to_complex(centred(seen.corners_px, seen.image_size_px)))
        variances = HEADING_SHARE * seen.covariances[:, 2, 2]
        told = bool((variances > 0).all())
        if not told:
            variances = (UNKNOWN_ERROR_PX / seen.sides_px) ** 2 / 2
        points = to_complex(centred(seen.centers_px, seen.image_size_px))
        return cls(seen.ids, points, arms.log_sides(), arms.squeezes(), variances, told)

    def __len__(self) -> int:
        return int(self.ids.size)

    def match(self, others: "Squares") -> tuple[IntArray, IntArray]:
        """Rows of the markers that are in both, here and there."""
        here, there = np.nonzero(self.ids[:, None] == others.ids)
        return here, there
