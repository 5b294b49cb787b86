"""Compiled loops over the pixels of markers: the columns of the linear model, their products, and residuals.

The formulas are those of `design_matrix`. In marker coordinates z = x + iy, in
sides, with black as 0 and white as 1, a marker on an endless white ground seen under a Gaussian of standard
deviation σ separates (`skyherd.markers.blur_model`):

    T(y, x) = 1 - Σ_r Σ_c E_r(y) B_rc E_c(x),   E_c(x) = Φ((x - e_c) / σ) - Φ((x - e_{c+1}) / σ),

with B_rc = 1 where the cell is black and e the cells' edges. Summed by edges instead of cells, a row of cells
is `Σ_c B_c E_c(x) = B_f + Σ_e (B_e - B_{e-1}) Φ((x - e) / σ)`, in which only edges within `REACH_SIGMAS` of x
count: those further left are passed, up to the cell f, and those further right are not reached. Most pixels
have an edge or two in reach.

Numba compiles these functions when this module is imported for the first time, and keeps the machine code in
`__pycache__` beside it, in the user's cache where that folder cannot be written to, or where
`NUMBA_CACHE_DIR` says. Importing takes half a second, so that the module is imported where pixels are first
read. Code that is kept is compiled again when this file changes, and not when only the constants change that
are imported here from another one.

Every function takes one marker after another and adds up in a fixed order, on the thread that calls it, so
that the same pixels give the same bytes. They hold no lock of Python's.
"""

import math
from typing import Any

import numpy as np
from numba import float32, float64, from_dtype, int32, int64, njit, uint8, void
from numba.core import types
from scipy.special import ndtr

from skyherd.vision.photometric.fitting.design_matrix import (
    BLACK,
    BLUR,
    CONTRAST,
    DOWN,
    GROUND,
    GROW,
    LEAN,
    LIGHT,
    MIDDLE_GREY,
    PIXEL_ROW,
    RIGHT,
    SQUEEZE,
    TONE,
    TURN,
    UNKNOWNS,
)

REACH_SIGMAS = 5
"""Edges of cells further from a pixel than this many standard deviations of the blur count as passed or as
not reached. Chosen: Φ is within 3e-7 of its limits there, and its second derivative within 8e-6."""

NODES_PER_SIGMA = 64
"""Tabulated values of Φ and φ to one standard deviation. Derived: the series about the nearest node leaves
`(1/128)³ / 6` of the third derivative: 3e-8 of Φ and 1e-7 of φ, the rounding of single precision."""

MIN_AXIS_PER_PX = 1e-12
"""Smallest slope along a line, in marker sides per pixel, that is divided by; an axis that is exactly at
right angles to a line would divide by zero. Chosen far below 1 / image width, so that the bounds it gives lie
outside any image."""

MIDDLE_NODE = REACH_SIGMAS * NODES_PER_SIGMA + 2
"""Index of Φ(0) and φ(0) in their tables. Derived, with two entries beyond the reach on either side: places
in reach are rounded, by 1/200 of a standard deviation in the sharpest blur (`design_matrix.SIGMA_LIMITS`)."""

_NODES = (np.arange(2 * MIDDLE_NODE + 1) - MIDDLE_NODE) / NODES_PER_SIGMA
_STEP = ndtr(_NODES).astype(np.float32)
_BELL = (np.exp(-(_NODES**2) / 2) / math.sqrt(2 * math.pi)).astype(np.float32)
_ZERO, _HALF, _ONE, _TWO = (np.float32(number) for number in (0, 0.5, 1, 2))
_REACH, _NODE_WIDTH = np.float32(REACH_SIGMAS), np.float32(1 / NODES_PER_SIGMA)
_RATE, _GREY = np.float32(NODES_PER_SIGMA), np.float32(MIDDLE_GREY)
_SQUEEZE_X, _SQUEEZE_Y = SQUEEZE
_LIGHT_X, _LIGHT_Y = LIGHT
_LEAN_X, _LEAN_Y = LEAN
_TONE = TONE[0]
_NEXT = np.uintp(1)

