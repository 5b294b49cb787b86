"""The linear model of a marker's pixels around a pose: its columns, drawn at the image's own pixels.

With a marker's pattern T (`skyherd.vision.pattern`) at marker coordinates z = z(p) = x + iy,

    I(p) ≈ a + b T + b (T_z · δz + T_log σ δ log σ) + g (1 - A) + (l_x x + l_y y) (r + T),

with black a, contrast b, a step of the pose δz = d + (s + iθ) z + e z̄, a blur other than the pattern's,
ground g beyond the card, and light l that changes over the marker, with r = a / b. Nothing is resampled but
the pattern, so that the noise stays white.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.pattern import Pattern
from skyherd.vision.shapes import Shapes

Floats = npt.NDArray[np.float32]

BLACK, CONTRAST, RIGHT, DOWN, TURN, GROW, BLUR, GROUND = range(8)
SQUEEZE, LIGHT, PIXELS = [8, 9], [10, 11], 12
"""Rows of the model's columns, two for what has two components, and of the pixels below them."""

ROWS = 16
"""Rows of `Pixels.columns`, the last ones empty: products of matrices are fastest in multiples of this."""

MIDDLE_GREY = 128.0
"""Taken off the pixels, so that sums of their squares keep their digits."""

ALIKE = 1.5
"""Markers whose sides differ by no more than this factor are treated at once."""

BLOCK = 64
"""Pixels are padded to a multiple of this: OpenCV reads a pattern at blocks of points."""


@dataclass(frozen=True)
class Looks:
    """What markers look like at their size and blur: N patterns, and what of the ground each would show.

    `limits` (N,) are the marker coordinates up to which pixels are read, `ratios` (N,) black over contrast,
    `textures` (N,) deviations of the ground's texture over the noise; `bends` are needed of squeezed markers
    only.
    """

    patterns: list[Pattern]
    grounds: list[Pattern]
    bends: list[Pattern]
    limits: Array
    sees_ground: BoolArray
    textures: Array
    ratios: Array

    def take(self, rows: IntArray) -> "Looks":
        """Some of them."""
        return Looks(
            [self.patterns[row] for row in rows],
            [self.grounds[row] for row in rows],
            [self.bends[row] for row in rows] if self.bends else [],
            self.limits[rows],
            self.sees_ground[rows],
            self.textures[rows],
            self.ratios[rows],
        )


