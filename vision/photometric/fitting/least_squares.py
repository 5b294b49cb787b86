"""Least squares of many markers at once, from Gram matrices, with unknowns held or free.

All columns of a marker's model, together with its pixels, make one matrix of inner products. The solution x
with every unknown free also gives the solution in which some of them, h, are held at values x_h = v,

    x' = x - C_xh C_hh⁻¹ (x_h - v),   C' = C - C_xh C_hh⁻¹ C_hx,

with C the inverse normal matrix; the sum of squares grows by `(x_h - v)ᵀ C_hh⁻¹ (x_h - v)`. With `C_hh + P`
in place of C_hh, the unknowns are not held, but expected at v with variances P. One Gram matrix a marker thus
answers every question that is asked by holding unknowns (is the light even? do the anisotropies belong to one
plane?) without looking at the pixels again.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.geometry import Array
from skyherd.vision.native.library import library
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.design_matrix import CONTRAST, GROUND, PIXEL_ROW

GROUND_RIDGE = 3e-4
"""Added to the ground's diagonal element of the normal matrix, since there may be no ground to be seen: a
prior of standard deviation `1 / sqrt(3e-4)` = 58 times the noise about the card's white. Derived from that
deviation, which is chosen: a smaller ridge lets an unseen ground take any value."""

RIDGE = 1e-9
"""Added to the other diagonal elements of the normal matrix, so that a column of zeros (no contrast) makes no
singular matrix. Chosen far below the element of any column that is not zero, which it leaves as it is."""

SINGLE_PRECISION = 3e-6
"""Relative error of the sums in a Gram matrix, at most. Each diagonal element is raised by this share, so
that two columns that are equal to within rounding make no singular matrix."""

MIN_SQUARES = 1e-9
"""Smallest sum of squared residuals, grey levels squared, which keeps the noise of a perfect fit positive.
Chosen far below the rounding noise of a single pixel, 1/12."""

MIN_CONTRAST = 4.0
"""Smallest contrast, grey levels, that steps are divided by. Chosen: there is nothing to be fitted below it,
and a marker counts only from `skyherd.vision.photometric.verify.MIN_MARKER_CONTRAST` on."""

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
        """Return the solution with unknowns drawn towards values, by the module's formula, two at a time."""
        values, inverse_normals = self.values.copy(), self.inverse_normals.copy()
        squares = self.residual_squares.copy()
        for begin in range(0, len(unknowns), 2):
            pair = unknowns[begin : begin + 2]
            targets = np.ascontiguousarray(at[:, begin : begin + 2], dtype=float), variances
            library().hold_unknowns(values, inverse_normals, squares, (pair[0], pair[-1]), *targets)
        return LeastSquaresSolution(values, inverse_normals, squares, self.pixels, free)

    def noise_stds(self) -> Array:
        """Return the standard deviations (N,) of a pixel about the model, grey levels.

        The square root of the sum of squares over the degrees of freedom, pixels less free unknowns (1 at
        least).
        """
        return np.asarray(np.sqrt(self.residual_squares / np.maximum(self.pixels - self.free, 1.0)))

    def contrasts(self) -> Array:
        """Return the contrasts (N,), grey levels, not below `MIN_CONTRAST`, so that they can divide."""
        return np.maximum(self.values[:, CONTRAST], MIN_CONTRAST)
