"""Equidistant fisheye lens.

A ray at angle θ from the optical axis meets the plane at unit distance at radius tan θ. It is imaged at

    r' = θ,    with the exact inverse    r = tan r'.

With a focal length of f px, the distance to the principal point is f θ px (Kannala and Brandt 2006, with only
the first coefficient).

This class and `skyherd.render.camera.lens.Distortion` have the same interface: `apply`, `remove`, `jacobian`,
`at`, `turn` and the truth value.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array

MAX_RAD = 1.45
"""Largest angle of a ray with the axis, rad (83 degrees). *Chosen*: rays are points of the plane at unit
distance, with a radius of 8 at this angle, and infinity at 90 degrees."""

NEAR = 1e-4
"""Radius below which two terms of a series replace the quotient 0 / 0. *Derived*: the truncation error is of
the radius' fourth power, 1e-16, the rounding of a double."""


@dataclass(frozen=True)
class Equidistant:
    """Equidistant fisheye lens, `r' = atan r`, independent of the zoom."""

    def __bool__(self) -> bool:
        """Return True: the lens bends straight lines."""
        return True

    def at(self, zoom: float) -> Self:
        """Return the lens at a zoom: itself."""
        return self

    def apply(self, rays: Array) -> Array:
        """Return the distorted rays (..., 2) of rays (..., 2)."""
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.asarray(rays * _ratio(np.arctan(radius), radius, -1 / 3))

    def jacobian(self, rays: Array) -> Array:
        """Return the Jacobians (..., 2, 2) of `apply`: 1 / (1 + r²) along the radius, θ / r across it."""
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)[..., None]
        across = _ratio(np.arctan(radius), radius, -1 / 3)
        # (1 / (1 + r²) - θ / r) / r², with the limit -2/3.
        square = np.maximum(radius, NEAR) ** 2
        bend = np.where(radius < NEAR, -2 / 3, (1 / (1 + square) - across) / square)
        return np.asarray(across * np.eye(2) + bend * rays[..., :, None] * rays[..., None, :])

    def remove(self, seen: Array) -> Array:
        """Return the undistorted rays (..., 2) of distorted rays (..., 2): the inverse of `apply`.

        Raises:
            InputError: a ray is more than `MAX_RAD` off the axis.
        """
        radius = np.linalg.norm(seen, axis=-1, keepdims=True)
        if radius.max(initial=0.0) > MAX_RAD:
            raise InputError(
                "lens",
                f"a corner {np.degrees(radius.max()):.0f} degrees off the axis of an equidistant lens",
                f"at most {np.degrees(MAX_RAD):.0f}: a longer focal_px, or a smaller half_angle_deg",
            )
        return np.asarray(seen * _ratio(np.tan(radius), radius, 1 / 3))

    def turn(self) -> float:
        """Return the squared radius at which the image folds back: infinity, since it never does."""
        return float("inf")


def _ratio(values: Array, radius: Array, third: float) -> Array:
    """Return `values / radius`, by the series `1 + third r²` near zero."""
    return np.where(radius < NEAR, 1 + third * radius**2, values / np.maximum(radius, NEAR))
