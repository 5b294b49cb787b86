"""Perspective cameras over the ground plane: the map from ground to pixels, as a homography.

A camera looks straight down unless tilted. At yaw psi its image axis +u lies along (cos psi, sin psi)
on the ground and +v along (sin psi, -cos psi): the image is what one sees looking down, not mirrored.
For square pixels and no tilt, with ground points as complex numbers,

    p = c + (f / h) conj((x - x_camera) exp(-i psi)).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array, apply_homography, to_complex
from skyherd.markers import CORNERS


@dataclass(frozen=True)
class Camera:
    """Intrinsics; `zoom` of the pose multiplies the focal length.

    Attributes:
        size_px: width, height.
        focal_px: focal length along u.
        principal_point_px: where the optical axis meets the image; the image centre if None.
        aspect: focal length along v over that along u; 1 for square pixels.
        skew: change of u with v along the sensor, as a fraction of the focal length.
        mirrored: the stream is flipped left to right, as behind a mirror.
    """

    size_px: tuple[int, int]
    focal_px: float
    principal_point_px: tuple[float, float] | None = None
    aspect: float = 1.0
    skew: float = 0.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        if min(self.size_px) < 1 or self.focal_px <= 0 or self.aspect <= 0:
            raise InputError(
                "camera",
                f"size {self.size_px}, focal_px {self.focal_px}, aspect {self.aspect}",
                "all must be positive",
            )

    def intrinsic_matrix(self, zoom: float = 1.0) -> Array:
        """K (3, 3), from camera rays to pixels."""
        width, height = self.size_px
        cu, cv = self.principal_point_px or ((width - 1) / 2, (height - 1) / 2)
        f = self.focal_px * zoom
        matrix = np.array([[f, self.skew * f, cu], [0.0, self.aspect * f, cv], [0.0, 0.0, 1.0]])
        if self.mirrored:
            matrix = np.array([[-1.0, 0.0, width - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ matrix
        return matrix


@dataclass(frozen=True)
class CameraPose:
    """Where a camera is: ground position (x, y), height, yaw, tilt, zoom.

    A positive tilt turns the scene about the camera's +u (then +v) axis, right-handed: the camera itself
    turns the other way.
    """

    position_m: tuple[float, float]
    height_m: float
    yaw_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    zoom: float = 1.0


def rotation_camera_world(pose: CameraPose) -> Array:
    """R (3, 3) from world to camera axes; the camera's z axis points down when untilted."""
    c, s = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
    downward = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    ca, sa = np.cos(pose.tilt_rad[0]), np.sin(pose.tilt_rad[0])
    cb, sb = np.cos(pose.tilt_rad[1]), np.sin(pose.tilt_rad[1])
    about_u = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_v = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    return np.asarray(about_v @ about_u @ downward)


def homography_image_ground(camera: Camera, pose: CameraPose) -> Array:
    """H (3, 3) from ground metres to pixels: `H = K [r1 r2 -R c]`, scaled so that H[2, 2] = 1."""
    rotation = rotation_camera_world(pose)
    center = np.array([*pose.position_m, pose.height_m])
    matrix = camera.intrinsic_matrix(pose.zoom) @ np.column_stack([rotation[:, :2], -rotation @ center])
    return np.asarray(matrix / matrix[2, 2])


def project(camera: Camera, pose: CameraPose, points_m: npt.ArrayLike) -> Array:
    """Pixels (..., 2) of ground points (..., 2)."""
    return apply_homography(homography_image_ground(camera, pose), points_m)


def footprint_m(camera: Camera, pose: CameraPose) -> Array:
    """Ground points (4, 2) under the image's corners."""
    width, height = camera.size_px
    border: Array = np.array(
        [[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]]
    )
    ground_image = np.linalg.inv(homography_image_ground(camera, pose))
    return apply_homography(np.asarray(ground_image, dtype=np.float64), border)


@dataclass(frozen=True)
class MarkerProjection:
    """Exact image of a team's markers: the truth that a detector is judged by.

    Attributes:
        centers_px: (N, 2) images of the robots' positions.
        corners_px: (N, 4, 2) images of the markers' corners.
        whole: (N,) whether the marker and its whole card lie in the image.
    """

    centers_px: Array
    corners_px: Array
    whole: npt.NDArray[np.bool_]


def square_m(positions_m: npt.ArrayLike, headings_rad: npt.ArrayLike, side_m: float) -> Array:
    """Ground corners (N, 4, 2) of squares of `side_m` around robots, in the marker's corner order."""
    forward = np.exp(1j * np.asarray(headings_rad, dtype=float))
    corners = to_complex(positions_m)[:, None] + side_m * forward[:, None] * CORNERS.conj()
    return np.stack([corners.real, corners.imag], axis=-1)


def project_markers(
    camera: Camera,
    pose: CameraPose,
    positions_m: npt.ArrayLike,
    headings_rad: npt.ArrayLike,
    side_m: float,
    card_side_m: float,
) -> MarkerProjection:
    """Project markers of `side_m` on cards of `card_side_m` that lie on the ground."""
    homography = homography_image_ground(camera, pose)
    cards = apply_homography(homography, square_m(positions_m, headings_rad, card_side_m))
    limit = np.array(camera.size_px) - 0.5
    # The scale H[2, 2] = 1 leaves w positive on the nadir's side of the horizon, which the camera is on.
    ahead = np.asarray(positions_m, dtype=float) @ homography[2, :2] + homography[2, 2] > 0
    return MarkerProjection(
        centers_px=apply_homography(homography, positions_m),
        corners_px=apply_homography(homography, square_m(positions_m, headings_rad, side_m)),
        whole=np.asarray(((cards >= -0.5) & (cards <= limit)).all(axis=(1, 2)) & ahead),
    )
