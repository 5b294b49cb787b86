"""The noise of an image, from the image alone."""

import math
from dataclasses import dataclass

import numpy as np

from skyherd.geometry import MEDIAN_PER_SIGMA, UNIFORM_VARIANCE
from skyherd.vision.grey import Image
from skyherd.vision.native.library import library

SATURATION_MARGIN, MIN_UNSATURATED_PIXELS = 5, 50
"""Pixels so near to black or white, grey levels, are clipped and say nothing about the noise; so many others
are needed to estimate it. Chosen: 5 is more than the usual noise; a median of 50 values is good to a
sixth."""

ROUNDING_NOISE = math.sqrt(UNIFORM_VARIANCE)
"""Least noise of an image, grey levels. Derived: rounding to whole grey levels has `sqrt(1 / 12)` = 0.29."""


def image_noise(image: Image) -> float:
    """Return the noise of an image, standard deviation in grey levels, from the image alone.

    The median of `|I(u - 1) - 2 I(u) + I(u + 1)|` is `0.6745 √6` standard deviations of white noise, if
    texture and edges take up less than half of the image. Every fourth column is read of every fourth line,
    of a large image of fewer lines, and no saturated pixel; the result is that of rounding, `sqrt(1 / 12)`,
    if too few are left.
    """
    limits = SATURATION_MARGIN, 255 - SATURATION_MARGIN
    ends = library().second_differences(np.ascontiguousarray(image), *limits).cumsum()
    count = int(ends[-1])
    if count < MIN_UNSATURATED_PIXELS:
        return ROUNDING_NOISE
    median = float(np.searchsorted(ends, [(count - 1) // 2, count // 2], side="right").mean())
    return max(median / (MEDIAN_PER_SIGMA * 6**0.5), ROUNDING_NOISE)


@dataclass(frozen=True)
class Noises:
    """Standard deviations of a pixel, grey levels.

    Attributes:
        image: of the image, from its pixels' differences.
        verified: left by verified fits in the median, at least that of the image.
        clear: the same of verified fits without outliers.
    """

    image: float
    verified: float
    clear: float
