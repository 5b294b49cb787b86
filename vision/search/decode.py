"""Decoding of quadrilaterals: correlation of their cells with every marker in all four rotations.

Cells are sampled as grey levels, not as bits, and correlated with the blurred cells of each marker. Small,
blurred or noisy markers, down to two pixels a cell, thus still correlate best with their own pattern. No
candidate is rejected for a wrong bit: the fit decides with all pixels.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from skyherd.geometry import Array, IntArray, to_complex
from skyherd.markers.dictionary import all_marker_cells, cells_per_side
from skyherd.vision.blurred_cells import MIN_DEVIATION, blurred_darkness, standardised
from skyherd.vision.grey import Image, sample_squares
from skyherd.vision.native.library import library
from skyherd.vision.native.records import Floats
from skyherd.vision.native.search_library import CodeColumns, CodeTable, DecodeConstants
from skyherd.vision.row_record import RowRecord

SAMPLES_PER_CELL = 2
"""Samples of a cell along each axis. Chosen: one is noisier, three take twice the time."""

MIN_CORRELATION = 0.6
"""Smallest correlation of a quadrilateral's cells with a marker. Chosen: low, because a false candidate only
costs a fit."""

BLURRED_CELLS, BLURRED_CORRELATION = 0.55, 0.9
"""Blur of a second set of patterns, in cells, and the smallest correlation with them. The limit is higher
because blur makes patterns similar.

