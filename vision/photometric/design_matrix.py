"""The linear model of a marker's pixels around a pose: its design matrix, drawn at the image's own pixels.

With a marker's pattern T (`skyherd.vision.photometric.pattern`) at marker coordinates z = z(p) = x + iy, the
grey level of pixel p is

    I(p) ≈ a + b T + b (T_z · δz + T_log σ δ log σ) + g (1 - A) + (l_x x + l_y y) (r + T) + c T (1 - T),

with black level a, contrast b (white minus black), a step of the pose δz = d + (s + iθ) z + e z̄ - z Re(q̄ z)
(shift d, scale s, rotation θ, squeeze e, lean q), a change of the blur's logarithm δ log σ, ground level g
beyond the card, of which the card covers the share A, light l that changes over the marker, with r = a / b,
and a bend c of the tone curve, by which a camera's gamma shifts edges towards black. Everything that the
pixels depend on is thus an unknown of one linear model, 15 in all; eight of them make up a homography.

The pattern and its derivatives are read *at the image's own pixels*; the image itself is never resampled, so
that its noise stays white.

Ground seen through the blur near the card's edge has a texture, which the model does not describe. Pixels are
therefore weighted by `1 / sqrt(1 + (t (1 - A))²)`, with t the texture's standard deviation over the noise:
texture is noise too, and without the weights the covariance would promise too much.
"""

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.photometric.appearance import MarkerAppearances, ground_share
from skyherd.vision.photometric.local_homography import LocalHomographies
from skyherd.vision.photometric.pattern import Pattern
from skyherd.vision.photometric.pixel_support import BLOCK, Floats, pixels_within

BLACK, CONTRAST, RIGHT, DOWN, TURN, GROW, BLUR, GROUND = range(8)
"""Indices of the unknowns with one component, in the order of the model's columns."""

SQUEEZE, LIGHT, LEAN = [8, 9], [10, 11], [12, 13]
"""Indices of the unknowns with two components each."""

TONE = [14]
"""Index of the bend of the tone curve, in a list as those of two components are."""

UNKNOWNS = 15
"""Number of unknowns of a marker. Derived: the indices above."""

PIXEL_ROW = UNKNOWNS
"""Index of the pixels' own values, which are stored beside the model's columns."""

POSE = [RIGHT, DOWN, TURN, GROW, *SQUEEZE, *LEAN]
"""Indices of the unknowns that make up a step of the pose."""

PADDED_COLUMNS = 16
"""Rows allocated in `DesignMatrices.columns`: the 15 unknowns and the pixels. Products of single-precision
matrices are fastest at multiples of 16; if there were fewer unknowns, the rest would be zeros."""

MIDDLE_GREY = 128.0
"""Grey level that is subtracted from the pixels, so that sums of their squares keep their digits in single
precision. Chosen: the middle of the 8-bit range."""

SIZE_RATIO = 1.5
"""Markers whose sides differ by less than this factor share one padded array. Chosen: a larger factor means
more padding, a smaller one more arrays."""


