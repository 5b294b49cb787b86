"""Followed markers by NumPy, stage by stage: the reference of the compiled following."""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, to_points
from skyherd.markers.dictionary import code_distance
from skyherd.messages import Detections
from skyherd.vision.grey import Image
from skyherd.vision.photometric import refine
from skyherd.vision.photometric.fitting.fit import MAX_STEPS_FROM_PREDICTION, USUAL_NOISE, fit_markers
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.streak_evidence import streak_evidence
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.state import CameraState
from skyherd.vision.photometric.tracks import REACH_SIDES, shifts_sides
from skyherd.vision.photometric.verify import may_be_occluded, verified


@dataclass(frozen=True)
class Step:
    """One image of a camera; the last two are of images in which all is as usual.

    Attributes:
        is_usual: whether all markers in view are found as usual.
        fits: first fits of the markers in view; None if they are not fitted.
        state: after the image.
        detections: of the image.
    """

    is_usual: bool
    fits: FitResults | None
    state: CameraState
    detections: Detections | None


def in_view(homographies: LocalHomographies, image_shape: tuple[int, ...]) -> BoolArray:
    """Return which markers (N,) have their centres inside an image (height, width)."""
    height, width = image_shape
    from_middle = homographies.centers - complex(width - 1, height - 1) / 2
    return np.asarray((np.abs(from_middle.real) < width / 2) & (np.abs(from_middle.imag) < height / 2))


def is_whole(homographies: LocalHomographies, image_shape: tuple[int, ...]) -> BoolArray:
    """Return which markers (N,) have all of their corners inside an image (height, width)."""
    height, width = image_shape
    corners = homographies.images(SQUARE_CORNERS)
    inside = (np.abs(corners.real - (width - 1) / 2) < width / 2) & (
        np.abs(corners.imag - (height - 1) / 2) < height / 2
    )
    return np.asarray(inside.all(axis=1))


def step(image: Image, dictionary: str, state: CameraState, time_s: float, unit_id: int = 0) -> Step:
    """Follow the markers of a state into an image."""
    tracks = state.tracks
    start = tracks.predicted(time_s)
    here = in_view(start, image.shape)
    should = is_whole(start, image.shape) | (shifts_sides(tracks.homographies, start) > REACH_SIDES)
    missing = bool((should & (tracks.missed == 0) & ~here).any())
    start, sigmas_px = start.take(here), tracks.sigmas_px[here]
    if not here.any() or (start.sides_px() > refine.MAX_SIDE_PX).any():
        return Step(False, None, state, None)
    noise, ids = state.noise or USUAL_NOISE, tracks.ids[here]
    given = image, dictionary, ids, start, sigmas_px, state.plane, noise, MAX_STEPS_FROM_PREDICTION
    fits, plane = fit_markers(*given)
    if missing or not _are_usual(image, dictionary, fits, sigmas_px):
        return Step(False, fits, state, None)
    state = replace(state, unsearched=state.unsearched + 1).learned(fits, plane, time_s)
    stds = np.sqrt(state.ratios.factors())[[0, 0, 1]]
    homographies = fits.homographies
    detections = Detections(
        unit_id=unit_id,
        time_s=time_s,
        image_size_px=np.array(image.shape[::-1]),
        ids=ids,
        centers_px=to_points(homographies.centers),
        headings_rad=homographies.headings_rad(),
        sides_px=homographies.sides_px(),
        corners_px=to_points(homographies.images(SQUARE_CORNERS)),
        covariances=fits.covariances * np.outer(stds, stds),
        qualities=fits.qualities,
    )
    return Step(True, fits, state, detections)


def _are_usual(image: Image, dictionary: str, fits: FitResults, sigmas_px: Array) -> bool:
    """Return whether all fits have settled, are verified, and show neither a cover nor a streak."""
    found_px = refine._within_limits(fits)
    if not refine.is_promising(fits).all():
        return False
    if (np.abs(np.log(found_px / sigmas_px)) > refine.BLUR_SETTLED).any():
        return False
    noise = image_noise(image)
    left = weighted_median(fits.noise_stds, fits.pixels)
    if (
        not verified(fits, noise, code_distance(dictionary)).all()
        or may_be_occluded(fits, max(noise, left)).any()
    ):
        return False
    telling = np.flatnonzero(fits.homographies.sides_px() <= refine.MAX_SIDE_PX)
    if not telling.size:
        return True
    few = fits.take(refine._few(fits, telling))
    evidence = streak_evidence(image, dictionary, few, refine.Plane(), left, 0j)
    is_long = abs(evidence.change_px2()) >= refine.MIN_STREAK_PX2
    return not (evidence.significance() >= refine.SIGNIFICANT and is_long)
