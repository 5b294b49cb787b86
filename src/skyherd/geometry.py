"""Plane geometry that every part needs: angles, complex points, homographies.

Points of the plane are complex numbers where that makes the law shorter: `x + iy` on the ground,
`u + iv` in an image. A proper similarity is then `z ↦ a z + b`, with scale `|a|` and rotation `arg a`.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of a value spread evenly over an interval of length 1: of the error of rounding to whole numbers
(grey levels squared), and of a square pixel along one axis (px²). Derived: `∫ x² dx` from -1/2 to 1/2."""

SQUARE_CORNERS: ComplexArray = np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])
"""Corners 0-3 of a marker of side 1 about its centre, as `right + i down`: front left, front right, back
right, back left. The marker's forward direction is -i."""

ROBOT_FRAME_CORNERS: ComplexArray = np.conj(1j * SQUARE_CORNERS)
"""The same corners in the robot's frame, as `forward + i left`: multiplied by `e^{i heading}` they are the
corners of a marker on the ground, relative to its centre, in sides."""


def wrap_angle(angle_rad: npt.ArrayLike) -> Array:
    """Take angles to [-pi, pi)."""
    return np.asarray((np.asarray(angle_rad, dtype=float) + np.pi) % (2 * np.pi) - np.pi)


def to_complex(points: npt.ArrayLike) -> ComplexArray:
    """Turn points (..., 2) into complex numbers (...)."""
    points = np.asarray(points, dtype=float)
    return np.asarray(points[..., 0] + 1j * points[..., 1])


def to_points(z: npt.ArrayLike) -> Array:
    """Turn complex numbers (...) into points (..., 2)."""
    z = np.asarray(z, dtype=complex)
    return np.stack([z.real, z.imag], axis=-1)


def apply_homography(homography: Array, points: npt.ArrayLike) -> Array:
    """Map points (..., 2) by a homography (3, 3): `x ~ H (x, y, 1)`."""
    points = np.asarray(points, dtype=float)
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def inverse(matrices: npt.ArrayLike) -> Array:
    """Inverses of matrices (..., n, n), such as homographies."""
    return np.asarray(np.linalg.inv(np.asarray(matrices, dtype=float)))


@dataclass(frozen=True)
class SquareImages:
    """Affine images of N squares: `p(z) = center + arm z + squeeze z̄`, z in the axes of `SQUARE_CORNERS`.

    Attributes:
        centers: (N,) complex image points of the squares' centres.
        arms: (N,) what a similarity would be: length `|arm|` is the side, `arg(-i arm)` the heading.
        squeezes: (N,) what a similarity does not have; zero where the image is a square.
    """

    centers: ComplexArray
    arms: ComplexArray
    squeezes: ComplexArray

    def headings_rad(self) -> Array:
        """(N,) directions of forward, from +u to +v, that fit both axes of each square equally well."""
        return np.angle(-1j * self.arms)


def fit_squares(corners: ComplexArray) -> SquareImages:
    """Least-squares affine images of squares with the given corners (N, 4), complex.

    The corners q_k of the unit square are orthogonal to their conjugates and to the constant, so that the
    three unknowns separate:

        center = Σ p_k / 4,  arm = Σ p_k q̄_k / Σ |q_k|²,  squeeze = Σ p_k q_k / Σ |q_k|².
    """
    power = float(np.sum(np.abs(SQUARE_CORNERS) ** 2))
    return SquareImages(
        centers=np.asarray(corners.mean(axis=1)),
        arms=np.asarray(corners @ SQUARE_CORNERS.conj() / power),
        squeezes=np.asarray(corners @ SQUARE_CORNERS / power),
    )
