"""Model of a marker's cells under blur, and its correlation with cells sampled in an image.

Under a Gaussian blur and on an infinite white ground, the cells have the grey levels `1 - E B Eᵀ`. B is the
matrix of black cells, and E is the separable blur of one row of cells (`skyherd.markers.blur_model`). The
correlation of samples and model is independent of brightness and contrast.
"""

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray
from skyherd.markers.blur_model import gather

MIN_DEVIATION = 1e-6
"""Smallest divisor of samples; uniform samples then have correlation 0 with every pattern.
Chosen: far below the rounding of grey levels."""


def blurred_darkness(white: BoolArray, blur_cells: float, samples_per_cell: int, samples: int = 1) -> Array:
    """Return the darkness (M, S, S) of blurred markers: 0 for white, 1 for black, S = n samples_per_cell.

    Args:
        white: (M, n, n) mask of the white cells of M markers.
        blur_cells: standard deviation of the blur, in cells.
        samples_per_cell: values per cell along each axis of the result.
        samples: points per value along each axis; a value is their mean.
    """
    gathered = _gathered(white.shape[1], blur_cells, samples_per_cell, samples)
    return np.asarray(gathered @ (~white).astype(float) @ gathered.T)


@lru_cache(maxsize=64)
def _gathered(n: int, blur_cells: float, samples_per_cell: int, samples: int) -> Array:
    """Return the weights (S, n) of n cells of a row in each of its S values. The cache holds 64 results."""
    points = (np.arange(n * samples_per_cell * samples) + 0.5) / (samples_per_cell * samples)
    gathered = gather(points, np.arange(n + 1.0), blur_cells)
    return np.asarray(gathered.reshape(n * samples_per_cell, samples, n).mean(axis=1))


def standardised(rows: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.floating[Any]]:
    """Return rows (M, K) standardised to mean 0 and standard deviation 1, in their own precision.

    The correlation of two standardised rows is their inner product divided by K.
    """
    centred = rows - rows.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(centred.std(axis=1, keepdims=True), MIN_DEVIATION))
