"""Whether a fit shows its marker: every bit is read again, and nothing but noise may be left.

A fit counts if every cell has the right colour by what the fit leaves of it, if it leaves no more than noise
that *other* markers (or the image) determine, and if its print is that of the camera's markers.

A cell of the wrong colour leaves, along each axis, `E(x) = Φ((x + 1/2) / σ) - Φ((x - 1/2) / σ)` of the
contrast, with x and the blur σ in cells: over the cell k cells further on `e_k = ∫ E` on average, and over
the image the squares `(∫ E²)²` for each pixel of the cell. What a fit leaves is measured in these units.

Light falls on black and white alike, so that `(white - black) / white`, the print contrast, is the same in
sun and shade. What has less of it than the camera's markers is no print, but ground between cards.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from skyherd.geometry import Array, BoolArray
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fit import has_outlier_pixels
from skyherd.vision.photometric.fit_result import FitResults, weighted_median

WRONG_CELL_SHARE, WRONG_CELL_SIGMAS, WRONG_CELL_LIMIT = 0.2, 4.0, 0.4
"""A cell is wrong if its mean residual exceeds the first share of what a wrong colour would leave plus so
many standard deviations of noise, or the last share in any case. Chosen: a right cell leaves 0, a wrong one
1, and the limit stays below the middle between them."""

MIN_MARKER_CONTRAST = 12.0
"""Smallest contrast of a marker, grey levels. Chosen: four times the usual noise."""

MAX_WHITE = 280.0
"""Upper limit of a plausible white level, grey levels. Derived: 10 % above the 8-bit maximum of 255, since
blur and noise let a fit find more than there is."""

MAX_CELL_NOISE = 0.12
"""Largest noise of a cell's mean, as a share of what a wrong colour would leave. Chosen: an eighth; the limit
of 0.4 above is then 3.3 standard deviations of the noise."""

MAX_SQUEEZE = 0.2
"""Largest squeeze of a marker's image, as a share of its arm. Derived: that of a tilt of 48 degrees, where
`(1 - cos 48°) / (1 + cos 48°) = 0.2`."""

MAX_BLUR_CELLS = 0.75
"""Largest blur, standard deviation in cells. Chosen: beyond it other markers, and even texture, can pass for
a marker."""

MAX_LAST_STEP_PX = 0.3
"""A fit whose last step moved the marker's sides by more has found nothing, or not yet. Chosen: drawings
without any blur, which no pattern has, settle slowly; their last steps are of 0.2 px."""

MIN_AREA_SHARE = 0.8
"""Smallest share of a marker's area that its pixels must cover. Chosen: the image may cut off part of the
black border, but no bits."""

NOISE_FACTOR = 1.25
"""A fit may leave this many times the camera's noise. Chosen: noise is estimated from few markers at first,
and changes from one frame to the next."""

WRONG_BIT_SHARE, FIRST_WRONG_BIT_SHARE = 0.5, 0.75
"""For what the model lacks (such as motion blur), a fit may leave in addition this share of the root mean
square that one wrong bit would leave, over the pixels and over the cells' means. The second value holds in a
first look, while blur and noise are not known yet. Chosen below 1, where a wrong bit would pass."""

MIN_PRINT_SHARE = 0.75
"""Smallest share of the other markers' print contrast. Chosen: print contrasts of markers differ by a tenth
at 12 px and noise 10; stray light of a twentieth of white takes this much in a shade five times darker."""

MAX_LOG_BLUR_DIFFERENCE = 0.3
"""A marker's blur may differ from that of the others by this, in its logarithm. Chosen: at 12 px and noise 10
it is measured to 0.05; most of what passes for a marker between others needs half as much blur again, 0.4."""

SATURATION_MARGIN, MIN_UNSATURATED_PIXELS = 5, 50
"""Pixels so near to black or white, grey levels, are clipped and say nothing about the noise; so many others
are needed to estimate it. Chosen: 5 is more than the usual noise; a median of 50 values is good to a
sixth."""

OCCLUSION_NOISE_FACTOR, OCCLUSION_LAST_STEP_PX = 1.15, 0.1
"""What a fit to chosen pixels may leave, as a multiple of the noise, and how far its last step may move the
sides, px. Chosen stricter than for all pixels, since these were chosen for agreeing."""

MAX_COVERED_SHARE = 0.25
"""Share of a marker's cells that may look wrong if it is still worth a fit without what covers it. Chosen: a
larger share costs time for fits that are mostly refused, since hidden bits count as wrong."""

SAMPLES_PER_CELL, SPAN_CELLS = 8, 5
"""Sample points of a cell in the integrals of E, and number of cells that they cover: two cells on either
side, which is enough up to a blur of `MAX_BLUR_CELLS`."""

MIN_DIVISOR_CONTRAST = 1e-3
"""Smallest contrast, grey levels, that residuals are compared with; a fit with less is refused anyway."""

MEDIAN_PER_SIGMA = 0.6745
"""Median of the absolute value of a normal variable of unit variance. Derived: Φ(0.6745) = 3/4."""


def bits_are_right(fits: FitResults) -> BoolArray:
    """Return which fits (N,) are plausible markers and leave every cell the colour it should have."""
    return _bits_are_right(fits, WrongCellResiduals.of(fits))


def _bits_are_right(fits: FitResults, wrong: "WrongCellResiduals") -> BoolArray:
    cell_noises = fits.noise_stds / (wrong.means * wrong.cells_px)
    worst = np.abs(fits.cell_means).max(axis=(1, 2)) / wrong.means
    allowed = np.minimum(WRONG_CELL_SHARE + WRONG_CELL_SIGMAS * cell_noises, WRONG_CELL_LIMIT)
    return np.asarray(_are_plausible(fits, cell_noises) & (worst < allowed))


def may_be_occluded(fits: FitResults, noise: float) -> BoolArray:
    """Return which fits (N,) leave more than noise of some pixel, and yet show most of their marker.

    `noise` is the standard deviation of a pixel, grey levels. Such a marker is worth another fit without the
    pixels that something covers (`skyherd.vision.photometric.occlusion`).
    """
    wrong = WrongCellResiduals.of(fits)
    is_wrong = np.abs(fits.cell_means) > WRONG_CELL_LIMIT * wrong.means[:, None, None]
    mostly_right = is_wrong.sum(axis=(1, 2)) <= MAX_COVERED_SHARE * fits.cell_means.shape[1] ** 2
    contrasty = fits.contrasts >= MIN_MARKER_CONTRAST
    outliers = has_outlier_pixels(fits.peaks, fits.contrasts, np.full(fits.ids.size, noise))
    return np.asarray(mostly_right & contrasty & outliers)


def _are_plausible(fits: FitResults, cell_noises: Array) -> BoolArray:
    """Which fits (N,) have settled, with contrast, sharpness, pixels and a shape such as markers have."""
    plausible = (fits.contrasts >= MIN_MARKER_CONTRAST) & (fits.blacks + fits.contrasts <= MAX_WHITE)
    plausible &= (fits.blurs_cells <= MAX_BLUR_CELLS) & (cell_noises <= MAX_CELL_NOISE)
    plausible &= fits.moved_px <= MAX_LAST_STEP_PX
    plausible &= fits.pixels >= MIN_AREA_SHARE * fits.homographies.sides_px() ** 2
    plausible &= np.abs(fits.homographies.squeezes) <= MAX_SQUEEZE * np.abs(fits.homographies.arms)
    return np.asarray(plausible)


def verified(fits: FitResults, noise: float, share: float = WRONG_BIT_SHARE) -> BoolArray:
    """Return which fits (N,) show their marker, leave little but noise, and are blurred and printed alike.

    Args:
        fits: of N markers.
        noise: standard deviation of a pixel, grey levels, determined by other markers or by the image: a
            fit's own residuals would excuse themselves.
        share: what may be left besides noise; see `WRONG_BIT_SHARE`.
    """
    wrong = WrongCellResiduals.of(fits)
    right = _bits_are_right(fits, wrong) & _residuals_are_small(fits, wrong, noise, share)
    if not right.any():
        return right
    blur, contrast = (
        weighted_median(values, fits.pixels * right) for values in (fits.log_blurs, fits.print_contrasts())
    )
    return right & match_blur_and_print(fits, blur, contrast)


def residual_is_noise(fits: FitResults, noise: float) -> BoolArray:
    """Return which fits (N,) to visible pixels have settled and leave no more than the noise, grey levels.

    Nothing is allowed for what the model lacks, since these fits may choose their pixels.
    """
    quiet = fits.noise_stds <= OCCLUSION_NOISE_FACTOR * noise
    return np.asarray(quiet & (fits.moved_px <= OCCLUSION_LAST_STEP_PX))


def match_blur_and_print(fits: FitResults, log_blur: float, print_contrast: float) -> BoolArray:
    """Return which fits (N,) are blurred and printed as the markers of a camera are.

    Args:
        fits: of N markers.
        log_blur: logarithm of the camera's blur over the blur assumed in the fits.
        print_contrast: of the camera's markers, a share of white.
    """
    blurred = np.abs(fits.log_blurs - log_blur) <= MAX_LOG_BLUR_DIFFERENCE
    return np.asarray(blurred & (fits.print_contrasts() >= MIN_PRINT_SHARE * print_contrast))


def _residuals_are_small(
    fits: FitResults, wrong: "WrongCellResiduals", noise: float, share: float
) -> BoolArray:
    """Which fits (N,) leave little more than the noise, pixel by pixel and cell by cell."""
    over_cells = np.sqrt(np.square(fits.cell_means).mean(axis=(1, 2)))
    small = fits.noise_stds <= np.hypot(NOISE_FACTOR * noise, share * wrong.pixels)
    small &= over_cells <= np.hypot(NOISE_FACTOR * noise / wrong.cells_px, share * wrong.cells)
    return np.asarray(small)


def image_noise(image: Image) -> float:
    """Return the noise of an image, standard deviation in grey levels, from the image alone.

    The median of `|I(u - 1) - 2 I(u) + I(u + 1)|` is `0.6745 √6` standard deviations of white noise, if
    texture and edges take up less than half of the image. Every fourth line and column is read, and no
    saturated pixel; the result is infinite if too few are left.
    """
    lines = image[::4].astype(np.int16)
    before, here, after = lines[:, :-2:4], lines[:, 1:-1:4], lines[:, 2::4]
    usable = (here > SATURATION_MARGIN) & (here < 255 - SATURATION_MARGIN)
    differences = np.abs(before - 2 * here + after)[usable]
    if differences.size < MIN_UNSATURATED_PIXELS:
        return np.inf
    return float(np.median(differences)) / (MEDIAN_PER_SIGMA * 6**0.5)


@dataclass(frozen=True)
class WrongCellResiduals:
    """What one cell of the wrong colour would leave of N fits, grey levels.

    Attributes:
        means: (N,) mean residual over that cell.
        pixels: (N,) root mean square of the residuals of all pixels.
        cells: (N,) root mean square of the mean residuals of all cells.
        cells_px: (N,) side of a cell, px.
    """

    means: Array
    pixels: Array
    cells: Array
    cells_px: Array

    @classmethod
    def of(cls, fits: FitResults) -> "WrongCellResiduals":
        """Return the residuals for fits of N markers, at the blur that each fit found."""
        cells_px = fits.homographies.sides_px() / fits.cell_means.shape[1]
        log_sigmas = np.log(fits.blurs_cells) + np.minimum(np.maximum(fits.log_blurs, -1.0), 1.0)
        own, along, square = (np.interp(log_sigmas, _LOG_SIGMAS, table) for table in _integral_tables())
        contrast = np.maximum(fits.contrasts, MIN_DIVISOR_CONTRAST)
        return cls(
            means=contrast * own**2,
            pixels=contrast * square * cells_px / np.sqrt(np.maximum(fits.pixels, 1.0)),
            cells=contrast * along / fits.cell_means.shape[1],
            cells_px=cells_px,
        )


_LOG_SIGMAS: Array = np.linspace(np.log(0.01), np.log(10.0), 400)
"""Logarithms of the tabulated blurs, standard deviations in cells; linear interpolation is good to 1e-4."""


@lru_cache(maxsize=1)
def _integral_tables() -> tuple[Array, Array, Array]:
    """`e_0`, `Σ e_k²` and `∫ E²`, each (400,), at the tabulated blurs."""
    x = (np.arange(SPAN_CELLS * SAMPLES_PER_CELL) + 0.5) / SAMPLES_PER_CELL - SPAN_CELLS / 2
    sigma = np.exp(_LOG_SIGMAS)[:, None]
    seen = ndtr((x + 0.5) / sigma) - ndtr((x - 0.5) / sigma)
    means = seen.reshape(-1, SPAN_CELLS, SAMPLES_PER_CELL).mean(axis=2)
    return means[:, SPAN_CELLS // 2], (means**2).sum(axis=1), (seen**2).sum(axis=1) / SAMPLES_PER_CELL
