"""The image type of all detectors, its validation, and downsampling by an integer factor."""

import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Array, Image
from skyherd.vision.native.library import library
from skyherd.vision.native.records import Floats

__all__ = ["Image", "block_means", "check_grey", "sample_squares"]


def check_grey(image: Image) -> Image:
    """Return the image as a contiguous array; copy it only if it is not contiguous.

    Raises:
        InputError: the image is not a two-dimensional array (height, width) of uint8, or it is empty.
    """
    if not isinstance(image, np.ndarray):
        raise InputError("image", f"a {type(image).__name__}", "grey, (height, width), uint8")
    if image.ndim != 2 or image.dtype != np.uint8 or min(image.shape) < 1:
        allowed = "grey, (height, width), uint8"
        if image.ndim == 3:
            allowed += "; cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) converts colour"
        raise InputError("image", f"shape {image.shape}, {image.dtype}", allowed)
    return np.ascontiguousarray(image)


def block_means(image: Image, side: int) -> Image:
    """Return the image downsampled by `side`, 2 or more: rounded means over blocks of that side.

    Rows and columns beyond the last whole block are ignored. An image smaller than one block gives shape
    (0, 0).
    """
    if min(image.shape) < side:
        return np.zeros((0, 0), dtype=np.uint8)
    return library().block_means(np.ascontiguousarray(image), side)


def sample_squares(image: Image, corners_px: Array, at: Array, fine: int = 1) -> Floats:
    """Return grey levels (N, S, S) on a grid within quadrilaterals, by bilinear interpolation.

    Places outside of the image read the nearest pixel of its border.

    Args:
        image: grey, (height, width).
        corners_px: (N, 4, 2) images of the unit square's corners (0, 0), (1, 0), (1, 1) and (0, 1), px.
        at: (S fine,) places along either axis of the square. They may lie beyond it.
        fine: neighbouring places along either axis whose mean is a level.
    """
    corners_px = np.ascontiguousarray(corners_px, dtype=float)
    return library().sampled_squares(np.ascontiguousarray(image), corners_px, np.asarray(at, float), fine)
