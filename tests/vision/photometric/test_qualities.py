"""Covariances of markers that no photometric fit measures."""

import cv2
import numpy as np
import pytest

from skyherd.messages import Quality
from skyherd.vision import PhotometricDetector
from skyherd.vision.photometric import likely
from skyherd.vision.photometric.evidence import likelihood
from skyherd.vision.photometric.evidence.likelihood import min_log_odds

DICTIONARY = "4X4_50"
IDS = [3, 7, 11, 20]
PLACES = np.array([50 + 50j, 130 + 55j, 60 + 130j, 140 + 135j])


def faint(image, rng):
    """Return the image with 1/26 of its contrast, about six grey levels, and noise of one."""
    return np.clip(np.rint(120 + (image - 120.0) / 26 + rng.normal(0, 1, image.shape)), 0, 255)


def blotchy(image, rng):
    """Return the image under stains of 14 grey levels about 2.5 px wide, and 5 % salt."""
    stains = cv2.GaussianBlur(rng.normal(0, 1, image.shape), (0, 0), 2.5)
    stained = image + 14 * stains / stains.std() + rng.normal(0, 1, image.shape)
    stained[rng.random(image.shape) < 0.05] = 255
    return np.clip(stained, 0, 255)


@pytest.mark.parametrize(
    ("change", "images", "quality"), [(faint, 80, Quality.CORNERS), (blotchy, 45, Quality.ROBUST)]
)
def test_covariances_without_a_fit_match_the_errors(place_markers, draw_markers, change, images, quality):
    """NEES of the centres between 0.5 and 2 over 30 markers or more, whose own deviation is below 0.2."""
    nees = []
    for seed in range(images):
        rng = np.random.default_rng([7, seed])
        centers = PLACES + rng.uniform(-3, 3, 4) + 1j * rng.uniform(-3, 3, 4)
        image = draw_markers(place_markers(centers, rng.uniform(-3, 3, 4), 40.0), IDS, (190, 190), rng)
        seen = PhotometricDetector(DICTIONARY, following=False).detect(change(image, rng).astype(np.uint8))
        off_px = seen.centers_px - centers[np.searchsorted(IDS, seen.ids), None].view(float)
        squares = np.einsum("ni,nij,nj->n", off_px, np.linalg.inv(seen.covariances[:, :2, :2]), off_px) / 2
        nees += squares[seen.qualities == quality].tolist()
    assert len(nees) >= 30
    assert 0.5 < np.mean(nees) < 2


def dazzled(image, centers, rng):
    """Return the image with a spot of light on each marker, which saturates two or three of its cells."""
    rows, columns = np.indices(image.shape)
    for center in centers:
        spot_px = np.abs(columns + 1j * rows - center - complex(*rng.uniform(-7, 7, 2)))
        image = image + 400 * np.exp(-((spot_px / 2.8) ** 2) / 2)
    return np.clip(np.rint(image + rng.normal(0, 2, image.shape)), 0, 255).astype(np.uint8)


def banded(image, centers, rng):
    """Return the image under light that varies by 0.35 with a period of 40 rows."""
    light = 1 + 0.35 * np.sin(2 * np.pi * (np.arange(image.shape[0])[:, None] / 40 + rng.random()))
    return np.clip(np.rint(light * image + rng.normal(0, 2, image.shape)), 0, 255).astype(np.uint8)


def found_under(change, place_markers, draw_markers) -> dict[tuple[int, int], int]:
    """Quality by image and id of all markers found in twelve images, each within a pixel of its place."""
    found = {}
    for seed in range(12):
        rng = np.random.default_rng([9, seed])
        centers = PLACES + rng.uniform(-3, 3, 4) + 1j * rng.uniform(-3, 3, 4)
        image = draw_markers(place_markers(centers, rng.uniform(-3, 3, 4), 40.0), IDS, (190, 190), rng)
        seen = PhotometricDetector(DICTIONARY, following=False).detect(change(image, centers, rng))
        assert set(seen.ids) <= set(IDS)
        off_px = seen.centers_px @ [1, 1j] - centers[np.searchsorted(IDS, seen.ids)]
        assert np.abs(off_px).max(initial=0.0) < 1
        found |= {(seed, marker): seen.qualities[row] for row, marker in enumerate(seen.ids.tolist())}
    return found


