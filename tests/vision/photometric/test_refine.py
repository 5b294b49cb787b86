"""Fits at a resolution that suits each marker, and the plane that later searches of an image know."""

from functools import reduce

import numpy as np
import pytest

from skyherd.vision import PhotometricDetector
from skyherd.vision.photometric import detector as detector_module
from skyherd.vision.photometric.fitting.fit import fit_markers
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.refine import (
    BLUR_ROUNDS,
    BLUR_SETTLED,
    STEPS_PER_ROUND,
    ScaledImage,
    fit_any_blur,
    is_promising,
    size_octaves,
)

SIDES_PX, MAX_SIDE_PX = np.array([30.0, 41.0, 79.0, 165.0]), 80.0
"""Sides of markers, of which the third grows beyond the limit and the last is fitted in shrunk images."""


@pytest.fixture
def blurred(place_markers, draw_markers):
    """Return an image of markers 0 to 3 on an even ground, and places near them."""
    centers = np.array([60 + 60j, 160 + 60j, 110 + 180j, 320 + 150j])
    headings = np.linspace(0, 2, 4)
    how = {"noise": 2.0, "psf_px": 2.0, "texture": 0.0}
    image = draw_markers(
        place_markers(centers, headings, SIDES_PX), range(4), (460, 300), np.random.default_rng(2), **how
    )
    similarities = 1j * SIDES_PX * np.exp(1j * headings)
    start = LocalHomographies(centers + 0.6 - 0.4j, 1.02 * similarities, 0 * centers, 0 * centers)
    return image, start


def refitted(image, ids, start, sigmas_px, plane):
    """Fit markers once, and again about the blurs that they found, by one call for each image and round."""

    def fit(rows, places, max_steps, around):
        octaves, parts, order, planes = size_octaves(places, MAX_SIDE_PX), [], [], []
        for octave in np.unique(octaves):
            here, scaled = np.flatnonzero(octaves == octave), ScaledImage(image, 2 ** int(octave))
            own, there = fit_markers(
                scaled.image,
                "4X4_50",
                ids[rows[here]],
                scaled.homographies(places.take(here)),
                scaled.sigmas_px(sigmas_px[rows[here]]),
                scaled.plane(plane),
                scaled.noise(2.0),
                max_steps,
                surroundings=None if around is None else around.take(here),
            )
            parts.append(scaled.full_size(own))
            order.append(here)
            planes.append(scaled.full_size_plane(there))
        return reduce(FitResults.joined, parts).take(np.argsort(np.concatenate(order))), planes[0]

    sigmas_px, rounds = np.full(ids.size, sigmas_px), []
    fits, plane = fit(np.arange(ids.size), start, 6, None)
    for _ in range(BLUR_ROUNDS):
        far = np.abs(np.log(fits.sigmas_px / sigmas_px)) > BLUR_SETTLED
        rows = np.flatnonzero(is_promising(fits) & far)
        if not rows.size:
            break
        sigmas_px[rows] = fits.sigmas_px[rows]
        again, _ = fit(rows, fits.homographies.take(rows), STEPS_PER_ROUND, fits.surroundings.take(rows))
        rounds.append(rows.size)
        fits = fits.put(rows, again)
    return fits, plane, rounds


def test_any_blur_equals_repeated_fits_at_all_sizes(blurred):
    """The compiled rounds are fits one by one, each at the size that the last one found."""
    image, start = blurred
    ids = np.array([0, 1, 2, 7])  # the last one is not shown
    fits, plane, rounds = refitted(image, ids, start, 0.6, Plane())
    assert len(rounds) > 2
    assert rounds[-1] < rounds[0] < ids.size
    found, found_plane = fit_any_blur(image, "4X4_50", ids, start, 0.6, Plane(), 2.0, max_side_px=MAX_SIDE_PX)
    assert found_plane.shared == plane.shared
    for name in ("sigmas_px", "blurs_cells", "cell_means", "covariances", "pixels", "moved_px", "besides"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(fits, name), rtol=1e-6, atol=1e-6, err_msg=name
        )
    np.testing.assert_allclose(found.corners_px, fits.corners_px, atol=1e-6)
    again, _ = fit_any_blur(
        image,
        "4X4_50",
        ids,
        start,
        fits.sigmas_px,
        plane,
        2.0,
        max_side_px=MAX_SIDE_PX,
        fitted=(found, plane),
    )
    np.testing.assert_array_equal(again.corners_px, found.corners_px)


def test_plane_goes_to_a_shrunk_image_and_back():
    """Perspectives are per pixel, thus twice as large in an image of half the size."""
    scaled, plane = ScaledImage(np.zeros((40, 60), dtype=np.uint8), 2), Plane(0.1j, 2e-4 - 1e-4j)
    there = scaled.plane(plane)
    assert (there.anisotropy, there.perspective) == (plane.anisotropy, 2 * plane.perspective)
    assert scaled.full_size_plane(there) == plane


@pytest.mark.parametrize("count", [3, 4])
def test_fallback_search_knows_the_plane_of_four_markers(place_markers, draw_markers, monkeypatch, count):
    """Four markers of the first search show it, and three do not. Their sides are known in either case."""
    known, sides = [], []

    def measured(*given):
        known.append(given[5])
        sides.append(given[6].size)
        return measure(*given)

    measure = detector_module.measure_candidates
    monkeypatch.setattr(detector_module, "measure_candidates", measured)
    centers = np.array([60 + 60j, 160 + 60j, 60 + 150j, 160 + 150j])[:count]
    matrices = place_markers(centers, np.linspace(0, 2, count), [36.0] * count)
    matrices[:, :2, :2] = np.diag([1.0, 0.8]) @ matrices[:, :2, :2]
    image = draw_markers(matrices, list(range(count)), (220, 210), np.random.default_rng(1), noise=1.0)
    first, _ = PhotometricDetector("4X4_50", following=False).searches(image)
    assert sorted(first.found.ids) == list(range(count))
    assert [plane.shared for plane in known] == [False, count == 4] and sides == [0, count]
    assert count == 3 or (known[1] == first.plane != Plane())
