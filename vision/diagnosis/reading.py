"""What a candidate shows, read as one marker: levels, blur, margin, wrong cells, and how alike it is.

Quadrilaterals are named as the detector decodes them, as they are and mirrored. They are read and drawn as
for their likelihood (`skyherd.vision.photometric.evidence.readings`): the blur is the one under which the
marker resembles the readings most, and black and white are fitted to them. Likeness is the correlation of
readings and drawn marker, 1 for a perfect one, whatever its contrast and blur.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import all_marker_cells, border_cells, cells_per_side, sides_of_corners
from skyherd.vision.blurred_cells import MIN_DEVIATION
from skyherd.vision.grey import Image, sample_squares
from skyherd.vision.native.pattern_records import PARTS
from skyherd.vision.photometric.evidence.pattern_fit import fit_patterns
from skyherd.vision.photometric.evidence.readings import (
    BLURS_CELLS,
    Readings,
    draw_codes,
    exposed,
    on_marker,
    part_places,
)
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.refine import START_SIGMA_PX
from skyherd.vision.row_record import RowRecord
from skyherd.vision.search.decode import DecodedQuads, decode_quads
from skyherd.vision.search.edges import fit_edges

FRAME_SHARE = 0.75
"""Share of the border's cells in the image that must be dark for a frame. Chosen: one side of four may be
lost."""

WHITE_PERCENTILE = 85
"""Percentile of the inner cells that is taken as white. Chosen: at least an eighth of a marker's bits are
white, and the brightest few may be glare."""

MAX_MOVED_SIDES = 0.25
"""Largest move of a centre by a fit, in sides. Chosen: beyond it the fit has found something else."""

FIRST_MIDDLE = 128.0
"""Level between black and white if no inner cell is in the image: the middle of the 8-bit range."""


@dataclass(frozen=True)
class Named(RowRecord):
    """N quadrilaterals, each with the marker that it resembles most.

    Attributes:
        decoded: ids, and corners in the order of the marker; anticlockwise of mirrored ones.
        mirrored: (N,) whether it resembles that marker's mirror image.
    """

    decoded: DecodedQuads
    mirrored: BoolArray


@dataclass(frozen=True)
class Reading:
    """A candidate read as a marker.

    Attributes:
        corners_px: (4, 2) corners, in the order of the marker.
        cell_px: (2,) shorter and longer extent of a cell, px: singular values of the map at the centre.
        black: grey level of its black, without blur.
        white: grey level of its white, without blur.
        depth: by how many grey levels the median of its surroundings is above the median of its border.
        framed: whether it is a dark frame with something bright in it.
        quiet: (4,) grey levels beside each edge, from edge 0-1 on; NaN off the image.
        likeness: correlation with the marker, -1 to 1.
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
        return float(sides_of_corners(self.corners_px[None])[0])


def name_quads(image: Image, quads_px: Array, dictionary: str) -> Named:
    """Return the quadrilaterals that resemble a marker, and those that resemble the mirror image of one.

    Args:
        image: grey, (height, width).
        quads_px: (N, 4, 2) corners, clockwise in the image, beginning with any corner.
        dictionary: whose markers they are compared with.
    """
    own, turned = (
        decode_quads(image, np.ascontiguousarray(quads), dictionary, START_SIGMA_PX)
        for quads in (quads_px, quads_px[:, ::-1])
    )
    return Named(own.joined(turned), np.repeat([False, True], [own.ids.size, turned.ids.size]))