MARKER = np.dtype(
    [
        ("center", complex),
        ("x_axis", complex),
        ("y_axis", complex),
        ("horizon", complex),
        ("lean", complex),
        ("squeeze", complex),
        ("limit", float),
        ("strip", float),
        ("height_px", float),
        ("sigma", float),
        ("black_ratio", float),
        ("half_card", float),
        ("x_stretch", float),
        ("y_stretch", float),
    ]
)
"""What the kernels know of a marker; lengths are in marker sides unless a unit is given.

- `center`, px, and the axes X and Y and the `horizon`, 1/px, of `LocalHomographies.axes`;
- `lean`, by how much the marker's image shrinks towards its points, and `squeeze`, by how much round blur
  differs along its directions (`LocalHomographies.anisotropies`); both are 0 where blur is drawn as if the
  marker were seen from straight above;
- `limit`, up to which marker coordinates pixels are read; `strip`, the same for the affine part of the
  homography, wide enough for what a horizon adds; `height_px`, half the height of the strips' common part;
- `sigma`, the blur's standard deviation, and its standard deviations along x and y over `sigma`;
- `black_ratio`, black level over contrast;
- `half_card`, the distance of the card's edge from the centre, infinite where no ground is to be seen.
"""


def _can_be_kept() -> bool:
    """Whether there is a folder in which compiled code can be kept; without one, each run compiles anew."""
    try:
        njit(cache=True)(_can_be_kept)
    except RuntimeError:
        return False
    return True


_FLAGS: Any = {
    "cache": _can_be_kept(),
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "nsz"},
}
"""How functions are compiled. A division by zero gives infinity, and not an error. A multiplication may be
joined with an addition, as the processor has it; nothing else about the numbers is changed, so that those
that are not finite are recognised."""

_INLINE: Any = {"inline": "always", **_FLAGS}
"""How functions are compiled that are called for every pixel: as part of their callers. Calls that hand over
arrays cost as much as the arithmetic. For the same reason they count with unsigned numbers: with others each
index is first asked whether it is negative, and so counts from the end."""


def _readonly(kind: Any, ndim: int) -> Any:
    """Type of a contiguous array that is not written to; arrays that could be are taken too."""
    return types.Array(kind, ndim, "C", readonly=True)


_MARKER = from_dtype(MARKER)
_MARKERS, _IMAGE, _BOUNDS = _readonly(_MARKER, 1), _readonly(uint8, 2), _readonly(int64, 1)
_COLUMNS, _PLACES, _SOLUTIONS = _readonly(float32, 2), _readonly(float32, 2), _readonly(float32, 2)


@njit(**_FLAGS)
def _first_and_last(low: float, high: float, size: int) -> tuple[int, int]:
    """The whole numbers from `low` to `high`, of those from 0 to `size - 1`; none if the last is smaller."""
    if not low <= high:
        return 0, -1
    first, last = max(math.ceil(low), 0.0), min(math.floor(high), size - 1.0)
    return (int(first), int(last)) if first <= last else (0, -1)


@njit(**_FLAGS)
def _lines(marker: Any, height: int) -> Any:
    """First and last line of an image of `height` lines that may have pixels of a marker.

    There are none if the marker's geometry has numbers that are not finite, as a fit that ran away may.
    """
    total = abs(marker.center) + abs(marker.x_axis) + abs(marker.y_axis) + abs(marker.horizon)
    total += abs(marker.lean) + abs(marker.squeeze) + marker.strip + marker.height_px + marker.sigma
    if not total < np.inf:
        return 0, -1
    middle = marker.center.imag
    return _first_and_last(middle - marker.height_px, middle + marker.height_px, height)


@njit(**_FLAGS)
def _columns_of_line(marker: Any, v: int, width: int) -> Any:
    """First and last column of line v within both strips `|Re(X̄ p)|, |Re(Ȳ p)| <= strip` about the centre."""
    below = v - marker.center.imag
    low, high = -np.inf, np.inf
    for axis in (marker.x_axis, marker.y_axis):
        per_u = axis.real if abs(axis.real) > MIN_AXIS_PER_PX else MIN_AXIS_PER_PX
        middle, half = -axis.imag / per_u * below, marker.strip / abs(per_u)
        low, high = max(low, middle - half), min(high, middle + half)
    return _first_and_last(low + marker.center.real, high + marker.center.real, width)


