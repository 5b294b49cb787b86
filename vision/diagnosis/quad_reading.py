"""What a quadrilateral of an image holds, read as a marker: its cells, levels, blur, and the nearest id.

A quadrilateral is mapped to the marker's grid of n x n cells, sampled at several places a cell. Likeness is
the correlation of the samples with the marker they are most like, over ids, quarter turns, mirroring and a
blur of 0.1 to 1 cells: 1 for a perfect marker, whatever its contrast and blur. Since the pattern is known,
the blur follows from the bits themselves and needs no clean edge.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray
from skyherd.markers.blur_model import gather
from skyherd.markers.dictionary import cells_per_side, dictionary_size, marker_cells

Image = npt.NDArray[np.uint8]

PER_CELL = 3
"""Samples a cell and axis that likeness is measured on."""

FINE = 3
"""Finer samples a cell and axis that are averaged into one of them, where there are enough pixels."""

BLURS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0)
"""Standard deviations, in cells, that are tried."""

FIRST_BLUR = 0.3
FINALISTS = 8
"""So many of the templates that are most like at the first blur are compared at all."""

PROMISING = 0.5
"""Likeness at the first blur below which nothing finer is measured."""

FRAME_SHARE = 0.75
"""Share of the border's cells that must be dark for a frame."""


@dataclass(frozen=True)
class Templates:
    """Markers of a dictionary, turned and mirrored: rows `(mirrored, turn, id)`.

    `white` (8 N, n, n); `levels` (8 N, n, n) under `FIRST_BLUR`, on a white card.
    """

    white: BoolArray
    levels: npt.NDArray[np.float32]
    count: int

    def row(self, index: int) -> tuple[int, bool]:
        """Id, and whether mirrored, of a row."""
        return index % self.count, index >= 4 * self.count


def _blurred(white: BoolArray, blur: float, per_cell: int) -> npt.NDArray[np.float32]:
    """Levels (M, S, S), S = n per_cell, of markers (M, n, n) on white under a blur in cells."""
    spread = _spread(white.shape[1], blur, per_cell)
    padded = np.pad(white.astype(float), ((0, 0), (1, 1), (1, 1)), constant_values=1.0)
    return np.asarray(spread @ padded @ spread.T, dtype=np.float32)


@lru_cache(maxsize=64)
def _spread(n: int, blur: float, per_cell: int) -> Array:
    """(S, n + 2) how the Gaussian gathers a row of cells; the card around them has no end."""
    x = (np.arange(n * per_cell) + 0.5) / per_cell
    return gather(x, np.concatenate([[-9.0], np.arange(n + 1), [n + 9.0]]), blur)


@lru_cache(maxsize=4)
def load_templates(dictionary: str) -> Templates:
    """The dictionary's templates."""
    count = dictionary_size(dictionary)
    cells = np.stack([marker_cells(dictionary, k) for k in range(count)])
    sides = (cells, cells[:, :, ::-1])
    white = np.concatenate([np.rot90(side, turn, (1, 2)) for side in sides for turn in range(4)])
    return Templates(white, _blurred(white, FIRST_BLUR, 1), count)


@dataclass(frozen=True)
class Reading:
    """A quadrilateral read as a marker.

    Attributes:
        corners_px: (4, 2), in order around it.
        cell_px: (2,) shorter and longer extent of a cell, px: singular values of the map at the centre.
        black: level of its black, and
        white: of its white, as they are without blur.
        depth: by how many grey levels the median of what is around it is above the median of its border.
        framed: whether it is a dark frame with something bright in it.
        quiet: (4,) level beside each edge, from edge 0-1 on; not a number off the image.
        likeness: correlation with the nearest marker.
        nearest_id: the marker it is most like.
        mirrored: it is most like that marker's mirror image.
        wrong_bits: cells that are not as in that marker, the border included.
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
    wrong_bits: int
    visible: float
    blur_cells: float

    @property
    def contrast(self) -> float:
        """White minus black, grey levels."""
        return self.white - self.black

    @property
    def tilt_deg(self) -> float:
        """Angle between the line of sight and the marker's normal, as a camera far away sees it."""
        return float(np.degrees(np.arccos(min(self.cell_px[0] / self.cell_px[1], 1.0))))

    @property
    def side_px(self) -> float:
        """Root of the area."""
        return float(np.sqrt(abs(_area(self.corners_px))))


def _area(corners_px: Array) -> float:
    """Signed area of a polygon (M, 2)."""
    u, v = corners_px.T
    return float((u * np.roll(v, -1) - np.roll(u, -1) * v).sum() / 2)


def image_from_cells(corners_px: Array, n: int) -> Array:
    """Homography (3, 3) from cell coordinates, 0 to n to the right and down, to pixels."""
    square = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32)
    return np.asarray(cv2.getPerspectiveTransform(square, corners_px.astype(np.float32)), dtype=float)


