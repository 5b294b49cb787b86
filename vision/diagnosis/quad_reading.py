"""What a quadrilateral of an image holds, read as a marker: its cells, levels, blur, and the nearest id.

A quadrilateral is mapped to the marker's grid of n x n cells and sampled at several points of each cell.
Likeness is the correlation of the samples with the marker that they are most like, over ids, quarter turns,
mirroring and a blur of 0.1 to 1 cells: 1 for a perfect marker, whatever its contrast and blur. Since the
pattern is known, blur and contrast follow from the bits themselves and need no clean edge.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import border_cells, cells_per_side
from skyherd.vision.blurred_cells import MIN_DEVIATION
from skyherd.vision.diagnosis.templates import (
    FIRST_BLUR_CELLS,
    Templates,
    blurred_levels,
    load_templates,
)
from skyherd.vision.grey import Image, sample_squares
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.row_record import RowRecord

PER_CELL = 3
"""Samples of a cell along each axis on which likeness is measured. Chosen odd, so that one lies in the
middle."""

FINE = 3
"""Finer samples along each axis that are averaged into one of the above. Chosen: fewer are noisier where a
cell has many pixels."""

BLURS_CELLS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0)
"""Standard deviations of the blur, in cells, that are tried. Chosen: from sharp to beyond legible."""

FINALISTS = 8
"""Number of templates, the likest at the first blur, that are compared at all blurs. Chosen: more cost time
in proportion."""

PROMISING = 0.5
"""Likeness at the first blur below which nothing finer is measured. Chosen low: it saves time on what is
plainly no marker."""

GROWTHS_PX = (0.5, 1.0)
"""By how much a contour is moved outwards and read again, px. Derived: thresholds lose up to a pixel of an
edge."""

FRAME_SHARE = 0.75
"""Share of the border's cells that must be dark for a frame. Chosen: one side of four may be lost."""

MIN_CELLS = 4
"""Smallest number of cells in the image from which a correlation is computed."""

WHITE_PERCENTILE = 85
"""Percentile of the inner cells that is taken as white. Chosen: at least an eighth of a marker's bits are
white, and the brightest few may be glare."""

QUADS_AT_ONCE, FINALISTS_AT_ONCE = 2048, 64
"""Number of quadrilaterals whose middles are compared at once, and whose samples are under all blurs. Chosen:
bounds the memory."""

FIRST_MIDDLE = 128.0
"""Level between black and white if no inner cell is in the image: the middle of the 8-bit range."""


@dataclass(frozen=True)
class Reading:
    """A quadrilateral read as a marker.

    Attributes:
        corners_px: (4, 2) corners, in order around it.
        cell_px: (2,) shorter and longer extent of a cell, px: singular values of the map at the centre.
        black: grey level of its black, without blur.
        white: grey level of its white, without blur.
        depth: by how many grey levels the median of its surroundings is above the median of its border.
        framed: whether it is a dark frame with something bright in it.
        quiet: (4,) grey levels beside each edge, from edge 0-1 on; NaN off the image.
        likeness: correlation with the nearest marker, -1 to 1.
        nearest_id: id of the marker that it is most like.
        mirrored: whether it is most like that marker's mirror image.
        wrong_cells: row and column, from 1, of the cells that differ from that marker's, the border included.
        visible: share of its cells that lie in the image.
        blur_cells: standard deviation of its blur, lens and pixel together, in cells.
    """

    corners_px: Array
    cell_px: Array
    black: float
    white: float
    depth: float
    framed: bool
    quiet: Array
    likeness: float
    nearest_id: int
    mirrored: bool
    wrong_cells: tuple[tuple[int, int], ...]
    visible: float
    blur_cells: float

    @property
    def wrong_bits(self) -> int:
        """Return number of cells that differ from the nearest marker's, the border included."""
        return len(self.wrong_cells)

    @property
    def contrast(self) -> float:
        """Difference of white and black, grey levels."""
        return self.white - self.black

    @property
    def tilt_deg(self) -> float:
        """Return the angle of the line of sight to the marker's normal, degrees, for a distant camera."""
        return float(np.degrees(np.arccos(min(self.cell_px[0] / self.cell_px[1], 1.0))))

    @property
    def side_px(self) -> float:
        """Side of a square of the same area, px."""
        return float(np.sqrt(abs(_area(self.corners_px))))


def _area(corners_px: Array) -> float:
    """Signed area of a polygon (M, 2)."""
    u, v = corners_px.T
    return float((u * np.roll(v, -1) - np.roll(u, -1) * v).sum() / 2)


