"""Brown–Conrady lens distortion, with OpenCV's names and signs.

A ray that meets the plane at unit distance at (x, y), `r² = x² + y²`, is imaged at

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y.

The distortion of a zoom lens may depend on the focal length. k1 grows by `zoom_k1` with each doubling of the
zoom z,

    k1(z) = k1 + zoom_k1 log2 z.

At large radii the radial polynomial may fold back, so that rays would enter the image a second time. Beyond
the fold the radial factor stays constant instead, which keeps such rays outside the image.

Rays are dimensionless: their coordinates are in focal lengths.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array

NEWTON_STEPS = 12
"""Maximum number of Newton steps of undistortion. *Chosen*: the built-in test cameras' lenses need five or
six; only rays near a fold need more."""

NEWTON_REACH = 0.5
"""Longest Newton step along either axis, focal lengths. *Chosen*: limits steps near a fold, where the
derivative is almost zero."""

SETTLED = 1e-12
"""Step below which undistortion has converged, focal lengths. *Chosen*: 1e-9 px at a focal length of 1000 px,
about a thousand times the rounding of a double."""

SAME_RAY = 1e-9
"""Largest accepted residual after the last Newton step, focal lengths. *Chosen*: 1e-6 px at a focal length of
1000 px, for rays near a fold, where Newton's method converges slowly."""

REAL = 1e-9
"""Imaginary part below which a root of the derivative counts as real. *Chosen*: far above the rounding of
simple roots, about 1e-15."""

FAR = 8.0
"""Largest radius of the search for a fold, focal lengths. *Chosen*: 83 degrees off the axis, beyond any
perspective lens."""


@dataclass(frozen=True)
class Distortion:
    """Distortion coefficients of a perspective lens; 0 by default.

    Attributes:
        k1: radial coefficient of r².
        k2: radial coefficient of r⁴.
        k3: radial coefficient of r⁶.
        p1: tangential coefficient along y.
        p2: tangential coefficient along x.
        zoom_k1: increase of k1 with each doubling of the zoom.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    zoom_k1: float = 0.0

    def __bool__(self) -> bool:
        """Return whether the lens bends straight lines: whether any coefficient is not zero."""
        return any((self.k1, self.k2, self.k3, self.p1, self.p2, self.zoom_k1))

    def at(self, zoom: float) -> "Distortion":
        """Return the lens at a zoom, with `zoom_k1` 0."""
        if not self.zoom_k1:
            return self
        return replace(self, k1=self.k1 + self.zoom_k1 * float(np.log2(zoom)), zoom_k1=0.0)

    def apply(self, rays: Array) -> Array:
        """Return the distorted rays (..., 2) of rays (..., 2)."""
        return _distort(self, rays)[0]

    def jacobian(self, rays: Array) -> Array:
        """Return the Jacobians (..., 2, 2) of `apply` at rays (..., 2)."""
        return _distort(self, rays)[1]

    def remove(self, seen: Array) -> Array:
        """Return the undistorted rays (..., 2) of distorted rays (..., 2), by Newton's method.

        Raises:
            InputError: the lens folds the image, so that no ray belongs to one of the points.
        """
        rays = seen.copy()
        for _ in range(NEWTON_STEPS):
            there, slope = _distort(self, rays)
            step = np.linalg.solve(slope, (seen - there)[..., None])[..., 0]
            rays += np.clip(step, -NEWTON_REACH, NEWTON_REACH)
            if np.abs(step).max(initial=0.0) < SETTLED:
                return rays
        if np.abs(_distort(self, rays)[0] - seen).max(initial=0.0) < SAME_RAY:
            return rays
        raise InputError("lens", f"{self} folds the image over", "smaller k1, k2, k3, p1, p2")

    def turn(self) -> float:
        """Return the squared radius at which the radial polynomial folds back; infinity if it never does."""
        return _turn(self)


NO_DISTORTION = Distortion()
"""Lens of a pinhole camera."""


@lru_cache(maxsize=64)
def _turn(lens: Distortion) -> float:
    """Return the least positive root r² of `d/dr (r + k1 r³ + k2 r⁵ + k3 r⁷)`; infinity beyond `FAR`."""
    roots = np.roots([7 * lens.k3, 5 * lens.k2, 3 * lens.k1, 1.0])
    real = roots.real[(np.abs(roots.imag) < REAL) & (roots.real > 0)]
    return float(real.min()) if real.size and real.min() < FAR**2 else float("inf")


def _distort(lens: Distortion, rays: Array) -> tuple[Array, Array]:
    """Return the distorted rays (..., 2) and the Jacobians (..., 2, 2)."""
    x, y = rays[..., 0], rays[..., 1]
    square = x * x + y * y
    r2 = np.minimum(square, _turn(lens))
    factor = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    growth = np.where(square > r2, 0.0, 2 * (lens.k1 + r2 * (2 * lens.k2 + r2 * 3 * lens.k3)))
    p1, p2 = lens.p1, lens.p2
    u = x * factor + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    v = y * factor + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    cross = growth * x * y + 2 * p1 * x + 2 * p2 * y
    uu = factor + growth * x * x + 2 * p1 * y + 6 * p2 * x
    vv = factor + growth * y * y + 6 * p1 * y + 2 * p2 * x
    return np.stack([u, v], axis=-1), np.stack([np.stack([uu, cross], -1), np.stack([cross, vv], -1)], -2)
