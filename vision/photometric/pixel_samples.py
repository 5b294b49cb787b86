"""The pixels that a fit of N markers rests on, kept from one step of the fit to the next."""

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.photometric.appearance import MarkerAppearances
from skyherd.vision.photometric.design_matrix import (
    UNKNOWNS,
    DesignMatrices,
    design_matrices_of,
)
from skyherd.vision.photometric.least_squares import LeastSquaresSolution
from skyherd.vision.photometric.local_homography import LocalHomographies


class PixelSamples:
    """The pixels last read of each of N markers, as design matrices and their Gram matrices.

    A fit reads again only the markers that still move. The Gram matrices of the others stay, so that one
    solution covers all N markers in every step.
    """

    def __init__(self, count: int) -> None:
        self._grams, self._counts = np.empty((count, UNKNOWNS + 1, UNKNOWNS + 1)), np.empty(count)
        self._parts: list[DesignMatrices] = []
        self._part_of = np.empty(count, dtype=np.int64)

    def read(
        self,
        image: Image,
        rows: IntArray,
        start: LocalHomographies,
        appearances: MarkerAppearances,
        inlier_limits: tuple[Array, Array] | None = None,
    ) -> None:
        """Read the pixels of the markers `rows` (R,) anew.

        Args:
            image: grey, (height, width).
            rows: indices of the markers to be read.
            start: homographies of all N markers, about which the model is linear.
            appearances: of all N markers.
            inlier_limits: a solution (N, 12) and limits (N,), grey levels; only pixels whose residual from
                that solution is below their marker's limit are used. All are if left out.
        """
        for pixels in design_matrices_of(image, rows, start, appearances):
            if inlier_limits is not None:
                values, limits = (of_each[pixels.rows] for of_each in inlier_limits)
                pixels.restrict(np.abs(pixels.residuals(values)) < limits[:, None])
            self._grams[pixels.rows], self._counts[pixels.rows] = pixels.gram_matrices(), pixels.counts
            self._part_of[pixels.rows] = len(self._parts)
            self._parts.append(pixels)

    def solution(self) -> LeastSquaresSolution:
        """Return the least-squares solution for all N markers, with every unknown free."""
        return LeastSquaresSolution.of_grams(self._grams, self._counts)

    def cell_residuals(
        self, rows: IntArray, solution: LeastSquaresSolution, n_cells: int
    ) -> tuple[Array, Array]:
        """Return what a solution of all N markers leaves of the pixels of the markers `rows` (R,).

        Returns:
            The mean residual over each cell (R, n, n), and the largest absolute residual of a pixel (R,),
            both in grey levels.
        """
        means, peaks = np.empty((self._counts.size, n_cells, n_cells)), np.empty(self._counts.size)
        for pixels in self._latest_parts(rows):
            means[pixels.rows], peaks[pixels.rows] = pixels.cell_residuals(
                solution.values[pixels.rows], n_cells
            )
        return means[rows], peaks[rows]

    def cell_support(self, rows: IntArray, n_cells: int) -> Array:
        """Return the share (R, n, n) of each cell's pixels that was used, for the markers `rows` (R,)."""
        shares = np.empty((self._counts.size, n_cells, n_cells))
        for pixels in self._latest_parts(rows):
            shares[pixels.rows] = pixels.cell_support(n_cells)
        return shares[rows]

    def _latest_parts(self, rows: IntArray) -> list[DesignMatrices]:
        """The parts that hold the latest pixels of the markers `rows`, in the order of reading."""
        return [self._parts[part] for part in np.unique(self._part_of[rows])]