def read_quads(image: Image, quads_px: Array, dictionary: str) -> list[Reading]:
    """Return what quadrilaterals hold, each read as a marker.

    Args:
        image: grey, (height, width).
        quads_px: (N, 4, 2) corners, in order around each; they may lie outside the image.
        dictionary: whose markers they are compared with.

    Raises:
        InputError: there is no such dictionary.
    """
    sights = _look(image, quads_px, dictionary)
    return _readings(sights, _matches(image, sights, dictionary), dictionary)


def read_outlines(image: Image, quads_px: Array, dictionary: str) -> list[Reading]:
    """Return what contours (N, 4, 2) hold, each moved outwards by up to `GROWTHS_PX`, most like a marker."""
    sights = _look(image, quads_px, dictionary)
    matches = _matches(image, sights, dictionary)
    rows = np.flatnonzero(sights.likeness >= PROMISING)
    quads_px = quads_px[rows]
    middles_px = quads_px.mean(axis=1, keepdims=True)
    reach_px = np.linalg.norm(quads_px - middles_px, axis=2).mean(axis=1) / np.sqrt(2)
    for growth_px in GROWTHS_PX:
        growths = (1 + growth_px / reach_px)[:, None, None]
        grown = _look(image, middles_px + growths * (quads_px - middles_px), dictionary)
        better = _matches(image, grown, dictionary)
        is_better = better.likeness > matches.likeness[rows]
        sights = sights.put(rows[is_better], grown.take(is_better))
        matches = matches.put(rows[is_better], better.take(is_better))
    return _readings(sights, matches, dictionary)


def show_all_bits(image: Image, quads_px: Array, dictionary: str, min_visible: float) -> BoolArray:
    """Return which quadrilaterals show all bits of a marker or of its mirror image, in any turn.

    Cells off the image may be any, up to a share. This needs no reading of what is plainly no marker.

    Args:
        image: grey, (height, width).
        quads_px: (N, 4, 2) corners, in order around each; they may lie outside the image.
        dictionary: whose markers are considered.
        min_visible: smallest share of the cells in the image.

    Raises:
        InputError: there is no such dictionary.
    """
    n = cells_per_side(dictionary)
    signs = np.where(load_templates(dictionary).white, 1, -1).astype(np.float32).reshape(-1, n * n)
    shown, is_border = np.zeros(len(quads_px), dtype=bool), _is_border(dictionary).ravel()
    for first in range(0, len(quads_px), QUADS_AT_ONCE):
        part = slice(first, first + QUADS_AT_ONCE)
        cells = _sample(image, quads_px[part], n, np.arange(0.5, n))
        seen = np.isfinite(cells).reshape(len(cells), -1)
        is_white = (cells > _levels_of_border(cells, dictionary)[1][:, None, None]).reshape(len(cells), -1)
        framed = ~is_white[:, is_border].any(axis=1) & (seen.mean(axis=1) >= min_visible)
        rows = np.flatnonzero(framed)  # few of many have a border without fault
        bits = np.where(seen[rows], np.where(is_white[rows], 1, -1), 0).astype(np.float32)
        shown[first + rows] = (bits @ signs.T).max(axis=1) == seen[rows].sum(axis=1)
    return shown


def _sample(image: Image, quads_px: Array, n: int, at_cells: Array) -> Array:
    """Return levels (N, K, K) of quadrilaterals (N, 4, 2) at K places along both axes; NaN off the image.

    A level is the mean of a square as wide as a `PER_CELL` of a cell.

    Args:
        image: grey, (height, width).
        quads_px: (N, 4, 2) corners of n x n cells.
        n: cells along a side.
        at_cells: (K,) places, in cells from the first corner on.
    """
    height, width = image.shape
    around = ((np.arange(FINE) + 0.5) / FINE - 0.5) / PER_CELL
    fine, at = (at_cells[:, None] + around).ravel() / n, at_cells / n
    levels = sample_squares(image, quads_px, fine, FINE)
    grid = (at - 0.5) + 1j * (at[:, None] - 0.5)
    places = LocalHomographies.of_quads(quads_px).images(grid.ravel()).reshape(levels.shape)
    inside = abs(places.real - (width - 1) / 2) < width / 2
    inside &= abs(places.imag - (height - 1) / 2) < height / 2
    return np.where(inside, levels, np.nan)


def _percentiles(values: Array, percent: float) -> Array:
    """Return a percentile of the finite values of each row of (N, K); NaN for a row without any."""
    ordered, count = np.sort(values, axis=1), np.isfinite(values).sum(axis=1)
    place = np.maximum(count - 1, 0) * percent / 100
    below = np.floor(place).astype(int)
    above = np.minimum(below + 1, np.maximum(count - 1, 0))
    low, high = (np.take_along_axis(ordered, k[:, None], axis=1)[:, 0] for k in (below, above))
    return np.asarray(low + (place - below) * (high - low))


