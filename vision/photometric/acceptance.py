"""Which fits count: as they are, without what covers a marker, or with a perspective of its own."""

import numpy as np

from skyherd.geometry import BoolArray, IntArray
from skyherd.markers.dictionary import code_distance
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.scales import fit_visible_all_sizes
from skyherd.vision.photometric.unknown_blur import START_SIGMA_PX, fit_any_blur, with_usual_blur
from skyherd.vision.photometric.verify import (
    MAX_BLUR_CELLS,
    MIN_MARKER_CONTRAST,
    may_be_occluded,
    residual_is_noise,
    verified,
)


def accepted(
    image: Image, dictionary: str, fits: FitResults, plane: Plane, start: LocalHomographies
) -> tuple[FitResults, BoolArray]:
    """Return the fits, and which of them (N,) are verified.

    Of covered markers they are those to their visible pixels, and of markers that are not on the plane
    those with a perspective of their own. What is refused for its blur is not fitted once more: of several
    fits the one with the least blur would pass, which is that with the largest error.

    Args:
        image: that was fitted, grey, (height, width).
        dictionary: of the markers.
        fits: of N markers.
        plane: that they lie on.
        start: (N,) where the fits began.
    """
    noise, distance = image_noise(image), code_distance(dictionary)
    good = verified(fits, noise, distance)
    floor = max(noise, weighted_median(fits.noise_stds, fits.pixels * good)) if good.any() else noise
    doubtful = np.flatnonzero(may_be_occluded(fits, floor))
    if doubtful.size:
        covered = fits.take(doubtful)
        visible = fit_visible_all_sizes(image, dictionary, covered, with_usual_blur(covered), plane, floor)
        is_good = verified(visible, noise, distance) & residual_is_noise(visible, floor)
        fits, good = _replaced(fits, good, doubtful[is_good], visible.take(is_good))
    legible = (fits.contrasts >= MIN_MARKER_CONTRAST) & (fits.blurs_cells <= MAX_BLUR_CELLS)
    apart = np.flatnonzero(~good & plane.shared & legible)
    if apart.size:
        others = fits.take(apart)
        alone, _ = fit_any_blur(
            image,
            dictionary,
            others.ids,
            start.take(apart),
            START_SIGMA_PX,
            Plane(),
            floor,
            alone=True,
        )
        is_good = verified(alone, noise, distance)
        fits, good = _replaced(fits, good, apart[is_good], alone.take(is_good))
    return fits, good


def _replaced(
    fits: FitResults, good: BoolArray, rows: IntArray, others: FitResults
) -> tuple[FitResults, BoolArray]:
    """Fits with those at indices `rows` replaced, which are then good."""
    good = good.copy()
    good[rows] = True
    return fits.put(rows, others), good
