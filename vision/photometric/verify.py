"""Whether a fit shows its marker: every bit read again, and nothing left but noise.

A cell of the wrong colour leaves, along each axis, `E(x) = Φ((x + 1/2) / σ) - Φ((x - 1/2) / σ)` of the
contrast, with x and the blur σ in cells: over the cell k cells further on `e_k = ∫ E` on average, and over
the image the squares `(∫ E²)²` for each pixel of the cell. What a fit leaves is measured by that.

Light falls on black and white alike, so that `(white - black) / white`, the print contrast, is the same in
sun and shade: what has less of it than the camera's markers is no print of them, but ground between cards.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from skyherd.geometry import Array, BoolArray
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fit import jut
from skyherd.vision.photometric.fit_result import Fits, weighted_median

WRONG_CELL, WRONG_CELL_SIGMAS, WRONG_CELL_LIMIT = 0.2, 4.0, 0.4
"""A cell is wrong if it leaves more than the first share of what a wrong colour would leave and so many
deviations of what noise does, or the last share in any case."""

LEAST_CONTRAST, LARGEST_WHITE = 12.0, 280.0
"""Grey levels: least from black to white that is looked at, and a white a tenth above all that there are."""

MAX_CELL_NOISE = 0.12
"""Largest noise of a cell's mean, as a share of what a wrong colour would leave: an eighth."""

MAX_SQUEEZE = 0.2
"""Largest difference of a marker's image from a square: that of a tilt of 48 degrees."""

MAX_BLUR_CELLS = 0.75
"""Largest blur, in cells: beyond it other markers, and even texture, can pass for one."""

MAX_LAST_STEP_PX = 0.3
"""A fit whose last step moved the marker's sides by more has found nothing, or not yet. Drawings without
any blur, which no pattern has, settle slowly: their last steps are of 0.2 px."""

MIN_SEEN = 0.8
"""Least share of a marker's area that its pixels must cover: an image may cut off its border, not bits."""

NOISE_FACTOR, WRONG_BIT_SHARE, FIRST_SHARE = 1.25, 0.5, 0.75
"""A fit may leave this many times the camera's noise and, for what the model lacks, this share of the root
mean square that one wrong bit would leave, over the pixels and over the cells' means; the last in a first
look, while blur and noise are not known yet."""

LEAST_PRINT_CONTRAST = 0.75
"""Least share of the other markers' print contrast. Theirs differ by a tenth at 12 px and noise 10; stray
light of a twentieth of white takes as much as this leaves in a shade five times darker."""

LARGEST_BLUR_STEP = 0.3
"""A marker's blur may differ from that of the others by this, in its logarithm. At 12 px and noise 10 it is
measured to 0.05; what passes for a marker between others mostly asks for half as much blur again."""

SATURATED, LEAST_TOLD = 5, 50
"""Pixels so near to black or white are clipped and tell no noise; so many others are needed to tell it."""

VISIBLE_NOISE, VISIBLE_STEP_PX = 1.15, 0.1
"""What a fit to chosen pixels may leave, as a multiple of the noise, and its last step at most."""

MOST_COVERED = 0.25
"""Share of a marker's cells that may look wrong if it is worth another look without what covers it."""

READINGS, SPAN = 8, 5
"""Points of a cell along each side in the integrals, and cells that they go over."""


def bits_are_right(fits: Fits) -> BoolArray:
    """Which fits (N,) show every cell of their marker, plainly enough."""
    return _bits_are_right(fits, WrongCells.of(fits))


def _bits_are_right(fits: Fits, wrong: "WrongCells") -> BoolArray:
    cell_noises = fits.noises / (wrong.means * wrong.cells_px)
    worst = np.abs(fits.cell_means).max(axis=(1, 2)) / wrong.means
    allowed = np.minimum(WRONG_CELL + WRONG_CELL_SIGMAS * cell_noises, WRONG_CELL_LIMIT)
    return np.asarray(_are_plain(fits, cell_noises) & (worst < allowed))


def may_be_covered(fits: Fits, noise: float) -> BoolArray:
    """Which fits (N,) leave much more of some pixel than noise does, and yet show most of their marker."""
    wrong = WrongCells.of(fits)
    is_wrong = np.abs(fits.cell_means) > WRONG_CELL_LIMIT * wrong.means[:, None, None]
    most = is_wrong.sum(axis=(1, 2)) <= MOST_COVERED * fits.cell_means.shape[1] ** 2
    plain = fits.contrasts >= LEAST_CONTRAST
    return np.asarray(most & plain & jut(fits.peaks, fits.contrasts, np.full(fits.ids.size, noise)))


def _are_plain(fits: Fits, cell_noises: Array) -> BoolArray:
    """Which fits (N,) have settled, with contrast, sharpness, pixels and a shape such as markers have."""
    plain = (fits.contrasts >= LEAST_CONTRAST) & (fits.blacks + fits.contrasts <= LARGEST_WHITE)
    plain &= (fits.blurs_cells <= MAX_BLUR_CELLS) & (cell_noises <= MAX_CELL_NOISE)
    plain &= fits.moved_px <= MAX_LAST_STEP_PX
    plain &= fits.pixels >= MIN_SEEN * fits.shapes.sides_px() ** 2
    plain &= np.abs(fits.shapes.squeezes) <= MAX_SQUEEZE * np.abs(fits.shapes.arms)
    return np.asarray(plain)


