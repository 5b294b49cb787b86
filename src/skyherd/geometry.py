"""Plane geometry for all parts: angles, points as complex numbers, homographies, images of squares.

Points of the plane are complex numbers where that makes a law shorter: `x + iy` on the ground, `u + iv` in an
image. A proper similarity is then `z ↦ a z + b`, with scale `|a|` and rotation `arg a`; an affine map is `z ↦
a z + c z̄ + b`.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""An array of 64-bit floats; docstrings give its shape."""

ComplexArray = npt.NDArray[np.complex128]
"""An array of 128-bit complex numbers, mostly points of a plane."""

IntArray = npt.NDArray[np.int64]
"""An array of 64-bit integers: ids, rows, counts."""

BoolArray = npt.NDArray[np.bool_]
"""An array of booleans, mostly a mask."""

Image = npt.NDArray[np.uint8]
"""An image of 8 bits: grey levels (height, width), or RGB (height, width, 3); docstrings name the kind."""

RgbImage = npt.NDArray[np.uint8]
"""An RGB image (height, width, 3), with the pixel coordinates of `Image`."""

UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of a uniform distribution on an interval of length 1, such as rounding (grey levels squared) or a
pixel along one axis (px²). Derived: `∫ x² dx` from -1/2 to 1/2."""

MEDIAN_PER_SIGMA = 0.6745
"""Median of the magnitude of a standard normal variable. Derived: Φ(0.6745) = 3/4."""

SQUARE_CORNERS: ComplexArray = np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])
"""Corners 0-3 of a marker of side 1 about its centre, as `right + i down`: front left, front right, back
right, back left. The marker's forward direction is -i."""

SQUARE_POWER = float(np.sum(np.abs(SQUARE_CORNERS) ** 2))
"""Sum of the squared distances of these corners from the centre. Derived."""

ROBOT_FRAME_CORNERS: ComplexArray = np.conj(1j * SQUARE_CORNERS)
"""The corners in the robot's frame, as `forward + i left`. Multiplied by `e^{i heading}` they are the
corners of a marker on the ground, relative to its centre, in sides."""


def wrap_angle(angle_rad: npt.ArrayLike) -> Array:
    """Return angles (any shape), rad, wrapped to [-pi, pi)."""
    return np.asarray((np.asarray(angle_rad, dtype=float) + np.pi) % (2 * np.pi) - np.pi)


def to_complex(points: npt.ArrayLike) -> ComplexArray:
    """Return points (..., 2) as complex numbers (...), `x + iy`."""
    points = np.asarray(points, dtype=float)
    z = np.empty(points.shape[:-1], dtype=complex)
    z.real, z.imag = points[..., 0], points[..., 1]
    return z


def to_points(z: npt.ArrayLike) -> Array:
    """Return complex numbers (...) as points (..., 2): the inverse of `to_complex`."""
    z = np.asarray(z, dtype=complex)
    points = np.empty((*z.shape, 2))
    points[..., 0], points[..., 1] = z.real, z.imag
    return points


def apply_homography(homography: Array, points: npt.ArrayLike) -> Array:
    """Return points (..., 2) mapped by a homography (3, 3), `(x', y', 1) ~ H (x, y, 1)`.

    A point on the line that the homography maps to infinity gives infinite values.
    """
    points = np.asarray(points, dtype=float)
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def median(values: Array) -> float:
    """Return the median of values (N,), at least one. `numpy.median` takes ten times as long for a few."""
    ascending = sorted(values.tolist())
    return float((ascending[(len(ascending) - 1) // 2] + ascending[len(ascending) // 2]) / 2)


def inverse(matrices: npt.ArrayLike) -> Array:
    """Return inverses of matrices (..., n, n), such as homographies and covariances.

    Raises:
        numpy.linalg.LinAlgError: a matrix is singular.
    """
    return np.asarray(np.linalg.inv(np.asarray(matrices, dtype=float)))


@dataclass(frozen=True)
class SquareImages:
    """Affine images of N squares: `p(z) = center + m z + k z̄`, z in the axes of `SQUARE_CORNERS`.

    The similarity part `m z` alone keeps a square a square. The anisotropy `k z̄` stretches it along one
    direction and shortens it across. The sides of the image are between `|m| - |k|` and `|m| + |k|`.

    Attributes:
        centers: (N,) images of the squares' centres, as `u + iv`.
        similarities: (N,) similarity parts m: `|m|` is the side, `arg(-i m)` the heading.
        anisotropies: (N,) anisotropies k; zero if the image is a square.
    """

    centers: ComplexArray
    similarities: ComplexArray
    anisotropies: ComplexArray

    def headings_rad(self) -> Array:
        """Return headings (N,) of the squares, from +u to +v, that fit both of their axes equally well."""
        return np.angle(-1j * self.similarities)


def fit_squares(corners: ComplexArray) -> SquareImages:
    """Fit affine images to the corners p (N, 4), complex, of N squares by least squares.

    The corners q_k of the unit square are orthogonal to their conjugates and to the constant, so that the
    three unknowns separate:

        center = Σ p_k / 4,  m = Σ p_k q̄_k / Σ |q_k|²,  k = Σ p_k q_k / Σ |q_k|².
    """
    return SquareImages(
        centers=np.asarray(corners.sum(axis=1) / 4),
        similarities=np.asarray(corners @ SQUARE_CORNERS.conj() / SQUARE_POWER),
        anisotropies=np.asarray(corners @ SQUARE_CORNERS / SQUARE_POWER),
    )
