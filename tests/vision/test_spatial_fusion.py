"""Fusion of markers on the faces of cubes: exact for exact corners, and consistent covariances on images."""

from dataclasses import replace

import numpy as np
import pytest
from five_markers import CUBE

from skyherd.datasets import RobotMarkerModel
from skyherd.errors import InputError
from skyherd.geometry import wrap_angle
from skyherd.markers.layout import MarkerLayout, Place
from skyherd.messages import Detections, Quality
from skyherd.render import (
    Camera,
    CameraPose,
    Ground,
    Renderer,
    Sensor,
    Shot,
    facing_rows,
    project_markers,
    rotation_camera_world,
)
from skyherd.vision import create_detector, fuse_markers
from skyherd.vision.fusion.spatial import fuse_spatial_markers
from skyherd.vision.fusion.team_pose import TeamPose, small_rotation

ROBOTS = range(6)
LAYOUT = MarkerLayout.make(ROBOTS, [RobotMarkerModel(**place).make() for place in CUBE])
DICTIONARY, SIDE_M = "4X4_50", 0.3
CAMERA = Camera(size_px=(900, 800), focal_px=800.0)


class Scene:
    """Cubes with random places and headings under a camera with a random tilt up to 40°.

    Args:
        rng: random generator.
        camera: the camera.
    """

    def __init__(self, rng: np.random.Generator, camera: Camera = CAMERA) -> None:
        self.camera = camera
        homes = np.array([[x, y] for x in (-2.2, 0.0, 2.2) for y in (-1.3, 1.3)])
        self.places_m = homes + rng.uniform(-0.2, 0.2, homes.shape)
        self.headings_rad = rng.uniform(-np.pi, np.pi, len(homes))
        height_m, yaw_rad, tilt_rad = rng.uniform(7, 9), rng.uniform(-3, 3), tuple(rng.uniform(-0.5, 0.5, 2))
        height_m *= camera.focal_px / CAMERA.focal_px
        level = CameraPose((0.0, 0.0), height_m, yaw_rad, tilt_rad)
        ahead = rotation_camera_world(level)[2]
        x_m, y_m = height_m / ahead[2] * ahead[:2]
        self.pose = CameraPose((float(x_m), float(y_m)), height_m, yaw_rad, tilt_rad)
        robots = LAYOUT.robot_ids
        places_m, headings_rad = self.places_m[robots], self.headings_rad[robots]
        rows = facing_rows(self.pose, places_m, headings_rad, SIDE_M, LAYOUT.frames)
        self.shot = Shot(
            camera,
            self.pose,
            LAYOUT.ids[rows],
            places_m[rows],
            headings_rad[rows],
            frames=LAYOUT.frames[rows],
        )

    @property
    def robots(self):
        """Ground truth of a marker on the ground at the reference point of each robot."""
        ids = np.arange(len(ROBOTS))
        return project_markers(
            self.camera, self.pose, self.places_m, self.headings_rad, SIDE_M, SIDE_M, ids=ids
        )

    def exact(self, variance: float = 1e-4) -> Detections:
        """Return exact detections of the markers that face the camera."""
        shot, count = self.shot, self.shot.ids.size
        truth = project_markers(
            self.camera,
            self.pose,
            shot.positions_m,
            shot.headings_rad,
            SIDE_M,
            SIDE_M,
            ids=shot.ids,
            frames=shot.frames,
        )
        return Detections(
            unit_id=2,
            time_s=3.0,
            image_size_px=np.array(self.camera.size_px),
            ids=shot.ids,
            centers_px=truth.centers_px,
            headings_rad=truth.headings_rad,
            sides_px=truth.sides_px,
            corners_px=truth.corners_px,
            covariances=np.tile(variance * np.diag([1.0, 1.0, 0.01]), (count, 1, 1)),
            qualities=np.full(count, Quality.PHOTOMETRIC),
        )

    def render(self, seed: int):
        """Return the image."""
        renderer = Renderer(DICTIONARY, SIDE_M, Ground(1), Sensor(2.0, np.random.default_rng(seed)))
        return renderer.render(self.shot)


def fuse(found: Detections, layout: MarkerLayout = LAYOUT, std_px: float = 0.02) -> Detections:
    """Return the robots of exact corners, of independent errors."""
    covariances = np.tile(std_px**2 * np.eye(8), (len(found), 1, 1))
    return fuse_spatial_markers(found, found.corners_px, covariances, layout, found[:0])


def nees(scene: Scene, fused: Detections) -> list[float]:
    """Return error² over the reported variance of (u, v, heading), over three, of each robot."""
    truth, values = scene.robots, []
    for robot in fused:
        turn = wrap_angle(robot.heading_rad - truth.headings_rad[robot.id])
        error = np.array([*(robot.center_px - truth.centers_px[robot.id]), turn])
        values.append(error @ np.linalg.solve(robot.covariance, error) / 3)
    return values


def one_each(found: Detections, rng: np.random.Generator) -> Detections:
    """Return one random marker of each robot."""
    shuffled = rng.permutation(len(found))
    _, first = np.unique(LAYOUT.robots_of(found.ids[shuffled]), return_index=True)
    return found[shuffled[first]]


