"""The columns of the linear model at one pixel, from what the blurred marker looks like there.

The formulas are those of `skyherd.vision.photometric.fitting.design_matrix`.
"""

from typing import Any

import numpy as np
from numba import njit

from skyherd.jobs.compilation import INLINE
from skyherd.vision.photometric.fitting.design_matrix import (
    ANISOTROPY,
    BLACK,
    BLUR,
    CONTRAST,
    DOWN,
    GROUND,
    GROW,
    KEYSTONE,
    LIGHT,
    MIDDLE_GREY,
    PIXEL_ROW,
    RIGHT,
    TONE,
    TURN,
)

_ONE, _GREY = np.float32(1), np.float32(MIDDLE_GREY)
_ANISOTROPY_X, _ANISOTROPY_Y = ANISOTROPY
_LIGHT_X, _LIGHT_Y = LIGHT
_KEYSTONE_X, _KEYSTONE_Y = KEYSTONE
_TONE = TONE[0]


@njit(**INLINE)
def write_columns(
    columns: Any,
    row: Any,
    x: Any,
    y: Any,
    white: Any,
    slope_x: Any,
    slope_y: Any,
    log_blur: Any,
    ground: Any,
    weight: Any,
    ratio: Any,
    grey: Any,
) -> None:
    """Write down what the model's columns are at one pixel.

    Args:
        columns: (P, 16) the result.
        row: of the pixel.
        x: marker coordinate of the pixel, towards the marker's right, in sides.
        y: the same, down.
        white: T.
        slope_x: T_x times the weight.
        slope_y: T_y times the weight.
        log_blur: T_log σ.
        ground: the share of ground beyond the card.
        weight: of the pixel.
        ratio: black level over contrast.
        grey: level of the pixel itself.
    """
    contrast = white * weight
    grow = -(x * slope_x + y * slope_y)
    light = ratio * weight + contrast
    columns[row, BLACK] = weight
    columns[row, CONTRAST] = contrast
    columns[row, RIGHT] = -slope_x
    columns[row, DOWN] = -slope_y
    columns[row, TURN] = y * slope_x - x * slope_y
    columns[row, GROW] = grow
    columns[row, BLUR] = log_blur * weight
    columns[row, GROUND] = ground * weight
    columns[row, _ANISOTROPY_X] = y * slope_y - x * slope_x
    columns[row, _ANISOTROPY_Y] = -(y * slope_x + x * slope_y)
    columns[row, _LIGHT_X] = x * light
    columns[row, _LIGHT_Y] = y * light
    columns[row, _KEYSTONE_X] = -grow * x
    columns[row, _KEYSTONE_Y] = -grow * y
    columns[row, _TONE] = contrast * (_ONE - white)
    columns[row, PIXEL_ROW] = (np.float32(grey) - _GREY) * weight
