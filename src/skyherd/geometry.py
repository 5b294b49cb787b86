"""Plane geometry that every part needs: angles, complex points, homographies.

Points of the plane are complex numbers where that makes the law shorter: `x + iy` on the ground,
`u + iv` in an image. A proper similarity is then `z ↦ a z + b`, with scale `|a|` and rotation `arg a`.
"""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


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