class TestExactCorners:
    @pytest.mark.parametrize("focal_px", [500.0, 800.0, 1500.0])
    def test_robots_are_exact_for_an_unknown_focal_length(self, focal_px) -> None:
        """The prior of the focal length pulls by less than the noise that the covariances state."""
        rng = np.random.default_rng(3)
        for _ in range(4):
            scene = Scene(rng, replace(CAMERA, focal_px=focal_px))
            fused, truth = fuse(scene.exact(), std_px=1e-4), scene.robots
            assert fused.ids.tolist() == list(ROBOTS) and (fused.unit_id, fused.time_s) == (2, 3.0)
            np.testing.assert_allclose(fused.centers_px, truth.centers_px, atol=2e-3)
            np.testing.assert_allclose(wrap_angle(fused.headings_rad - truth.headings_rad), 0, atol=1e-4)
            np.testing.assert_allclose(fused.sides_px, truth.sides_px, rtol=1e-4)
            np.testing.assert_allclose(fused.corners_px, truth.corners_px, atol=5e-3)

    def test_one_side_of_each_cube_suffices(self) -> None:
        rng = np.random.default_rng(4)
        for _ in range(6):
            scene = Scene(rng)
            sides = one_each(scene.exact().without(set(ROBOTS)), rng)
            fused = fuse(sides, std_px=1e-4)
            truth = scene.robots
            assert len(fused) == len(sides)
            np.testing.assert_allclose(fused.centers_px, truth.centers_px[fused.ids], atol=0.05)
            off = wrap_angle(fused.headings_rad - truth.headings_rad[fused.ids])
            np.testing.assert_allclose(off, 0, atol=1e-3)

    def test_wrong_height_moves_the_robots(self) -> None:
        """Negative control: a cube that is 0.3 sides taller stands lower in the image."""
        scene = Scene(np.random.default_rng(5))
        lift = np.zeros((3, 3))
        lift[2, 2] = 0.3
        taller = MarkerLayout(LAYOUT.ids, LAYOUT.robot_ids, LAYOUT.frames + lift)
        off_px = np.linalg.norm(fuse(scene.exact(), taller).centers_px - scene.robots.centers_px, axis=1)
        assert (off_px > 0.5).all()


def test_correlated_errors_of_corners_give_consistent_robots() -> None:
    """The corners of a marker are shifted together by 0.05 px; independent errors would give a NEES of 4."""
    rng, values = np.random.default_rng(11), []
    covariance = 0.05**2 * np.kron(np.ones((4, 4)), np.eye(2)) + 0.005**2 * np.eye(8)
    root = np.linalg.cholesky(covariance)
    for _ in range(15):
        scene = Scene(rng)
        found = scene.exact()
        corners_px = found.corners_px + (rng.normal(size=(len(found), 8)) @ root.T).reshape(-1, 4, 2)
        covariances = np.tile(covariance, (len(found), 1, 1))
        values += nees(scene, fuse_spatial_markers(found, corners_px, covariances, LAYOUT, found[:0]))
    assert 0.75 <= np.mean(values) <= 1.3


class TestDerivatives:
    def pose(self) -> TeamPose:
        return TeamPose(
            np.array([900.0, 800.0]),
            1.1,
            np.diag([1.0, -1.0, -1.0]) @ small_rotation(np.array([0.4, -0.2, 0.1])),
            np.array([[300.0, 500.0], [700.0, 200.0]]),
            np.array([30.0, 40.0]),
            np.array([0.4, -2.0]),
        )

    def test_derivatives_are_differences(self) -> None:
        pose, points = self.pose(), LAYOUT.points_sides[:4]
        robots = np.array([0, 1, 1, 0])
        _, shared, own = pose.images(points, robots)
        for unknown in range(11):
            step = np.zeros(11)
            step[unknown] = 1e-6
            ends = [pose.moved(sign * step).images(points, robots)[0] for sign in (1, -1)]
            difference = (ends[0] - ends[1]) / 2e-6
            if unknown < 3:
                expected = shared[..., unknown]
            else:
                mine = robots == (unknown - 3) // 4
                expected = np.where(mine[:, None, None], own[..., (unknown - 3) % 4], 0.0)
            np.testing.assert_allclose(difference, expected, atol=1e-4)

    def test_pose_covariance_is_that_of_differences(self) -> None:
        pose, rng = self.pose(), np.random.default_rng(1)
        root = rng.normal(size=(11, 11))
        errors = root @ root.T
        for robot in range(2):
            by = np.zeros((3, 11))
            for unknown in range(11):
                step = np.zeros(11)
                step[unknown] = 1e-6
                ends = [pose.moved(sign * step).homographies()[robot] for sign in (1, -1)]
                places = [end[:2, 2] for end in ends]
                slopes = [end[:2, 0] - end[:2, 2] * end[2, 0] for end in ends]
                headings = [np.arctan2(slope[1], slope[0]) for slope in slopes]
                by[:, unknown] = [*(places[0] - places[1]), headings[0] - headings[1]]
            by /= 2e-6
            np.testing.assert_allclose(pose.pose_covariances(errors)[robot], by @ errors @ by.T, rtol=1e-4)

    def test_homography_is_the_image_of_the_ground_plane(self) -> None:
        pose, plane = self.pose(), np.array([[0.3, -0.8, 0.0], [2.0, 1.0, 0.0]])
        for robot, homography in enumerate(pose.homographies()):
            images = pose.images(plane[None], np.array([robot]))[0][0]
            mapped = np.column_stack([plane[:, :2], np.ones(2)]) @ homography.T
            np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:], images, atol=1e-9)