def read_quad(image: Image, corners_px: Array, dictionary: str, *, promising: float = PROMISING) -> Reading:
    """Read a quadrilateral (4, 2); one less than `promising` at the first look is not looked at finely."""
    n = cells_per_side(dictionary)
    image_cells = image_from_cells(corners_px, n)
    samples = _sample(image, image_cells, n)
    levels = _cell_levels(samples)
    ring, inner = levels[1:-1, 1:-1], levels[2:-2, 2:-2]
    border = np.concatenate([ring[0], ring[-1], ring[1:-1, 0], ring[1:-1, -1]])
    quiet = np.array([_median(edge[1:-1]) for edge in (levels[0], levels[:, -1], levels[-1], levels[:, 0])])
    templates = load_templates(dictionary)
    match = _nearest(ring, samples[PER_CELL:-PER_CELL, PER_CELL:-PER_CELL], templates, promising)
    nearest_id, mirrored = templates.row(match.row)
    seen = np.isfinite(ring)
    middle = _middle(border, inner)
    return Reading(
        corners_px=corners_px,
        cell_px=_cell_px(image_cells, n),
        black=match.black,
        white=match.white,
        depth=_median(quiet) - _median(border),
        framed=bool((border[np.isfinite(border)] < middle).mean() >= FRAME_SHARE) if seen.all() else False,
        quiet=quiet,
        likeness=match.likeness,
        nearest_id=nearest_id,
        mirrored=mirrored,
        wrong_bits=int(((ring > middle) != templates.white[match.row])[seen].sum()),
        visible=float(seen.mean()),
        blur_cells=match.blur_cells,
    )


def _middle(border: Array, inner: Array) -> float:
    """Level between black and white: half-way from the border to the brighter cells inside."""
    bright = inner[np.isfinite(inner)]
    return (_median(border) + float(np.percentile(bright, 85))) / 2 if bright.size else 128.0


def _median(values: Array) -> float:
    """Median of the finite values; not a number if there is none."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _cell_px(image_cells: Array, n: int) -> Array:
    """Shorter and longer extent of a cell at the centre, px."""
    w = image_cells @ [n / 2, n / 2, 1.0]
    jacobian = (image_cells[:2, :2] - np.outer(w[:2] / w[2], image_cells[2, :2])) / w[2]
    return np.asarray(np.linalg.svd(jacobian, compute_uv=False)[::-1])


def _sample(image: Image, image_cells: Array, n: int) -> Array:
    """Levels (S, S), S = (n + 2) PER_CELL, of cells and quiet zone; not a number off the image."""
    size = (n + 2) * PER_CELL
    fine = PER_CELL * FINE
    first = 0.5 / fine - 1
    to_cells = np.array([[1 / fine, 0, first], [0, 1 / fine, first], [0, 0, 1]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(
        image,
        image_cells @ to_cells,
        (size * FINE, size * FINE),
        flags=flags,
        borderMode=cv2.BORDER_REPLICATE,
    )
    samples = np.asarray(warped, dtype=float).reshape(size, FINE, size, FINE).mean(axis=(1, 3))
    at = (np.arange(size) + 0.5) / PER_CELL - 1
    points = np.stack(np.meshgrid(at, at), axis=-1) @ image_cells[:, :2].T + image_cells[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):  # a quadrilateral may have its horizon inside
        u, v = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    inside = (u > -0.5) & (v > -0.5) & (u < image.shape[1] - 0.5) & (v < image.shape[0] - 0.5)
    return np.where(inside, samples, np.nan)


def _cell_levels(samples: Array) -> Array:
    """Levels of the cells' middles, of which PER_CELL samples a side there are."""
    middle = PER_CELL // 2
    return samples[middle::PER_CELL, middle::PER_CELL]


@dataclass(frozen=True)
class Match:
    """The most like template: its row, likeness and blur, and the levels that fit it best."""

    likeness: float
    row: int
    blur_cells: float
    black: float
    white: float


def _nearest(cells: Array, samples: Array, templates: Templates, promising: float) -> Match:
    """The template most like what lies in the image.

    All are compared by the cells' middles, the best of them then by all samples and blurs.
    """
    seen = np.isfinite(cells)
    if seen.sum() < 4:
        return Match(0.0, 0, FIRST_BLUR, 0.0, 0.0)
    likeness = _correlate(templates.levels[:, seen], cells[seen])
    best = np.argsort(likeness)[-FINALISTS:]
    match = _fit(
        float(likeness[best[-1]]), int(best[-1]), FIRST_BLUR, templates.levels[best[-1]][seen], cells[seen]
    )
    if match.likeness < promising:
        return match
    seen = np.isfinite(samples)
    for blur in BLURS:
        patterns = _blurred(templates.white[best], blur, PER_CELL)[:, seen]
        likeness = _correlate(patterns, samples[seen])
        row = int(likeness.argmax())
        if likeness[row] > match.likeness or blur == BLURS[0]:
            match = _fit(float(likeness[row]), int(best[row]), blur, patterns[row], samples[seen])
    return match


def _fit(likeness: float, row: int, blur: float, pattern: npt.NDArray[np.float32], values: Array) -> Match:
    """Black and white by least squares: values = black + (white - black) pattern."""
    gain = likeness * float(values.std()) / max(float(pattern.std()), 1e-9)
    black = float(values.mean()) - gain * float(pattern.mean())
    return Match(likeness, row, blur, black, black + gain)


def _correlate(patterns: npt.NDArray[np.float32], values: Array) -> Array:
    """Correlation (M,) of each row of patterns (M, K) with values (K,)."""
    offsets = values - values.mean()
    deviations = patterns - patterns.mean(axis=1, keepdims=True)
    size = np.linalg.norm(deviations, axis=1) * np.linalg.norm(offsets)
    return np.asarray(deviations @ offsets / np.maximum(size, 1e-9), dtype=float)
