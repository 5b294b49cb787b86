"""The model's columns at the pixels of markers under blur that is round, or nearly so, in the marker.

The marker T and its derivatives are those of `blurred_edges`. For blur that is round in the image only, the
marker's anisotropy and keystone add terms to them, which are taken to first order (`design_matrix`).
"""

from typing import Any

import numpy as np
from numba import float32, float64, int32, int64, njit, void

from skyherd.jobs.compilation import FLAGS, IMAGE, INLINE, readonly
from skyherd.vision.photometric.fitting.kernels.blurred_edges import (
    REACH_SIGMAS,
    edges_in_reach,
    step_and_bell,
)
from skyherd.vision.photometric.fitting.kernels.card_edge import ground_and_weight
from skyherd.vision.photometric.fitting.kernels.columns import write_columns
from skyherd.vision.photometric.fitting.kernels.marker_record import MARKERS

_ZERO, _HALF, _ONE, _TWO = (np.float32(number) for number in (0, 0.5, 1, 2))
_NEXT = np.uintp(1)


@njit(**INLINE)
def _pass_edges(position: Any, reach: Any, per_cell: Any, edges: Any) -> tuple[Any, Any]:
    """Write down Φ, φ and φ' at those edges of cells along one axis that are within reach of a position.

    Args:
        position: as of `edges_in_reach`, which also says what is returned.
        reach: as there.
        per_cell: standard deviations of the blur to a cell.
        edges: (n + 1, 3) what is written, for edges that are in reach.
    """
    first, end = edges_in_reach(position, reach, len(edges))
    for edge in range(first, end):
        place = (position - np.float32(edge)) * per_cell
        value, bell = step_and_bell(place)
        edges[edge, 0] = value
        edges[edge, 1] = bell
        edges[edge, 2] = -place * bell
    return first, end


@njit(**INLINE)
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


@njit(**INLINE)
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


@njit(**INLINE)
def _white(
    blurred: tuple[Any, ...], x: Any, y: Any, keystone: tuple[Any, Any], anisotropy: tuple[Any, Any]
) -> Any:
    """T at a pixel, and T_log σ = σ² (T_xx + T_yy), of blur that is round in the image only.

    Args:
        blurred: of `_blurred`.
        x: marker coordinate of the pixel.
        y: the same, down.
        keystone: its two components, of `MARKER`.
        anisotropy: the same.
    """
    f, _, _, f_xx, f_xy, f_yy = blurred
    log_blur = -(f_xx + f_yy)
    along = keystone[0] * x + keystone[1] * y
    white = _ONE - f
    white += (f_xx - f_yy) * (anisotropy[0] - _HALF * (keystone[0] * x - keystone[1] * y))
    white += _TWO * f_xy * (anisotropy[1] - _HALF * (keystone[1] * x + keystone[0] * y))
    white += (_ONE + _HALF) * along * log_blur
    return white, log_blur


@njit(
    void(
        *(IMAGE, MARKERS, readonly(float32, 3), float64),
        *(readonly(int64, 1), readonly(float32, 2), readonly(int32, 2), float32[:, ::1]),
    ),
    **FLAGS,
)
def fill(
    image: Any,
    markers: Any,
    cells: Any,
    texture: float,
    bounds: Any,
    places: Any,
    pixels: Any,
    columns: Any,
) -> None:
    """Fill in the weighted columns of the linear model at the pixels of N markers.

    Args:
        image: (height, width) grey levels.
        markers: (N,) of `MARKER`.
        cells: (N, n + 2, n + 2) 1 where a cell is black, 0 where it is white and on the ground around.
        texture: standard deviation of the ground's texture over that of the noise.
        bounds: (N + 1,) of `list_pixels`: marker k has the rows from `bounds[k]` to `bounds[k + 1]`.
        places: (P, 2) of `list_pixels`.
        pixels: (P, 2) of `list_pixels`.
        columns: (P, 16) result: the model's columns and the pixels less `MIDDLE_GREY`, times their weights.
    """
    n = cells.shape[1] - 2
    x_edges, y_edges = np.empty((n + 1, 3), dtype=np.float32), np.empty((n + 1, 3), dtype=np.float32)
    cells_per_side, half_side = np.float32(n), np.float32(n / 2)
    texture_square = np.float32(texture * texture)
    for number in range(np.uintp(markers.size)):
        marker = markers[number]
        sigma, half_card = marker.sigma, np.float32(marker.half_card)
        per_side, per_cell = np.float32(1 / sigma), np.float32(1 / (n * sigma))
        reach = np.float32(REACH_SIGMAS * n * sigma)
        x_rate = np.float32(1 / (sigma * marker.x_stretch))
        y_rate = np.float32(1 / (sigma * marker.y_stretch))
        ratio = np.float32(marker.black_ratio)
        keystone = np.float32(marker.keystone.real), np.float32(marker.keystone.imag)
        anisotropy = np.float32(marker.anisotropy.real), np.float32(marker.anisotropy.imag)
        for row in range(np.uintp(bounds[number]), np.uintp(bounds[number + _NEXT])):
            x, y = places[row, 0], places[row, 1]
            across = _pass_edges(x * cells_per_side + half_side, reach, per_cell, x_edges)
            down = _pass_edges(y * cells_per_side + half_side, reach, per_cell, y_edges)
            blurred = _blurred(cells, number, across, down, x_edges, y_edges)
            white, log_blur = _white(blurred, x, y, keystone, anisotropy)
            ground, weight = ground_and_weight(x, y, half_card, x_rate, y_rate, texture_square)
            slope_x, slope_y = -blurred[1] * per_side * weight, -blurred[2] * per_side * weight
            grey = image[np.uintp(pixels[row, 0]), np.uintp(pixels[row, 1])]
            write_columns(columns, row, x, y, white, slope_x, slope_y, log_blur, ground, weight, ratio, grey)
