"""Markers followed from one image of a camera to the next: fitted where they are predicted.

In most images of a video all markers in view are found where their own last steps lead: each fit is verified,
under the blur that was assumed, wholly visible and without a streak. One compiled call then also learns the
next state of the camera and writes the detections (`fit_predicted`, `vision/native/follow.h`).

In other images `follow` goes on from these fits: where the common motion of the others takes a marker, and at
last by a search near these places (`skyherd.vision.photometric.tracks`).
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import nan

import numpy as np

from skyherd.geometry import MEDIAN_PER_SIGMA, SQUARE_CORNERS, Array, BoolArray, IntArray, to_points
from skyherd.markers.dictionary import code_distance
from skyherd.messages import Detections, Quality
from skyherd.vision.grey import Image
from skyherd.vision.native.follow_records import Estimates, FollowConstants, FollowRequest, FollowResults
from skyherd.vision.native.library import library
from skyherd.vision.photometric import refine, tracks, verify
from skyherd.vision.photometric.candidates import find_candidates, outside_markers, unambiguous
from skyherd.vision.photometric.cards import refit_without_cards
from skyherd.vision.photometric.fitting import appearance, correlated_noise, fit, streak_evidence
from skyherd.vision.photometric.fitting.correlated_noise import PooledRatios
from skyherd.vision.photometric.fitting.fit import MAX_STEPS_FROM_PREDICTION, USUAL_NOISE
from skyherd.vision.photometric.fitting.fit_result import FitResults, no_fit_results
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.fitting.surroundings import Surroundings
from skyherd.vision.photometric.image_noise import (
    MIN_UNSATURATED_PIXELS,
    ROUNDING_NOISE,
    SATURATION_MARGIN,
    image_noise,
)
from skyherd.vision.photometric.measure import measure_candidates, verify_and_refit
from skyherd.vision.photometric.refine import fit_any_blur, is_promising
from skyherd.vision.photometric.state import LEARNING_RATE, CameraState
from skyherd.vision.photometric.tracks import (
    MIN_SHIFT_SIDES,
    Tracks,
    apply_similarity,
    common_motion,
    find_quads_near,
    innermost,
    shifts_sides,
)
from skyherd.vision.photometric.verify import verified

USUAL, NOT_FITTED = 0, 1
"""Results of the compiled call, as in `follow.h`."""


@dataclass(frozen=True)
class FirstFit:
    """Prediction and fit of the markers that a camera follows, of which M are in view.

    Attributes:
        is_usual: whether all are as usual; what is learned, and the detections, are valid then.
        is_fitted: whether the markers in view were fitted.
        results: of the compiled call; None if no marker is followed.
    """

    is_usual: bool
    is_fitted: bool
    results: FollowResults | None

    @property
    def rows(self) -> IntArray:
        """Indices (M,) of the tracks in view."""
        return np.zeros(0, dtype=np.int64) if self.results is None else self.results.rows

    @property
    def should_be_seen(self) -> BoolArray:
        """Mask (N,) of the tracks that the image should show."""
        return np.zeros(0, dtype=bool) if self.results is None else self.results.should_be_seen != 0

    @property
    def start(self) -> LocalHomographies:
        """Predicted homographies of the markers in view."""
        return LocalHomographies.of_records(self._known.starts)

    @property
    def plane(self) -> Plane:
        """Common plane of the markers after the fit."""
        return Plane.of_record(self._known.plane)

    def fits(self, ids: IntArray) -> FitResults:
        """Return the fits of the markers in view, `ids` (M,)."""
        known = self._known
        return FitResults.of_records(ids, known.fits, known.cell_means, known.blurs)

    def learned(self, before: CameraState) -> CameraState:
        """Return the state of the camera after an image in which all is as usual."""
        known = self._known
        found = known.estimates
        return replace(
            before,
            sigma_px=found.sigma_px,
            noise=found.noise,
            contrast=found.contrast,
            print_contrast=found.print_contrast,
            plane=self.plane,
            tracks=Tracks.of_records(known.tracks),
            unsearched=before.unsearched + 1,
            ratios=PooledRatios(np.array(found.ratio_sums), found.ratio_boxes),
        )

    def detections(self, image: Image, before: CameraState, time_s: float, unit_id: int) -> Detections:
        """Return the detections of an image in which all is as usual; `before` is the state before it."""
        known = self._known
        return Detections(
            unit_id=unit_id,
            time_s=time_s,
            image_size_px=np.array([image.shape[1], image.shape[0]]),
            ids=before.tracks.ids[known.rows],
            qualities=np.full(known.rows.size, Quality.PHOTOMETRIC.value),
            **{name: known.detections[name] for name in known.detections.dtype.names or ()},
        )

    @property
    def _known(self) -> FollowResults:
        assert self.results is not None, "a marker is followed"
        return self.results


def fit_predicted(image: Image, dictionary: str, state: CameraState, time_s: float) -> FirstFit:
    """Fit the followed markers where they are predicted.

    Args:
        image: grey, (height, width), contiguous.
        dictionary: of the markers.
        state: of the camera.
        time_s: when the image was taken.
    """
    if not state.tracks.ids.size:
        return FirstFit(is_usual=False, is_fitted=False, results=None)
    request = FollowRequest(
        image=image,
        tracks=state.tracks.records,
        cells=appearance.black_cells(dictionary, state.tracks.ids),
        plane=state.plane.record(),
        estimates=_estimates(state),
        fit_constants=fit.fit_constants(),
        constants=follow_constants(dictionary),
        time_s=time_s,
        noise=state.noise or USUAL_NOISE,
        max_steps=MAX_STEPS_FROM_PREDICTION,
    )
    end, results = library().follow_markers(request)
    return FirstFit(is_usual=end == USUAL, is_fitted=end != NOT_FITTED, results=results)


def _estimates(state: CameraState) -> Estimates:
    """Return the estimates of a camera for the compiled library."""
    known = (state.sigma_px, state.noise, state.contrast, state.print_contrast)
    levels = (nan if value is None else value for value in known)
    return Estimates(*levels, tuple(state.ratios.sums.tolist()), state.ratios.boxes)


@lru_cache(maxsize=8)
def follow_constants(dictionary: str) -> FollowConstants:
    """Return the constants of following markers of a dictionary for the compiled library."""
    return FollowConstants(
        reach_sides=tracks.REACH_SIDES,
        max_log_growth=tracks.MAX_LOG_GROWTH,
        max_side_px=refine.MAX_SIDE_PX,
        max_log_blur_difference=refine.MAX_LOG_BLUR_DIFFERENCE,
        streak_pixels=refine.STREAK_PIXELS,
        significant=refine.SIGNIFICANT,
        min_streak_px2=refine.MIN_STREAK_PX2,
        streak_ridge=streak_evidence.RIDGE,
        outlier_share=fit.OUTLIER_SHARE,
        outlier_sigmas=fit.OUTLIER_SIGMAS,
        rounding_noise=ROUNDING_NOISE,
        median_difference=MEDIAN_PER_SIGMA * 6**0.5,
        learning_rate=LEARNING_RATE,
        forgotten=correlated_noise.FORGOTTEN,
        significant_ratio_error=correlated_noise.SIGNIFICANT_SIGMAS * correlated_noise.RATIO_ERROR,
        min_ratio=correlated_noise.MIN_RATIO,
        max_ratio=correlated_noise.MAX_RATIO,
        looks=appearance.appearance_constants(dictionary),
        blur=refine.blur_constants(),
        verification=verify.verification_limits(code_distance(dictionary)),
        max_missed=tracks.MAX_MISSED,
        streak_markers=refine.STREAK_MARKERS,
        saturation_margin=SATURATION_MARGIN,
        min_unsaturated_pixels=MIN_UNSATURATED_PIXELS,
    )


@dataclass(frozen=True)
class Followed:
    """Result of following markers into an image.

    Attributes:
        found: the markers, in ascending order of id.
        plane: common plane of the markers.
        is_missing: whether a marker that the last image showed is missing. Markers that were about to leave
            the view are not missing, unless the prediction lies so far away that it may be wrong.
    """

    found: FitResults
    plane: Plane
    is_missing: bool


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
        return Followed(no_fit_results(dictionary), plane, bool(first.should_be_seen.any()))
    ids, start, missed = tracks.ids[here], first.start, tracks.missed[here]
    if first.is_usual:
        fits = first.fits(ids)
        all_good = np.ones(fits.ids.size, dtype=bool)
        return Followed(
            *refit_without_cards(image, dictionary, fits, all_good, first.plane), is_missing=False
        )
    known = tracks.take(here)
    fits, start, plane = _fit_tracks(
        image, dictionary, state, ids, first, known.sigmas_px, known.surroundings
    )
    lost = ~is_promising(fits)
    near = _find_near(image, dictionary, state, start.take(lost), fits.homographies.take(~lost), missed[lost])
    near = near.take(np.isin(near.ids, ids))  # others are for the search, which compares their prints
    rest = ~np.isin(ids, near.ids)
    fits, start = fits.take(rest), start.take(rest)
    if fits.ids.size:
        corners_px, sides_px = _start_corners(fits, start), start.sides_px()  # each was seen before
        fits, good, plane, _ = verify_and_refit(
            image, dictionary, fits, plane, start, corners_px, known_sides_px=sides_px
        )
        fits = fits.take(good & np.isin(fits.ids, ids))
    found = unambiguous(fits.joined(near))
    return Followed(found, plane, bool((first.should_be_seen & ~np.isin(tracks.ids, found.ids)).any()))


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
    surroundings: Surroundings,
) -> tuple[FitResults, LocalHomographies, Plane]:
    """Return fits of followed markers, their places as predicted or by the common motion, and the plane."""
    about, start = (state.plane, state.noise or USUAL_NOISE, MAX_STEPS_FROM_PREDICTION), first.start
    fitted = (first.fits(ids), first.plane) if first.is_fitted else None
    fit = partial(fit_any_blur, image, dictionary, ids, surroundings=surroundings)
    fits, plane = fit(start, sigmas_px, *about, fitted=fitted)
    lost = np.flatnonzero(~is_promising(fits))
    if not lost.size:
        return fits, start, plane
    moved = _moved(image, dictionary, replace(state, plane=plane), start, fits)
    again = shifts_sides(start.take(lost), moved.take(lost)) > MIN_SHIFT_SIDES
    if not again.any():
        return fits, start, plane
    # All are fitted again, since few may have determined the plane.
    there = fits.homographies.put(lost, moved.take(lost))
    fits, plane = fit(there, sigmas_px, *about)
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
    sides_px = places.sides_px()
    return measure_candidates(image, dictionary, state, quads_px, candidates, known_sides_px=sides_px).found
