"""Fits of markers under conditions that are not known beforehand: blur, size and streaks of motion.

*Blur.* A fit is linear in the logarithm of the blur, and finds a blur within half or double of the assumed
one. Fits are repeated about the blur that they found until it settles, each marker by itself, since depth and
focus differ from one to the next. Markers whose blurs hardly differ take the usual blur, which is known
better than that of any one of them.

*Size.* A large marker has more pixels than are of use. It is fitted in an image shrunk by means over k x k
pixels, whose blur has the variance `σ'² = (σ² - 1/12) / k² + 1/12`, px²: the lens's part shrinks, that of the
square pixel, 1/12, does not.

*Streaks.* A camera that moves straight makes the same streak of every point. Under a round blur, headings are
then off by more than their covariances. Evidence for a streak is summed over a few markers, since one alone
is not conclusive. Only if there is a streak, markers are fitted again under an elliptic blur. A camera that
turns makes different streaks of different markers; they are fitted under their common one.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np

from skyherd.geometry import UNIFORM_VARIANCE, Array, BoolArray, IntArray
from skyherd.markers.dictionary import code_distance
from skyherd.vision.grey import Image, block_means
from skyherd.vision.native.library import library
from skyherd.vision.native.records import BlurConstants, BlurRequest
from skyherd.vision.photometric.fitting.appearance import appearance_constants, black_cells
from skyherd.vision.photometric.fitting.fit import MAX_STEPS, USUAL_NOISE, fit_constants
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.occlusion import fit_visible
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.fitting.streak_evidence import streak_evidence
from skyherd.vision.photometric.fitting.surroundings import Surroundings
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.verify import MIN_MARKER_CONTRAST, verified

MAX_SIDE_PX = 144.0
"""Side, px, above which a marker is fitted in an image shrunk by 2, 4, 8 and so on, so that its side there is
between 72 and 144 px. Chosen: a smaller value makes large markers less precise, a larger one costs time and
memory with its square."""


def fit_all_sizes(
    image: Image,
    dictionary: str,
    ids: IntArray,
    homographies: LocalHomographies,
    sigma_px: float | Array,
    plane: Plane,
    noise: float,
    max_steps: int = MAX_STEPS,
    *,
    alone: bool = False,
    max_side_px: float = MAX_SIDE_PX,
    streak_px2: complex | None = None,
    surroundings: Surroundings | None = None,
    blur_rounds: int = 0,
    fitted: tuple[FitResults, Plane] | None = None,
) -> tuple[FitResults, Plane]:
    """Do as `fit_markers`, with each marker at a resolution that suits it.

    Arguments and results are those of `fit_markers` and refer to the full-size image; the plane is that of
    the smallest markers. Markers of more than `max_side_px` are fitted in a shrunk image.

    Markers are fitted again up to `blur_rounds` times about the blurs that they found. The first fit may be
    given as `fitted`.
    """
    around = Surroundings.of_cards(ids.size) if surroundings is None else surroundings
    request = BlurRequest(
        image=np.ascontiguousarray(image),
        start=homographies.records(),
        sigmas_px=np.array(np.broadcast_to(sigma_px, (ids.size,)), dtype=float),
        surroundings=around.records(),
        cells=black_cells(dictionary, ids),
        constants=fit_constants(),
        looks=appearance_constants(dictionary),
        limits=blur_constants(),
        noise=noise,
        max_steps=max_steps,
        alone=alone,
        streak_px2=streak_px2,
        max_side_px=max_side_px,
        rounds=blur_rounds,
        fitted=fitted[0].records() if fitted else None,
    )
    found = (fitted[1] if fitted else plane).record()
    fits = FitResults.of_records(ids, *library().fit_any_blur(request, found))
    return fits, Plane.of_record(found)


def fit_visible_all_sizes(
    image: Image,
    dictionary: str,
    fits: FitResults,
    sigma_px: float | Array,
    plane: Plane,
    noise: float,
    *,
    settled: bool = False,
) -> tuple[FitResults, Plane]:
    """Do as `fit_visible`, with each marker at a resolution that suits it; in the order of `fits`.

    The plane is that of the smallest markers.
    """
    octaves, visible, found = size_octaves(fits.homographies, MAX_SIDE_PX), fits, list[Plane]()
    sigmas_px = np.broadcast_to(np.asarray(sigma_px, dtype=float), (fits.ids.size,))
    for octave in np.unique(octaves):
        rows, scaled = np.flatnonzero(octaves == octave), ScaledImage(image, 2 ** int(octave))
        covered = fits.take(rows)
        refitted, there = fit_visible(
            scaled.image,
            dictionary,
            replace(covered, homographies=scaled.homographies(covered.homographies)),
            scaled.sigmas_px(sigmas_px[rows]),
            scaled.plane(plane),
            scaled.noise(noise),
            settled=settled,
        )
        visible = visible.put(rows, scaled.full_size(refitted))
        found.append(scaled.full_size_plane(there))
    return visible, found[0]


def size_octaves(homographies: LocalHomographies, max_side_px: float) -> IntArray:
    """Return how often (N,) the image is to be halved for each marker."""
    octaves = np.maximum(np.ceil(np.log2(homographies.sides_px() / max_side_px)), 0)
    return np.asarray(octaves, dtype=np.int64)


class ScaledImage:
    """An image shrunk by means over `shrink` x `shrink` pixels, and what is known of it at that size.

    Lines and columns that make no whole square are left out. With `shrink` 1 the image is used as it is.
    """

    def __init__(self, image: Image, shrink: int) -> None:
        self.shrink = shrink
        self.image = image if shrink == 1 else block_means(image, shrink)

    def homographies(self, homographies: LocalHomographies) -> LocalHomographies:
        """Return homographies into the shrunk image, from those into the full-size one."""
        return homographies if self.shrink == 1 else homographies.scaled(self.shrink)

    def sigmas_px(self, sigmas_px: Array) -> Array:
        """Return blurs (N,) of lens and pixel in shrunk pixels, from those in full-size pixels."""
        return sigmas_px if self.shrink == 1 else _rescaled(sigmas_px, 1 / self.shrink)

    def full_size_sigmas_px(self, sigmas_px: Array) -> Array:
        """Return blurs (N,) of lens and pixel in full-size pixels, from those in shrunk pixels."""
        return sigmas_px if self.shrink == 1 else _rescaled(sigmas_px, self.shrink)

    def noise(self, noise: float) -> float:
        """Return the standard deviation of a shrunk pixel, grey levels: that of a mean, rounded once more."""
        return noise if self.shrink == 1 else math.hypot(noise / self.shrink, UNIFORM_VARIANCE**0.5)

    def plane(self, plane: Plane) -> Plane:
        """Return the plane in shrunk pixels, from that in full-size ones."""
        return plane if self.shrink == 1 else plane.scaled(1 / self.shrink)

    def full_size_plane(self, plane: Plane) -> Plane:
        """Return the plane in full-size pixels, from that in shrunk ones."""
        return plane if self.shrink == 1 else plane.scaled(self.shrink)

    def full_size(self, fits: FitResults) -> FitResults:
        """Return results of fits in the shrunk image in pixels of the full-size one."""
        if self.shrink == 1:
            return fits
        scale = np.diag([self.shrink, self.shrink, 1.0])
        return replace(
            fits,
            homographies=fits.homographies.scaled(1 / self.shrink),
            covariances=scale @ fits.covariances @ scale,
            sigmas_px=self.full_size_sigmas_px(fits.sigmas_px),
            pixels=fits.pixels * self.shrink**2,
            moved_px=fits.moved_px * self.shrink,
        )


def _rescaled(sigmas_px: Array, factor: float) -> Array:
    """Return blurs (N,) of lens and square pixel in an image `factor` times as large."""
    lens_px2 = np.maximum(sigmas_px**2 - UNIFORM_VARIANCE, 0.0)
    return np.asarray(np.sqrt(lens_px2 * factor**2 + UNIFORM_VARIANCE))


START_SIGMA_PX = 0.6
"""Blur assumed before any marker was seen, standard deviation of lens and pixel together, px. Measured: the
median of 1190 markers on photographs of six kinds is 0.56 px."""

MIN_SIGMA_PX, MAX_SIGMA_CELLS = 0.25, 1.0
"""Limits of the blur that markers are fitted under, px and cells. Chosen: the pixel alone has 0.29 px, and
drawings less; the upper limit is a third beyond `MAX_BLUR_CELLS`, so that what is refused for its blur was
fitted under it. Fits under less blur than there is are off by more than they tell: at 0.6 cells where there
are 0.8, by 0.1 px and more in markers of 10 px."""

BLUR_ROUNDS, BLUR_SETTLED = 6, 0.06
"""The blur is found by so many more rounds of fitting at most, until its logarithm changes by less than the
second number. Chosen: the fit corrects an error of 6 % to second order; six rounds reach from half a pixel to
ten."""

STEPS_PER_ROUND = 3
"""Most steps of each of these fits, which begin where the last one ended. Chosen: half of `MAX_STEPS`."""

MAX_LOG_BLUR_DIFFERENCE = 0.15
"""Blurs whose logarithms differ by less from the usual one's are replaced by it. Chosen: three times the
error of a marker's blur at 12 px and noise 10."""

