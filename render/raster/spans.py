"""Which pixels convex shapes touch: one run of pixels an image row."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skyherd.geometry import Array, IntArray

TINY = 1e-9
"""Edges this near to a row's direction bound it at infinity."""


@dataclass(frozen=True)
class Spans:
    """Runs of pixels, one for each shape and image row that it touches, ordered by shape.

    Attributes:
        shape: (R,) which shape.
        v: (R,) image row.
        u: (R,) first pixel of the run.
        count: (R,) pixels in it, at least one.
    """

    shape: IntArray
    v: IntArray
    u: IntArray
    count: IntArray

    def part(self, rows: slice) -> "Spans":
        """Some of the runs."""
        return Spans(self.shape[rows], self.v[rows], self.u[rows], self.count[rows])

    def chunks(self, pixels: int) -> "list[Spans]":
        """The same runs in parts of about so many pixels, which keeps what is computed on them in cache."""
        ends = np.cumsum(self.count)
        if not ends.size:
            return []
        cuts = np.searchsorted(ends, np.arange(pixels, ends[-1], pixels)) + 1
        bounds = [0, *np.unique(cuts).tolist(), ends.size]
        return [self.part(slice(a, b)) for a, b in pairwise(bounds) if a < b]


def cover(outlines_px: Array, margin_px: float, size_px: tuple[int, int]) -> Spans:
    """Pixels of an image of `size_px` within `margin_px` of convex outlines (N, V, 2).

    A pixel belongs to a shape if it lies behind each of its edges, moved outwards by the margin:
    `n_u u + n_v v <= d + margin` with unit normals n.
    """
    width, height = size_px
    u, v = outlines_px.T
    following = np.arange(1, len(u) + 1) % len(u)
    along_u, along_v = u[following] - u, v[following] - v
    length = np.sqrt(along_u**2 + along_v**2) + TINY
    sense = np.where((u * along_v - v * along_u).sum(axis=0) < 0, -1.0, 1.0) / length
    normal_u, normal_v = sense * along_v, -sense * along_u
    normal_u[np.abs(normal_u) < TINY] = TINY
    # Along a row each edge bounds u on one side: `u <= cut - slope v` where n_u > 0, else `u >=`.
    cut = (normal_u * u + normal_v * v + margin_px) / normal_u
    slope, to_right = normal_v / normal_u, normal_u > 0
    first, end = np.ceil(v.min(axis=0) - margin_px), np.floor(v.max(axis=0) + margin_px) + 1
    first, end = (np.minimum(np.maximum(line, 0), height).astype(np.int64) for line in (first, end))
    rows = np.maximum(end - first, 0)
    shape = np.repeat(np.arange(rows.size), rows)
    row = np.arange(shape.size) - np.repeat(np.cumsum(rows) - rows - first, rows)
    bound = cut[:, shape] - slope[:, shape] * row
    right = to_right[:, shape]
    low, high = np.where(right, -np.inf, bound).max(axis=0), np.where(right, bound, np.inf).min(axis=0)
    low = np.ceil(np.minimum(np.maximum(low, 0), width)).astype(np.int64)
    high = np.floor(np.minimum(np.maximum(high, -1), width - 1)).astype(np.int64) + 1
    some = high > low
    return Spans(shape[some], row[some], low[some], (high - low)[some])
