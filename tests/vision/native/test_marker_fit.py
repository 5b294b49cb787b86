"""The compiled fit of markers against the one in NumPy, step by step, and its checks of arguments."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.helpers import fit_reference, visible_reference
from tests.helpers.native_builds import builds

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import rendered_frames
from skyherd.errors import InputError
from skyherd.geometry import SQUARE_CORNERS, to_points
from skyherd.vision.native.library import declared, library
from skyherd.vision.native.records import APPEARANCE, HOMOGRAPHY, UNKNOWNS, VisibleRequest
from skyherd.vision.photometric.fitting import common_unknowns
from skyherd.vision.photometric.fitting.appearance import appearances_of
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.design_matrix import CONTRAST, POSE
from skyherd.vision.photometric.fitting.fit import fit_markers, fit_request
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.occlusion import fit_visible, visible_constants
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.fitting.streak_evidence import streak_evidence
from skyherd.vision.photometric.fitting.surroundings import Surroundings
from skyherd.vision.photometric.remeasure import MAX_STEPS as OUTLINE_STEPS

DICTIONARY = "4X4_50"
SCENES = {
    "level": {},
    "tilted": {"tilt_deg": 20.0},
    "steep": {"tilt_deg": 55.0},
    "blurred": {"blur_px": 2.0},
    "small": {"side_px": 12.0},
    "gamma": {"gamma": 1.8},
    "light": {"light": 0.5},
    "streak": {"motion_px": 4.0},
}
"""What is unusual about a scene of 16 markers of 30 px: factors of a `Cell`."""

STARTS = {"near": 0.3, "far": 2.0, "beyond": 8.0}
"""Standard deviations, px, of where fits begin; markers of the last one mostly end elsewhere."""


def frame_of(scene):
    factors = {name: value for name, value in SCENES[scene].items() if name in Cell.__dataclass_fields__}
    (frame,) = rendered_frames(replace(Cell(cameras=1, frames=1), **factors), DICTIONARY, 3)
    image = frame.image
    if scene == "gamma":
        image = np.rint(255 * (image / 255) ** (1 / SCENES[scene]["gamma"])).astype(np.uint8)
    if scene == "light":
        across = 1 + SCENES[scene]["light"] * np.sin(np.arange(image.shape[1]) / 15)
        image = np.rint(np.clip(0.6 * image * across, 0, 255)).astype(np.uint8)
    return replace(frame, image=image)


def start_of(frame, start, seed):
    """Return homographies about the true ones; every fifth marker is sheared, as on a plane of its own."""
    rng = np.random.default_rng(seed)
    turned = np.exp(1j * frame.headings_rad)[:, None] * 1j * SQUARE_CORNERS
    corners = to_points(frame.centers_px @ np.array([1, 1j])[:, None] + 30.0 * turned)
    return LocalHomographies.of_corners(corners + rng.normal(0, STARTS[start], (len(corners), 1, 2)))


def assert_alike(found, expected):
    """Sums of 1000 pixels in another order differ by 1e-13 of themselves, and steps repeat that at most."""
    for name in ("centers", "similarities", "anisotropies", "perspectives"):
        one, two = (getattr(fits.homographies, name) for fits in (found, expected))
        np.testing.assert_allclose(one, two, rtol=1e-7, atol=1e-9)
    for name in ("blacks", "contrasts", "noise_stds", "log_blurs", "sigmas_px", "peaks", "moved_px"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-6)
    for name in ("pixels", "boxes", "blurs_cells", "ids", "qualities"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    np.testing.assert_allclose(found.cell_means, expected.cell_means, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found.covariances, expected.covariances, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.variance_ratios, expected.variance_ratios, rtol=1e-4)
    np.testing.assert_allclose(found.besides, expected.besides, rtol=0, atol=1e-4)
    for name in ("levels", "textures"):
        one, two = (getattr(fits.surroundings, name) for fits in (found, expected))
        np.testing.assert_allclose(one, two, rtol=1e-4, atol=1e-3)


def assert_same_plane(found, expected):
    assert found.shared == expected.shared
    assert found.anisotropy == pytest.approx(expected.anisotropy, abs=1e-9)
    assert found.perspective == pytest.approx(expected.perspective, abs=1e-12)


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("how", ["together", "alone", "streak", "known plane"])
def test_compiled_fit_equals_that_of_numpy(scene, start, how):
    frame = frame_of(scene)
    given = frame.image, DICTIONARY, frame.ids, start_of(frame, start, 5), 0.7
    plane = Plane(0.05 + 0.02j, 1e-4 - 5e-5j) if how == "known plane" else Plane()
    options = {"alone": how == "alone", "streak_px2": 0.4 - 0.3j if how == "streak" else None}
    found, found_plane = fit_markers(*given, plane, 5.0, **options)
    expected, expected_plane = fit_reference.fit_markers(*given, plane, 5.0, **options)
    assert_alike(found, expected)
    assert_same_plane(found_plane, expected_plane)


def on_plates(frame, level):
    """Return the image with ground of a grey level from the markers' borders on, and some texture."""
    turned = np.exp(1j * frame.headings_rad)[:, None] * 1j * SQUARE_CORNERS
    corners = to_points(frame.centers_px @ np.array([1, 1j])[:, None] + 30.0 * turned)
    shares = np.zeros(frame.image.shape, dtype=np.uint8)
    cv2.fillPoly(shares, np.rint(16 * corners).astype(np.int32), 255, cv2.LINE_AA, 4)
    texture = np.random.default_rng(2).normal(level, 8.0, shares.shape)
    image = frame.image * (shares / 255) + texture * (1 - shares / 255)
    return np.rint(image.clip(0, 255)).astype(np.uint8)


