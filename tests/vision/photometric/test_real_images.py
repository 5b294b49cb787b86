"""What photographs have that drawings of noise lack: other blurs, processing, perspective, boards."""

import cv2
import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.geometry import SQUARE_CORNERS, to_points
from skyherd.markers.dictionary import code_distance, dictionary_size, marker_cells, with_border
from skyherd.messages import Quality
from skyherd.vision import create_detector
from skyherd.vision.photometric import verify
from skyherd.vision.photometric.detector import PhotometricDetector

DICTIONARY = "4X4_50"
HOMES = 60 + 60j + 80 * (np.arange(16) % 4 + 1j * (np.arange(16) // 4))
SIZE = (360, 360)


def scene(place_markers, draw_markers, *, noise=2.0, side_px=36.0, seed=0, psf_px=0.8, dictionary=DICTIONARY):
    """16 markers at random headings: image, centres (16,) and headings (16,)."""
    rng = np.random.default_rng(seed)
    headings = rng.uniform(-3, 3, 16)
    centers = HOMES + rng.uniform(-2, 2, 16) + 1j * rng.uniform(-2, 2, 16)
    matrices = place_markers(centers, headings, side_px)
    image = draw_markers(matrices, range(16), SIZE, rng, noise=noise, psf_px=psf_px, dictionary=dictionary)
    return image, centers, headings


def processed(image):
    """A raw image denoised, sharpened and compressed, as phones and webcams do."""
    denoised = cv2.bilateralFilter(image, 5, 30, 2)
    sharp = cv2.addWeighted(denoised, 2.2, cv2.GaussianBlur(denoised, (0, 0), 1.2), -1.2, 0)
    return cv2.imdecode(cv2.imencode(".jpg", sharp, [cv2.IMWRITE_JPEG_QUALITY, 80])[1], cv2.IMREAD_GRAYSCALE)


def found_centers(seen):
    return seen.centers_px[:, 0] + 1j * seen.centers_px[:, 1]


# --- blur ---


def test_markers_of_different_blur_are_all_measured(place_markers, draw_markers):
    """Half of the image in focus, half of it blurred four times as much: each marker has its own blur."""
    sharp, centers, _ = scene(place_markers, draw_markers, noise=0.0, psf_px=0.5)
    image = sharp.copy()
    image[:, 180:] = cv2.GaussianBlur(sharp, (0, 0), 2.0)[:, 180:]
    noise = np.random.default_rng(1).normal(0, 2.0, image.shape)
    image = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
    detector = PhotometricDetector(DICTIONARY)
    seen = detector.detect(image)
    assert seen.ids.tolist() == list(range(16))
    off = np.abs(found_centers(seen) - centers)
    deviations = np.sqrt(np.trace(seen.covariances[:, :2, :2], axis1=1, axis2=2))
    assert (off < 5 * deviations).all(), off / deviations
    blurs = detector.states[0].tracks.sigmas_px
    left = HOMES.real < 180
    # A Gaussian of 0.5 px sampled at whole pixels is narrower than itself by up to a tenth.
    assert np.allclose(blurs[left], np.hypot(0.5, np.sqrt(1 / 12)), rtol=0.2)
    assert np.allclose(blurs[~left], np.hypot(2.0, np.hypot(0.5, np.sqrt(1 / 12))), rtol=0.1)


def test_a_drawing_without_blur_is_read_whole():
    """154 frontal markers, edges on pixel borders, black 0 and white 255."""
    cell, step, ids = 4, 40, [index % 50 for index in range(154)]
    image = np.full((11 * step + 20, 14 * step + 20), 255, np.uint8)
    for index, marker in enumerate(ids):
        row, column = 20 + step * (index // 14), 20 + step * (index % 14)
        drawn = np.kron(marker_cells(DICTIONARY, marker), np.ones((cell, cell))) * 255
        image[row : row + 6 * cell, column : column + 6 * cell] = drawn
    seen = create_detector("photometric", dictionary=DICTIONARY, repeats=True).detect(image)
    assert sorted(seen.ids.tolist()) == sorted(ids)
    truth = (1 + 1j) * (20 + 3 * cell - 0.5) + step * (np.arange(14) + 1j * np.arange(11)[:, None]).ravel()
    off = np.abs(found_centers(seen)[:, None] - truth).min(axis=1)
    assert off.max() < 0.05


def test_an_image_is_read_the_same_whatever_was_seen_before(place_markers, draw_markers):
    """Without following, nothing is apply_similarity over: equal to the bit."""
    first, _, _ = scene(place_markers, draw_markers, seed=1, psf_px=2.0, noise=12.0)
    second, _, _ = scene(place_markers, draw_markers, seed=2, psf_px=0.5)
    detector = create_detector("photometric", dictionary=DICTIONARY)
    detector.detect(first)
    after, fresh = (
        detector.detect(second),
        create_detector("photometric", dictionary=DICTIONARY).detect(second),
    )
    for name in ("ids", "centers_px", "headings_rad", "covariances"):
        np.testing.assert_array_equal(getattr(after, name), getattr(fresh, name))


# --- processing ---


def test_processed_images_lose_no_marker(place_markers, draw_markers, monkeypatch):
    """Denoised, sharpened and compressed markers of 20 px: all are found, to a tenth of a pixel. None is if
    only the image's own noise may be left over, as the negative control has it."""
    for seed in range(3):
        image, centers, _ = scene(place_markers, draw_markers, noise=6.0, side_px=20.0, seed=seed)
        seen = PhotometricDetector(DICTIONARY).detect(processed(image))
        assert seen.ids.tolist() == list(range(16))
        assert np.abs(found_centers(seen) - centers).max() < 0.1
    monkeypatch.setattr(verify, "MODEL_SHARE", 0.0)
    seen = PhotometricDetector(DICTIONARY).detect(processed(image))
    assert len(seen.of_quality(Quality.PHOTOMETRIC)) < 8


# --- perspective ---


@pytest.mark.parametrize("tilt_deg", [30, 50, 65])
def test_a_single_slanted_marker_has_a_perspective_of_its_own(draw_markers, tilt_deg):
    """One marker three sides away from the camera: its corners to a tenth of a pixel."""
    tilt, focal, size = np.radians(tilt_deg), 450.0, (400, 400)
    turned = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    pose = np.column_stack([turned[:, 0], turned[:, 1], [0, 0, 3.0]])
    spin = np.array([[np.cos(0.4), -np.sin(0.4), 0], [np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    matrix = np.array([[focal, 0, 199.5], [0, focal, 199.5], [0, 0, 1]]) @ pose @ spin
    image = draw_markers(matrix[None] / matrix[2, 2], [11], size, np.random.default_rng(1), noise=2.0)
    seen = create_detector("photometric", dictionary=DICTIONARY).detect(image)
    assert seen.ids.tolist() == [11]
    corners = np.column_stack([to_points(SQUARE_CORNERS), np.ones(4)]) @ matrix.T
    assert np.abs(seen.corners_px[0] - corners[:, :2] / corners[:, 2:]).max() < 0.1


# --- kinds of markers ---


def test_borders_of_two_cells_are_read_as_such(place_markers, draw_markers):
    wide = with_border(DICTIONARY, 2)
    image, centers, _ = scene(place_markers, draw_markers, side_px=44.0, dictionary=wide)
    seen = create_detector("photometric", dictionary=DICTIONARY, border_bits=2).detect(image)
    assert seen.ids.tolist() == list(range(16))
    assert np.abs(found_centers(seen) - centers).max() < 0.05
    assert not len(create_detector("photometric", dictionary=DICTIONARY).detect(image).ids)


def test_white_markers_on_black_are_read_if_one_says_so(place_markers, draw_markers):
    image, _, _ = scene(place_markers, draw_markers)
    usual = create_detector("photometric", dictionary=DICTIONARY)
    white = create_detector("photometric", dictionary=DICTIONARY, inverted=True)
    assert len(white.detect(image).ids) == 0
    np.testing.assert_array_equal(white.detect(255 - image).centers_px, usual.detect(image).centers_px)
    assert len(usual.detect(255 - image).ids) == 0


def test_ids_that_repeat_are_all_told_if_one_asks(place_markers, draw_markers):
    rng = np.random.default_rng(4)
    ids = [3, 3, 3, 7, 9, 9, 1, 2, 4, 5, 6, 8, 10, 11, 12, 13]
    image = draw_markers(place_markers(HOMES, rng.uniform(-3, 3, 16), 36.0), ids, SIZE, rng)
    seen = create_detector("photometric", dictionary=DICTIONARY, repeats=True).detect(image)
    assert sorted(seen.ids.tolist()) == sorted(ids)
    assert seen.ids[seen.repeated].tolist() == [3, 3, 3, 9, 9]
    once = create_detector("photometric", dictionary=DICTIONARY).detect(image)
    assert once.ids.tolist() == seen.unambiguous().ids.tolist()
    with pytest.raises(InputError, match="leaves out ids that repeat"):
        create_detector("opencv", dictionary=DICTIONARY, repeats=True)
    with pytest.raises(InputError, match="cannot be followed"):
        PhotometricDetector(DICTIONARY, repeats=True)


@pytest.mark.parametrize("name", ["4X4_50", "APRILTAG_16h5", "5X5_100"])
def test_code_distance_is_the_minimum_over_pairs_and_rotations(name):
    bits = [marker_cells(name, marker)[1:-1, 1:-1] for marker in range(dictionary_size(name))]
    least = min(
        np.count_nonzero(bits[i] != np.rot90(bits[j], turn))
        for i in range(len(bits))
        for j in range(i, len(bits))
        for turn in range(4)
        if (i, turn) != (j, 0)
    )
    assert code_distance(name) == least == code_distance(with_border(name, 2))


def test_a_border_is_one_to_three_cells():
    assert with_border("4X4_50", 1) == "4X4_50"
    assert marker_cells(with_border("4X4_50", 3), 0).shape == (10, 10)
    for name, border in (("4X4_50", 0), ("4X4_50", 4), ("4X4_50@2", 2)):
        with pytest.raises(InputError):
            with_border(name, border)
    with pytest.raises(InputError, match="a border of 1 to 3 cells"):
        marker_cells("4X4_50@9", 0)
