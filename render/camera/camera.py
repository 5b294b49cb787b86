"""Perspective cameras over the ground plane: the map from ground to pixels, as a homography.

A camera looks straight down unless tilted. At yaw psi its image axis +u lies along (cos psi, sin psi)
on the ground and +v along (sin psi, -cos psi): the image is what one sees looking down, not mirrored.
For square pixels and no tilt, with ground points as complex numbers,

    p = c + (f / h) conj((x - x_camera) exp(-i psi)).

Frames: ground points are (x, y) in metres, z up. Image points are (u, v) in pixels, u right and v down, an
integer being a pixel's centre. Camera rays are (x, y) where they meet the plane at distance 1 before the
camera.

What a lens does to each pixel of an image is needed for every image. It is computed at knots a few pixels
apart and splined between them (`lens_field`), so that a change of zoom costs as much as one image, and not
forty.
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
"""Distance of the knots at which a lens is computed, px. *Chosen*: splines of the fifth degree between them
are right to 1e-4 px, and to 1e-3 px where a lens is about to fold. Fewer knots cost less and are less
exact."""

MIN_KNOTS = 48
"""Knots along a side of an image, at least. *Chosen*: keeps the splines exact in small images, where a lens
bends as much over fewer pixels."""


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a camera and its lens; the `zoom` of a pose multiplies the focal length.

    Attributes:
        size_px: width, height.
        focal_px: focal length along u.
        principal_point_px: where the optical axis meets the image; the image centre if None.
        aspect: focal length along v over that along u; 1 for square pixels.
        skew: change of u with v along the sensor, as a fraction of the focal length.
        mirrored: the stream is flipped left to right, as behind a mirror.
        distortion: the lens: a perspective one after Brown and Conrady, or an equidistant fisheye.

    Raises:
        InputError: a size or focal length is not positive, or the lens makes no image of this size.
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
        """Each corner of the image must see a ray before the lens's polynomial turns back."""
        rays = self.distortion.remove(apply_homography(inverse(self.intrinsic_matrix()), self.corners_px))
        if (rays**2).sum(axis=-1).max() >= self.distortion.turn():
            raise InputError(
                "camera",
                f"{self.distortion} folds the image over",
                "smaller k1, k2, k3, or a longer focal_px",
            )

    @property
    def corners_px(self) -> Array:
        """Return corners (4, 2) of the image's border, half a pixel outside the outermost pixels' centres."""
        width, height = self.size_px
        right, bottom = width - 0.5, height - 0.5
        return np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])

    def intrinsic_matrix(self, zoom: float = 1.0) -> Array:
        """K (3, 3): homography from camera rays to pixels, before the lens's distortion."""
        width, height = self.size_px
        cu, cv = self.principal_point_px or ((width - 1) / 2, (height - 1) / 2)
        f = self.focal_px * zoom
        matrix = np.array([[f, self.skew * f, cu], [0.0, self.aspect * f, cv], [0.0, 0.0, 1.0]])
        if self.mirrored:
            matrix = np.array([[-1.0, 0.0, width - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ matrix
        return matrix


@dataclass(frozen=True)
class CameraPose:
    """Position, rotation and zoom of a camera.

    Attributes:
        position_m: the ground point (x, y) below it.
        height_m: height above the ground.
        yaw_rad: direction of the image's +u axis on the ground, counter-clockwise from +x.
        tilt_rad: turns of the scene about the camera's +u axis, and then about its +v axis, right-handed; the
            camera itself turns the other way.
        zoom: factor on the focal length.
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


@lru_cache(maxsize=32)
def homography_image_ground(camera: Camera, pose: CameraPose) -> Array:
    """H (3, 3) from ground metres to pixels: `H = K [r1 r2 -R c]`, scaled so that H[2, 2] = 1.

    It is -1 where the ground's origin lies behind the camera, since the last row is positive before it.
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
    """Take pixels (..., 2) as they would be without the lens to where they are seen through it.

    `zoom` is the pose's. Without a distortion the points come back as they are.
    """
    if not camera.distortion:
        return points_px
    matrix = camera.intrinsic_matrix(zoom)
    rays = apply_homography(inverse(matrix), points_px)
    return apply_homography(matrix, camera.distortion.at(zoom).apply(rays))


def undistort(camera: Camera, zoom: float, points_px: Array) -> Array:
    """Take pixels (..., 2) seen through the lens to where they would be without it: the inverse of `distort`.

    Raises:
        InputError: a pixel shows no ray, since the lens folds the image there.
    """
    check_kind("undistort: camera", camera, Camera, "a Camera")
    if not camera.distortion:
        return points_px
    matrix = camera.intrinsic_matrix(zoom)
    rays = apply_homography(inverse(matrix), points_px)
    return apply_homography(matrix, camera.distortion.at(zoom).remove(rays))


def lens_jacobians(camera: Camera, zoom: float, points_px: Array) -> Array:
    """Return derivatives (..., 2, 2) of `distort` at pixels (..., 2) as they would be without the lens."""
    matrix = camera.intrinsic_matrix(zoom)
    rays = apply_homography(inverse(matrix), points_px)
    plane = matrix[:2, :2]
    return np.asarray(plane @ camera.distortion.at(zoom).jacobian(rays) @ inverse(plane))


@lru_cache(maxsize=8)
def lens_field(camera: Camera, zoom: float) -> LensField | None:
    """Return the lens displacement of each pixel of an image, or None without one.

    The last eight are kept, since computing one costs as much as drawing an image.
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
    """Knots (K,) along a side of so many pixels, and weights (length, K) of values there at each pixel."""
    # Imported with the first lens: it takes long, and cameras without a lens do not need it.
    from scipy.interpolate import make_interp_spline

    knots = np.linspace(-0.5, length - 0.5, max(MIN_KNOTS, length // KNOT_PX))
    weights = make_interp_spline(knots, np.eye(knots.size), k=5)(np.arange(length))
    return knots, np.asarray(weights)


def project(camera: Camera, pose: CameraPose, points_m: npt.ArrayLike) -> Array:
    """Return pixels (..., 2), through the lens, of ground points (..., 2) in metres.

    The points have to lie before the camera's horizon; others come out mirrored through it.
    """
    check_kind("project: camera", camera, Camera, "a Camera")
    check_kind("project: pose", pose, CameraPose, "a CameraPose")
    return distort(camera, pose.zoom, apply_homography(homography_image_ground(camera, pose), points_m))


def footprint_m(camera: Camera, pose: CameraPose) -> Array:
    """Ground points (4, 2), metres, under the image's corners, clockwise from the upper left."""
    ground_image = inverse(homography_image_ground(camera, pose))
    return apply_homography(ground_image, undistort(camera, pose.zoom, camera.corners_px))
