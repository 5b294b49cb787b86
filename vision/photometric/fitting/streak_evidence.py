"""What the pixels of fitted markers tell of a blur that differs along the image's directions, as streaks do.

A streak Q (`design_matrix`) changes a marker's pixels by `X δQ`, where X are two combinations of its second
derivatives. Of what a fit leaves, r, and of X only that counts which the fit's own unknowns cannot explain:
with J their columns and `C = (JᵀJ)⁻¹`,

    M = Xᵀ X - Xᵀ J C Jᵀ X,   b = Xᵀ r,

each over the variance of the noise. Added up over markers, `δQ = (Σ M)⁻¹ Σ b` with covariance `(Σ M)⁻¹`, and
`bᵀ M⁻¹ b` of the sums is the fall of the chi-squared.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import Array
from skyherd.vision.grey import Image
from skyherd.vision.native.library import library
from skyherd.vision.photometric.fitting.appearance import appearances_of
from skyherd.vision.photometric.fitting.fit import fit_request
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.plane import Plane

RIDGE = 1e-6
"""Added to the diagonal of the information on a streak, 1/px⁴, so that markers without any contrast make no
singular matrix. Chosen far below that of a marker of 8 px at noise 10."""


@dataclass(frozen=True)
class StreakEvidence:
    """Evidence of N markers for a change of the streak, whose components are its real and imaginary parts.

    Attributes:
        informations: (N, 2, 2) the M of each marker, 1/px⁴.
        scores: (N, 2) the b of each marker, 1/px².
    """

    informations: Array
    scores: Array

    def covariance(self) -> Array:
        """Return the covariance (2, 2) of the streak, px⁴, if the markers leave nothing but noise."""
        return np.asarray(np.linalg.inv(self.informations.sum(axis=0) + RIDGE * np.eye(2)))

    def change_px2(self) -> complex:
        """Return by how much the streak Q of all markers together differs from what they were fitted with."""
        change = self.covariance() @ self.scores.sum(axis=0)
        return complex(change[0], change[1])

    def significance(self) -> float:
        """Return the fall of the chi-squared with the change, over what the markers then leave of theirs.

        That is a degree of freedom, 1 at least; more where markers tell different streaks.
        """
        total = self.scores.sum(axis=0)
        change = self.covariance() @ total
        left = self.scores - self.informations @ change
        ridged = self.informations + RIDGE * np.eye(2)
        squares = float((left * np.linalg.solve(ridged, left[..., None])[..., 0]).sum())
        freedom = 2 * (len(self.scores) - 1)
        return float(total @ change / max(1.0, squares / freedom if freedom else 0.0))


def streak_evidence(
    image: Image, dictionary: str, fits: FitResults, plane: Plane, noise: float, streak_px2: complex
) -> StreakEvidence:
    """Return what the pixels of N markers, at least one, tell of a streak beyond that of their fits.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        fits: of the markers, settled.
        plane: that they were fitted on.
        noise: standard deviation of a pixel, grey levels.
        streak_px2: Q that they were fitted under, px².
    """
    shapes = fits.homographies
    blurs = shapes.blurs(fits.sigmas_px)
    appearances = appearances_of(
        dictionary, fits.ids, blurs, plane, noise, streak_px2, surroundings=fits.surroundings
    )
    appearances = replace(appearances, black_ratios=fits.blacks / np.maximum(fits.contrasts, 1.0))
    return StreakEvidence(*library().streak_evidence(fit_request(image, shapes, appearances, noise)))
