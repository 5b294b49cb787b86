"""Readings of candidates, and markers drawn as they would be read.

A candidate's square, and the white zone of one cell around it, are read in `PARTS` x `PARTS` parts of each
cell. Large markers are read in a shrunk image, so that a part is the mean over its pixels. Markers are drawn
in the same parts under several blurs (`skyherd.markers.blur_model`).
"""

from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from math import isqrt
from statistics import NormalDist

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray
from skyherd.markers.blur_model import gather
from skyherd.markers.dictionary import all_marker_cells
from skyherd.vision.blurred_cells import standardised
from skyherd.vision.grey import Image, block_means, sample_squares
from skyherd.vision.native.library import library
from skyherd.vision.native.pattern_records import PARTS
from skyherd.vision.native.records import Floats
from skyherd.vision.row_record import RowRecord
from skyherd.vision.search.decode import blurred_codes

MAX_READINGS, PX2_PER_READING = 3.0, 4.0
"""Independent readings of a cell at most, and pixels for each. Chosen: errors of a model are alike over a
cell, so that more pixels do not add evidence in proportion."""

QUANTILES = (0.05, 0.95)
"""Between these quantiles of all readings lies their range. Chosen: without the tails of noise and glare."""

CARD_QUANTILES = (0.1, 0.9)
"""Between these quantiles of the readings on the card lies the range that a marker's contrast explains.
Chosen: a few bright or dark cells do not count."""

MIN_CONTRAST = 4.0
"""Smallest contrast of a marker, grey levels. Chosen: below it the rounding of grey levels shows as bits."""

BLURS_CELLS = (
    (0.1, 0.1),
    (0.22, 0.22),
    (0.36, 0.36),
    (0.52, 0.52),
    (0.72, 0.72),
    (0.15, 0.5),
    (0.5, 0.15),
    (0.3, 0.8),
    (0.8, 0.3),
)
"""Blurs (along the rows, along the columns) under which patterns are drawn, standard deviations in cells.
Chosen: geometric between a sharp edge and the largest blur that is accepted; then streaks of motion."""

CLIPPED_GAIN = 3.0
"""Contrast of an overexposed marker before white is clipped, over that after. Chosen: edges then move by one
standard deviation of the blur, as at 1.6 stops too much light."""

CLIPPED_SHARE, CLIPPED_RANGE = 0.15, 0.02
"""Candidates may be clipped of whose readings this share lies this near to the brightest, as a share of their
range. Chosen: far more than in an image with noise. It spares the drawing of clipped patterns."""

SATURATED, MIN_GLARE, MAX_GLARE_SHARE = 250.0, 10.0, 0.4
"""Grey level from which a reading is saturated, by how much the white zone must be darker, and the largest
share of the marker that is taken as glare. Chosen: cards in an image that is well exposed are that much
darker; of a marker under more glare too few bits are left, and what is saturated all over is salt."""

HALO_PARTS = 5
"""Width of the square, in parts, that a saturated part spoils around it. Chosen: two parts to each side, as
far as the rim of a spot of light brightens a black cell."""

CELL_BLURS = (0.2, 0.5)
"""Blurs under which whole cells are compared with all markers, before some markers are drawn in parts.
Chosen: a sharp one and a blurred one."""

MAX_CODES = 6
"""Codes of a candidate that are drawn. Chosen: others resemble the readings far less."""

MIN_PART_PX, SINGLE_SAMPLE_PX = 1.5, 0.9
"""Smallest part in a shrunk image, and largest part that is read by one sample instead of four, px. Chosen: a
part covers two to three pixels, which four samples average."""


