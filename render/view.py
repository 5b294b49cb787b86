"""Projection of flat shapes on the ground through pose, motion, shutter and lens.

A flat shape on the ground is imaged by a homography. With a rolling shutter and motion each row has its own
homography. It is computed for the first, the middle and the last row, and interpolated by a parabola. The
lens distortion follows the homography. Both drawing and ground truth use `View`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray, apply_homography, inverse
from skyherd.render.camera.camera import (
    Camera,
    CameraPose,
    distort,
    homography_image_ground,
    lens_field,
    lens_jacobians,
    undistort,
)
from skyherd.render.camera.lens_blur import Ray
from skyherd.render.camera.lens_displacement import LensField
from skyherd.render.camera.motion import INSTANT, STILL, Motion, Shutter
from skyherd.render.native.library import Frame

ROLLING_STEPS = 5
"""Fixed-point steps for the row in which a moving point is seen. *Chosen*: each reduces the error by a factor
of 100 or more, so that five reduce 100 px to 1e-8 px."""


@dataclass(frozen=True)
class ShapeImages:
    """Homographies of N flat shapes to undistorted pixels, at one or three instants of an image.

    Attributes:
        camera: intrinsics and lens.
        zoom: zoom of the pose.
        times_s: (Q,) instants: one, or with a rolling shutter those of the first, middle and last row.
        matrices: (Q, N, 3, 3) homographies from shape coordinates to pixels at these instants.
    """

    camera: Camera
    zoom: float
    times_s: Array
    matrices: Array

    @property
    def rolling(self) -> bool:
        """True if rows are exposed at different times."""
        return len(self.times_s) > 1

    def only(self, shapes: IntArray) -> "ShapeImages":
        """Return the images of the shapes with the given indices (M,)."""
        return replace(self, matrices=self.matrices[:, shapes])

    def _share_of_time(self, v_px: Array) -> Array:
        """Return the times (...) of rows v (...), scaled to -1 and 1 at the first and the last instant."""
        height, (_, middle, last) = self.camera.size_px[1], self.times_s
        times_s = np.interp(v_px, [-0.5, height - 0.5], self.times_s[[0, -1]])
        return np.asarray((times_s - middle) / (last - middle))

    def _at(self, matrices: Array, shape: IntArray, v_px: Array) -> Array:
        """Return the matrices (..., 3, 3) of shapes (...) at the times of rows v (...), by a parabola."""
        if not self.rolling:
            return np.asarray(matrices[0][shape])
        t = self._share_of_time(v_px)
        parabola = (t * (t - 1) / 2, 1 - t * t, t * (t + 1) / 2)
        return np.asarray(sum(w[..., None, None] * m[shape] for w, m in zip(parabola, matrices, strict=True)))

    def project(self, points: Array) -> Array:
        """Project points (V, 2) or (N, V, 2) in shape coordinates to pixels (N, V, 2).

        With a rolling shutter the row of a point depends on its time, and the time on the row. Fixed-point
        iteration solves this.
        """
        homogeneous = np.ones((*points.shape[:-1], 3))
        homogeneous[..., :2] = points
        if not self.rolling:
            mapped = homogeneous @ self.matrices[0].transpose(0, 2, 1)
            return distort(self.camera, self.zoom, mapped[..., :2] / mapped[..., 2:])
        shape = np.broadcast_to(
            np.arange(self.matrices.shape[1], dtype=np.int64)[:, None],
            (self.matrices.shape[1], points.shape[-2]),
        )
        v_px: Array = np.full(shape.shape, (self.camera.size_px[1] - 1) / 2)
        for _ in range(ROLLING_STEPS):
            mapped = np.einsum(
                "nvij,nvj->nvi",
                self._at(self.matrices, shape, v_px),
                np.broadcast_to(homogeneous, (*shape.shape, 3)),
            )
            pixels = distort(self.camera, self.zoom, mapped[..., :2] / mapped[..., 2:])
            v_px = pixels[..., 1]
        return pixels

    def row_times(self) -> Array:
        """Return the times (height,) of the rows, scaled to -1 and 1 at the first and the last instant."""
        rows = np.arange(self.camera.size_px[1], dtype=float)
        return self._share_of_time(rows) if self.rolling else np.zeros_like(rows)

    @property
    def bent(self) -> bool:
        """True if lens or rolling shutter bend straight lines."""
        return self.rolling or bool(self.camera.distortion)

    def lens(self) -> LensField | None:
        """Return the lens displacement of each pixel; None without distortion."""
        return lens_field(self.camera, self.zoom)

    def frame(self) -> Frame:
        """Return lens and shutter of the image, for the compiled drawing."""
        lens = self.lens()
        return Frame(self.row_times(), None if lens is None else lens.fields)

    def before_horizon(self, points: Array) -> BoolArray:
        """Return the mask (N,) of shapes with all points (V, 2) on the camera's side of the horizon."""
        last = self.matrices[:, :, 2]
        weights = last[..., :2] @ points.T + last[..., 2:]
        return np.asarray((weights > 0).all(axis=(0, 2)))

    def at_origin(self) -> Array:
        """Return homographies (N, 3, 3) to pixels that are correct to first order at each shape's origin.

        Without lens and rolling shutter they are exact. The lens contributes its Jacobian D, and a row time τ
        the motion between rows. A point in row v moves by `dp = D H dx + p_t τ dv`, so that the Jacobian is
        multiplied by `(1 - τ p_t e_vᵀ)⁻¹`.
        """
        if not self.bent:
            return np.asarray(self.matrices[0])
        centers = self.project(np.zeros((1, 2)))[:, 0]
        shape: IntArray = np.arange(len(centers))
        matrices = self._at(self.matrices, shape, centers[:, 1])
        straight = matrices[:, :2, 2] / matrices[:, 2:, 2]
        slopes = lens_jacobians(self.camera, self.zoom, straight)
        if self.rolling:
            slopes = self._shear(shape, centers[:, 1]) @ slopes
        local = np.zeros_like(matrices)
        local[:, :2, :2], local[:, 2, 2] = slopes, 1.0
        local[:, :2, 2] = centers - np.einsum("nij,nj->ni", slopes, straight)
        return np.asarray(local @ matrices)

    def _shear(self, shape: IntArray, v_px: Array) -> Array:
        """Return `(1 - p_v e_vᵀ)⁻¹` (N, 2, 2), where p_v is the motion of an origin's image per row."""
        there = []
        for v in (v_px - 0.5, v_px + 0.5):
            moved = self._at(self.matrices, shape, v)
            there.append(distort(self.camera, self.zoom, moved[:, :2, 2] / moved[:, 2:, 2]))
        change = np.zeros((len(shape), 2, 2))
        change[:, :, 1] = there[1] - there[0]
        return inverse(np.eye(2) - change)


