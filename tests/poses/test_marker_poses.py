"""Poses of single markers against exact poses: projections with known noise, and rendered images."""

import csv
import json

import cv2
import numpy as np
import pytest
from pose_scenes import CALIBRATIONS, drawn_corners, nees, random_pose

from skyherd.cli import main
from skyherd.inspection.metres import POSE_COLUMNS
from skyherd.poses import Calibration, marker_poses
from skyherd.poses.marker_poses import MARKER_CORNERS, lens_bend, pose_difference
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.render.camera.camera import rotation_camera_world
from skyherd.vision import create_detector, measure_outlines

SIDE_M = 0.1
"""Side of the markers, m."""


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_exact_corners_give_the_exact_pose(name) -> None:
    rng, calibration = np.random.default_rng(1), CALIBRATIONS[name]
    for tilt_deg in (0, 20, 60):
        rotation, translation = random_pose(rng, tilt_deg, distance_m=1.5)
        seen = calibration.project(SIDE_M * MARKER_CORNERS @ rotation.T + translation)
        # A detector fits straight edges; its corners are those of the homography that fits best.
        seen = seen + lens_bend(rotation, translation, calibration, SIDE_M)
        poses = marker_poses(seen[None], 1e-4 * np.eye(8)[None], calibration, SIDE_M)
        off = pose_difference(poses.rotations[0], poses.translations_m[0], rotation, translation)
        assert np.abs(off[:3]).max() < 2e-6 and np.abs(off[3:]).max() < 2e-5
        assert poses.tilts_rad()[0] == pytest.approx(np.radians(tilt_deg), abs=1e-4)


@pytest.mark.parametrize("tilt_deg", [10, 30, 60])
def test_covariances_match_errors_of_noisy_corners(tilt_deg) -> None:
    """The mean of the NEES of 300 poses is 6 within four of its standard deviations, sqrt(12 / 300)."""
    rng, calibration = np.random.default_rng(tilt_deg), CALIBRATIONS["pinhole"]
    values = []
    for _ in range(300):
        pose = random_pose(rng, tilt_deg, distance_m=1.5)
        corners, covariance = drawn_corners(rng, *pose, calibration, SIDE_M, std_px=0.01)
        poses = marker_poses(corners[None], covariance[None], calibration, SIDE_M)
        values.append(nees(pose, (poses.rotations[0], poses.translations_m[0]), poses.covariances[0]))
    assert np.mean(values) == pytest.approx(6, abs=4 * np.sqrt(12 / 300))


def test_likelihood_ratio_calibrates_the_ambiguity() -> None:
    """Of far markers the other solution is right as often as the ratio says, and both are reported."""
    rng, calibration = np.random.default_rng(7), CALIBRATIONS["pinhole"]
    wrong, expected, doubtful = 0, 0.0, 0
    for _ in range(300):
        pose = random_pose(rng, 25, distance_m=4.0)
        corners, covariance = drawn_corners(rng, *pose, calibration, SIDE_M, std_px=0.1)
        poses = marker_poses(corners[None], covariance[None], calibration, SIDE_M)
        ratio = poses.log_ratios[0]
        first = (poses.rotations[0], poses.translations_m[0])
        other = (poses.other_rotations[0], poses.other_translations_m[0])
        off, far = (np.linalg.norm(pose_difference(*one, *pose)[3:]) for one in (first, other))
        wrong, expected = wrong + int(far < off), expected + 1 / (1 + np.exp(ratio))
        doubtful += int(ratio < np.log(20))
    assert doubtful > 50
    assert wrong == pytest.approx(expected, abs=4 * np.sqrt(max(expected, 1)))


