"""Bilinear resampling of an image through a homography, by the cheaper affine warp where that is exact."""

from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array

Pixel = TypeVar("Pixel", np.uint8, np.float32)

AFFINE = 1e-12
"""Last rows whose first two entries are smaller than this, relative to the third, are affine."""


def warp(
    source: npt.NDArray[Pixel], source_image: Array, size_px: tuple[int, int], *, wrap: bool = False
) -> npt.NDArray[Pixel]:
    """Image of `size_px` (width, height) whose pixel x is `source` at `source_image` (3, 3) times x.

    Outside `source` lies zero, or its own repetition with `wrap`.
    """
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    border = cv2.BORDER_WRAP if wrap else cv2.BORDER_CONSTANT
    matrix = source_image / source_image[2, 2]
    if np.abs(matrix[2, :2]).max() < AFFINE:
        drawn = cv2.warpAffine(source, matrix[:2], size_px, flags=flags, borderMode=border)
    else:
        drawn = cv2.warpPerspective(source, matrix, size_px, flags=flags, borderMode=border)
    return np.asarray(drawn, dtype=source.dtype)
