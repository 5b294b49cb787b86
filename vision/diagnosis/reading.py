"""Cells of candidates: which differ from a marker's, how alike they are to it, and the margin around them."""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import border_cells, cells_per_side, sides_of_corners
from skyherd.vision.grey import Image, sample_squares
from skyherd.vision.native.pattern_records import PARTS
from skyherd.vision.photometric.evidence.readings import (
    BLURS_CELLS,
    Readings,
    black_cells,
    draw_codes,
    exposed,
    on_marker,
)
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.row_record import RowRecord
from skyherd.vision.search.decode import SAMPLES_PER_CELL, DecodedQuads

WHITE_PERCENTILE = 85
"""Percentile of the inner cells that is taken as white. Chosen: at least an eighth of a marker's bits are
white, and the brightest few may be glare."""

QUIET_SHARE, MIN_CONTRAST = 0.4, 1.0
"""A margin must lie at least this share of the way from black to white, and their least difference, grey
levels. Chosen: a little less than half, since blur darkens a narrow margin; above 0."""

MIN_VISIBLE, MIN_CUT_LIKENESS = 0.4, 0.85
"""Smallest share of a cut marker's cells in the image, and smallest likeness of these. Chosen: half of a
code's bits; high, since many squares are tried."""

BIT_SHARE = 0.3
"""Share of the step from the border to the margin that the contrast of inner cells must exceed, or all of
them are taken as black. Chosen: a white cell is as bright as the card apart from blur."""

FINE_SAMPLES = 5
"""Samples along each axis of a cell that is shown to users. Chosen: noise of a single pixel turns none."""

MIN_DIVISOR = 1e-9
"""Smallest deviation that is divided by."""


@dataclass(frozen=True)
class Reading:
    """A candidate read as a marker.

    Attributes:
        corners_px: (4, 2) corners, in the order of the marker.
        cell_px: (2,) shorter and longer extent of a cell, px: singular values of the map at the centre.
        contrast: grey levels from black to white, without blur.
        blur_cells: standard deviation of its blur, lens and pixel together, in cells.
        likeness: correlation with the marker under that blur, -1 to 1.
        nearest_id: id of the marker that it is most like.
        wrong_cells: row and column, from 1, of the cells that differ from that marker's, the border included.
        has_frame: whether it has the marker's black border, apart from a few cells.
        dark_edges: number of its edges without a white margin.
        visible: share of its cells that lie in the image.
    """

    corners_px: Array
    cell_px: Array
    contrast: float
    blur_cells: float
    likeness: float
    nearest_id: int
    wrong_cells: tuple[tuple[int, int], ...]
    has_frame: bool
    dark_edges: int
    visible: float

    @property
    def tilt_deg(self) -> float:
        """Angle of the line of sight to the marker's normal, degrees, for a distant camera."""
        return float(np.degrees(np.arccos(min(self.cell_px[0] / self.cell_px[1], 1.0))))

    @property
    def side_px(self) -> float:
        """Side of a square of the same area, px."""
        return float(sides_of_corners(self.corners_px[None])[0])


@dataclass(frozen=True)
class Cells(RowRecord):
    """Cells and margins of N squares.

    Attributes:
        levels: (N, n + 2, n + 2) grey levels; NaN off the image.
        blacks: (N,) median of the border.
        whites: (N,) level of bright inner cells.
    """

    levels: Array
    blacks: Array
    whites: Array

    @classmethod
    def read(cls, image: Image, corners_px: Array, dictionary: str, count: int = SAMPLES_PER_CELL) -> "Cells":
        """Return the cells at corners (N, 4, 2), px, by a number of samples along each axis of a cell.

        The squares may lie outside the image in part.
        """
        n, outer = cells_per_side(dictionary), is_border(dictionary)
        seen = are_in_image(image, corners_px, (np.arange(n + 2) - 0.5) / n)
        at = ((np.arange(count * (n + 2)) + 0.5) / count - 1) / n
        levels = np.where(seen, sample_squares(image, corners_px, at, count), np.nan)
        inner = levels[:, 1:-1, 1:-1]
        black, white = percentiles(inner[:, outer], 50), percentiles(inner[:, ~outer], WHITE_PERCENTILE)
        cells = cls(levels, black, white)
        has_bits = white - black > BIT_SHARE * (cells.surroundings - black)
        return replace(cells, whites=np.where(has_bits, white, np.fmax(white, cells.surroundings)))

    @property
    def inner(self) -> Array:
        """Grey levels (N, n, n) of the cells without the margin."""
        return self.levels[:, 1:-1, 1:-1]

    @property
    def visible(self) -> Array:
        """Shares (N,) of the cells that lie in the image."""
        return np.asarray(np.isfinite(self.inner).mean(axis=(1, 2)))

    @property
    def margins(self) -> Array:
        """Grey levels (N, 4, n) of the margin along each edge."""
        all_of_them = self.levels
        sides = all_of_them[:, 0], all_of_them[:, -1], all_of_them[:, :, 0], all_of_them[:, :, -1]
        return np.stack(sides, axis=1)[:, :, 1:-1]

    @property
    def surroundings(self) -> Array:
        """Medians (N,) of the margin, grey levels."""
        return percentiles(self.margins.reshape(-1, 4 * self.inner.shape[1]), 50)

    def dark_edges(self) -> IntArray:
        """Return at how many edges (N,) the margin is too dark."""
        beside = percentiles(self.margins.reshape(-1, self.inner.shape[1]), 50).reshape(-1, 4)
        steps = QUIET_SHARE * np.maximum(self.whites - self.blacks, MIN_CONTRAST)
        return np.asarray((beside < (self.blacks + steps)[:, None]).sum(axis=1))

    def wrong(self, codes: IntArray, dictionary: str) -> BoolArray:
        """Return which cells (N, n, n) in the image are not of the colour that codes (N,) give them."""
        is_white = self.inner > ((self.blacks + self.whites) / 2)[:, None, None]
        return np.asarray((is_white == (black_cells(dictionary)[codes] > 0)) & np.isfinite(self.inner))


