"""Markers covered in part are measured by what is seen of them."""

from functools import cache

import numpy as np
import pytest

from skyherd.geometry import ROBOT_FRAME_CORNERS
from skyherd.markers.blur_model import total_sigma_px
from skyherd.markers.dictionary import card_side, code_distance
from skyherd.render import Camera, CameraPose, Disc, Ground, Renderer, Sensor, Shot, project_markers
from skyherd.vision import PhotometricDetector, create_detector
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.fit import fit_markers
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.occlusion import fit_visible
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.verify import may_be_occluded, verified

DICTIONARY, SIDE_PX, NOISE, SIGMA_PX = "4X4_50", 30.0, 3.0, total_sigma_px(0.8)
DISTANCE = code_distance(DICTIONARY)
IDS = np.arange(16)
CAMERA, POSE = Camera((640, 640), focal_px=10 * SIDE_PX), CameraPose((0.0, 0.0), 10.0)


@cache
def one_ground() -> Ground:
    """Made once: making a ground takes as long as twenty images of it."""
    return Ground(1, sigma_px=SIGMA_PX)


def scene(seed: int, covered: list[int], radius: float, inward: float = 0.0, pose: CameraPose = POSE):
    """An image of sixteen markers, some with a dark disc about their corner or so far from it towards the
    middle, and the truth about it."""
    rng = np.random.default_rng(seed)
    home = 4.4 * np.stack(np.meshgrid(np.arange(4) - 1.5, np.arange(4) - 1.5), axis=-1).reshape(-1, 2)
    positions, headings = home + rng.uniform(-0.5, 0.5, home.shape), rng.uniform(-np.pi, np.pi, IDS.size)
    axes = np.exp(1j * headings)
    corners = (ROBOT_FRAME_CORNERS[1] * (1 - inward)) * axes
    discs = [
        Disc((positions[row, 0] + corners[row].real, positions[row, 1] + corners[row].imag), radius, 40.0)
        for row in covered
    ]
    renderer = Renderer(DICTIONARY, 1.0, one_ground(), Sensor(NOISE, rng), psf_px=0.8)
    image = renderer.render(Shot(CAMERA, pose, IDS, positions, headings, occluders=discs))
    return image, project_markers(CAMERA, pose, positions, headings, 1.0, card_side(DICTIONARY))


def turned(headings_rad, truth) -> np.ndarray:
    return np.angle(np.exp(1j * (headings_rad - truth.headings_rad)))


@pytest.mark.parametrize("radius", [0.08, 0.16])
def test_what_covers_a_corner_does_not_pull_at_the_pose(radius):
    """0.5 % and 2 % of the marker: errors as the covariance has them, those of plain least squares twenty of
    its deviations and more. The mean of 16 squares deviates by 0.35; what is left of the disc's blurred edge
    may double them."""
    image, truth = scene(1, IDS.tolist(), radius)
    start = LocalHomographies.of_corners(truth.corners_px)
    plain, plane = fit_markers(image, DICTIONARY, IDS, start, SIGMA_PX, Plane(), NOISE)
    assert may_be_occluded(plain, NOISE).all()
    fits, _ = fit_visible(image, DICTIONARY, plain, SIGMA_PX, plane, NOISE)
    assert verified(fits, NOISE, DISTANCE).all()
    deviations = np.sqrt(fits.covariances[:, 2, 2])
    off, plainly_off = (turned(f.homographies.headings_rad(), truth) / deviations for f in (fits, plain))
    assert np.mean(off**2) < 2 * (1 + 3 * 0.35)
    assert np.median(np.abs(plainly_off)) > 20


