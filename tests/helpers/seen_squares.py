"""Camera views of square markers, by projection, with errors of known size."""

from dataclasses import dataclass, field

import numpy as np

from skyherd.errors import InputError
from skyherd.messages import Detections
from skyherd.render import Camera, CameraPose, Distortion, homography_image_ground, project_markers
from skyherd.render.camera.camera import undistort

SIDE_M, HEIGHT_M, FOCAL_PX = 0.5, 12.0, 640.0
"""Markers of 27 px, seen over 64 degrees, in images of 800 px."""

CORNERS = np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])


@dataclass
class View:
    """A posed camera over robots (N, 2) with headings (N,); corners have errors of `sigma_px` per axis."""

    camera: Camera = field(default_factory=lambda: Camera((800, 800), FOCAL_PX))
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    yaw_rad: float = 0.3
    zoom: float = 1.0
    sigma_px: float = 0.005

    @property
    def pose(self) -> CameraPose:
        tilt_rad = tuple(np.radians(self.tilt_deg).tolist())
        level = CameraPose((0.0, 0.0), HEIGHT_M, self.yaw_rad, tilt_rad, self.zoom)
        x, y = self.ground(np.zeros(1, dtype=complex), level)
        return CameraPose((-float(x[0]), -float(y[0])), HEIGHT_M, self.yaw_rad, tilt_rad, self.zoom)

    def ground(self, points: np.ndarray, pose: CameraPose) -> np.ndarray:
        """Return ground points (2, N) of image points (N,) from the centre, in halves of the shorter side."""
        size = np.array(self.camera.size_px)
        pixels = np.column_stack([points.real, points.imag]) * size.min() / 2 + (size - 1) / 2
        pixels = undistort(self.camera, pose.zoom, pixels)
        top = np.linalg.inv(homography_image_ground(self.camera, pose)) @ np.vstack(
            [pixels.T, np.ones(len(pixels))]
        )
        return top[:2] / top[2]

    def see(
        self,
        positions_m: np.ndarray,
        headings_rad: np.ndarray,
        rng: np.random.Generator,
        *,
        time_s: float = 0.0,
        told: bool = True,
    ) -> Detections:
        """Return detections with centre, heading and side of four corners with independent errors."""
        truth = project_markers(self.camera, self.pose, positions_m, headings_rad, SIDE_M, SIDE_M)
        assert truth.whole.all(), "a robot is out of view"
        count = len(positions_m)
        error = self.sigma_px * rng.standard_normal((count, 4, 2))
        corners = truth.corners_px + error
        seen = corners[..., 0] + 1j * corners[..., 1]
        arms, crosses = seen @ CORNERS.conj() / 2, seen @ CORNERS / 2
        covariances = np.zeros((count, 3, 3))
        if told:
            covariances[:, [0, 1], [0, 1]] = self.sigma_px**2 / 4
            covariances[:, 2, 2] = (self.sigma_px / truth.sides_px) ** 2
        return Detections(
            unit_id=0,
            time_s=time_s,
            image_size_px=np.array(self.camera.size_px),
            ids=np.arange(count),
            centers_px=truth.centers_px + error.mean(axis=1),
            headings_rad=np.angle(-1j * (arms - crosses)),
            sides_px=np.sqrt(np.abs(np.abs(arms) ** 2 - np.abs(crosses) ** 2)),
            corners_px=corners,
            covariances=covariances,
        )

    def ideal_px(self, image_px: np.ndarray) -> np.ndarray:
        """Return the points of an ideal camera for points (N, 2) of the image, px.

        The ground is rotated by the mean slope of both axes at the image's centre. The unit circle keeps its
        size.
        """
        size = np.array(self.camera.size_px)
        points = (image_px - (size - 1) / 2) / (size.min() / 2)
        h = 1e-4
        probes = np.array([0, h, -h, 1j * h, -1j * h, 1, 1j, -1, -1j])
        x, y = self.ground(np.concatenate([probes, points[:, 0] + 1j * points[:, 1]]), self.pose)
        ground = x - 1j * y  # the image's sense
        turn = ((ground[1] - ground[2]) - 1j * (ground[3] - ground[4])) / (4 * h)
        away = (ground - ground[0]) / turn
        ideal = away[9:] / np.mean(np.abs(away[5:9])) * size.min() / 2
        return np.column_stack([ideal.real, ideal.imag]) + (size - 1) / 2


def random_view(seed: int, *, lens: bool = True, tilt_deg: float = 15.0) -> View:
    """Return a cheap camera: oblong pixels, skew, lens distortion, tilt."""
    rng = np.random.default_rng(seed)
    way, lean = rng.uniform(-np.pi, np.pi), tilt_deg * np.sqrt(rng.uniform())
    while True:
        try:
            camera = Camera(
                (800, 800),
                FOCAL_PX * rng.uniform(0.9, 1.3),
                aspect=rng.uniform(0.8, 1.25),
                skew=rng.uniform(-0.1, 0.1),
                distortion=Distortion(k1=rng.uniform(-0.25, 0.1)) if lens else Distortion(),
            )
        except InputError:  # a lens that folds the image over
            continue
        return View(camera, (lean * np.cos(way), lean * np.sin(way)), rng.uniform(-np.pi, np.pi))


def random_robots(
    rng: np.random.Generator, count: int, reach_m: float = 2.9
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and headings of robots under the camera."""
    return rng.uniform(-reach_m, reach_m, (count, 2)), rng.uniform(-np.pi, np.pi, count)


def shape_error(points_px: np.ndarray, positions_m: np.ndarray) -> float:
    """Return the RMS distance of image points (N, 2) to the best similarity, over their RMS radius."""
    ground, seen = positions_m[:, 0] - 1j * positions_m[:, 1], points_px[:, 0] + 1j * points_px[:, 1]
    ground, seen = ground - ground.mean(), seen - seen.mean()
    turn = np.vdot(ground, seen) / np.vdot(ground, ground)
    return float(np.linalg.norm(seen - turn * ground) / np.linalg.norm(seen))
