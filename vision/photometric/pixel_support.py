"""The pixels that lie within each marker, with their marker coordinates."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, ComplexArray, IntArray
from skyherd.vision.photometric.local_homography import LocalHomographies

Floats = npt.NDArray[np.float32]

BLOCK = 64
"""Pixel counts are padded to a multiple of this number, so that `cv2.remap` can read a pattern at a
rectangular block of points. Chosen: larger blocks add more padding, smaller ones more rows to each call."""

MIN_AXIS_PER_PX = 1e-12
"""Smallest slope along a line, in marker sides per pixel, that is divided by; an axis that is exactly at
right angles to a line would divide by zero. Chosen far below 1 / image width, so that the bounds it gives lie
outside any image."""

MAX_GROWTH = 0.5
"""Largest share by which a horizon may move a marker's border outwards. Chosen: at a half, the marker is seen
from nearer than its own side; what lies further out is not read."""


@dataclass(frozen=True)
class PixelSupport:
    """The pixels of N markers, line by line; each row is filled up to the same length M by padding.

    Attributes:
        counts: (N,) number of pixels of each marker.
        mask: (N, M) 1 for a pixel, 0 for padding.
        flat_indices: (N, M) indices of the pixels into the flattened image; meaningless in padding.
        x, y: (N, M) marker coordinates of the pixels' centres, in sides; 0 in padding.
    """

    counts: IntArray
    mask: Floats
    flat_indices: IntArray
    x: Floats
    y: Floats

    def within(self, limits: Array) -> "PixelSupport":
        """Return the support without the pixels whose coordinates exceed their marker's limit (N,)."""
        limit = limits.astype(np.float32)[:, None]
        mask = self.mask * ((np.abs(self.x) <= limit) & (np.abs(self.y) <= limit))
        return replace(self, counts=np.count_nonzero(mask, axis=1), mask=mask)


def pixels_within(
    homographies: LocalHomographies, limits: Array, image_shape: tuple[int, ...]
) -> PixelSupport:
    """Return the pixels of an image (height, width) whose marker coordinates are within ± `limits` (N,).

    Each image line meets the strips `|x| < limit` and `|y| < limit` in two intervals; the pixels of a line
    are the common part of both, cut off at the image's border. The strips are those of the affine part of the
    homography, made wider by what a horizon may add; the pixels beyond the limits are then masked.
    """
    inner, leans = limits, np.abs(homographies.leans())
    limits = limits / (1 - np.minimum(leans * np.sqrt(2) * limits, MAX_GROWTH))
    right = homographies.arms + homographies.squeezes
    down = 1j * (homographies.arms - homographies.squeezes)
    # A fit that runs away may make a marker larger than any image; lines beyond the image are not needed.
    reach = np.minimum(limits * (np.abs(right.imag) + np.abs(down.imag)), 2.0 * image_shape[0])
    corner = homographies.centers.real.round() + 1j * homographies.centers.imag.round()
    offset = homographies.centers - corner
    # Lines and columns are counted from the pixels nearest to the centres: small numbers, without rounding.
    lines = np.ceil(offset.imag - reach)[:, None] + np.arange(int(2 * reach.max()) + 1)
    v = lines - offset.imag[:, None]
    low, high = -corner.real[:, None], image_shape[1] - 1 - corner.real[:, None]
    for axis in homographies.axes():
        per_u = np.where(np.abs(axis.real) < MIN_AXIS_PER_PX, MIN_AXIS_PER_PX, axis.real)
        middle = offset.real[:, None] - (axis.imag / per_u)[:, None] * v
        half = (limits / np.abs(per_u))[:, None]
        low, high = np.maximum(low, np.ceil(middle - half)), np.minimum(high, np.floor(middle + half))
    in_image = lines + corner.imag[:, None]
    meets = (in_image >= 0) & (in_image < image_shape[0]) & (high >= low)
    counts = np.where(meets, high - low + 1, 0).astype(np.int64)
    support = _padded(homographies, corner, np.where(meets, low, 0), lines, counts, image_shape[1])
    return support.within(inner) if leans.any() else support


def _padded(
    homographies: LocalHomographies,
    corner: ComplexArray,
    low: Array,
    lines: Array,
    counts: IntArray,
    width: int,
) -> PixelSupport:
    """Lay the intervals of pixels out in rows of equal length.

    Args:
        homographies: of the N markers.
        corner: (N,) the pixels nearest to the centres, from which lines and columns are counted.
        low: (N, L) first column of each interval.
        lines: (N, L) line of each interval.
        counts: (N, L) pixels of each interval.
        width: of the image, px.
    """
    totals = counts.sum(axis=1)
    size = -(-max(int(totals.max()), 1) // BLOCK) * BLOCK
    mask = (np.arange(size) < totals[:, None]).astype(np.float32)
    counts = np.column_stack([counts, size - totals]).ravel()
    starts = np.cumsum(counts) - counts
    low, lines = (np.column_stack([place, np.zeros(len(place))]).ravel() for place in (low, lines))
    columns = np.arange(mask.size, dtype=np.int32)
    columns += np.repeat((low - starts).astype(np.int32), counts)
    columns = columns.reshape(mask.shape)
    rows = np.repeat(lines.astype(np.int32), counts).reshape(mask.shape)
    offset = (homographies.centers - corner).astype(np.complex64)[:, None]
    u, v = columns.astype(np.float32) - offset.real, rows.astype(np.float32) - offset.imag

    def along(axis: ComplexArray) -> Floats:
        """`Re(axis̄ p)` of all pixels p, relative to their markers' centres."""
        real, imag = axis.real.astype(np.float32)[:, None], axis.imag.astype(np.float32)[:, None]
        return np.asarray(real * u + imag * v)

    x, y = (along(axis) * mask for axis in homographies.axes())
    if homographies.horizons.any():
        nearness = 1 - along(homographies.horizons) * mask
        x, y = x / nearness, y / nearness
    rows *= width
    rows += columns
    rows += (corner.imag * width + corner.real).astype(np.int32)[:, None]
    return PixelSupport(totals, mask, rows, x, y)
