"""Fusion of the markers of a robot: exact for exact corners, and consistent covariances on images."""

import numpy as np
import pytest
from five_markers import MARKERS

from skyherd.datasets import RobotMarkerModel
from skyherd.geometry import ROBOT_FRAME_CORNERS, apply_homography, to_points, wrap_angle
from skyherd.markers.dictionary import card_side
from skyherd.markers.layout import MarkerLayout, Place
from skyherd.messages import Detections, Quality
from skyherd.render import (
    Camera,
    CameraPose,
    Ground,
    Renderer,
    Sensor,
    Shot,
    homography_image_ground,
    project_markers,
    rotation_camera_world,
)
from skyherd.vision import create_detector, fuse_markers

ROBOTS = range(6)
LAYOUT = MarkerLayout.make(ROBOTS, [RobotMarkerModel(**place).make() for place in MARKERS])
DICTIONARY, SIDE_M = "4X4_50", 0.3
CAMERA = Camera(size_px=(900, 800), focal_px=800.0)


class Scene:
    """Robots with random places and headings under a camera with a random tilt up to 40°.

    Args:
        rng: random generator.
        seen: number of markers that each robot shows; 0: a random one for each robot.
    """

    def __init__(self, rng: np.random.Generator, seen: int) -> None:
        homes = np.array([[x, y] for x in (-2.2, 0.0, 2.2) for y in (-1.3, 1.3)])
        self.places_m = homes + rng.uniform(-0.2, 0.2, homes.shape)
        self.headings_rad = rng.uniform(-np.pi, np.pi, len(homes))
        height_m, yaw_rad, tilt_rad = rng.uniform(8, 10), rng.uniform(-3, 3), tuple(rng.uniform(-0.5, 0.5, 2))
        level = CameraPose((0.0, 0.0), height_m, yaw_rad, tilt_rad)
        ahead = rotation_camera_world(level)[2]
        x_m, y_m = height_m / ahead[2] * ahead[:2]
        self.pose = CameraPose((float(x_m), float(y_m)), height_m, yaw_rad, tilt_rad)
        shown = [rng.permutation(len(MARKERS))[: seen or rng.integers(1, 6)] for _ in ROBOTS]
        rows = np.concatenate([own + robot * len(MARKERS) for robot, own in enumerate(shown)])
        robots = LAYOUT.robot_ids[rows]
        self.ids = LAYOUT.ids[rows]
        arms = LAYOUT.offsets_sides[rows] * np.exp(1j * self.headings_rad[robots])
        self.marker_places_m = self.places_m[robots] + SIDE_M * to_points(arms)
        self.marker_headings_rad = self.headings_rad[robots] + LAYOUT.yaws_rad[rows]

    def truth(self, places_m, headings_rad, ids):
        card_m = SIDE_M * card_side(DICTIONARY)
        return project_markers(CAMERA, self.pose, places_m, headings_rad, SIDE_M, card_m, ids=ids)

    @property
    def robots(self):
        """Ground truth of a marker at the reference point of each robot."""
        return self.truth(self.places_m, self.headings_rad, np.arange(len(ROBOTS)))

    def exact(self, variance: float = 0.0) -> Detections:
        """Return exact detections of the shown markers."""
        truth = self.truth(self.marker_places_m, self.marker_headings_rad, self.ids)
        count = self.ids.size
        return Detections(
            unit_id=2,
            time_s=3.0,
            image_size_px=np.array(CAMERA.size_px),
            ids=self.ids,
            centers_px=truth.centers_px,
            headings_rad=truth.headings_rad,
            sides_px=truth.sides_px,
            corners_px=truth.corners_px,
            covariances=np.tile(variance * np.diag([1.0, 1.0, 0.01]), (count, 1, 1)),
            qualities=np.full(count, Quality.PHOTOMETRIC),
        )

    def detect(self, seed: int) -> Detections:
        """Render an image of the shown markers, and detect them."""
        renderer = Renderer(DICTIONARY, SIDE_M, Ground(1), Sensor(2.0, np.random.default_rng(seed)))
        shot = Shot(CAMERA, self.pose, self.ids, self.marker_places_m, self.marker_headings_rad)
        return create_detector("photometric", dictionary=DICTIONARY).detect(renderer.render(shot))


