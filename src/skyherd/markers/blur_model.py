"""A marker card under a Gaussian: the model of lens and pixel that drawing and fitting share.

A card is a grid of flat cells, so its image under a Gaussian of standard deviation sigma separates:

    F(y, x) = Σ_r Σ_c E_r(y) L_rc E_c(x),   E_c(x) = Φ((x - e_c) / σ) - Φ((x - e_{c+1}) / σ),

with L the cells' grey levels, e their edges and Φ the normal distribution.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from skyherd.geometry import UNIFORM_VARIANCE, Array
from skyherd.markers.dictionary import QUIET_ZONE_CELLS


def total_sigma_px(psf_px: float) -> float:
    """Standard deviation, px, of lens and pixel together."""
    return float(np.sqrt(psf_px**2 + UNIFORM_VARIANCE))


def cell_edges(n_cells: int, side: float) -> Array:
    """Edges (n + 3,) of a card's cells along one axis, from its centre: quiet zone, n cells, quiet zone."""
    lines = np.concatenate([[-QUIET_ZONE_CELLS], np.arange(n_cells + 1), [n_cells + QUIET_ZONE_CELLS]])
    return np.asarray(side * (lines / n_cells - 0.5))


@dataclass(frozen=True)
class Gathered:
    """E (samples, cells) and its first and second derivatives along x: how the Gaussian gathers cells."""

    value: Array
    slope: Array
    curvature: Array


def gather(x: Array, edges: Array, sigma: float) -> Array:
    """E (samples, cells): how much of each cell the Gaussian gathers at each x."""
    steps = ndtr((x[:, None] - edges[None, :]) / sigma)
    return np.asarray(steps[:, :-1] - steps[:, 1:])


def gather_with_derivatives(x: Array, edges: Array, sigma: float) -> Gathered:
    """E and dE/dx, d²E/dx²; by the heat equation `dE/dσ = σ d²E/dx²`."""
    z = (x[:, None] - edges[None, :]) / sigma
    bell = np.exp(-z * z / 2) / (np.sqrt(2 * np.pi) * sigma)
    bend = -z * bell / sigma
    return Gathered(gather(x, edges, sigma), bell[:, :-1] - bell[:, 1:], bend[:, :-1] - bend[:, 1:])