@dataclass(frozen=True)
class Readings(RowRecord):
    """Readings of N candidates.

    Attributes:
        levels: (N, parts) grey levels of markers and white zones, row by row.
        weights: (N,) independent readings that a part counts as.
        scales: (N,) range of the readings, grey levels.
        ranges: (N,) range on the card that a marker's contrast should explain, grey levels.
        seen: (N, parts) 0 where glare saturates a part, so that it shows nothing of the marker, else 1.
    """

    levels: Array
    weights: Array
    scales: Array
    ranges: Array
    seen: Array

    @property
    def n_cells(self) -> int:
        """Cells along a marker's side, border included."""
        return isqrt(self.levels.shape[1]) // PARTS - 2

    @property
    def cells(self) -> Array:
        """Mean grey levels (N, n + 2, n + 2) of the cells, with those of the white zone around them."""
        side = self.n_cells + 2
        return np.asarray(self.levels.reshape(-1, side, PARTS, side, PARTS).mean(axis=(2, 4)))

    def may_be_clipped(self) -> npt.NDArray[np.bool_]:
        """Return which (N,) have as many readings near the brightest as an overexposed image has."""
        near = self.levels.max(axis=1) - CLIPPED_RANGE * self.scales
        return np.asarray((self.levels > near[:, None]).mean(axis=1) > CLIPPED_SHARE)

    def all_seen(self) -> "Readings":
        """Return the same readings without glare."""
        return replace(self, seen=np.ones_like(self.seen))

    @property
    def cells_seen(self) -> Array:
        """Share (N, n + 2, n + 2) of each cell that no glare saturates."""
        side = self.n_cells + 2
        return np.asarray(self.seen.reshape(-1, side, PARTS, side, PARTS).mean(axis=(2, 4)))

    @classmethod
    def read(cls, image: Image, corners_px: Array, n_cells: int) -> "Readings":
        """Return the readings of an image (height, width) at corners (N, 4, 2), px, clockwise as seen."""
        levels = _levels(image, corners_px, n_cells)
        seen = (~_under_glare(levels, n_cells)).astype(float)
        return cls(levels, _weights(corners_px, n_cells), *_ranges(levels, n_cells), seen)

    def unseen(self, spoilt: npt.NDArray[np.bool_]) -> "Readings":
        """Return these readings without spoilt parts (N, parts)."""
        return replace(self, seen=np.where(spoilt, 0.0, self.seen))

    def with_levels(self, levels: Array) -> "Readings":
        """Return these readings with other grey levels (N, parts)."""
        scales, ranges = _ranges(levels, self.n_cells)
        return replace(self, levels=levels, scales=scales, ranges=ranges)


def _ranges(levels: Array, n_cells: int) -> tuple[Array, Array]:
    """Return the ranges (N,) of all levels (N, parts), and of those on the card."""
    on_card = levels[:, on_marker(n_cells)]
    all_of_them, of_card = (
        np.maximum(np.ptp(np.quantile(values, ends, axis=1), axis=0), MIN_CONTRAST)
        for values, ends in ((levels, QUANTILES), (on_card, CARD_QUANTILES))
    )
    return all_of_them, of_card


def _under_glare(levels: Array, n_cells: int) -> npt.NDArray[np.bool_]:
    """Return which parts (N, parts) lie at saturated ones, on candidates whose white is not saturated."""
    saturated, card = levels >= SATURATED, on_marker(n_cells)
    white_is_below = np.median(levels[:, ~card], axis=1) < SATURATED - MIN_GLARE
    spoilt = np.zeros(levels.shape, dtype=bool)
    halo, side = np.ones((HALO_PARTS, HALO_PARTS), dtype=np.uint8), PARTS * (n_cells + 2)
    for row in np.flatnonzero(white_is_below & saturated.any(axis=1)):
        spot = saturated[row].reshape(side, side).astype(np.uint8)
        spoilt[row] = cv2.dilate(spot, halo).ravel() > 0
    return np.asarray(spoilt & (spoilt[:, card].mean(axis=1) < MAX_GLARE_SHARE)[:, None])


def part_places(n_cells: int, per_part: int = 1) -> Array:
    """Return `per_part` places in each part along an axis, in cells from the marker's edge."""
    parts = PARTS * per_part
    return (np.arange(parts * (n_cells + 2)) + 0.5) / parts - 1


@lru_cache(maxsize=16)
def on_marker(n_cells: int) -> npt.NDArray[np.bool_]:
    """Return which parts (parts,) are on the marker, not in the zone around it."""
    cells = np.pad(np.ones((n_cells, n_cells), dtype=bool), 1)
    return np.kron(cells, np.ones((PARTS, PARTS), dtype=bool)).ravel()