def nees(scene: Scene, fused: Detections) -> list[float]:
    """Return error² over the reported variance of (u, v, heading), over three, of each robot."""
    truth, values = scene.robots, []
    for robot in fused:
        turn = wrap_angle(robot.heading_rad - truth.headings_rad[robot.id])
        error = np.array([*(robot.center_px - truth.centers_px[robot.id]), turn])
        values.append(error @ np.linalg.solve(robot.covariance, error) / 3)
    return values


class TestExactCorners:
    @pytest.mark.parametrize("variance", [0.0, 1e-4])
    @pytest.mark.parametrize("seen", [1, 2, 5])
    def test_robot_is_exact_for_any_visible_markers(self, seen, variance) -> None:
        """The homography of a pinhole camera is exact at any offset and tilt."""
        rng = np.random.default_rng(seen)
        for _ in range(5):
            scene = Scene(rng, seen)
            fused, truth = fuse_markers(scene.exact(variance), LAYOUT), scene.robots
            assert fused.ids.tolist() == list(ROBOTS) and (fused.unit_id, fused.time_s) == (2, 3.0)
            np.testing.assert_allclose(fused.centers_px, truth.centers_px, atol=1e-6)
            np.testing.assert_allclose(wrap_angle(fused.headings_rad - truth.headings_rad), 0, atol=1e-8)
            np.testing.assert_allclose(fused.sides_px, truth.sides_px, rtol=1e-8)
            np.testing.assert_allclose(fused.corners_px, truth.corners_px, atol=1e-6)
            assert fused.covariances.any() == (variance > 0)

    def test_wrong_layout_is_off_by_its_error(self) -> None:
        """Negative control: offsets that are a tenth of a side wrong move the robots by as much."""
        scene = Scene(np.random.default_rng(0), 1)
        off = np.zeros((3, 3))
        off[0, 2] = 0.1
        wrong = MarkerLayout(LAYOUT.ids, LAYOUT.robot_ids, LAYOUT.frames + off)
        off = fuse_markers(scene.exact(), wrong).centers_px - scene.robots.centers_px
        lengths = np.linalg.norm(off, axis=1) / scene.robots.sides_px
        np.testing.assert_allclose(lengths, 0.1, rtol=0.3)

    def test_more_markers_make_the_robot_more_certain(self) -> None:
        scene = Scene(np.random.default_rng(1), 5)
        found = scene.exact(1e-4)
        stds = {}
        for ids in ([30], [30, 40], [0, 10, 20, 30, 40]):
            fused = fuse_markers(found.select(set(ids)), LAYOUT)
            stds[len(ids)] = np.sqrt(np.diag(fused[0].covariance))
        assert (stds[5] < stds[2]).all() and (stds[2] < stds[1]).all()

    def test_far_marker_is_uncertain_across_its_arm(self) -> None:
        """An error of the heading moves the reference point at the end of an arm of 2.1 sides."""
        scene = Scene(np.random.default_rng(1), 5)
        found = scene.exact(1e-4)
        near, far = (fuse_markers(found.select({marker}), LAYOUT)[0] for marker in (0, 40))
        assert np.trace(near.covariance[:2, :2]) == pytest.approx(2e-4, rel=0.05)
        across_px = np.sqrt(0.01 * 1e-4) * 2.1 * near.side_px
        assert np.sqrt(np.trace(far.covariance[:2, :2])) > 0.6 * across_px


