"""Grids of grey cells, such as marker cards, laid over an image.

In a grid's own coordinates (column x, row y, in cells) its light is a sum of steps at the grid's lines. A
pixel whose lens and aperture spread light by S (`skyherd.render.raster.edge`) gathers from it

    F = Σ_j Σ_k  T_jk S_j(y) S_k(x),      S_k(x) = S((x - k) / (σ |∇x|)),

where T_00 is a cell's level, T_0k and T_j0 the steps of level from cell to cell along x and along y, and
T_jk, for j, k > 0, the steps of those steps. The share A of the pixel that is covered is the same sum for a
grid whose cells are all 1. Only lines within `FELT` count on either axis. Distances are taken in the image,
across each pixel, so that tilt, perspective, skew and lens need no care of their own but one: lines that meet
at an angle in the image. With ρ the cosine between the gradients of x and y, the two factors are correlated,
and by Plackett's identity (1954) they gather more by

    ∫_0^ρ φ_r(y_j, x_k) dr  ≈  ρ φ_{ρ/2}(y_j, x_k),

φ_r being the binormal density of correlation r: the midpoint rule, right to 0.1 grey levels of 200 at ρ =
0.3; where |ρ| is more, at the rim of a fisheye, Gauss's rule with two nodes. Where the pixel's square is
wide beside the lens, its joint fourth cumulants add Edgeworth terms.
"""

import math
from typing import Any

import numpy as np
from numba import float32, float64, njit, void

from skyherd.jobs.compilation import FLAGS, INLINE, PARTS, readonly
from skyherd.render.raster.kernels.pixels import (
    AFFINE,
    MIN_SQUARE,
    SHAPES,
    matrix_of_row,
    place_of,
    runs_of,
    seen_through,
    sharpness_of,
    slopes_at,
    spread_at,
    table_start,
)

SQUARE = 1e-3
"""Correlation of the two axes below which a corner is the product of its edges. *Derived*: `200 ρ φ(0)²` is
0.03 grey levels of 200."""

BOXY = 0.03
"""Fourth cumulant of the pixel, over σ⁴, below which corners leave it out. *Derived*: 0.1 grey levels of 200
at most."""

FELT = 3.4
"""Distance in σ beyond which a line is left out. *Derived*: `200 Φ(-3.4)`, 0.07 grey levels of 200, are left
there. More lines a pixel cost more."""

SLANTED = 0.35
"""Correlation ρ from which on the integral over r takes two nodes in place of one. *Chosen*: the midpoint
rule is right to 0.1 grey levels of 200 at 0.3; two nodes cost twice as much."""

GAUSS = (0.5 - 12**-0.5, 0.5 + 12**-0.5)
"""Nodes of Gauss's rule of two points, as shares of ρ. *Derived*: `(1 ± 1/√3) / 2`."""


@njit(**INLINE)
def _feel(table: Any, start: float, at: float, sharpness: float, reach: float, spread: Any) -> Any:
    """Return the first line that a pixel feels on an axis and the one after the last; `spread` has S of each.

    Args:
        table: S, as `EdgeSpread` has it.
        start: place of distance zero in it, for these lines.
        at: where the pixel lies on the axis, cells.
        sharpness: how many σ a cell is there.
        reach: from how far away a line is felt, cells.
        spread: (m + 1,) result, at the lines that are felt; the lines of a grid are numbered 0 to m.
    """
    cells = len(spread) - 1
    first = math.ceil(min(max(at - reach, 0.0), cells + 0.5))
    end = math.floor(max(min(at + reach, cells + 0.0), -0.5)) + 1
    for line in range(first, end):
        spread[np.uintp(line)] = spread_at(table, start, (at - line) * sharpness)
    return first, end


@njit(**PARTS)
def _binormal(r: float, x: float, y: float) -> float:
    """Return the density of two standard normal variables with correlation r, at x, y."""
    rest = 1 - r * r
    return math.exp((x * x + y * y - 2 * r * x * y) / (-2 * rest)) / (2 * math.pi * math.sqrt(rest))


