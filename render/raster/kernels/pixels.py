"""Which pixels a flat shape touches, where on it they lie, and how sharp it is there: parts of the kernels.

A shape has the pixels that lie behind each edge of its outline, moved outwards by a margin: `n_u u + n_v v <=
d + margin` with unit normals n. A pixel is mapped into the shape's coordinates (x, y) by the inverse of the
shape's homography, after what the lens does to the pixel; the gradient of that map says how many σ of the
blur one unit of x or of y is.
"""

import math
from typing import Any

import numpy as np
from numba import float32, float64, int64, njit, uint8

from skyherd.jobs.compilation import PARTS, readonly
from skyherd.render.raster.edge import DIRECTIONS, PER_SIGMA, REACH, SAMPLES

TINY = 1e-9
"""Edges whose normal has a smaller part along a row count as along the row. *Chosen*: they bound the row's
pixels at 1e9 px, beyond any image, and no division is by zero."""

AFFINE = 1e-7
"""Change of a map's scale from pixel to pixel below which it counts as affine. *Derived*: over a run of 1000
pixels the place is then off by 1e-4 of the run."""

MIN_SQUARE = 1e-300
"""Least squared length of a gradient. *Chosen*: keeps 0 / 0 from a direction that is of no use anyhow."""

SHAPES = (
    uint8[:, ::1],  # image
    float32[:, ::1],  # light
    readonly(float64, 3),  # outlines_px
    readonly(int64, 1),  # numbers
    readonly(float64, 4),  # matrices
    readonly(float64, 1),  # row_times
    readonly(float32, 2),  # lens
    float64,  # margin_px
    float64,  # sigma_px
    readonly(float32, 1),  # table
)
"""Types of the arguments that all kernels end with."""


@njit(**PARTS)
def runs_of(outlines_px: Any, margin_px: float, height: int, width: int) -> Any:
    """Return runs of pixels (R, 4) of shapes in an image: shape, row, first column, column after the last.

    They are ordered by shape and row. `outlines_px` (M, V, 2) are the corners of the shapes, in either sense.
    """
    most = 0
    for shape in range(len(outlines_px)):
        first, end = _rows_of(outlines_px[shape], margin_px, height)
        most += max(end - first, 0)
    runs, count = np.empty((most, 4), dtype=np.int64), 0
    edges = np.empty((outlines_px.shape[1], 3))
    for shape in range(len(outlines_px)):
        first, end = _rows_of(outlines_px[shape], margin_px, height)
        _bound_edges(outlines_px[shape], margin_px, edges)
        for v in range(first, end):
            first_u, end_u = _columns_of(edges, v, width)
            if end_u > first_u:
                runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = shape, v, first_u, end_u
                count += 1
    return runs[:count]


@njit(**PARTS)
def _rows_of(outline_px: Any, margin_px: float, height: int) -> Any:
    """First row that a shape touches, and the one after the last."""
    low, high = np.inf, -np.inf
    for corner in range(len(outline_px)):
        low, high = min(low, outline_px[corner, 1]), max(high, outline_px[corner, 1])
    first, end = math.ceil(low - margin_px), math.floor(high + margin_px) + 1
    return int(min(max(first, 0), height)), int(min(max(end, 0), height))


@njit(**PARTS)
def _bound_edges(outline_px: Any, margin_px: float, edges: Any) -> None:
    """Return how the moved edges of an outline (V, 2) bound a row, into `edges` (V, 3): cut, slope and n_u.

    A row v has the columns `u <= cut - slope v` where n_u is positive, and `u >=` where it is negative.
    """
    count = len(outline_px)
    area = 0.0
    for corner in range(count):
        u, v, after = outline_px[corner, 0], outline_px[corner, 1], (corner + 1) % count
        area += u * outline_px[after, 1] - v * outline_px[after, 0]
    for corner in range(count):
        u, v, after = outline_px[corner, 0], outline_px[corner, 1], (corner + 1) % count
        along_u, along_v = outline_px[after, 0] - u, outline_px[after, 1] - v
        length = math.sqrt(along_u * along_u + along_v * along_v) + TINY
        sense = -1.0 / length if area < 0 else 1.0 / length
        normal_u, normal_v = sense * along_v, -sense * along_u
        if abs(normal_u) < TINY:
            normal_u = TINY
        edges[corner, 0] = (normal_u * u + normal_v * v + margin_px) / normal_u
        edges[corner, 1] = normal_v / normal_u
        edges[corner, 2] = normal_u


