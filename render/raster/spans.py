"""Which pixels convex shapes touch: one run of pixels an image row."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skyherd.geometry import Array, IntArray

TINY = 1e-9
"""Edges whose normal has a smaller part along a row count as along the row. *Chosen*: they bound the row's
pixels at 1e9 px, beyond any image, and no division is by zero."""


@dataclass(frozen=True)
class Spans:
    """Runs of pixels, one for each shape and image row that it touches, ordered by shape.

    Attributes:
        shape: (R,) number of the shape.
        v: (R,) image row.
        u: (R,) column of the run's first pixel.
        count: (R,) pixels in the run, at least one.
    """

    shape: IntArray
    v: IntArray
    u: IntArray
    count: IntArray

    def part(self, rows: slice) -> "Spans":
        """The runs of a slice."""
        return Spans(shape=self.shape[rows], v=self.v[rows], u=self.u[rows], count=self.count[rows])

    def chunks(self, pixels: int) -> "list[Spans]":
        """The same runs in parts of about so many pixels, which keeps what is computed on them in cache."""
        ends = np.cumsum(self.count)
        if not ends.size:
            return []
        cuts = np.searchsorted(ends, np.arange(pixels, ends[-1], pixels)) + 1
        bounds = [0, *np.unique(cuts).tolist(), ends.size]
        return [self.part(slice(a, b)) for a, b in pairwise(bounds) if a < b]


def cover(outlines_px: Array, margin_px: float, size_px: tuple[int, int]) -> Spans:
    """Find the pixels of an image that are within a margin of convex outlines.

    A pixel belongs to a shape if it lies behind each of its edges, moved outwards by the margin:
    `n_u u + n_v v <= d + margin` with unit normals n. The outlines may be in either sense.

    Args:
        outlines_px: (N, V, 2) corners of the shapes' outlines.
        margin_px: how far beyond its outline a shape still matters.
        size_px: width and height of the image.
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
    return Spans(shape=shape[some], v=row[some], u=low[some], count=(high - low)[some])
