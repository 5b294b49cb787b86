"""Faint quadrilaterals: markers in fog, haze or deep shade, whose contrast is a few times the noise.

The search takes as dark what is darker than its surroundings by `DARKER`, 10 grey levels. Of full contrast
that is a small share, and noise and texture demand it; of a faint marker it may be all. Here the image's
differences from the mean of their surroundings are multiplied by a gain, so that all faint surroundings have
one contrast. Where noise would become too large, the image is smoothed before. Then it is searched likewise.

The share of the contrast that `DARKER` is decides what is found. At a third, squares that touch at their
corners stay apart; at a sixth, wide black borders are dark all over. So the image is searched under either.
"""

import cv2
import numpy as np

from skyherd.geometry import Array
from skyherd.vision.grey import Image, block_means
from skyherd.vision.native.library import library
from skyherd.vision.native.records import Floats
from skyherd.vision.search.quads import find_quads

FINE_SPREAD, COARSE_SPREAD = 12.0, 25.0
"""Standard deviations that surroundings are stretched to, grey levels. Measured on boards of
`benchmarks/touching.py` with other seeds, contrasts of 5 to 34 grey levels and noise of 0.7 to 3. Of 6,480
markers of 14 to 40 px 4,747 are found, and 1,594 of 1,728 of 70 and 130 px. A gain of 5 everywhere finds
4,033 and 1,150. The first alone finds a quarter of the large ones. With 10 or 15 for it, 170 and 80 fewer of
the others are found."""

MIN_FINE_GAIN, MIN_COARSE_GAIN = 1.5, 5.0
"""Limits of the gains. Surroundings that have a smaller fine one are left flat, and have at least the coarse
one, under which whatever is smoothed becomes black or white. Chosen: flat are those whose squares the search
itself finds. Measured on 48 markers with dead columns: without the coarse limit a third is lost."""

MAX_GAIN, MAX_NOISE = 12.0, 6.0
"""Largest gain, and largest standard deviation of noise after it, grey levels. Chosen: a contrast of 5 grey
levels, below which few markers can be read, then has what the search finds, and noise is below `DARKER`.
Where the fine gain keeps noise within it, the image is not smoothed. Measured with 9 instead, on the boards
above: more markers are found at a tilt of 65 degrees, and as many fewer of 14 px at the lowest contrast."""

SMOOTHED_NOISE = 6 / 16
"""Share of the noise's standard deviation that smoothing leaves. Chosen: the smallest binomial filter, of
3 px. A box of 3 px removes more noise, and cells of 1.6 px with it. Derived: the weights (1, 2, 1) / 4 along
either axis."""

BLOCK_PX, SURROUNDINGS = 4, 15
"""Side of the blocks that have a gain each, px, as in `vision/native/stretch.c`, and of the surroundings that
determine it, in blocks. Chosen: surroundings are larger than the markers that are faint and yet small enough
to be missed otherwise."""

MIDDLE = 128.0
"""Grey level of no difference."""

MIN_VARIANCE = 0.01
"""Smallest variance that is divided by, grey levels squared. Chosen far below that of rounding."""


def find_faint_quads(image: Image, known_px: Array, noise: float) -> Array:
    """Return the corners (N, 4, 2), px, of dark quadrilaterals of little contrast.

    Args:
        image: grey, (height, width).
        known_px: (K, 4, 2) corners of squares, px, that need not be found again.
        noise: standard deviation of a pixel, grey levels, above 0.
    """
    if min(image.shape) < BLOCK_PX:
        return np.zeros((0, 4, 2))
    fine, coarse = stretched_contrasts(image, noise)
    small = find_quads(fine, known_px, shrinks=(1,))
    return np.concatenate([small, find_quads(coarse, known_px)])


def stretched_contrasts(image: Image, noise: float) -> tuple[Image, Image]:
    """Return the image stretched about `MIDDLE` to the fine and to the coarse spread, smoothed against noise.

    Args:
        image: grey, (height, width), at least one block high and wide.
        noise: standard deviation of a pixel, grey levels, above 0.
    """
    blocks, box = block_means(image, BLOCK_PX).astype(np.float32), (SURROUNDINGS, SURROUNDINGS)
    means: Floats = np.asarray(cv2.blur(blocks, box))
    variances = cv2.sqrBoxFilter(blocks, -1, box) - means.astype(float) ** 2 - (noise / BLOCK_PX) ** 2
    per_level = (1 / np.sqrt(np.maximum(variances, MIN_VARIANCE))).astype(np.float32)
    most = float(min(MAX_GAIN, MAX_NOISE / (SMOOTHED_NOISE * noise)))
    fine = np.minimum(FINE_SPREAD * per_level, most)
    fine[fine < MIN_FINE_GAIN] = 0.0
    coarse = np.clip(COARSE_SPREAD * per_level, min(MIN_COARSE_GAIN, most), most)
    gains = np.stack([fine, coarse])
    return library().stretched(image, gains, MIDDLE - gains * means, may_stay_sharp(fine, noise))


def may_stay_sharp(gains: Floats, noise: float) -> Image:
    """Return as 255 the blocks whose noise, grey levels, is within its limit after their gains, else 0."""
    return np.where(gains * noise <= MAX_NOISE, 255, 0).astype(np.uint8)