def _is_border(dictionary: str) -> BoolArray:
    """Return which of the cells (n, n) are the markers' black border."""
    n, border = cells_per_side(dictionary), border_cells(dictionary)
    is_border = np.ones((n, n), dtype=bool)
    is_border[border:-border, border:-border] = False
    return is_border


def _levels_of_border(cells: Array, dictionary: str) -> tuple[Array, Array]:
    """Return the levels (N,) of the borders of cells (N, n, n), and those between black and white.

    These lie half-way from the border to the brighter cells inside.
    """
    is_border = _is_border(dictionary)
    black = _percentiles(cells[:, is_border], 50)
    bright = _percentiles(cells[:, ~is_border], WHITE_PERCENTILE)
    return black, np.where(np.isfinite(bright), (black + bright) / 2, FIRST_MIDDLE)


@dataclass(frozen=True)
class _Sights(RowRecord):
    """N quadrilaterals at the first look.

    Attributes:
        corners_px: (N, 4, 2) their corners.
        levels: (N, n + 2, n + 2) of the middles of cells and quiet zone; not a number off the image.
        best: (N, F) rows of the `FINALISTS`, the templates that the cells' middles are most like, the likest
            last.
        likeness: (N,) with the likest of them; 0 if too little of it is in the image.
    """

    corners_px: Array
    levels: Array
    best: IntArray
    likeness: Array


@dataclass(frozen=True)
class _Matches(RowRecord):
    """The templates that N quadrilaterals are most like.

    Attributes:
        likeness: (N,) correlations with them.
        rows: (N,) of the templates in `Templates`.
        blurs_cells: (N,) standard deviations of the blur, in cells.
        blacks, whites: (N,) grey levels that fit them best.
    """

    likeness: Array
    rows: IntArray
    blurs_cells: Array
    blacks: Array
    whites: Array


def _look(image: Image, quads_px: Array, dictionary: str) -> _Sights:
    """Return the middles of the cells of quadrilaterals (N, 4, 2), compared with all templates."""
    n, templates = cells_per_side(dictionary), load_templates(dictionary)
    finalists = min(FINALISTS, len(templates.white))
    levels = np.empty((len(quads_px), n + 2, n + 2))
    best, likeness = np.zeros((len(quads_px), finalists), dtype=np.int64), np.zeros(len(quads_px))
    for first in range(0, len(quads_px), QUADS_AT_ONCE):
        part = slice(first, first + QUADS_AT_ONCE)
        levels[part] = _sample(image, quads_px[part], n, np.arange(-0.5, n + 1))
        cells = levels[part, 1:-1, 1:-1].reshape(-1, n * n)
        alike = _correlations(cells, templates.levels.reshape(-1, n * n))
        alike[np.isfinite(cells).sum(axis=1) < MIN_CELLS] = 0.0
        best[part] = _greatest(alike, finalists)
        likeness[part] = np.take_along_axis(alike, best[part, -1:], axis=1)[:, 0]
    return _Sights(quads_px, levels, best, likeness)


def _greatest(values: npt.NDArray[np.float32], count: int) -> IntArray:
    """Return the columns (N, count) of the greatest values of each row, the greatest last."""
    columns = np.argpartition(values, -count, axis=1)[:, -count:]
    order = np.argsort(np.take_along_axis(values, columns, axis=1), axis=1)
    return np.take_along_axis(columns, order, axis=1)


