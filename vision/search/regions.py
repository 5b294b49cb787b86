"""Boundaries of the dark regions of an image: where markers may be.

A pixel is dark if it is below the mean of its surroundings by a constant. An image of half the size shows
first where dark pixels crowd: around a marker's edge they are dark by much and in number, those of noise and
texture are not. The places found are laid side by side in one smaller image, so that empty parts of the image
cost nothing, and all of them are treated at once. Places around markers that are known already are left out.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray
from skyherd.vision.grey import Image

SMOOTHING_PX = 3
"""Width, px, of the box filter that takes noise off before the threshold. Chosen: the smallest there is; a
wider one closes cells of small markers."""

SHARPENING_PX = 5
"""Width, px, of the box filter whose mean, taken twice, is subtracted again: blur otherwise closes the white
between a marker's border and a dark ground. Chosen: about the size of a blurred edge."""

WINDOWS_PX = (9, 21)
"""Widths, px, of the surroundings. Chosen: small ones separate crowded edges, large ones fill thick
borders."""

DARKER = 10
"""By how many grey levels a dark pixel is below the mean of its surroundings, in the sharpened image. Chosen:
half of it takes in noise, twice as much loses faint markers."""

COARSE_WINDOW = 5
"""Width, px of the image of half the size, of the surroundings there and of the boxes in which dark pixels
are counted. Chosen: about a small marker."""

CROWD_FACTOR, MIN_CROWD, MAX_CROWD = 2.2, 2.0, 6.0
"""Pixels crowd where the mean darkness of a box is so many times that of the whole image, within these bounds
in grey levels. Derived: noise of standard deviation σ is dark by 0.4 σ on average, to 0.12 σ over 25 pixels,
so that 2.2 times as much is four standard deviations off."""

CROWD_REACH = 9
"""Width, px of the image of half the size, of the box around each crowded pixel that is looked at. Chosen: an
edge's crowd must reach over the marker's border."""

MARGIN_PX = 16
"""Width of the margin around each place. Derived from what the box filters above reach, `(5 - 1) + (21 - 1) /
2` px, rounded up to an even number."""

MAX_MOSAIC_SHARE = 0.33
"""Share of the image's area beyond which the image is treated as a whole. Chosen: then laying out costs more
than it saves."""


@dataclass(frozen=True)
class Boundaries:
    """B closed boundaries of dark regions, anticlockwise as seen; those of holes in them run clockwise.

    Attributes:
        points: (P,) points of all boundaries, one boundary after the other, u + iv, px.
        lengths: (B,) number of points of each.
    """

    points: ComplexArray
    lengths: IntArray


ENLARGEMENT = 2
"""How many times as large an image is in which small squares are looked for. Chosen: at twice the size a cell
of a pixel and a half is as wide as the filters above; three would take more than twice the time of two."""

KNOWN_LINE_PX = 2 * COARSE_WINDOW - 1
"""Width, px of the image of half the size, of the line along the edges of known squares on which pixels do
not crowd. Derived: an edge darkens the means over `COARSE_WINDOW`, taken twice, as far as `COARSE_WINDOW - 1`
to either side."""


@dataclass(frozen=True)
class Mosaic:
    """K places of an image, laid side by side in one image.

    Attributes:
        image: of all places.
        mask: half the size, 255 where a pixel belongs to a place.
        begins: (K,) the first column of each place.
        offsets: (K,) shift from the mosaic to the image, u + iv, px.
    """

    image: Image
    mask: Image
    begins: IntArray
    offsets: ComplexArray

    def enlarged(self) -> "Mosaic":
        """Return the mosaic of an image that is `ENLARGEMENT` times as large."""
        image, mask = (
            np.asarray(cv2.resize(part, None, fx=ENLARGEMENT, fy=ENLARGEMENT, interpolation=how), np.uint8)
            for part, how in ((self.image, cv2.INTER_LINEAR), (self.mask, cv2.INTER_NEAREST))
        )
        return Mosaic(image, mask, ENLARGEMENT * self.begins, ENLARGEMENT * self.offsets)

    def shifts(self, columns: Array) -> ComplexArray:
        """Return the shifts (N,) to the image, u + iv, px, of what lies at columns (N,) of the mosaic."""
        return self.offsets[np.searchsorted(self.begins, columns, side="right") - 1]


@dataclass(frozen=True)
class DarkRegions:
    """The dark regions of an image.

    Attributes:
        dark: 255 where the mosaic's image is dark.
        mosaic: the places of the image that were looked at.
    """

    dark: Image
    mosaic: Mosaic

    def eroded(self) -> "DarkRegions":
        """Return the regions without their outermost pixels: what touches at a corner only comes apart."""
        square = np.ones((3, 3), dtype=np.uint8)
        return DarkRegions(np.asarray(cv2.erode(self.dark, square), dtype=np.uint8), self.mosaic)


def crowded_places(image: Image, known_px: Array | None = None, min_darkness: float = 0.0) -> Mosaic | None:
    """Return the places of an image where dark pixels crowd; None if there is none.

    Args:
        image: grey, (height, width), of which an odd last line or column is not looked at.
        known_px: (K, 4, 2) corners of squares, px, along whose edges pixels do not count as crowded. What
            crowds beside them does, and its place may reach over them.
        min_darkness: smallest mean darkness of a box, grey levels, that counts as crowded, if it is above
            what follows from the image.
    """
    height, width = (side - side % 2 for side in image.shape)
    if min(height, width) == 0:
        return None
    image = image[:height, :width]
    crowded = _crowded(image, np.zeros((0, 4, 2)) if known_px is None else known_px, min_darkness)
    return _mosaic(image, crowded) if crowded.any() else None


