"""Least squares of many markers at once, from Gram matrices, with unknowns held or set free at will.

All columns of a marker's model and its pixels make one matrix of inner products. Its solution x with every
unknown free also gives that with some of them held at h, `x - C_xh C_hh⁻¹ (x_h - h)` with C the inverse
normal matrix: hypotheses are compared without looking at the pixels again.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array
from skyherd.vision.photometric.design_matrix import CONTRAST, GROUND, PIXELS

GROUND_RIDGE = 3e-4
"""Added to the ground's own element of the Gram matrix, since there may be none to be seen: a deviation of
58 σ_n about the card's white."""

SINGLE_PRECISION = 3e-6
"""Relative error of the sums in a Gram matrix, at most."""

LEAST_CONTRAST = 4.0
"""Grey levels between black and white under which nothing is there to be fitted."""

_RIDGE = np.diag(np.where(np.arange(PIXELS) == GROUND, GROUND_RIDGE, 1e-9))
_PARTED = 1 + SINGLE_PRECISION * np.eye(PIXELS)


@dataclass(frozen=True)
class Solved:
    """Solutions for N markers.

    Attributes:
        values: (N, 12) the unknowns, in the order of `skyherd.vision.photometric.design_matrix`.
        inverses: (N, 12, 12) inverse normal matrices C, zero for what is held.
        squares: (N,) sum of squares left.
        pixels: (N,) pixels read.
        free: number of unknowns that are not held.
    """

    values: Array
    inverses: Array
    squares: Array
    pixels: Array
    free: int = PIXELS

    @classmethod
    def of(cls, grams: Array, pixels: Array) -> "Solved":
        """Solve for all unknowns of Gram matrices (N, 13, 13), of so many pixels (N,) each."""
        right = grams[:, :PIXELS, PIXELS]
        # Sums in single precision are right to 1e-6 or so: columns nearer than that are parted.
        inverses = np.linalg.inv((grams[:, :PIXELS, :PIXELS] + _RIDGE) * _PARTED).astype(float)
        values: Array = (inverses @ right[..., None])[..., 0]
        squares: Array = np.maximum(grams[:, PIXELS, PIXELS] - (values * right).sum(axis=1), 1e-9)
        return cls(values, inverses, squares, pixels)

    def holding(self, rows: list[int], at: Array) -> "Solved":
        """The same with the unknowns `rows` held at values (N, len(rows)), by which the squares grow.

        They never shrink, which rounding may make them where pixels are too few to tell the unknowns.
        """
        off = (self.values[:, rows] - at)[..., None]
        blocks = self._blocks(rows)
        gain = self.inverses[:, :, rows] @ blocks
        return Solved(
            values=self.values - (gain @ off)[..., 0],
            inverses=self.inverses - gain @ self.inverses[:, rows],
            squares=self.squares + np.maximum(off.transpose(0, 2, 1) @ blocks @ off, 0.0)[:, 0, 0],
            pixels=self.pixels,
            free=self.free - len(rows),
        )

    def _blocks(self, rows: list[int]) -> Array:
        return np.linalg.inv(self.inverses[:, rows][:, :, rows]).astype(float)

    def noises(self) -> Array:
        """(N,) standard deviation of a pixel about the model."""
        return np.asarray(np.sqrt(self.squares / np.maximum(self.pixels - self.free, 1.0)))

    def contrasts(self) -> Array:
        """(N,) grey levels, not below `LEAST_CONTRAST`."""
        return np.maximum(self.values[:, CONTRAST], LEAST_CONTRAST)
