"""Opaque flat shapes of one grey level that cover markers: discs and convex quadrilaterals."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array, BoolArray, apply_homography, inverse


@dataclass(frozen=True)
class Disc:
    """A disc on the ground.

    Attributes:
        center_m: its middle on the ground.
        radius_m: its radius.
        level: its grey level.
    """

    center_m: tuple[float, float]
    radius_m: float
    level: float

    def covers(self, points_m: Array) -> BoolArray:
        """Return which ground points (..., 2) lie under it."""
        offset = points_m - np.array(self.center_m)
        return np.asarray((offset**2).sum(axis=-1) < self.radius_m**2)

    def ground_shape(self) -> Array:
        """Homography (3, 3) to ground metres from coordinates in which it is the unit disc."""
        x, y = self.center_m
        return np.array([[self.radius_m, 0.0, x], [0.0, self.radius_m, y], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Quad:
    """A convex quadrilateral on the ground.

    Attributes:
        corners_m: (4, 2) corners on the ground, in order, in either sense; read-only.
        level: its grey level.

    Raises:
        InputError: the corners do not make a convex quadrilateral.
    """

    corners_m: npt.ArrayLike
    level: float

    def __post_init__(self) -> None:
        corners = np.array(self.corners_m, dtype=float)
        if corners.shape != (4, 2) or not convex(corners[None])[0]:
            raise InputError(
                "quad", f"corners {corners.tolist()}", "four corners, in order, of a convex shape"
            )
        corners.setflags(write=False)
        object.__setattr__(self, "corners_m", corners)

    def covers(self, points_m: Array) -> BoolArray:
        """Return which ground points (..., 2) lie under it."""
        at = apply_homography(inverse(self.ground_shape()), points_m)
        return np.asarray(((at > 0) & (at < 1)).all(axis=-1))

    def ground_shape(self) -> Array:
        """Homography (3, 3) to ground metres from coordinates in which it is the unit square."""
        return np.asarray(quads_square(np.asarray(self.corners_m)[None])[0])


Occluder = Disc | Quad
"""What can cover markers."""


def convex(corners: Array) -> BoolArray:
    """Return which quadrilaterals (N, 4, 2) are convex (N,): they turn the same way at every corner."""
    along = np.roll(corners, -1, axis=1) - corners
    following = np.roll(along, -1, axis=1)
    turn = along[..., 0] * following[..., 1] - along[..., 1] * following[..., 0]
    return np.asarray((turn > 0).all(axis=1) | (turn < 0).all(axis=1))


def quads_square(corners: Array) -> Array:
    """Return homographies (N, 3, 3) from the unit square's corners (0,0), (1,0), (1,1), (0,1) to (N, 4, 2).

    In closed form (Heckbert 1989, "Fundamentals of Texture Mapping and Image Warping", section 2.2.3): the
    two projective terms g and h follow from sums and differences of the corners, the other terms from these.
    """
    p0, p1, p2, p3 = np.moveaxis(corners, 1, 0)
    d1, d2, d3 = p1 - p2, p3 - p2, p0 - p1 + p2 - p3

    def cross(a: Array, b: Array) -> Array:
        return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])

    area = cross(d1, d2)
    g, h = cross(d3, d2) / area, cross(d1, d3) / area
    result = np.empty((len(corners), 3, 3))
    result[:, :2, 0] = p1 - p0 + g[:, None] * p1
    result[:, :2, 1] = p3 - p0 + h[:, None] * p3
    result[:, :2, 2] = p0
    result[:, 2] = np.stack([g, h, np.ones_like(g)], axis=-1)
    return result
