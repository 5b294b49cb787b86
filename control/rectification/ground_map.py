"""The map from an image to the ground, up to a similarity: it removes lens, oblong pixels and tilt.

Image points p = u + iv are relative to the image centre, in halves of the image's shorter side. Then

    r = (p - c - α conj(p - c)) / (1 - |α|²)          pixels: anisotropy α from aspect and skew,
    s = r / (1 + κ₁ |r|² + κ₂ |r|⁴ + κ₃ |r|⁶)          lens: radially symmetric about the centre c,
    q = (s + (f λ / (1 + S))² s̄) / (1 - Re(λ̄ s))      tilt: the ground's horizon is Re(λ̄ s) = 1,

where S² = 1 + f² |λ|², and S is the foreshortening by the tilt along λ. The focal length f occurs only there,
in the second order of the tilt. The lens is the division model (Fitzgibbon 2001) with two more coefficients.
One coefficient approximates any lens to 1e-2. Three approximate fisheyes of 120 degrees to 3e-5, and Brown's
polynomial unless it is close to folding. Finally q is rotated, scaled and shifted until `q(0) = 0`, `∂q/∂p(0)
> 0` and the circle |p| = 1 keeps its mean radius.

A marker is a square on the ground. With `dq = a dp + b dp̄`, its image has the relative anisotropy `ε = -b /
a`. Its side is proportional to `(|a|² - |b|²)^(-1/2)`. docs/rectification.md has the derivation.
"""

from dataclasses import dataclass, field

import numpy as np

from skyherd.geometry import Array, ComplexArray, to_complex, to_points
from skyherd.messages import centred

ANISOTROPY, LENS, CENTER, FOCAL, PERSPECTIVE = [0, 1], [2, 3, 4], [5, 6], [7], [8, 9]
"""Indices of the unknowns α, (κ₁, κ₂, κ₃), c, f² / `USUAL_FOCAL`² - 1 and λ among all ten; a complex unknown
has two, real part and imaginary part."""

CAMERA, UNKNOWNS = 8, 10
"""Number of unknowns of the camera, which come first, and of all; the last two are the tilt of one image."""

USUAL_FOCAL = 1.4
"""Assumed focal length without support from the data, in halves of the image's shorter side. Chosen: a view
of 71 degrees, 2 atan(1 / 1.4), across the shorter side."""

MIN_FACTOR = 0.05
"""Minimum of the denominators of lens and tilt. Chosen: points beyond it lie at the horizon or outside the
lens; it keeps the map finite there."""

NEWTON_STEPS = 10
"""Newton steps of `GroundMap.image_px`. Chosen: they converge quadratically near the solution; before that a
step is limited to a quarter of the image's shorter side."""

_FIXED: ComplexArray = np.array([0, 1, 1j, -1, -1j], dtype=complex)
"""Points that fix rotation, scale and origin of the map: the image centre, and four of the circle |p| = 1."""


@dataclass(frozen=True)
class LocalMaps:
    """First-order map at N points: `q + a dp + b dp̄`, with Wirtinger derivatives, arrays (..., N).

    Attributes:
        values: q, the points on the ground.
        derivatives: a = ∂q/∂p.
        conjugate_derivatives: b = ∂q/∂p̄; zero where the map is a local similarity.
    """

    values: ComplexArray
    derivatives: ComplexArray
    conjugate_derivatives: ComplexArray

    def anisotropies(self) -> ComplexArray:
        """Return relative anisotropies ε = -b / a (..., N) of the images of squares on the ground."""
        return np.asarray(-self.conjugate_derivatives / self.derivatives)

    def log_scales(self) -> Array:
        """Return natural logarithms (..., N) of image length over ground length, from the roots of areas."""
        areas = np.abs(self.derivatives) ** 2 - np.abs(self.conjugate_derivatives) ** 2
        return np.asarray(-np.log(np.maximum(areas, MIN_FACTOR**4)) / 2)


def local_maps(unknowns: Array, points: ComplexArray) -> LocalMaps:
    """Return the map and its derivatives for unknowns (..., 10) at image points (N,); arrays (..., N)."""
    raw = _raw_maps(unknowns[..., None, :], np.concatenate([_FIXED, points]))
    origin, derivative = raw.values[..., :1], raw.derivatives[..., :1]
    radii = np.abs((raw.values[..., 1:5] - origin) / derivative)
    factor = 1 / (derivative * (radii.sum(axis=-1, keepdims=True) / 4))
    return LocalMaps(
        values=(raw.values[..., 5:] - origin) * factor,
        derivatives=raw.derivatives[..., 5:] * factor,
        conjugate_derivatives=raw.conjugate_derivatives[..., 5:] * factor,
    )