def read_markers(image: Image, named: Named, fitted_px: Array, dictionary: str) -> list[Reading]:
    """Return what quadrilaterals show of the markers that they are named after.

    Each is read at its corners, at those of a fit, and at those of its edges, of which the likeliest count.

    Args:
        image: grey, (height, width).
        named: the quadrilaterals; they may lie outside the image in part.
        fitted_px: (N, 4, 2) corners by fits, px. They do not count where they are at another place.
        dictionary: of the markers.
    """
    ids, corners_px = named.decoded.ids, named.decoded.corners_px
    if not ids.size:
        return []
    order = np.where(named.mirrored[:, None], np.arange(4)[::-1], np.arange(4))[..., None]
    clockwise_px = np.take_along_axis(corners_px, order, axis=1)
    edges_px = fit_edges(image, clockwise_px, cells_per_side(dictionary)).corners_px
    sights = _look(image, corners_px, ids, dictionary)
    for others_px in (fitted_px, np.take_along_axis(edges_px, order, axis=1)):
        others = _look(image, others_px, ids, dictionary)
        moved_px = np.linalg.norm((others_px - corners_px).mean(axis=1), axis=1)
        there = moved_px < MAX_MOVED_SIDES * sides_of_corners(corners_px)
        better = np.flatnonzero(there & (others.likeness > sights.likeness))
        sights = sights.put(better, others.take(better))
    return _readings(sights, named, dictionary)


def depths(image: Image, quads_px: Array, dictionary: str) -> Array:
    """Return by how many grey levels (N,) the margins of quadrilaterals (N, 4, 2) exceed their borders."""
    n = cells_per_side(dictionary)
    levels = sample_squares(image, quads_px, cell_middles(n) + 0.5)
    around = _edge_cells(levels.astype(float)).reshape(len(levels), 4 * n)
    return np.asarray(
        np.median(around, axis=1) - np.median(levels[:, 1:-1, 1:-1][:, is_border(dictionary)], axis=1)
    )


def cell_middles(n: int) -> Array:
    """Return the middles (n + 2,) of a row of cells with a margin, in sides from the centre."""
    return np.asarray((np.arange(n + 2) - 0.5) / n - 0.5)


def in_image(image: Image, quads_px: Array, at: Array) -> BoolArray:
    """Return which places (N, K, K) of quadrilaterals lie in the image, at K places along either axis.

    Places are in sides from the centre.
    """
    height, width = image.shape
    grid = at + 1j * at[:, None]
    places = LocalHomographies.of_quads(quads_px).images(grid.ravel()).reshape(-1, at.size, at.size)
    inside = np.abs(places.real - (width - 1) / 2) < width / 2
    return np.asarray(inside & (np.abs(places.imag - (height - 1) / 2) < height / 2))


def is_border(dictionary: str) -> BoolArray:
    """Return which of the cells (n, n) are the markers' black border."""
    n, border = cells_per_side(dictionary), border_cells(dictionary)
    outer = np.ones((n, n), dtype=bool)
    outer[border:-border, border:-border] = False
    return outer


@dataclass(frozen=True)
class _Sights(RowRecord):
    """N quadrilaterals, compared with one marker each.

    Attributes:
        corners_px: (N, 4, 2) their corners.
        levels: (N, n + 2, n + 2) of the middles of cells and margin; not a number off the image.
        likeness: (N,) correlations with the marker.
        blurs_cells: (N,) standard deviations of the blur, in cells.
        blacks, whites: (N,) grey levels that fit best.
    """

    corners_px: Array
    levels: Array
    likeness: Array
    blurs_cells: Array
    blacks: Array
    whites: Array


