"""Whether a fit shows its marker: every bit read again, and nothing left but noise.

A cell of the wrong colour leaves, along each axis, `E(x) = Φ((x + 1/2) / σ) - Φ((x - 1/2) / σ)` of the
contrast, with x and the blur σ in cells: over the cell itself `(∫ E)²` on average, and over the image the
squares `(∫ E²)²` for each pixel of the cell. What a fit leaves is measured by that.
"""

import numpy as np
from scipy.special import ndtr

from skyherd.geometry import Array, BoolArray
from skyherd.vision.fit import Fits
from skyherd.vision.grey import Image

WRONG_CELL, WRONG_CELL_SIGMAS, WRONG_CELL_LIMIT = 0.2, 4.0, 0.4
"""A cell is wrong if it leaves more than the first share of what a wrong colour would leave and so many
deviations of what noise does, or the last share in any case."""

CONTRAST_LIMITS = 12.0, 280.0
"""Grey levels from black to white: least that is looked at, and most, a tenth more than there can be."""

MAX_CELL_NOISE = 0.12
"""Largest noise of a cell's mean, as a share of what a wrong colour would leave: an eighth."""

MAX_SQUEEZE = 0.2
"""Largest difference of a marker's image from a square: that of a tilt of 48 degrees."""

MAX_BLUR_CELLS = 0.75
"""Largest blur, in cells: beyond it other markers, and even texture, can pass for one."""

MIN_SEEN = 0.8
"""Least share of a marker's area that its pixels must cover: an image may cut off its border, not bits."""

NOISE_FACTOR, WRONG_BIT_SHARE, FIRST_SHARE = 1.25, 0.4, 0.75
"""A fit may leave this many times the camera's noise and, for what the model lacks, this share of the root
mean square that one wrong bit would leave; the last while only the image itself tells the noise."""

LARGEST_BLUR_STEP = 0.3
"""A marker's blur may differ from that of the others by this, in its logarithm. At 12 px and noise 10 it is
measured to 0.05; what passes for a marker between others mostly asks for half as much blur again."""

SATURATED, LEAST_TOLD = 5, 50
"""Pixels so near to black or white are clipped and tell no noise; so many others are needed to tell it."""

MOST_COVERED, MOST_LEFT = 8, 2.0
"""Of a marker that is being followed so many cells of the border may be covered, as by a neighbour's card,
while the bits within are all seen; it may then leave this many times what one wrong bit would."""

READINGS = 8
"""Points of a cell along each side in the integrals."""


def bits_are_right(fits: Fits) -> BoolArray:
    """Which fits (N,) show every cell of their marker, plainly enough."""
    mean, _ = _wrong_cell(fits)
    cell_noises = fits.noises / (mean * _cells_px(fits))
    worst = np.abs(fits.cell_means).max(axis=(1, 2)) / mean
    allowed = np.minimum(WRONG_CELL + WRONG_CELL_SIGMAS * cell_noises, WRONG_CELL_LIMIT)
    return np.asarray(_are_plain(fits, cell_noises) & (worst < allowed))


def border_is_covered(fits: Fits) -> BoolArray:
    """Which fits (N,) show all the bits of their marker, and enough of its border."""
    mean, wrong = _wrong_cell(fits)
    is_wrong = np.abs(fits.cell_means) > WRONG_CELL_LIMIT * mean[:, None, None]
    bits_wrong = is_wrong[:, 1:-1, 1:-1].sum(axis=(1, 2))
    few = (bits_wrong == 0) & (is_wrong.sum(axis=(1, 2)) <= MOST_COVERED)
    return np.asarray(few & _are_plain(fits, np.zeros(len(mean))) & (fits.noises <= MOST_LEFT * wrong))


def _are_plain(fits: Fits, cell_noises: Array) -> BoolArray:
    """Which fits (N,) have contrast, sharpness, pixels and a shape such as markers have."""
    least, most = CONTRAST_LIMITS
    plain = (fits.contrasts >= least) & (fits.contrasts <= most) & (fits.blurs_cells <= MAX_BLUR_CELLS)
    plain &= cell_noises <= MAX_CELL_NOISE
    plain &= fits.pixels >= MIN_SEEN * fits.shapes.sides_px() ** 2
    plain &= np.abs(fits.shapes.squeezes) <= MAX_SQUEEZE * np.abs(fits.shapes.arms)
    return np.asarray(plain)


def verified(fits: Fits, noise: float, share: float = WRONG_BIT_SHARE) -> BoolArray:
    """Which fits (N,) show their marker, as blurred as the others, and leave little more than the noise."""
    _, wrong = _wrong_cell(fits)
    right = bits_are_right(fits) & (fits.noises <= np.hypot(NOISE_FACTOR * noise, share * wrong))
    # The median over all pixels of markers that seem right: large ones tell the blur best.
    order = np.argsort(fits.log_blurs)
    told = np.cumsum((fits.pixels * right)[order])
    common = fits.log_blurs[order][np.searchsorted(told, told[-1] / 2)] if right.any() else 0.0
    return np.asarray(right & (np.abs(fits.log_blurs - common) <= LARGEST_BLUR_STEP))


def image_noise(image: Image) -> float:
    """Noise of an image in which no marker is known, grey levels; texture and edges being its lesser part.

    The median of `|I(u - 1) - 2 I(u) + I(u + 1)|` is `0.6745 √6` deviations of white noise. Every fourth line
    and column is read, and no saturated pixel; infinite if too few are left.
    """
    lines = image[::4].astype(np.int16)
    before, here, after = lines[:, :-2:4], lines[:, 1:-1:4], lines[:, 2::4]
    told = np.abs(before - 2 * here + after)[(here > SATURATED) & (here < 255 - SATURATED)]
    return float(np.median(told)) / (0.6745 * 6**0.5) if told.size >= LEAST_TOLD else np.inf


def _cells_px(fits: Fits) -> Array:
    return np.asarray(fits.shapes.sides_px() / fits.cell_means.shape[1])


def _wrong_cell(fits: Fits) -> tuple[Array, Array]:
    """What one cell of the wrong colour would leave (N,), in grey: mean over it, RMS over all pixels."""
    x = (np.arange(4 * READINGS) + 0.5) / READINGS - 2.0
    sigma = fits.blurs_cells[:, None]
    seen = ndtr((x + 0.5) / sigma) - ndtr((x - 0.5) / sigma)
    contrast = np.maximum(fits.contrasts, 1e-3)
    squares = ((seen**2).sum(axis=1) / READINGS) ** 2 * _cells_px(fits) ** 2
    mean = seen[:, np.abs(x) < 0.5].mean(axis=1) ** 2
    return contrast * mean, contrast * np.sqrt(squares / np.maximum(fits.pixels, 1.0))