def verified(fits: Fits, noise: float, share: float = WRONG_BIT_SHARE) -> BoolArray:
    """Which fits (N,) show their marker, blurred and printed as the others, and leave little but noise."""
    wrong = WrongCells.of(fits)
    right = _bits_are_right(fits, wrong) & _leave_noise(fits, wrong, noise, share)
    if not right.any():
        return right
    blur, contrast = (
        weighted_median(values, fits.pixels * right) for values in (fits.log_blurs, fits.print_contrasts())
    )
    return right & are_alike(fits, blur, contrast)


def leave_noise_only(fits: Fits, noise: float) -> BoolArray:
    """Which fits (N,) by what is seen of their markers have settled and leave no more than the noise.

    They may choose their pixels, so that nothing is excused by what the model lacks.
    """
    return np.asarray((fits.noises <= VISIBLE_NOISE * noise) & (fits.moved_px <= VISIBLE_STEP_PX))


def are_alike(fits: Fits, log_blur: float, print_contrast: float) -> BoolArray:
    """Which fits (N,) are blurred and printed as markers of a camera are."""
    blurred = np.abs(fits.log_blurs - log_blur) <= LARGEST_BLUR_STEP
    return np.asarray(blurred & (fits.print_contrasts() >= LEAST_PRINT_CONTRAST * print_contrast))


def _leave_noise(fits: Fits, wrong: "WrongCells", noise: float, share: float) -> BoolArray:
    """Which fits (N,) leave little more than the noise, pixel by pixel and cell by cell.

    The noise is one that others tell: what a fit itself leaves would excuse it.
    """
    over_cells = np.sqrt(np.square(fits.cell_means).mean(axis=(1, 2)))
    quiet = fits.noises <= np.hypot(NOISE_FACTOR * noise, share * wrong.pixels)
    quiet &= over_cells <= np.hypot(NOISE_FACTOR * noise / wrong.cells_px, share * wrong.cells)
    return np.asarray(quiet)


def image_noise(image: Image) -> float:
    """Noise of an image in which no marker is known, grey levels; texture and edges being its lesser part.

    The median of `|I(u - 1) - 2 I(u) + I(u + 1)|` is `0.6745 √6` deviations of white noise. Every fourth line
    and column is read, and no saturated pixel; infinite if too few are left.
    """
    lines = image[::4].astype(np.int16)
    before, here, after = lines[:, :-2:4], lines[:, 1:-1:4], lines[:, 2::4]
    told = np.abs(before - 2 * here + after)[(here > SATURATED) & (here < 255 - SATURATED)]
    return float(np.median(told)) / (0.6745 * 6**0.5) if told.size >= LEAST_TOLD else np.inf


@dataclass(frozen=True)
class WrongCells:
    """What one cell of the wrong colour would leave of N fits, in grey.

    Attributes:
        means: (N,) mean over that cell.
        pixels: (N,) root mean square over all pixels.
        cells: (N,) root mean square over all cells' means.
        cells_px: (N,) side of a cell.
    """

    means: Array
    pixels: Array
    cells: Array
    cells_px: Array

    @classmethod
    def of(cls, fits: Fits) -> "WrongCells":
        """By the blur that the fits found."""
        cells_px = fits.shapes.sides_px() / fits.cell_means.shape[1]
        log_sigmas = np.log(fits.blurs_cells) + np.minimum(np.maximum(fits.log_blurs, -1.0), 1.0)
        own, along, square = (np.interp(log_sigmas, _LOG_SIGMAS, leaves) for leaves in _leavings())
        contrast = np.maximum(fits.contrasts, 1e-3)
        return cls(
            means=contrast * own**2,
            pixels=contrast * square * cells_px / np.sqrt(np.maximum(fits.pixels, 1.0)),
            cells=contrast * along / fits.cell_means.shape[1],
            cells_px=cells_px,
        )


_LOG_SIGMAS: Array = np.linspace(np.log(0.01), np.log(10.0), 400)
"""Logarithms of the blurs, in cells, that are tabulated: linear between them to 1e-4."""


@lru_cache(maxsize=1)
def _leavings() -> tuple[Array, Array, Array]:
    """At the tabulated blurs `e_0`, `Σ e_k²` and `∫ E²`."""
    x = (np.arange(SPAN * READINGS) + 0.5) / READINGS - SPAN / 2
    sigma = np.exp(_LOG_SIGMAS)[:, None]
    seen = ndtr((x + 0.5) / sigma) - ndtr((x - 0.5) / sigma)
    means = seen.reshape(-1, SPAN, READINGS).mean(axis=2)
    return means[:, SPAN // 2], (means**2).sum(axis=1), (seen**2).sum(axis=1) / READINGS
