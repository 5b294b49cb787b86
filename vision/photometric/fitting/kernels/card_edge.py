"""The ground beyond a marker's card: the share of it in a pixel, and the weight that is left of the pixel."""

import math
from typing import Any

import numpy as np
from numba import njit

from skyherd.jobs.compilation import INLINE
from skyherd.vision.photometric.fitting.kernels.blurred_edges import step

_ZERO, _ONE = np.float32(0), np.float32(1)


@njit(**INLINE)
def ground_and_weight(x: Any, y: Any, half_card: Any, x_rate: Any, y_rate: Any, texture_square: Any) -> Any:
    """Return the share g of ground in the pixel at (x, y), and its weight `1 / sqrt(1 + t² g²)`.

    Args:
        x: marker coordinate, in sides.
        y: the same, down.
        half_card: distance of the card's edge from the centre, in sides.
        x_rate: standard deviations of the blur along x to a side.
        y_rate: the same along y.
        texture_square: t², variance of the ground's texture over that of the noise.
    """
    ground = _ONE - step((half_card - abs(x)) * x_rate) * step((half_card - abs(y)) * y_rate)
    weight = _ONE
    if ground > _ZERO:
        weight /= np.float32(math.sqrt(_ONE + texture_square * ground * ground))
    return ground, weight
