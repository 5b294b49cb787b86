"""The noise of a photograph, from the photograph alone.

It enters the floor of accuracy that detectors are compared with, and so is not taken from any of them:
skyherd's own detector has an estimate for its thresholds, faster and without saturated pixels, and a mistake
of that one would then hide what it does to the results.
"""

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import MEDIAN_PER_SIGMA

NOISE_FILTER = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=float) / 6
"""Filter that removes even shades and straight edges and leaves the variance of white noise as it is
(Immerkær 1996). Derived: the squares of its numbers sum to 1."""


def immerkaer_noise(image: npt.NDArray[np.uint8]) -> float:
    """Standard deviation, grey levels, of what changes from pixel to pixel in a grey image (height, width).

    It is that of white noise if the picture itself is even or straight-edged in most places: a median is
    taken of what the filter leaves.
    """
    filtered = cv2.filter2D(image.astype(np.float64), -1, NOISE_FILTER)
    return float(np.median(np.abs(filtered)) / MEDIAN_PER_SIGMA)