def _correlations(values: Array, patterns: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the correlations (N, M) of values (N, K), where they are finite, with patterns.

    Args:
        values: (N, K); what is not a number is left out.
        patterns: (M, K) for all rows, or (N, M, K) for each.
    """
    seen = np.isfinite(values)
    weights = (seen / np.maximum(seen.sum(axis=1, keepdims=True), 1)).astype(np.float32)
    known = np.where(seen, values, 0.0)
    mean = (weights * known).sum(axis=1, keepdims=True)
    centred = np.where(seen, known - mean, 0.0).astype(np.float32)
    deviations = np.sqrt((weights * centred**2).sum(axis=1, keepdims=True))

    def products(factors: npt.NDArray[np.float32], rows: npt.NDArray[np.float32]) -> Any:
        return factors @ rows.T if rows.ndim == 2 else (rows @ factors[:, :, None])[:, :, 0]

    covariances = products(weights * centred, patterns)
    if seen.all() and patterns.ndim == 2:
        pattern_deviations = patterns.std(axis=1)
    else:
        means = products(weights, patterns)
        pattern_deviations = np.sqrt(np.maximum(products(weights, patterns**2) - means**2, 0.0))
    divisors = np.maximum(deviations, MIN_DEVIATION) * np.maximum(pattern_deviations, MIN_DEVIATION)
    return np.asarray(covariances / divisors, dtype=np.float32)


def _matches(image: Image, sights: _Sights, dictionary: str) -> _Matches:
    """Return the likest templates; by all samples and blurs for what may be a marker."""
    n, templates = cells_per_side(dictionary), load_templates(dictionary)
    first, cells = sights.best[:, -1], sights.levels[:, 1:-1, 1:-1].reshape(-1, n * n)
    patterns = templates.levels.reshape(-1, n * n)[first]
    matches = _fitted(sights.likeness, first, np.full(len(first), FIRST_BLUR_CELLS), patterns, cells)
    promising = np.flatnonzero(sights.likeness >= PROMISING)
    for begin in range(0, promising.size, FINALISTS_AT_ONCE):
        rows = promising[begin : begin + FINALISTS_AT_ONCE]
        matches = matches.put(rows, _nearest(image, sights.take(rows), templates, n))
    return matches


def _nearest(image: Image, sights: _Sights, templates: Templates, n: int) -> _Matches:
    """Return the finalists that are most like what lies in the image, by all samples and blurs."""
    count, finalists = sights.best.shape
    samples = _sample(image, sights.corners_px, n, np.arange(0.5, n * PER_CELL) / PER_CELL)
    values = samples.reshape(count, -1)
    white = templates.white[sights.best.ravel()]
    patterns = np.stack([blurred_levels(white, blur, PER_CELL) for blur in BLURS_CELLS])
    patterns = patterns.reshape(len(BLURS_CELLS), count, finalists, -1).swapaxes(0, 1)
    patterns = patterns.reshape(count, len(BLURS_CELLS) * finalists, -1)
    alike = _correlations(values, patterns)
    top, every = alike.argmax(axis=1), np.arange(count)
    blurs, rows = np.array(BLURS_CELLS)[top // finalists], sights.best[every, top % finalists]
    return _fitted(alike[every, top].astype(float), rows, blurs, patterns[every, top], values)


def _fitted(
    likeness: Array, rows: IntArray, blurs_cells: Array, patterns: npt.NDArray[np.float32], values: Array
) -> _Matches:
    """Return black and white by least squares: values (N, K) = black + (white - black) patterns."""
    seen = np.isfinite(values)
    count = np.maximum(seen.sum(axis=1), 1)

    def moments(numbers: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation of the numbers of each row that are seen."""
        mean = np.where(seen, numbers, 0.0).sum(axis=1) / count
        squares = np.where(seen, (numbers - mean[:, None]) ** 2, 0.0).sum(axis=1) / count
        return mean, np.sqrt(squares)

    (mean, deviation), (darkness, spread) = moments(values), moments(patterns.astype(float))
    gains = likeness * deviation / np.maximum(spread, MIN_DEVIATION)
    blacks = mean - gains * darkness
    return _Matches(likeness, rows, blurs_cells, blacks, blacks + gains)


def _readings(sights: _Sights, matches: _Matches, dictionary: str) -> list[Reading]:
    """Return all that is measured of quadrilaterals that are most like some templates."""
    templates, levels, n = load_templates(dictionary), sights.levels, cells_per_side(dictionary)
    cells = levels[:, 1:-1, 1:-1]
    seen = np.isfinite(cells)
    border, middle = _levels_of_border(cells, dictionary)
    is_white = cells > middle[:, None, None]
    is_border = _is_border(dictionary)
    framed = seen.all(axis=(1, 2)) & ((~is_white[:, is_border]).mean(axis=1) >= FRAME_SHARE)
    sides = [levels[:, 0, 1:-1], levels[:, 1:-1, -1], levels[:, -1, 1:-1], levels[:, 1:-1, 0]]
    quiet = _percentiles(np.concatenate(sides), 50).reshape(4, -1).T
    depths = _percentiles(quiet, 50) - border
    maps = LocalHomographies.of_quads(sights.corners_px)
    larger, smaller = np.abs(maps.similarities), np.abs(maps.anisotropies)
    extents_px = np.stack([np.abs(larger - smaller), larger + smaller], axis=1) / n
    readings = []
    for row in range(len(levels)):
        nearest_id, mirrored = templates.row(int(matches.rows[row]))
        wrong_cells = templates.wrong_cells(int(matches.rows[row]), is_white[row], seen[row])
        readings.append(
            Reading(
                corners_px=sights.corners_px[row],
                cell_px=extents_px[row],
                black=float(matches.blacks[row]),
                white=float(matches.whites[row]),
                depth=float(depths[row]),
                framed=bool(framed[row]),
                quiet=quiet[row],
                likeness=float(matches.likeness[row]),
                nearest_id=nearest_id,
                mirrored=mirrored,
                wrong_cells=wrong_cells,
                visible=float(seen[row].mean()),
                blur_cells=float(matches.blurs_cells[row]),
            )
        )
    return readings
