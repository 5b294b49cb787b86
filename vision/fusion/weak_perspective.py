"""First estimates of robots in an image, by the weak perspective of each marker.

Near one marker, the camera is an orthographic projection along the ray to the marker, times a size. The
affine map of the marker's plane then determines its rotation up to the sign of its slant. With the right
signs, the markers of an image agree on the vertical direction, and the camera is above the robots.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import ROBOT_FRAME_CORNERS, Array, BoolArray, IntArray, to_points
from skyherd.vision.fusion.team_pose import KAPPA, TeamPose, about_vertical

AGREE_RAD = np.radians(20.0)
"""Angle between vertical directions above which two markers disagree. Chosen: above errors of the weak
perspective, and below twice the slant of a tilted camera."""

SQUARE: Array = to_points(ROBOT_FRAME_CORNERS)
"""Corners (4, 2) of a marker (forward, left), sides."""


@dataclass(frozen=True)
class Slants:
    """Rotations of K markers in an image, for both signs of their slant.

    Attributes:
        rotations: (K, 2, 3, 3) from the axes of each marker's robot to the camera's.
        possible: (K, 2) False if the camera would be below the robot.
        centers: (K, 3) the markers' centres in the camera's axes, marker sides.
        size_px: (2,) width and height of the image.
    """

    rotations: Array
    possible: BoolArray
    centers: Array
    size_px: Array

    @classmethod
    def of_markers(cls, corners_px: Array, frames: Array, size_px: Array) -> "Slants":
        """Return the slants of markers with corners (K, 4, 2) and frames (K, 3, 3) on their robots."""
        middle, focal_px = (size_px - 1) / 2, float(size_px.max()) / KAPPA
        homographies = _homographies(corners_px)
        centers_px = homographies[:, :2, 2]
        affine = homographies[:, :2, :2] - centers_px[:, :, None] * homographies[:, 2:, :2]
        rays = np.column_stack([(centers_px - middle) / focal_px, np.ones(len(corners_px))])
        to_ray = _towards(rays / np.linalg.norm(rays, axis=1)[:, None])
        project = np.zeros((len(rays), 2, 3))
        project[:, 0, 0] = project[:, 1, 1] = 1.0
        project[:, :, 2] = -rays[:, :2]
        local = np.linalg.solve(project @ to_ray[:, :2].transpose(0, 2, 1), affine)
        scales = np.linalg.svd(local, compute_uv=False)[:, 0]
        axes = _completed(local / scales[:, None, None])
        normals = np.cross(frames[:, :, 0], frames[:, :, 1])[:, :, None]
        on_robot = np.concatenate([frames[:, :, :2], normals], axis=2)
        rotations = to_ray.transpose(0, 2, 1)[:, None] @ axes @ on_robot.transpose(0, 2, 1)[:, None]
        possible = np.einsum("ksi,ki->ks", rotations[..., 2], rays) < 0
        possible |= ~possible.any(axis=1)[:, None]
        return cls(rotations, possible, rays * (focal_px / scales)[:, None], size_px)

    def verticals(self) -> list[Array]:
        """Return one or two vertical directions (3,) in the camera's axes on which most markers agree."""
        ups = self.rotations[..., 2]
        candidates = ups[self.possible]
        angles = np.arccos(np.clip(np.einsum("ci,ksi->cks", candidates, ups), -1, 1))
        least = np.where(self.possible, angles, np.pi).min(axis=2)
        costs = (np.minimum(least, AGREE_RAD) ** 2).sum(axis=1)
        best = candidates[np.argmin(costs)]
        apart = np.arccos(np.clip(candidates @ best, -1, 1)) > AGREE_RAD
        if not apart.any():
            return [best]
        return [best, candidates[apart][np.argmin(costs[apart])]]

    def poses(self, up: Array, frames: Array) -> TeamPose:
        """Return the pose of each marker's robot by this marker alone, for a vertical direction (3,)."""
        x = np.array([1.0, 0.0, 0.0]) - up[0] * up
        x /= np.linalg.norm(x)
        camera = np.column_stack([x, np.cross(up, x), up])
        agreement = np.where(self.possible, self.rotations[..., 2] @ up, -np.inf)
        chosen = self.rotations[np.arange(len(frames)), agreement.argmax(axis=1)]
        local = camera.T @ chosen
        turns = np.arctan2(local[:, 1, 0] - local[:, 0, 1], local[:, 0, 0] + local[:, 1, 1])
        arms = (camera @ about_vertical(turns) @ frames[:, :, 2:])[..., 0]
        places = self.centers - arms
        middle, longer_px = (self.size_px - 1) / 2, float(self.size_px.max())
        depths = np.maximum(places[:, 2:], np.finfo(float).tiny)
        return TeamPose(
            self.size_px,
            KAPPA,
            camera,
            middle + longer_px / KAPPA * places[:, :2] / depths,
            longer_px / KAPPA / depths[:, 0],
            turns,
        )


def take_robots(pose: TeamPose, rows: IntArray) -> TeamPose:
    """Return the poses of some robots."""
    return TeamPose(
        pose.size_px,
        pose.kappa,
        pose.camera,
        pose.places_px[rows],
        pose.sizes_px[rows],
        pose.turns_rad[rows],
    )


def _homographies(corners_px: Array) -> Array:
    """Return homographies (K, 3, 3) from markers (forward, left), sides, to pixels, by corners (K, 4, 2)."""
    count = len(corners_px)
    x, y = SQUARE.T
    u, v = corners_px[..., 0], corners_px[..., 1]
    equations = np.zeros((count, 2, 4, 8))
    for row, pixels in enumerate((u, v)):
        equations[:, row, :, 3 * row : 3 * row + 3] = np.column_stack([x, y, np.ones(4)])
        equations[:, row, :, 6], equations[:, row, :, 7] = -pixels * x, -pixels * y
    known = np.concatenate([u, v], axis=1)[..., None]
    solutions = np.linalg.solve(equations.reshape(count, 8, 8), known)[..., 0]
    return np.concatenate([solutions, np.ones((count, 1))], axis=1).reshape(count, 3, 3)


def _towards(rays: Array) -> Array:
    """Return rotations (K, 3, 3) whose third rows are the rays (K, 3), of length 1."""
    x = np.cross([0.0, 1.0, 0.0], rays)
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.stack([x, np.cross(rays, x), rays], axis=1)


def _completed(columns: Array) -> Array:
    """Return the two rotations (K, 2, 3, 3) whose first two columns begin with given ones (K, 2, 2)."""
    a, b = columns[:, :, 0], columns[:, :, 1]
    first = np.sqrt(np.maximum(0.0, 1 - (a**2).sum(axis=1)))
    second = np.sqrt(np.maximum(0.0, 1 - (b**2).sum(axis=1)))
    second = np.where((a * b).sum(axis=1) < 0, second, -second)
    signs = np.array([1.0, -1.0])[:, None]
    pairs = []
    for pair, depth in ((a, first), (b, second)):
        pairs.append(np.stack([np.column_stack([pair, sign * depth]) for sign in signs], axis=1))
    x, y = pairs
    x = x / np.linalg.norm(x, axis=2)[..., None]
    y = y - (x * y).sum(axis=2)[..., None] * x
    y = y / np.linalg.norm(y, axis=2)[..., None]
    return np.stack([x, y, np.cross(x, y)], axis=-1)
