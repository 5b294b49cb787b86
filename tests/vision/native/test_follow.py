"""The compiled following of markers against the stages in NumPy, and its checks of arguments."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.helpers import following_reference
from tests.helpers.native_builds import builds

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import rendered_frames
from skyherd.errors import InputError
from skyherd.vision import PhotometricDetector
from skyherd.vision.native.follow_records import TRACK, FollowRequest
from skyherd.vision.native.library import Library, declared
from skyherd.vision.photometric import following, refine, verify
from skyherd.vision.photometric.fitting import fit
from skyherd.vision.photometric.following import fit_predicted
from skyherd.vision.photometric.state import CameraState

TIME_S = 0.1
CELLS = {
    "weak code": ("4X4_50", {}),
    "strong code": ("6X6_250", {}),
    "noise": ("4X4_50", {"noise": 10.0}),
    "no noise": ("4X4_50", {"noise": 0.0}),
    "small": ("4X4_50", {"side_px": 14.0}),
    "tilted": ("4X4_50", {"tilt_deg": 20.0}),
    "ground": ("6X6_250", {"blur_px": 2.0}),
}
"""Scenes of 16 markers of 30 px: dictionary, and factors of a `Cell`."""

_scenes = {}


def scene(name, **factors):
    """Return an image, and the state of a camera that has just seen it."""
    key = name, tuple(factors.items())
    if key not in _scenes:
        dictionary, usual = CELLS[name]
        cell = replace(Cell(cameras=1, frames=1), **usual, **factors)
        (frame,) = rendered_frames(cell, dictionary, 3)
        detector = PhotometricDetector(dictionary)
        for number in range(3):
            detector.detect(frame.image, time_s=TIME_S * (number - 2))
        _scenes[key] = frame.image, dictionary, detector.states[0]
    return _scenes[key]


def disturbed(state: CameraState, seed: int, shift_px: float, lost: int) -> CameraState:
    """Return a state as of a moving camera; some of the tracks were missed, and others are out of view."""
    rng, tracks = np.random.default_rng(seed), state.tracks
    count = tracks.ids.size
    places = tracks.homographies
    turn = np.exp(1j * rng.uniform(-0.02, 0.02, count))
    steps = shift_px * (rng.normal(size=(count, 2)) @ [1, 1j])
    moved = replace(places, centers=places.centers - steps, similarities=places.similarities / turn)
    missed = np.zeros(count, dtype=np.int64)
    missed[rng.permutation(count)[:lost]] = rng.integers(1, 12, min(lost, count))
    away = np.where(rng.random(count) < 0.15 * (lost > 0), -2000.0, 0.0)
    tracks = replace(
        tracks,
        homographies=replace(moved, centers=moved.centers + away),
        velocities=steps / TIME_S,
        similarity_log_rates=np.log(turn) / TIME_S,
        on_arc=rng.random(count) < 0.5,
        missed=missed,
    )
    return replace(state, tracks=tracks)


def assert_alike(first, expected, state, image):
    """Sums of a fit's pixels are the same; prediction and estimates differ by rounding alone."""
    learned, found = first.learned(state), first.detections(image, state, TIME_S, 0)
    for name in ("ids", "qualities", "image_size_px"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected.detections, name))
    for name in ("centers_px", "corners_px", "sides_px"):
        one, two = getattr(found, name), getattr(expected.detections, name)
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.headings_rad, expected.detections.headings_rad, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.covariances, expected.detections.covariances, rtol=1e-5, atol=1e-12)
    for name in ("sigma_px", "noise", "contrast", "print_contrast", "unsearched", "searches"):
        assert getattr(learned, name) == pytest.approx(getattr(expected.state, name), rel=1e-6)
    np.testing.assert_allclose(learned.ratios.sums, expected.state.ratios.sums, rtol=1e-4)
    assert learned.ratios.boxes == expected.state.ratios.boxes
    for name in ("ids", "missed", "times_s"):
        one, two = getattr(learned.tracks, name), getattr(expected.state.tracks, name)
        np.testing.assert_array_equal(one, two)
    for name in ("velocities", "similarity_log_rates", "sigmas_px"):
        one, two = getattr(learned.tracks, name), getattr(expected.state.tracks, name)
        np.testing.assert_allclose(one, two, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", CELLS)
@given(seed=st.integers(0, 2**31), shift_px=st.floats(0, 1.5), lost=st.integers(0, 3))
def test_compiled_following_equals_that_of_numpy(name, seed, shift_px, lost):
    image, dictionary, state = scene(name)
    state = disturbed(state, seed, shift_px, lost)
    first = fit_predicted(image, dictionary, state, TIME_S)
    expected = following_reference.step(image, dictionary, state, TIME_S)
    assert first.is_usual == expected.is_usual
    assert first.is_fitted == (expected.fits is not None)
    start = state.tracks.predicted(TIME_S)
    here = following_reference.in_view(start, image.shape)
    np.testing.assert_array_equal(first.rows, np.flatnonzero(here))
    np.testing.assert_allclose(first.start.centers, start.centers[here], rtol=0, atol=1e-9)
    if expected.fits is not None:
        fits = first.fits(expected.fits.ids)
        np.testing.assert_allclose(fits.homographies.centers, expected.fits.homographies.centers, atol=1e-6)
        np.testing.assert_allclose(fits.cell_means, expected.fits.cell_means, atol=1e-3)
    if expected.is_usual:
        assert_alike(first, expected, state, image)


@pytest.mark.parametrize("name", CELLS)
def test_markers_where_they_are_predicted_are_usual(name):
    """So that the comparison above is of whole steps."""
    image, dictionary, state = scene(name)
    assert fit_predicted(image, dictionary, state, TIME_S).is_usual


def covered(image, state):
    """A leaf lies on a marker."""
    u, v = state.tracks.homographies.centers[3].real, state.tracks.homographies.centers[3].imag
    image[int(v) - 4 : int(v) + 4, int(u) - 14 : int(u) - 8] = 255
    return image, state


def erased(image, state):
    """A marker is gone."""
    u, v = state.tracks.homographies.centers[3].real, state.tracks.homographies.centers[3].imag
    image[int(v) - 25 : int(v) + 25, int(u) - 25 : int(u) + 25] = 200
    return image, state


def refocused(image, state):
    """The lens had another blur in the last image."""
    tracks = replace(state.tracks, sigmas_px=1.1 * state.tracks.sigmas_px)
    return image, replace(state, tracks=tracks)


def lost_beyond_view(image, state):
    """A marker was taken to move out of the image at once, which its robot cannot."""
    velocities = state.tracks.velocities.copy()
    velocities[3] = 1e5
    return image, replace(state, tracks=replace(state.tracks, velocities=velocities))


def paler(image, state):
    """A print has half of the contrast of the others."""
    u, v = state.tracks.homographies.centers[3].real, state.tracks.homographies.centers[3].imag
    there = slice(int(v) - 24, int(v) + 24), slice(int(u) - 24, int(u) + 24)
    image[there] = 120 + 0.5 * image[there]
    return image, state


@pytest.mark.parametrize("change", [covered, erased, refocused, lost_beyond_view, paler])
def test_unusual_image_is_left_to_python(change):
    """NumPy agrees that it is unusual. The fits are there for the next stages."""
    image, dictionary, state = scene("weak code")
    image, state = change(image.copy(), state)
    first = fit_predicted(image, dictionary, state, TIME_S)
    assert not first.is_usual and first.is_fitted
    assert not following_reference.step(image, dictionary, state, TIME_S).is_usual


@pytest.mark.parametrize("motion_px", [1.5, 4.0])
def test_streak_is_left_to_python(motion_px, monkeypatch):
    """Under 1.5 px nothing else is unusual. The negative control: a streak that is not significant."""
    state = scene("strong code")[2]
    image, dictionary, _ = scene("strong code", motion_px=motion_px)
    assert not fit_predicted(image, dictionary, state, TIME_S).is_usual
    monkeypatch.setattr(refine, "SIGNIFICANT", np.inf)
    with fresh_constants():
        assert fit_predicted(image, dictionary, state, TIME_S).is_usual == (motion_px < 4)


def test_bright_pixel_is_left_to_python(monkeypatch):
    """One on a black border leaves each cell right. The negative control: all peaks are allowed."""
    image, dictionary, state = scene("strong code")
    image, corner = image.copy(), state.tracks.homographies.take(np.array([3])).images(np.array([-0.44 + 0j]))
    image[round(corner.imag.item()), round(corner.real.item())] = 255
    assert not fit_predicted(image, dictionary, state, TIME_S).is_usual
    monkeypatch.setattr(fit, "OUTLIER_SHARE", np.inf)
    with fresh_constants():
        assert fit_predicted(image, dictionary, state, TIME_S).is_usual


@contextlib.contextmanager
def fresh_constants():
    """Let the compiled library read changed constants meanwhile."""
    for cached in (following.follow_constants, verify.verification_limits):
        cached.cache_clear()
    yield
    for cached in (following.follow_constants, verify.verification_limits):
        cached.cache_clear()


def test_cells_below_the_smallest_ones_are_left_to_python(monkeypatch):
    """Cells of 2.3 px under limits on either side of that."""
    image, dictionary, state = scene("small")
    for least_px in (2.2, 2.5):
        monkeypatch.setattr(verify, "MIN_CELL_PX", least_px)
        with fresh_constants():
            assert fit_predicted(image, dictionary, state, TIME_S).is_usual == (least_px < 2.3)


def test_large_markers_are_left_to_python():
    image, dictionary, state = scene("weak code")
    places = state.tracks.homographies
    large = replace(places, similarities=6 * places.similarities)
    first = fit_predicted(
        image, dictionary, replace(state, tracks=replace(state.tracks, homographies=large)), TIME_S
    )
    assert not first.is_usual and not first.is_fitted and first.rows.size


@pytest.mark.parametrize("name", ["weak code", "no noise"])
def test_detector_calls_compiled_code_once_in_a_followed_image(name, monkeypatch):
    """The negative control is the same image with a cover: it takes more calls."""
    image, dictionary, state = scene(name)
    calls = []
    for function in ("follow_markers", "fit_markers", "streak_evidence", "second_differences", "quads"):
        real = getattr(Library, function)

        def counted(*given, real=real, function=function):
            calls.append(function)
            return real(*given)

        monkeypatch.setattr(Library, function, counted)
    detector = PhotometricDetector(dictionary)
    detector.states[0] = replace(state, unsearched=0)
    found = detector.detect(image, time_s=TIME_S)
    assert calls == ["follow_markers"] and len(found) == state.tracks.ids.size
    detector.states[0] = replace(state, unsearched=0)
    detector.detect(covered(image.copy(), state)[0], time_s=TIME_S)
    assert len(calls) > 2


def request_of(monkeypatch, name="weak code") -> FollowRequest:
    """Return the request that following makes of a scene."""
    made = []
    real = Library.follow_markers
    monkeypatch.setattr(Library, "follow_markers", lambda own, given: made.append(given) or real(own, given))
    fit_predicted(*scene(name), TIME_S)
    monkeypatch.undo()
    return made[0]


@pytest.mark.parametrize("name", ["weak code", "strong code", "tilted"])
def test_builds_follow_markers_with_equal_bytes(monkeypatch, name):
    request, results = request_of(monkeypatch, name), set()
    for one in builds("vision", declared).values():
        end, found = one.follow_markers(request)
        arrays = found.fits, found.cell_means, found.plane, found.tracks, found.detections
        results.add((end, b"".join(array.tobytes() for array in arrays), bytes(found.estimates)))
    assert len(results) == 1


@pytest.mark.parametrize(
    "change",
    [
        lambda given: {"tracks": given.tracks[:0], "cells": given.cells[:0]},
        lambda given: {"tracks": given.tracks[:-1]},
        lambda given: {"tracks": given.tracks.astype(np.dtype(TRACK, align=True))[::-1]},
        lambda given: {"cells": given.cells.astype(float)},
        lambda given: {"cells": np.zeros((given.tracks.size, 23, 23), np.float32)},
        lambda given: {"image": given.image[:, ::2]},
        lambda given: {"image": given.image.astype(float)},
        lambda given: {"plane": np.zeros(2, given.plane.dtype)},
        lambda given: {"max_steps": 0},
    ],
)
def test_invalid_arguments_are_rejected(monkeypatch, change):
    request = request_of(monkeypatch)
    with pytest.raises(InputError):
        following.library().follow_markers(replace(request, **change(request)))
