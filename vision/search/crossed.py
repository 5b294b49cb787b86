"""Dark squares whose outline a line crosses: a pen stroke, a cable, a crack.

The line joins the square with what is dark around it, so that the outline of the region is no square's.
Here large dark regions are filled, which makes markers solid, and opened: a line is narrower than a box, and
vanishes. The image is searched at half the size, since the fit finds the place again.
"""

import cv2
import numpy as np

from skyherd.geometry import Array
from skyherd.vision.grey import Image, block_means
from skyherd.vision.native.library import library
from skyherd.vision.search.quads import quads_of_places
from skyherd.vision.search.regions import crowded_places

SHRINK = 2
"""Downsampling factor of the image that is searched. Chosen: at full size the search takes four times as
long, a seventh of the detector's time on photographs."""

DARKER = 8
"""By how much dark pixels are below the mean of a window of 21 px, grey levels. Chosen: less
than in the search of squares, since the opening has taken the extremes."""

MIN_SIDE_PX = 10
"""Smallest width and height of a region, px of the small image. Chosen: a line as wide as the opening crosses
a quarter of such a square, and smaller ones cannot be read under it."""

OPENING_PX = 3
"""Width of the box of the opening, px of the small image. Measured on 192 markers of 48 px under a line of 2
to 5 px, tuning seeds of `benchmarks/odd_conditions.py`: 89 of 36h11 and 45 of 4X4_50 are found, with 5
instead 96 and 42. Chosen: the smaller one leaves more of a small square."""


def find_crossed_quads(image: Image, known_px: Array) -> Array:
    """Return the corners (N, 4, 2), px, of dark quadrilaterals that are left of regions without their lines.

    Args:
        image: grey, (height, width).
        known_px: (K, 4, 2) corners of squares, px, that need not be found again.
    """
    small = block_means(image, SHRINK)
    small = np.ascontiguousarray(small[: small.shape[0] // 2 * 2, : small.shape[1] // 2 * 2])
    if min(small.shape) < MIN_SIDE_PX:
        return np.zeros((0, 4, 2))
    box = np.ones((OPENING_PX, OPENING_PX), dtype=np.uint8)
    opened = cv2.morphologyEx(large_regions(small), cv2.MORPH_OPEN, box)
    middle = (SHRINK - 1) / 2
    places = crowded_places(np.asarray(255 - opened, dtype=np.uint8), (known_px - middle) / SHRINK)
    return np.zeros((0, 4, 2)) if places is None else SHRINK * quads_of_places(places, range(1)) + middle


def large_regions(image: Image) -> Image:
    """Return the dark regions of at least `MIN_SIDE_PX` without their holes, as 255; sides are even."""
    filled = np.zeros_like(image)
    for outline in library().large_boundaries(image, DARKER, MIN_SIDE_PX):
        cv2.fillPoly(filled, [outline], 255)
    return filled