class TestWeights:
    """Two markers on either side of the reference point, under a level camera.

    Heading errors are small, so that turn and size are known: the place is the weighted mean of two places.
    """

    LAYOUT = MarkerLayout.make([0], [Place(0, (1.5, 1.5)), Place(10, (-1.5, -1.5))])

    def pair(self, *covariances_px2, shift_px=(0.0, 0.0)) -> Detections:
        """Return detections of both markers, of which the first is moved by (u, v)."""
        centers = np.array([[400.0 + 45, 300 - 45], [400 - 45, 300 + 45]])
        centers[0] += shift_px
        corners = to_points(30 * np.conj(ROBOT_FRAME_CORNERS)) + centers[:, None]
        covariances = np.zeros((2, 3, 3))
        covariances[:, :2, :2], covariances[:, 2, 2] = covariances_px2, 1e-12
        return Detections(
            unit_id=0,
            time_s=0.0,
            image_size_px=np.array(CAMERA.size_px),
            ids=np.array([0, 10]),
            centers_px=centers,
            headings_rad=np.zeros(2),
            sides_px=np.full(2, 30.0),
            corners_px=corners,
            covariances=covariances,
            qualities=np.full(2, Quality.PHOTOMETRIC),
        )

    @pytest.mark.parametrize(("first", "share"), [(1e-4, 0.8), (16e-4, 0.2)])
    def test_place_is_the_mean_by_inverse_covariance(self, first, share) -> None:
        found = self.pair(first * np.eye(2), 4e-4 * np.eye(2), shift_px=(0.02, -0.01))
        (robot,) = fuse_markers(found, self.LAYOUT)
        np.testing.assert_allclose(robot.center_px, [400 + share * 0.02, 300 - share * 0.01], atol=2e-5)
        np.testing.assert_allclose(robot.covariance[:2, :2], share * first * np.eye(2), atol=1e-6)

    def test_correlated_errors_give_each_markers_sharp_direction(self) -> None:
        """Each marker is certain along its own diagonal, so that the robot is certain along both."""
        narrow, wide = 1e-6, 1e-2
        mean, half = (wide + narrow) / 2, (wide - narrow) / 2
        found = self.pair([[mean, half], [half, mean]], [[mean, -half], [-half, mean]])
        (robot,) = fuse_markers(found, self.LAYOUT)
        assert np.trace(robot.covariance[:2, :2]) == pytest.approx(2 * narrow, rel=0.01)

    def test_heading_of_one_marker_has_the_plane_errors(self) -> None:
        """The heading's own share of 0.5, the anisotropy's 0.9, and 0.025 · 1.5² of the perspective."""
        found = self.pair(np.eye(2) * 1e-4, np.eye(2) * 1e-4)[:1]
        (robot,) = fuse_markers(found, self.LAYOUT)
        assert robot.covariance[2, 2] / 1e-12 == pytest.approx(0.5 + 0.9 + 0.025 * 1.5**2, rel=1e-3)


