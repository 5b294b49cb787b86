"""The linear model of a marker's pixels around a pose: its columns, drawn at the image's own pixels.

With a marker's pattern T (`skyherd.vision.photometric.pattern`) at marker coordinates z = z(p) = x + iy,

    I(p) ≈ a + b T + b (T_z · δz + T_log σ δ log σ) + g (1 - A) + (l_x x + l_y y) (r + T),

with black a, contrast b, a step of the pose δz = d + (s + iθ) z + e z̄, a blur other than the pattern's,
ground g beyond the card, and light l that changes over the marker, with r = a / b. Nothing is resampled but
the pattern, so that the noise stays white.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.photometric.local_homography import Shapes
from skyherd.vision.photometric.pattern import Pattern
from skyherd.vision.photometric.pixel_support import BLOCK, Floats, lines_within

BLACK, CONTRAST, RIGHT, DOWN, TURN, GROW, BLUR, GROUND = range(8)
SQUEEZE, LIGHT, PIXELS = [8, 9], [10, 11], 12
POSE = [RIGHT, DOWN, TURN, GROW, *SQUEEZE]
"""Rows of the model's columns, two for what has two components, and of the pixels below them."""

ROWS = 16
"""Rows of `Pixels.columns`, the last ones empty: products of matrices are fastest in multiples of this."""

MIDDLE_GREY = 128.0
"""Taken off the pixels, so that sums of their squares keep their digits."""

ALIKE = 1.5
"""Markers whose sides differ by no more than this factor are treated at once."""

EDGE_REACH, PER_SIGMA = 4.0, 64
"""Half-width of the table of the card's edge, σ, and its entries to a σ: nearest ones are right to 0.003."""

_EDGE: Floats = ndtr(np.arange(-EDGE_REACH, EDGE_REACH + 1 / PER_SIGMA, 1 / PER_SIGMA)).astype(np.float32)
_EDGE[[0, -1]] = 0.0, 1.0


@dataclass(frozen=True)
class Looks:
    """What N markers look like at their size and blur.

    Attributes:
        patterns: of each.
        bends: of each, if they are squeezed.
        sigmas: (N,) blurs, in marker sides.
        limits: (N,) marker coordinates up to which pixels are read.
        sees_ground: (N,) whether the ground beyond the card can be seen within them.
        ratios: (N,) black over contrast.
        half_card: where the card ends, in marker coordinates.
        texture: deviation of the ground's texture over the noise.
    """

    patterns: list[Pattern]
    bends: list[Pattern]
    sigmas: Array
    limits: Array
    sees_ground: BoolArray
    ratios: Array
    half_card: float
    texture: float

    def take(self, rows: IntArray) -> "Looks":
        """Some of them."""
        return Looks(
            [self.patterns[row] for row in rows],
            [self.bends[row] for row in rows] if self.bends else [],
            self.sigmas[rows],
            self.limits[rows],
            self.sees_ground[rows],
            self.ratios[rows],
            self.half_card,
            self.texture,
        )