def test_pose_is_at_least_as_good_as_ippe() -> None:
    rng, calibration = np.random.default_rng(5), CALIBRATIONS["pinhole"]
    square = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]]) * SIDE_M
    ours, ippe = [], []
    for _ in range(100):
        pose = random_pose(rng, 40, distance_m=1.5)
        corners, covariance = drawn_corners(rng, *pose, calibration, SIDE_M, std_px=0.05)
        poses = marker_poses(corners[None], covariance[None], calibration, SIDE_M)
        ours.append(np.linalg.norm(poses.translations_m[0] - pose[1]))
        _, _, shift = cv2.solvePnP(square, corners, calibration.matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        ippe.append(np.linalg.norm(shift.ravel() - pose[1]))
    assert np.sqrt(np.mean(np.square(ours))) < 0.96 * np.sqrt(np.mean(np.square(ippe)))


@pytest.mark.smoke
@pytest.mark.parametrize("tilt_deg", [0, 55])
def test_poses_of_a_rendered_image_match_their_covariances(tilt_deg) -> None:
    """Six markers of 45 px on one plane: mean NEES / 6 of 36 numbers is 1 within four deviations."""
    rng = np.random.default_rng(tilt_deg)
    tilt = np.radians(tilt_deg)
    camera = Camera((700, 520), focal_px=900.0)
    pose = CameraPose((0.3, -2.0 * np.sin(tilt)), 2.0 * np.cos(tilt), 0.0, (-tilt, 0.0))
    positions = np.array([[0.0, 0.0], [0.25, 0.2], [0.6, -0.15], [0.55, 0.22], [-0.1, -0.2], [0.3, -0.2]])
    headings = rng.uniform(-np.pi, np.pi, 6)
    renderer = Renderer("4X4_50", SIDE_M, Ground(3), Sensor(2.0, rng))
    shot = Shot(camera, pose, np.arange(6), positions, headings)
    image = renderer.render(shot)
    found = create_detector("photometric").detect(image)
    assert len(found) == 6
    corners, covariances = measure_outlines(image, found, "4X4_50")
    calibration = Calibration((700, 520), camera.intrinsic_matrix(), np.zeros(0))
    poses = marker_poses(corners, covariances, calibration, SIDE_M)
    to_camera, center = rotation_camera_world(pose), np.array([*pose.position_m, pose.height_m])
    values = []
    for k, marker in enumerate(found.ids):
        c, s = np.cos(headings[marker]), np.sin(headings[marker])
        rotation = to_camera @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        translation = to_camera @ (np.array([*positions[marker], 0]) - center)
        estimate = poses.rotations[k], poses.translations_m[k]
        values.append(nees((rotation, translation), estimate, poses.covariances[k]))
    assert np.mean(values) / 6 == pytest.approx(1, abs=4 * np.sqrt(2 / 36))


def test_no_markers_give_no_poses() -> None:
    poses = marker_poses(np.zeros((0, 4, 2)), np.zeros((0, 8, 8)), CALIBRATIONS["fisheye"], SIDE_M)
    assert poses.rotations.shape == (0, 3, 3) and poses.covariances.shape == (0, 6, 6)


SCENE = CameraPose((0.0, -1.4), 2.0, 0.0, (-np.radians(35.0), 0.0))
"""A camera 2.4 m from the markers, tilted by 35 degrees."""


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """Return a picture of six markers, the calibration file beside it, and exact translations by id, m."""
    rng, camera = np.random.default_rng(2), Camera((700, 520), focal_px=900.0)
    positions = np.array([[0.0, 0.0], [0.25, 0.2], [0.5, -0.15], [-0.45, 0.22], [-0.1, -0.2], [0.3, -0.2]])
    renderer = Renderer("4X4_50", SIDE_M, Ground(3), Sensor(2.0, rng))
    image = renderer.render(Shot(camera, SCENE, np.arange(6), positions, rng.uniform(-np.pi, np.pi, 6)))
    folder = tmp_path_factory.mktemp("poses")
    cv2.imwrite(str(folder / "a.png"), image)
    storage = cv2.FileStorage(str(folder / "camera.yaml"), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 700)
    storage.write("image_height", 520)
    storage.write("camera_matrix", camera.intrinsic_matrix())
    storage.write("distortion_coefficients", np.zeros((1, 5)))
    storage.release()
    center = np.array([*SCENE.position_m, SCENE.height_m])
    return folder, {k: rotation_camera_world(SCENE) @ ([*p, 0.0] - center) for k, p in enumerate(positions)}


@pytest.mark.parametrize("options", [[], ["--one-plane"]])
def test_detect_with_a_calibration_adds_poses(picture, tmp_path, options) -> None:
    folder, true_m = picture
    arguments = ["detect", folder / "a.png", "--marker-side-m", SIDE_M, "--camera", folder / "camera.yaml",
                 "--format", "jsonl", "--out", tmp_path / "out", *options]  # fmt: skip
    with pytest.raises(SystemExit) as left:
        main([*map(str, arguments)])
    assert left.value.code == 0
    rows = [json.loads(line) for line in (tmp_path / "out" / "detections.jsonl").read_text().splitlines()]
    assert sorted(row["id"] for row in rows) == list(range(6))
    for row in rows:
        found_m = np.array([row[f"camera_{axis}_m"] for axis in "xyz"])
        stds_m = np.array([row[f"std_camera_{axis}_m"] for axis in "xyz"])
        # Rounded to 1e-4 in the table.
        assert (np.abs(found_m - true_m[row["id"]]) < 4 * stds_m + 1e-4).all()
        assert np.array(row["pose_covariance"]).shape == (6, 6)
        assert row["pose"] == ("plane" if options else "alone")
        assert (row["log_ratio"] is None) is bool(options) and ("other_pose" in row) is not bool(options)


def test_csv_has_the_poses_of_the_other_format_under_their_names(picture, tmp_path) -> None:
    folder, _ = picture
    tables = {}
    for kind in ("csv", "jsonl"):
        camera = ["--marker-side-m", SIDE_M, "--camera", folder / "camera.yaml"]
        arguments = ["detect", folder / "a.png", *camera, "--format", kind, "--out", tmp_path / kind]
        with pytest.raises(SystemExit) as left:
            main([*map(str, arguments)])
        assert left.value.code == 0
        tables[kind] = (tmp_path / kind / f"detections.{kind}").read_text()
    rows = list(csv.DictReader(tables["csv"].splitlines()))
    others = [json.loads(line) for line in tables["jsonl"].splitlines()]
    assert len(rows) == len(others) == 6
    for row, other in zip(rows, others, strict=True):
        assert {name: float(row[name]) for name in POSE_COLUMNS if name != "pose"} == {
            name: pytest.approx(other[name], abs=1e-4) for name in POSE_COLUMNS if name != "pose"
        }
        assert row["pose"] == "alone"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--camera", "camera.yaml"], "--camera: given without --marker-side-m"),
        (["--one-plane", "--marker-side-m", "0.1"], "--one-plane: given without --camera"),
        (["--camera", "absent.yaml", "--marker-side-m", "0.1"], "absent.yaml: no such file"),
        (
            ["--camera", "small.yaml", "--marker-side-m", "0.1"],
            "a.png: 700 x 520 px, calibrated at 70 x 520 px",
        ),
    ],
)
def test_bad_options_of_poses_are_one_line(picture, tmp_path, monkeypatch, capsys, options, said) -> None:
    monkeypatch.chdir(picture[0])
    text = (picture[0] / "camera.yaml").read_text()
    (picture[0] / "small.yaml").write_text(text.replace("image_width: 700", "image_width: 70"))
    with pytest.raises(SystemExit) as left:
        main(["detect", "a.png", "--out", str(tmp_path / "out"), *options])
    error = capsys.readouterr().err
    assert (
        left.value.code == 2 and said in error and error.count("\n") == 1 and not (tmp_path / "out").exists()
    )
