"""Perspective cameras over the ground plane: homographies from ground to pixels.

A camera looks straight down unless tilted. At yaw psi its image axis +u lies along (cos psi, sin psi)
on the ground, and +v along (sin psi, -cos psi). The image is not mirrored. For square pixels and no tilt,
with ground points as complex numbers,

    p = c + (f / h) conj((x - x_camera) exp(-i psi)).

Frames: ground points are (x, y) in metres, z up. Image points are (u, v) in pixels, u right and v down;
integers are pixel centres. Camera rays are (x, y) in normalized image coordinates, on the plane at distance 1
in front of the camera.

Each image needs the lens displacement of each pixel. `lens_field` computes it at knots a few pixels apart and
interpolates by splines. A change of zoom then costs as much as one image instead of forty.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array, apply_homography, inverse
from skyherd.messages.checks import check_kind
from skyherd.render.camera.fisheye import Equidistant
from skyherd.render.camera.lens import NO_DISTORTION, Distortion
from skyherd.render.camera.lens_displacement import LensField

KNOT_PX = 5
"""Distance of the knots of the lens field, px. *Chosen*: quintic splines are then accurate to 1e-4 px, and to
1e-3 px where a lens almost folds the image."""

MIN_KNOTS = 48
"""Minimum number of knots along a side of an image. *Chosen*: keeps the splines accurate in small images,
where the distortion changes faster per pixel."""


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a camera and its lens; the `zoom` of a pose multiplies the focal length.

    Attributes:
        size_px: width and height.
        focal_px: focal length along u.
        principal_point_px: principal point; the image centre if None.
        aspect: ratio of the focal lengths along v and u; 1 for square pixels.
        skew: skew coefficient, as a fraction of the focal length.
        mirrored: True if the stream is flipped left to right.
        distortion: lens model: Brown–Conrady or equidistant fisheye.

    Raises:
        InputError: a size or focal length is not positive, or the lens folds the image.
    """

    size_px: tuple[int, int]
    focal_px: float
    principal_point_px: tuple[float, float] | None = None
    aspect: float = 1.0
    skew: float = 0.0
    mirrored: bool = False
    distortion: Distortion | Equidistant = NO_DISTORTION

    def __post_init__(self) -> None:
        if min(self.size_px) < 1 or self.focal_px <= 0 or self.aspect <= 0:
            raise InputError(
                "camera",
                f"size {self.size_px}, focal_px {self.focal_px}, aspect {self.aspect}",
                "all must be positive",
            )
        check_kind(
            "Camera.distortion", self.distortion, (Distortion, Equidistant), "a Distortion or Equidistant"
        )
        if self.distortion:
            self._check_lens()

    def _check_lens(self) -> None:
        """Raise InputError if the radial polynomial folds back inside the image corners."""
        rays = self.distortion.remove(apply_homography(inverse(self.intrinsic_matrix()), self.corners_px))
        if (rays**2).sum(axis=-1).max() >= self.distortion.turn():
            raise InputError(
                "camera",
                f"{self.distortion} folds the image over",
                "smaller k1, k2, k3, or a longer focal_px",
            )

    @property
    def corners_px(self) -> Array:
        """Corners (4, 2) of the image border, half a pixel outside the outermost pixel centres."""
        width, height = self.size_px
        right, bottom = width - 0.5, height - 0.5
        return np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])

    def intrinsic_matrix(self, zoom: float = 1.0) -> Array:
        """Return K (3, 3), the homography from camera rays to pixels without distortion."""
        width, height = self.size_px
        cu, cv = self.principal_point_px or ((width - 1) / 2, (height - 1) / 2)
        f = self.focal_px * zoom
        matrix = np.array([[f, self.skew * f, cu], [0.0, self.aspect * f, cv], [0.0, 0.0, 1.0]])
        if self.mirrored:
            matrix = np.array([[-1.0, 0.0, width - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ matrix
        return matrix


@dataclass(frozen=True)
class CameraPose:
    """Position, orientation and zoom of a camera.

    Attributes:
        position_m: ground point (x, y) below the camera.
        height_m: height above the ground.
        yaw_rad: direction of the image's +u axis on the ground, counter-clockwise from +x.
        tilt_rad: rotations of the scene about the camera's +u axis, then about its +v axis, right-handed. The
            camera itself rotates the opposite way.
        zoom: factor on the focal length.
    """

    position_m: tuple[float, float]
    height_m: float
    yaw_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    zoom: float = 1.0


def rotation_camera_world(pose: CameraPose) -> Array:
    """Return R (3, 3) from world to camera axes; the camera's z axis points down when untilted."""
    check_kind("rotation_camera_world: pose", pose, CameraPose, "a CameraPose")
    c, s = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
    downward = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    ca, sa = np.cos(pose.tilt_rad[0]), np.sin(pose.tilt_rad[0])
    cb, sb = np.cos(pose.tilt_rad[1]), np.sin(pose.tilt_rad[1])
    about_u = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_v = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    return np.asarray(about_v @ about_u @ downward)


@lru_cache(maxsize=32)
def homography_image_ground(camera: Camera, pose: CameraPose) -> Array:
    """Return H (3, 3) from ground metres to pixels: `H = K [r1 r2 -R c]`, scaled to |H[2, 2]| = 1.

    The last row is positive for points in front of the camera, so that H[2, 2] = -1 if the ground's origin is
    behind the camera.
    """
    check_kind("homography_image_ground: camera", camera, Camera, "a Camera")
    check_kind("homography_image_ground: pose", pose, CameraPose, "a CameraPose")
    rotation = rotation_camera_world(pose)
    center = np.array([*pose.position_m, pose.height_m])
    matrix = camera.intrinsic_matrix(pose.zoom) @ np.column_stack([rotation[:, :2], -rotation @ center])
    scaled: Array = matrix / abs(matrix[2, 2])
    scaled.setflags(write=False)
    return scaled


def distort(camera: Camera, zoom: float, points_px: Array) -> Array:
    """Return the distorted pixels (..., 2) of undistorted pixels (..., 2) at the zoom of a pose.

    Without distortion the points are returned unchanged.
    """
    if not camera.distortion:
        return points_px
    matrix = camera.intrinsic_matrix(zoom)
    rays = apply_homography(inverse(matrix), points_px)
    return apply_homography(matrix, camera.distortion.at(zoom).apply(rays))


def undistort(camera: Camera, zoom: float, points_px: Array) -> Array:
    """Return the undistorted pixels (..., 2) of distorted pixels (..., 2): the inverse of `distort`.

    Raises:
        InputError: the lens folds the image at a pixel, so that no ray belongs to it.
    """
    check_kind("undistort: camera", camera, Camera, "a Camera")
    if not camera.distortion:
        return points_px
    matrix = camera.intrinsic_matrix(zoom)
    rays = apply_homography(inverse(matrix), points_px)
    return apply_homography(matrix, camera.distortion.at(zoom).remove(rays))


def lens_jacobians(camera: Camera, zoom: float, points_px: Array) -> Array:
    """Return the Jacobians (..., 2, 2) of `distort` at undistorted pixels (..., 2)."""
    matrix = camera.intrinsic_matrix(zoom)
    rays = apply_homography(inverse(matrix), points_px)
    plane = matrix[:2, :2]
    return np.asarray(plane @ camera.distortion.at(zoom).jacobian(rays) @ inverse(plane))


@lru_cache(maxsize=8)
def lens_field(camera: Camera, zoom: float) -> LensField | None:
    """Return the lens displacement of each pixel of an image, or None without distortion.

    The last eight are cached, since computing one costs as much as drawing an image.
    """
    if not camera.distortion:
        return None
    (u_knots, along_u), (v_knots, along_v) = (_spline(length) for length in camera.size_px)
    knots = np.stack(np.meshgrid(u_knots, v_knots), axis=-1)
    straight = undistort(camera, zoom, knots)
    slopes = inverse(lens_jacobians(camera, zoom, straight)).reshape(*knots.shape[:2], 4)
    fields = np.concatenate([straight - knots, slopes], axis=-1).transpose(2, 0, 1)
    return LensField((along_v @ fields @ along_u.T).astype(np.float32).reshape(6, -1))


@lru_cache(maxsize=16)
def _spline(length: int) -> tuple[Array, Array]:
    """Return knots (K,) along a side of `length` pixels, and spline weights (length, K) at each pixel."""
    # Imported with the first lens: it takes long, and cameras without a lens do not need it.
    from scipy.interpolate import make_interp_spline

    knots = np.linspace(-0.5, length - 0.5, max(MIN_KNOTS, length // KNOT_PX))
    weights = make_interp_spline(knots, np.eye(knots.size), k=5)(np.arange(length))
    return knots, np.asarray(weights)


def project(camera: Camera, pose: CameraPose, points_m: npt.ArrayLike) -> Array:
    """Project ground points (..., 2), m, to distorted pixels (..., 2).

    The points must lie on the camera's side of the horizon. Other points are mirrored through it.
    """
    check_kind("project: camera", camera, Camera, "a Camera")
    check_kind("project: pose", pose, CameraPose, "a CameraPose")
    return distort(camera, pose.zoom, apply_homography(homography_image_ground(camera, pose), points_m))


def footprint_m(camera: Camera, pose: CameraPose) -> Array:
    """Return the ground points (4, 2), m, at the image corners, clockwise from the upper left."""
    ground_image = inverse(homography_image_ground(camera, pose))
    return apply_homography(ground_image, undistort(camera, pose.zoom, camera.corners_px))