class Pixels:
    """The pixels of some of an image's markers, and the model's columns at them.

    Attributes:
        rows: (N,) which of the image's markers they are.
        counts: (N,) pixels of each, as many as are kept.
        columns: (N, 16, M) the model's columns and the pixels, all times the pixels' weights, 0 in padding.
    """

    def __init__(self, image: Image, rows: IntArray, shapes: Shapes, looks: Looks) -> None:
        self.rows = rows
        lines = lines_within(shapes, looks.limits, image.shape)
        self.x, self.y, self.counts, self._padded = lines.x, lines.y, lines.counts, lines.padded
        self.columns = np.empty((rows.size, ROWS, self.x.shape[1]), dtype=np.float32)
        self.columns[:, PIXELS + 1 :] = 0.0
        self._weigh(looks, shapes, lines.padded)
        grey = np.subtract(image.ravel().take(lines.places, mode="wrap"), MIDDLE_GREY, dtype=np.float32)
        np.multiply(grey, self.columns[:, BLACK], out=self.columns[:, PIXELS])
        self._fill(looks, shapes)

    def grams(self) -> Floats:
        """(N, 13, 13) inner products of the columns and the pixels."""
        return (self.columns @ self.columns.transpose(0, 2, 1))[:, : PIXELS + 1, : PIXELS + 1]

    def keep(self, wanted: BoolArray) -> None:
        """Leave out all pixels but those wanted (N, M)."""
        self.columns *= wanted[:, None]
        self.counts = np.count_nonzero(self.columns[:, BLACK], axis=1)

    def left(self, solutions: Array) -> Floats:
        """(N, M): what the model at `solutions` (N, 12) leaves of the pixels, times their weights."""
        model = np.zeros((self.rows.size, ROWS), dtype=np.float32)
        model[:, :PIXELS], model[:, PIXELS] = -solutions, 1.0
        return (model[:, None] @ self.columns)[:, 0]

    def _weigh(self, looks: Looks, shapes: Shapes, padded: Floats) -> None:
        """What of the ground is seen, and the pixels' weights: texture seen there is noise as well."""
        weights, ground = self.columns[:, BLACK], self.columns[:, GROUND]
        if not looks.sees_ground.any():
            weights[...], ground[...] = padded, 0.0
            return
        ground[...] = seen_beyond(self.x, self.y, looks, shapes.squeezes / shapes.arms)
        np.multiply(ground, ground, out=weights)
        weights *= np.float32(looks.texture**2)
        weights += 1
        np.divide(padded, np.sqrt(weights, out=weights), out=weights)
        ground *= weights

    def _fill(self, looks: Looks, shapes: Shapes) -> None:
        """Read the patterns at the pixels and make the model's columns of them."""
        x, y, columns = self.x, self.y, self.columns.transpose(1, 0, 2)
        weights = columns[BLACK]
        drawn = _read(looks.patterns, x, y)
        if looks.bends:
            self._bend(drawn, looks.bends, shapes)
        np.multiply(drawn[..., 0], weights, out=columns[CONTRAST])
        slope_x, slope_y = (np.multiply(drawn[..., axis], weights) for axis in (1, 2))
        np.multiply(drawn[..., 3], weights, out=columns[BLUR])
        np.negative(slope_x, out=columns[RIGHT])
        np.negative(slope_y, out=columns[DOWN])
        xx, yy, xy, yx = x * slope_x, y * slope_y, x * slope_y, y * slope_x
        np.subtract(yx, xy, out=columns[TURN])
        np.subtract(-xx, yy, out=columns[GROW])
        np.subtract(yy, xx, out=columns[SQUEEZE[0]])
        np.subtract(-yx, xy, out=columns[SQUEEZE[1]])
        light = looks.ratios.astype(np.float32)[:, None] * weights
        light += columns[CONTRAST]
        np.multiply(x, light, out=columns[LIGHT[0]])
        np.multiply(y, light, out=columns[LIGHT[1]])

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

    def leavings(self, solutions: Array, n_cells: int) -> tuple[Array, Array]:
        """What the model at `solutions` (N, 12) leaves, grey levels.

        Returns:
            Mean over each cell (N, n, n), and most of a pixel (N,).
        """
        left, cells = self.left(solutions), self._cells(n_cells)
        sizes = self._over_cells(cells, self.columns[:, BLACK] > 0, n_cells)
        means = self._over_cells(cells, left, n_cells) / np.maximum(sizes, 1)
        return means, np.maximum(left.max(axis=1), -left.min(axis=1)).astype(np.float64)

    def cells_seen(self, n_cells: int) -> Array:
        """(N, n, n): which share of each cell's pixels was kept."""
        cells = self._cells(n_cells)
        kept, read = (
            self._over_cells(cells, which, n_cells) for which in (self.columns[:, BLACK] > 0, self._padded)
        )
        return np.asarray(kept / np.maximum(read, 1))

    def _over_cells(self, cells: IntArray, values: npt.NDArray[Any], n_cells: int) -> Array:
        """(N, n, n) sums of values (N, M) over each cell."""
        grid = n_cells + 2
        sums = np.bincount(cells, values.ravel(), minlength=self.rows.size * grid**2)
        return np.asarray(sums.reshape(self.rows.size, grid, grid)[:, 1:-1, 1:-1], dtype=np.float64)

    def _cells(self, n_cells: int) -> IntArray:
        """(N M,) in which cell of all markers' each pixel lies, with a ring around for those outside."""
        grid = n_cells + 2
        down = self._cells_along(self.y, n_cells)
        down += np.arange(0, self.rows.size * grid, grid)[:, None]
        down *= grid
        down += self._cells_along(self.x, n_cells)
        return np.asarray(down.ravel())

    @staticmethod
    def _cells_along(along: Floats, n_cells: int) -> IntArray:
        """Cells, counted from 1, that marker coordinates (N, M) along one axis lie in."""
        cells = along * np.float32(n_cells)
        cells += np.float32(n_cells / 2 + 1)
        return np.clip(cells, 0, n_cells + 1.5, out=cells).astype(np.int64)


def seen_beyond(x: Floats, y: Floats, looks: Looks, squeezes: ComplexArray) -> Floats:
    """What of the ground beyond the card is seen at marker coordinates (N, M), `1 - A(x) A(y)`.

    With the blur σ and the card's edge at h, `A(x) = Φ((h - |x|) / σ)`: the other edge is too far off to be
    felt. Zero where a marker sees none within its limits. In the coordinates of a marker that is squeezed by
    e = `squeezes` (N,), `z + e z̄`, blur that is round in the image has deviations `σ |1 ∓ e| / (1 - |e|²)`.
    """
    middle = EDGE_REACH * PER_SIGMA + 0.5

    def covered(along: Floats, wide: Array) -> Floats:
        per_side = PER_SIGMA / (looks.sigmas * wide)
        edge = np.where(looks.sees_ground, looks.half_card * per_side + middle, np.inf)
        place = edge.astype(np.float32)[:, None] - per_side.astype(np.float32)[:, None] * np.abs(along)
        return _EDGE.take(np.clip(place, 0, 2 * middle - 1, out=place).astype(np.intp), mode="wrap")

    x_wide, y_wide = (np.abs(1 + sign * squeezes) / (1 - np.abs(squeezes) ** 2) for sign in (-1, 1))
    return np.asarray(1 - covered(x, x_wide) * covered(y, y_wide))


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


def take_pixels(image: Image, rows: IntArray, shapes: Shapes, looks: Looks) -> list[Pixels]:
    """Pixels of the markers `rows`, those whose sides differ by less than `ALIKE` together."""
    kinds = np.floor(np.log(shapes.sides_px()[rows]) / math.log(ALIKE))
    if rows.size == len(shapes) and (kinds == kinds[0]).all():
        return [Pixels(image, rows, shapes, looks)]
    return [
        Pixels(image, alike, shapes.take(alike), looks.take(alike))
        for kind in np.unique(kinds)
        for alike in [rows[kinds == kind]]
    ]