class Pixels:
    """The pixels of some of an image's markers, and the model's columns at them.

    Attributes:
        rows: (N,) which of the image's markers they are.
        counts: (N,) pixels of each.
        columns: (N, 16, M) the model's columns and the pixels, all times the pixels' weights, 0 in padding.
    """

    def __init__(self, image: Image, rows: IntArray, shapes: Shapes, looks: Looks) -> None:
        self.rows = rows
        lines = _lines_within(shapes, looks.limits, image.shape)
        self.x, self.y, padded = lines.x, lines.y, lines.padded
        self.counts = padded.sum(axis=1)
        self.columns = np.empty((rows.size, ROWS, padded.shape[1]), dtype=np.float32)
        self.columns[:, PIXELS + 1 :] = 0.0
        self._weigh(looks, padded)
        grey = image.ravel().take(lines.places, mode="clip").reshape(padded.shape)
        np.multiply(grey - np.float32(MIDDLE_GREY), self.weights, out=self.columns[:, PIXELS])
        self._fill(looks, shapes)

    def grams(self) -> Floats:
        """(N, 13, 13) inner products of the columns and the pixels."""
        return (self.columns @ self.columns.transpose(0, 2, 1))[:, : PIXELS + 1, : PIXELS + 1]

    def _weigh(self, looks: Looks, padded: Floats) -> None:
        """What of the ground is seen, and the pixels' weights: texture seen there is noise as well."""
        ground = self.columns[:, GROUND]
        ground[...] = 0.0
        seeing = np.flatnonzero(looks.sees_ground)
        if seeing.size:
            ground[seeing] = _read([looks.grounds[row] for row in seeing], self.x[seeing], self.y[seeing])
        seen = ground * looks.textures.astype(np.float32)[:, None]
        self.weights = self.columns[:, BLACK]
        np.divide(padded, np.sqrt(1 + seen * seen), out=self.weights)
        ground *= self.weights

    def _fill(self, looks: Looks, shapes: Shapes) -> None:
        """Read the patterns at the pixels and make the model's columns of them."""
        x, y, columns = self.x, self.y, self.columns
        drawn = _read(looks.patterns, x, y)
        if looks.bends:
            self._bend(drawn, looks.bends, shapes)
        np.multiply(drawn[..., 0], self.weights, out=columns[:, CONTRAST])
        slope_x, slope_y = (np.multiply(drawn[..., axis], self.weights) for axis in (1, 2))
        np.multiply(drawn[..., 3], self.weights, out=columns[:, BLUR])
        np.negative(slope_x, out=columns[:, RIGHT])
        np.negative(slope_y, out=columns[:, DOWN])
        xx, yy, xy, yx = x * slope_x, y * slope_y, x * slope_y, y * slope_x
        np.subtract(yx, xy, out=columns[:, TURN])
        np.subtract(-xx, yy, out=columns[:, GROW])
        np.subtract(yy, xx, out=columns[:, SQUEEZE[0]])
        np.subtract(-yx, xy, out=columns[:, SQUEEZE[1]])
        light = columns[:, CONTRAST] + looks.ratios.astype(np.float32)[:, None] * self.weights
        np.multiply(x, light, out=columns[:, LIGHT[0]])
        np.multiply(y, light, out=columns[:, LIGHT[1]])

    def _bend(self, drawn: Floats, bends: list[Pattern], shapes: Shapes) -> None:
        """Take into T (N, M, 4) that a blur round in the image is not so in a squeezed marker's coordinates.

        Towards the horizon the marker shrinks by `w^(-3/2)` with `w = 1 + Re(h̄ m z)`, so that blur grows in
        its coordinates, and the squeeze changes by `- h m̄ z / 2`.
        """
        x, y, bent = self.x, self.y, _read(bends, self.x, self.y)
        squeezes = (shapes.squeezes / shapes.arms).astype(np.complex64)[:, None]
        leans = (shapes.horizons * shapes.arms.conj() / 2).astype(np.complex64)[:, None]
        squeeze_x = squeezes.real - (leans.real * x - leans.imag * y)
        squeeze_y = squeezes.imag - (leans.imag * x + leans.real * y)
        drawn[..., 0] -= bent[..., 0] * squeeze_x + bent[..., 1] * squeeze_y
        drawn[..., 0] += 3 * (leans.real * x + leans.imag * y) * drawn[..., 3]

    def cell_means(self, solutions: Array, n_cells: int) -> Array:
        """(N, n, n): mean over each cell of what the model at `solutions` (N, 12) leaves, grey levels."""
        count = self.rows.size
        model = np.zeros((count, ROWS), dtype=np.float32)
        model[:, :PIXELS], model[:, PIXELS] = -solutions, 1.0
        left = (model[:, None] @ self.columns)[:, 0]
        grid = n_cells + 2  # with a ring around for pixels outside
        across, down = (
            np.clip(z * np.float32(n_cells) + np.float32(n_cells / 2 + 1), 0, grid - 0.5).astype(np.intp)
            for z in (self.x, self.y)
        )
        cell = ((np.arange(count)[:, None] * grid + down) * grid + across).ravel()
        sums, sizes = (
            np.bincount(cell, values.ravel(), minlength=count * grid**2)
            for values in (left, self.weights > 0)
        )
        means = (sums / np.maximum(sizes, 1)).reshape(count, grid, grid)
        return np.asarray(means[:, 1:-1, 1:-1])


@dataclass(frozen=True)
class Lines:
    """Pixels of N markers, line by line, each marker's filled up to the same number M with its centre.

    Attributes:
        padded: (N, M) 1 for a pixel, 0 for one that only fills up.
        places: (N x M,) where the pixels are in the image.
        x, y: (N, M) marker coordinates.
    """

    padded: Floats
    places: IntArray
    x: Floats
    y: Floats


