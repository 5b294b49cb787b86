"""Wrapped detectors of other libraries: corner order, heading, biases, and errors."""

import builtins
from functools import cache

import cv2
import numpy as np
import pytest

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import rendered_frames
from skyherd.bench.detectors.scorer import match
from skyherd.errors import InputError
from skyherd.geometry import apply_homography, wrap_angle
from skyherd.markers.dictionary import marker_cells, pose_of_corners
from skyherd.vision import create_detector, detector_names
from skyherd.vision.detectors import peers
from skyherd.vision.detectors.peers import (
    APRILTAG_FAMILIES,
    LOCUS_FAMILIES,
    REFINEMENTS,
    PeerDetector,
    headings_in_plane,
    peer_names,
)

LIBRARIES = {"apriltag3": "pupil_apriltags", "locus-tag": "locus", "napa": "napa_vision"}
DICTIONARIES = [
    *((name, "4X4_50") for name in REFINEMENTS),
    *(("apriltag3", family) for family in APRILTAG_FAMILIES),
    *(("locus-tag", family) for family in LOCUS_FAMILIES),
    *(("napa", family) for family in APRILTAG_FAMILIES),
]
BIAS_PX = {
    "opencv": 0.0,
    "opencv-subpix": 0.0,
    "opencv-contour": 0.0,
    "opencv-apriltag": 0.46,
    "apriltag3": 0.5,
    "locus-tag": 0.5,
    "napa": 0.0,
}


@cache
def frames(dictionary, count):
    """Return `count` frames of 16 markers from each of two cameras."""
    return list(rendered_frames(Cell(noise=2.0, blur_px=0.8, cameras=2, frames=count), dictionary, 5))


def errors(name, dictionary, count, *, corrected):
    """Return the errors (N, 4) of u, v, heading and side, and the corner distances (N, 4), px."""
    if name in LIBRARIES:
        pytest.importorskip(LIBRARIES[name])
    detector = PeerDetector(name, dictionary, corrected=corrected)
    poses, corners = [], []
    for frame in frames(dictionary, count):
        seen = detector.detect(frame.image)
        answers, rows = match(frame, seen)
        shift = seen.centers_px[answers] - frame.centers_px[rows]
        turn = wrap_angle(seen.headings_rad[answers] - frame.headings_rad[rows])
        grow = seen.sides_px[answers] - frame.sides_px[rows]
        poses.append(np.column_stack([shift, turn, grow]))
        forward = frame.sides_px[rows] * np.exp(1j * frame.headings_rad[rows])
        true = frame.centers_px[rows] @ [1, 1j]
        true = true[:, None] + forward[:, None] * np.array([0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j, -0.5 - 0.5j])
        corners.append(np.abs(seen.corners_px[answers] @ [1, 1j] - true))
    return np.concatenate(poses), np.concatenate(corners)


IN_FRAMES = pytest.mark.parametrize(
    ("count", "least", "bias_px"), [(2, 56, 0.07), pytest.param(3, 85, 0.05, marks=pytest.mark.slow)]
)
"""Frames per camera, minimum number of detected markers, and tolerance of the mean position, px.

The largest standard deviation is 0.18 px: three standard errors are 0.07 px for 61 markers and 0.055 px for
96.
"""


@IN_FRAMES
@pytest.mark.parametrize(("name", "dictionary"), DICTIONARIES)
def test_corrected_peers_match_ground_truth(name, dictionary, count, least, bias_px):
    """Corners in the package's order to a pixel; a wrong order gives errors of a side, 30 px.

    Position without bias within the tolerance, heading to 2 deg, and side to half a pixel, because its bias
    depends on the side by up to that.
    """
    error, corners = errors(name, dictionary, count, corrected=True)
    assert len(error) > least
    assert np.median(corners) < 1.0 and np.percentile(corners, 95) < 2.0
    assert np.abs(error[:, :2].mean(axis=0)).max() < bias_px
    assert np.degrees(np.abs(error[:, 2])).mean() < 2.0
    assert abs(error[:, 3].mean()) < 0.5


@IN_FRAMES
@pytest.mark.parametrize(("name", "dictionary"), [*DICTIONARIES[:5], DICTIONARIES[7], DICTIONARIES[12]])
def test_uncorrected_peers_keep_their_biases(name, dictionary, count, least, bias_px):
    """Position biases as in the table. AprilTag's headings differ by 180 degrees, OpenCV's do not."""
    error, _ = errors(name, dictionary, count, corrected=False)
    assert len(error) > least
    np.testing.assert_allclose(error[:, :2].mean(axis=0), BIAS_PX[name], atol=bias_px)
    half_turn = np.cos(error[:, 2]).mean()
    assert half_turn == pytest.approx(-1.0 if name == "apriltag3" else 1.0, abs=0.01)
    assert error[:, 3].mean() < 0.02