@njit(int64(_MARKERS, int64, int64), **_FLAGS)
def count_pixels(markers: Any, height: int, width: int) -> int:
    """Return how many pixels N markers (`MARKER`) have in an image of that size, or a few more.

    They are those between the strips; `fill` leaves out those that only the strips' extra width takes in. No
    marker has more than the image.
    """
    count = 0
    for number in range(markers.size):
        first_line, last_line = _lines(markers[number], height)
        for v in range(first_line, last_line + 1):
            first, last = _columns_of_line(markers[number], v, width)
            count += last - first + 1
    return count


@njit(**_INLINE)
def _node(place: Any) -> tuple[Any, Any, Any]:
    """The tables' entry nearest to a place in reach, standard deviations; where that is, and how far off."""
    node = np.uintp(place * _RATE + np.float32(MIDDLE_NODE + 0.5))
    there = np.float32(np.intp(node) - MIDDLE_NODE) * _NODE_WIDTH
    return node, there, place - there


@njit(**_INLINE)
def _step(place: Any) -> Any:
    """Φ at a place in standard deviations."""
    if not place < _REACH:
        return _ONE
    if place <= -_REACH:
        return _ZERO
    node, there, off = _node(place)
    return _STEP[node] + _BELL[node] * off * (_ONE - _HALF * there * off)


@njit(**_INLINE)
def _pass_edges(position: Any, reach: Any, per_cell: Any, edges: Any) -> tuple[Any, Any]:
    """Write down Φ, φ and φ' at those edges of cells along one axis that are within reach of a position.

    Args:
        position: in cells, from the first edge of the marker.
        reach: in cells.
        per_cell: standard deviations of the blur to a cell.
        edges: (n + 1, 3) what is written, for edges that are in reach.

    Returns:
        The first edge in reach, and the first beyond it. Edge k has cell k on its left, where cells 0 and
        n + 1 are the ground on either side.
    """
    first = min(max(int(position - reach + _ONE), 0), len(edges))
    end = max(min(int(position + reach + _ONE), len(edges)), first)
    for edge in range(np.uintp(first), np.uintp(end)):
        place = (position - np.float32(edge)) * per_cell
        node, there, off = _node(place)
        bell = _BELL[node]
        edges[edge, 0] = _STEP[node] + bell * off * (_ONE - _HALF * there * off)
        bell *= _ONE - off * (there - _HALF * (there * there - _ONE) * off)
        edges[edge, 1] = bell
        edges[edge, 2] = -place * bell
    return np.uintp(first), np.uintp(end)


@njit(**_INLINE)
def _sum_of_row(cells: Any, number: int, row: int, first: int, end: int, edges: Any) -> tuple[Any, Any, Any]:
    """`Σ_c B_c E_c` of one row of cells, and its first and second derivatives, times σ and σ²."""
    black = cells[number, row, first]
    value, slope, bend = black, _ZERO, _ZERO
    for edge in range(first, end):
        change = cells[number, row, edge + _NEXT] - black
        value += change * edges[edge, 0]
        slope += change * edges[edge, 1]
        bend += change * edges[edge, 2]
        black += change
    return value, slope, bend


@njit(**_INLINE)
def _blurred(
    cells: Any, number: int, across: tuple[Any, Any], down: tuple[Any, Any], x_edges: Any, y_edges: Any
) -> Any:
    """`F = Σ_r Σ_c E_r B_rc E_c`, and σ F_x, σ F_y, σ² F_xx, σ² F_xy and σ² F_yy.

    Args:
        cells: (N, n + 2, n + 2) 1 where a cell is black, 0 on the ground around.
        number: which of the N markers.
        across: what `_pass_edges` returns for columns.
        down: what it returns for rows.
        x_edges: (n + 1, 3) of `_pass_edges`, of columns.
        y_edges: (n + 1, 3) of `_pass_edges`, of rows.
    """
    first, end = down
    above, above_x, above_xx = _sum_of_row(cells, number, first, across[0], across[1], x_edges)
    f, f_x, f_xx = above, above_x, above_xx
    f_y = f_xy = f_yy = _ZERO
    for edge in range(first, end):
        here, here_x, here_xx = _sum_of_row(cells, number, edge + _NEXT, across[0], across[1], x_edges)
        share, slope, bend = y_edges[edge, 0], y_edges[edge, 1], y_edges[edge, 2]
        change, change_x, change_xx = here - above, here_x - above_x, here_xx - above_xx
        f += share * change
        f_x += share * change_x
        f_xx += share * change_xx
        f_y += slope * change
        f_xy += slope * change_x
        f_yy += bend * change
        above, above_x, above_xx = here, here_x, here_xx
    return f, f_x, f_y, f_xx, f_xy, f_yy


