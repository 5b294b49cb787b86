"""Residuals of pixels from the model, and their sums over markers' cells and over boxes of pixels."""

from typing import Any

import numpy as np
from numba import float32, float64, int32, int64, njit, void

from skyherd.jobs.compilation import FLAGS, INLINE, readonly
from skyherd.vision.photometric.fitting.design_matrix import BLACK, PIXEL_ROW, UNKNOWNS

_ZERO = np.float32(0)
_BOUNDS = readonly(int64, 1)
_COLUMNS, _PLACES, _SOLUTIONS = readonly(float32, 2), readonly(float32, 2), readonly(float32, 2)


@njit(**INLINE)
def _residual(columns: Any, row: int, solutions: Any, number: int) -> Any:
    """Return a pixel less the model at it, in single precision, times the pixel's weight."""
    residual = columns[row, PIXEL_ROW]
    for unknown in range(UNKNOWNS):
        residual -= solutions[number, unknown] * columns[row, unknown]
    return residual


@njit(float32[::1](_COLUMNS, _BOUNDS, _SOLUTIONS), **FLAGS)
def residuals(columns: Any, bounds: Any, solutions: Any) -> Any:
    """Return the weighted residuals (P,), grey levels, of the model at `solutions` (N, 15)."""
    left = np.empty(len(columns), dtype=np.float32)
    for number in range(len(solutions)):
        for row in range(bounds[number], bounds[number + 1]):
            left[row] = _residual(columns, row, solutions, number)
    return left


@njit(
    void(*(_COLUMNS, _PLACES, _BOUNDS, _SOLUTIONS), *(float64[:, :, ::1],) * 3, float64[::1]),
    **FLAGS,
)
def add_over_cells(
    columns: Any, places: Any, bounds: Any, solutions: Any, sums: Any, used: Any, read: Any, peaks: Any
) -> None:
    """Add to sums, which are zero at first, what the model at `solutions` leaves of the pixels, grey levels.

    Args:
        columns: (P, 16) of `fill`.
        places: (P, 2) of `fill`.
        bounds: (N + 1,) of `fill`.
        solutions: (N, 15) of the model.
        sums: (N, n, n) result: the residuals over each cell.
        used: (N, n, n) result: the pixels of each cell that have a weight.
        read: (N, n, n) result: all pixels of each cell.
        peaks: (N,) result: the largest absolute residual of a pixel.
    """
    n = sums.shape[1]
    half, cells_per_side = np.float32(n / 2), np.float32(n)
    for number in range(peaks.size):
        for row in range(bounds[number], bounds[number + 1]):
            left = _residual(columns, row, solutions, number)
            peaks[number] = max(peaks[number], abs(left))
            across, down = places[row, 0] * cells_per_side + half, places[row, 1] * cells_per_side + half
            if min(across, down) >= 0 and max(across, down) < n:
                r, c = int(down), int(across)
                sums[number, r, c] += left
                used[number, r, c] += columns[row, BLACK] > 0
                read[number, r, c] += 1


@njit(
    void(
        *(
            _COLUMNS,
            readonly(int32, 2),
            _BOUNDS,
            readonly(int64, 1),
            _SOLUTIONS,
            readonly(float32, 3),
            int64,
        ),
        *(float64[:, ::1], float64[:, ::1], int64[::1]),
    ),
    **FLAGS,
)
def add_over_boxes(
    columns: Any,
    pixels: Any,
    bounds: Any,
    picked: Any,
    solutions: Any,
    influences: Any,
    box_px: int,
    small: Any,
    large: Any,
    boxes: Any,
) -> None:
    """Add up influences times residuals over boxes of pixels, for some of the markers.

    Boxes are those of lines and columns divided by `box_px`, counted from the first that a marker has. All
    results are zero at first.

    Args:
        columns: (P, 16) of `fill`.
        pixels: (P, 2) of `fill`.
        bounds: (N + 1,) of `fill`.
        picked: (K,) which of the N markers.
        solutions: (N, 15) of the model.
        influences: (N, Q, 15) by how much each of Q quantities changes with what the model's columns do.
        box_px: side of the small boxes; large ones are two by two of them.
        small: (K, Q) result: sums over all small boxes of the square of what influence times residual adds up
            to in a box.
        large: (K, Q) result: the same over large boxes.
        boxes: (K,) result: number of large boxes that have pixels.
    """
    quantities = influences.shape[1]
    for place in range(picked.size):
        number = picked[place]
        begin, end = bounds[number], bounds[number + 1]
        top, left = np.int64(2**31), np.int64(2**31)
        bottom = right = np.int64(0)
        for row in range(begin, end):
            if columns[row, BLACK] > 0:
                v, u = pixels[row, 0] // box_px, pixels[row, 1] // box_px
                top, bottom, left, right = min(top, v), max(bottom, v), min(left, u), max(right, u)
        if top > bottom:
            continue
        sums = np.zeros(((bottom - top) // 2 + 1, (right - left) // 2 + 1, 5, quantities))
        for row in range(begin, end):
            if columns[row, BLACK] > 0:
                v, u = pixels[row, 0] // box_px - top, pixels[row, 1] // box_px - left
                sums[v // 2, u // 2, 4, 0] = 1
                residual = _residual(columns, row, solutions, number)
                for quantity in range(quantities):
                    influence = _ZERO
                    for unknown in range(UNKNOWNS):
                        influence += influences[number, quantity, unknown] * columns[row, unknown]
                    sums[v // 2, u // 2, v % 2 * 2 + u % 2, quantity] += influence * residual
        for v in range(len(sums)):
            for u in range(sums.shape[1]):
                boxes[place] += sums[v, u, 4, 0] > 0
                for quantity in range(quantities):
                    whole = 0.0
                    for quarter in range(4):
                        one = sums[v, u, quarter, quantity]
                        small[place, quantity] += one * one
                        whole += one
                    large[place, quantity] += whole * whole
