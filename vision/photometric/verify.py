"""Whether a fit shows its marker: every bit is read again, and nothing but noise may be left.

A fit counts if it passes all tests of `verification_tests`. The three that decide most: every cell has the
right colour, by its residual. The residuals do not exceed the image's noise, or the share of the contrast
that the processing of real cameras leaves of any model. That is 3 to 11 %, by demosaicing, denoising,
sharpening and compression. Its print is that of the others. The others bound contrast, blur, shape and place.

Residuals are measured in units of those that a cell of the wrong colour would leave (`WrongCellResiduals`).

Light falls on black and white alike, so that `(white - black) / white`, the print contrast, is the same in
sun and shade. A patch with less of it than the camera's markers is no print, but ground between cards.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np

from skyherd.geometry import Array, BoolArray
from skyherd.markers.blur_model import normal_cdf
from skyherd.vision.native.follow_records import VerificationLimits
from skyherd.vision.photometric.fitting.fit import has_outlier_pixels
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median

WRONG_CELL_SHARE, WRONG_CELL_SIGMAS, WRONG_CELL_LIMIT = 0.2, 4.0, 0.4
"""A cell is wrong if its mean residual exceeds the last share of what a wrong colour would leave, or the
first share plus so many standard deviations of noise. Chosen: a right cell leaves 0, a wrong one 1, and the
limit stays below the middle between them."""

STRONG_DISTANCE, STRONG_CELL_LIMIT = 8, 0.5
"""Where markers of a dictionary differ by so many bits at least, a cell may leave the second number whatever
the noise: the middle between right and wrong. Chosen: a single cell that is read wrongly does not make
another marker there, and sharpened photographs leave up to 0.49."""

WEAK_CELL_SHARE = 0.21
"""Where they differ by fewer bits, a cell may leave this share and `WRONG_CELL_SIGMAS` standard deviations of
the *image's* noise, as independent errors add up: what a fit leaves besides noise must not excuse its cells.
Measured: of 1050 markers of 4X4_50 on photographs the worst cell leaves 0.195."""

MIN_CELL_PX = 0.8
"""Smallest side of a cell, px. Chosen: cells of the smallest markers that are searched, of 8 px, have one
pixel. A fit explains pixels that are fewer than its unknowns: squares of 3 px in text passed for marker 191
of 36h11."""

MIN_MARKER_CONTRAST = 12.0
"""Smallest contrast of a marker, grey levels. Chosen: four times the usual noise."""

MAX_WHITE = 330.0
"""Upper limit of a plausible white level, grey levels. Measured: on photographs with clipped whites fits find
up to 315, since the clipping sharpens edges; what passes for a marker by chance asks for up to 440."""

MAX_CELL_NOISE = 0.12
"""Largest noise of a cell's mean, as a share of what a wrong colour would leave. Chosen: an eighth; the limit
of 0.4 above is then 3.3 standard deviations of the noise."""

MAX_ANISOTROPY = 0.6
"""Largest anisotropy of a marker's image, as a share of its similarity. Derived: that of a tilt of 75
degrees, where `(1 - cos 75°) / (1 + cos 75°) = 0.59`."""

MAX_KEYSTONE = 0.45
"""Largest keystone of a marker's image. Derived: a marker tilted by 75 degrees has it where the camera
is twice its side away."""

MAX_BLUR_CELLS = 0.75
"""Largest blur, standard deviation in cells. Chosen: beyond it other markers, and even texture, can pass for
a marker. Measured at 0.9 cells: of markers of 10 and 12 px under 0.79 to 0.87 cells, three in a thousand are
taken for another one; at 0.75, of 4608 of 12 px under 0.72 cells none is."""

MAX_LAST_STEP_PX = 0.3
"""A fit whose last step moved the marker's sides by more has found nothing, or not yet. Chosen: drawings
without any blur, which no pattern has, settle slowly; their last steps are of 0.2 px."""

MIN_AREA_SHARE = 0.8
"""Smallest share of a marker's area that its pixels must cover. Chosen: the image may cut off part of the
black border, but no bits."""

NOISE_FACTOR, STRONG_NOISE_FACTOR = 1.15, 1.25
"""A fit to a weak and to a strong code may leave so many times the image's noise. Chosen: an image tells its
noise to a tenth, and texture and compression change it from place to place. Measured: of dark squares with a
light one inside, half of those that pass for marker 17 of 4X4_50 leave 1.15 to 1.25 times the noise."""

MODEL_SHARE, CELL_MODEL_SHARE = 0.16, 0.13
"""A fit may leave these shares of its contrast, if they are more than the noise, as root mean squares over
the pixels and over the cells' means. The model lacks a real camera's processing, motion blur and rounded
corners. The shares do not add to the noise: processing removes most of it. Fits on photographs
leave 5 to 50 times the image's noise; dark squares with light ones inside, in images that nothing processed,
leave 1.1 to 2.2 times. Measured: of 1190 markers on photographs of six kinds 99 % leave less than 0.11 and
0.07, all that are fitted rightly 0.16 and 0.12; of what decodes and is no marker, three quarters leave more
than 0.12 and 0.08, and the rest has a wrong cell."""

SHARP_BLUR_CELLS, STRONG_BLUR_CELLS = 0.15, 0.25
"""Blurs, cells, of weak and of strong codes, beyond which the share allowed for the pixels falls as their
reciprocal. Derived: processing acts within a pixel or two of edges, and leaves little of what is blurred over
more. Measured: no marker on the photographs is lost at these values."""

MAX_PROCESSED_NOISE = 0.03
"""Noise of an image, as a share of a weak code's contrast, beyond which nothing is allowed for what the model
lacks: such an image was hardly processed, and its noise hides what would tell a marker from clutter.
Measured: at most 0.009 for 1066 markers of weak codes on photographs."""

WRONG_BITS_PER_DISTANCE = 0.3
"""Besides, a fit may leave no more than this many wrong bits for each bit by which two markers of its
dictionary differ at least. Measured: of the same markers 99.5 % leave less than 0.3; of dark squares that
happen to have a light one inside, which 4X4_50 has too few bits to tell from its marker 17, a third does."""

MIN_PRINT_SHARE = 0.75
"""Smallest share of the other markers' print contrast. Chosen: print contrasts of markers differ by a tenth
at 12 px and noise 10; stray light of a twentieth of white takes this much in a shade five times darker."""

OCCLUSION_NOISE_FACTOR, OCCLUSION_LAST_STEP_PX = 1.15, 0.1
"""What a fit to chosen pixels may leave, as a multiple of the noise, and how far its last step may move the
sides, px. Chosen stricter than for all pixels, since these were chosen for agreeing."""

SAMPLES_PER_CELL, SPAN_CELLS = 8, 5
"""Sample points of a cell in the integrals of E, and number of cells that they cover: two cells on either
side, which is enough up to a blur of `MAX_BLUR_CELLS`."""

MIN_DIVISOR_CONTRAST = 1e-3
"""Smallest contrast, grey levels, that residuals are compared with; a fit with less is refused anyway."""


@dataclass(frozen=True)
class WrongCellResiduals:
    """Residuals that one cell of the wrong colour would leave in N fits, grey levels.

    Attributes:
        means: (N,) mean residual over that cell.
        pixels: (N,) root mean square of the residuals of all pixels.
        cells_px: (N,) side of a cell, px.
    """

    means: Array
    pixels: Array
    cells_px: Array

    @classmethod
    def of(cls, fits: FitResults) -> "WrongCellResiduals":
        """Return the residuals for fits of N markers, at the blur that each fit found."""
        cells_px = fits.homographies.sides_px() / fits.cell_means.shape[1]
        log_sigmas = np.log(fits.blurs_cells) + np.minimum(np.maximum(fits.log_blurs, -1.0), 1.0)
        own, square = (np.interp(log_sigmas, _LOG_SIGMAS, table) for table in _integral_tables())
        contrast = np.maximum(fits.contrasts, MIN_DIVISOR_CONTRAST)
        return cls(
            means=contrast * own**2,
            pixels=contrast * square * cells_px / np.sqrt(np.maximum(fits.pixels, 1.0)),
            cells_px=cells_px,
        )


_LOG_SIGMAS: Array = np.linspace(np.log(0.01), np.log(10.0), 400)
"""Logarithms of the tabulated blurs, standard deviations in cells; linear interpolation is good to 1e-4."""


@lru_cache(maxsize=1)
def _integral_tables() -> tuple[Array, Array]:
    """`∫ E` over the wrong cell itself and `∫ E²` over all, each (400,), at the tabulated blurs."""
    x = (np.arange(SPAN_CELLS * SAMPLES_PER_CELL) + 0.5) / SAMPLES_PER_CELL - SPAN_CELLS / 2
    sigma = np.exp(_LOG_SIGMAS)[:, None]
    seen = normal_cdf((x + 0.5) / sigma) - normal_cdf((x - 0.5) / sigma)
    own = seen[:, np.abs(x) < 1 / 2].mean(axis=1)
    return own, (seen**2).sum(axis=1) / SAMPLES_PER_CELL


class Quantity(Enum):
    """Quantity that a test of a fit compares with a limit; the values are the words that users read."""

    CELL_SIZE = "cell in pixels"
    CONTRAST = "contrast"
    WHITE = "white level"
    BLUR = "blur in cells"
    CELL_NOISE = "noise of a cell"
    LAST_STEP = "last step of the fit"
    AREA = "area in the image"
    ANISOTROPY = "anisotropy"
    KEYSTONE = "keystone"
    WORST_CELL = "worst cell"
    PIXEL_RESIDUAL = "residual of the pixels"
    CELL_RESIDUAL = "residual of the cells"
    PRINT_CONTRAST = "print contrast"


@dataclass(frozen=True)
class FitTest:
    """One test of N fits: a quantity of each, and its limit.

    Attributes:
        quantity: what is tested.
        values: (N,) of the quantity, in the unit that the function which makes the test says.
        limits: (N,) largest values that pass, or smallest ones; one number for all fits alike.
        at_least: whether limits are the smallest values that pass.
    """

    quantity: Quantity
    values: Array
    limits: Array | float
    at_least: bool = False

    def passed(self) -> BoolArray:
        """Return which fits (N,) pass; one whose value is no number does not."""
        return np.asarray(self.values >= self.limits if self.at_least else self.values <= self.limits)


def _all_passed(tests: Iterable[FitTest]) -> BoolArray:
    """Return which fits (N,) pass all of at least one test."""
    return np.asarray(np.logical_and.reduce([test.passed() for test in tests]))


def bits_are_right(fits: FitResults, distance: int) -> BoolArray:
    """Return which fits (N,) are plausible markers and leave every cell the colour it should have.

    `distance` is the least number of bits by which two markers of the dictionary differ.
    """
    return _all_passed(_bit_tests(fits, WrongCellResiduals.of(fits), distance))


def _bit_tests(fits: FitResults, wrong: WrongCellResiduals, distance: int) -> list[FitTest]:
    """Return tests of plausibility, of the last step, px, and of the cells, as shares of a wrong one."""
    cell_noises = fits.noise_stds / (wrong.means * wrong.cells_px)
    worst = np.abs(fits.cell_means).max(axis=(1, 2)) / wrong.means
    allowed = np.minimum(WRONG_CELL_SHARE + WRONG_CELL_SIGMAS * cell_noises, WRONG_CELL_LIMIT)
    if distance >= STRONG_DISTANCE:
        allowed = np.full_like(worst, STRONG_CELL_LIMIT)
    return [
        *_plausibility_tests(fits),
        FitTest(Quantity.WORST_CELL, worst, allowed),
        FitTest(Quantity.LAST_STEP, fits.moved_px, MAX_LAST_STEP_PX),
        FitTest(Quantity.CELL_NOISE, cell_noises, MAX_CELL_NOISE),
    ]


def may_be_occluded(fits: FitResults, noise: float) -> BoolArray:
    """Return which fits (N,) have a marker's contrast and leave more than noise of some pixel.

    `noise` is the standard deviation of a pixel, grey levels. Such a marker is worth another fit without the
    pixels that something covers (`fitting.occlusion`).
    """
    contrasty = fits.contrasts >= MIN_MARKER_CONTRAST
    outliers = has_outlier_pixels(fits.peaks, fits.contrasts, np.full(fits.ids.size, noise))
    return np.asarray(contrasty & outliers)


def _plausibility_tests(fits: FitResults) -> list[FitTest]:
    """Return tests whether fits have cells, contrast, sharpness, a shape and pixels such as markers have.

    Cells are in px, contrast and white are grey levels, the blur is in cells, the others are shares of area,
    similarity and side.
    """
    shapes, n_cells = fits.homographies, fits.cell_means.shape[1]
    return [
        FitTest(Quantity.CELL_SIZE, shapes.sides_px() / n_cells, MIN_CELL_PX, at_least=True),
        FitTest(Quantity.CONTRAST, fits.contrasts, MIN_MARKER_CONTRAST, at_least=True),
        FitTest(Quantity.WHITE, fits.blacks + fits.contrasts, MAX_WHITE),
        FitTest(Quantity.BLUR, fits.blurs_cells, MAX_BLUR_CELLS),
        FitTest(Quantity.AREA, fits.pixels / shapes.sides_px() ** 2, MIN_AREA_SHARE, at_least=True),
        FitTest(
            Quantity.ANISOTROPY, np.abs(shapes.anisotropies) / np.abs(shapes.similarities), MAX_ANISOTROPY
        ),
        FitTest(Quantity.KEYSTONE, np.abs(shapes.keystones()), MAX_KEYSTONE),
    ]


def verified(fits: FitResults, noise: float, distance: int) -> BoolArray:
    """Return which fits (N,) pass all of `verification_tests`, with the same arguments."""
    return _all_passed(verification_tests(fits, noise, distance))


def verification_tests(fits: FitResults, noise: float, distance: int) -> list[FitTest]:
    """Return all tests of fits: that they show their marker, leave little but noise, and are printed alike.

    The tests are in the order in which they are best told: one that fails often makes later ones fail too.

    Args:
        fits: of N markers.
        noise: standard deviation of a pixel, grey levels, determined by the image: a fit's own residuals
            would excuse themselves.
        distance: least number of bits by which two markers of the dictionary differ.
    """
    wrong = WrongCellResiduals.of(fits)
    tests = [*_bit_tests(fits, wrong, distance), *_residual_tests(fits, wrong, noise, distance)]
    right, prints = _all_passed(tests), fits.print_contrasts()
    usual = weighted_median(prints, fits.pixels * right) if right.any() else 0.0
    return [*tests, FitTest(Quantity.PRINT_CONTRAST, prints, MIN_PRINT_SHARE * usual, at_least=True)]


def residual_is_noise(fits: FitResults, noise: float | Array) -> BoolArray:
    """Return which fits (N,) to visible pixels have settled and leave no more than the noise, grey levels.

    Nothing is allowed for what the model lacks, since these fits may choose their pixels.
    """
    quiet = fits.noise_stds <= OCCLUSION_NOISE_FACTOR * noise
    return np.asarray(quiet & (fits.moved_px <= OCCLUSION_LAST_STEP_PX))


def _residual_tests(
    fits: FitResults, wrong: WrongCellResiduals, noise: float, distance: int
) -> list[FitTest]:
    """Return tests of the residuals of pixels and of cells against the noise, grey levels."""
    over_cells = np.sqrt(np.square(fits.cell_means).mean(axis=(1, 2)))
    sharp = STRONG_BLUR_CELLS if distance >= STRONG_DISTANCE else SHARP_BLUR_CELLS
    share = MODEL_SHARE * np.minimum(1.0, sharp / fits.blurs_cells)
    few_bits = np.sqrt(WRONG_BITS_PER_DISTANCE * distance) * wrong.pixels
    model = np.minimum(share * fits.contrasts, few_bits)
    cell_noises = noise / (wrong.means * wrong.cells_px)
    if distance < STRONG_DISTANCE:
        model = np.where(noise > MAX_PROCESSED_NOISE * fits.contrasts, 0.0, model)
    noise *= STRONG_NOISE_FACTOR if distance >= STRONG_DISTANCE else NOISE_FACTOR
    tests = [FitTest(Quantity.PIXEL_RESIDUAL, fits.noise_stds, np.maximum(noise, model))]
    if distance < STRONG_DISTANCE:
        worst = np.abs(fits.cell_means).max(axis=(1, 2)) / wrong.means
        most = np.hypot(WEAK_CELL_SHARE, WRONG_CELL_SIGMAS * cell_noises)
        tests = [FitTest(Quantity.WORST_CELL, worst, most), *tests]
    over_noise = np.maximum(noise / wrong.cells_px, CELL_MODEL_SHARE * fits.contrasts)
    return [*tests, FitTest(Quantity.CELL_RESIDUAL, over_cells, over_noise)]


@lru_cache(maxsize=8)
def verification_limits(distance: int) -> VerificationLimits:
    """Return the limits of `verified` for the compiled library."""
    (own, square), is_strong = _integral_tables(), distance >= STRONG_DISTANCE
    return VerificationLimits(
        wrong_cell_share=WRONG_CELL_SHARE,
        wrong_cell_sigmas=WRONG_CELL_SIGMAS,
        wrong_cell_limit=WRONG_CELL_LIMIT,
        strong_cell_limit=STRONG_CELL_LIMIT,
        weak_cell_share=WEAK_CELL_SHARE,
        min_contrast=MIN_MARKER_CONTRAST,
        max_white=MAX_WHITE,
        max_cell_noise=MAX_CELL_NOISE,
        max_anisotropy=MAX_ANISOTROPY,
        max_keystone=MAX_KEYSTONE,
        max_blur_cells=MAX_BLUR_CELLS,
        max_last_step_px=MAX_LAST_STEP_PX,
        min_cell_px=MIN_CELL_PX,
        min_area_share=MIN_AREA_SHARE,
        noise_factor=STRONG_NOISE_FACTOR if is_strong else NOISE_FACTOR,
        model_share=MODEL_SHARE,
        cell_model_share=CELL_MODEL_SHARE,
        sharp_blur_cells=STRONG_BLUR_CELLS if is_strong else SHARP_BLUR_CELLS,
        max_processed_noise=MAX_PROCESSED_NOISE,
        wrong_bits=WRONG_BITS_PER_DISTANCE * distance,
        min_print_share=MIN_PRINT_SHARE,
        min_divisor_contrast=MIN_DIVISOR_CONTRAST,
        first_log_sigma=_LOG_SIGMAS[0],
        last_log_sigma=_LOG_SIGMAS[-1],
        own_cell=own.ctypes.data,  # the tables are kept by their cache
        square=square.ctypes.data,
        table_size=own.size,
        is_strong=is_strong,
    )