@njit(**_INLINE)
def _write_columns(
    columns: Any,
    row: Any,
    x: Any,
    y: Any,
    white: Any,
    slope_x: Any,
    slope_y: Any,
    log_blur: Any,
    ground: Any,
    weight: Any,
    ratio: Any,
) -> None:
    """Write down what the model's columns are at one pixel.

    Args:
        columns: (P, 16) the result.
        row: of the pixel.
        x: marker coordinate of the pixel, towards the marker's right, in sides.
        y: the same, down.
        white: T.
        slope_x: T_x times the weight.
        slope_y: T_y times the weight.
        log_blur: T_log σ.
        ground: the share of ground beyond the card.
        weight: of the pixel.
        ratio: black level over contrast.
    """
    contrast = white * weight
    grow = -(x * slope_x + y * slope_y)
    light = ratio * weight + contrast
    columns[row, BLACK] = weight
    columns[row, CONTRAST] = contrast
    columns[row, RIGHT] = -slope_x
    columns[row, DOWN] = -slope_y
    columns[row, TURN] = y * slope_x - x * slope_y
    columns[row, GROW] = grow
    columns[row, BLUR] = log_blur * weight
    columns[row, GROUND] = ground * weight
    columns[row, _SQUEEZE_X] = y * slope_y - x * slope_x
    columns[row, _SQUEEZE_Y] = -(y * slope_x + x * slope_y)
    columns[row, _LIGHT_X] = x * light
    columns[row, _LIGHT_Y] = y * light
    columns[row, _LEAN_X] = -grow * x
    columns[row, _LEAN_Y] = -grow * y
    columns[row, _TONE] = contrast * (_ONE - white)