@pytest.mark.parametrize("start", ["near", "far"])
@pytest.mark.parametrize("scene", ["level", "tilted", "steep"])
@pytest.mark.parametrize("how", ["together", "alone", "streak"])
def test_fit_without_cards_equals_that_of_numpy(scene, start, how):
    frame = frame_of(scene)
    levels = np.where(np.arange(frame.ids.size) % 3, -0.4, np.nan)
    given = on_plates(frame, 150.0), DICTIONARY, frame.ids, start_of(frame, start, 5), 0.7, Plane(), 5.0
    options = {"alone": how == "alone", "streak_px2": 0.4 - 0.3j if how == "streak" else None}
    options["surroundings"] = Surroundings.of_ground(levels)
    found, found_plane = fit_markers(*given, **options)
    expected, expected_plane = fit_reference.fit_markers(*given, **options)
    assert_alike(found, expected)
    assert_same_plane(found_plane, expected_plane)
    assert (found.surroundings.is_bare() == ~np.isnan(levels)).all()


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("settled_px", [1e-3, 1e9])
def test_free_fit_equals_that_of_numpy(scene, start, settled_px):
    """The second limit ends the fit after one step, so that the limit's place is compared, too."""
    frame = frame_of(scene)
    places = start_of(frame, start, 5)
    given = frame.image, places, appearances_of(DICTIONARY, frame.ids, places.blurs(0.7), OWN_PLANES, 5.0)
    fits, covariances = library().fit_freely(fit_request(*given, 5.0, OUTLINE_STEPS), settled_px)
    expected, solution, peaks, ratios, boxes = fit_reference.fit_freely(*given, OUTLINE_STEPS, settled_px)
    for name in HOMOGRAPHY.names:
        found = fits["homography"][name]
        np.testing.assert_allclose(found, getattr(expected, name), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(fits["peaks"], peaks, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(fits["noise_stds"], solution.noise_stds(), rtol=1e-6)
    np.testing.assert_allclose(fits["contrasts"], solution.values[:, CONTRAST], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(fits["variance_ratios"], ratios, rtol=1e-4)
    np.testing.assert_array_equal(fits["boxes"], boxes)
    scale = (solution.noise_stds() / solution.contrasts()) ** 2
    by_pose = scale[:, None, None] * solution.inverse_normals[:, POSE][:, :, POSE]
    deviations = np.sqrt(np.diagonal(by_pose, axis1=1, axis2=2))
    off = np.abs(covariances - by_pose) / (deviations[:, :, None] * deviations[:, None])
    assert off.max() < 1e-4


def test_scenes_reach_each_hypothesis(monkeypatch):
    """The tone curve, light and plane are free where the scene has them, so that these are compared."""

    def fitted(scene):
        frame = frame_of(scene)
        return fit_markers(frame.image, DICTIONARY, frame.ids, start_of(frame, "near", 5), 0.7, Plane(), 5.0)

    assert fitted("level")[1] == Plane()
    assert fitted("tilted")[1].shared and fitted("tilted")[1].perspective
    for scene in ("gamma", "light"):
        free = fitted(scene)[0].noise_stds
        with monkeypatch.context() as patched:
            patched.setattr(common_unknowns, "FREE_SIGMAS", np.inf)
            held = fitted(scene)[0].noise_stds
        assert np.median(held / free) > 1.1


@pytest.mark.parametrize("scene", ["level", "streak", "steep"])
@pytest.mark.parametrize("streak_px2", [0j, 0.5 + 0.2j])
def test_streak_evidence_equals_that_of_numpy(scene, streak_px2):
    """Products of single-precision columns differ by 1e-6 of the largest."""
    frame = frame_of(scene)
    given = frame.image, DICTIONARY, frame.ids, start_of(frame, "near", 5), 0.8, Plane(), 5.0
    fits, plane = fit_markers(*given, streak_px2=streak_px2 or None)
    about = frame.image, DICTIONARY, fits, plane, 5.0, streak_px2
    found, expected = streak_evidence(*about), fit_reference.streak_evidence(*about)
    for name in ("informations", "scores"):
        one, two = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-5 * np.abs(two).max())


def request_of(**changes):
    frame = frame_of("tilted")
    start = start_of(frame, "near", 5)
    around = Surroundings.of_ground(np.where(np.arange(frame.ids.size) % 4, np.nan, -0.3))
    appearances = appearances_of(DICTIONARY, frame.ids, start.blurs(0.7), Plane(), 5.0, None, around)
    return replace(fit_request(frame.image, start, appearances, 5.0), **changes)


def test_builds_fit_markers_with_equal_bytes():
    results = set()
    for one in builds("vision", declared).values():
        plane = Plane().record()
        fits, means = one.fit_markers(request_of(), plane)
        evidence = one.streak_evidence(request_of(streak_px2=0.3j))
        free = one.fit_freely(request_of(), 1e-3)
        results.add(b"".join(array.tobytes() for array in (fits, means, plane, *evidence, *free)))
    assert len(results) == 1


INVALID = {
    "no marker": {"start": np.zeros(0, HOMOGRAPHY), "appearances": np.zeros(0, APPEARANCE)},
    "homographies of another type": {"start": np.zeros((16, 4), complex)},
    "fewer appearances": {"appearances": np.zeros(3, APPEARANCE)},
    "cells of fewer markers": {"cells": np.zeros((3, 8, 8), np.float32)},
    "cells that are not square": {"cells": np.zeros((16, 8, 9), np.float32)},
    "too many cells": {"cells": np.zeros((16, 23, 23), np.float32)},
    "a colour image": {"image": np.zeros((50, 50, 3), np.uint8)},
    "a strided image": {"image": np.zeros((50, 100), np.uint8)[:, ::2]},
    "no steps": {"max_steps": 0},
}


@pytest.mark.parametrize("changes", INVALID.values(), ids=INVALID)
def test_invalid_requests_are_rejected(changes):
    with pytest.raises(InputError):
        library().fit_markers(request_of(**changes), Plane().record())
    with pytest.raises(InputError):
        library().streak_evidence(request_of(streak_px2=0.3j, **changes))
    with pytest.raises(InputError):
        library().fit_freely(request_of(**changes), 1e-3)


def test_other_invalid_arguments_are_rejected():
    with pytest.raises(InputError):
        library().fit_markers(request_of(), np.zeros(2))
    with pytest.raises(InputError, match="size"):
        library().streak_evidence(request_of())  # without a streak
    for settled_px in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="size"):
            library().fit_freely(request_of(), settled_px)


def visible_scene(scene, cover):
    """Return a frame, some markers of which a grey disc, a dark stroke or nothing covers in part."""
    frame = frame_of(scene)
    image = frame.image.copy()
    for k, (u, v) in enumerate(np.rint(frame.centers_px).astype(int).tolist()):
        if cover == "disc" and k % 3 == 0:
            cv2.circle(image, (u + 11, v + 3), 5, 90, cv2.FILLED)
        elif cover == "stroke" and k % 2 == 0:
            cv2.line(image, (u - 20, v - 9), (u + 20, v + 12), 20, 2)
    return replace(frame, image=image)


@pytest.mark.parametrize("cover", ["nothing", "disc", "stroke"])
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("how", ["on the plane", "alone", "settled"])
def test_fit_to_visible_pixels_equals_numpy(how, scene, cover):
    frame = visible_scene(scene, cover)
    start, noise = start_of(frame, "near", 4), 3.0
    given = frame.image, DICTIONARY, frame.ids
    plain, plane = fit_markers(*given, start, 0.9, Plane(), noise)
    plane, settled = plane if how == "on the plane" else OWN_PLANES, how == "settled"
    given = frame.image, DICTIONARY, plain, 0.9, plane, noise
    found, found_plane = fit_visible(*given, settled=settled)
    expected, expected_plane = visible_reference.fit_visible(*given, settled=settled)
    assert_same_plane(found_plane, expected_plane)
    assert found_plane == plane or settled
    np.testing.assert_array_equal(found.pixels, expected.pixels)
    determined = found.pixels > UNKNOWNS  # fewer pixels determine nothing
    assert_alike(found.take(determined), expected.take(determined))
    assert cover == "nothing" or (found.pixels < 0.99 * plain.pixels).sum() >= 4


def test_builds_fit_visible_pixels_alike():
    frame = visible_scene("tilted", "disc")
    plain, plane = fit_markers(
        frame.image, DICTIONARY, frame.ids, start_of(frame, "near", 5), 0.9, Plane(), 3.0
    )
    looks = appearances_of(DICTIONARY, frame.ids, plain.homographies.blurs(0.9), plane, 3.0)
    request = VisibleRequest(
        markers=fit_request(frame.image, plain.homographies, looks, 3.0),
        constants=visible_constants(),
        blacks=plain.blacks.copy(),
        contrasts=plain.contrasts.copy(),
        sigmas_px=np.full(frame.ids.size, 0.9),
        border=1,
    )
    results = [one.fit_visible(request, plane.record()) for one in builds("vision", declared).values()]
    assert len({fits.tobytes() + means.tobytes() for fits, means in results}) == 1
    with pytest.raises(InputError, match="contrasts"):
        library().fit_visible(replace(request, contrasts=plain.contrasts[:3]), plane.record())
    with pytest.raises(InputError):
        library().fit_visible(replace(request, border=-1), plane.record())