def _raw_maps(unknowns: Array, p: ComplexArray) -> LocalMaps:
    """Return the map as in `local_maps`, before rotation, scale and origin are fixed."""
    a, center, h = (to_complex(unknowns[..., k : k + 2]) for k in (0, 5, 8))
    k1, k2, k3, focal_term = (unknowns[..., k] for k in (2, 3, 4, 7))
    away = p - center
    square = 1 / (1 - np.abs(a) ** 2)
    # Chain rule of the Wirtinger derivatives, `d· = (first) dp + (second) dp̄`.
    r, r_p, r_c = (away - a * away.conj()) * square, square, -a * square
    rho = r.real**2 + r.imag**2
    bend = np.maximum(1 + rho * (k1 + rho * (k2 + rho * k3)), MIN_FACTOR)
    growth = (k1 + rho * (2 * k2 + 3 * rho * k3)) / bend**2
    s, s_r, s_rc = r / bend, 1 / bend - rho * growth, -r * r * growth
    s_p, s_c = s_r * r_p + s_rc * r_c.conj(), s_r * r_c + s_rc * r_p
    # Below 1/2, f² is continued by an exponential: it stays positive with a nonzero slope.
    square_focal = np.maximum(1 + focal_term, np.exp(np.minimum(2 * focal_term + 1, 0)) / 2)
    focal = USUAL_FOCAL * np.sqrt(square_focal)
    foreshortening = (focal * h / (1 + np.sqrt(1 + (focal * np.abs(h)) ** 2))) ** 2
    w = np.maximum(1 - (h.conj() * s).real, MIN_FACTOR)
    q = (s + foreshortening * s.conj()) / w
    half = h / 2
    q_s, q_sc = (1 + q * half.conj()) / w, (foreshortening + q * half) / w
    return LocalMaps(q, q_s * s_p + q_sc * s_c.conj(), q_s * s_c + q_sc * s_p.conj())


@dataclass(frozen=True)
class GroundMap:
    """Map of one image to the ground; by default the identity.

    Attributes:
        unknowns: (10,) values in the order of `ANISOTROPY`, `LENS`, `CENTER`, `FOCAL` and `PERSPECTIVE`.
        covariance: (10, 10) their covariance.
    """

    unknowns: Array = field(default_factory=lambda: np.zeros(UNKNOWNS))
    covariance: Array = field(default_factory=lambda: np.zeros((UNKNOWNS, UNKNOWNS)))

    @property
    def ideal(self) -> bool:
        """True if it is the identity: square pixels, no lens distortion and no tilt."""
        return not self.unknowns.any()

    def rectified_px(self, points_px: Array, image_size_px: Array) -> Array:
        """Return the points (N, 2), px, of an ideal camera for image points (N, 2), px.

        Args:
            points_px: (N, 2) points of the real image.
            image_size_px: (2,) width and height of both images.
        """
        maps = local_maps(self.unknowns, to_complex(centred(points_px, image_size_px)))
        return _pixels(maps.values, image_size_px)

    def image_px(self, points_px: Array, image_size_px: Array) -> Array:
        """Return points (N, 2), px, of the real image: the inverse of `rectified_px`, by Newton's method."""
        target = to_complex(centred(points_px, image_size_px))
        points = target
        for _ in range(NEWTON_STEPS):
            maps = local_maps(self.unknowns, points)
            off = target - maps.values
            area = np.abs(maps.derivatives) ** 2 - np.abs(maps.conjugate_derivatives) ** 2
            step = (maps.derivatives.conj() * off - maps.conjugate_derivatives * off.conj()) / area
            points = points + step / np.maximum(1.0, 2 * np.abs(step))
        return _pixels(points, image_size_px)


def _pixels(points: ComplexArray, image_size_px: Array) -> Array:
    """Return pixels (N, 2) of complex points (N,) from the image centre: the inverse of `centred`."""
    return np.asarray(to_points(points) * image_size_px.min() / 2 + (image_size_px - 1) / 2)
