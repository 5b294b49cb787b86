"""One frame from several cameras, and of a moving camera, against exact poses."""

import numpy as np
import pytest
from pose_scenes import CALIBRATIONS, drawn_corners
from scipy.spatial.transform import Rotation

from skyherd.errors import InputError
from skyherd.poses import Calibration, View, common_frame, locate_camera
from skyherd.poses.marker_poses import pose_difference
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.render.camera.camera import rotation_camera_world
from skyherd.vision import create_detector, measure_outlines

SIDE_M = 0.1
"""Side of the markers, m."""


def looking_down(rng, x_m, y_m, height_m=1.6, tilt_deg=25.0):
    """Return the map (R, t) from the frame to a camera above (x, y), tilted in a random direction."""
    azimuth = rng.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    down = Rotation.from_euler("x", np.pi).as_matrix()
    turn = Rotation.from_rotvec(np.radians(tilt_deg) * axis).as_matrix() @ down
    return turn, -turn @ np.array([x_m, y_m, height_m])


def world(rng, count=8, flat=False):
    """Return poses of markers in the frame of marker 0, by id."""
    markers = {0: (np.eye(3), np.zeros(3))}
    for marker in range(1, count):
        turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
        if not flat:
            turn = Rotation.from_rotvec(0.2 * rng.normal(size=3)).as_matrix() @ turn
        place = np.array([*rng.uniform(-0.4, 0.4, 2), 0.0 if flat else rng.uniform(-0.05, 0.05)])
        markers[marker] = turn, place
    return markers


def view_of(rng, name, camera, markers, ids, std_px=0.01, model="pinhole"):
    """Return a view with noisy corners of the markers `ids`."""
    turn, shift = camera
    drawn = []
    for marker in ids:
        rotation, place = markers[marker]
        pose = turn @ rotation, turn @ place + shift
        drawn.append(drawn_corners(rng, *pose, CALIBRATIONS[model], SIDE_M, std_px))
    corners, covariances = (np.array(part) for part in zip(*drawn, strict=True))
    return View(name, CALIBRATIONS[model], np.array(ids), corners, covariances)


def frame_errors(frame, markers, cameras):
    """Return the errors (6 M + 6 V,) of a frame against exact poses."""
    errors = [pose_difference(frame.rotations[row], frame.positions_m[row], *markers[int(marker)])
              for row, marker in enumerate(frame.ids)]  # fmt: skip
    errors += [
        pose_difference(frame.camera_rotations[v], frame.camera_positions_m[v], turn.T, -turn.T @ shift)
        for v, (turn, shift) in enumerate(cameras)
    ]
    return np.concatenate(errors)


@pytest.mark.parametrize("coplanar", [False, True])
def test_frame_of_three_cameras_matches_its_covariance(coplanar) -> None:
    """Over six teams of three cameras the mean NEES is that of the unknowns, within four deviations."""
    values, freedoms = [], 0
    for seed in range(6):
        rng = np.random.default_rng([seed, coplanar])
        markers = world(rng, flat=coplanar)
        cameras = [looking_down(rng, *place) for place in ((-0.3, 0.0), (0.3, 0.1), (0.0, -0.3))]
        # No marker is in all three views.
        seen = [[0, 1, 2, 3, 4], [3, 4, 5, 6, 7], [0, 2, 5, 7]]
        views = [view_of(rng, f"camera {k}", *given, ids) for k, (given, ids) in enumerate(
            zip(((c, markers) for c in cameras), seen, strict=True))]  # fmt: skip
        frame = common_frame(views, SIDE_M, reference=0, coplanar=coplanar)
        assert frame.consistent and frame.ids.tolist() == list(range(8))
        errors = frame_errors(frame, markers, cameras)
        known = np.diag(frame.covariance) > 0
        np.testing.assert_allclose(errors[~known], 0, atol=1e-9)
        values.append(errors[known] @ np.linalg.solve(frame.covariance[np.ix_(known, known)], errors[known]))
        freedoms = int(known.sum())
        positions = errors.reshape(-1, 6)[:, :3] / np.sqrt(np.maximum(
            np.diag(frame.covariance).reshape(-1, 6)[:, :3], 1e-18))  # fmt: skip
        assert np.abs(positions[np.diag(frame.covariance).reshape(-1, 6)[:, :3] > 0]).max() < 4.5
    assert freedoms == (7 * (3 if coplanar else 6) + 18)
    assert np.mean(values) == pytest.approx(freedoms, abs=4 * np.sqrt(2 * freedoms / 6))


def test_marker_that_moved_makes_the_frame_inconsistent() -> None:
    rng = np.random.default_rng(3)
    markers, moved = world(rng), None
    moved = {**markers, 3: (markers[3][0], markers[3][1] + [0.005, 0, 0])}
    views = [
        view_of(rng, "left", looking_down(rng, -0.2, 0), markers, [0, 1, 3]),
        view_of(rng, "right", looking_down(rng, 0.2, 0), moved, [0, 1, 3]),
    ]
    assert not common_frame(views, SIDE_M).consistent
    assert common_frame([view.select([0, 1]) for view in views], SIDE_M).consistent