def likeness_and_blurs(
    image: Image, corners_px: Array, codes: IntArray, dictionary: str
) -> tuple[Array, Array]:
    """Return correlations (N,) with codes (N,) at corners (N, 4, 2), px, and the most likely blurs, cells."""
    if not codes.size:
        return np.zeros(0), np.zeros(0)
    n, count = cells_per_side(dictionary), len(codes)
    readings = Readings.read(image, corners_px, n)
    seen = are_in_image(image, corners_px, (np.arange(n + 2) - 0.5) / n)
    seen = seen.repeat(PARTS, axis=1).repeat(PARTS, axis=2).reshape(count, -1)
    means = (seen * readings.levels).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    one = np.where(seen, readings.levels, means[:, None])  # off the image, it favours no blur
    blurs, clips, drawn = draw_codes(replace(readings, levels=one), codes[:, None], dictionary)
    seen &= on_marker(n)
    weights = seen / np.maximum(seen.sum(axis=1, keepdims=True), 1)
    one, other = (
        np.where(seen, row - (weights * row).sum(axis=1, keepdims=True), 0.0)
        for row in (one, exposed(drawn, clips[..., None])[:, 0])
    )
    scale = np.maximum(np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1), MIN_DIVISOR)
    return (one * other).sum(axis=1) / scale, np.sqrt(np.prod(BLURS_CELLS, axis=1))[blurs[:, 0]]


def read_cut_squares(image: Image, squares_px: Array, dictionary: str) -> DecodedQuads:
    """Return the squares (N, 4, 2), px, whose cells in the image are those of a marker, all of them.

    The margin must be white as far as it is in the image.
    """
    cells, n = Cells.read(image, squares_px, dictionary), cells_per_side(dictionary)
    middles = (cells.blacks + cells.surroundings) / 2
    framed = (cells.visible >= MIN_VISIBLE) & ~(cells.margins <= middles[:, None, None]).any(axis=(1, 2))
    framed &= np.isfinite(middles)
    colors = np.sign(np.nan_to_num(middles[framed, None] - cells.inner[framed].reshape(-1, n * n)))
    patterns = 2 * black_cells(dictionary).reshape(-1, n * n) - 1
    rows, codes = np.nonzero(colors @ patterns.T == np.abs(colors).sum(axis=1)[:, None])
    ids, turns = np.divmod(codes, 4)
    order = (turns[:, None] + np.arange(4)) % 4
    corners_px = np.take_along_axis(squares_px[framed][rows], order[..., None], axis=1)
    alike, _ = likeness_and_blurs(image, corners_px, 4 * ids, dictionary)
    return DecodedQuads(ids, corners_px, alike, np.ones(ids.size)).take(alike >= MIN_CUT_LIKENESS)


def are_in_image(image: Image, quads_px: Array, at: Array) -> BoolArray:
    """Return which places (N, K, K) of quadrilaterals lie in the image, at K places (sides) along each axis.

    0 is the corner where a marker begins, and 1 the next one.
    """
    height, width = image.shape
    grid = (at + 1j * at[:, None]).ravel() - (0.5 + 0.5j)
    places = LocalHomographies.of_quads(quads_px).images(grid).reshape(-1, at.size, at.size)
    inside = np.abs(places.real - (width - 1) / 2) < width / 2
    return np.asarray(inside & (np.abs(places.imag - (height - 1) / 2) < height / 2))


def is_border(dictionary: str) -> BoolArray:
    """Return which of the cells (n, n) are the markers' black border."""
    n, border = cells_per_side(dictionary), border_cells(dictionary)
    return np.pad(np.zeros((n - 2 * border, n - 2 * border), dtype=bool), border, constant_values=True)


def percentiles(values: Array, percent: float) -> Array:
    """Return a percentile of the finite values of each row of (N, K); NaN for a row without any."""
    ordered, count = np.sort(values, axis=1), np.isfinite(values).sum(axis=1)
    place = np.maximum(count - 1, 0) * percent / 100
    below, above = np.floor(place).astype(int), np.ceil(place).astype(int)
    low, high = (np.take_along_axis(ordered, k[:, None], axis=1)[:, 0] for k in (below, above))
    return np.asarray(low + (place - below) * (high - low))
