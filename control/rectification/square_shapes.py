"""Image of a square marker as a measurement of the map to the ground: its size and its anisotropy."""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray, SquareImages, fit_squares, to_complex
from skyherd.messages import Detections, centred

TINY = 1e-24
"""Minimum area of a square's image, in squares of half an image's shorter side. Chosen: it keeps the
logarithm of coincident corners finite; one pixel of an image of 8192 px has 6e-8."""

# Measured on markers of 18 to 40 px: 0.4 to 0.6 for anisotropies, 0.32 to 0.39 for sides.
HEADING_SHARE = 1 / 2
"""Variance of each number of a square (log side, two anisotropy components) over that of its heading.
Derived: for four corners with equal and independent errors."""

UNKNOWN_ERROR_PX = 0.1
"""Standard deviation of a corner along each axis, px, without a reported covariance. Chosen: an initial
guess; the noise is estimated from the residuals then."""


def relative_anisotropies(squares: SquareImages) -> ComplexArray:
    """Return relative anisotropies `ε = anisotropy / conj(similarity)` (N,), invariant to rotation.

    The image of a square under `q ↦ p(q) = similarity q + anisotropy q̄` has the aspect ratio (1 + |ε|) / (1
    - |ε|).
    """
    return np.asarray(
        squares.anisotropies * squares.similarities / np.maximum(np.abs(squares.similarities) ** 2, TINY)
    )


def log_sides(squares: SquareImages) -> Array:
    """Return natural logarithms (N,) of the sides of squares with the same areas as the images."""
    areas = np.abs(squares.similarities) ** 2 - np.abs(squares.anisotropies) ** 2
    return np.asarray(np.log(np.maximum(np.abs(areas), TINY)) / 2)


@dataclass(frozen=True)
class Squares:
    """Images of N markers, in the units of `skyherd.control.rectification.ground_map`.

    Attributes:
        ids: (N,) ids of the markers.
        points: (N,) their centres, complex, from the image centre, in halves of the shorter side.
        log_sides: (N,) natural logarithms of their sides.
        anisotropies: (N,) their relative anisotropies, complex.
        variances: (N,) variances of each log side and of each component of an anisotropy.
        reported: whether the variances come from covariances that the detector reports.
    """

    ids: IntArray
    points: ComplexArray
    log_sides: Array
    anisotropies: ComplexArray
    variances: Array
    reported: bool

    @classmethod
    def of(cls, seen: Detections) -> "Squares":
        """Return the shapes of detected markers, from their corners; any detector is sufficient."""
        images = fit_squares(to_complex(centred(seen.corners_px, seen.image_size_px)))
        variances = HEADING_SHARE * seen.covariances[:, 2, 2]
        reported = bool((variances > 0).all())
        if not reported:
            variances = (UNKNOWN_ERROR_PX / seen.sides_px) ** 2 / 2
        return cls(
            ids=seen.ids,
            points=to_complex(seen.centred),
            log_sides=log_sides(images),
            anisotropies=relative_anisotropies(images),
            variances=variances,
            reported=reported,
        )

    def __len__(self) -> int:
        return int(self.ids.size)

    def match(self, others: "Squares") -> tuple[IntArray, IntArray]:
        """Return rows (M,) of the common markers, in these squares and in `others`."""
        here, there = np.nonzero(self.ids[:, None] == others.ids)
        return here, there
