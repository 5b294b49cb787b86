"""Markers without white cards, in single images and followed: errors against those of markers on cards."""

from functools import lru_cache

import numpy as np
import pytest
from tests.helpers.plates import corners_px, rough, without_cards

from skyherd.geometry import to_points
from skyherd.messages import Quality
from skyherd.vision import DeferringDetector, PhotometricDetector
from skyherd.vision.photometric import cards, likely, measure
from skyherd.vision.photometric.fitting.fit import fit_markers
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.fitting.surroundings import Surroundings
from skyherd.vision.photometric.following import fit_predicted
from skyherd.vision.photometric.remeasure import measure_outlines

SIZE, SIDE_PX, IMAGES = (320, 240), 34.0, 5
HOMES = np.array([60 + 60j, 160 + 55j, 260 + 62j, 58 + 180j, 160 + 184j, 262 + 178j])
IDS = np.array([3, 7, 11, 20, 23, 31])
CARD, GRASS = None, "grass"
DICTIONARIES = ("4X4_50", "APRILTAG_36h11")


class Errors:
    """Errors of found markers, one after the other.

    Attributes:
        corners_px: root mean square errors of their corners, px.
        sides_px: errors of their sides, px.
        poses: NEES of centre and heading.
        outlines: NEES of the corners by `measure_outlines`.
        qualities: of the measurements.
        missed: number of markers that were not found.
    """

    def __init__(self) -> None:
        self.corners_px, self.sides_px, self.poses, self.outlines, self.qualities = [], [], [], [], []
        self.missed = 0

    def add(self, image, found, matrices, headings, dictionary):
        rows = np.searchsorted(IDS, found.ids)
        assert np.isin(found.ids, IDS).all()
        self.missed += IDS.size - rows.size
        true_px = corners_px(matrices)[rows]
        outlines_px, covariances = measure_outlines(image, found, dictionary)
        self.corners_px += np.sqrt(((found.corners_px - true_px) ** 2).sum(axis=2).mean(axis=1)).tolist()
        self.sides_px += (found.sides_px - np.sqrt(np.linalg.det(matrices[rows, :2, :2]))).tolist()
        turned = np.angle(np.exp(1j * (found.headings_rad - np.asarray(headings)[rows])))
        poses = np.column_stack([found.centers_px - true_px.mean(axis=1), turned])
        self.poses += nees(poses, found.covariances)
        self.outlines += nees((outlines_px - true_px).reshape(-1, 8), covariances)
        self.qualities += found.qualities.tolist()


def nees(errors, covariances):
    squares = np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])
    return (squares / errors.shape[1]).tolist()


@pytest.fixture(scope="module")
def scene(place_markers, draw_markers):
    """Return image, matrices and headings of six markers; those of a seed move from image to image."""

    def make(dictionary, ground, seed, number=0, noise=2.0):
        rng = np.random.default_rng([5, seed])
        headings = rng.uniform(-3, 3, IDS.size) + 0.02 * number
        centers = (
            HOMES + rng.uniform(-6, 6, IDS.size) + 1j * rng.uniform(-6, 6, IDS.size) + (1.3 - 0.7j) * number
        )
        matrices = place_markers(centers, headings, SIDE_PX * np.exp(rng.uniform(-0.2, 0.2, IDS.size)))
        if ground == GRASS:
            ground = rough(rng, SIZE[::-1], 110.0, 25.0)
        paint = None if ground is CARD else without_cards(matrices, ground)
        noises = np.random.default_rng([6, seed, number])
        options = dict(dictionary=dictionary, noise=noise, psf_px=0.6, texture=0.0, paint=paint)
        return draw_markers(matrices, IDS, SIZE, noises, **options), matrices, headings

    return lru_cache(maxsize=None)(make)


@pytest.fixture(scope="module")
def errors_of(scene):
    """Return the errors in single images, or of a detector that follows markers over four."""

    def measured(dictionary, ground, follows=False, noise=2.0):
        errors = Errors()
        for seed in range(IMAGES):
            detector = PhotometricDetector(dictionary, following=follows)
            for number in range(4 if follows else 1):
                image, matrices, headings = scene(dictionary, ground, seed, number, noise)
                found = detector.detect(image, time_s=0.1 * number)
                if number or not follows:
                    errors.add(image, found, matrices, headings, dictionary)
        return errors

    return lru_cache(maxsize=None)(measured)


PLATES = [(200.0, 1.35), (150.0, 1.7), (90.0, 2.3)]
"""Grey levels of plates, and the largest ratio of errors to those on cards. Black is 30 and white 230. The
information of an outline grows with the square of its contrast, which is 0.85, 0.6 and 0.3 of a card's."""


@pytest.mark.parametrize("follows", [False, True])
@pytest.mark.parametrize(("level", "ratio"), PLATES)
@pytest.mark.parametrize("dictionary", DICTIONARIES)
def test_marker_on_grey_plate_is_as_accurate_as_on_card(errors_of, dictionary, level, ratio, follows):
    plate, card = errors_of(dictionary, level, follows), errors_of(dictionary, CARD, follows)
    assert plate.missed <= 0.05 * len(plate.poses)
    assert np.mean(np.array(plate.qualities) == Quality.PHOTOMETRIC) > 0.95
    assert np.median(plate.corners_px) < ratio * np.median(card.corners_px)
    assert abs(np.median(plate.sides_px) - np.median(card.sides_px)) < 0.01
    assert 0.5 < np.mean(plate.poses) < 2
    assert 0.5 < np.mean(plate.outlines) < 2


