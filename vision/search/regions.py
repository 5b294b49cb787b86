"""Boundaries of the dark regions of an image: where markers may be.

A pixel is dark if it is below the mean of its surroundings by a constant. An image of half the size tells
first where that may be worth asking: around a marker's edge pixels are dark by much and in number, those of
noise and texture are not. The places found are laid side by side and treated as one image.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from skyherd.geometry import ComplexArray, IntArray
from skyherd.vision.grey import Image

SMOOTHING_PX = 3
"""Width of the box that takes noise off before the threshold."""

SHARPENING_PX = 5
"""Width of the box whose mean, taken twice, is taken off again: blur closes the white between a border and
its ground."""

WINDOWS_PX = (9, 21)
"""Widths of the surroundings: small ones part crowded edges, large ones fill thick borders."""

DARKER = 10
"""By how many grey levels a dark pixel is below the mean of its surroundings, in the sharpened image."""

COARSE_WINDOW = 5
"""Width of the boxes in the image of half the size, for surroundings and crowds alike."""

CROWDED, LEAST_CROWDED, MOST_CROWDED = 2.2, 2.0, 6.0
"""A crowd's mean darkness must be so many times the whole image's, within these bounds in grey levels."""

AROUND = 9
"""Width of the box around each crowded pixel, in the image of half the size, that is looked at."""

MARGIN_PX = 16
"""What the boxes above reach, rounded up to an even number: (5 - 1) + (21 - 1) / 2 pixels."""

MOST_LAID_OUT = 0.33
"""Share of the image beyond which it is treated whole."""


@dataclass(frozen=True)
class Boundaries:
    """B closed boundaries of an image's dark regions, anticlockwise as seen; those of holes run clockwise.

    Attributes:
        points: (P,) of all of them, one after the other, `u + iv`.
        lengths: (B,) how many points each has.
    """

    points: ComplexArray
    lengths: IntArray


@dataclass(frozen=True)
class Sheet:
    """Places of an image side by side.

    Attributes:
        image: of all of them.
        mask: what of it belongs to them, in half the size.
        begins: (K,) their first columns.
        offsets: (K,) from the sheet to the image, `u + iv`.
    """

    image: Image
    mask: Image
    begins: IntArray
    offsets: ComplexArray


def dark_boundaries(image: Image, least_points: int) -> Boundaries:
    """Boundaries of so many points or more; an odd last line or column of the image is not looked at."""
    none = Boundaries(np.zeros(0, dtype=complex), np.zeros(0, dtype=np.int64))
    height, width = (side - side % 2 for side in image.shape)
    if min(height, width) == 0:
        return none
    sheet = _lay_out(image[:height, :width])
    mask = cv2.resize(sheet.mask, sheet.image.shape[::-1], interpolation=cv2.INTER_NEAREST)
    dark = cv2.bitwise_and(_dark(sheet.image), mask)
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    boundaries = [contour for contour in contours if len(contour) >= least_points]
    if not boundaries:
        return none
    lengths = np.array([len(boundary) for boundary in boundaries])
    joined = np.concatenate(boundaries)[:, 0].astype(float)
    place = np.searchsorted(sheet.begins, joined[np.cumsum(lengths) - lengths, 0], side="right") - 1
    return Boundaries(joined[:, 0] + 1j * joined[:, 1] + np.repeat(sheet.offsets[place], lengths), lengths)


def _dark(image: Image) -> Image:
    """255 where an image is dark."""
    smooth, wide = _mean(image, SMOOTHING_PX), _mean(_mean(image, SHARPENING_PX), SHARPENING_PX)
    sharp = np.asarray(cv2.addWeighted(smooth, 2.0, wide, -1.0, 0.0), dtype=np.uint8)
    surroundings = cv2.max(*(_mean(sharp, width) for width in WINDOWS_PX))
    _, dark = cv2.threshold(cv2.subtract(surroundings, sharp), DARKER, 255, cv2.THRESH_BINARY)
    return np.asarray(dark, dtype=np.uint8)


def _lay_out(image: Image) -> Sheet:
    """The places of an image that are worth a look, or all of it if they are many."""
    busy = _busy(image)
    contours, _ = cv2.findContours(busy, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    boxes = np.array([cv2.boundingRect(contour) for contour in contours], dtype=np.int64).reshape(-1, 4)
    low = 2 * boxes[:, :2] - MARGIN_PX
    widths, heights = (2 * boxes[:, 2:] + 2 * MARGIN_PX).T
    height = int(heights.max(initial=0))
    if not boxes.size or height * widths.sum() > MOST_LAID_OUT * image.size:
        return Sheet(image, busy, np.zeros(1, dtype=np.int64), np.zeros(1, dtype=complex))
    begins = np.cumsum(widths) - widths
    mask = np.zeros((height // 2, int(widths.sum()) // 2), dtype=np.uint8)
    for contour, shift in zip(contours, (np.column_stack([begins, 0 * begins]) - low) // 2, strict=True):
        cv2.drawContours(mask, [contour], 0, 255, cv2.FILLED, offset=shift.tolist())
    crops = [
        _crop(image, x, y, width, height) for (x, y), width in zip(low.tolist(), widths.tolist(), strict=True)
    ]
    return Sheet(np.hstack(crops), mask, begins, low[:, 0] - begins + 1j * low[:, 1])


def _busy(image: Image) -> Image:
    """255 around pixels of the image of half the size that are dark in a crowd."""
    half = np.asarray(
        cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA),
        dtype=np.uint8,
    )
    darkness = np.asarray(cv2.subtract(_mean(half, COARSE_WINDOW), half), dtype=np.uint8)
    crowd = np.clip(CROWDED * cv2.mean(darkness)[0], LEAST_CROWDED, MOST_CROWDED)
    _, crowded = cv2.threshold(_mean(darkness, COARSE_WINDOW), crowd, 255, cv2.THRESH_BINARY)
    return np.asarray(cv2.dilate(crowded, np.ones((AROUND, AROUND), dtype=np.uint8)), dtype=np.uint8)


def _crop(image: Image, u: int, v: int, width: int, height: int) -> Image:
    """A part of an image, mirrored where it goes beyond the border, as the boxes' means have it."""
    inside = image[max(v, 0) : v + height, max(u, 0) : u + width]
    top, left = max(-v, 0), max(-u, 0)
    below, right = height - top - inside.shape[0], width - left - inside.shape[1]
    return np.asarray(
        cv2.copyMakeBorder(inside, top, below, left, right, cv2.BORDER_REFLECT_101), dtype=np.uint8
    )


def _mean(image: Image, width: int) -> Image:
    """Mean over a box around each pixel."""
    return np.asarray(cv2.blur(image, (width, width)), dtype=np.uint8)
