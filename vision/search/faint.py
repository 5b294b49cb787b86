"""Faint quadrilaterals: markers in fog, haze or deep shade, whose contrast is a few times the noise.

The search takes as dark what is darker than its surroundings by a constant, which noise and texture demand.
Here the image is smoothed, and its differences from the mean of its surroundings are multiplied, before it is
searched in the same way.
"""

import cv2
import numpy as np

from skyherd.geometry import Array
from skyherd.vision.grey import Image
from skyherd.vision.search.quads import find_quads

GAIN = 5
"""Factor by which differences are multiplied. Chosen: a contrast of 9 grey levels then has what the search
finds, and noise of 2, which the smoothing takes to a third, is below its threshold."""

SMOOTHING_PX, SURROUNDINGS_PX = 3, 61
"""Widths of the box filters that smooth the image and give the mean of its surroundings, px. Chosen: the
smallest, and larger than the markers that are faint and yet small enough to be missed otherwise."""

MIDDLE = 128
"""Grey level of no difference."""


def find_faint_quads(image: Image, known_px: Array) -> Array:
    """Return the corners (N, 4, 2), px, of dark quadrilaterals of little contrast.

    Args:
        image: grey, (height, width).
        known_px: (K, 4, 2) corners of squares, px, that need not be found again.
    """
    return find_quads(stretched_contrast(image), known_px)


def stretched_contrast(image: Image) -> Image:
    """Return the smoothed image's differences from the mean of its surroundings, times `GAIN`."""
    smooth = cv2.blur(image, (SMOOTHING_PX, SMOOTHING_PX))
    mean = cv2.blur(image, (SURROUNDINGS_PX, SURROUNDINGS_PX))
    return np.asarray(cv2.addWeighted(smooth, GAIN, mean, -GAIN, MIDDLE), dtype=np.uint8)
