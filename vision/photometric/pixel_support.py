"""Which pixels of an image lie within a marker, line by line, and where in the marker's coordinates."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, ComplexArray, IntArray
from skyherd.vision.photometric.local_homography import Shapes

Floats = npt.NDArray[np.float32]

BLOCK = 64
"""Pixels are padded to a multiple of this: OpenCV reads a pattern at blocks of points."""


@dataclass(frozen=True)
class Lines:
    """Pixels of N markers, line by line, each marker's filled up to the same number M with its centre.

    Attributes:
        counts: (N,) pixels of each.
        padded: (N, M) 1 for a pixel, 0 for one that only fills up.
        places: (N, M) where the pixels are in the image.
        x, y: (N, M) marker coordinates.
    """

    counts: IntArray
    padded: Floats
    places: IntArray
    x: Floats
    y: Floats


def lines_within(shapes: Shapes, limits: Array, image_shape: tuple[int, ...]) -> Lines:
    """The pixels of an image that lie within `limits` (N,) of the markers' centres, in marker coordinates.

    Each line of pixels meets the strips `|x| < limit` and `|y| < limit` in intervals: their common part.
    """
    right, down = shapes.arms + shapes.squeezes, 1j * (shapes.arms - shapes.squeezes)
    reach = limits * (np.abs(right.imag) + np.abs(down.imag))
    corner = shapes.centers.real.round() + 1j * shapes.centers.imag.round()
    off = shapes.centers - corner
    # Lines and columns are counted from the pixels nearest to the centres: small numbers, without rounding.
    lines = np.ceil(off.imag - reach)[:, None] + np.arange(int(2 * reach.max()) + 1)
    v = lines - off.imag[:, None]
    low, high = -corner.real[:, None], image_shape[1] - 1 - corner.real[:, None]
    for axis in shapes.axes():
        per_u = np.where(np.abs(axis.real) < 1e-12, 1e-12, axis.real)
        middle = off.real[:, None] - (axis.imag / per_u)[:, None] * v
        half = (limits / np.abs(per_u))[:, None]
        low, high = np.maximum(low, np.ceil(middle - half)), np.minimum(high, np.floor(middle + half))
    on = lines + corner.imag[:, None]
    meets = (on >= 0) & (on < image_shape[0]) & (high >= low)
    counts = np.where(meets, high - low + 1, 0).astype(np.int64)
    return _laid_out(shapes, corner, np.where(meets, low, 0), lines, counts, image_shape[1])


def _laid_out(
    shapes: Shapes, corner: ComplexArray, low: Array, lines: Array, counts: IntArray, width: int
) -> Lines:
    """Pixels from `low` (N, L), `counts` of them, on `lines`, both from pixels `corner` (N,)."""
    totals = counts.sum(axis=1)
    size = -(-max(int(totals.max()), 1) // BLOCK) * BLOCK
    padded = (np.arange(size) < totals[:, None]).astype(np.float32)
    counts = np.column_stack([counts, size - totals]).ravel()
    starts = np.cumsum(counts) - counts
    low, lines = (np.column_stack([place, np.zeros(len(place))]).ravel() for place in (low, lines))
    columns = np.arange(padded.size, dtype=np.int32)
    columns += np.repeat((low - starts).astype(np.int32), counts)
    columns = columns.reshape(padded.shape)
    rows = np.repeat(lines.astype(np.int32), counts).reshape(padded.shape)
    off = (shapes.centers - corner).astype(np.complex64)[:, None]
    u, v = columns.astype(np.float32) - off.real, rows.astype(np.float32) - off.imag

    def along(axis: ComplexArray) -> Floats:
        """`Re(axis̄ p)` of all pixels p, from their markers' centres."""
        real, imag = axis.real.astype(np.float32)[:, None], axis.imag.astype(np.float32)[:, None]
        return np.asarray(real * u + imag * v)

    x, y = (along(axis) * padded for axis in shapes.axes())
    if shapes.horizons.any():
        nearness = 1 - along(shapes.horizons) * padded
        x, y = x / nearness, y / nearness
    rows *= width
    rows += columns
    rows += (corner.imag * width + corner.real).astype(np.int32)[:, None]
    return Lines(totals, padded, rows, x, y)
