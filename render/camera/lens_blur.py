"""Lens blur that is no Gaussian: discs of defocus and coma, as means over the rays through the lens's pupil.

A point is seen through every part of the lens's opening, the pupil. A ray through the pupil's point ρ e^{iθ},
0 ≤ ρ ≤ 1, meets the image beside the ray through the middle, by (complex, px)

    d = ρ e^{iθ} (disc + f A/2 (1/z_focus - 1/z)) + coma e^{iα} (ρ² (2 + e^{2i(θ - α)}) - 1),

with f the focal length in px, A the aperture's diameter, z the point's distance along the optical axis, and α
the direction of the coma. The first term is the circle of confusion of a thin lens: a disc, evenly lit, whose
radius is 0 in focus. The second is Seidel's third-order coma, the same over the whole image, with its mean
taken off, so that it moves no marker. Variances along and across: disc r²/4 and r²/4, coma C²/2 and C²/6.

An image is the mean of the sharp ones that the rays see, all drawn exactly, on top of the Gaussian of
`psf_px`: a cubature over the pupil, Gauss and Legendre along ρ² and even steps along θ. On a plane 1/z is
affine in the image, so that each ray sees the ground through a homography of its own, to which no depth map
comes near in exactness. Displacements are those before the lens's distortion, which stretches them as it
stretches everything.
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
"""Nodes of the cubature along ρ² and along θ: so many for each standard deviation σ of lens and pixel that
rays spread, and these more, rounded up. *Measured*: with three times as many no pixel of a marker changes by
0.3 grey levels of 200, their root mean square by 0.03 (`tests/render/camera/test_lens_blur.py`)."""

MAX_RAYS = 1024
"""Rays at most. *Chosen*: enough for discs of a radius of some 30 σ; a larger one shows single rays."""


@dataclass(frozen=True)
class Ray:
    """One of the rays through the pupil.

    Attributes:
        shift_px: (2,) by how much it is beside the middle one, whatever it comes from.
        parallax_px_m: (2,) what is taken from that for each 1/m of the inverse distance.
        weight: its share of the light.
    """

    shift_px: Array
    parallax_px_m: Array
    weight: float

    def homography(self, camera: Camera, pose: CameraPose) -> Array:
        """H (3, 3) from ground metres to pixels, before the lens's distortion, as this ray sees the ground.

        `H' = H + shift h₃ - parallax s (0, 0, 1)`, h₃ being H's last row, which is s times the distance z.
        """
        through_middle = homography_image_ground(camera, pose)
        seen = np.array(through_middle)
        seen[:2] += np.outer(self.shift_px, through_middle[2])
        seen[:2, 2] -= self.parallax_px_m * _per_metre(pose)
        return seen


@dataclass(frozen=True)
class LensBlur:
    """A lens's disc of defocus and coma, beside its Gaussian blur; each part is off at 0.

    Attributes:
        disc_px: radius of the disc that every point is seen as.
        coma_px: C of the coma, whose blur is some 3 C long.
        coma_rad: direction of its tail in the image, from +u to +v.
        aperture_m: diameter of the opening, for a disc that grows with the distance from the focus.
        focus_m: distance along the optical axis at which points are in focus.

    Raises:
        InputError: a radius, length or aperture is negative, or the focus is not before the camera.
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
        """Return whether every point is seen as a point, apart from the Gaussian."""
        return not (self.disc_px or self.coma_px or self.aperture_m)

    def radii_px(self, camera: Camera, pose: CameraPose, points_px: Array) -> Array:
        """Signed radii (...), px, of the discs of the ground at pixels (..., 2); positive behind the focus.

        `disc + f A/2 (1/z_focus - 1/z)`; f is the focal length along u.
        """
        reach = camera.focal_px * pose.zoom * self.aperture_m / 2
        return np.asarray(self.disc_px + reach * (1 / self.focus_m - inverse_depths(camera, pose, points_px)))

    def variances_px2(self, camera: Camera, pose: CameraPose, points_px: Array) -> Array:
        """Return the variances (...), px², that the blur adds along an axis, in the mean, at pixels (..., 2).

        `r²/4 + C²/3`.
        """
        return np.asarray(self.radii_px(camera, pose, points_px) ** 2 / 4 + self.coma_px**2 / 3)

    def rays(self, camera: Camera, pose: CameraPose, sigma_px: float) -> list[Ray]:
        """Return the rays whose images' mean is the blurred one; their weights sum to one.

        `sigma_px` is the standard deviation of the Gaussian and the pixel together; the sharper these, the
        more rays it takes.
        """
        radius = float(np.abs(self.radii_px(camera, pose, camera.corners_px)).max())
        # Coma spreads rays by 3 C along ρ², and goes twice around where a disc goes once.
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
"""A lens without defocus and coma."""


def inverse_depths(camera: Camera, pose: CameraPose, points_px: Array) -> Array:
    """Inverse distances (...), 1/m, along the optical axis, of the ground seen at pixels (..., 2).

    `1/z = s h · (u, v, 1)`, h being the last row of the inverse homography; 0 at the horizon and beyond.
    """
    straight = undistort(camera, pose.zoom, points_px)
    row = inverse(homography_image_ground(camera, pose))[2]
    return np.asarray(np.maximum(_per_metre(pose) * (straight @ row[:2] + row[2]), 0.0))


def _per_metre(pose: CameraPose) -> float:
    """s, by which the homography's last row is to be divided to give the distance z, m."""
    center = np.array([*pose.position_m, pose.height_m])
    return float(1.0 / abs(rotation_camera_world(pose)[2] @ center))
