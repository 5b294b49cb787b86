"""The map from an image to the ground, up to a similarity: lens, oblong pixels and tilt taken off.

Image points p = u + iv are from the image's centre, in halves of its shorter side. Then

    r = (p - c - α conj(p - c)) / (1 - |α|²)          square pixels: aspect and skew squeeze by α,
    s = r / (1 + κ₁ |r|² + κ₂ |r|⁴ + κ₃ |r|⁶)          a lens that is round about the centre c,
    q = (s + (f λ / (1 + S))² s̄) / (1 - Re(λ̄ s))      a tilt: the ground's horizon is Re(λ̄ s) = 1,

where S² = 1 + f² |λ|² is by how much a tilt foreshortens along λ. The focal length f enters there alone, in
the second order of the tilt. The lens is the division model (Fitzgibbon 2001) with two coefficients more: one
follows any lens to a hundredth, three follow fisheyes of 120 degrees to 3e-5, and Brown's polynomial as well
as long as it is not about to fold. Then q is turned, scaled and shifted until q(0) = 0, ∂q/∂p(0) > 0 and the
circle |p| = 1 keeps its mean radius.

A marker is a square on the ground. Where `dq = a dp + b dp̄`, its image is squeezed by `ε = -b / a`, and its
side is in proportion to `(|a|² - |b|²)^(-1/2)`.
"""

from dataclasses import dataclass, field

import numpy as np

from skyherd.geometry import Array, ComplexArray, to_complex, to_points
from skyherd.messages import centred

SQUEEZE, LENS, CENTER, FOCAL, HORIZON = [0, 1], [2, 3, 4], [5, 6], [7], [8, 9]
"""Places of the unknowns α, κ, c, f² / `USUAL_FOCAL`² - 1 and λ; complex ones take two."""

CAMERA, UNKNOWNS = 8, 10
"""The first so many are the camera's, the others those of one image."""

USUAL_FOCAL = 1.4
"""Focal length in halves of the image's shorter side where nothing tells it: 71 degrees from side to side."""

LEAST = 0.05
"""What is divided by is held above this: the horizon, and what no lens shows, lie beyond."""

NEWTON_STEPS = 10

_FIXED: ComplexArray = np.array([0, 1, 1j, -1, -1j], dtype=complex)


@dataclass(frozen=True)
class LocalMaps:
    """The map near points: `q + a dp + b dp̄`, arrays (..., N)."""

    values: ComplexArray
    slopes: ComplexArray
    crosses: ComplexArray

    def squeezes(self) -> ComplexArray:
        """ε, by how much the ground's squares are squeezed in the image."""
        return np.asarray(-self.crosses / self.slopes)

    def log_scales(self) -> Array:
        """Logarithms of image lengths over ground lengths."""
        areas = np.abs(self.slopes) ** 2 - np.abs(self.crosses) ** 2
        return np.asarray(-np.log(np.maximum(areas, LEAST**4)) / 2)


def local_maps(unknowns: Array, points: ComplexArray) -> LocalMaps:
    """The map and its derivatives for unknowns (..., 10) at image points (N,)."""
    raw = _raw_maps(unknowns[..., None, :], np.concatenate([_FIXED, points]))
    origin, turn = raw.values[..., :1], raw.slopes[..., :1]
    size = np.abs((raw.values[..., 1:5] - origin) / turn).mean(axis=-1, keepdims=True)
    factor = 1 / (turn * size)
    return LocalMaps(
        (raw.values[..., 5:] - origin) * factor, raw.slopes[..., 5:] * factor, raw.crosses[..., 5:] * factor
    )


def _raw_maps(unknowns: Array, p: ComplexArray) -> LocalMaps:
    """As `local_maps`, before turn, scale and origin are set."""
    a = unknowns[..., 0] + 1j * unknowns[..., 1]
    k1, k2, k3 = unknowns[..., 2], unknowns[..., 3], unknowns[..., 4]
    h = unknowns[..., 8] + 1j * unknowns[..., 9]
    away = p - (unknowns[..., 5] + 1j * unknowns[..., 6])
    square = 1 / (1 - np.abs(a) ** 2)
    # Wirtinger derivatives, `d· = (first) dp + (second) dp̄`, from step to step.
    r, r_p, r_c = (away - a * away.conj()) * square, square, -a * square
    rho = r.real**2 + r.imag**2
    bend = np.maximum(1 + rho * (k1 + rho * (k2 + rho * k3)), LEAST)
    growth = (k1 + rho * (2 * k2 + 3 * rho * k3)) / bend**2
    s, s_r, s_rc = r / bend, 1 / bend - rho * growth, -r * r * growth
    s_p, s_c = s_r * r_p + s_rc * np.conj(r_c), s_r * r_c + s_rc * np.conj(r_p)
    # Below a half f² falls exponentially, so that it stays positive and never loses its slope.
    square_focal = np.maximum(1 + unknowns[..., 7], np.exp(np.minimum(2 * unknowns[..., 7] + 1, 0)) / 2)
    focal = USUAL_FOCAL * np.sqrt(square_focal)
    lean = (focal * h / (1 + np.sqrt(1 + (focal * np.abs(h)) ** 2))) ** 2
    w = np.maximum(1 - (np.conj(h) * s).real, LEAST)
    q = (s + lean * s.conj()) / w
    q_s, q_sc = (1 + q * np.conj(h) / 2) / w, (lean + q * h / 2) / w
    return LocalMaps(q, q_s * s_p + q_sc * np.conj(s_c), q_s * s_c + q_sc * np.conj(s_p))


@dataclass(frozen=True)
class GroundMap:
    """The map of one image: unknowns (10,) and their covariance (10, 10); by default it changes nothing."""

    unknowns: Array = field(default_factory=lambda: np.zeros(UNKNOWNS))
    covariance: Array = field(default_factory=lambda: np.zeros((UNKNOWNS, UNKNOWNS)))

    @property
    def ideal(self) -> bool:
        """Whether it changes nothing: a camera with square pixels that looks straight down."""
        return not self.unknowns.any()

    def rectified_px(self, points_px: Array, image_size_px: Array) -> Array:
        """Points (N, 2) of an image of some size as an ideal camera would see them."""
        maps = local_maps(self.unknowns, to_complex(centred(points_px, image_size_px)))
        return _pixels(maps.values, image_size_px)

    def image_px(self, points_px: Array, image_size_px: Array) -> Array:
        """The inverse of `rectified_px`, by Newton's method."""
        target = to_complex(centred(points_px, image_size_px))
        points = target
        for _ in range(NEWTON_STEPS):
            maps = local_maps(self.unknowns, points)
            off = target - maps.values
            area = np.abs(maps.slopes) ** 2 - np.abs(maps.crosses) ** 2
            step = (maps.slopes.conj() * off - maps.crosses * off.conj()) / area
            points = points + step / np.maximum(1.0, 2 * np.abs(step))
        return _pixels(points, image_size_px)


def _pixels(points: ComplexArray, image_size_px: Array) -> Array:
    """The inverse of `centred`."""
    return np.asarray(to_points(points) * image_size_px.min() / 2 + (image_size_px - 1) / 2)