def _look(image: Image, corners_px: Array, ids: IntArray, dictionary: str) -> _Sights:
    """Return quadrilaterals (N, 4, 2), with corners in the order of the markers (N,), compared with these."""
    n = cells_per_side(dictionary)
    seen = in_image(image, corners_px, cell_middles(n))
    parts = in_image(image, corners_px, part_places(n) / n - 0.5).reshape(len(seen), -1)
    parts_seen = (parts & on_marker(n)).astype(float)
    readings = Readings.read(image, corners_px, n)
    # What is not in the image shall not favour a blur.
    means = (parts * readings.levels).sum(axis=1) / np.maximum(parts.sum(axis=1), 1)
    readings = replace(readings, levels=np.where(parts, readings.levels, means[:, None]), seen=parts_seen)
    blurs, clips, drawn = draw_codes(readings, 4 * ids[:, None], dictionary)
    white = exposed(drawn, clips[..., None])
    levels = fit_patterns(readings, white).levels[:, 0]
    middles = readings.levels.reshape(-1, n + 2, PARTS, n + 2, PARTS)[:, :, PARTS // 2, :, PARTS // 2]
    return _Sights(
        corners_px,
        np.where(seen, middles, np.nan),
        _correlations(readings.levels, white[:, 0], parts_seen),
        np.sqrt(np.prod(BLURS_CELLS, axis=1))[blurs[:, 0]],
        levels[:, 0],
        levels[:, 0] + levels[:, 1],
    )


def _correlations(one: Array, other: Array, weights: Array) -> Array:
    """Return the correlations (N,) of rows (N, K) where weights (N, K) are 1; 0 without any."""
    totals = np.maximum(weights.sum(axis=1), 1.0)[:, None]
    one, other = (
        np.asarray(row - (weights * row).sum(axis=1, keepdims=True) / totals) for row in (one, other)
    )
    products, *squares = (
        (weights * pair).sum(axis=1) / totals[:, 0] for pair in (one * other, one**2, other**2)
    )
    deviations = (np.maximum(np.sqrt(square), MIN_DEVIATION) for square in squares)
    return np.asarray(products / np.prod(list(deviations), axis=0))


def _edge_cells(levels: Array) -> Array:
    """Return the margin's cells (N, 4, n) along each edge of levels (N, n + 2, n + 2), from edge 0-1 on."""
    sides = levels[:, 0, 1:-1], levels[:, 1:-1, -1], levels[:, -1, 1:-1], levels[:, 1:-1, 0]
    return np.stack(sides, axis=1)


def percentiles(values: Array, percent: float) -> Array:
    """Return a percentile of the finite values of each row of (N, K); NaN for a row without any."""
    ordered, count = np.sort(values, axis=1), np.isfinite(values).sum(axis=1)
    place = np.maximum(count - 1, 0) * percent / 100
    below = np.floor(place).astype(int)
    above = np.minimum(below + 1, np.maximum(count - 1, 0))
    low, high = (np.take_along_axis(ordered, k[:, None], axis=1)[:, 0] for k in (below, above))
    return np.asarray(low + (place - below) * (high - low))


def _readings(sights: _Sights, named: Named, dictionary: str) -> list[Reading]:
    """Return all that is measured of quadrilaterals and the markers that they are named after."""
    cells, outer = sights.levels[:, 1:-1, 1:-1], is_border(dictionary)
    seen, ids = np.isfinite(cells), named.decoded.ids
    blacks, bright = percentiles(cells[:, outer], 50), percentiles(cells[:, ~outer], WHITE_PERCENTILE)
    middles = np.where(np.isfinite(bright), (blacks + bright) / 2, FIRST_MIDDLE)
    is_white = cells > middles[:, None, None]
    wrong = (is_white != all_marker_cells(dictionary)[ids]) & seen
    dark, in_view = (~is_white & seen)[:, outer].sum(axis=1), seen[:, outer].sum(axis=1)
    framed = (in_view > 0) & (dark >= FRAME_SHARE * in_view)
    beside = _edge_cells(sights.levels)
    quiet = percentiles(beside.reshape(-1, beside.shape[2]), 50).reshape(-1, 4)
    maps = LocalHomographies.of_quads(sights.corners_px)
    larger, smaller = np.abs(maps.similarities), np.abs(maps.anisotropies)
    extents_px = np.stack([np.abs(larger - smaller), larger + smaller], axis=1) / cells.shape[1]
    return [
        Reading(
            corners_px=sights.corners_px[row],
            cell_px=extents_px[row],
            black=float(sights.blacks[row]),
            white=float(sights.whites[row]),
            depth=float(depth),
            framed=bool(framed[row]),
            quiet=quiet[row],
            likeness=float(sights.likeness[row]),
            nearest_id=int(ids[row]),
            mirrored=bool(named.mirrored[row]),
            wrong_cells=tuple((int(down) + 1, int(along) + 1) for down, along in np.argwhere(wrong[row])),
            visible=float(seen[row].mean()),
            blur_cells=float(sights.blurs_cells[row]),
        )
        for row, depth in enumerate(percentiles(quiet, 50) - blacks)
    ]
