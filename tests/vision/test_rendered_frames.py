"""Detection in rendered frames with ground truth, at the noise and blur of the accuracy table.

The fast tests use 4 frames of 16 markers per side, and `pytest -m slow` uses 6 and 100 frames.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from scipy.special import chdtri

from skyherd.control import AerialController, Hover, SafetyRadius, Template
from skyherd.datasets import make_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.markers.dictionary import card_side, dictionary_names, mirror_symmetric_ids, pose_of_corners
from skyherd.messages import Detections
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot, project_markers
from skyherd.vision import create_detector, explain_mirrored
from skyherd.vision.detectors.accuracy import load_accuracy
from skyherd.vision.photometric.detector import PhotometricDetector

DICTIONARY, IMAGE_PX, PER_FRAME = "4X4_50", 800, 16
SIDES_PX = (15.0, 16.0, 18.0, 21.0, 25.0, 30.0, 37.0, 45.0, 60.0)


def wrap(angle: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * np.asarray(angle)))


@dataclass(frozen=True)
class Measured:
    """Errors of the detected markers at one true side."""

    side_px: float
    recall: float
    false: int
    error: np.ndarray  # (M, 3) u, v in px, heading in rad
    covariances: np.ndarray  # (M, 3, 3)
    sides_px: np.ndarray  # (M,) measured


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    rng = np.random.default_rng(20)
    ground = Ground(20, sigma_px=float(np.hypot(0.8, np.sqrt(1 / 12))))
    return Renderer(DICTIONARY, 1.0, ground, Sensor(2.0, rng), psf_px=0.8)


def measure(renderer: Renderer, side_px: float, frames: int, seed: int) -> Measured:
    """Measure fully visible markers on a jittered grid, with random heading, id, yaw and ground position."""
    rng = np.random.default_rng([seed, int(side_px)])
    detector = create_detector(dictionary=DICTIONARY)
    found, false, errors, covariances, sides = 0, 0, [], [], []
    spacing = (IMAGE_PX / side_px - 2.5) / 4
    for _ in range(frames):
        yaw, place = rng.uniform(-np.pi, np.pi), complex(*rng.uniform(-20, 20, 2))
        grid = (np.arange(4)[:, None] + 1j * np.arange(4)[None, :]).ravel() - 1.5 * (1 + 1j)
        jitter = rng.uniform(-0.5, 0.5, (2, PER_FRAME)) * max(spacing - 2.2, 0.0)
        at = place + (spacing * grid + jitter[0] + 1j * jitter[1]) * np.exp(1j * yaw)
        positions, headings = np.column_stack([at.real, at.imag]), rng.uniform(-np.pi, np.pi, PER_FRAME)
        ids = np.sort(rng.permutation(50)[:PER_FRAME])
        camera = Camera((IMAGE_PX, IMAGE_PX), 10 * side_px)
        pose = CameraPose((place.real, place.imag), 10.0, yaw)
        truth = project_markers(camera, pose, positions, headings, 1.0, card_side(DICTIONARY))
        assert truth.whole.all()
        seen = detector.detect(renderer.render(Shot(camera, pose, ids, positions, headings)))
        row = np.searchsorted(ids, seen.ids).clip(max=PER_FRAME - 1)
        offset = seen.centers_px - truth.centers_px[row]
        right = (ids[row] == seen.ids) & (np.linalg.norm(offset, axis=1) < side_px / 2)
        turn = wrap(seen.headings_rad - (yaw - headings[row]))  # image angles are clockwise from above
        found, false = found + int(right.sum()), false + int((~right).sum())
        errors.append(np.column_stack([offset, turn])[right])
        covariances.append(seen.covariances[right])
        sides.append(seen.sides_px[right])
    return Measured(
        side_px,
        found / (frames * PER_FRAME),
        false,
        np.concatenate(errors),
        np.concatenate(covariances),
        np.concatenate(sides),
    )


@pytest.fixture(scope="module", params=[4, pytest.param(6, marks=pytest.mark.slow)])
def measured(renderer: Renderer, request: pytest.FixtureRequest) -> dict[float, Measured]:
    return {side: measure(renderer, side, request.param, 1) for side in SIDES_PX}


def check_sides(results: list[Measured]) -> None:
    """Check a bias of at most 1 %. The standard error of 60 markers is 0.12 % at 15 px, and less above."""
    bias = {r.side_px: r.sides_px.mean() / r.side_px - 1 for r in results}
    assert max(np.abs(list(bias.values()))) < 0.01, bias


def check_recall(results: list[Measured]) -> None:
    """Check a recall of 98 % from 18 px, for all sides together, and for each within binomial scatter.

    At a true recall of 0.98, the probability of more than 5 misses of 64 markers is below 2e-3. That of more
    than 7 misses of 96 is below 1e-3.
    """
    results = [r for r in results if r.side_px >= 18]
    recalls = {r.side_px: r.recall for r in results}
    assert np.mean(list(recalls.values())) >= 0.98, recalls
    for r in results:
        markers = r.error.shape[0] / r.recall
        assert r.recall >= 0.98 - 4 * np.sqrt(0.98 * 0.02 / markers), recalls
    assert sum(r.false for r in results) == 0


def check_covariances(results: list[Measured], kurtosis: float) -> None:
    """Check that RMS errors match the reported covariances, per side and for all sides.

    The mean square of n values of kurtosis K has the relative standard deviation sqrt((K - 1) / n). K is 3
    for normal errors. Contour-fitted corners have heavier tails, rarely of a pixel. The tolerance is 4.5
    standard deviations, plus 15 % for the table. It is linear between sides, and measured on 1600 markers a
    side.
    """
    total, count = 0.0, 0
    for r in results:
        variance = np.einsum("nii->ni", r.covariances)
        squares = r.error**2 / variance
        n = squares.shape[0]
        for name, values in (("position", squares[:, :2].ravel()), ("heading", squares[:, 2])):
            allowed = 1.15 + 4.5 * np.sqrt((kurtosis - 1) / values.size)
            assert values.mean() < allowed, f"{name} at {r.side_px} px: NEES {values.mean():.2f}"
            assert values.mean() > 1 / allowed, (
                f"{name} at {r.side_px} px: covariance too large, {values.mean():.2f}"
            )
        total, count = total + squares.sum(), count + 3 * n
    allowed = 1.15 + 4.5 * np.sqrt((kurtosis - 1) / count)
    assert 1 / allowed < total / count < allowed


def test_marker_sides_are_unbiased_to_one_percent(measured) -> None:
    check_sides(list(measured.values()))


def test_recall_is_98_percent_from_18_px(measured) -> None:
    check_recall(list(measured.values()))


def test_centre_errors_match_the_accuracy_table(measured) -> None:
    """The share of squared errors below the 90 % quantile of chi-square is at least 0.9.

    For normal errors, the squared errors of u and v over the table's variance have a chi-square distribution
    with 2 degrees of freedom, and 90 % are below 4.61. The tolerance is 5 binomial standard deviations.
    Heavier tails at the same RMS increase the share.
    """
    table = load_accuracy("photometric")
    for r in measured.values():
        std = np.interp(r.side_px, table.sides_px, table.position_std_px)
        squares = np.sum(r.error[:, :2] ** 2, axis=1) / std**2
        share = np.mean(squares < chdtri(2, 0.1))
        assert share > 0.9 - 5 * np.sqrt(0.09 / squares.size), f"{r.side_px} px"


def test_covariances_match_the_errors(measured) -> None:
    check_covariances(list(measured.values()), kurtosis=20.0)


@pytest.mark.slow
def test_full_measurement_meets_all_requirements(renderer) -> None:
    """100 frames, 1600 markers a side, as for the accuracy table."""
    results = [measure(renderer, side, 100, 2) for side in (*SIDES_PX, 20.0, 23.0, 34.0, 50.0)]
    check_sides(results)
    check_recall(results)
    check_covariances(results, kurtosis=40.0)


# --- headings ---


@pytest.mark.parametrize("yaw", [0.0, 1.2, -2.5])
def test_robot_driving_forward_moves_along_its_image_heading(renderer, yaw) -> None:
    """Detections before and after 2 m (50 px) ahead: the displacement has the direction of the heading.

    Centre errors of 0.035 px over 50 px are 0.06 deg, and heading errors 0.25 deg. The tolerance of 1.5 deg
    is 6 standard deviations.
    """
    camera, pose = Camera((IMAGE_PX, IMAGE_PX), 250.0), CameraPose((3.0, -1.0), 10.0, yaw)
    ids, headings = np.array([1, 5, 9, 30]), np.array([0.1, 1.9, -2.4, -1.0])
    start = np.array([[0.0, -1.0], [6.0, -1.0], [3.0, 4.0], [3.0, -6.0]])
    ahead = start + 2.0 * np.column_stack([np.cos(headings), np.sin(headings)])
    before, after = (
        create_detector(dictionary=DICTIONARY).detect(
            renderer.render(Shot(camera, pose, ids, positions, headings))
        )
        for positions in (start, ahead)
    )
    assert before.ids.tolist() == after.ids.tolist() == ids.tolist()
    way = after.centers_px - before.centers_px
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), 50.0, atol=0.5)
    turn = wrap(np.arctan2(way[:, 1], way[:, 0]) - before.headings_rad)
    assert np.abs(turn).max() < np.radians(1.5)


@pytest.mark.smoke
def test_corners_0_and_1_are_front_left_and_front_right(renderer) -> None:
    camera, pose = Camera((200, 200), 400.0), CameraPose((0.0, 0.0), 10.0)
    image = renderer.render(
        Shot(camera, pose, np.array([7]), np.zeros((1, 2)), np.array([np.pi / 2]))
    )  # north is up in the image
    seen = create_detector(dictionary=DICTIONARY).detect(image)
    assert seen.headings_rad[0] == pytest.approx(-np.pi / 2, abs=0.02)
    np.testing.assert_allclose(
        seen.corners_px[0] - 99.5, [[-20, -20], [20, -20], [20, 20], [-20, 20]], atol=0.5
    )


def test_pose_of_corners_is_exact_on_squares() -> None:
    """Unit corners rotated by h, scaled by s and moved to c."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        c, h, s = rng.uniform(0, 800, 2), rng.uniform(-np.pi, np.pi), rng.uniform(10, 80)
        forward, right = np.array([np.cos(h), np.sin(h)]), np.array([-np.sin(h), np.cos(h)])
        corners = [c + s / 2 * (a * forward + b * right) for a, b in ((1, -1), (1, 1), (-1, 1), (-1, -1))]
        center, heading, side = pose_of_corners(np.array([corners]))
        np.testing.assert_allclose(center[0], c, atol=1e-10)
        assert wrap(heading[0] - h) == pytest.approx(0, abs=1e-12)
        assert side[0] == pytest.approx(s, rel=1e-12)


