"""The detector on rendered frames whose truth is known, at the noise and blur its table was measured at.

Default: 4 frames of 16 markers a size. `pytest -m slow` measures 6, and 100 frames a size.
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
from skyherd.markers.dictionary import card_side, dictionary_names, pose_of_corners
from skyherd.messages import Detections
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot, project_markers
from skyherd.vision import create_detector, explain_mirrored
from skyherd.vision.detectors.accuracy import load_accuracy

DICTIONARY, IMAGE_PX, PER_FRAME = "4X4_50", 800, 16
SIDES_PX = (15.0, 16.0, 18.0, 21.0, 25.0, 30.0, 37.0, 45.0, 60.0)


def wrap(angle: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * np.asarray(angle)))


@dataclass(frozen=True)
class Measured:
    """Errors over the markers found at one true side."""

    side_px: float
    recall: float
    false: int
    error: np.ndarray  # (M, 3) u, v in px, heading in rad
    covariances: np.ndarray  # (M, 3, 3)
    sides_px: np.ndarray  # (M,) as measured


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    rng = np.random.default_rng(20)
    ground = Ground(20, sigma_px=float(np.hypot(0.8, np.sqrt(1 / 12))))
    return Renderer(DICTIONARY, 1.0, ground, Sensor(2.0, rng), psf_px=0.8)


def measure(renderer: Renderer, side_px: float, frames: int, seed: int) -> Measured:
    """Markers on a jittered grid, all cards whole, at any heading, id, yaw and place on the ground."""
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
    """The issue's figure, 1 %. The mean of 60 markers has a standard error of 0.12 % at 15 px, less above."""
    bias = {r.side_px: r.sides_px.mean() / r.side_px - 1 for r in results}
    assert max(np.abs(list(bias.values()))) < 0.01, bias


def check_recall(results: list[Measured]) -> None:
    """The issue's figure, 98 % from 18 px, over all sizes together and at each but for binomial scatter.

    At a true recall of 0.98, 64 markers lose more than 5 with a chance under 2e-3, 96 more than 7 under 1e-3.
    """
    results = [r for r in results if r.side_px >= 18]
    recalls = {r.side_px: r.recall for r in results}
    assert np.mean(list(recalls.values())) >= 0.98, recalls
    for r in results:
        markers = r.error.shape[0] / r.recall
        assert r.recall >= 0.98 - 4 * np.sqrt(0.98 * 0.02 / markers), recalls
    assert sum(r.false for r in results) == 0


def check_covariances(results: list[Measured], kurtosis: float) -> None:
    """RMS errors are those the table states, in position and in heading, at every size and over all.

    For n values of kurtosis K the mean square scatters by sqrt((K - 1) / n); K = 2 + 1 is normal, and
    chi-square. Contour-fitted corners have heavier tails, rarely by a pixel. 4.5 such deviations, and 15 %
    for the table: it is linear between sizes, and itself measured on 1600 markers a size.
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


def test_centres_are_within_the_shipped_tables_rms(measured) -> None:
    """Chi-square of the centres: the bulk (90 % of the markers, without the tails) against its quantile.

    Squared errors of u and v over the table's variance are chi-square of 2 degrees of freedom for normal
    errors, 90 % of them below 4.61. The share below is then 0.9 but for 5 binomial deviations; tails
    heavier than normal at the same RMS only put more into the bulk.
    """
    table = load_accuracy("photometric")
    for r in measured.values():
        std = np.interp(r.side_px, table.sides_px, table.position_std_px)
        squares = np.sum(r.error[:, :2] ** 2, axis=1) / std**2
        share = np.mean(squares < chdtri(2, 0.1))
        assert share > 0.9 - 5 * np.sqrt(0.09 / squares.size), f"{r.side_px} px"


def test_covariances_are_honest(measured) -> None:
    check_covariances(list(measured.values()), kurtosis=20.0)


@pytest.mark.slow
def test_the_full_measurement(renderer) -> None:
    """100 frames a size: 1600 markers, as the shipped table was measured."""
    results = [measure(renderer, side, 100, 2) for side in (*SIDES_PX, 20.0, 23.0, 34.0, 50.0)]
    check_sides(results)
    check_recall(results)
    check_covariances(results, kurtosis=40.0)


# --- headings ---


@pytest.mark.parametrize("yaw", [0.0, 1.2, -2.5])
def test_robot_driving_forward_moves_along_its_image_heading(renderer, yaw) -> None:
    """Detected before and after 2 m (50 px) ahead: the way points along the detected headings.

    Centres of 0.035 px over 50 px leave 0.06 deg, headings themselves 0.25 deg: 6 deviations are 1.5 deg.
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
def test_corners_zero_and_one_lie_ahead_left_then_right(renderer) -> None:
    camera, pose = Camera((200, 200), 400.0), CameraPose((0.0, 0.0), 10.0)
    image = renderer.render(
        Shot(camera, pose, np.array([7]), np.zeros((1, 2)), np.array([np.pi / 2]))
    )  # north: image up
    seen = create_detector(dictionary=DICTIONARY).detect(image)
    assert seen.headings_rad[0] == pytest.approx(-np.pi / 2, abs=0.02)
    np.testing.assert_allclose(
        seen.corners_px[0] - 99.5, [[-20, -20], [20, -20], [20, 20], [-20, 20]], atol=0.5
    )