Measured on markers of 12 px at noise 5 and a blur of 1.45 px (0.72 cells): 43 % of the quadrilaterals decode
correctly at an assumed blur of 0.6 px, and 96 % at 1.2 px. A limit of 0.8 instead of 0.9 detects 1 % more of
them. It also accepts 20 % more dark squares with light squares inside as marker 17 of 4X4_50."""

BLUR_STEP = 1.2
"""Ratio of consecutive pattern blurs, which form a geometric progression. Chosen: the correlation depends
little on the blur, and a smaller ratio needs more memory."""

MIN_CELL_DEVIATION = 1.5
"""Smallest standard deviation of a quadrilateral's cells, grey levels. Chosen: uniform ground and noise have
less."""

ROUNDING = 1e-4
"""Error of a correlation in single precision, at most. Derived: 400 products of 6e-8 of themselves."""

MIN_WHITE = 1.0
"""Smallest white level in the divisor of contrasts, grey levels. Chosen: markers are printed on white."""

CONSTANTS = DecodeConstants(MIN_DEVIATION, MIN_WHITE)
"""Limits for the compiled library."""


@dataclass(frozen=True)
class DecodedQuads(RowRecord):
    """Decoded quadrilaterals.

    Attributes:
        ids: (N,) the marker with the greatest correlation.
        corners_px: (N, 4, 2) corners in the order of that marker.
        correlations: (N,) of the quadrilateral's cells with those of the marker, -1 to 1.
        print_contrasts: (N,) `(white - black) / white` of the marker's levels, by linear regression of the
            cells on the pattern under the assumed blur.
    """

    ids: IntArray
    corners_px: Array
    correlations: Array
    print_contrasts: Array


def no_decoded_quads() -> DecodedQuads:
    """Return a record with N = 0."""
    return DecodedQuads(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)), np.zeros(0), np.zeros(0))


def decode_quads(
    image: Image,
    quads_px: Array,
    dictionary: str,
    sigma_px: float,
    min_correlation: float = MIN_CORRELATION,
) -> DecodedQuads:
    """Return the quadrilaterals that correlate with a marker, each with its best marker.

    Several quadrilaterals may decode as the same marker. The result has a row for each of them.

    Args:
        image: grey, (height, width).
        quads_px: (N, 4, 2) corners, clockwise in the image, beginning with any corner.
        dictionary: name of the marker dictionary.
        sigma_px: standard deviation of the combined blur of lens and pixel.
        min_correlation: smallest correlation of a quadrilateral's cells with its marker.
    """
    if not len(quads_px):
        return no_decoded_quads()
    corners, n_cells = to_complex(quads_px), cells_per_side(dictionary)
    cells_px = np.abs(np.roll(corners, 1, axis=1) - corners).mean(axis=1) / n_cells
    buckets, tables = np.unique(_buckets(sigma_px / cells_px), return_inverse=True)
    numbers = buckets.tolist()
    found = library().decoded(
        read_cells(image, quads_px, n_cells),
        tables.astype(np.int32),
        [*(_codes(dictionary, number) for number in numbers), blurred_codes(dictionary, BLURRED_CELLS)],
        [*(_least_likeness(dictionary, number) for number in numbers), BLURRED_CORRELATION],
        CONSTANTS,
    )
    is_alike = (found["likeness"] >= min_correlation) & (found["deviation"] >= MIN_CELL_DEVIATION)
    found = found[is_alike]
    marker, turn = np.divmod(found["code"], 4)
    order = (turn[:, None] + np.arange(4)) % 4
    turned_px = np.take_along_axis(quads_px[is_alike], order[..., None], axis=1)
    return DecodedQuads(marker, turned_px, found["likeness"], found["print_contrast"])


@lru_cache(maxsize=128)
def _least_likeness(dictionary: str, bucket: int) -> float:
    """Return the least likeness under a tabulated blur of what has `BLURRED_CORRELATION` with a blurred code.

    Correlations are cosines of angles between standardised rows, which obey the triangle inequality. The
    angle from a row to a code is at most that to the blurred code and that between both codes.
    """
    usual, blurred = _codes(dictionary, bucket).columns, blurred_codes(dictionary, BLURRED_CELLS).columns
    alike = (usual.columns * blurred.columns)[:, : usual.count].sum(axis=0, dtype=float).min()
    cosine = min(alike / len(usual.columns), 1.0)
    return math.cos(math.acos(BLURRED_CORRELATION) + math.acos(cosine)) - ROUNDING


def blurred_codes(dictionary: str, blur_cells: float) -> CodeTable:
    """Return the codes of a dictionary under the tabulated blur nearest to `blur_cells`.

    Code 4 i + k is marker i with corner k first.
    """
    return _codes(dictionary, int(_buckets(np.array(blur_cells))))


def _buckets(blurs_cells: Array) -> IntArray:
    """Return the numbers (N,) of the tabulated blurs nearest to blurs (N,), in cells."""
    return np.rint(np.log(blurs_cells) / math.log(BLUR_STEP)).astype(int)


@lru_cache(maxsize=40)
def _codes(dictionary: str, bucket: int) -> CodeTable:
    """Return the codes of a dictionary under a blur of `BLUR_STEP ** bucket` cells.

    The cache holds all blurs of one dictionary, of which photographs have up to 38. A table takes 1 MB for a
    thousand markers of 6 x 6 bits, and 10 MB for `7X7_8000`.
    """
    cells = all_marker_cells(dictionary)
    darkness = blurred_darkness(cells, BLUR_STEP**bucket, samples_per_cell=1, samples=SAMPLES_PER_CELL)
    rows = darkness.reshape(len(cells), -1)
    patterns = standardised(-rows.astype(np.float32)).reshape(darkness.shape)
    codes = np.stack([np.rot90(patterns, -turn, axes=(1, 2)) for turn in range(4)], axis=1)
    columns = CodeColumns.of(codes.reshape(4 * len(cells), -1))
    return CodeTable(columns, np.repeat(rows.mean(axis=1), 4), np.repeat(rows.std(axis=1), 4))


def read_cells(image: Image, quads_px: Array, n_cells: int) -> Floats:
    """Return the grey levels (N, n²) of the cells in quadrilaterals (N, 4, 2), row-major from corner 0."""
    samples = SAMPLES_PER_CELL
    at = (np.arange(samples * n_cells) + 0.5) / (samples * n_cells)
    return sample_squares(image, quads_px, at, samples).reshape(len(quads_px), n_cells**2)
