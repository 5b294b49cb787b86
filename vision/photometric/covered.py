"""Markers that something covers: their fits to the pixels that are visible."""

from collections.abc import Callable
from functools import partial

import numpy as np

from skyherd.geometry import BoolArray
from skyherd.markers.dictionary import code_distance
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.fit_result import FitResults, replaced
from skyherd.vision.photometric.fitting.plane import MIN_MARKERS_ON_PLANE, Plane
from skyherd.vision.photometric.image_noise import Noises
from skyherd.vision.photometric.refine import fit_visible_all_sizes, with_usual_blur
from skyherd.vision.photometric.verify import residual_is_noise, verified

MAX_RATIO_TO_CLEAR = 2.0
"""Largest residual of a fit to visible pixels that replaces a verified fit, over that of clear markers.
Measured: 0.8 to 0.9 under covers and dead rows, up to 1.7 under pen lines, and 27 or more in thresholded
images."""


def refit_covered(
    image: Image,
    dictionary: str,
    fits: FitResults,
    good: BoolArray,
    is_covered: BoolArray,
    known_plane: Plane,
    noises: Noises,
) -> tuple[FitResults, BoolArray, Plane]:
    """Refit covered markers, a mask (N,), to their visible pixels, on the plane that others show.

    Returned are the fits, which (N,) are verified, and the plane, known or found. Outliers along all edges,
    as of thresholded images, cover nothing: a verified fit is replaced only if the other leaves little more
    than clear markers do.
    """
    rows = np.flatnonzero(is_covered)
    if not rows.size:
        return fits, good, known_plane
    most = np.full(rows.size, noises.verified)
    most[good[rows]] = min(noises.verified, MAX_RATIO_TO_CLEAR * noises.clear)

    def is_explained(visible: FitResults) -> BoolArray:
        is_right = verified(visible, noises.image, code_distance(dictionary))
        return np.asarray(is_right & residual_is_noise(visible, most))

    there = fits.take(rows)
    visible, is_good, plane = fit_visible_pixels(
        image, dictionary, there, known_plane, noises.verified, is_explained
    )
    return *replaced(fits, good, rows[is_good], visible.take(is_good)), plane


def fit_visible_pixels(
    image: Image,
    dictionary: str,
    fits: FitResults,
    known_plane: Plane,
    noise: float,
    is_accepted: Callable[[FitResults], BoolArray],
) -> tuple[FitResults, BoolArray, Plane]:
    """Return fits to the visible pixels, on the known plane or, where that is not accepted, off it.

    If no plane is known, the accepted fits are fitted again on their own one, if they are enough to show it.
    Returned with the fits are which of them (N,) are accepted, and the plane, known or found.
    """
    fit = partial(fit_visible_all_sizes, image, dictionary, noise=noise)
    sigmas_px = with_usual_blur(fits)
    visible, _ = fit(fits, sigmas_px, known_plane)
    accepted = is_accepted(visible)
    off, rows = np.flatnonzero(~accepted), np.flatnonzero(accepted)
    if known_plane.shared and off.size:
        visible = visible.put(off, fit(fits.take(off), sigmas_px[off], OWN_PLANES)[0])
        return visible, is_accepted(visible), known_plane
    if known_plane.shared or rows.size < MIN_MARKERS_ON_PLANE:
        return visible, accepted, known_plane
    together, plane = fit(visible.take(rows), sigmas_px[rows], OWN_PLANES, settled=True)
    on_plane = visible.put(rows, together)
    kept = is_accepted(on_plane)
    return visible.put(np.flatnonzero(kept), on_plane.take(kept)), accepted | kept, plane