@njit(**PARTS)
def _columns_of(edges: Any, v: int, width: int) -> Any:
    """Return the first column of row v within moved edges and the one after the last; 0, 0 without any."""
    low, high = 0.0, width - 1.0
    for edge in range(len(edges)):
        bound = edges[edge, 0] - edges[edge, 1] * v
        if edges[edge, 2] > 0:
            high = min(high, bound)
        else:
            low = max(low, bound)
    if not low <= high:
        return 0, 0
    return math.ceil(low), math.floor(high) + 1


@njit(**PARTS)
def matrix_of_row(matrices: Any, shape: int, row_time: float, matrix: Any) -> None:
    """Write the map (3, 3) of a shape at a row's instant into `matrix`, by a parabola if there are three."""
    if len(matrices) == 1:
        for i in range(3):
            for j in range(3):
                matrix[i, j] = matrices[0, shape, i, j]
        return
    before, middle, after = row_time * (row_time - 1) / 2, 1 - row_time**2, row_time * (row_time + 1) / 2
    for i in range(3):
        for j in range(3):
            matrix[i, j] = (
                before * matrices[0, shape, i, j]
                + middle * matrices[1, shape, i, j]
                + after * matrices[2, shape, i, j]
            )


@njit(**PARTS)
def table_start(u: float, v: float) -> Any:
    """Place in the edge table of distance zero, for edges with the normal (u, v) in the image.

    Half an entry is added, so that cutting off decimals rounds to the nearest entry.
    """
    u, v = u * u, v * v
    cos_4_alpha = ((u - v) ** 2 - 4 * u * v) / max((u + v) ** 2, MIN_SQUARE)
    direction = np.rint((1 - cos_4_alpha) / 2 * (DIRECTIONS - 1))
    return direction * SAMPLES + SAMPLES // 2 + 0.5


@njit(**PARTS)
def spread_at(table: Any, start: float, distance: float) -> Any:
    """S of a distance, in σ."""
    return table[np.uintp(np.intp(min(max(distance, -REACH), REACH) * PER_SIGMA + start))]


@njit(**PARTS)
def place_of(matrix: Any, u: float, v: float) -> Any:
    """Numerators of x and y, and w, at a place of the image without the lens."""
    return (
        matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2],
        matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2],
        matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2],
    )


@njit(**PARTS)
def slopes_at(matrix: Any, x: float, y: float) -> Any:
    """Gradients of x and of y in the image without the lens, times w: (x by u, x by v, y by u, y by v)."""
    return (
        matrix[0, 0] - x * matrix[2, 0],
        matrix[0, 1] - x * matrix[2, 1],
        matrix[1, 0] - y * matrix[2, 0],
        matrix[1, 1] - y * matrix[2, 1],
    )


@njit(**PARTS)
def sharpness_of(slopes: Any, w: float, sigma_px: float) -> Any:
    """Return one unit of x and of y in σ, and the cosine between their gradients, from `slopes_at`."""
    a, b, c, d = slopes
    x, y = math.sqrt(max(a * a + b * b, MIN_SQUARE)), math.sqrt(max(c * c + d * d, MIN_SQUARE))
    return w / (sigma_px * x), w / (sigma_px * y), (a * c + b * d) / (x * y)


@njit(**PARTS)
def seen_through(matrix: Any, lens: Any, index: int, u: float, v: float, sigma_px: float) -> Any:
    """Return the place of a pixel in its shape and its sharpness: x, y, w, sharpness of x and y, cosine.

    `lens` (6, P) is `LensField.fields` of all pixels, or has none.
    """
    if not lens.shape[1]:
        x, y, w = place_of(matrix, u, v)
        x, y = x / w, y / w
        across_x, across_y, cosine = sharpness_of(slopes_at(matrix, x, y), w, sigma_px)
        return x, y, w, across_x, across_y, cosine
    x, y, w = place_of(matrix, u + lens[0, index], v + lens[1, index])
    x, y = x / w, y / w
    a, b, c, d = slopes_at(matrix, x, y)
    uu, uv, vu, vv = lens[2, index], lens[3, index], lens[4, index], lens[5, index]
    bent = a * uu + b * vu, a * uv + b * vv, c * uu + d * vu, c * uv + d * vv
    across_x, across_y, cosine = sharpness_of(bent, w, sigma_px)
    return x, y, w, across_x, across_y, cosine
