"""Dark squares whose outline a line crosses."""

import cv2
import numpy as np
import pytest

from skyherd.vision import PhotometricDetector
from skyherd.vision.photometric import detector as stages
from skyherd.vision.search import crossed as crossed_module
from skyherd.vision.search.crossed import find_crossed_quads
from skyherd.vision.search.quads import find_quads, find_small_quads

DICTIONARY, SIDE_PX, LINE_PX = "APRILTAG_36h11", 60.0, 3
MIDDLES = np.array([70 + 70j, 190 + 70j, 70 + 190j, 190 + 190j])
NONE = np.zeros((0, 4, 2))


@pytest.fixture
def crossed(place_markers, draw_markers):
    """Return an image of four markers, each under a dark line that ends on the ground on either side."""

    def strokes(image: np.ndarray) -> None:
        for middle in MIDDLES:
            ends = [middle + 18j + 50 * np.exp(1j * angle) for angle in (0.3, 0.3 + np.pi)]
            one, other = ((round(end.real), round(end.imag)) for end in ends)
            cv2.line(image, one, other, 30, LINE_PX)

    rng = np.random.default_rng(3)
    matrices = place_markers(MIDDLES, [0.1, 0.5, 0.9, 1.3], [SIDE_PX] * 4)
    given = {"noise": 1.0, "dictionary": DICTIONARY, "paint": strokes}
    return draw_markers(matrices, [1, 2, 3, 4], (260, 260), rng, **given)


def test_large_regions_are_those_of_opencv():
    """Noise, and blocks with others in their holes, filled region by region."""
    rng = np.random.default_rng(7)
    coarse = cv2.resize(
        rng.integers(0, 256, (25, 40), dtype=np.uint8), (160, 100), interpolation=cv2.INTER_CUBIC
    )
    image = np.clip(coarse + rng.normal(0, 12, coarse.shape), 0, 255).astype(np.uint8)
    cv2.rectangle(image, (20, 20), (80, 80), 0, 4)
    cv2.rectangle(image, (40, 40), (55, 55), 0, cv2.FILLED)
    dark = cv2.subtract(cv2.blur(image, (21, 21)), image) > crossed_module.DARKER
    outlines, _ = cv2.findContours(dark.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    large = [one for one in outlines if min(cv2.boundingRect(one)[2:]) >= crossed_module.MIN_SIDE_PX]
    expected = cv2.drawContours(np.zeros_like(image), large, -1, 255, cv2.FILLED)
    assert 1 < len(large) < len(outlines)
    np.testing.assert_array_equal(crossed_module.large_regions(image), expected)
    assert crossed_module.large_regions(np.full((10, 12), 90, np.uint8)).max() == 0


def found(quads: np.ndarray) -> int:
    """Return the number of markers with a quadrilateral of their size within 4 px of their centre."""
    off = np.abs(quads.mean(axis=1) @ [1, 1j] - MIDDLES[:, None])
    sides = np.linalg.norm(np.roll(quads, 1, axis=1) - quads, axis=2).mean(axis=1)
    return int(((off < 4) & (np.abs(sides - SIDE_PX) < 8)).any(axis=1).sum())


def test_squares_under_a_line_are_found(crossed):
    """Three of four at least. The other searches, the negative control, find fewer."""
    assert found(find_crossed_quads(crossed, NONE)) >= 3
    assert max(found(find_quads(crossed)), found(find_small_quads(crossed, NONE))) < 3


def test_markers_under_a_line_are_detected(crossed, monkeypatch):
    detector = PhotometricDetector(DICTIONARY, following=False)
    seen = detector.detect(crossed)
    assert len(seen) >= 3 and set(seen.ids) <= {1, 2, 3, 4}
    assert np.abs(seen.centers_px @ [1, 1j] - MIDDLES[seen.ids - 1]).max() < 0.2
    monkeypatch.setattr(stages, "find_crossed_quads", lambda *_: NONE)
    assert len(detector.detect(crossed)) < 3


def test_known_squares_are_left_out(crossed):
    before = found(find_crossed_quads(crossed, NONE))
    offsets = SIDE_PX / 2**0.5 * np.exp(1j * (np.pi / 4 + np.arange(4) * np.pi / 2))
    corners = MIDDLES[:1, None] + 1.2 * offsets
    known_px = np.stack([corners.real, corners.imag], axis=-1)
    assert found(find_crossed_quads(crossed, known_px)) == before - 1


def test_tiny_image_has_none():
    assert find_crossed_quads(np.zeros((5, 30), np.uint8), NONE).shape == (0, 4, 2)