class TestIdentity:
    def test_disagreeing_markers_make_the_robot_ambiguous(self) -> None:
        """The top of robot 5 is read as the front of robot 2."""
        scene = Scene(np.random.default_rng(6))
        found = scene.exact()
        found = found.without({12})
        swapped = Detections(**{**vars(found), "ids": np.where(found.ids == 5, 12, found.ids)})
        fused = fuse(swapped)
        assert (fused.ids == 2).sum() == 2 and 2 not in fused.unambiguous().ids

    def test_strangers_stay_and_lesser_qualities_count(self) -> None:
        scene = Scene(np.random.default_rng(7))
        image, layout = scene.render(1), MarkerLayout.make([1], [RobotMarkerModel(**p).make() for p in CUBE])
        found = create_detector("photometric", dictionary=DICTIONARY).detect(image)
        worse = np.where(found.ids == 1, Quality.ROBUST, found.qualities)
        fused = fuse_markers(Detections(**{**vars(found), "qualities": worse}), layout, image, DICTIONARY)
        assert fused.ids[0] == 1 and fused.qualities[0] == Quality.ROBUST
        assert set(fused.ids[1:].tolist()) == set(found.without(layout.ids).ids.tolist())

    def test_image_is_needed_for_faces(self) -> None:
        found = Scene(np.random.default_rng(8)).exact()
        with pytest.raises(InputError, match="markers lie on several faces"):
            fuse_markers(found, LAYOUT)
        assert len(fuse(found[:0])) == 0

    def test_raised_plane_is_not_flat(self) -> None:
        assert MarkerLayout.make([0], [Place(0, (0.0, 0.0))]).is_flat
        assert not MarkerLayout.make([0], [Place(0, (0.0, 0.0), height_sides=1.0)]).is_flat
        assert not MarkerLayout.make([0], [Place(0, (0.0, 0.0), face="left")]).is_flat


class TestRenderedImages:
    def measure(self, count: int, seed: int, choose) -> list[float]:
        rng, values = np.random.default_rng(seed), []
        for number in range(count):
            scene = Scene(rng)
            image = scene.render(1000 * seed + number)
            found = choose(create_detector("photometric", dictionary=DICTIONARY).detect(image), rng)
            fused = fuse_markers(found, LAYOUT, image, DICTIONARY)
            assert set(fused.ids.tolist()) == set(LAYOUT.robots_of(found.ids).tolist())
            values += nees(scene, fused)
        return values

    def test_covariances_hold_for_random_visible_faces(self) -> None:
        """The errors of an image's robots have its focal length and vertical in common."""
        values = self.measure(10, 1, lambda found, rng: found[np.flatnonzero(rng.random(len(found)) < 2 / 3)])
        assert 0.6 <= np.mean(values) <= 1.7

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "choose",
        [
            pytest.param(lambda found, _: found, id="all"),
            pytest.param(one_each, id="one"),
            pytest.param(lambda found, _: found.without(set(ROBOTS)), id="sides"),
        ],
    )
    def test_covariances_hold_for_each_choice_of_faces(self, choose) -> None:
        assert 0.8 <= np.mean(self.measure(60, 2, choose)) <= 1.3

    def test_detector_without_covariances_gives_robots(self) -> None:
        """OpenCV's corners are good to some tenths of a pixel, and the ground is 1.5 sides below."""
        scene = Scene(np.random.default_rng(9))
        image = scene.render(1)
        found = create_detector("opencv-subpix", dictionary=DICTIONARY).detect(image)
        fused = fuse_markers(found, LAYOUT, image, DICTIONARY)
        assert len(fused) == len(ROBOTS) and not fused.covariances.any()
        off_px = np.linalg.norm(fused.centers_px - scene.robots.centers_px[fused.ids], axis=1)
        assert off_px.max() < 2.0


def test_faces_are_seen_from_outside() -> None:
    """Forward, left and the outward normal are right-handed on each face."""
    outward = {"front": (1, 0, 0), "left": (0, 1, 0), "back": (-1, 0, 0), "right": (0, -1, 0)}
    for face, normal in outward.items():
        frame = Place(0, (0.0, 0.0), face=face).frame
        np.testing.assert_array_equal(np.cross(frame[:, 0], frame[:, 1]), normal)
        np.testing.assert_array_equal(frame[:, 0], (0, 0, 1))
    turned = Place(0, (0.0, 0.0), np.pi / 2, face="front").frame
    np.testing.assert_allclose(turned[:, 0], (0, -1, 0), atol=1e-12)