class TestIdentity:
    def test_strangers_stay_after_the_robots(self) -> None:
        scene = Scene(np.random.default_rng(2), 3)
        found = scene.exact()
        layout = MarkerLayout.make([1], [Place(0, (0.0, 0.0)), Place(10, (1.5, 1.5))])
        fused = fuse_markers(found, layout)
        others = found.without(layout.ids)
        assert fused.ids[-len(others) :].tolist() == others.ids.tolist()
        np.testing.assert_array_equal(fused.corners_px[-len(others) :], others.corners_px)

    def test_disagreeing_markers_make_the_robot_ambiguous(self) -> None:
        """One marker of robot 2 lies on robot 5, by a false reading or a swapped print."""
        scene = Scene(np.random.default_rng(3), 5)
        found = scene.exact()
        ids = found.ids.copy()
        stray = int(np.flatnonzero(ids == 25)[0])
        ids[stray] = 42
        keep = (found.ids != 42) | (np.arange(ids.size) == stray)
        moved = Detections(**{**vars(found), "ids": ids})[np.flatnonzero(keep)]
        fused = fuse_markers(moved, LAYOUT)
        assert (fused.ids == 2).sum() == 2
        assert 2 not in fused.unambiguous().ids and 5 in fused.unambiguous().ids

    def test_repeated_marker_makes_the_robot_ambiguous(self) -> None:
        found = Scene(np.random.default_rng(3), 1).exact()
        twice = Detections(
            **{**vars(found), "ids": np.where(found.ids == found.ids[0], found.ids[1], found.ids)}
        )
        fused = fuse_markers(twice, LAYOUT)
        assert fused.repeated.sum() == 2

    def test_quality_is_the_least_of_the_markers(self) -> None:
        found = Scene(np.random.default_rng(4), 5).exact()
        worse = np.where(found.ids == 13, Quality.ROBUST, Quality.PHOTOMETRIC)
        fused = fuse_markers(Detections(**{**vars(found), "qualities": worse}), LAYOUT)
        assert fused.qualities.tolist() == [2, 2, 2, 1, 2, 2]

    def test_image_without_markers_has_no_robots(self) -> None:
        found = Scene(np.random.default_rng(5), 1).exact()[:0]
        assert len(fuse_markers(found, LAYOUT)) == 0


class TestRenderedImages:
    def test_covariances_hold_for_random_visible_markers(self) -> None:
        """The mean of 96 robots has a standard deviation of 0.08; 0.8 to 1.25 is required."""
        rng, values, ignorant = np.random.default_rng(7), [], []
        for number in range(16):
            scene = Scene(rng, 0)
            found = scene.detect(number)
            fused = fuse_markers(found, LAYOUT)
            assert sorted(fused.ids.tolist()) == list(ROBOTS)
            values += nees(scene, fused)
            # Negative control: the robot's place by one marker with that marker's own covariance.
            single = found[np.unique(LAYOUT.robots_of(found.ids), return_index=True)[1]]
            placed = fuse_markers(single, LAYOUT)
            order = np.argsort(LAYOUT.robots_of(single.ids))
            own = Detections(**{**vars(placed), "covariances": single.covariances[order]})
            ignorant += nees(scene, own)
        assert 0.8 <= np.mean(values) <= 1.25
        assert np.mean(ignorant) > 3

    @pytest.mark.slow
    @pytest.mark.parametrize("seen", [1, 2, 3, 5])
    def test_covariances_hold_for_each_number_of_markers(self, seen) -> None:
        rng = np.random.default_rng(100 + seen)
        values = [
            value
            for number in range(60)
            for scene in [Scene(rng, seen)]
            for value in nees(scene, fuse_markers(scene.detect(1000 * seen + number), LAYOUT))
        ]
        assert 0.8 <= np.mean(values) <= 1.25

    def test_every_detector_gives_robots_within_a_pixel(self) -> None:
        """OpenCV states no covariances; its corners are good to some tenths of a pixel."""
        scene = Scene(np.random.default_rng(8), 5)
        renderer = Renderer(DICTIONARY, SIDE_M, Ground(1), Sensor(2.0, np.random.default_rng(1)))
        shot = Shot(CAMERA, scene.pose, scene.ids, scene.marker_places_m, scene.marker_headings_rad)
        found = create_detector("opencv-subpix", dictionary=DICTIONARY).detect(renderer.render(shot))
        fused = fuse_markers(found, LAYOUT)
        assert len(fused) == len(ROBOTS) and not fused.covariances.any()
        off_px = np.linalg.norm(fused.centers_px - scene.robots.centers_px[fused.ids], axis=1)
        assert off_px.max() < 1.0


def test_scene_looks_at_the_robots() -> None:
    scene = Scene(np.random.default_rng(0), 1)
    middle = apply_homography(homography_image_ground(CAMERA, scene.pose), np.zeros((1, 2)))
    np.testing.assert_allclose(middle, [(np.array(CAMERA.size_px) - 1) / 2], atol=1e-6)
