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
        columns: (N, 13, M) the model's columns and the pixels, all times the pixels' weights, 0 in padding.
    """

    def __init__(self, image: Image, rows: IntArray, shapes: Shapes, looks: Looks) -> None:
        self.rows = rows
        lines = _lines_within(shapes, looks.limits, image.shape)
        size = lines.padded.shape[1]
        self.counts = lines.padded.sum(axis=1)
        self.columns = np.empty((rows.size, PIXELS + 1, size), dtype=np.float32)
        self.x, self.y = _marker_coordinates(shapes, lines)
        self._weigh(looks, lines.padded)
        grey = image.ravel().take(lines.places, mode="clip").reshape(rows.size, size)
        np.multiply(grey - np.float32(MIDDLE_GREY), self.weights, out=self.columns[:, PIXELS])
        self._fill(looks, shapes)

    def _weigh(self, looks: Looks, padded: Floats) -> None:
        """What of the ground is seen, and the pixels' weights: texture seen there is noise as well."""
        ground = self.columns[:, GROUND]
        ground[...] = 0.0
        for row in np.flatnonzero(looks.sees_ground):
            _read(looks.grounds[row], self.x[row], self.y[row], ground[row])
        seen = ground * looks.textures.astype(np.float32)[:, None]
        self.weights = self.columns[:, BLACK]
        np.divide(padded, np.sqrt(1 + seen * seen), out=self.weights)
        ground *= self.weights

    def _fill(self, looks: Looks, shapes: Shapes) -> None:
        """Read the patterns at the pixels and make the model's columns of them."""
        x, y, columns = self.x, self.y, self.columns
        drawn = np.empty((*x.shape, 4), dtype=np.float32)
        for row, pattern in enumerate(looks.patterns):
            _read(pattern, x[row], y[row], drawn[row])
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
        squeezes = (shapes.squeezes / shapes.arms).astype(np.complex64)
        leans = (shapes.horizons * shapes.arms.conj()).astype(np.complex64)
        for row, bend in enumerate(bends):
            x, y = self.x[row], self.y[row]
            bent = np.empty((x.size, 2), dtype=np.float32)
            _read(bend, x, y, bent)
            lean = leans[row] / 2
            squeeze_x = squeezes[row].real - (lean.real * x - lean.imag * y)
            squeeze_y = squeezes[row].imag - (lean.imag * x + lean.real * y)
            drawn[row, :, 0] -= bent[:, 0] * squeeze_x + bent[:, 1] * squeeze_y
            drawn[row, :, 0] += 3 * (lean.real * x + lean.imag * y) * drawn[row, :, 3]

    def cell_means(self, solutions: Array, n_cells: int) -> Array:
        """(N, n, n): mean over each cell of what the model at `solutions` (N, 12) leaves, grey levels."""
        count = self.rows.size
        model = np.concatenate([-solutions, np.ones((count, 1))], axis=1).astype(np.float32)
        left = (model[:, None] @ self.columns)[:, 0]
        across, down = (np.floor((z + np.float32(0.5)) * n_cells).astype(np.int32) for z in (self.x, self.y))
        inside = (np.minimum(across, down) >= 0) & (np.maximum(across, down) < n_cells) & (self.weights > 0)
        cell = (np.arange(count, dtype=np.int32)[:, None] * n_cells + down) * n_cells + across
        sums, sizes = (
            np.bincount(cell[inside], weights, minlength=count * n_cells**2)
            for weights in (left[inside], None)
        )
        return (sums / np.maximum(sizes, 1)).reshape(count, n_cells, n_cells)


@dataclass(frozen=True)
class Lines:
    """Pixels of N markers, line by line, each marker's filled up to the same number M.

    Attributes:
        padded: (N, M) 1 for a pixel, 0 for one that only fills up.
        places: (N x M,) where the pixels are in the image.
        u, v: (N, M) the pixels, from `origins` (N,).
    """

    padded: Floats
    places: IntArray
    u: Floats
    v: Floats
    origins: ComplexArray


