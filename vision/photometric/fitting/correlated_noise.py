"""How noise that is correlated from pixel to pixel changes the variances of poses.

Demosaicing, denoising, sharpening and compression make the noise of neighbouring pixels alike, or unlike. A
tone curve or motion blur that the model lacks leaves residuals that are larger along edges than elsewhere.
The covariance `σ_n² (JᵀJ)⁻¹` knows of neither. A pose's error is the sum over the pixels p

    e = Σ a(p) n(p),    a(p) = P C J(p),

of their noise n times their influence a, with J(p) a row of the design matrix, C the inverse normal matrix
and P the map from the unknowns to the pose. Its variance is estimated from the residuals r in place of the
noise: summed over boxes of b x b pixels, `s = Σ_box a r`, the squares s² count the covariances of pixels that
lie in one box. Those of pixels that are d apart are so counted by the share 1 - d / b. Twice the sum over
boxes of 2 b pixels less that over boxes of b counts all that are up to b apart in full. It counts none beyond
2 b, as the flat-top window does (Politis and Romano, Journal of Time Series Analysis 16, 1995).

One marker has too few boxes to tell its own variance. The ratio to the variance that independent noise would
give is therefore taken over all markers of an image, for positions and for headings.
"""

from dataclasses import dataclass, field

import numpy as np

from skyherd.geometry import Array

BOX_PX = 2
"""Side b of the smaller boxes, px; the larger have twice as much. Chosen: denoising and demosaicing reach
over one or two pixels, blocks of a codec further; larger boxes are fewer, and tell less precisely."""

MAX_MARKERS = 8
"""Residuals are summed for so many markers of an image at most. Chosen: the ratio of 8 markers of 30 px is
known to a tenth; all markers of a crowd would take as long as a step of their fit."""

KEPT_SHARE = 0.88
"""Share of the ratio that a fit leaves, since residuals are smaller than the noise by what the fit took off.
Measured by `python benchmarks/correlated_noise.py`: 0.65 at 12 px, 0.77 to 0.94 at 16 to 60 px."""

RATIO_ERROR = 3.5
"""Standard deviation of one marker's ratio, times the square root of its number of large boxes. Measured
likewise: 2.4 to 4.6."""

SIGNIFICANT_SIGMAS = 3.0
"""A ratio that differs from 1 by fewer of its standard deviations is taken for 1. Chosen: of raw images,
whose noise is white, one in 400 differs by more."""

FORGOTTEN = 0.2
"""Share of what is known of a unit's ratios that each image takes the place of. Chosen: as for its blur."""

MIN_RATIO, MAX_RATIO = 0.1, 100.0
"""Limits of the ratios. Chosen: beyond them the model is wrong rather than the noise correlated."""


@dataclass(frozen=True)
class PooledRatios:
    """Ratios of variances, taken over the markers of an image and of those before it.

    Attributes:
        sums: (2,) of positions and of headings, each weighted by its number of boxes.
        boxes: number of boxes that they are of.
    """

    sums: Array = field(default_factory=lambda: np.zeros(2))
    boxes: float = 0.0

    def updated(self, ratios: Array, boxes: Array) -> "PooledRatios":
        """Return the pooled ratios with those of one more image.

        Args:
            ratios: (N, 2) of each marker, to the variances that independent noise would give.
            boxes: (N,) number of large boxes; 0 for a marker whose residuals were not summed.
        """
        kept = 1 - FORGOTTEN
        return PooledRatios(kept * self.sums + boxes @ ratios, kept * self.boxes + float(boxes.sum()))

    def factors(self) -> Array:
        """Return the factors (2,) by which variances of positions and of headings are multiplied."""
        if not self.boxes:
            return np.ones(2)
        pooled = np.clip(self.sums / self.boxes, MIN_RATIO, MAX_RATIO)
        significant = np.abs(pooled - 1) > SIGNIFICANT_SIGMAS * RATIO_ERROR / np.sqrt(self.boxes)
        return np.where(significant, pooled, 1.0)
