"""Discs laid over an image.

Their edge is taken as straight, and for its curvature moved inwards by `σ² / 2 R`, which leaves the disc its
area: right where it is much larger than the blur.
"""

import math
from typing import Any

import numpy as np
from numba import float32, njit, void

from skyherd.jobs.compilation import FLAGS, readonly
from skyherd.render.raster.kernels.pixels import (
    SHAPES,
    matrix_of_row,
    place_of,
    runs_of,
    seen_through,
    slopes_at,
    spread_at,
    table_start,
)

MIDDLE = 1e-6
"""Least distance of a pixel from a disc's centre, in radii. *Chosen*: there the direction outwards is not
defined, and the disc is far from its edge anyhow."""

MIN_SPREAD = 1e-12
"""Least variance of an edge's blur across a disc's radius, in squared radii. *Chosen*: keeps a division from
zero where a pixel lies in the disc's centre; it is far below a pixel of any image."""


@njit(void(readonly(float32, 1), *SHAPES), **FLAGS)
def lay_discs(
    levels: Any,
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
    """Lay discs over an image, in place: `A level + (1 - A) background`.

    `matrices` lead to where the discs are unit discs, `levels` (N,) are their grey levels, and the other
    arguments are those of `lay_lattices`.
    """
    whole = image.size > 0
    height, width = image.shape if whole else light.shape
    runs, matrix = runs_of(outlines_px, margin_px, height, width), np.empty((3, 3))
    for run in range(len(runs)):
        shape, v, first_u, end_u = runs[run, 0], runs[run, 1], runs[run, 2], runs[run, 3]
        level = levels[numbers[shape]]
        matrix_of_row(matrices, shape, row_times[v], matrix)
        x, y, w = place_of(matrix, first_u, v)
        slopes = slopes_at(matrix, x / w, y / w)
        start = table_start(slopes[0], slopes[1])
        for u in range(first_u, end_u):
            x, y, w, sharp_x, sharp_y, cosine = seen_through(matrix, lens, v * width + u, u, v, sigma_px)
            if not w > 0:  # beyond the horizon
                continue
            radius = max(math.sqrt(x * x + y * y), MIDDLE)
            across_x, across_y = x / sharp_x, y / sharp_y
            square = across_x**2 + across_y**2 + 2 * cosine * across_x * across_y
            sigma = math.sqrt(max(square, MIN_SPREAD)) / radius
            covered = spread_at(table, start, (1 - radius) / sigma - sigma / 2)
            if whole:
                image[v, u] = np.rint((1 - covered) * image[v, u] + level * covered)
            else:
                light[v, u] = (1 - covered) * light[v, u] + level * covered