@njit(
    void(
        *(_IMAGE, _MARKERS, _readonly(float32, 3), float64),
        *(int64[::1], float32[:, ::1], float32[:, ::1], int32[:, ::1]),
    ),
    **_FLAGS,
)
def fill(
    image: Any,
    markers: Any,
    cells: Any,
    texture: float,
    bounds: Any,
    columns: Any,
    places: Any,
    pixels: Any,
) -> None:
    """Fill in the weighted columns of the linear model at the pixels of N markers.

    Pixels follow each other line by line, and markers one after another, without gaps.

    Args:
        image: (height, width) grey levels.
        markers: (N,) of `MARKER`.
        cells: (N, n + 2, n + 2) 1 where a cell is black, 0 where it is white and on the ground around.
        texture: standard deviation of the ground's texture over that of the noise.
        bounds: (N + 1,) result: marker k has the rows from `bounds[k]` to `bounds[k + 1]`.
        columns: (P, 16) result: the model's columns and the pixels less `MIDDLE_GREY`, times their weights.
        places: (P, 2) result: marker coordinates x and y.
        pixels: (P, 2) result: line v and column u in the image.
    """
    n = cells.shape[1] - 2
    x_edges, y_edges = np.empty((n + 1, 3), dtype=np.float32), np.empty((n + 1, 3), dtype=np.float32)
    height, width = image.shape
    cells_per_side, half_side = np.float32(n), np.float32(n / 2)
    texture_square = np.float32(texture * texture)
    bounds[0] = 0
    place = np.uintp(0)
    for number in range(np.uintp(markers.size)):
        marker = markers[number]
        center, x_axis, y_axis, horizon = marker.center, marker.x_axis, marker.y_axis, marker.horizon
        sigma = marker.sigma
        per_side, per_cell = np.float32(1 / sigma), np.float32(1 / (n * sigma))
        reach = np.float32(REACH_SIGMAS * n * sigma)
        limit, half_card = marker.limit, np.float32(marker.half_card)
        x_rate, y_rate = (
            np.float32(1 / (sigma * marker.x_stretch)),
            np.float32(1 / (sigma * marker.y_stretch)),
        )
        ratio = np.float32(marker.black_ratio)
        lean_x, lean_y = np.float32(marker.lean.real), np.float32(marker.lean.imag)
        squeeze_x, squeeze_y = np.float32(marker.squeeze.real), np.float32(marker.squeeze.imag)
        first_line, last_line = _lines(marker, height)
        for v in range(first_line, last_line + 1):
            below = v - center.imag
            first, last = _columns_of_line(marker, v, width)
            for u in range(first, last + 1):
                right = u - center.real
                far = 1 / (1 - (horizon.real * right + horizon.imag * below))
                far_x = (x_axis.real * right + x_axis.imag * below) * far
                far_y = (y_axis.real * right + y_axis.imag * below) * far
                if not (far > 0 and abs(far_x) <= limit and abs(far_y) <= limit):
                    continue
                x, y = np.float32(far_x), np.float32(far_y)
                across = _pass_edges(x * cells_per_side + half_side, reach, per_cell, x_edges)
                down = _pass_edges(y * cells_per_side + half_side, reach, per_cell, y_edges)
                f, f_x, f_y, f_xx, f_xy, f_yy = _blurred(cells, number, across, down, x_edges, y_edges)

                # T, its slopes, and T_log σ = σ² (T_xx + T_yy); blur that is round in the image only.
                log_blur = -(f_xx + f_yy)
                along = lean_x * x + lean_y * y
                white = _ONE - f
                white += (f_xx - f_yy) * (squeeze_x - _HALF * (lean_x * x - lean_y * y))
                white += _TWO * f_xy * (squeeze_y - _HALF * (lean_y * x + lean_x * y))
                white += (_ONE + _HALF) * along * log_blur

                # The share of ground beyond the card, and the weight.
                ground = _ONE - _step((half_card - abs(x)) * x_rate) * _step((half_card - abs(y)) * y_rate)
                weight = _ONE
                if ground > _ZERO:
                    weight /= np.float32(math.sqrt(_ONE + texture_square * ground * ground))

                slope_x, slope_y = -f_x * per_side * weight, -f_y * per_side * weight
                _write_columns(columns, place, x, y, white, slope_x, slope_y, log_blur, ground, weight, ratio)
                columns[place, PIXEL_ROW] = (np.float32(image[v, u]) - _GREY) * weight
                places[place, 0], places[place, 1] = x, y
                pixels[place, 0], pixels[place, 1] = v, u
                place += _NEXT
        bounds[number + _NEXT] = place


@njit(**_INLINE)
def _residual(columns: Any, row: int, solutions: Any, number: int) -> Any:
    """A pixel less the model at it, in single precision, times the pixel's weight."""
    residual = columns[row, PIXEL_ROW]
    for unknown in range(UNKNOWNS):
        residual -= solutions[number, unknown] * columns[row, unknown]
    return residual


@njit(float32[::1](_COLUMNS, _BOUNDS, _SOLUTIONS), **_FLAGS)
def residuals(columns: Any, bounds: Any, solutions: Any) -> Any:
    """Return the weighted residuals (P,), grey levels, of the model at `solutions` (N, 15)."""
    left = np.empty(len(columns), dtype=np.float32)
    for number in range(len(solutions)):
        for row in range(bounds[number], bounds[number + 1]):
            left[row] = _residual(columns, row, solutions, number)
    return left


@njit(
    void(*(_COLUMNS, _PLACES, _BOUNDS, _SOLUTIONS), *(float64[:, :, ::1],) * 3, float64[::1]),
    **_FLAGS,
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
            _readonly(int32, 2),
            _BOUNDS,
            _readonly(int64, 1),
            _SOLUTIONS,
            _readonly(float32, 3),
            int64,
        ),
        *(float64[:, ::1], float64[:, ::1], int64[::1]),
    ),
    **_FLAGS,
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
