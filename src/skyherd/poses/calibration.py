"""Intrinsics of a calibrated camera: pinhole, Brown–Conrady or Kannala–Brandt, by OpenCV's functions.

A camera has axes x right, y down and z ahead, and its origin in the projection centre. Image points are (u,
v), px, with integers at pixel centres, as OpenCV's.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.messages.checks import shown
from skyherd.messages.frozen_arrays import freeze

COEFFICIENTS = (0, 4, 5, 8, 12, 14)
"""Numbers of Brown–Conrady coefficients that OpenCV knows: none; with k3; rational; thin prism; tilted."""

FISHEYE_COEFFICIENTS = 4
"""Number of Kannala–Brandt coefficients."""

MAX_SIZE_PX, MAX_FOCAL_PX = 65535, 1e6
"""Maximum side of an image and maximum focal length, px. Chosen: beyond any camera."""

CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
"""When OpenCV ends the iteration of a fisheye's rays. Chosen: far below the error of a corner."""

_AT_ORIGIN = np.zeros((3, 1))


@dataclass(frozen=True)
class Calibration:
    """Intrinsics of one camera, as a file states them.

    Attributes:
        size_px: (width, height) of the images; None if the file does not state it.
        matrix: (3, 3) OpenCV's camera matrix, px.
        coefficients: (D,) distortion coefficients in OpenCV's order: k1, k2, p1, p2, k3, … or, of a fisheye,
            k1 to k4. Empty for a lens without distortion.
        fisheye: True for the Kannala–Brandt model (equidistant), False for Brown–Conrady.

    Raises:
        InputError: a number is not finite, or no camera has it.
    """

    size_px: tuple[int, int] | None
    matrix: Array
    coefficients: Array
    fisheye: bool = False

    def __post_init__(self) -> None:
        self._check()
        freeze(self, "matrix", (3, 3))
        freeze(self, "coefficients", (np.size(self.coefficients),))

    def _check(self) -> None:
        """Raise InputError for values that no camera has."""
        matrix, coefficients = (
            np.asarray(self.matrix, dtype=float),
            np.asarray(self.coefficients, dtype=float),
        )
        if self.size_px is not None and not all(0 < side <= MAX_SIZE_PX for side in self.size_px):
            raise InputError("image size", f"{self.size_px} px", f"1 to {MAX_SIZE_PX} px a side")
        form = "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise InputError("camera matrix", "not three rows of three finite numbers", form)
        if (matrix.ravel()[[1, 3, 6, 7, 8]] != [0, 0, 0, 0, 1]).any():
            raise InputError("camera matrix", f"{shown(matrix.tolist())}", form)
        focals, centers = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        if not ((focals > 0) & (focals < MAX_FOCAL_PX) & (np.abs(centers) < MAX_FOCAL_PX)).all():
            raise InputError(
                "camera matrix", f"fx, fy, cx, cy {[*focals, *centers]}", "px; fx and fy above 0"
            )
        allowed = (FISHEYE_COEFFICIENTS,) if self.fisheye else COEFFICIENTS
        if coefficients.ndim != 1 or coefficients.size not in allowed:
            numbers = " or ".join(map(str, allowed))
            raise InputError("distortion coefficients", f"{coefficients.size} numbers", numbers)
        if not np.isfinite(coefficients).all():
            raise InputError("distortion coefficients", "not all finite", "finite numbers")

    def check_image(self, where: str, size_px: tuple[int, int]) -> None:
        """Raise InputError if images of another size than the calibrated one are to be measured."""
        if self.size_px is not None and tuple(size_px) != tuple(self.size_px):
            raise InputError(
                where,
                f"{size_px[0]} x {size_px[1]} px, calibrated at {self.size_px[0]} x {self.size_px[1]} px",
                "a calibration at the size of the images",
            )

    def project(self, points_m: Array) -> Array:
        """Return the image points (..., 2), px, of points (..., 3) in the camera's axes, in front of it."""
        return self._project(points_m)[0]

    def jacobians(self, points_m: Array) -> Array:
        """Return the derivatives (..., 2, 3), px/m, of `project` at points (..., 3)."""
        return self._project(points_m)[1]

    def _project(self, points_m: Array) -> tuple[Array, Array]:
        points = np.ascontiguousarray(points_m, dtype=float).reshape(-1, 1, 3)
        if not len(points):
            return np.zeros((*points_m.shape[:-1], 2)), np.zeros((*points_m.shape[:-1], 2, 3))
        given = points, _AT_ORIGIN, _AT_ORIGIN, self.matrix
        if self.fisheye:
            image, jacobian = cv2.fisheye.projectPoints(*given, self.coefficients)
            by_shift = slice(11, 14)
        else:
            image, jacobian = cv2.projectPoints(*given, self.coefficients)
            by_shift = slice(3, 6)
        shape = points_m.shape[:-1]
        by_point = np.asarray(jacobian, dtype=float)[:, by_shift]
        return np.asarray(image, dtype=float).reshape(*shape, 2), by_point.reshape(*shape, 2, 3)

    def rays(self, points_px: Array) -> Array:
        """Return the rays (..., 2) of image points (..., 2), px: x / z and y / z in the camera's axes."""
        points = np.ascontiguousarray(points_px, dtype=float).reshape(-1, 1, 2)
        if not len(points):
            return np.zeros(points_px.shape)
        if self.fisheye:
            rays = cv2.fisheye.undistortPoints(points, self.matrix, self.coefficients, criteria=CRITERIA)
        else:
            rays = cv2.undistortPoints(points, self.matrix, self.coefficients)
        return np.asarray(rays, dtype=float).reshape(points_px.shape)