MAX_WRONG_SHARE = 0.6
"""Mean residual of a cell, as a share of the contrast, up to which a fit is worth another. Chosen: a right
cell may leave half of it under a blur that is wrong by half."""


def fit_any_blur(
    image: Image,
    dictionary: str,
    ids: IntArray,
    homographies: LocalHomographies,
    sigmas_px: float | Array,
    plane: Plane,
    noise: float = USUAL_NOISE,
    max_steps: int = MAX_STEPS,
    *,
    alone: bool = False,
    max_side_px: float = MAX_SIDE_PX,
    streak_px2: complex | None = None,
    surroundings: Surroundings | None = None,
    fitted: tuple[FitResults, Plane] | None = None,
) -> tuple[FitResults, Plane]:
    """Fit markers as `fit_all_sizes` does, of which `sigmas_px` is only where the blur begins.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        ids: (N,) marker ids, at least one.
        homographies: N of them, where to begin.
        sigmas_px: standard deviation of the blur to begin with: one for all, or (N,).
        plane: of the markers, as far as it is known.
        noise: standard deviation of a pixel, grey levels, as far as it is known.
        max_steps: most steps of the first fit.
        alone: whether each marker has a plane of its own, also if one would explain them all.
        max_side_px: side from which on markers are fitted in a shrunk image.
        streak_px2: as of `fit_markers`.
        surroundings: of the markers; white cards if left out.
        fitted: result of the first fit, if it is known already.

    Returns:
        The results in the order of `ids`, and the plane that they put the markers on.
    """
    return fit_all_sizes(
        image,
        dictionary,
        ids,
        homographies,
        sigmas_px,
        plane,
        noise,
        max_steps,
        alone=alone,
        max_side_px=max_side_px,
        streak_px2=streak_px2,
        surroundings=surroundings,
        blur_rounds=BLUR_ROUNDS,
        fitted=fitted,
    )