@pytest.mark.parametrize("follows", [False, True])
@pytest.mark.parametrize("dictionary", DICTIONARIES)
def test_covariances_on_rough_ground_match_the_errors(errors_of, dictionary, follows):
    """The outline tells little there, so that corners are less accurate than on cards."""
    errors = errors_of(dictionary, GRASS, follows)
    assert errors.missed <= 0.05 * len(errors.poses)
    assert np.mean(np.array(errors.qualities) == Quality.PHOTOMETRIC) > 0.9
    assert np.median(errors.corners_px) < 0.04
    assert 0.5 < np.median(errors.poses) / 0.79 < 2  # 0.79: median of chi-squared / 3
    assert 0.5 < np.median(errors.outlines) < 2


@pytest.mark.parametrize("level", [200.0, 150.0])
def test_fit_to_card_on_plate_has_biased_sides(scene, monkeypatch, level):
    """Negative control of the tests above: without fits to ground."""
    monkeypatch.setattr(measure, "refit_without_cards", lambda *given: (given[2], given[4]))
    monkeypatch.setattr(likely, "MAX_OUTLINE_RATIO", 0.0)
    image, matrices, _ = scene("APRILTAG_36h11", level, 0)
    found = PhotometricDetector("APRILTAG_36h11", following=False).detect(image)
    true_px = np.sqrt(np.linalg.det(matrices[np.searchsorted(IDS, found.ids), :2, :2]))
    assert np.median(found.sides_px - true_px) > 0.1


def test_markers_on_cards_are_not_fitted_to_ground(scene, monkeypatch):
    def fail(*given, **options):
        raise AssertionError("a fit to ground")

    monkeypatch.setattr(cards, "fit_any_blur", fail)
    for seed in range(IMAGES):
        for dictionary in DICTIONARIES:
            image, *_ = scene(dictionary, CARD, seed)
            assert len(PhotometricDetector(dictionary, following=False).detect(image)) == IDS.size


def test_dark_squares_at_corners_are_no_ground(place_markers, draw_markers):
    """As on calibration boards: the markers keep their cards."""
    matrices = place_markers([100 + 80j], [0.3], 60.0)

    def paint(image):
        for corner in to_points(np.array([[-0.58 - 0.58j, 0.58 - 0.58j, 0.58 + 0.58j, -0.58 + 0.58j]]))[0]:
            square = place_markers([complex(*(matrices[0] @ [*corner, 1])[:2])], [0.3], 0.16 * 60)[0]
            without = np.zeros_like(image)
            without_cards(square[None], 0.0)(without)
            image[without != 0] = 30.0

    image = draw_markers(matrices, [7], (200, 160), np.random.default_rng(3), noise=2.0, paint=paint)
    detector = PhotometricDetector("4X4_50")
    assert detector.detect(image).ids.tolist() == [7]
    assert not detector.states[0].tracks.surroundings.is_bare().any()


@pytest.mark.parametrize("kind", [PhotometricDetector, DeferringDetector])
def test_marker_that_drives_from_white_to_grey_ground(scene, kind):
    """Fits to cards are as usual there, with sides 0.1 px off. `GROUND_INTERVAL` bounds the delay."""
    detector, dictionary = kind("APRILTAG_36h11"), "APRILTAG_36h11"
    for number in range(14):
        image, matrices, _ = scene(dictionary, 230.0 if number < 6 else 215.0, 0, number)
        found = detector.detect(image, time_s=0.1 * number)
        true_px = np.sqrt(np.linalg.det(matrices[:, :2, :2]))
        if number < 6 or number > 10:
            assert np.abs(np.median(found.sides_px - true_px)) < 0.03
    around = detector.states[0].tracks.surroundings
    assert np.nanmedian(around.levels) == pytest.approx(-0.075, abs=0.02)


def test_track_keeps_the_ground_so_that_images_stay_usual(scene):
    dictionary = "APRILTAG_36h11"
    detector = PhotometricDetector(dictionary)
    for number in range(3):
        detector.detect(scene(dictionary, 150.0, 1, number)[0], time_s=0.1 * number)
        around = detector.states[0].tracks.surroundings
        assert around.levels == pytest.approx(-0.4, abs=0.02)
        assert around.textures == pytest.approx(0, abs=5)
    image, *_ = scene(dictionary, 150.0, 1, 3)
    assert fit_predicted(image, dictionary, detector.states[0], 0.3).is_usual


def test_fit_finds_level_and_texture_of_the_ground(scene):
    image, matrices, _ = scene("4X4_50", GRASS, 1)
    start = LocalHomographies.of_corners(corners_px(matrices))
    around = Surroundings.of_ground(np.zeros(IDS.size))
    fits, _ = fit_markers(image, "4X4_50", IDS, start, 0.66, Plane(), 2.0, surroundings=around)
    assert fits.surroundings.levels == pytest.approx((110 - 230) / 200, abs=0.06)
    # The lens takes a part of the texture of 25.
    assert np.median(fits.surroundings.textures) == pytest.approx(18, abs=5)
