"""Positions on the ground in metres from a marker's side alone, on rendered images with exact truth."""

import csv

import cv2
import numpy as np
import pytest

from skyherd.cli import main
from skyherd.control import Rectifier
from skyherd.geometry import to_complex
from skyherd.poses import ground_covariances, ground_positions
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.vision import create_detector

SIDE_M, HEIGHT_M = 0.1, 2.5
"""Side of the markers and height of the camera, m; a marker has about 40 px."""

CAMERA = Camera((800, 600), focal_px=1000.0)
"""Camera of the images."""


def image_of(seed, tilt_deg):
    """Return an image of nine markers on the ground, their positions (9, 2), m, and headings (9,), rad."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid([-0.5, 0.0, 0.5], [-0.35, 0.0, 0.35]), axis=-1).reshape(-1, 2)
    positions = grid + rng.uniform(-0.08, 0.08, (9, 2))
    headings = rng.uniform(-np.pi, np.pi, 9)
    tilt = np.radians(tilt_deg)
    pose = CameraPose((0.0, -HEIGHT_M * np.tan(tilt)), HEIGHT_M, 0.0, (-tilt, 0.0))
    renderer = Renderer("4X4_50", SIDE_M, Ground(1), Sensor(2.0, rng))
    return renderer.render(Shot(CAMERA, pose, np.arange(9), positions, headings)), positions, headings


def aligned_errors(found, true):
    """Return errors (N, 2) of positions after the best rotation and shift, without any change of scale."""
    found, true = to_complex(found), to_complex(true)
    found, true = found - found.mean(), true - true.mean()
    turn = np.vdot(found, true)
    off = found * turn / abs(turn) - true
    return np.stack([off.real, off.imag], axis=1)


@pytest.mark.parametrize(("tilt_deg", "limit_m"), [(0, 5e-4), (12, 2e-3)])
def test_positions_in_metres_match_the_rendered_ground(tilt_deg, limit_m) -> None:
    image, positions, _ = image_of(1, tilt_deg)
    seen = create_detector("photometric").detect(image)
    flat = Rectifier().rectify(seen)
    assert seen.ids.tolist() == list(range(9))
    errors = aligned_errors(ground_positions(flat, SIDE_M), positions)
    assert np.linalg.norm(errors, axis=1).max() < limit_m
    # The tilted image as it is seen is wrong by far more: the side alone does not replace the rectification.
    as_seen = aligned_errors(ground_positions(seen, SIDE_M), positions)
    assert tilt_deg == 0 or np.linalg.norm(as_seen, axis=1).max() > 5 * limit_m


def test_positions_scale_with_the_side() -> None:
    image, _, _ = image_of(2, 0)
    seen = create_detector("photometric").detect(image)
    np.testing.assert_allclose(ground_positions(seen, 0.2), 2 * ground_positions(seen, 0.1))
    np.testing.assert_allclose(ground_covariances(seen, 0.2), 4 * ground_covariances(seen, 0.1))


def test_covariances_in_metres_match_the_errors() -> None:
    """A camera that looks straight down: position errors over their covariances have a mean of two."""
    squares = []
    for seed in range(6):
        image, positions, _ = image_of(10 + seed, 0)
        seen = create_detector("photometric").detect(image)
        errors = ground_positions(seen, SIDE_M) - positions[seen.ids]
        covariances = ground_covariances(seen, SIDE_M)
        squares += [e @ np.linalg.solve(c, e) for e, c in zip(errors, covariances, strict=True)]
    # 54 markers; the scale error is common to nine of them.
    assert 0.7 < np.mean(squares) / 2 < 1.5


def rows_of(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_detect_with_a_side_adds_metres(tmp_path, capsys) -> None:
    image, positions, headings = image_of(3, 0)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    with pytest.raises(SystemExit) as left:
        main(["detect", str(tmp_path / "a.png"), "--marker-side-m", "0.1", "--out", str(tmp_path / "out")])
    assert left.value.code == 0
    rows = rows_of(tmp_path / "out" / "detections.csv")
    assert len(rows) == 9
    for row in rows:
        k = int(row["id"])
        assert [float(row["x_m"]), float(row["y_m"])] == pytest.approx(positions[k].tolist(), abs=5e-4)
        off = np.angle(np.exp(1j * (np.radians(float(row["yaw_deg"])) - headings[k])))
        assert abs(off) < 0.01 and 0 < float(row["std_x_m"]) < 1e-3


@pytest.mark.parametrize("side", ["0", "-1", "nan", "inf", "1e9"])
@pytest.mark.parametrize("verb", ["detect", "track"])
def test_side_that_is_no_length_is_one_line(tmp_path, capsys, verb, side) -> None:
    with pytest.raises(SystemExit) as left:
        main([verb, str(tmp_path / "a.mp4"), "--marker-side-m", side])
    said = capsys.readouterr().err
    assert left.value.code == 2 and "--marker-side-m" in said and said.count("\n") == 1
