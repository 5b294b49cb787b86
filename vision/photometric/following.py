"""Markers followed from one image of a camera to the next: fitted where they are predicted.

A followed marker is fitted where its own last steps lead (`first_fit`), then where the common motion of the
others takes it, and at last searched for near these places (`skyherd.vision.photometric.tracks`).
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, IntArray, to_points
from skyherd.markers.dictionary import code_distance
from skyherd.vision.grey import Image
from skyherd.vision.photometric.candidates import find_candidates, outside_markers, unambiguous
from skyherd.vision.photometric.first_fit import FirstFit
from skyherd.vision.photometric.fitting.fit import MAX_STEPS_FROM_PREDICTION, USUAL_NOISE
from skyherd.vision.photometric.fitting.fit_result import FitResults, no_fit_results
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.measure import measure_candidates, verify_and_refit
from skyherd.vision.photometric.refine import fit_any_blur, is_promising
from skyherd.vision.photometric.state import CameraState
from skyherd.vision.photometric.tracks import (
    MIN_SHIFT_SIDES,
    apply_similarity,
    common_motion,
    find_quads_near,
    innermost,
    shifts_sides,
)
from skyherd.vision.photometric.verify import verified


@dataclass(frozen=True)
class Followed:
    """Result of following markers into an image.

    Attributes:
        found: the markers, in ascending order of id.
        is_missing: whether a marker that the last image showed is missing. Markers that were about to leave
            the view are not missing, unless the prediction lies so far away that it may be wrong.
        plane: common plane of the markers.
    """

    found: FitResults
    is_missing: bool
    plane: Plane


def follow(image: Image, dictionary: str, state: CameraState, first: FirstFit) -> Followed:
    """Return the followed markers that an image shows.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        state: of the camera.
        first: the prediction and the first fit.
    """
    tracks, here, plane = state.tracks, first.rows, state.plane
    if not here.size:
        return Followed(no_fit_results(dictionary), bool(first.should_be_seen.any()), plane)
    ids, start, missed = tracks.ids[here], first.start, tracks.missed[here]
    if first.is_usual:
        return Followed(first.fits(ids), False, first.plane)
    fits, start, plane = _fit_tracks(image, dictionary, state, ids, first, tracks.sigmas_px[here])
    lost = ~is_promising(fits)
    near = _find_near(image, dictionary, state, start.take(lost), fits.homographies.take(~lost), missed[lost])
    near = near.take(np.isin(near.ids, ids))  # others are for the search, which compares their prints
    rest = ~np.isin(ids, near.ids)
    fits, start = fits.take(rest), start.take(rest)
    if fits.ids.size:
        fits, good, plane, _ = verify_and_refit(
            image, dictionary, fits, plane, start, _start_corners(fits, start)
        )
        fits = fits.take(good & np.isin(fits.ids, ids))
    found = unambiguous(fits.joined(near))
    return Followed(found, bool((first.should_be_seen & ~np.isin(tracks.ids, found.ids)).any()), plane)


def _start_corners(fits: FitResults, start: LocalHomographies) -> Array:
    """Return corners (N, 4, 2), px, by the fits where these stayed near, otherwise as predicted."""
    fitted, predicted = fits.homographies.images(SQUARE_CORNERS), start.images(SQUARE_CORNERS)
    away = np.abs(fitted - predicted).max(axis=1)
    near = np.isfinite(away) & (away < start.sides_px() / 2)
    return to_points(np.where(near[:, None], fitted, predicted))


def _fit_tracks(
    image: Image,
    dictionary: str,
    state: CameraState,
    ids: IntArray,
    first: FirstFit,
    sigmas_px: Array,
) -> tuple[FitResults, LocalHomographies, Plane]:
    """Return fits of followed markers, their places as predicted or by the common motion, and the plane."""
    about, start = (state.plane, state.noise or USUAL_NOISE, MAX_STEPS_FROM_PREDICTION), first.start
    fitted = (first.fits(ids), first.plane) if first.is_fitted else None
    fits, plane = fit_any_blur(image, dictionary, ids, start, sigmas_px, *about, fitted=fitted)
    lost = np.flatnonzero(~is_promising(fits))
    if not lost.size:
        return fits, start, plane
    moved = _moved(image, dictionary, replace(state, plane=plane), start, fits)
    again = shifts_sides(start.take(lost), moved.take(lost)) > MIN_SHIFT_SIDES
    if not again.any():
        return fits, start, plane
    # All are fitted again, since few may have determined the plane.
    there = fits.homographies.put(lost, moved.take(lost))
    fits, plane = fit_any_blur(image, dictionary, ids, there, sigmas_px, *about)
    right = np.flatnonzero(is_promising(fits))
    return fits, start.put(right, there.take(right)), plane


def _moved(
    image: Image, dictionary: str, state: CameraState, start: LocalHomographies, fits: FitResults
) -> LocalHomographies:
    """Return the places of followed markers by the motion of those found, or of some that are searched."""
    seen = fits.take(verified(fits, image_noise(image), code_distance(dictionary)))
    if not seen.ids.size:
        nowhere = no_fit_results(dictionary).homographies
        few = innermost(start, image)
        seen = _find_near(image, dictionary, state, few, nowhere, np.zeros(len(few), dtype=np.int64))
        seen = unambiguous(seen.take(np.isin(seen.ids, fits.ids)))
    if not seen.ids.size:
        return start
    rows = np.searchsorted(fits.ids, seen.ids)
    return apply_similarity(start, common_motion(start.take(rows), seen.homographies))


def _find_near(
    image: Image,
    dictionary: str,
    state: CameraState,
    places: LocalHomographies,
    known: LocalHomographies,
    missed: IntArray,
) -> FitResults:
    """Return accepted markers near places, outside of known ones; the reach grows with images missed (N,)."""
    if not len(places):
        return no_fit_results(dictionary)
    quads_px = find_quads_near(image, places, missed)
    quads_px = quads_px[outside_markers(quads_px, known)]
    candidates = find_candidates(image, dictionary, state, quads_px, beside_markers=len(known) > 0)
    return measure_candidates(image, dictionary, state, quads_px, candidates).found
