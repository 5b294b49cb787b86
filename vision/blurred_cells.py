"""Cells of markers under blur, and how well cells read in an image agree with them.

A marker's cells, seen through a Gaussian blur on a white ground without end, have the grey levels
`1 - E B Eᵀ`, with B the black cells and E the matrix that gathers a row of cells
(`skyherd.markers.blur_model`). Readings are compared by their correlation, which does not depend on
brightness and contrast.
"""

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, BoolArray
from skyherd.markers.blur_model import gather

MIN_DEVIATION = 1e-6
"""Smallest standard deviation that readings are divided by, so that flat ones have correlation 0 with
everything. Chosen far below the rounding of grey levels."""


def blurred_darkness(white: BoolArray, blur_cells: float, samples_per_cell: int, samples: int = 1) -> Array:
    """Return how dark markers appear under blur, (M, S, S): 0 for white, 1 for black, S = n samples_per_cell.

    Args:
        white: (M, n, n) white cells of M markers.
        blur_cells: standard deviation of the blur, in cells.
        samples_per_cell: values returned for each cell along each axis.
        samples: points that are averaged into one value along each axis.
    """
    gathered = _gathered(white.shape[1], blur_cells, samples_per_cell, samples)
    return np.asarray(gathered @ (~white).astype(float) @ gathered.T)


@lru_cache(maxsize=64)
def _gathered(n: int, blur_cells: float, samples_per_cell: int, samples: int) -> Array:
    """Shares (S, n) of n cells in a row that each of its S values gathers; the last 64 are kept."""
    points = (np.arange(n * samples_per_cell * samples) + 0.5) / (samples_per_cell * samples)
    gathered = gather(points, np.arange(n + 1.0), blur_cells)
    return np.asarray(gathered.reshape(n * samples_per_cell, samples, n).mean(axis=1))


def standardised(rows: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.floating[Any]]:
    """Return rows (M, K) shifted and scaled to mean 0 and standard deviation 1, in their own precision.

    The correlation of two rows is then their inner product over K.
    """
    centred = rows - rows.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(centred.std(axis=1, keepdims=True), MIN_DEVIATION))


def correlations(
    patterns: npt.NDArray[np.floating[Any]], readings: npt.NDArray[np.floating[Any]]
) -> npt.NDArray[np.floating[Any]]:
    """Return the correlation (N, M) of each of N rows of readings (N, K) with each of M patterns (M, K)."""
    return np.asarray(standardised(readings) @ standardised(patterns).T / readings.shape[1])
