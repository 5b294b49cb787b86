"""Lens blur besides the Gaussian: defocus and coma, as means over rays through the pupil.

The ray through the pupil's point ρ e^{iθ}, 0 ≤ ρ ≤ 1, is displaced in the image from the central ray by
(complex, px)

    d = ρ e^{iθ} (disc + f A/2 (1/z_focus - 1/z)) + coma e^{iα} (ρ² (2 + e^{2i(θ - α)}) - 1),

with f the focal length in px, A the aperture's diameter, z the point's distance along the optical axis, and α
the direction of the coma. The first term is the circle of confusion of a thin lens: a uniform disc, whose
radius is 0 in focus. The second is Seidel's third-order coma, the same over the whole image. Its mean is
subtracted, so that it moves no marker. Variances along and across: disc r²/4 and r²/4, coma C²/2 and C²/6.

An image is the weighted mean of the sharp images of the rays, on top of the Gaussian of `psf_px`. The weights
are a cubature over the pupil: Gauss–Legendre along ρ², equal steps along θ. On a plane 1/z is affine in the
image, so that each ray sees the ground through an exact homography of its own. Displacements are applied
before the lens distortion.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array, inverse
from skyherd.render.camera.camera import (
    Camera,
    CameraPose,
    homography_image_ground,
    rotation_camera_world,
    undistort,
)

RADIAL_PER_SIGMA, RADIAL_LEAST = 0.5, 0.5
ANGULAR_PER_SIGMA, ANGULAR_LEAST = 1.5, 3.0
"""Cubature nodes along ρ² and θ: per σ (lens and pixel) of ray spread, plus a constant. *Measured*: with
three times as many, pixels of a marker change by less than 0.3 grey levels of 200, and 0.03 RMS."""

MAX_RAYS = 1024
"""Maximum number of rays. *Chosen*: enough for discs of a radius of about 30 σ; larger discs show single
rays."""


@dataclass(frozen=True)
class Ray:
    """Ray through a point of the pupil. Its displacement is `shift_px - parallax_px_m / z`.

    Attributes:
        shift_px: (2,) displacement from the central ray for a point at infinity.
        parallax_px_m: (2,) decrease of the displacement for each 1/m of inverse distance.
        weight: share of the light.
    """

    shift_px: Array
    parallax_px_m: Array
    weight: float

    def homography(self, camera: Camera, pose: CameraPose) -> Array:
        """Return this ray's H (3, 3) from ground metres to undistorted pixels.

        `H' = H + shift h₃ - parallax s (0, 0, 1)`, where h₃ is H's last row, s times the distance z.
        """
        through_middle = homography_image_ground(camera, pose)
        seen = np.array(through_middle)
        seen[:2] += np.outer(self.shift_px, through_middle[2])
        seen[:2, 2] -= self.parallax_px_m * _per_metre(pose)
        return seen


@dataclass(frozen=True)
class LensBlur:
    """Defocus and coma of a lens, besides its Gaussian blur; each part is off at 0.

    Attributes:
        disc_px: radius of a constant defocus disc.
        coma_px: C of the coma, with a blur about 3 C long.
        coma_rad: direction of the coma's tail in the image, from +u to +v.
        aperture_m: diameter of the aperture, for defocus that depends on the distance.
        focus_m: distance along the optical axis at which points are in focus.

    Raises:
        InputError: a radius, length or aperture is negative, or the focus distance is not positive.
    """

    disc_px: float = 0.0
    coma_px: float = 0.0
    coma_rad: float = 0.0
    aperture_m: float = 0.0
    focus_m: float = 10.0

    def __post_init__(self) -> None:
        if min(self.disc_px, self.coma_px, self.aperture_m) < 0 or self.focus_m <= 0:
            raise InputError(
                "lens",
                f"disc_px {self.disc_px}, coma_px {self.coma_px}, aperture_m {self.aperture_m}, "
                f"focus_m {self.focus_m}",
                "none negative, and focus_m positive",
            )

    @property
    def none(self) -> bool:
        """True without defocus and coma."""
        return not (self.disc_px or self.coma_px or self.aperture_m)

    def radii_px(self, camera: Camera, pose: CameraPose, points_px: Array) -> Array:
        """Return signed radii (...), px, of the ground's discs at pixels (..., 2); positive behind the focus.

        `disc + f A/2 (1/z_focus - 1/z)`; f is the focal length along u.
        """
        reach = camera.focal_px * pose.zoom * self.aperture_m / 2
        return np.asarray(self.disc_px + reach * (1 / self.focus_m - inverse_depths(camera, pose, points_px)))

    def variances_px2(self, camera: Camera, pose: CameraPose, points_px: Array) -> Array:
        """Return the blur's variance per axis (...), px², mean of both axes, at pixels (..., 2).

        `r²/4 + C²/3`.
        """
        return np.asarray(self.radii_px(camera, pose, points_px) ** 2 / 4 + self.coma_px**2 / 3)

    def rays(self, camera: Camera, pose: CameraPose, sigma_px: float) -> list[Ray]:
        """Return the rays whose weighted mean image is the blurred one; their weights sum to one.

        Args:
            camera: intrinsics and lens.
            pose: pose of the camera.
            sigma_px: standard deviation of Gaussian and pixel together; a smaller one needs more rays.
        """
        radius = float(np.abs(self.radii_px(camera, pose, camera.corners_px)).max())
        # Coma spreads rays by 3 C along ρ², and its phase 2θ turns twice per turn of θ.
        along, around = ((radius + times * self.coma_px) / sigma_px for times in (4, 3))
        rings = int(np.ceil(RADIAL_PER_SIGMA * along + RADIAL_LEAST))
        spokes = int(np.ceil(ANGULAR_PER_SIGMA * around + ANGULAR_LEAST))
        rings = min(rings, MAX_RAYS // min(spokes, MAX_RAYS))
        nodes, weights = np.polynomial.legendre.leggauss(rings)
        square = np.repeat((nodes + 1) / 2, spokes)
        turn = np.arange(spokes) + np.arange(rings)[:, None] / 2
        angle = 2 * np.pi / spokes * turn.ravel()
        pupil = np.sqrt(square) * np.exp(1j * angle)
        tail = np.exp(1j * self.coma_rad)
        coma = self.coma_px * tail * (square * (2 + np.exp(2j * (angle - self.coma_rad))) - 1)
        at = pupil[:, None].view(float)
        focal_px = camera.focal_px * pose.zoom * np.array([1.0, camera.aspect])
        parallax = at * focal_px * self.aperture_m / 2
        shift = self.disc_px * at + coma[:, None].view(float) + parallax / self.focus_m
        shares = np.repeat(weights / 2 / spokes, spokes)
        return [Ray(*ray) for ray in zip(shift, parallax, shares.tolist(), strict=True)]


SHARP = LensBlur()
"""Lens without defocus and coma."""


def inverse_depths(camera: Camera, pose: CameraPose, points_px: Array) -> Array:
    """Return inverse distances (...), 1/m, of the ground at pixels (..., 2), along the optical axis.

    `1/z = s h · (u, v, 1)`, where h is the last row of the inverse homography; 0 at the horizon and beyond.
    """
    straight = undistort(camera, pose.zoom, points_px)
    row = inverse(homography_image_ground(camera, pose))[2]
    return np.asarray(np.maximum(_per_metre(pose) * (straight @ row[:2] + row[2]), 0.0))


def _per_metre(pose: CameraPose) -> float:
    """Return s, 1/m, the ratio of the homography's last row to the distance z."""
    center = np.array([*pose.position_m, pose.height_m])
    return float(1.0 / abs(rotation_camera_world(pose)[2] @ center))