def test_peers_have_names_and_report_no_covariance():
    assert set(peer_names()) <= set(detector_names())
    frame = next(rendered_frames(Cell(cameras=1, frames=1), "4X4_50", 1))
    seen = create_detector("opencv").detect(frame.image, time_s=1.5, unit_id=3)
    assert len(seen) > 10 and not seen.covariances.any()
    assert (seen.time_s, seen.unit_id) == (1.5, 3)
    raw = create_detector("opencv-apriltag", corrected=False).detect(frame.image)
    same = create_detector("opencv-apriltag").detect(frame.image)
    np.testing.assert_allclose((raw.centers_px - same.centers_px), BIAS_PX["opencv-apriltag"], atol=0.03)


def test_headings_in_a_tilted_plane_match_the_forward_axes():
    """Exact corners at 15 deg: below 0.2 deg (second order in the tilt), above 1 deg without the plane."""
    tilt = np.radians(15.0)
    c, s = np.cos(tilt), np.sin(tilt)
    seen = np.array([[1.0, 0, 0], [0, c, -s], [0, s / 600, c]])
    rng = np.random.default_rng(2)
    centers, turns = rng.uniform(-150, 150, (16, 2)), np.exp(1j * rng.uniform(-3, 3, 16))
    square = turns[:, None] * 30 * np.array([0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j, -0.5 - 0.5j])
    corners = centers[:, None] + np.stack([square.real, square.imag], axis=-1)
    ahead = centers + 1e-3 * np.column_stack([turns.real, turns.imag])
    true = apply_homography(seen, ahead) - apply_homography(seen, centers)
    true = np.arctan2(true[:, 1], true[:, 0])
    image = apply_homography(seen, corners)
    assert np.degrees(np.abs(wrap_angle(headings_in_plane(image) - true))).max() < 0.2
    assert np.degrees(np.abs(wrap_angle(pose_of_corners(image)[1] - true))).max() > 1.0
    assert headings_in_plane(image[:0]).shape == (0,)


def test_largest_quad_of_a_repeated_id_is_kept():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners = np.stack([10 * square, 20 * square, 5 * square])
    ids, kept = peers._largest_of_each(np.array([7, 7, 3]), corners)
    np.testing.assert_array_equal(ids, [3, 7])
    np.testing.assert_array_equal(kept, corners[[2, 1]])


def test_peers_accept_empty_scenes_and_refuse_colour_images():
    for name in peer_names()[:4]:
        assert len(create_detector(name).detect(np.full((90, 120), 128, np.uint8))) == 0
    with pytest.raises(InputError, match="grey"):
        create_detector("opencv").detect(np.zeros((9, 9, 3), np.uint8))


@pytest.mark.parametrize(("name", "library"), LIBRARIES.items())
def test_missing_library_or_dictionary_gives_input_error(name, library, monkeypatch):
    with pytest.raises(InputError, match=r"does not know 5X5_50; one of .*APRILTAG_16h5"):
        create_detector(name, dictionary="5X5_50")

    def absent(asked, *args, **kwargs):
        if asked == library:
            raise ImportError(asked)
        return builtins.__import__(asked, *args, **kwargs)

    monkeypatch.setattr(peers, "import_module", absent)
    peers._apriltag_library_detector.cache_clear()
    with pytest.raises(InputError, match=r"pip install (skyherd\[peers\]|napa-vision)$"):
        create_detector(name, dictionary="APRILTAG_36h11")
    peers._apriltag_library_detector.cache_clear()


@pytest.mark.parametrize("name", ["opencv", "opencv-apriltag", "apriltag3", "locus-tag"])
def test_find_all_reports_repeats_and_detect_the_largest(name):
    """Two markers of id 3, of 60 and 90 px, and one of id 5. The corners equal those of `detect`."""
    if name in LIBRARIES:
        pytest.importorskip(LIBRARIES[name])
    image = np.full((240, 420), 220, np.uint8)
    for marker_id, side, left in ((3, 60, 30), (3, 90, 140), (5, 80, 290)):
        cells = marker_cells("APRILTAG_36h11", marker_id)
        drawn = cv2.resize(cells.astype(np.uint8), (side, side), interpolation=cv2.INTER_NEAREST_EXACT)
        image[70 : 70 + side, left : left + side] = np.where(drawn, 220, 30)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    detector = PeerDetector(name, "APRILTAG_36h11")
    ids, corners = detector.find_all(image)
    assert sorted(ids.tolist()) == [3, 3, 5]
    seen = detector.detect(image)
    for marker_id, center in ((3, (184.5, 114.5)), (5, (329.5, 109.5))):
        row = int(np.flatnonzero(seen.ids == marker_id)[0])
        np.testing.assert_allclose(seen.centers_px[row], center, atol=1.0)
        assert min(np.abs(seen.corners_px[row] - one).max() for one in corners) < 1e-9
