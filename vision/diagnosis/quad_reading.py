"""What a quadrilateral of an image holds, read as a marker: its cells, levels, blur, and the nearest id.

A quadrilateral is mapped to the marker's grid of n x n cells and sampled at several points of each cell.
Likeness is the correlation of the samples with the marker that they are most like, over ids, quarter turns,
mirroring and a blur of 0.1 to 1 cells: 1 for a perfect marker, whatever its contrast and blur. Since the
pattern is known, blur and contrast follow from the bits themselves and need no clean edge.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import border_cells, cells_per_side
from skyherd.vision.blurred_cells import MIN_DEVIATION, correlations, standardised
from skyherd.vision.diagnosis.cell_samples import (
    PER_CELL,
    cell_extents_px,
    image_from_cells,
    sample_cells,
    sample_middles,
)
from skyherd.vision.diagnosis.templates import (
    FIRST_BLUR_CELLS,
    Templates,
    blurred_levels,
    load_templates,
)
from skyherd.vision.grey import Image

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

QUADS_AT_ONCE = 4096
"""Number of quadrilaterals that are sampled at once. Chosen: bounds the memory."""

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


def read_quad(image: Image, corners_px: Array, dictionary: str) -> Reading:
    """Return what a quadrilateral holds, read as a marker.

    Args:
        image: grey, (height, width).
        corners_px: (4, 2) corners, in order around it; they may lie outside the image.
        dictionary: whose markers it is compared with.

    Raises:
        InputError: there is no such dictionary.
    """
    return _read_sight(_look(image, corners_px, dictionary))


def read_grown(image: Image, corners_px: Array, dictionary: str) -> Reading:
    """Return what a contour (4, 2) holds, moved outwards by up to `GROWTHS_PX`, most like a marker."""
    sight = _look(image, corners_px, dictionary)
    if sight.likeness < PROMISING:
        return _read_sight(sight)
    center = corners_px.mean(axis=0)
    reach = float(np.linalg.norm(corners_px - center, axis=1).mean()) / np.sqrt(2)
    grown = [center + (1 + growth / reach) * (corners_px - center) for growth in GROWTHS_PX]
    sights = [sight, *(_look(image, corners, dictionary) for corners in grown)]
    matches = [_nearest(sight) for sight in sights]
    best = max(range(len(sights)), key=lambda k: matches[k].likeness)
    return _read(sights[best], matches[best])


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
    n, border = cells_per_side(dictionary), border_cells(dictionary)
    white = load_templates(dictionary).white.reshape(-1, n * n)
    signs = np.where(white, 1, -1).astype(np.float32)
    is_inner = np.zeros((n, n), dtype=bool)
    is_inner[border:-border, border:-border] = True
    shown = np.zeros(len(quads_px), dtype=bool)
    for first in range(0, len(quads_px), QUADS_AT_ONCE):
        part = slice(first, first + QUADS_AT_ONCE)
        levels, seen = sample_middles(image, quads_px[part], n)
        levels = np.where(seen, levels, np.nan)
        black = _percentiles(levels[:, ~is_inner.ravel()], 50)
        bright = _percentiles(levels[:, is_inner.ravel()], WHITE_PERCENTILE)
        middle = np.where(np.isfinite(bright), (black + bright) / 2, FIRST_MIDDLE)
        bits = np.where(seen, np.where(levels > middle[:, None], 1, -1), 0).astype(np.float32)
        right = (bits @ signs.T).max(axis=1) == seen.sum(axis=1)
        shown[part] = right & (seen.mean(axis=1) >= min_visible)
    return shown


def _percentiles(values: Array, percent: float) -> Array:
    """Return a percentile of the finite values of each row of (N, K); not a number if there is none."""
    ordered, count = np.sort(values, axis=1), np.isfinite(values).sum(axis=1)
    place = np.maximum(count - 1, 0) * percent / 100
    below = np.floor(place).astype(int)
    above = np.minimum(below + 1, np.maximum(count - 1, 0))
    low, high = (np.take_along_axis(ordered, k[:, None], axis=1)[:, 0] for k in (below, above))
    return np.asarray(low + (place - below) * (high - low))


@dataclass(frozen=True)
class _Sight:
    """A quadrilateral at the first look.

    Attributes:
        corners_px: (4, 2) its corners.
        image_cells: (3, 3) homography from cell coordinates to pixels.
        samples: levels (S, S) of cells and quiet zone, as of `sample_cells`.
        templates: what it is compared with.
        border: width of the markers' black border, in cells.
        best: rows of the `FINALISTS`, the templates that its cells' middles are most like, ascending.
        likeness: with the likest of them; 0 if too little of it is in the image.
    """

    corners_px: Array
    image_cells: Array
    samples: Array
    templates: Templates
    border: int
    best: IntArray
    likeness: float

    @property
    def levels(self) -> Array:
        """Return levels (n + 2, n + 2) of the middles of cells and quiet zone."""
        return self.samples[PER_CELL // 2 :: PER_CELL, PER_CELL // 2 :: PER_CELL]


def _read_sight(sight: _Sight) -> Reading:
    """Return what a quadrilateral holds; by all samples and blurs if it may be a marker."""
    return _read(sight, _first_match(sight) if sight.likeness < PROMISING else _nearest(sight))


def _look(image: Image, corners_px: Array, dictionary: str) -> _Sight:
    """Sample a quadrilateral and compare its cells' middles with all templates."""
    n, border = cells_per_side(dictionary), border_cells(dictionary)
    image_cells = image_from_cells(corners_px, n)
    samples = sample_cells(image, image_cells, n)
    templates = load_templates(dictionary)
    cells = samples[PER_CELL // 2 :: PER_CELL, PER_CELL // 2 :: PER_CELL][1:-1, 1:-1]
    seen = np.isfinite(cells)
    if seen.sum() < MIN_CELLS:
        nothing = np.zeros(1, dtype=np.int64)
        return _Sight(corners_px, image_cells, samples, templates, border, nothing, 0.0)
    values = cells[seen]
    if seen.all():
        likeness = (standardised(values[None]) @ templates.standard.T / values.size)[0]
    else:
        likeness = correlations(templates.levels[:, seen], values[None])[0]
    best = np.argsort(likeness)[-FINALISTS:]
    return _Sight(corners_px, image_cells, samples, templates, border, best, float(likeness[best[-1]]))


def _read(sight: _Sight, match: "Match") -> Reading:
    """Return all that is measured of a quadrilateral that is most like a template."""
    levels, templates = sight.levels, sight.templates
    ring = levels[1:-1, 1:-1]
    is_border = np.ones(ring.shape, dtype=bool)
    is_border[sight.border : -sight.border, sight.border : -sight.border] = False
    border, inner = ring[is_border], ring[~is_border]
    quiet = np.array([_median(edge[1:-1]) for edge in (levels[0], levels[:, -1], levels[-1], levels[:, 0])])
    nearest_id, mirrored = templates.row(match.row)
    seen = np.isfinite(ring)
    middle = _middle(border, inner)
    return Reading(
        corners_px=sight.corners_px,
        cell_px=cell_extents_px(sight.image_cells, len(ring)),
        black=match.black,
        white=match.white,
        depth=_median(quiet) - _median(border),
        framed=bool((border[np.isfinite(border)] < middle).mean() >= FRAME_SHARE) if seen.all() else False,
        quiet=quiet,
        likeness=match.likeness,
        nearest_id=nearest_id,
        mirrored=mirrored,
        wrong_cells=templates.wrong_cells(match.row, ring > middle, seen),
        visible=float(seen.mean()),
        blur_cells=match.blur_cells,
    )


def _middle(border: Array, inner: Array) -> float:
    """Return level between black and white: half-way from the border to the brighter cells inside."""
    bright = float(_percentiles(inner[None], WHITE_PERCENTILE)[0])
    return (_median(border) + bright) / 2 if np.isfinite(bright) else FIRST_MIDDLE


def _median(values: Array) -> float:
    """Return the median of the finite values; not a number if no value is finite."""
    finite = np.sort(values[np.isfinite(values)])  # np.median takes several times as long for so few
    if not finite.size:
        return float("nan")
    return float(finite[(finite.size - 1) // 2] + finite[finite.size // 2]) / 2


@dataclass(frozen=True)
class Match:
    """The template that cells are most like.

    Attributes:
        likeness: correlation with it.
        row: of the template in `Templates`.
        blur_cells: standard deviation of the blur, in cells.
        black, white: grey levels that fit it best.
    """

    likeness: float
    row: int
    blur_cells: float
    black: float
    white: float


def _first_match(sight: _Sight) -> Match:
    """Return the template that is most like the cells' middles under the first blur."""
    cells, row = sight.levels[1:-1, 1:-1], int(sight.best[-1])
    seen = np.isfinite(cells)
    if seen.sum() < MIN_CELLS:
        return Match(likeness=0.0, row=0, blur_cells=FIRST_BLUR_CELLS, black=0.0, white=0.0)
    return _fit(sight.likeness, row, FIRST_BLUR_CELLS, sight.templates.levels[row][seen], cells[seen])


def _nearest(sight: _Sight) -> Match:
    """Return the finalist that is most like what lies in the image, by all samples and blurs."""
    samples, best = sight.samples[PER_CELL:-PER_CELL, PER_CELL:-PER_CELL], sight.best
    seen = np.isfinite(samples)
    patterns = _under_all_blurs(sight.templates.white[best])[:, seen]
    likeness = correlations(patterns, samples[seen][None])[0]
    top = int(likeness.argmax())
    blur, row = BLURS_CELLS[top // len(best)], int(best[top % len(best)])
    return _fit(float(likeness[top]), row, blur, patterns[top], samples[seen])


def _under_all_blurs(white: BoolArray) -> npt.NDArray[np.float32]:
    """Return levels (B M, S, S) of markers (M, n, n) under each of B blurs, blur by blur."""
    return np.concatenate([blurred_levels(white, blur, PER_CELL) for blur in BLURS_CELLS])


def _fit(likeness: float, row: int, blur: float, pattern: npt.NDArray[np.float32], values: Array) -> Match:
    """Return black and white by least squares: values = black + (white - black) pattern."""
    gain = likeness * float(values.std()) / max(float(pattern.std()), MIN_DEVIATION)
    black = float(values.mean()) - gain * float(pattern.mean())
    return Match(likeness=likeness, row=row, blur_cells=blur, black=black, white=black + gain)