def test_a_marker_with_a_bit_that_is_not_seen_is_not_shown():
    """The disc lies over a bit; the marker beside it is as it was."""
    image, truth = scene(2, [5], 0.12, inward=0.5)
    plain, plane = fit_markers(
        image, DICTIONARY, IDS, LocalHomographies.of_corners(truth.corners_px), SIGMA_PX, Plane(), NOISE
    )
    assert np.flatnonzero(may_be_occluded(plain, NOISE)).tolist() == [5]
    fits, _ = fit_visible(image, DICTIONARY, plain, SIGMA_PX, plane, NOISE)
    assert np.flatnonzero(~verified(fits, NOISE, DISTANCE)).tolist() == [5]


@pytest.mark.parametrize("name", ["photometric", "tracking"])
def test_covered_markers_are_found_and_leave_the_others_alone(name):
    """Three of sixteen: all are found, in the first image already and as well as the noise allows, and the
    plane that all share is told by the others."""
    squares = []
    detector = create_detector(name, dictionary=DICTIONARY)
    for seed in range(6):
        image, truth = scene(10 + seed, [2, 7, 11], 0.16)
        seen = detector.detect(image, time_s=100.0 * seed, unit_id=seed)
        assert seen.ids.tolist() == IDS.tolist()
        squares.append(turned(seen.headings_rad, truth) ** 2 / seen.covariances[:, 2, 2])
        assert detector.states[seed].plane == Plane()
    others = np.delete(np.array(squares), [2, 7, 11], axis=1)
    # 78 and 18 squares deviate from their mean by 0.16 and 0.33; edges of discs may double the latter.
    assert np.mean(others) < 1 + 4 * 0.16
    assert np.mean(np.array(squares)[:, [2, 7, 11]]) < 2 * (1 + 3 * 0.33)


TILTED = CameraPose((0.0, 0.0), 10.0, 0.0, (0.5, -0.3))


def squared_errors(image, truth, ids) -> list[float]:
    """Detect markers; squared errors of the centres of those of `ids`, over what covariances say."""
    seen = PhotometricDetector(DICTIONARY, following=False).detect(image)
    rows = np.isin(seen.ids, ids)
    off = seen.centers_px[rows] - truth.centers_px[seen.ids[rows]]
    return [d @ np.linalg.solve(c, d) / 2 for d, c in zip(off, seen.covariances[rows, :2, :2], strict=True)]


@pytest.mark.parametrize("covered", [[6], [1, 2, 5, 6, 8, 11], IDS.tolist()])
def test_covered_markers_are_measured_under_a_tilt(covered):
    """One marker alone, or a few, do not show the keystones of a tilt: centres would be off by 0.1 px."""
    errors: list[float] = []
    for seed in range(4):
        image, truth = scene(40 + seed, covered, 0.12, pose=TILTED)
        errors += squared_errors(image, truth, covered)
    assert len(errors) >= 4
    assert np.mean(errors) < 2 * (1 + 4 / np.sqrt(len(errors)))


def test_covers_do_not_affect_the_plane_of_clear_markers():
    """Twelve of sixteen are covered: the plane of all plain fits would lead to a NEES of 6."""
    covered, pose, errors = IDS[4:].tolist(), CameraPose((0.0, 0.0), 10.0, 0.0, (0.25, -0.15)), []
    for seed in range(8):
        image, truth = scene(70 + seed, covered, 0.25, pose=pose)
        errors += squared_errors(image, truth, covered)
    assert len(errors) > 40
    assert np.mean(errors) < 2


def test_covered_markers_alone_find_their_plane():
    """All are covered: they are known as well as on a known plane, and better than each by itself."""
    stds = []
    for seed in range(4):
        image, truth = scene(80 + seed, IDS.tolist(), 0.16)
        start = LocalHomographies.of_corners(truth.corners_px)
        plain, _ = fit_markers(image, DICTIONARY, IDS, start, SIGMA_PX, Plane(), NOISE)
        given = image, DICTIONARY, plain, SIGMA_PX
        known, alone = (fit_visible(*given, plane, NOISE)[0] for plane in (Plane(), OWN_PLANES))
        seen = PhotometricDetector(DICTIONARY, following=False).detect(image)
        assert seen.ids.tolist() == IDS.tolist()
        stds.append([np.sqrt(np.median(one.covariances[:, 0, 0])) for one in (seen, known, alone)])
    found, known, alone = np.mean(stds, axis=0)
    assert found < 1.1 * known < 0.8 * alone