def test_pose_of_corners_is_the_least_squares_square() -> None:
    """Exact on squares: unit corners turned by h, scaled by s, moved to c."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        c, h, s = rng.uniform(0, 800, 2), rng.uniform(-np.pi, np.pi), rng.uniform(10, 80)
        forward, right = np.array([np.cos(h), np.sin(h)]), np.array([-np.sin(h), np.cos(h)])
        corners = [c + s / 2 * (a * forward + b * right) for a, b in ((1, -1), (1, 1), (-1, 1), (-1, -1))]
        center, heading, side = pose_of_corners(np.array([corners]))
        np.testing.assert_allclose(center[0], c, atol=1e-10)
        assert wrap(heading[0] - h) == pytest.approx(0, abs=1e-12)
        assert side[0] == pytest.approx(s, rel=1e-12)


# --- what must not be detected, and what must be said ---


def picture(renderer: Renderer, ids: list[int], *, mirrored: bool = False) -> np.ndarray:
    """Up to four markers of 40 px in an image 400 px wide."""
    camera, pose = Camera((400, 400), 400.0, mirrored=mirrored), CameraPose((0.0, 0.0), 10.0, 0.2)
    places = np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]])[: len(ids)]
    return renderer.render(
        Shot(camera, pose, np.array(ids), places, np.array([0.0, 1.0, 2.0, 3.0])[: len(ids)])
    )


@pytest.mark.smoke
def test_a_mirrored_stream_decodes_nothing_and_that_is_said(renderer) -> None:
    detector = create_detector(dictionary=DICTIONARY)
    image = picture(renderer, [3, 12, 21, 40], mirrored=True)
    assert len(detector.detect(image)) == 0
    why = explain_mirrored(image, DICTIONARY)
    assert why is not None and "mirrored" in why and "4 in its mirror image" in why
    assert detector.detect(cv2.flip(image, 1)).ids.tolist() == [3, 12, 21, 40]


def test_some_markers_of_4x4_50_are_their_own_mirror_image() -> None:
    """8, 9, 17 and 47 decode in a mirrored stream as themselves: it need not look empty."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    alike = []
    for marker_id in range(50):
        bits = (cv2.aruco.generateImageMarker(dictionary, marker_id, 6) > 127).astype(np.uint8)[1:-1, 1:-1]
        found, read, *_ = dictionary.identify(np.ascontiguousarray(bits[:, ::-1]), 0.6)
        alike += [(marker_id, read)] if found else []
    assert alike == [(8, 8), (9, 9), (17, 17), (47, 47)]


@pytest.mark.parametrize("name", ["triangle", "star"])
def test_a_run_through_a_mirrored_camera_is_refused(scenario_tree, name) -> None:
    """Also where robots 8 and 9 are in view, whose markers are their own mirror images."""
    tree = scenario_tree(name) | {"duration_s": 0.1}
    for unit in tree["units"]:
        unit["camera"]["mirrored"] = True
    with pytest.raises(InputError, match="mirrored"):
        list(run_steps(make_mission(tree)))


def test_an_empty_image_is_not_explained_away(renderer) -> None:
    detector = create_detector(dictionary=DICTIONARY)
    image = picture(renderer, [])
    assert len(detector.detect(image)) == 0
    assert explain_mirrored(image, DICTIONARY) is None


def test_an_id_that_is_seen_twice_is_left_out(renderer) -> None:
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
def test_only_grey_images_of_8_bits_are_taken(image) -> None:
    with pytest.raises(InputError, match=r"grey, \(height, width\), uint8"):
        create_detector(dictionary=DICTIONARY).detect(image)


def test_unknown_detector_or_dictionary_error_lists_valid_names() -> None:
    with pytest.raises(InputError, match="no detector 'yolo'; one of apriltag3, locus-tag"):
        create_detector("yolo")
    with pytest.raises(InputError, match="no dictionary '9X9_1'") as raised:
        create_detector(dictionary="9X9_1").detect(np.zeros((40, 40), np.uint8))
    assert all(name in str(raised.value) for name in dictionary_names())


def test_detecting_does_not_change_the_image(renderer) -> None:
    image = picture(renderer, [3, 8])
    before = image.copy()
    create_detector(dictionary=DICTIONARY).detect(image)
    np.testing.assert_array_equal(image, before)


def test_one_detector_serves_images_of_several_sizes(renderer) -> None:
    """Settings are in pixels: the same marker is found in a small picture and in a large one around it."""
    detector = create_detector(dictionary=DICTIONARY)
    small = picture(renderer, [3, 8])
    large = np.full((1200, 1600), 128, np.uint8)
    large[500:900, 700:1100] = small
    one, other = detector.detect(small), detector.detect(large)
    assert one.ids.tolist() == other.ids.tolist() == [3, 8]
    np.testing.assert_allclose(other.centers_px - [700, 500], one.centers_px, atol=0.1)
    assert detector.detect(small).centers_px.tolist() == one.centers_px.tolist()


def test_detections_carry_their_unit_time_and_size(renderer) -> None:
    seen: Detections = create_detector(dictionary=DICTIONARY).detect(
        picture(renderer, [3]), time_s=2.5, unit_id=4
    )
    assert (seen.unit_id, seen.time_s, seen.image_size_px.tolist()) == (4, 2.5, [400, 400])
    wide = create_detector(dictionary=DICTIONARY).detect(np.zeros((30, 70), np.uint8))
    assert wide.image_size_px.tolist() == [70, 30] and len(wide) == 0


def test_controller_ignores_markers_that_are_no_robots(renderer) -> None:
    """A stray marker 40 in view changes neither goals nor flight nor what is reported."""
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