def nearest_codes(readings: Readings, dictionary: str) -> tuple[IntArray, Array]:
    """Return the codes whose cells resemble the readings most, and the correlation with the best of them.

    Code 4 i + k is marker i with corner k first.

    Returns:
        Codes (N, MAX_CODES), the likeliest first, and correlations (N,) of the first.
    """
    cells = readings.cells[:, 1:-1, 1:-1].reshape(len(readings.levels), -1)
    seen = standardised(cells.astype(np.float32))
    products = (library().code_products(seen, blurred_codes(dictionary, blur).columns) for blur in CELL_BLURS)
    match = reduce(np.maximum, products)
    few = np.argpartition(-match, MAX_CODES - 1, axis=1)[:, :MAX_CODES]
    order = np.argsort(-np.take_along_axis(match, few, axis=1), axis=1)
    return np.asarray(np.take_along_axis(few, order, axis=1)), match.max(axis=1) / seen.shape[1]


@lru_cache(maxsize=16)
def black_cells(dictionary: str) -> npt.NDArray[np.float32]:
    """Return the black cells (4 D, n, n) of all codes, 1 for black."""
    cells = all_marker_cells(dictionary)
    turned = np.stack([np.rot90(cells, -turn, axes=(1, 2)) for turn in range(4)], axis=1)
    return (~turned).reshape(-1, *cells.shape[1:]).astype(np.float32)


def exposed(white: Array, clips: npt.NDArray[np.bool_] | bool) -> Array:
    """Return whiteness as an image shows it; in an overexposed one white grows into the black beside it."""
    return np.where(clips, np.minimum(CLIPPED_GAIN * white, 1.0), white)


def cell_edges(bits: int, n_cells: int, blur_cells: float, *, clips: bool) -> Array:
    """Return the edges (bits + 1,) of as many cells along an axis of a square whose side seems to be n_cells.

    Clipping moves the place where a blurred edge has half of the contrast, so that the square seems smaller.
    """
    moved = NormalDist().inv_cdf(1 - 0.5 / CLIPPED_GAIN) * blur_cells if clips else 0.0
    return np.linspace(-moved, n_cells + moved, bits + 1)


@lru_cache(maxsize=512)
def cell_shares(bits: int, n_cells: int, blur_cells: float, *, clips: bool) -> Array:
    """Return the share (side, bits) of each cell of `cell_edges` in each part along an axis, under a blur."""
    return gather(part_places(n_cells), cell_edges(bits, n_cells, blur_cells, clips=clips), blur_cells)


def draw_codes(
    readings: Readings, codes: IntArray, dictionary: str
) -> tuple[IntArray, npt.NDArray[np.bool_], Array]:
    """Draw codes under the blur with which they resemble the readings most, overexposed or not.

    Args:
        readings: of N candidates.
        codes: (N, K) of each.
        dictionary: of the markers.

    Returns:
        The numbers (N, K) of the blurs in `BLURS_CELLS`, whether the image clips (N, K), and the whiteness
        (N, K, parts), 0 to 1, before it does.
    """
    blurs, alike, drawn = _drawn_most_alike(readings, codes, dictionary, clips=False)
    clips = np.zeros(codes.shape, dtype=bool)
    bright = np.flatnonzero(readings.may_be_clipped())
    if bright.size:
        own, likeness, shown = _drawn_most_alike(readings.take(bright), codes[bright], dictionary, clips=True)
        clips[bright] = likeness > alike[bright]
        blurs[bright] = np.where(clips[bright], own, blurs[bright])
        drawn[bright] = np.where(clips[bright, :, None], shown, drawn[bright])
    return blurs, clips, drawn


def nearest_patterns(readings: Readings, dictionary: str, count: int) -> Array:
    """Return the whiteness (N, count, parts) that the codes would show that resemble the readings most."""
    codes = nearest_codes(readings, dictionary)[0][:, :count]
    _, clips, drawn = draw_codes(readings, codes, dictionary)
    return exposed(drawn, clips[..., None])


def _drawn_most_alike(
    readings: Readings, codes: IntArray, dictionary: str, *, clips: bool
) -> tuple[IntArray, Array, Array]:
    """Return the blurs (N, K) most alike, their correlations with the readings, and unclipped whiteness."""
    seen = standardised(readings.levels.astype(np.float32))
    correlations = (_clipped_correlations if clips else _correlations)(seen, codes, dictionary)
    blurs = correlations.argmax(axis=-1)
    along, down = _gathers(readings.n_cells, clips)
    darkness = down[blurs] @ black_cells(dictionary)[codes] @ along[blurs].swapaxes(-1, -2)
    drawn = (1 - darkness.astype(float)).reshape(*codes.shape, -1)
    return blurs, np.asarray(correlations.max(axis=-1)), drawn