@cache
def blur_constants() -> BlurConstants:
    """Return the limits of blurs, and of fits about them, for the compiled library."""
    return BlurConstants(
        min_sigma_px=MIN_SIGMA_PX,
        max_sigma_cells=MAX_SIGMA_CELLS,
        settled=BLUR_SETTLED,
        min_contrast=MIN_MARKER_CONTRAST,
        max_wrong_share=MAX_WRONG_SHARE,
        steps_per_round=STEPS_PER_ROUND,
    )


def usual_sigma_px(fits: FitResults) -> float:
    """Return the median blur of N markers, at least one, weighted by their pixels, px."""
    return weighted_median(_within_limits(fits), fits.pixels)


def with_usual_blur(fits: FitResults, usual_px: float | None = None) -> Array:
    """Return the blurs (N,) found, px, those near to the usual one replaced by it.

    The usual one is that of these fits if it is left out.
    """
    found_px = _within_limits(fits)
    usual_px = usual_sigma_px(fits) if usual_px is None else usual_px
    near = np.abs(np.log(found_px / usual_px)) < MAX_LOG_BLUR_DIFFERENCE
    return np.where(near, usual_px, found_px)


def _within_limits(fits: FitResults) -> Array:
    cells_px = fits.homographies.sides_px() / fits.cell_means.shape[1]
    max_px = np.maximum(MAX_SIGMA_CELLS * cells_px, MIN_SIGMA_PX)
    return np.clip(fits.sigmas_px, MIN_SIGMA_PX, max_px)


def is_promising(fits: FitResults) -> BoolArray:
    """Return which fits (N,) may yet be of markers: with contrast, and no cell quite wrong."""
    worst = np.abs(fits.cell_means).max(axis=(1, 2))
    return np.asarray((fits.contrasts >= MIN_MARKER_CONTRAST) & (worst < MAX_WRONG_SHARE * fits.contrasts))