class DesignMatrices:
    """The pixels of some of an image's markers, and the model's columns at them.

    Attributes:
        rows: (N,) indices of these markers among those of the image.
        x, y: (N, M) marker coordinates of the pixels, in sides.
        counts: (N,) number of pixels used of each marker.
        columns: (N, 16, M) the model's columns and, in row `PIXEL_ROW`, the pixels less `MIDDLE_GREY`, all
            times the pixels' weights; 0 in padding and for pixels that are not used.
    """

    def __init__(
        self, image: Image, rows: IntArray, homographies: LocalHomographies, appearances: MarkerAppearances
    ) -> None:
        self.rows = rows
        support = pixels_within(homographies, appearances.read_limits, image.shape)
        self.x, self.y, self.counts, self._mask = support.x, support.y, support.counts, support.mask
        self._flat_indices, self._width = support.flat_indices, image.shape[1]
        self.columns = np.empty((rows.size, PADDED_COLUMNS, self.x.shape[1]), dtype=np.float32)
        self.columns[:, PIXEL_ROW + 1 :] = 0.0
        self._set_weights(appearances, homographies)
        grey = np.subtract(
            image.ravel().take(support.flat_indices, mode="wrap"), MIDDLE_GREY, dtype=np.float32
        )
        np.multiply(grey, self.columns[:, BLACK], out=self.columns[:, PIXEL_ROW])
        self._fill(appearances, homographies)

    def gram_matrices(self) -> Floats:
        """Return the inner products (N, 16, 16) of the weighted columns and the pixels."""
        size = PIXEL_ROW + 1
        return (self.columns @ self.columns.transpose(0, 2, 1))[:, :size, :size]

    def restrict(self, used: BoolArray) -> None:
        """Set all pixels to zero, in place, but those marked in `used` (N, M)."""
        self.columns *= used[:, None]
        self.counts = np.count_nonzero(self.columns[:, BLACK], axis=1)

    def residuals(self, solutions: Array) -> Floats:
        """Return the weighted residuals (N, M), grey levels, of the model at `solutions` (N, 15)."""
        model = np.zeros((self.rows.size, PADDED_COLUMNS), dtype=np.float32)
        model[:, :UNKNOWNS], model[:, PIXEL_ROW] = -solutions, 1.0
        return (model[:, None] @ self.columns)[:, 0]

    def cell_residuals(self, solutions: Array, n_cells: int) -> tuple[Array, Array]:
        """Return what the model at `solutions` (N, 15) leaves of the pixels, grey levels.

        Returns:
            The mean residual over each cell (N, n, n), and the largest absolute residual of a pixel (N,).
        """
        residuals, cells = self.residuals(solutions), self._cells(n_cells)
        sizes = self._sum_over_cells(cells, self.columns[:, BLACK] > 0, n_cells)
        means = self._sum_over_cells(cells, residuals, n_cells) / np.maximum(sizes, 1)
        return means, np.maximum(residuals.max(axis=1), -residuals.min(axis=1)).astype(np.float64)

    def squared_box_sums(
        self, solutions: Array, influences: Array, picked: IntArray, box_px: int
    ) -> tuple[Array, Array, Array]:
        """Return how influences times residuals add up over boxes of pixels, for some of the markers.

        Args:
            solutions: (N, 15) of the model.
            influences: (N, K, 15) by how much each of K quantities changes with what the model's columns do.
            picked: (P,) which of these N markers.
            box_px: side of the small boxes; large ones have twice as much.

        Returns:
            The sums (P, K) over all small boxes, and over all large ones, of the square of what influence
            times residual adds up to in a box; and the number (P,) of large boxes that have pixels.
        """
        columns = self.columns[picked]
        weighted = influences[picked].astype(np.float32) @ columns[:, :UNKNOWNS]
        weighted *= self.residuals(solutions)[picked][:, None]
        v, u = np.divmod(self._flat_indices[picked], self._width)
        used = columns[:, BLACK] > 0
        rows, across = _boxes_along(v, used, box_px), _boxes_along(u, used, box_px)
        n_rows, n_across = (2 * (int(boxes.max()) // 2 + 1) for boxes in (rows, across))
        count, shape = picked.size * n_rows * n_across, (picked.size, n_rows // 2, 2, n_across // 2, 2)
        boxes = ((np.arange(picked.size)[:, None] * n_rows + rows) * n_across + across).ravel()
        sums = [np.bincount(boxes, one.ravel(), count).reshape(shape) for one in weighted.transpose(1, 0, 2)]
        small = np.stack([np.square(one).sum(axis=(1, 2, 3, 4)) for one in sums], axis=1)
        large = np.stack([np.square(one.sum(axis=(2, 4))).sum(axis=(1, 2)) for one in sums], axis=1)
        filled = np.bincount(boxes, used.ravel(), count).reshape(shape).any(axis=(2, 4))
        return small, large, filled.sum(axis=(1, 2))

    def cell_support(self, n_cells: int) -> Array:
        """Return the share (N, n, n) of each cell's pixels that is used; 0 for a cell off the image."""
        cells = self._cells(n_cells)
        used, read = (
            self._sum_over_cells(cells, which, n_cells) for which in (self.columns[:, BLACK] > 0, self._mask)
        )
        return np.asarray(used / np.maximum(read, 1))

    def _set_weights(self, appearances: MarkerAppearances, homographies: LocalHomographies) -> None:
        """Fill the columns of black, which are the pixels' weights, and of the ground seen."""
        weights, ground = self.columns[:, BLACK], self.columns[:, GROUND]
        if not appearances.reaches_ground.any():
            weights[...], ground[...] = self._mask, 0.0
            return
        ground[...] = ground_share(self.x, self.y, appearances, homographies.squeezes / homographies.arms)
        np.multiply(ground, ground, out=weights)
        weights *= np.float32(appearances.texture**2)
        weights += 1
        np.divide(self._mask, np.sqrt(weights, out=weights), out=weights)
        ground *= weights

    def _fill(self, appearances: MarkerAppearances, homographies: LocalHomographies) -> None:
        """Read the patterns at the pixels and make the model's other columns of them."""
        x, y, columns = self.x, self.y, self.columns.transpose(1, 0, 2)
        weights = columns[BLACK]
        drawn = _read(appearances.patterns, x, y)
        if appearances.anisotropies:
            self._add_anisotropy(drawn, appearances.anisotropies, homographies)
        np.multiply(drawn[..., 0], weights, out=columns[CONTRAST])
        np.subtract(1, drawn[..., 0], out=columns[TONE[0]])
        columns[TONE[0]] *= columns[CONTRAST]
        slope_x, slope_y = (np.multiply(drawn[..., axis], weights) for axis in (1, 2))
        np.multiply(drawn[..., 3], weights, out=columns[BLUR])
        np.negative(slope_x, out=columns[RIGHT])
        np.negative(slope_y, out=columns[DOWN])
        xx, yy, xy, yx = x * slope_x, y * slope_y, x * slope_y, y * slope_x
        np.subtract(yx, xy, out=columns[TURN])
        np.subtract(-xx, yy, out=columns[GROW])
        for axis, along in zip(LEAN, (x, y), strict=True):
            np.multiply(columns[GROW], along, out=columns[axis])
            np.negative(columns[axis], out=columns[axis])
        np.subtract(yy, xx, out=columns[SQUEEZE[0]])
        np.subtract(-yx, xy, out=columns[SQUEEZE[1]])
        light = appearances.black_ratios.astype(np.float32)[:, None] * weights
        light += columns[CONTRAST]
        np.multiply(x, light, out=columns[LIGHT[0]])
        np.multiply(y, light, out=columns[LIGHT[1]])

    def _add_anisotropy(
        self, drawn: Floats, anisotropies: list[Pattern], homographies: LocalHomographies
    ) -> None:
        """Correct T in `drawn` (N, M, 4), in place, for blur that is round in the image only.

        Towards the horizon the marker shrinks by `w^(-3/2)` with `w = 1 + Re(h̄ m z)`, so that the blur grows
        in its coordinates, and the squeeze changes by `- h m̄ z / 2`.
        """
        x, y, factors = self.x, self.y, _read(anisotropies, self.x, self.y)
        squeezes = homographies.anisotropies().astype(np.complex64)[:, None]
        leans = (homographies.horizons * homographies.arms.conj() / 2).astype(np.complex64)[:, None]
        squeeze_x = squeezes.real - (leans.real * x - leans.imag * y)
        squeeze_y = squeezes.imag - (leans.imag * x + leans.real * y)
        drawn[..., 0] -= factors[..., 0] * squeeze_x + factors[..., 1] * squeeze_y
        drawn[..., 0] += 3 * (leans.real * x + leans.imag * y) * drawn[..., 3]

    def _sum_over_cells(self, cells: IntArray, values: npt.NDArray[Any], n_cells: int) -> Array:
        """Sums (N, n, n) of values (N, M) over each cell."""
        grid = n_cells + 2
        sums = np.bincount(cells, values.ravel(), minlength=self.rows.size * grid**2)
        return np.asarray(sums.reshape(self.rows.size, grid, grid)[:, 1:-1, 1:-1], dtype=np.float64)

    def _cells(self, n_cells: int) -> IntArray:
        """Index (N M,) of each pixel's cell among those of all markers, each with a ring around it."""
        grid = n_cells + 2
        cells = self._cells_along(self.y, n_cells)
        cells += np.arange(0, self.rows.size * grid, grid)[:, None]
        cells *= grid
        cells += self._cells_along(self.x, n_cells)
        return np.asarray(cells.ravel())

    @staticmethod
    def _cells_along(along: Floats, n_cells: int) -> IntArray:
        """Cells, counted from 1, of marker coordinates (N, M) along one axis; outside: 0 and n + 1."""
        cells = along * np.float32(n_cells)
        cells += np.float32(n_cells / 2 + 1)
        return np.clip(cells, 0, n_cells + 1.5, out=cells).astype(np.int64)


def _boxes_along(along: IntArray, used: BoolArray, box_px: int) -> IntArray:
    """Numbers (P, M) of the boxes of lines or columns `along`, from 0 at the first that is used."""
    boxes = along // box_px
    first = np.where(used, boxes, np.iinfo(boxes.dtype).max).min(axis=1, keepdims=True)
    return np.where(used, boxes - first, 0)


def _read(patterns: list[Pattern], x: Floats, y: Floats) -> Floats:
    """Values of N patterns at marker coordinates (N, M): (N, M), or (N, M, channels)."""
    scales = np.array([(pattern.rate, pattern.center) for pattern in patterns], dtype=np.float32)
    rates, centers = scales[:, :1], scales[:, 1:]
    u, v = ((z * rates + centers).reshape(len(patterns), -1, BLOCK) for z in (x, y))
    values = np.empty((*u.shape, *patterns[0].values.shape[2:]), dtype=np.float32)
    for row, pattern in enumerate(patterns):
        cv2.remap(
            pattern.values, u[row], v[row], cv2.INTER_LINEAR, dst=values[row], borderMode=cv2.BORDER_REPLICATE
        )
    return values.reshape(*x.shape, *values.shape[3:])


def design_matrices_of(
    image: Image, rows: IntArray, homographies: LocalHomographies, appearances: MarkerAppearances
) -> list[DesignMatrices]:
    """Return design matrices of the markers `rows` (R,), those of similar size (`SIZE_RATIO`) together.

    Args:
        image: grey, (height, width).
        rows: indices of the markers to be read.
        homographies: of all N markers.
        appearances: of all N markers.
    """
    kinds = np.floor(np.log(homographies.sides_px()[rows]) / math.log(SIZE_RATIO))
    if rows.size == len(homographies) and (kinds == kinds[0]).all():
        return [DesignMatrices(image, rows, homographies, appearances)]
    return [
        DesignMatrices(image, same_size, homographies.take(same_size), appearances.take(same_size))
        for kind in np.unique(kinds)
        for same_size in [rows[kinds == kind]]
    ]