def _lines_within(shapes: Shapes, limits: Array, image_shape: tuple[int, ...]) -> Lines:
    """The pixels of an image that lie within `limits` (N,) of the markers' centres, in marker coordinates.

    Each line of pixels meets the two strips `|x| < limit` and `|y| < limit` in intervals; their common part
    is taken.
    """
    right, down = shapes.arms + shapes.squeezes, 1j * (shapes.arms - shapes.squeezes)
    area = (right.conj() * down).imag
    reach = limits * (np.abs(right.imag) + np.abs(down.imag))
    lines = np.ceil(shapes.centers.imag - reach)[:, None] + np.arange(int(2 * reach.max()) + 1)
    v = lines - shapes.centers.imag[:, None]
    low, high = np.full(v.shape, -np.inf), np.full(v.shape, np.inf)
    # x = (down_v u - down_u v) / area and y = (right_u v - right_v u) / area, from the marker's centre.
    for per_u, per_v in ((down.imag / area, -down.real / area), (-right.imag / area, right.real / area)):
        per_u = np.where(np.abs(per_u) < 1e-12, 1e-12, per_u)[:, None]
        middle, half = -per_v[:, None] * v / per_u, limits[:, None] / np.abs(per_u)
        low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)
    low = np.maximum(np.ceil(low + shapes.centers.real[:, None]), 0)
    high = np.minimum(np.floor(high + shapes.centers.real[:, None]), image_shape[1] - 1)
    inside = (lines >= 0) & (lines < image_shape[0])
    counts = np.where(inside, np.maximum(high - low + 1, 0), 0).astype(np.int64)
    return _laid_out(low, lines, counts, image_shape[1], np.rint(shapes.centers))


def _laid_out(low: Array, lines: Array, counts: IntArray, width: int, origins: ComplexArray) -> Lines:
    """Pixels from `low` (N, L), `counts` of them, on image `lines`; a last line fills each marker up."""
    totals = counts.sum(axis=1)
    size = -(-max(int(totals.max()), 1) // BLOCK) * BLOCK
    counts = np.column_stack([counts, size - totals]).ravel()
    fill = np.zeros(totals.size)
    low, lines = np.column_stack([low, fill]), np.column_stack([lines, fill])
    line = np.repeat(np.arange(counts.size, dtype=np.int32), counts)
    within = -(np.cumsum(counts) - counts)
    position = np.arange(line.size)
    places = position + (within + (lines * width + low).ravel().astype(np.int64))[line]
    u = position + (within + (low - origins.real[:, None]).ravel())[line]
    v = (lines - origins.imag[:, None]).ravel()[line]
    shape = (totals.size, size)
    padded = (np.arange(size) < totals[:, None]).astype(np.float32)
    return Lines(
        padded, places, u.astype(np.float32).reshape(shape), v.astype(np.float32).reshape(shape), origins
    )


def _marker_coordinates(shapes: Shapes, lines: Lines) -> tuple[Floats, Floats]:
    """x, y (N, M) of pixels."""
    matrices = np.linalg.inv(shapes.matrices(lines.origins)).astype(np.float32)
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(matrices, 0, 2)[..., None]
    u, v = lines.u, lines.v
    x, y = a * u + b * v + c, d * u + e * v + f
    if not shapes.horizons.any():
        return x, y
    w = g * u + h * v + i
    return x / w, y / w


def _read(pattern: Pattern, x: Floats, y: Floats, out: Floats) -> None:
    """A pattern's values at marker coordinates (M,), into `out` (M,) or (M, 4)."""
    u, v = ((z * np.float32(pattern.rate) + np.float32(pattern.center)).reshape(-1, BLOCK) for z in (x, y))
    into = out.reshape(*u.shape, *out.shape[1:])
    cv2.remap(pattern.values, u, v, cv2.INTER_LINEAR, dst=into, borderMode=cv2.BORDER_REPLICATE)


def take_pixels(image: Image, rows: IntArray, shapes: Shapes, looks: Looks) -> list[Pixels]:
    """Pixels of the markers `rows`, those whose sides differ by less than `ALIKE` together."""
    kinds = np.floor(np.log(shapes.sides_px()[rows]) / np.log(ALIKE))
    return [
        Pixels(image, alike, shapes.take(alike), looks.take(alike))
        for kind in np.unique(kinds)
        for alike in [rows[kinds == kind]]
    ]