STREAK_MARKERS, STREAK_PIXELS = 4, 3000
"""So many markers at most, of so many pixels together, are asked whether there is a streak. Chosen: a streak
that turns a heading by its standard deviation raises the chi-squared of each marker by more than one, so
that four tell it; more of them take time in every image."""

SIGNIFICANT = 20.0
"""Fall of the chi-squared from which on there is a streak. Derived: chance reaches `exp(-20 / 2)`, once in
22000 images."""

MIN_STREAK_PX2 = 0.02
"""Smallest streak, px², that markers are fitted again for. Chosen: that of 0.7 px; less turns no heading by
its noise, and lenses have as much."""

HOPELESS_RISE = 1.05
"""Ratio of the residuals after a round to those under round blur above which the streak is given up. Measured
on 107 photographs with evidence of a streak: after the first round it is 1.03 at most where later ones bring
it below 1, and up to 3.8 where none does."""

STREAK_ROUNDS, SETTLED_SHARE, SETTLED_SIGNIFICANCE = 4, 0.05, 1.0
"""Largest number of fits under a streak. They end when it changes by less than the share, or when the
chi-squared falls by less than the last number. Chosen: the rest is of second order in the change, or within
the streak's standard deviation. Measured on 201 photographs: the last one saves a third of the time of
streaks. All 2,348 markers are found, and one in 80 moves by more than its standard deviation."""


def with_streak(
    image: Image, dictionary: str, fits: FitResults, good: BoolArray, plane: Plane, worth: BoolArray
) -> tuple[FitResults, BoolArray, Plane]:
    """Return fits under the streak that the image has; the same, as they are, if it has none.

    Args:
        image: that was fitted, grey, (height, width).
        dictionary: of the markers.
        fits: of N markers under round blur.
        good: (N,) which of them are verified; these tell whether there is a streak.
        plane: that they lie on.
        worth: (N,) which of them are worth another fit.

    Returns:
        The fits, which of them (N,) are verified, and the plane.
    """
    rows = _telling(fits, good)
    if not rows.size:
        return fits, good, plane
    noise = weighted_median(fits.noise_stds, fits.pixels * good)
    few = _few(fits, rows)
    evidence = streak_evidence(image, dictionary, fits.take(few), plane, noise, 0j)
    if evidence.significance() < SIGNIFICANT or abs(evidence.change_px2()) < MIN_STREAK_PX2:
        return fits, good, plane
    promising = np.flatnonzero(is_promising(fits) & (worth | good))
    streak_px2, rise, old = 0j, 1.0, fits.take(promising)
    new, new_plane, telling = old, plane, np.flatnonzero(np.isin(promising, rows))
    for _ in range(STREAK_ROUNDS):
        evidence = streak_evidence(image, dictionary, new.take(telling), new_plane, noise, streak_px2)
        change = evidence.change_px2()
        is_within_noise = streak_px2 and evidence.significance() < SETTLED_SIGNIFICANCE
        if is_within_noise or abs(change) < SETTLED_SHARE * abs(streak_px2):
            break
        streak_px2 += change
        new, new_plane = fit_any_blur(
            image,
            dictionary,
            new.ids,
            new.homographies,
            with_usual_blur(new),
            new_plane,
            noise,
            streak_px2=streak_px2,
            surroundings=new.surroundings,
        )
        rise = float(np.median(new.noise_stds[telling] / old.noise_stds[telling]))
        if rise > HOPELESS_RISE:
            return fits, good, plane
    if rise > 1:
        return fits, good, plane
    is_good = verified(new, image_noise(image), code_distance(dictionary))
    good = good.copy()
    good[promising[is_good]] = True
    return fits.put(promising[is_good], new.take(is_good)), good, new_plane


def _telling(fits: FitResults, good: BoolArray) -> IntArray:
    """Return indices of the fits that show a streak: verified ones in the image's own pixels."""
    return np.flatnonzero(good & (fits.homographies.sides_px() <= MAX_SIDE_PX))


def _few(fits: FitResults, rows: IntArray) -> IntArray:
    """Return those of the fits at indices `rows`, at least one, that are asked in every image."""
    few = rows[:: max(1, -(-rows.size // STREAK_MARKERS))]
    return few[: max(1, int((np.cumsum(fits.pixels[few]) <= STREAK_PIXELS).sum()))]