def test_covered_marker_off_the_plane_of_the_others_is_measured():
    """One of sixteen is tilted by itself: it keeps an anisotropy of its own."""
    errors = []
    for seed in range(4):
        image, truth = scene(90 + seed, [], 0.12)
        other, tilted = scene(90 + seed, [6], 0.12, pose=TILTED)
        (u, v), (x, y) = (np.rint(one.centers_px[6]).astype(int) for one in (truth, tilted))
        image[v - 30 : v + 30, u - 30 : u + 30] = other[y - 30 : y + 30, x - 30 : x + 30]
        truth.centers_px[6] = tilted.centers_px[6] + [u - x, v - y]
        own = squared_errors(image, truth, [6])
        assert len(own) == 1
        errors += own
    assert np.mean(errors) < 2 * (1 + 4 / np.sqrt(len(errors)))


def test_outliers_along_all_edges_cover_nothing(place_markers, draw_markers):
    """Of thresholded images; without these pixels, centres would be 0.05 px off by six deviations."""
    off, errors, centers = [], [], np.array([60 + 60j, 160 + 60j, 60 + 150j, 160 + 150j])
    for seed in range(12):
        rng = np.random.default_rng(seed)
        matrices = place_markers(centers, rng.uniform(-3, 3, 4), [24.0, 30.0, 36.0, 42.0])
        grey = draw_markers(matrices, [3, 11, 24, 48], (220, 210), rng, noise=1.0)
        seen = PhotometricDetector(DICTIONARY, following=False).detect(
            np.where(grey > 128, 255, 0).astype(np.uint8)
        )
        away = seen.centers_px - centers[:, None].view(float)
        off += np.linalg.norm(away, axis=1).tolist()
        errors += [
            d @ np.linalg.solve(c, d) / 2 for d, c in zip(away, seen.covariances[:, :2, :2], strict=True)
        ]
    assert np.sqrt(np.mean(np.square(off))) < 0.04
    assert np.mean(errors) < 2


def test_what_is_not_covered_is_not_fitted_twice(monkeypatch):
    image, _ = scene(3, [], 0.1)
    monkeypatch.setattr("skyherd.vision.photometric.covered.fit_visible_all_sizes", None)
    assert PhotometricDetector(DICTIONARY).detect(image).ids.size == IDS.size


@pytest.mark.parametrize("side_px", [120.0, 200.0, 600.0, 1500.0])
def test_large_markers_are_seen_in_part_as_well(side_px):
    """2 % of a marker covered, at any size: its centre within 0.02 px and its heading within 0.02 deg:
    ten times what noise allows and less than a hundredth of what the disc does."""
    size = int(2.2 * side_px)
    camera = Camera((size, size), focal_px=10 * side_px)
    rng = np.random.default_rng(7)
    renderer = Renderer(DICTIONARY, 1.0, one_ground(), Sensor(NOISE, rng), psf_px=0.8)
    axis = np.exp(0.3j)
    corner = ROBOT_FRAME_CORNERS[1] * axis
    disc = Disc((corner.real, corner.imag), 0.16, 40.0)
    image = renderer.render(
        Shot(camera, POSE, np.array([7]), np.zeros((1, 2)), np.array([0.3]), occluders=[disc])
    )
    truth = project_markers(camera, POSE, np.zeros((1, 2)), np.array([0.3]), 1.0, card_side(DICTIONARY))
    seen = PhotometricDetector(DICTIONARY).detect(image)
    assert seen.ids.tolist() == [7]
    assert np.abs(seen.centers_px - truth.centers_px).max() < 0.02
    assert np.abs(turned(seen.headings_rad, truth)) < np.radians(0.02)
