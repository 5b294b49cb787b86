"""Parameters of the adaptive threshold, and the places of an image that are searched.

A pixel is dark if it is below the local mean by a constant (`vision/native/means.c`). A first pass at half
the size selects places with a high density of dark pixels. Marker edges exceed this density limit, and noise
and texture do not. The selected places are copied side by side into one mosaic, which is processed at once.
Empty parts of the image thus cost no time. Places around known markers are left out.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray
from skyherd.vision.grey import Image, block_means

SMOOTHING_PX = 3
"""Width of the box filter that reduces noise before the threshold, px. Chosen: the smallest; a wider one
closes cells of small markers."""

SHARPENING_PX = 5
"""Width of the box filter of the unsharp mask, applied twice, px. Without it, blur closes the white between a
marker's border and a dark ground. Chosen: about the size of a blurred edge."""

WINDOWS_PX = (9, 21)
"""Window widths of the adaptive threshold, px. Chosen: the small one separates close edges, the large one
fills thick borders."""

DARKER = 10
"""Smallest difference of a dark pixel to the local mean in the sharpened image, grey levels. Chosen: half of
it includes noise, twice as much loses faint markers."""

COARSE_WINDOW = 5
"""Width of the local mean and of the density window, px of the half-size image. Chosen: about a small
marker."""

CROWD_FACTOR, MIN_CROWD, MAX_CROWD = 2.2, 2.0, 6.0
"""Density limit: this factor times the mean darkness of the image, within these bounds in grey levels.

Derived: noise of standard deviation σ has a mean darkness of 0.4 σ, with a standard deviation of 0.12 σ over
25 pixels. A factor of 2.2 is four standard deviations above the mean.

Measured for stretched images (`faint.py`), on 13,284 markers of 16 to 60 px and contrasts of 10 to 35 grey
levels on texture: with 9, 12 and 18 instead of 6, 37, 117 and 208 of 7,524 are lost."""

CROWD_REACH = 9
"""Width of the dilation of dense pixels, px of the half-size image. Chosen: it extends from an edge over the
marker's border."""

MARGIN_PX = 16
"""Margin around each place, px. Derived: the reach of the box filters above, `(5 - 1) + (21 - 1) / 2` px,
rounded up to an even number."""

MAX_MOSAIC_SHARE = 0.33
"""Share of the image's area above which the image is processed as a whole. Chosen: the mosaic then costs more
time than it saves."""

KNOWN_LINE_PX = COARSE_WINDOW
"""Width of the excluded line along the edges of known squares, px of the half-size image. Chosen: as far as a
mean over `COARSE_WINDOW` spreads an edge. Twice the width cuts off a part of markers beside known ones, and
saves no time on photographs or in missions."""


@dataclass(frozen=True)
class Mosaic:
    """K places of an image, copied side by side into one image.

    Attributes:
        image: grey image of all places.
        mask: image of half the size, 255 where a pixel belongs to a place.
        begins: (K,) first column of each place.
        offsets: (K,) shift from the mosaic to the image, u + iv, px.
    """

    image: Image
    mask: Image
    begins: IntArray
    offsets: ComplexArray

    def shifts(self, columns: Array) -> ComplexArray:
        """Return the shifts (N,) from columns (N,) of the mosaic to the image, u + iv, px."""
        return self.offsets[np.searchsorted(self.begins, columns, side="right") - 1]


def crowded_places(image: Image, known_px: Array | None = None, min_darkness: float = 0.0) -> Mosaic | None:
    """Return the places of an image with a high density of dark pixels, or None.

    Args:
        image: grey, (height, width); an odd last row or column is ignored.
        known_px: (K, 4, 2) corners of known squares, px. Pixels inside them and along their edges are
            excluded. Places beside them may extend over them.
        min_darkness: lower limit of the density limit, grey levels.
    """
    height, width = (side - side % 2 for side in image.shape)
    if min(height, width) == 0:
        return None
    image = image[:height, :width]
    crowded = _crowded(image, np.zeros((0, 4, 2)) if known_px is None else known_px, min_darkness)
    return _mosaic(image, crowded) if crowded.any() else None


def _mosaic(image: Image, crowded_mask: Image) -> Mosaic:
    """Return the places of an image within a mask, or the whole image if they exceed `MAX_MOSAIC_SHARE`."""
    whole = Mosaic(image, crowded_mask, np.zeros(1, dtype=np.int64), np.zeros(1, dtype=complex))
    if 4 * cv2.countNonZero(crowded_mask) > MAX_MOSAIC_SHARE * image.size:
        return whole
    contours, _ = cv2.findContours(crowded_mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    boxes = np.array([cv2.boundingRect(contour) for contour in contours], dtype=np.int64).reshape(-1, 4)
    low = 2 * boxes[:, :2] - MARGIN_PX
    widths, heights = (2 * boxes[:, 2:] + 2 * MARGIN_PX).T
    height = int(heights.max(initial=0))
    if not boxes.size or height * widths.sum() > MAX_MOSAIC_SHARE * image.size:
        return whole
    begins = np.cumsum(widths) - widths
    mask = np.zeros((height // 2, int(widths.sum()) // 2), dtype=np.uint8)
    for contour, shift in zip(contours, (np.column_stack([begins, 0 * begins]) - low) // 2, strict=True):
        cv2.drawContours(mask, [contour], 0, 255, cv2.FILLED, offset=shift.tolist())
    crops = [
        _crop(image, x, y, width, height) for (x, y), width in zip(low.tolist(), widths.tolist(), strict=True)
    ]
    return Mosaic(np.hstack(crops), mask, begins, low[:, 0] - begins + 1j * low[:, 1])


def _crowded(image: Image, known_px: Array, min_darkness: float) -> Image:
    """Return the mask of places with a high density of dark pixels, at half the size.

    Known squares (K, 4, 2), px of the full image, and their edges are excluded.
    """
    half = block_means(image, 2)
    darkness = np.asarray(cv2.subtract(_mean(half, COARSE_WINDOW), half), dtype=np.uint8)
    crowd = np.clip(CROWD_FACTOR * cv2.mean(darkness)[0], MIN_CROWD, MAX_CROWD)
    least = max(float(crowd), min_darkness)
    _, crowded = cv2.threshold(_mean(darkness, COARSE_WINDOW), least, 255, cv2.THRESH_BINARY)
    squares = np.rint((known_px - 0.5) / 2).astype(np.int32)
    for square in squares:
        cv2.fillConvexPoly(crowded, square, 0)
    cv2.polylines(crowded, list(squares), True, 0, KNOWN_LINE_PX)
    reach = np.ones((CROWD_REACH, CROWD_REACH), dtype=np.uint8)
    return np.asarray(cv2.dilate(crowded, reach), dtype=np.uint8)


def _crop(image: Image, u: int, v: int, width: int, height: int) -> Image:
    """Return a part of an image, mirrored beyond the border as in OpenCV's box filters."""
    inside = image[max(v, 0) : v + height, max(u, 0) : u + width]
    top, left = max(-v, 0), max(-u, 0)
    below, right = height - top - inside.shape[0], width - left - inside.shape[1]
    return np.asarray(
        cv2.copyMakeBorder(inside, top, below, left, right, cv2.BORDER_REFLECT_101), dtype=np.uint8
    )


def _mean(image: Image, width: int) -> Image:
    """Return the mean over a box around each pixel."""
    return np.asarray(cv2.blur(image, (width, width)), dtype=np.uint8)
