"""Which marker a quadrilateral shows, by how well its cells agree with every marker in every turn.

A cell is read as grey, not as a bit, and compared with what blur leaves of each marker's cells: the readings
of a small, blurred or noisy marker still resemble their own pattern more than any other. Nothing is refused
for a wrong bit here; that is left to the fit, which sees pixels.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, ComplexArray, IntArray, to_complex
from skyherd.markers.blur_model import gather
from skyherd.markers.dictionary import cells_per_side, dictionary_size, marker_cells
from skyherd.vision.row_record import RowRecord

READINGS = 2
"""Readings of a cell along each of its sides."""

MIN_CORRELATION = 0.6
"""Least correlation of a candidate's cells with a marker's."""

BLUR_STEP = 1.2
"""Cells are compared at blurs, relative to a cell, in this geometric progression."""

MIN_SPREAD = 3.0
"""Least standard deviation of the cells, grey levels."""


@dataclass(frozen=True)
class DecodedQuads(RowRecord):
    """Quadrilaterals that look like markers.

    Attributes:
        ids: (N,) the marker each resembles most.
        corners_px: (N, 4, 2) in that marker's own order.
        correlations: (N,) correlation of its cells with the marker's.
    """

    ids: IntArray
    corners_px: Array
    correlations: Array


def decode_quads(
    image: npt.NDArray[np.uint8], quads_px: Array, dictionary: str, sigma_px: float
) -> DecodedQuads:
    """Markers that quadrilaterals (N, 4, 2), clockwise as seen, resemble under a blur of `sigma_px`."""
    if not len(quads_px):
        return DecodedQuads(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)), np.zeros(0))
    corners = to_complex(quads_px)
    n_cells = cells_per_side(dictionary)
    cells = _read_cells(image, corners, n_cells)
    spread = cells.std(axis=1)
    best, likeness = np.empty(len(corners), dtype=np.int64), np.empty(len(corners))
    cells_px = np.abs(np.roll(corners, 1, axis=1) - corners).mean(axis=1) / n_cells
    buckets = np.rint(np.log(sigma_px / cells_px) / np.log(BLUR_STEP)).astype(int)
    for bucket in np.unique(buckets):
        rows = np.flatnonzero(buckets == bucket)
        scores = _standardised(cells[rows]) @ _codes(dictionary, int(bucket)).T / cells.shape[1]
        best[rows], likeness[rows] = scores.argmax(axis=1), scores.max(axis=1)
    marker, turn = np.divmod(best, 4)
    order = (turn[:, None] + np.arange(4)) % 4
    found = DecodedQuads(marker, np.take_along_axis(quads_px, order[..., None], axis=1), likeness)
    return found.take((likeness >= MIN_CORRELATION) & (spread >= MIN_SPREAD))


@lru_cache(maxsize=32)
def _codes(dictionary: str, bucket: int) -> npt.NDArray[np.float32]:
    """(4 x markers, cells), standardised: row 4 i + k is marker i under blur, seen with corner k first."""
    cells = np.stack([marker_cells(dictionary, i) for i in range(dictionary_size(dictionary))])
    n_cells = cells.shape[1]
    at = (np.arange(READINGS * n_cells) + 0.5) / READINGS
    spread = gather(at, np.arange(n_cells + 1.0), BLUR_STEP**bucket)
    spread = spread.reshape(n_cells, READINGS, n_cells).mean(axis=1)
    black = spread @ (~cells).astype(float) @ spread.T
    codes = np.stack([np.rot90(black, -turn, axes=(1, 2)) for turn in range(4)], axis=1)
    return _standardised(-codes.reshape(4 * len(cells), -1).astype(np.float32))


def _standardised(cells: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """RowRecord of mean 0 and deviation 1."""
    centred = cells - cells.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(centred.std(axis=1, keepdims=True), 1e-6))


def _read_cells(image: npt.NDArray[np.uint8], corners: ComplexArray, n_cells: int) -> npt.NDArray[np.float32]:
    """Grey of each cell (N, n²) in quadrilaterals with corners (N, 4), row by row from the first corner."""
    at = (np.arange(READINGS * n_cells) + 0.5) / (READINGS * n_cells)
    points = _square_to_quads(corners, at[None, :], at[:, None]).reshape(len(corners), -1)
    u, v = points.real.astype(np.float32), points.imag.astype(np.float32)
    grey = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    cells = grey.reshape(-1, n_cells, READINGS, n_cells, READINGS).mean(axis=(2, 4), dtype=np.float32)
    return np.asarray(cells.reshape(len(corners), -1))


def _square_to_quads(corners: ComplexArray, x: Array, y: Array) -> ComplexArray:
    """Images (N, ...) of points of the unit square under the homographies that take its corners to (N, 4)."""
    first, second, third, fourth = (corner[:, None, None] for corner in corners.T)
    a, b, c = second - third, fourth - third, first - second + third - fourth

    def cross(p: ComplexArray, q: ComplexArray) -> Array:
        return np.asarray((p.conj() * q).imag)

    area = cross(a, b)
    g, h = cross(c, b) / area, cross(a, c) / area
    top = first + x * (second - first + g * second) + y * (fourth - first + h * fourth)
    return np.asarray(top / (1 + g * x + h * y))
