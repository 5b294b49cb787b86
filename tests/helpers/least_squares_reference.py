"""Least squares of many markers at once in NumPy, as in `least_squares.c`; `fit` has the formulas."""

from dataclasses import dataclass

import numpy as np
from tests.helpers.design_matrix_reference import PIXEL_ROW

from skyherd.geometry import Array
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.design_matrix import CONTRAST, GROUND
from skyherd.vision.photometric.fitting.fit import (
    GROUND_RIDGE,
    MIN_CONTRAST,
    MIN_SQUARES,
    RIDGE,
    SINGLE_PRECISION,
)

_RIDGES = np.diag(np.where(np.arange(UNKNOWNS) == GROUND, GROUND_RIDGE, RIDGE))
_RAISED_DIAGONAL = 1 + SINGLE_PRECISION * np.eye(UNKNOWNS)


@dataclass(frozen=True)
class LeastSquaresSolution:
    """Least-squares solutions for N markers.

    Attributes:
        values: (N, 15) the unknowns, in the order of `design_matrix`.
        inverse_normals: (N, 15, 15) inverse normal matrices C; rows and columns of held unknowns are zero.
        residual_squares: (N,) sums of squared weighted residuals, grey levels squared.
        pixels: (N,) number of pixels used.
        free: number of unknowns that are not held.
    """

    values: Array
    inverse_normals: Array
    residual_squares: Array
    pixels: Array
    free: int = UNKNOWNS

    @classmethod
    def of_grams(cls, grams: Array, pixels: Array) -> "LeastSquaresSolution":
        """Solve for all unknowns, from Gram matrices (N, 16, 16) of `pixels` (N,) pixels each.

        The last row and column of a Gram matrix are the inner products with the pixels' values.
        """
        right = grams[:, :UNKNOWNS, PIXEL_ROW]
        normals = (grams[:, :UNKNOWNS, :UNKNOWNS] + _RIDGES) * _RAISED_DIAGONAL
        inverse_normals = np.linalg.inv(normals).astype(float)
        values: Array = (inverse_normals @ right[..., None])[..., 0]
        squares: Array = np.maximum(
            grams[:, PIXEL_ROW, PIXEL_ROW] - (values * right).sum(axis=1), MIN_SQUARES
        )
        return cls(values, inverse_normals, squares, pixels)

    def expected(self, unknowns: list[int], at: Array, variances: Array) -> "LeastSquaresSolution":
        """Return the solution in which `unknowns` are expected at values `at` (N, len(unknowns)).

        `variances` (N,), of each of them about that value, are in units of the noise's variance. With zero,
        the unknowns are held; see `constrained`. The sum of squares includes what the expectation adds.
        """
        return self._drawn(unknowns, at, variances, self.free)

    def constrained(self, unknowns: list[int], at: Array) -> "LeastSquaresSolution":
        """Return the solution in which `unknowns` are held at values `at` (N, len(unknowns)).

        The sums of squares never shrink, although rounding would make them where the pixels are too few to
        determine the unknowns.
        """
        return self._drawn(unknowns, at, np.zeros(len(self.values)), self.free - len(unknowns))

    def _drawn(self, unknowns: list[int], at: Array, variances: Array, free: int) -> "LeastSquaresSolution":
        """Return the solution with unknowns drawn towards values, by the formula of `fit`."""
        columns = self.inverse_normals[:, :, unknowns]
        own = columns[:, unknowns] + variances[:, None, None] * np.eye(len(unknowns))
        gains = np.linalg.inv(own)
        off = self.values[:, unknowns] - at
        pulls = (gains @ off[..., None])[..., 0]
        return LeastSquaresSolution(
            self.values - (columns @ pulls[..., None])[..., 0],
            self.inverse_normals - columns @ gains @ self.inverse_normals[:, unknowns],
            self.residual_squares + np.maximum((off * pulls).sum(axis=1), 0.0),
            self.pixels,
            free,
        )

    def noise_stds(self) -> Array:
        """Return the standard deviations (N,) of a pixel about the model, grey levels.

        The square root of the sum of squares over the degrees of freedom, pixels less free unknowns (1 at
        least).
        """
        return np.asarray(np.sqrt(self.residual_squares / np.maximum(self.pixels - self.free, 1.0)))

    def contrasts(self) -> Array:
        """Return the contrasts (N,), grey levels, not below `MIN_CONTRAST`, so that they can divide."""
        return np.maximum(self.values[:, CONTRAST], MIN_CONTRAST)