@njit(**PARTS)
def _at_corner(correlation: float, cumulants: Any, x: float, y: float) -> Any:
    """Return what a corner at distances x, y, in σ, adds to the product of its two edges.

    `cumulants` are κ_22 / 4, κ_31 / 6 and κ_13 / 6 of lens and pixel across the two edges, over σ⁴.
    """
    even, odd_x, odd_y = cumulants
    if abs(correlation) > SLANTED:
        density = (_binormal(GAUSS[0] * correlation, x, y) + _binormal(GAUSS[1] * correlation, x, y)) / 2
    else:
        density = _binormal(0.5 * correlation, x, y)
    return density * (correlation + even * x * y + odd_x * (x * x - 1) + odd_y * (y * y - 1))


@njit(**INLINE)
def _row_sum(grid: Any, row: int, lines: Any, spread: Any) -> Any:
    """Return what a row of cells sends to a pixel that feels `lines` across it: `Σ_k T_k S_k`."""
    first, end = lines
    before = grid[np.uintp(row), np.uintp(first)]
    total = before
    for line in range(first, end):
        after = grid[np.uintp(row), np.uintp(line + 1)]
        total += (after - before) * spread[np.uintp(line)]
        before = after
    return total


@njit(**INLINE)
def _grid_sum(grid: Any, lines_x: Any, lines_y: Any, spread_x: Any, spread_y: Any) -> Any:
    """Return what a grid sends to a pixel, as if its lines met at right angles: `Σ_j Σ_k T_jk S_j S_k`."""
    first, end = lines_y
    before = _row_sum(grid, first, lines_x, spread_x)
    total = before
    for line in range(first, end):
        after = _row_sum(grid, line + 1, lines_x, spread_x)
        total += (after - before) * spread_y[np.uintp(line)]
        before = after
    return total


@njit(**INLINE)
def _covered(lines: Any, spread: Any) -> Any:
    """Return how much of a pixel lies between the first and the last line of an axis."""
    (first, end), cells = lines, len(spread) - 1
    inside = float32(1.0) if 0 < first <= cells else float32(0.0)
    if first == 0 and end > 0:
        inside += spread[0]
    if first <= cells < end:
        inside -= spread[cells]
    return inside


@njit(**PARTS)
def _corner_sign(line: int, cells: int) -> Any:
    """Step of cover at a line: into the grid, out of it, or none."""
    if line == 0:
        return float32(1.0)
    return float32(-1.0) if line == cells else float32(0.0)


@njit(**PARTS)
def _corner_sums(grid: Any, lines_x: Any, lines_y: Any, x: Any, y: Any, cosine: float, cumulants: Any) -> Any:
    """Return the share of light and of cover by the corners that a pixel feels.

    Args:
        grid: (m + 2, m + 2) levels, framed.
        lines_x: first line that it feels across x, and the one after the last.
        lines_y: the same across y.
        x: where it lies, cells, and how many σ a cell is there.
        y: the same.
        cosine: ρ.
        cumulants: of the pixel (`_cumulants`).
    """
    light, covered, cells = float32(0.0), float32(0.0), len(grid) - 2
    for j in range(lines_y[0], lines_y[1]):
        for k in range(lines_x[0], lines_x[1]):
            more = float32(_at_corner(cosine, cumulants, (x[0] - k) * x[1], (y[0] - j) * y[1]))
            light += more * ((grid[j + 1, k + 1] - grid[j + 1, k]) - (grid[j, k + 1] - grid[j, k]))
            covered += more * _corner_sign(k, cells) * _corner_sign(j, cells)
    return light, covered


@njit(**PARTS)
def _cumulants(slopes: Any, kurtosis: float) -> Any:
    """κ_22 / 4, κ_31 / 6 and κ_13 / 6, over σ⁴, of a pixel's square across lines of x and of y."""
    a, b, c, d = slopes
    x, y = math.sqrt(max(a * a + b * b, MIN_SQUARE)), math.sqrt(max(c * c + d * d, MIN_SQUARE))
    a, b, c, d = a / x, b / x, c / y, d / y
    return (
        kurtosis / 4 * (a * a * c * c + b * b * d * d),
        kurtosis / 6 * (a**3 * c + b**3 * d),
        kurtosis / 6 * (a * c**3 + b * d**3),
    )