def test_doubtful_markers_need_pixels_that_agree(place_markers, draw_markers, monkeypatch):
    """Without the odds that a robust fit adds fewer are found, and without robust fits no more."""
    found = found_under(dazzled, place_markers, draw_markers)
    monkeypatch.setattr(likelihood, "ROBUST_LOG_ODDS", 0.0)
    sure = found_under(dazzled, place_markers, draw_markers)
    assert sure.keys() < found.keys() and len(found) >= len(sure) + 5
    assert {found[one] for one in found.keys() - sure.keys()} == {Quality.ROBUST}
    monkeypatch.undo()
    monkeypatch.setattr(likely, "MAX_UNEXPLAINED_SHARE", -1.0)
    assert found_under(dazzled, place_markers, draw_markers).keys() == sure.keys()


def test_fits_that_agree_with_the_edges_count(place_markers, draw_markers, monkeypatch):
    """If fits had to explain the readings better than the edges, fewer would be robust and fewer found."""
    found = found_under(dazzled, place_markers, draw_markers)
    monkeypatch.setattr(likely, "MAX_LOG_LOSS", 0.0)
    better = found_under(dazzled, place_markers, draw_markers)
    assert better.keys() < found.keys() and len(found) >= len(better) + 2
    robust, fewer = (list(one.values()).count(Quality.ROBUST) for one in (found, better))
    assert robust >= fewer + 4


def test_markers_under_bands_of_light_are_found_by_their_edges(place_markers, draw_markers, monkeypatch):
    """Of 48 at least 46. Without the odds that others of like size add, a control, fewer than 43."""
    found = found_under(banded, place_markers, draw_markers)
    assert len(found) >= 46 and list(found.values()).count(Quality.CORNERS) >= 20
    monkeypatch.setattr(likelihood, "LIKE_LOG_ODDS", 0.0)
    fewer = found_under(banded, place_markers, draw_markers)
    assert len(fewer) < 43
    monkeypatch.undo()
    monkeypatch.setattr(likely, "MAX_SIDE_RATIO", 0.9)  # no marker is like another one
    assert found_under(banded, place_markers, draw_markers).keys() == fewer.keys()


DOUBTFUL = [(1, 3), (1, 11), (2, 11), (3, 7), (4, 7), (7, 11), (8, 11), (8, 20)]
"""Seeds and ids of markers whose log odds under bands of light are 7.1 to 7.9, too few for them alone."""


def one_marker(seed, marker, place_markers, draw_markers):
    """Return the image of a marker of 40 px, the same image under bands of light, and the marker's place."""
    rng, center = np.random.default_rng([seed, marker]), np.array([95 + 95j])
    image = draw_markers(place_markers(center, rng.uniform(-3, 3, 1), 40.0), [marker], (190, 190), rng)
    return image, banded(image, center, rng), center


@pytest.mark.parametrize(("side_px", "found"), [(24.0, 0), (28.0, 8), (56.0, 8), (66.0, 0)])
def test_another_marker_counts_if_it_is_of_like_size(side_px, found, place_markers, draw_markers):
    """Markers of 40 px are found beside a clear one of up to 1.5 times their size, or less."""
    detector, count = PhotometricDetector(DICTIONARY, following=False), 0
    for seed, marker in DOUBTFUL:
        _, doubtful, center = one_marker(seed, marker, place_markers, draw_markers)
        assert marker not in detector.detect(doubtful).ids
        rng = np.random.default_rng(seed)
        other = draw_markers(place_markers(center, rng.uniform(-3, 3, 1), side_px), [40], (190, 190), rng)
        seen = detector.detect(np.hstack([doubtful, other.astype(np.uint8)]))
        assert 40 in seen.ids
        count += marker in seen.ids
    assert count == found


@pytest.mark.parametrize("moved_px", [0, 16])
def test_a_followed_marker_is_doubted_less_than_a_new_one(moved_px, place_markers, draw_markers):
    """It was seen in the image before at the same size. One that moved is searched near its last place."""
    for seed, marker in DOUBTFUL:
        clear, doubtful, _ = one_marker(seed, marker, place_markers, draw_markers)
        detector = PhotometricDetector(DICTIONARY)
        assert detector.detect(clear.astype(np.uint8), time_s=0.0).ids.tolist() == [marker]
        moved = np.roll(doubtful, moved_px, axis=1)
        assert detector.detect(moved, time_s=0.1).ids.tolist() == [marker]


@pytest.mark.parametrize("dictionary", ["4X4_50", "4X4_1000", "5X5_100", "APRILTAG_36h11"])
def test_robust_fits_need_no_more_odds_than_others(dictionary):
    """Also of the weakest dictionaries, whose markers cannot have the odds of the constant."""
    assert min_log_odds(dictionary, robust=True) <= min_log_odds(dictionary)