@dataclass(frozen=True)
class View:
    """One exposure of a camera.

    Attributes:
        camera: intrinsics and lens.
        pose: pose in the middle of the exposure of the middle row.
        motion: velocities of camera and robots.
        shutter: exposure and row time.
        at_s: time within the exposure, s from its middle.
        ray: ray through the pupil; None for the central one.
    """

    camera: Camera
    pose: CameraPose
    motion: Motion = STILL
    shutter: Shutter = INSTANT
    at_s: float = 0.0
    ray: Ray | None = None

    def images(self, ground_shapes: Callable[[float], Array]) -> ShapeImages:
        """Return the images of shapes on the ground.

        Args:
            ground_shapes: function from a time, s, to the homographies (N, 3, 3) from shape coordinates to
                ground metres.
        """
        shapes = np.array([ground_shapes(time_s + self.at_s) for time_s in self._times_s])
        return self._of(self._homographies[:, None] @ shapes)

    def ground(self) -> ShapeImages:
        """Return the image of the ground, as a single shape with coordinates in metres."""
        return self._of(self._homographies[:, None])

    def _of(self, matrices: Array) -> ShapeImages:
        return ShapeImages(self.camera, self.pose.zoom, np.array(self._times_s), matrices)

    @property
    def _times_s(self) -> list[float]:
        """Instants as in `ShapeImages`."""
        half_s = self.shutter.row_time_s * self.camera.size_px[1] / 2
        return [-half_s, 0.0, half_s] if half_s else [0.0]

    @cached_property
    def _homographies(self) -> Array:
        """Homographies (Q, 3, 3) from ground metres to undistorted pixels at these instants."""
        times_s = [time_s + self.at_s for time_s in self._times_s]
        poses = [self.motion.pose_at(self.pose, time_s) if time_s else self.pose for time_s in times_s]
        if self.ray is None:
            return np.array([homography_image_ground(self.camera, pose) for pose in poses])
        return np.array([self.ray.homography(self.camera, pose) for pose in poses])

    def ground_box(self) -> tuple[Array, Array]:
        """Return the lower and upper corner (2,), m, of a bounding box of the ground in view."""
        corners = self.camera.corners_px
        border = np.concatenate(
            [corners + share * (np.roll(corners, -1, axis=0) - corners) for share in (0, 0.5)]
        )
        ground_image = inverse(self.ground().matrices[:, 0])
        straight = undistort(self.camera, self.pose.zoom, border)
        seen = np.concatenate([apply_homography(matrix, straight) for matrix in ground_image])
        return seen.min(axis=0), seen.max(axis=0)
