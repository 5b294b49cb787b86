"""Markers fitted whose blur is not known beforehand: each about the blur that its last fit found.

A fit is linear in the logarithm of the blur, and so finds a blur within half or double of the one that it
drew the marker with. Fits are repeated about what they found until that changes no more, each marker by
itself: depth and focus may differ from one to the next. Where they hardly differ, all markers take the usual
blur, which is known better than that of any one of them.
"""

from functools import partial

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fitting.fit import MAX_STEPS, USUAL_NOISE
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.scales import MAX_SIDE_PX, fit_all_sizes
from skyherd.vision.photometric.verify import MIN_MARKER_CONTRAST

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

    Returns:
        The results in the order of `ids`, and the plane that they put the markers on.
    """
    sigmas_px = np.array(np.broadcast_to(sigmas_px, (ids.size,)), dtype=float)
    fit = partial(
        fit_all_sizes,
        image,
        dictionary,
        noise=noise,
        alone=alone,
        max_side_px=max_side_px,
        streak_px2=streak_px2,
    )
    fits, plane = fit(ids, homographies, sigmas_px, plane, max_steps=max_steps)
    for _ in range(BLUR_ROUNDS):
        found_px = _within_limits(fits)
        rows = np.flatnonzero(is_promising(fits) & (np.abs(np.log(found_px / sigmas_px)) > BLUR_SETTLED))
        if not rows.size:
            break
        sigmas_px[rows], near = found_px[rows], fits.homographies.take(rows)
        again, _ = fit(ids[rows], near, sigmas_px[rows], plane, max_steps=STEPS_PER_ROUND)
        fits = fits.put(rows, again)
    return fits, plane


def usual_sigma_px(fits: FitResults) -> float:
    """Return the median blur of N markers, at least one, weighted by their pixels, px."""
    return weighted_median(_within_limits(fits), fits.pixels)


def with_usual_blur(fits: FitResults) -> Array:
    """Return the blurs (N,) found, px, those near to the usual one replaced by it."""
    found_px, usual_px = _within_limits(fits), usual_sigma_px(fits)
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
