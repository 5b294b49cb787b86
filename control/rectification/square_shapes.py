"""What the image of a square tells of the map to the ground: its size, and by how much it is squeezed."""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray, SquareImages, fit_squares, to_complex
from skyherd.messages import Detections, centred

TINY = 1e-24
"""Areas of corners that all lie on one spot are held above this."""

HEADING_SHARE = 1 / 2
"""Variance of each of a square's three numbers over that of its heading, as of four corners with equal and
independent errors. Of markers fitted to their pixels, of 18 to 40 px, squeezes have 0.4 to 0.6 and sides
0.32 to 0.39."""

UNKNOWN_ERROR_PX = 0.1
"""Error of a corner, per axis, where a detector tells no covariance: a first guess."""


def relative_squeezes(squares: SquareImages) -> ComplexArray:
    """(N,) `ε = squeeze / conj(arm)`: by how much each square is squeezed, however it is turned."""
    return np.asarray(squares.squeezes * squares.arms / np.maximum(np.abs(squares.arms) ** 2, TINY))


def log_sides(squares: SquareImages) -> Array:
    """(N,) natural logarithms of the sides of squares that have the same areas as the images."""
    areas = np.abs(squares.arms) ** 2 - np.abs(squares.squeezes) ** 2
    return np.asarray(np.log(np.maximum(np.abs(areas), TINY)) / 2)


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
        images = fit_squares(to_complex(centred(seen.corners_px, seen.image_size_px)))
        variances = HEADING_SHARE * seen.covariances[:, 2, 2]
        told = bool((variances > 0).all())
        if not told:
            variances = (UNKNOWN_ERROR_PX / seen.sides_px) ** 2 / 2
        points = to_complex(centred(seen.centers_px, seen.image_size_px))
        return cls(seen.ids, points, log_sides(images), relative_squeezes(images), variances, told)

    def __len__(self) -> int:
        return int(self.ids.size)

    def match(self, others: "Squares") -> tuple[IntArray, IntArray]:
        """Rows of the markers that are in both, here and there."""
        here, there = np.nonzero(self.ids[:, None] == others.ids)
        return here, there