def _lines_within(shapes: Shapes, limits: Array, image_shape: tuple[int, ...]) -> Lines:
    """The pixels of an image that lie within `limits` (N,) of the markers' centres, in marker coordinates.

    Each line of pixels meets the two strips `|x| < limit` and `|y| < limit` in intervals; their common part
    is taken.
    """
    right, down = shapes.arms + shapes.squeezes, 1j * (shapes.arms - shapes.squeezes)
    reach = limits * (np.abs(right.imag) + np.abs(down.imag))
    lines = np.ceil(shapes.centers.imag - reach)[:, None] + np.arange(int(2 * reach.max()) + 1)
    v = lines - shapes.centers.imag[:, None]
    low, high = np.full(v.shape, -np.inf), np.full(v.shape, np.inf)
    for axis in shapes.axes():
        per_u = np.where(np.abs(axis.real) < 1e-12, 1e-12, axis.real)[:, None]
        middle, half = -axis.imag[:, None] * v / per_u, limits[:, None] / np.abs(per_u)
        low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)
    low = np.maximum(np.ceil(low + shapes.centers.real[:, None]), 0)
    high = np.minimum(np.floor(high + shapes.centers.real[:, None]), image_shape[1] - 1)
    inside = (lines >= 0) & (lines < image_shape[0])
    counts = np.where(inside, np.maximum(high - low + 1, 0), 0).astype(np.int64)
    return _laid_out(shapes, low, lines, counts, image_shape[1])


def _laid_out(shapes: Shapes, low: Array, lines: Array, counts: IntArray, width: int) -> Lines:
    """Pixels from `low` (N, L), `counts` of them, on image `lines`; a last line fills each marker up."""
    totals = counts.sum(axis=1)
    size = -(-max(int(totals.max()), 1) // BLOCK) * BLOCK
    padded = (np.arange(size) < totals[:, None]).astype(np.float32)
    counts = np.column_stack([counts, size - totals]).ravel()
    low = np.column_stack([low, shapes.centers.real])
    lines = np.column_stack([lines, shapes.centers.imag])
    begins = low - shapes.centers.real[:, None] + 1j * (lines - shapes.centers.imag[:, None])
    step = np.arange(padded.size) - np.repeat(np.cumsum(counts) - counts, counts)
    places = np.repeat((lines * width + low).astype(np.int64).ravel(), counts) + step
    within = step.astype(np.float32).reshape(padded.shape) * padded

    def along(axis: ComplexArray) -> Floats:
        """`Re(axis̄ p)` of all pixels p, from their markers' centres."""
        at_begin = (axis.conj()[:, None] * begins).real.astype(np.float32)
        slope = axis.real.astype(np.float32)[:, None]
        return np.asarray(np.repeat(at_begin.ravel(), counts).reshape(padded.shape) + slope * within)

    x, y = (along(axis) for axis in shapes.axes())
    if shapes.horizons.any():
        nearness = 1 - along(shapes.horizons)
        x, y = x / nearness, y / nearness
    return Lines(padded, places, x, y)


def _read(patterns: list[Pattern], x: Floats, y: Floats) -> Floats:
    """Values of N patterns at marker coordinates (N, M): (N, M), or (N, M, channels)."""
    rates, centers = (
        np.array([[getattr(pattern, name)] for pattern in patterns], dtype=np.float32)
        for name in ("rate", "center")
    )
    u, v = ((z * rates + centers).reshape(len(patterns), -1, BLOCK) for z in (x, y))
    values = np.empty((*u.shape, *patterns[0].values.shape[2:]), dtype=np.float32)
    for row, pattern in enumerate(patterns):
        cv2.remap(
            pattern.values, u[row], v[row], cv2.INTER_LINEAR, dst=values[row], borderMode=cv2.BORDER_REPLICATE
        )
    return values.reshape(*x.shape, *values.shape[3:])


def take_pixels(image: Image, rows: IntArray, shapes: Shapes, looks: Looks) -> list[Pixels]:
    """Pixels of the markers `rows`, those whose sides differ by less than `ALIKE` together."""
    kinds = np.floor(np.log(shapes.sides_px()[rows]) / np.log(ALIKE))
    return [
        Pixels(image, alike, shapes.take(alike), looks.take(alike))
        for kind in np.unique(kinds)
        for alike in [rows[kinds == kind]]
    ]