def _correlations(seen: Floats, codes: IntArray, dictionary: str) -> Array:
    """Return the correlations (N, K, blurs) of standardised readings (N, parts) with codes under each blur.

    The darkness of black cells B is `D B Aᵀ`. Its inner product with readings S is that of B with `Dᵀ S A`,
    the readings gathered by cells, so that no code is drawn.
    """
    black = black_cells(dictionary)
    n_cells, side = black.shape[1], isqrt(seen.shape[1])
    along, down = _gathers(n_cells, clips=False)
    gathered = down.swapaxes(1, 2) @ (seen.reshape(-1, 1, side, side) @ along)
    cells = n_cells**2
    products = black[codes].reshape(*codes.shape, cells) @ gathered.reshape(len(seen), -1, cells).swapaxes(
        1, 2
    )
    return np.asarray(-products / _deviations(dictionary)[codes])


@lru_cache(maxsize=16)
def _deviations(dictionary: str) -> Array:
    """Return the root sums of squares (4 D, blurs) of all codes' darkness about its mean under each blur.

    The sum of squares of `D B Aᵀ` is the inner product of B with `DᵀD B AᵀA`.
    """
    black = black_cells(dictionary).astype(float)
    roots = []
    for along, down in zip(
        *(part.astype(float) for part in _gathers(black.shape[1], clips=False)), strict=True
    ):
        squares = ((down.T @ down) @ black @ (along.T @ along) * black).sum(axis=(1, 2))
        sums = down.sum(axis=0) @ black @ along.sum(axis=0)
        roots.append(np.sqrt(squares - sums**2 / (len(down) * len(along))))
    return np.stack(roots, axis=1)


def _clipped_correlations(seen: Floats, codes: IntArray, dictionary: str) -> Array:
    """Return the correlations (N, K, blurs) as `_correlations`, with codes that the image clips."""
    black = black_cells(dictionary)[codes][:, :, None]
    along, down = _gathers(black.shape[-1], clips=True)
    shown = exposed(1 - down @ black @ along.swapaxes(1, 2), clips=True).reshape(*codes.shape, len(down), -1)
    centred = shown - shown.mean(axis=-1, keepdims=True)
    products = (centred @ seen[:, None, :, None])[..., 0]
    return np.asarray(products / np.linalg.norm(centred, axis=-1))


@lru_cache(maxsize=16)
def _gathers(n_cells: int, clips: bool) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return weights (blurs, side, n) of a row's cells at its parts, along the rows and along the columns."""
    along, down = (
        np.stack([cell_shares(n_cells, n_cells, blur[axis], clips=clips) for blur in BLURS_CELLS]).astype(
            np.float32
        )
        for axis in (0, 1)
    )
    return along, down


def _weights(corners_px: Array, n_cells: int) -> Array:
    """Return the independent readings (N,) that a part counts as."""
    one, two = corners_px[:, 2] - corners_px[:, 0], corners_px[:, 3] - corners_px[:, 1]
    cell_px2 = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2 / n_cells**2
    return np.asarray(np.minimum(MAX_READINGS, cell_px2 / PX2_PER_READING) / PARTS**2)


def _levels(image: Image, corners_px: Array, n_cells: int) -> Array:
    """Return the grey levels (N, parts) of all parts of markers and white zones."""
    sides_px = np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=1), axis=2).mean(axis=1)
    parts_px = sides_px / (n_cells * PARTS)
    octaves = np.maximum(np.floor(np.log2(np.maximum(parts_px / MIN_PART_PX, 1.0))), 0).astype(int)
    side = PARTS * (n_cells + 2)
    levels = np.empty((len(corners_px), side**2))
    for octave in np.unique(octaves):
        rows, shrink = np.flatnonzero(octaves == octave), 2 ** int(octave)
        small = image if shrink == 1 else block_means(image, shrink)
        corners = (corners_px[rows] - (shrink - 1) / 2) / shrink
        fine = 2 if parts_px[rows].max() / shrink > SINGLE_SAMPLE_PX else 1
        at = part_places(n_cells, fine) / n_cells
        levels[rows] = sample_squares(small, corners, at, fine).reshape(len(rows), -1)
    return levels