@njit(void(readonly(float32, 3), float64, *SHAPES), **FLAGS)
def lay_lattices(
    levels: Any,
    kurtosis: float,
    image: Any,
    light: Any,
    outlines_px: Any,
    numbers: Any,
    matrices: Any,
    row_times: Any,
    lens: Any,
    margin_px: float,
    sigma_px: float,
    table: Any,
) -> None:
    """Lay grids of grey cells over an image, in place: `F + (1 - A) background`.

    Args:
        levels: (N, m + 2, m + 2) grey levels of the shapes' cells, in a border of empty ones.
        kurtosis: fourth cumulant of the pixel, over σ⁴.
        image: the canvas (height, width), if it has whole grey levels; else (0, 0).
        light: the canvas (height, width), if it is of light, in grey levels; else (0, 0).
        outlines_px: (M, V, 2) corners of the shapes that are drawn, in the image.
        numbers: (M,) rows of `levels` that they have.
        matrices: (Q, M, 3, 3) from pixels without the lens to the shapes' coordinates, columns and rows, at
            one instant or three.
        row_times: (height,) when each row is seen, the three instants being at -1, 0 and 1; not read if there
            is one.
        lens: (6, height x width) `LensField.fields`, or (6, 0) without a lens.
        margin_px: how far beyond its outline a shape still matters.
        sigma_px: standard deviation of lens and pixel together.
        table: S, as `EdgeSpread` has it.
    """
    whole = image.size > 0
    height, width = image.shape if whole else light.shape
    boxy, straight, lines = kurtosis < -BOXY, not lens.shape[1], levels.shape[1] - 1
    spread_x, spread_y = np.empty(lines, dtype=np.float32), np.empty(lines, dtype=np.float32)
    runs, matrix = runs_of(outlines_px, margin_px, height, width), np.empty((3, 3))
    for run in range(len(runs)):
        shape, v, first_u, end_u = runs[run, 0], runs[run, 1], runs[run, 2], runs[run, 3]
        grid = levels[numbers[shape]]
        matrix_of_row(matrices, shape, row_times[v], matrix)
        x, y, w = place_of(matrix, first_u, v)
        x, y = x / w, y / w
        slopes = slopes_at(matrix, x, y)
        sharp_x, sharp_y, cosine = sharpness_of(slopes, w, sigma_px)
        start_x, start_y = table_start(slopes[0], slopes[1]), table_start(slopes[2], slopes[3])
        cumulants = _cumulants(slopes, kurtosis)
        reach_x, reach_y = FELT / sharp_x, FELT / sharp_y
        affine = straight and max(abs(matrix[2, 0]), abs(matrix[2, 1])) < AFFINE * w
        step_x, step_y = matrix[0, 0] / w, matrix[1, 0] / w
        for u in range(first_u, end_u):
            if affine:
                at_x, at_y = x + step_x * (u - first_u), y + step_y * (u - first_u)
            else:
                pixel = v * width + u
                at_x, at_y, w, sharp_x, sharp_y, cosine = seen_through(matrix, lens, pixel, u, v, sigma_px)
                if not w > 0:  # beyond the horizon
                    continue
                reach_x, reach_y = FELT / sharp_x, FELT / sharp_y
            lines_x = _feel(table, start_x, at_x, sharp_x, reach_x, spread_x)
            lines_y = _feel(table, start_y, at_y, sharp_y, reach_y, spread_y)
            gathered = _grid_sum(grid, lines_x, lines_y, spread_x, spread_y)
            covered = _covered(lines_x, spread_x) * _covered(lines_y, spread_y)
            if boxy or abs(cosine) > SQUARE:
                x_here, y_here = (at_x, sharp_x), (at_y, sharp_y)
                more = _corner_sums(grid, lines_x, lines_y, x_here, y_here, cosine, cumulants)
                gathered, covered = gathered + more[0], covered + more[1]
            if whole:
                image[v, u] = np.rint((1 - covered) * image[v, u] + gathered)
            else:
                light[v, u] = (1 - covered) * light[v, u] + gathered
