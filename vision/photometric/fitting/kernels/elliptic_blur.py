"""Compiled loop that draws markers under blur that differs much along their directions.

`round_blur` draws round blur, and what a marker's anisotropy adds to it to first order. That is not enough
for a marker at a steep tilt, nor for the streak of a camera that moved. Here the blur is any Gaussian, of
variances σ_x² and σ_y² along the marker's axes and correlation ρ. Along the axes it separates; the
correlation follows by Mehler's series,

    G = Σ_n ρⁿ / n! (σ_x σ_y ∂_x ∂_y)ⁿ F,

with F the marker under the same variances without correlation. Terms from n = 1 on are zero but at cells'
corners. The series is summed up to `ORDER` in the marker, and up to the first order in its slopes, which
decide how fast a fit converges, not where to.

Seen in perspective, with the image p = A z / w, w = 1 + q·z, a pixel's own blur is
`w² (1 + z qᵀ) Σ (1 + q zᵀ)` where Σ is that at the marker's centre: the inverse of p's derivative is
`w (1 + z qᵀ) A⁻¹`.

This takes twice the time of `round_blur`, so that it is for markers that need it, and loaded when the first
such marker is seen.
"""

import math
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
from skyherd.vision.photometric.fitting.kernels.scan_conversion import growth

ORDER = 4
"""Last term of Mehler's series that is summed. Derived: at a correlation of 0.8, that of a tilt of 70 degrees
at its worst, the next one is 0.4 % of the contrast at corners, and of 0.6, that of 60 degrees, 0.1 %."""

_ZERO, _HALF, _ONE, _TWO, _THREE = (np.float32(number) for number in (0, 0.5, 1, 2, 3))
_SIXTH, _TWENTY_FOURTH = np.float32(1 / 6), np.float32(1 / 24)
_NEXT = np.uintp(1)


@njit(**INLINE)
def _pass_edges(position: Any, reach: Any, per_cell: Any, edges: Any) -> tuple[Any, Any]:
    """Write down Φ and its first four derivatives at those edges along one axis that are within reach.

    Arguments and results are those of `round_blur._pass_edges`, except that `edges` is (n + 1, `ORDER` + 1).
    """
    first, end = edges_in_reach(position, reach, len(edges))
    for edge in range(first, end):
        place = (position - np.float32(edge)) * per_cell
        square = place * place
        value, bell = step_and_bell(place)
        edges[edge, 0] = value
        edges[edge, 1] = bell
        edges[edge, 2] = -place * bell
        edges[edge, 3] = (square - _ONE) * bell
        edges[edge, 4] = place * (_THREE - square) * bell
    return first, end


@njit(**INLINE)
def _sum_of_row(cells: Any, number: int, row: int, first: int, end: int, edges: Any) -> Any:
    """`Σ_c B_c E_c` of one row of cells, and its first four derivatives, times powers of σ_x."""
    black = cells[number, row, first]
    value, one, two, three, four = black, _ZERO, _ZERO, _ZERO, _ZERO
    for edge in range(first, end):
        change = cells[number, row, edge + _NEXT] - black
        value += change * edges[edge, 0]
        one += change * edges[edge, 1]
        two += change * edges[edge, 2]
        three += change * edges[edge, 3]
        four += change * edges[edge, 4]
        black += change
    return value, one, two, three, four


@njit(**INLINE)
def _blurred(
    cells: Any, number: int, across: Any, down: Any, x_edges: Any, y_edges: Any, correlation: Any
) -> Any:
    """G, σ_x G_x, σ_y G_y, σ_x² G_xx, σ_x σ_y G_xy and σ_y² G_yy, under a correlation of the blur.

    The arguments are otherwise those of `round_blur._blurred`.
    """
    first, end = down
    row0, row1, row2, row3, row4 = _sum_of_row(cells, number, first, across[0], across[1], x_edges)
    f00, f10, f20 = row0, row1, row2
    f01 = f02 = f11 = f12 = f13 = f21 = f22 = f31 = f33 = f44 = _ZERO
    for edge in range(first, end):
        new0, new1, new2, new3, new4 = _sum_of_row(cells, number, edge + _NEXT, across[0], across[1], x_edges)
        d0, d1, d2, d3, d4 = new0 - row0, new1 - row1, new2 - row2, new3 - row3, new4 - row4
        y0, y1, y2, y3 = y_edges[edge, 0], y_edges[edge, 1], y_edges[edge, 2], y_edges[edge, 3]
        f00 += y0 * d0
        f10 += y0 * d1
        f20 += y0 * d2
        f01 += y1 * d0
        f11 += y1 * d1
        f21 += y1 * d2
        f31 += y1 * d3
        f02 += y2 * d0
        f12 += y2 * d1
        f22 += y2 * d2
        f13 += y3 * d1
        f33 += y3 * d3
        f44 += y_edges[edge, 4] * d4
        row0, row1, row2, row3, row4 = new0, new1, new2, new3, new4
    square = correlation * correlation
    value = (
        f00
        + correlation * f11
        + square * (_HALF * f22 + correlation * (_SIXTH * f33 + correlation * _TWENTY_FOURTH * f44))
    )
    g_x, g_y = f10 + correlation * f21, f01 + correlation * f12
    return value, g_x, g_y, f20 + correlation * f31, f11 + correlation * f22, f02 + correlation * f13