def test_pose_in_camera_is_consistent_with_the_frame() -> None:
    rng = np.random.default_rng(4)
    markers, camera = world(rng, flat=True), looking_down(rng, 0, 0)
    values = []
    for _ in range(12):
        view = view_of(rng, "camera", camera, markers, list(range(8)), model="plumb_bob")
        frame = common_frame([view], SIDE_M, coplanar=True)
        turns, shifts, covariances = frame.in_camera(0)
        for row, (rotation, place) in markers.items():
            off = pose_difference(
                turns[row], shifts[row], camera[0] @ rotation, camera[0] @ place + camera[1]
            )
            values.append(off @ np.linalg.solve(covariances[row], off))
    # The eight markers of an image share the error of their plane: 12 independent images.
    assert np.mean(values) == pytest.approx(6, abs=4 * np.sqrt(12 / 12))


def test_moving_camera_is_located_in_the_frame_of_fixed_markers() -> None:
    rng = np.random.default_rng(5)
    values = []
    for _ in range(10):
        markers = world(rng)
        first = [
            view_of(rng, f"image {k}", looking_down(rng, 0.2 * k, 0), markers, [0, 1, 2]) for k in range(2)
        ]
        frame = common_frame(first, SIDE_M, reference=0)
        for k in range(5):
            camera = looking_down(rng, 0.1 * k, -0.2)
            # Markers 5 and 6 are robots: the frame does not have them.
            view = view_of(rng, "image", camera, markers, [1, 2, 5, 6])
            rotation, position, covariance = locate_camera(view, frame, SIDE_M)
            off = pose_difference(rotation, position, camera[0].T, -camera[0].T @ camera[1])
            values.append(off @ np.linalg.solve(covariance, off))
    # The five images of a frame share its errors: at least 10 independent ones.
    assert np.mean(values) == pytest.approx(6, abs=4 * np.sqrt(12 / 10))
    view = view_of(rng, "image 9", camera, markers, [5, 6])
    with pytest.raises(InputError, match="image 9: shows no marker of the frame"):
        locate_camera(view, frame, SIDE_M)


def test_cameras_without_a_shared_marker_are_one_line() -> None:
    rng = np.random.default_rng(6)
    markers = world(rng)
    views = [
        view_of(rng, "left", looking_down(rng, -0.2, 0), markers, [0, 1]),
        view_of(rng, "right", looking_down(rng, 0.2, 0), markers, [2, 3]),
    ]
    with pytest.raises(InputError, match="right: shares no marker"):
        common_frame(views, SIDE_M, reference=0)
    with pytest.raises(InputError, match="marker 9 is in no view"):
        common_frame(views[:1], SIDE_M, reference=9)
    with pytest.raises(InputError, match="show no marker"):
        common_frame([], SIDE_M)


def test_ambiguous_markers_are_decided_by_both_views() -> None:
    """Far markers look alike in two poses; the frame has the one that both views agree on."""
    rng = np.random.default_rng(8)
    for _ in range(2):
        markers = world(rng, count=3, flat=False)
        cameras = [looking_down(rng, *place, height_m=4.0) for place in ((-0.8, 0.0), (0.8, 0.0))]
        views = [view_of(rng, "one", camera, markers, [0, 1, 2], std_px=0.05) for camera in cameras]
        frame = common_frame(views, SIDE_M, reference=0)
        for row, marker in enumerate(frame.ids):
            off = pose_difference(frame.rotations[row], frame.positions_m[row], *markers[int(marker)])
            # The wrong one of two solutions is off by twice its tilt, 50 degrees.
            assert frame.consistent and np.degrees(np.linalg.norm(off[3:])) < 15


def test_three_rendered_cameras_agree_on_one_frame() -> None:
    """Errors of positions and angles of markers and cameras are within three standard deviations."""
    rng = np.random.default_rng(11)
    positions = np.array([[0.0, 0.0], [0.35, 0.1], [-0.3, 0.15], [0.1, -0.3], [-0.25, -0.25], [0.3, 0.35]])
    headings = np.array([0.0, 0.5, 2.0, -1.0, 3.0, 1.0])
    views, cameras = [], []
    for k, (place, tilt_deg) in enumerate((((-0.9, 0.0), -30.0), ((0.0, -0.9), 25.0), ((0.1, 0.0), 5.0))):
        camera = Camera((640, 480), focal_px=800.0)
        tilt = (0.0, np.radians(tilt_deg)) if k == 0 else (np.radians(-tilt_deg), 0.0)
        pose = CameraPose(place, 1.7, 0.0, tilt)
        renderer = Renderer("4X4_50", SIDE_M, Ground(1), Sensor(2.0, rng))
        image = renderer.render(Shot(camera, pose, np.arange(6), positions, headings))
        found = create_detector("photometric").detect(image)
        assert len(found) == 6
        calibration = Calibration((640, 480), camera.intrinsic_matrix(), np.zeros(0))
        views.append(View(f"camera {k}", calibration, found.ids, *measure_outlines(image, found, "4X4_50")))
        turn = rotation_camera_world(pose)
        cameras.append((turn, -turn @ np.array([*pose.position_m, pose.height_m])))
    markers = {
        k: (Rotation.from_euler("z", heading).as_matrix(), np.array([*position, 0.0]))
        for k, (position, heading) in enumerate(zip(positions, headings, strict=True))
    }
    frame = common_frame(views, SIDE_M, reference=0, coplanar=True)
    assert frame.consistent
    errors = frame_errors(frame, markers, cameras)
    known = np.diag(frame.covariance) > 0
    sigmas = errors[known] / np.sqrt(np.diag(frame.covariance)[known])
    assert np.abs(sigmas).max() < 3
    # Millimetres at 1.7 m: a frame that is only loosely consistent would not be that accurate.
    assert np.linalg.norm(errors.reshape(-1, 6)[:, :3], axis=1).max() < 2e-3
