"""The pixels that a fit of N markers rests on, and what they come to."""

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.photometric.design_matrix import PIXELS, Looks, Pixels, take_pixels
from skyherd.vision.photometric.least_squares import Solved
from skyherd.vision.photometric.local_homography import Shapes


class Taken:
    """The pixels last taken of each of N markers."""

    def __init__(self, count: int) -> None:
        self._grams, self._counts = np.empty((count, PIXELS + 1, PIXELS + 1)), np.empty(count)
        self._parts: list[Pixels] = []
        self._part_of = np.empty(count, dtype=np.int64)

    def take(
        self,
        image: Image,
        rows: IntArray,
        start: Shapes,
        looks: Looks,
        explained: tuple[Array, Array] | None = None,
    ) -> None:
        """Take those of the markers `rows` anew.

        With `explained` only those of which a solution (N, 12) leaves less than a limit (N,), grey levels.
        """
        for pixels in take_pixels(image, rows, start, looks):
            if explained is not None:
                values, limits = (of_each[pixels.rows] for of_each in explained)
                pixels.keep(np.abs(pixels.left(values)) < limits[:, None])
            self._grams[pixels.rows], self._counts[pixels.rows] = pixels.grams(), pixels.counts
            self._part_of[pixels.rows] = len(self._parts)
            self._parts.append(pixels)

    def solved(self) -> Solved:
        """Solutions for all markers, every unknown free."""
        return Solved.of(self._grams, self._counts)

    def leavings(self, rows: IntArray, solved: Solved, n_cells: int) -> tuple[Array, Array]:
        """What a solution leaves of the markers `rows` (R,), grey levels.

        Returns:
            Mean over each cell (R, n, n), and most of a pixel (R,).
        """
        means, peaks = np.empty((self._counts.size, n_cells, n_cells)), np.empty(self._counts.size)
        for pixels in self._last(rows):
            means[pixels.rows], peaks[pixels.rows] = pixels.leavings(solved.values[pixels.rows], n_cells)
        return means[rows], peaks[rows]

    def cells_seen(self, rows: IntArray, n_cells: int) -> Array:
        """(R, n, n) which share of each cell's pixels was taken."""
        shares = np.empty((self._counts.size, n_cells, n_cells))
        for pixels in self._last(rows):
            shares[pixels.rows] = pixels.cells_seen(n_cells)
        return shares[rows]

    def _last(self, rows: IntArray) -> list[Pixels]:
        """Those of the markers `rows`, in the order in which they were taken."""
        return [self._parts[part] for part in np.unique(self._part_of[rows])]
