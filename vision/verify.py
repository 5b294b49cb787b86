"""Whether a fit shows its marker: every bit read again, and nothing left but noise.

A cell of the wrong colour leaves, along each axis, `E(x) = Φ((x + 1/2) / σ) - Φ((x - 1/2) / σ)` of the
contrast, with x and the blur σ in cells: over the cell itself `(∫ E)²` on average, and over the image the
squares `(∫ E²)²` for each pixel of the cell. What a fit leaves is measured by that.
"""

import numpy as np
from scipy.special import ndtr

from skyherd.geometry import Array, BoolArray
from skyherd.vision.fit import Fits

WRONG_CELL, WRONG_CELL_SIGMAS, WRONG_CELL_LIMIT = 0.2, 4.0, 0.4
"""A cell is wrong if it leaves more than the first share of what a wrong colour would leave and so many
deviations of what noise does, or the last share in any case."""

MIN_CONTRAST = 12.0
"""Least grey levels from black to white."""

MAX_SQUEEZE = 0.2
"""Largest difference of a marker's image from a square: that of a tilt of 48 degrees."""

MAX_BLUR_CELLS = 0.75
"""Largest blur, in cells: beyond it other markers, and even texture, can pass for one."""

NOISE_FACTOR, WRONG_BIT_SHARE = 1.25, 0.4
"""A fit may leave this many times the camera's noise and, for what the model lacks, this share of the root
mean square that one wrong bit would leave."""

READINGS = 8
"""Points of a cell along each side in the integrals."""


def bits_are_right(fits: Fits) -> BoolArray:
    """Which fits (N,) show every cell of their marker, plainly enough."""
    mean, _ = _wrong_cell(fits)
    cells_px = _cells_px(fits)
    worst = np.abs(fits.cell_means).max(axis=(1, 2)) / mean
    allowed = np.minimum(WRONG_CELL + WRONG_CELL_SIGMAS * fits.noises / (mean * cells_px), WRONG_CELL_LIMIT)
    plain = (fits.contrasts >= MIN_CONTRAST) & (fits.blurs_cells <= MAX_BLUR_CELLS)
    plain &= np.abs(fits.shapes.squeezes) <= MAX_SQUEEZE * np.abs(fits.shapes.arms)
    return np.asarray(plain & (worst < allowed))


def verified(fits: Fits, noise: float | None) -> BoolArray:
    """Which fits (N,) show their marker and leave little more than the camera's noise, if it is known."""
    right = bits_are_right(fits)
    if not right.any():
        return right
    usual = float(np.median(fits.noises[right])) if noise is None else noise
    _, wrong = _wrong_cell(fits)
    return right & (fits.noises <= np.hypot(NOISE_FACTOR * usual, WRONG_BIT_SHARE * wrong))


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
