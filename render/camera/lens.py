"""Lens distortion after Brown and Conrady, with OpenCV's names and signs.

A ray that meets the plane at unit distance at (x, y), `r² = x² + y²`, is seen as if it met it at

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y.

A zoom lens may bend otherwise at each focal length: k1 grows by `zoom_k1` with each doubling of the zoom z,

    k1(z) = k1 + zoom_k1 log2 z.

Far out the radial polynomial may turn back, so that rays would come into the image a second time. Such rays
are taken on outwards instead, with the factor that it has where it turns.

Rays are dimensionless: lengths on the plane at unit distance, that is in focal lengths.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array

NEWTON_STEPS = 12
"""Steps of Newton's method after which undistorting gives up. *Chosen*: the built-in test cameras' lenses
need five or six; only rays near a fold need more."""

NEWTON_REACH = 0.5
"""Longest step of Newton's method along either axis, focal lengths. *Chosen*: keeps a step that starts near a
fold, where the derivative is almost zero, from leaving the image."""

SETTLED = 1e-12
"""Undistorting ends once no ray moves by more than this, focal lengths. *Chosen*: 1e-9 px at a focal length
of 1000 px, some thousand times the rounding of a double."""

SAME_RAY = 1e-9
"""A ray counts as found if the lens takes it to within this of where it is seen, focal lengths. *Chosen*:
1e-6 px at a focal length of 1000 px, for rays near a fold, where Newton's method settles slowly."""

REAL = 1e-9
"""Roots of the derivative with a smaller imaginary part count as real. *Chosen*: far above the rounding of
single roots, which is near 1e-15."""

FAR = 8.0
"""Radius up to which a turn of the polynomial is looked for, focal lengths. *Chosen*: 83 degrees off the
axis, beyond any perspective lens."""


@dataclass(frozen=True)
class Distortion:
    """A perspective lens: radial k1, k2, k3, tangential p1, p2, and `zoom_k1`; none of them by default.

    Attributes:
        k1: radial coefficient of r².
        k2: radial coefficient of r⁴.
        k3: radial coefficient of r⁶.
        p1: tangential coefficient, along y.
        p2: tangential coefficient, along x.
        zoom_k1: what each doubling of the zoom adds to k1.
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
        """Return the lens at a zoom, as one that does not depend on the zoom any more."""
        if not self.zoom_k1:
            return self
        return replace(self, k1=self.k1 + self.zoom_k1 * float(np.log2(zoom)), zoom_k1=0.0)

    def apply(self, rays: Array) -> Array:
        """Take rays (..., 2) to where the lens makes them appear (..., 2)."""
        return _distort(self, rays)[0]

    def jacobian(self, rays: Array) -> Array:
        """Return derivatives (..., 2, 2) of `apply` at rays (..., 2)."""
        return _distort(self, rays)[1]

    def remove(self, seen: Array) -> Array:
        """Take rays as they appear (..., 2) to the rays themselves (..., 2), by Newton's method.

        Raises:
            InputError: no ray appears at one of the points, since the lens folds the image.
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
        """Square of the radius at which the radial polynomial turns back; infinity if it never does."""
        return _turn(self)


NO_DISTORTION = Distortion()
"""The lens of a pinhole camera."""


@lru_cache(maxsize=64)
def _turn(lens: Distortion) -> float:
    """Return the least positive root r² of `d/dr (r + k1 r³ + k2 r⁵ + k3 r⁷)`; infinity if it is far out."""
    roots = np.roots([7 * lens.k3, 5 * lens.k2, 3 * lens.k1, 1.0])
    real = roots.real[(np.abs(roots.imag) < REAL) & (roots.real > 0)]
    return float(real.min()) if real.size and real.min() < FAR**2 else float("inf")


def _distort(lens: Distortion, rays: Array) -> tuple[Array, Array]:
    """Rays (..., 2) as seen, and the derivatives (..., 2, 2)."""
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
