"""The equidistant fisheye: images of rays in proportion to their angle with the axis.

A ray at the angle θ from the optical axis meets the plane at unit distance at the radius tan θ, and is seen
as if it met it at

    r' = θ,        so that   r = tan r'   is its exact inverse.

With a focal length of f px a ray is therefore seen f θ px from the principal point (Kannala and Brandt 2006,
with the first coefficient alone).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array

MOST_RAD = 1.45
"""Rays farther off the axis, 83 degrees, are refused: the plane of unit distance is too far away there."""

NEAR = 1e-4
"""Radii below this take the first terms of the series: right to its fourth power."""


@dataclass(frozen=True)
class Equidistant:
    """Lens after `r' = atan r`; the same at every zoom."""

    def __bool__(self) -> bool:
        """It always bends."""
        return True

    def at(self, zoom: float) -> Self:
        """The lens at a zoom."""
        return self

    def apply(self, rays: Array) -> Array:
        """Rays (..., 2) as they are seen."""
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.asarray(rays * _ratio(np.arctan(radius), radius, -1 / 3))

    def jacobian(self, rays: Array) -> Array:
        """Derivatives (..., 2, 2) of rays as seen: 1 / (1 + r²) along the radius, θ / r across it."""
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)[..., None]
        across = _ratio(np.arctan(radius), radius, -1 / 3)
        # (1 / (1 + r²) - θ / r) / r², which goes to -2/3.
        square = np.maximum(radius, NEAR) ** 2
        bend = np.where(radius < NEAR, -2 / 3, (1 / (1 + square) - across) / square)
        return np.asarray(across * np.eye(2) + bend * rays[..., :, None] * rays[..., None, :])

    def remove(self, seen: Array) -> Array:
        """Rays (..., 2) that are seen so.

        Raises:
            InputError: a ray is too far off the axis.
        """
        radius = np.linalg.norm(seen, axis=-1, keepdims=True)
        if radius.max(initial=0.0) > MOST_RAD:
            raise InputError(
                "lens",
                f"a corner {np.degrees(radius.max()):.0f} degrees off the axis of an equidistant lens",
                f"at most {np.degrees(MOST_RAD):.0f}: a longer focal_px, or a smaller half_angle_deg",
            )
        return np.asarray(seen * _ratio(np.tan(radius), radius, 1 / 3))

    def turn(self) -> float:
        """It never turns back."""
        return float("inf")


def _ratio(values: Array, radius: Array, third: float) -> Array:
    """`values / radius`, by the series `1 + third r²` near zero."""
    return np.where(radius < NEAR, 1 + third * radius**2, values / np.maximum(radius, NEAR))