# --- invalid images, and explanations ---


def picture(renderer: Renderer, ids: list[int], *, mirrored: bool = False) -> np.ndarray:
    """Return an image 400 px wide with up to four markers of 40 px."""
    camera, pose = Camera((400, 400), 400.0, mirrored=mirrored), CameraPose((0.0, 0.0), 10.0, 0.2)
    places = np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]])[: len(ids)]
    return renderer.render(
        Shot(camera, pose, np.array(ids), places, np.array([0.0, 1.0, 2.0, 3.0])[: len(ids)])
    )


@pytest.mark.smoke
def test_mirrored_image_has_no_markers_and_an_explanation(renderer) -> None:
    detector = create_detector(dictionary=DICTIONARY)
    image = picture(renderer, [3, 12, 21, 40], mirrored=True)
    assert len(detector.detect(image)) == 0
    why = explain_mirrored(image, DICTIONARY)
    assert why is not None and "mirrored" in why and "4 in its mirror image" in why
    assert detector.detect(cv2.flip(image, 1)).ids.tolist() == [3, 12, 21, 40]


def test_four_markers_of_4x4_50_are_symmetric() -> None:
    """8, 9, 17 and 47 decode with their own ids in a mirrored image."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    alike = []
    for marker_id in range(50):
        bits = (cv2.aruco.generateImageMarker(dictionary, marker_id, 6) > 127).astype(np.uint8)[1:-1, 1:-1]
        found, read, *_ = dictionary.identify(np.ascontiguousarray(bits[:, ::-1]), 0.6)
        alike += [(marker_id, read)] if found else []
    assert alike == [(8, 8), (9, 9), (17, 17), (47, 47)]
    assert sorted(mirror_symmetric_ids("4X4_50")) == [8, 9, 17, 47]


@pytest.mark.parametrize(("ids", "is_mirrored"), [([9], False), ([8, 9, 17], False), ([8, 9, 12], True)])
def test_symmetric_markers_do_not_show_a_mirrored_image(renderer, monkeypatch, ids, is_mirrored) -> None:
    """A small one may be detected in the mirror image alone, by chance."""
    nothing, there = (
        create_detector(dictionary=DICTIONARY).detect(picture(renderer, some)) for some in ([], ids)
    )
    answers = [there, nothing]
    monkeypatch.setattr(PhotometricDetector, "detect", lambda *given: answers.pop(0))
    assert (explain_mirrored(picture(renderer, []), DICTIONARY) is not None) == is_mirrored


@pytest.mark.parametrize("name", ["triangle", "star"])
def test_run_with_a_mirrored_camera_is_refused(scenario_tree, name) -> None:
    """Also with robots 8 and 9 in view, whose markers are symmetric."""
    tree = scenario_tree(name) | {"duration_s": 0.1}
    for unit in tree["units"]:
        unit["camera"]["mirrored"] = True
    with pytest.raises(InputError, match="mirrored"):
        list(run_steps(make_mission(tree)))


def test_empty_image_is_not_explained_as_mirrored(renderer) -> None:
    detector = create_detector(dictionary=DICTIONARY)
    image = picture(renderer, [])
    assert len(detector.detect(image)) == 0
    assert explain_mirrored(image, DICTIONARY) is None


def test_repeated_id_is_left_out(renderer) -> None:
    seen = create_detector(dictionary=DICTIONARY).detect(picture(renderer, [3, 8, 3, 40]))
    assert seen.ids.tolist() == [8, 40]


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((40, 40, 3), np.uint8),
        np.zeros((40, 40), np.float32),
        np.zeros((40, 40), np.uint16),
        np.zeros(40, np.uint8),
        np.zeros((0, 40), np.uint8),
    ],
    ids=["colour", "float", "16 bits", "one row", "empty"],
)
def test_images_other_than_grey_uint8_are_refused(image) -> None:
    with pytest.raises(InputError, match=r"grey, \(height, width\), uint8"):
        create_detector(dictionary=DICTIONARY).detect(image)


def test_unknown_detector_or_dictionary_error_lists_valid_names() -> None:
    with pytest.raises(InputError, match="no detector 'yolo'; one of apriltag3, locus-tag"):
        create_detector("yolo")
    with pytest.raises(InputError, match="no dictionary '9X9_1'") as raised:
        create_detector(dictionary="9X9_1").detect(np.zeros((40, 40), np.uint8))
    assert all(name in str(raised.value) for name in dictionary_names())


def test_detection_does_not_change_the_image(renderer) -> None:
    image = picture(renderer, [3, 8])
    before = image.copy()
    create_detector(dictionary=DICTIONARY).detect(image)
    np.testing.assert_array_equal(image, before)


def test_one_detector_accepts_images_of_several_sizes(renderer) -> None:
    """The same markers are found in a small image and in a larger image around it."""
    detector = create_detector(dictionary=DICTIONARY)
    small = picture(renderer, [3, 8])
    large = np.full((1200, 1600), 128, np.uint8)
    large[500:900, 700:1100] = small
    one, other = detector.detect(small), detector.detect(large)
    assert one.ids.tolist() == other.ids.tolist() == [3, 8]
    np.testing.assert_allclose(other.centers_px - [700, 500], one.centers_px, atol=0.1)
    assert detector.detect(small).centers_px.tolist() == one.centers_px.tolist()


def test_detections_have_unit_time_and_image_size(renderer) -> None:
    seen: Detections = create_detector(dictionary=DICTIONARY).detect(
        picture(renderer, [3]), time_s=2.5, unit_id=4
    )
    assert (seen.unit_id, seen.time_s, seen.image_size_px.tolist()) == (4, 2.5, [400, 400])
    wide = create_detector(dictionary=DICTIONARY).detect(np.zeros((30, 70), np.uint8))
    assert wide.image_size_px.tolist() == [70, 30] and len(wide) == 0


def test_controller_ignores_markers_that_are_no_robots(renderer) -> None:
    """A marker 40 that is no robot changes neither the goals nor the report."""
    template = Template(np.array([3, 8, 21]), np.array([0, 1, 1j]))
    seen = create_detector(dictionary=DICTIONARY).detect(picture(renderer, [3, 8, 21, 40]))
    assert 40 in seen.ids
    with_stray, without = (
        AerialController(template, SafetyRadius(radius=1.4), Hover()).step(detections)
        for detections in (seen, seen.select([3, 8, 21]))
    )
    assert with_stray.report.ids.tolist() == with_stray.report.controlled_ids.tolist() == [3, 8, 21]
    np.testing.assert_array_equal(with_stray.goals.rho_px, without.goals.rho_px)
    np.testing.assert_array_equal(with_stray.goals.neighbor_ids, without.goals.neighbor_ids)
