"""Fits at a resolution that suits each marker, and the plane that later searches of an image know."""

import numpy as np
import pytest

from skyherd.vision import PhotometricDetector
from skyherd.vision.photometric import detector as detector_module
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.refine import ScaledImage


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
