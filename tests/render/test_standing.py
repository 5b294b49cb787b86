"""Markers on robots in space: their images against projections of points in three dimensions."""

import numpy as np
import pytest
from five_markers import CUBE

from skyherd.datasets import RobotMarkerModel
from skyherd.geometry import ROBOT_FRAME_CORNERS, apply_homography, to_points
from skyherd.markers.dictionary import card_side
from skyherd.render import (
    Camera,
    CameraPose,
    Disc,
    Distortion,
    Ground,
    Motion,
    Quad,
    Renderer,
    Sensor,
    Shot,
    Shutter,
    facing_rows,
    project,
    rotation_camera_world,
    shadows,
)

SIDE_M = 0.25
CAMERA = Camera(size_px=(800, 700), focal_px=900.0)
POSE = CameraPose((0.4, -3.0), 4.0, 0.3, (-0.6, 0.1))
FRAMES = np.array([RobotMarkerModel(**place).make().frame for place in CUBE])
POSITIONS_M, HEADINGS_RAD = np.tile([[0.2, 0.3]], (5, 1)), np.full(5, 0.7)


def world_points(points, frames=FRAMES, positions_m=POSITIONS_M, headings_rad=HEADINGS_RAD):
    """Return points (V, 2) of each marker (forward, left), sides, in the world (N, V, 3), m."""
    local = SIDE_M * (points @ frames[:, :, :2].transpose(0, 2, 1) + frames[:, None, :, 2])
    turns = np.array(
        [[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in headings_rad]
    )
    return local @ turns.transpose(0, 2, 1) + np.pad(positions_m, ((0, 0), (0, 1)))[:, None]


def pinhole(points_m, pose=POSE, camera=CAMERA):
    """Return the images (..., 2) of points (..., 3), by rotation and division alone."""
    seen = (points_m - [*pose.position_m, pose.height_m]) @ rotation_camera_world(pose).T
    return camera.focal_px * seen[..., :2] / seen[..., 2:] + (np.array(camera.size_px) - 1) / 2


def shot(rows, **more) -> Shot:
    """Return a shot of some faces of one cube."""
    return Shot(CAMERA, POSE, rows, POSITIONS_M[rows], HEADINGS_RAD[rows], frames=FRAMES[rows], **more)


def renderer(**more) -> Renderer:
    return Renderer("4X4_50", SIDE_M, Ground(1, kind="plain"), Sensor(0.0, np.random.default_rng(0)), **more)


SQUARE = to_points(ROBOT_FRAME_CORNERS)


def test_truth_is_the_projection_of_points_in_space() -> None:
    truth = renderer().truth(shot(np.arange(5)))
    np.testing.assert_allclose(truth.corners_px, pinhole(world_points(SQUARE)), atol=1e-9)
    np.testing.assert_allclose(truth.centers_px, pinhole(world_points(np.zeros((1, 2))))[:, 0], atol=1e-9)


def test_markers_on_the_ground_are_their_own_shadows() -> None:
    flat = np.tile(np.diag([1.0, 1.0, 0.0]), (5, 1, 1))
    ground = shadows(POSE, POSITIONS_M, HEADINGS_RAD, SIDE_M, flat)
    np.testing.assert_allclose(
        [apply_homography(one, SQUARE) for one in ground], world_points(SQUARE, flat)[..., :2], atol=1e-12
    )
    assert (ground[:, 2] == [0, 0, 1]).all()


def test_visible_faces_are_those_turned_to_the_camera_by_depth() -> None:
    """The camera is south of the cube, whose front looks to the north-east."""
    rows = facing_rows(POSE, POSITIONS_M, HEADINGS_RAD, SIDE_M, FRAMES)
    assert set(rows.tolist()) == {0, 3, 4}
    images = pinhole(world_points(SQUARE))
    areas = np.linalg.det(images[:, [1, 3]] - images[:, :1])
    assert set(np.flatnonzero(areas > 0).tolist()) == {0, 3, 4}
    centers = world_points(np.zeros((1, 2)))[rows, 0]
    depths = np.linalg.norm(centers - [*POSE.position_m, POSE.height_m], axis=1)
    assert (np.diff(depths) < 0).all()


def test_drawn_faces_have_their_cells_where_the_truth_is() -> None:
    rows = facing_rows(POSE, POSITIONS_M, HEADINGS_RAD, SIDE_M, FRAMES)
    image = renderer().render(shot(rows))
    ring = 0.5 - 0.5 / 6
    black = pinhole(world_points(np.array([[ring, 0.0], [-ring, 0.0], [0.0, ring], [0.0, -ring]])))[rows]
    white = pinhole(world_points(2 * (0.25 + card_side("4X4_50") / 4) * SQUARE))[rows]
    for points, level in ((black, 30), (white, 230)):
        u, v = np.rint(points.reshape(-1, 2)).astype(int).T
        assert np.abs(image[v, u].astype(float) - level).max() < 25


def test_covered_face_is_not_whole_and_others_are() -> None:
    rows = facing_rows(POSE, POSITIONS_M, HEADINGS_RAD, SIDE_M, FRAMES)
    ground = shadows(POSE, POSITIONS_M, HEADINGS_RAD, SIDE_M, FRAMES)[rows[1]]
    cover = Quad(apply_homography(ground, 0.9 * SQUARE), 70.0)
    truth = renderer().truth(shot(rows, occluders=[cover]))
    assert truth.whole.tolist() == [True, False, True]
    np.testing.assert_allclose(truth.visible_fractions, [1.0, 1 - 0.81, 1.0], atol=0.03)
    assert renderer().truth(shot(rows, occluders=[Disc((9.0, 9.0), 0.1, 70.0)])).whole.all()


def test_rolling_shutter_and_lens_apply_to_faces() -> None:
    """A point is where the camera of its row sees it, for a robot and a camera in motion."""
    camera = Camera(size_px=(800, 700), focal_px=900.0, distortion=Distortion(k1=-0.1))
    shutter = Shutter(row_time_s=2e-5)
    motion = Motion((0.3, -0.2, 0.1), 0.2, np.tile([[0.4, 0.1]], (5, 1)), np.full(5, 0.8))
    scene = Shot(camera, POSE, np.arange(5), POSITIONS_M, HEADINGS_RAD, motion=motion, frames=FRAMES)
    truth = renderer(shutter=shutter).truth(scene)
    for row in range(5):
        for corner in range(4):
            time_s = 2e-5 * (truth.corners_px[row, corner, 1] - 349.5)
            places, headings = motion.robots_at(POSITIONS_M, HEADINGS_RAD, time_s)
            pose = motion.pose_at(POSE, time_s)
            point = world_points(SQUARE, FRAMES, places, headings)[row, corner]
            ground = np.array(pose.position_m) + (point[:2] - pose.position_m) * pose.height_m / (
                pose.height_m - point[2]
            )
            expected = project(camera, pose, ground[None])[0]
            assert truth.corners_px[row, corner] == pytest.approx(expected, abs=1e-3)
