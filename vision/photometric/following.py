"""Markers followed from one image of a unit to the next: fitted where they should be by now.

That is, in this order: where their own last steps lead (`skyherd.vision.photometric.tracks`); where the
others' common motion takes them (`skyherd.vision.photometric.common_motion`); and near these places.
"""

from dataclasses import replace

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.markers.dictionary import code_distance
from skyherd.vision.grey import Image
from skyherd.vision.photometric.acceptance import accepted
from skyherd.vision.photometric.common_motion import (
    MIN_SHIFT_SIDES,
    REACH_SIDES,
    carried,
    common_motion,
    find_quads_near,
    innermost,
    shifts_sides,
)
from skyherd.vision.photometric.fitting.fit import MAX_STEPS_FROM_PREDICTION, USUAL_NOISE
from skyherd.vision.photometric.fitting.fit_result import FitResults, no_fit_results
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.image_estimates import ImageEstimates
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.look import look_at_quads
from skyherd.vision.photometric.places import unambiguous
from skyherd.vision.photometric.streaks import with_streak
from skyherd.vision.photometric.tracks import in_view, is_whole
from skyherd.vision.photometric.unknown_blur import fit_any_blur, is_promising
from skyherd.vision.photometric.verify import verified
from skyherd.vision.search.decode import MIN_CORRELATION


def follow(image: Image, dictionary: str, known: ImageEstimates, time_s: float) -> tuple[FitResults, bool]:
    """Return the markers that are followed, in ascending order of id, and whether one is missing.

    Markers that were about to leave the view are not missing, unless they were expected so far from where
    they were that the expectation may be wrong.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        known: what is known of the unit's images; its plane becomes that of this image.
        time_s: when the image was taken.
    """
    start = known.tracks.predicted(time_s)
    here, whole = in_view(start, image.shape), is_whole(start, image.shape)
    should_be_seen = whole | (shifts_sides(known.tracks.homographies, start) > REACH_SIDES)
    if not here.any():
        return no_fit_results(dictionary), bool(should_be_seen.any())
    ids, start = known.tracks.ids[here], start.take(here)
    fits, start = _fit_tracks(image, dictionary, known, ids, start, known.tracks.sigmas_px[here])
    lost = ~is_promising(fits)
    near = _find_near(image, dictionary, known, start.take(lost), fits.homographies.take(~lost))
    near = near.take(np.isin(near.ids, ids))  # others are for the search, which compares their prints
    rest = ~np.isin(ids, near.ids)
    fits, start = fits.take(rest), start.take(rest)
    if fits.ids.size:
        fits, good = accepted(image, dictionary, fits, known.plane, start)
        fits, good, known.plane = with_streak(image, dictionary, fits, good, known.plane)
        fits = fits.take(good)
    found = unambiguous(fits.joined(near))
    return found, bool((should_be_seen & ~np.isin(known.tracks.ids, found.ids)).any())


def _fit_tracks(
    image: Image,
    dictionary: str,
    known: ImageEstimates,
    ids: IntArray,
    start: LocalHomographies,
    sigmas_px: Array,
) -> tuple[FitResults, LocalHomographies]:
    """Fits of followed markers, and their places: as predicted, or where a common motion took them."""
    plane, noise = known.plane, known.noise or USUAL_NOISE
    about = noise, MAX_STEPS_FROM_PREDICTION
    fits, known.plane = fit_any_blur(image, dictionary, ids, start, sigmas_px, plane, *about)
    lost = np.flatnonzero(~is_promising(fits))
    if not lost.size:
        return fits, start
    moved = _moved(image, dictionary, known, start, fits)
    again = shifts_sides(start.take(lost), moved.take(lost)) > MIN_SHIFT_SIDES
    if not again.any():
        return fits, start
    # All are fitted again, since few may have told the plane.
    there = fits.homographies.put(lost, moved.take(lost))
    fits, known.plane = fit_any_blur(image, dictionary, ids, there, sigmas_px, plane, *about)
    right = np.flatnonzero(is_promising(fits))
    return fits, start.put(right, there.take(right))


def _moved(
    image: Image, dictionary: str, known: ImageEstimates, start: LocalHomographies, fits: FitResults
) -> LocalHomographies:
    """Where followed markers are by the motion of those that were found, or of some that are searched."""
    seen = fits.take(verified(fits, image_noise(image), code_distance(dictionary)))
    if not seen.ids.size:
        nowhere = no_fit_results(dictionary).homographies
        seen = _find_near(image, dictionary, known, innermost(start, image), nowhere)
        seen = unambiguous(seen.take(np.isin(seen.ids, fits.ids)))
    if not seen.ids.size:
        return start
    rows = np.searchsorted(fits.ids, seen.ids)
    return carried(start, common_motion(start.take(rows), seen.homographies))


def _find_near(
    image: Image, dictionary: str, known: ImageEstimates, places: LocalHomographies, there: LocalHomographies
) -> FitResults:
    """Verified markers near places, but for where markers are known to be there."""
    if not len(places):
        return no_fit_results(dictionary)
    quads = find_quads_near(image, places)
    return look_at_quads(image, dictionary, replace(known), quads, there, MIN_CORRELATION).found
