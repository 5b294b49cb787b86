"""Noise of a photograph, estimated from the photograph alone.

It enters the error floor of the detectors, and is therefore independent of all of them. Skyherd's own
detector has a faster estimate for its thresholds, without saturated pixels. An error of that estimate would
hide its effect on the results.
"""

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import MEDIAN_PER_SIGMA

NOISE_FILTER = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=float) / 6
"""Filter that removes uniform gradients and straight edges and preserves the variance of white noise
(Immerkær 1996). Derived: the squares of its coefficients sum to 1."""


def immerkaer_noise(image: npt.NDArray[np.uint8]) -> float:
    """Return the standard deviation, grey levels, of pixel noise in a grey image (height, width).

    It is that of white noise if most of the picture is smooth or has straight edges: the median of the
    filter's output is used.
    """
    filtered = cv2.filter2D(image.astype(np.float64), -1, NOISE_FILTER)
    return float(np.median(np.abs(filtered)) / MEDIAN_PER_SIGMA)
