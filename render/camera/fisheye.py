"""The equidistant fisheye: images of rays in proportion to their angle with the axis.

A ray at the angle θ from the optical axis meets the plane at unit distance at the radius tan θ, and is seen
as if it met it at

    r' = θ,        so that   r = tan r'   is its exact inverse.

With a focal length of f px a ray is therefore seen f θ px from the principal point (Kannala and Brandt 2006,
with the first coefficient alone).

A lens is a map of rays: `apply`, `remove` and `jacobian`, `at` a zoom, `turn`, and whether it bends at all.
This class and `skyherd.render.camera.lens.Distortion` both have these, so that markers, ground and truth work
with either of them.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array

MAX_RAD = 1.45
"""Largest angle of a ray with the axis, rad (83 degrees). *Chosen*: rays are points of the plane at unit
distance, which is 8 away at this angle; at 90 degrees it is infinitely far."""

NEAR = 1e-4
"""Radii below this take the first two terms of a series in place of a quotient 0 / 0. *Derived*: what the
series leaves out is of the radius' fourth power, 1e-16, which is the rounding of a double."""


@dataclass(frozen=True)
class Equidistant:
    """The equidistant fisheye lens, `r' = atan r`; it is the same at every zoom."""

    def __bool__(self) -> bool:
        """Return whether the lens bends straight lines: always."""
        return True

    def at(self, zoom: float) -> Self:
        """Return the lens at a zoom: itself."""
        return self

    def apply(self, rays: Array) -> Array:
        """Take rays (..., 2) to where the lens makes them appear (..., 2)."""
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.asarray(rays * _ratio(np.arctan(radius), radius, -1 / 3))

    def jacobian(self, rays: Array) -> Array:
        """Return derivatives (..., 2, 2) of `apply`: 1 / (1 + r²) along the radius, θ / r across it."""
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)[..., None]
        across = _ratio(np.arctan(radius), radius, -1 / 3)
        # (1 / (1 + r²) - θ / r) / r², which goes to -2/3.
        square = np.maximum(radius, NEAR) ** 2
        bend = np.where(radius < NEAR, -2 / 3, (1 / (1 + square) - across) / square)
        return np.asarray(across * np.eye(2) + bend * rays[..., :, None] * rays[..., None, :])

    def remove(self, seen: Array) -> Array:
        """Take rays as they appear (..., 2) to the rays themselves (..., 2): the inverse of `apply`.

        Raises:
            InputError: a ray is too far off the axis.
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
        """Square of the radius at which the image folds back: infinity, since it never does."""
        return float("inf")


def _ratio(values: Array, radius: Array, third: float) -> Array:
    """`values / radius`, by the series `1 + third r²` near zero."""
    return np.where(radius < NEAR, 1 + third * radius**2, values / np.maximum(radius, NEAR))