@njit(**INLINE)
def _growths(variances: tuple[Any, Any, Any], marker: Any) -> tuple[Any, Any, Any]:
    """Return the growth of a marker's blur towards the horizon: both components of Σ q, and q·Σ q.

    Args:
        variances: σ_xx, σ_yy and σ_xy of Σ, the blur at the marker's centre.
        marker: its record, with its keystone q.
    """
    xx, yy, xy = variances
    keystone_x, keystone_y = np.float32(marker.keystone.real), np.float32(marker.keystone.imag)
    x, y = xx * keystone_x + xy * keystone_y, xy * keystone_x + yy * keystone_y
    return x, y, keystone_x * x + keystone_y * y


@njit(**INLINE)
def _ellipse(
    x: Any, y: Any, w_square: Any, variances: tuple[Any, Any, Any], growths: tuple[Any, Any, Any]
) -> tuple[Any, Any, Any]:
    """Return a pixel's own blur: its standard deviations along x and y, and its covariance.

    Towards the horizon the marker shrinks, by w, and blur grows in its coordinates.

    Args:
        x: marker coordinate of the pixel.
        y: the same, down.
        w_square: w² there.
        variances: of the blur at the marker's centre.
        growths: of `_growths`.
    """
    xx, yy, xy = variances
    grow_x, grow_y, grow = growths
    sigma_x = math.sqrt(w_square * (xx + _TWO * x * grow_x + x * x * grow))
    sigma_y = math.sqrt(w_square * (yy + _TWO * y * grow_y + y * y * grow))
    return sigma_x, sigma_y, w_square * (xy + x * grow_y + y * grow_x + x * y * grow)


@njit(
    void(
        *(IMAGE, MARKERS, readonly(float64, 2), readonly(float32, 3), float64),
        *(readonly(int64, 1), readonly(float32, 2), readonly(int32, 2), float32[:, ::1], float32[:, ::1]),
    ),
    **FLAGS,
)
def fill(
    image: Any,
    markers: Any,
    blurs: Any,
    cells: Any,
    texture: float,
    bounds: Any,
    places: Any,
    pixels: Any,
    columns: Any,
    bends: Any,
) -> None:
    """Fill in the weighted columns of the linear model at the pixels of N markers, as `round_blur.fill`.

    Args:
        image: (height, width) grey levels.
        markers: (N,) of `MARKER`, of which `sigma`, `anisotropy` and the stretches are not used.
        blurs: (N, 6) of `blur_ellipses.blur_tables`: variances along x and y and covariance of the blur, in
            sides squared, and by how much each of them changes with the logarithm of the blur.
        cells: as there.
        texture: as there.
        bounds: as there.
        places: as there.
        pixels: as there.
        columns: as there.
        bends: (P, 3) result: T_xx, T_xy and T_yy, times the pixels' weights.
    """
    n = cells.shape[1] - 2
    x_edges = np.empty((n + 1, ORDER + 1), dtype=np.float32)
    y_edges = np.empty((n + 1, ORDER + 1), dtype=np.float32)
    cells_per_side, half_side = np.float32(n), np.float32(n / 2)
    texture_square, reach = np.float32(texture * texture), np.float32(REACH_SIGMAS * n)
    for number in range(np.uintp(markers.size)):
        marker = markers[number]
        center, half_card, ratio = marker.center, np.float32(marker.half_card), np.float32(marker.black_ratio)
        variances = np.float32(blurs[number, 0]), np.float32(blurs[number, 1]), np.float32(blurs[number, 2])
        by_xx, by_yy = np.float32(_HALF * blurs[number, 3]), np.float32(_HALF * blurs[number, 4])
        by_xy = np.float32(blurs[number, 5])
        growths = _growths(variances, marker)
        for row in range(np.uintp(bounds[number]), np.uintp(bounds[number + _NEXT])):
            x, y, v, u = places[row, 0], places[row, 1], pixels[row, 0], pixels[row, 1]
            far = growth(marker.perspective, u - center.real, v - center.imag)
            w_square = np.float32(far * far)
            sigma_x, sigma_y, covariance = _ellipse(x, y, w_square, variances, growths)
            x_rate, y_rate = _ONE / sigma_x, _ONE / sigma_y
            at_x, at_y = x * cells_per_side + half_side, y * cells_per_side + half_side
            across = _pass_edges(at_x, reach * sigma_x, x_rate / cells_per_side, x_edges)
            down = _pass_edges(at_y, reach * sigma_y, y_rate / cells_per_side, y_edges)
            correlation = covariance * x_rate * y_rate
            g, g_x, g_y, g_xx, g_xy, g_yy = _blurred(
                cells, number, across, down, x_edges, y_edges, correlation
            )
            t_xx, t_xy, t_yy = -g_xx * x_rate * x_rate, -g_xy * x_rate * y_rate, -g_yy * y_rate * y_rate
            log_blur = w_square * (by_xx * t_xx + by_yy * t_yy + by_xy * t_xy)
            ground, weight = ground_and_weight(x, y, half_card, x_rate, y_rate, texture_square)
            slope_x, slope_y = -g_x * x_rate * weight, -g_y * y_rate * weight
            bends[row, 0], bends[row, 1], bends[row, 2] = t_xx * weight, t_xy * weight, t_yy * weight
            white, grey = _ONE - g, image[np.uintp(v), np.uintp(u)]
            write_columns(columns, row, x, y, white, slope_x, slope_y, log_blur, ground, weight, ratio, grey)
