"""Markers that are guessed: cut by the border, or without a margin; and what must not be guessed."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import all_marker_cells, marker_cells
from skyherd.vision import PhotometricDetector
from skyherd.vision.diagnosis.guesses import _all_codes, _numbers, dark_patches, guess_markers
from skyherd.vision.diagnosis.places import first_of_each_place

DICTIONARY = "4X4_50"


def laid_out(ids: list[int], margin: int, ground: int, cell_px: int = 9) -> np.ndarray:
    """Markers in a row, each turned further by 17 degrees, with a white margin of some cells on a ground."""
    image = np.full((140, 140 * len(ids)), ground, np.uint8)
    for k, marker_id in enumerate(ids):
        cells = np.pad(np.where(marker_cells(DICTIONARY, marker_id), 230, 30), margin, constant_values=230)
        side = cell_px * len(cells)
        turn = cv2.getRotationMatrix2D((side / 2 - 0.5, side / 2 - 0.5), 17.0 * (k + 1), 1.0)
        turn[:, 2] += 70 - side / 2
        drawn = np.kron(cells, np.ones((cell_px, cell_px))).astype(np.uint8)
        place = image[:, 140 * k : 140 * (k + 1)]
        cv2.warpAffine(drawn, turn, (140, 140), place, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


def guessed(image: np.ndarray) -> dict[int, np.ndarray]:
    """Return the centre of the best guess of each place, px, by its id."""
    nothing = PhotometricDetector(DICTIONARY, following=False).detect(np.zeros((9, 9), np.uint8))
    named = guess_markers(image, DICTIONARY, nothing)
    named = named.take(np.argsort(named.mirrored - named.decoded.correlations))
    named = named.take(first_of_each_place(named.decoded.corners_px))
    return dict(zip(named.decoded.ids.tolist(), named.decoded.corners_px.mean(axis=1), strict=True))


@pytest.mark.parametrize("cell_px", [6, 9, 14])
def test_markers_on_dark_ground_are_guessed(cell_px) -> None:
    ids = [3, 7, 12, 21, 33]
    found = guessed(laid_out(ids, 0, 35, cell_px))
    assert sorted(found) == ids
    for k, marker_id in enumerate(ids):
        np.testing.assert_allclose(found[marker_id], (140 * k + 69.5, 69.5), atol=cell_px / 3)


def test_spots_within_detections_are_no_groups() -> None:
    image = laid_out([3, 7], 0, 35)
    detector = PhotometricDetector(DICTIONARY, following=False)
    found = detector.detect(laid_out([3, 7], 1, 35))
    assert found.ids.tolist() == [3, 7]
    assert guess_markers(image, DICTIONARY, found).decoded.ids.tolist() == []


def test_flipped_bits_are_no_guess() -> None:
    """One white cell of each painted black, which makes it no marker of the dictionary."""
    image = laid_out([3, 7], 0, 35)
    cells = marker_cells(DICTIONARY, 3).copy()
    cells[tuple(np.argwhere(cells)[0])] = False
    drawn = np.kron(np.where(cells, 230, 30), np.ones((9, 9))).astype(np.uint8)
    plain = np.full((140, 140), 35, np.uint8)
    plain[43:97, 43:97] = drawn
    assert guessed(plain) == {}
    assert 3 in guessed(image)


@pytest.mark.parametrize("ground", [230, 120])
def test_markers_cut_by_the_border_are_guessed(ground) -> None:
    """A corner of each is beyond the right border."""
    for marker_id in (3, 21, 40):
        image = laid_out([marker_id], 1, ground)
        last = int(np.argwhere(image.min(axis=0) < 60).max())
        found = guessed(np.ascontiguousarray(image[:, : last - 12]))
        assert list(found) == [marker_id]
        np.testing.assert_allclose(found[marker_id], (69.5, 69.5), atol=3)


def test_cut_markers_have_a_margin() -> None:
    """With a dark strip along one side, a third of a cell away, it is not guessed."""
    image = np.full((160, 200), 230, np.uint8)
    cells = np.kron(np.where(marker_cells(DICTIONARY, 3), 230, 30), np.ones((14, 14)))
    image[40:124, 100:184] = cells
    striped = image.copy()
    striped[40:124, 85:95] = 30
    cut, other = (cv2.GaussianBlur(one, (0, 0), 0.8)[:, :165].copy() for one in (image, striped))
    assert list(guessed(cut)) == [3] and guessed(other) == {}


def test_dark_corner_of_the_image_is_no_cut_marker() -> None:
    image = np.full((140, 140), 200, np.uint8)
    image[:60, 90:] = 30
    image[15:30, 100:125] = 200
    assert guessed(cv2.GaussianBlur(image, (0, 0), 0.8)) == {}


def test_patches_are_squares_around_dark_regions() -> None:
    """A square without a corner, of a marker's size, and an oblong, which is none."""
    image = np.full((200, 300), 200, np.uint8)
    image[50:110, 60:120], image[60:90, 180:270] = 30, 30
    cv2.circle(image, (60, 50), 20, 200, -1)
    patches = dark_patches(image)
    np.testing.assert_allclose(np.unique(patches.mean(axis=1).round(), axis=0), [[90, 80]], atol=1.5)


@pytest.mark.parametrize("dictionary", ["4X4_50", "APRILTAG_36h11", "7X7_1000"])
def test_codes_are_those_of_all_turns_and_mirror_images(dictionary) -> None:
    cells = all_marker_cells(dictionary)[:40]
    inner = np.zeros(cells.shape[1:], dtype=bool)
    inner[1:-1, 1:-1] = True
    codes = set(_all_codes(dictionary).tolist())
    for turn in range(4):
        for side in (cells, cells[:, :, ::-1]):
            assert set(_numbers(np.rot90(side, turn, (1, 2))[:, inner]).tolist()) <= codes
    flipped = cells.copy()
    flipped[:, 2, 2] ^= True
    assert not set(_numbers(flipped[:, inner]).tolist()) <= codes