def dark_regions(mosaic: Mosaic) -> DarkRegions:
    """Return the dark regions of the places of an image."""
    mask = cv2.resize(mosaic.mask, mosaic.image.shape[::-1], interpolation=cv2.INTER_NEAREST)
    return DarkRegions(np.asarray(cv2.bitwise_and(_dark(mosaic.image), mask), dtype=np.uint8), mosaic)


def dark_boundaries(regions: DarkRegions, min_points: int) -> Boundaries:
    """Return the boundaries of dark regions that have `min_points` points or more."""
    mosaic = regions.mosaic
    contours, _ = cv2.findContours(regions.dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    boundaries = [contour for contour in contours if len(contour) >= min_points]
    if not boundaries:
        return Boundaries(np.zeros(0, dtype=complex), np.zeros(0, dtype=np.int64))
    lengths = np.array([len(boundary) for boundary in boundaries])
    joined = np.concatenate(boundaries)[:, 0].astype(float)
    shifts = mosaic.shifts(joined[np.cumsum(lengths) - lengths, 0])
    return Boundaries(joined[:, 0] + 1j * joined[:, 1] + np.repeat(shifts, lengths), lengths)


def _dark(image: Image) -> Image:
    """255 where an image is dark."""
    smooth, wide = _mean(image, SMOOTHING_PX), _mean(_mean(image, SHARPENING_PX), SHARPENING_PX)
    sharp = np.asarray(cv2.addWeighted(smooth, 2.0, wide, -1.0, 0.0), dtype=np.uint8)
    surroundings = cv2.max(*(_mean(sharp, width) for width in WINDOWS_PX))
    _, dark = cv2.threshold(cv2.subtract(surroundings, sharp), DARKER, 255, cv2.THRESH_BINARY)
    return np.asarray(dark, dtype=np.uint8)


def _mosaic(image: Image, crowded_mask: Image) -> Mosaic:
    """The places of an image where dark pixels crowd, or all of it if they are many."""
    contours, _ = cv2.findContours(crowded_mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    boxes = np.array([cv2.boundingRect(contour) for contour in contours], dtype=np.int64).reshape(-1, 4)
    low = 2 * boxes[:, :2] - MARGIN_PX
    widths, heights = (2 * boxes[:, 2:] + 2 * MARGIN_PX).T
    height = int(heights.max(initial=0))
    if not boxes.size or height * widths.sum() > MAX_MOSAIC_SHARE * image.size:
        return Mosaic(image, crowded_mask, np.zeros(1, dtype=np.int64), np.zeros(1, dtype=complex))
    begins = np.cumsum(widths) - widths
    mask = np.zeros((height // 2, int(widths.sum()) // 2), dtype=np.uint8)
    for contour, shift in zip(contours, (np.column_stack([begins, 0 * begins]) - low) // 2, strict=True):
        cv2.drawContours(mask, [contour], 0, 255, cv2.FILLED, offset=shift.tolist())
    crops = [
        _crop(image, x, y, width, height) for (x, y), width in zip(low.tolist(), widths.tolist(), strict=True)
    ]
    return Mosaic(np.hstack(crops), mask, begins, low[:, 0] - begins + 1j * low[:, 1])


def _crowded(image: Image, known_px: Array, min_darkness: float) -> Image:
    """255 around the pixels, of the image of half the size, where dark pixels crowd.

    Those along the edges of squares that are known, (K, 4, 2), px of the image, are left out.
    """
    half = np.asarray(
        cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA),
        dtype=np.uint8,
    )
    darkness = np.asarray(cv2.subtract(_mean(half, COARSE_WINDOW), half), dtype=np.uint8)
    crowd = np.clip(CROWD_FACTOR * cv2.mean(darkness)[0], MIN_CROWD, MAX_CROWD)
    least = max(float(crowd), min_darkness)
    _, crowded = cv2.threshold(_mean(darkness, COARSE_WINDOW), least, 255, cv2.THRESH_BINARY)
    for square in np.rint((known_px - 0.5) / 2).astype(np.int32):
        cv2.fillConvexPoly(crowded, square, 0)
        cv2.polylines(crowded, [square], True, 0, KNOWN_LINE_PX)
    reach = np.ones((CROWD_REACH, CROWD_REACH), dtype=np.uint8)
    return np.asarray(cv2.dilate(crowded, reach), dtype=np.uint8)


def _crop(image: Image, u: int, v: int, width: int, height: int) -> Image:
    """A part of an image, mirrored beyond the border, as box filters do at the border of a whole image."""
    inside = image[max(v, 0) : v + height, max(u, 0) : u + width]
    top, left = max(-v, 0), max(-u, 0)
    below, right = height - top - inside.shape[0], width - left - inside.shape[1]
    return np.asarray(
        cv2.copyMakeBorder(inside, top, below, left, right, cv2.BORDER_REFLECT_101), dtype=np.uint8
    )


def _mean(image: Image, width: int) -> Image:
    """Mean over a box around each pixel."""
    return np.asarray(cv2.blur(image, (width, width)), dtype=np.uint8)
