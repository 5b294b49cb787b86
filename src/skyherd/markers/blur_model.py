"""Model of a marker card under a Gaussian blur, shared by the Cramér–Rao bound and the detector.

A card is a grid of uniform cells. Its image under a Gaussian of standard deviation sigma separates:

    F(y, x) = Σ_r Σ_c E_r(y) L_rc E_c(x),   E_c(x) = Φ((x - e_c) / σ) - Φ((x - e_{c+1}) / σ),

with L the cells' grey levels, e their edges and Φ the normal distribution.
"""

import math
from dataclasses import dataclass

import numpy as np

from skyherd.geometry import UNIFORM_VARIANCE, Array
from skyherd.markers.dictionary import QUIET_ZONE_CELLS


def total_sigma_px(psf_px: float) -> float:
    """Return the standard deviation of lens and pixel together, px: `sqrt(psf² + 1/12)`.

    `psf_px` is the standard deviation of the lens's blur; 1/12 px² is the variance of a square pixel.
    """
    return float(np.sqrt(psf_px**2 + UNIFORM_VARIANCE))


def cell_edges(n_cells: int, side: float) -> Array:
    """Return the edges (n + 3,) of a card's cells along one axis: quiet zone, n cells, quiet zone.

    They are measured from the card's centre, in the unit of `side`, the side of the black square.
    """
    lines = np.concatenate([[-QUIET_ZONE_CELLS], np.arange(n_cells + 1), [n_cells + QUIET_ZONE_CELLS]])
    return np.asarray(side * (lines / n_cells - 0.5))


@dataclass(frozen=True)
class Gathered:
    """Weights of cells under a Gaussian, with derivatives; each (samples, cells).

    Attributes:
        value: E, the weights.
        slope: dE/dx.
        curvature: d²E/dx².
    """

    value: Array
    slope: Array
    curvature: Array


def normal_cdf(x: Array) -> Array:
    """Return Φ(x), the normal distribution function, at each element of an array of any shape.

    It needs no import of SciPy, which would take a fifth of a second when a program starts.
    """
    return np.asarray(_ERFC(x / -math.sqrt(2)), dtype=float) / 2


_ERFC = np.frompyfunc(math.erfc, 1, 1)
"""Complementary error function of each element."""


def gather(x: Array, edges: Array, sigma: float) -> Array:
    """Return the weight E (samples, cells) of each cell under a Gaussian at each x.

    Args:
        x: (samples,) positions along the axis.
        edges: (cells + 1,) of the cells, ascending.
        sigma: standard deviation of the Gaussian; all in one unit.
    """
    steps = normal_cdf((x[:, None] - edges[None, :]) / sigma)
    return np.asarray(steps[:, :-1] - steps[:, 1:])


def gather_with_derivatives(x: Array, edges: Array, sigma: float) -> Gathered:
    """Return `gather` with its derivatives along x; by the heat equation, dE/dσ is `σ d²E/dx²`."""
    z = (x[:, None] - edges[None, :]) / sigma
    bell = np.exp(-z * z / 2) / (np.sqrt(2 * np.pi) * sigma)
    bend = -z * bell / sigma
    return Gathered(gather(x, edges, sigma), bell[:, :-1] - bell[:, 1:], bend[:, :-1] - bend[:, 1:])
