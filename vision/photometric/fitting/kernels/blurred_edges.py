"""Edges under a Gaussian blur: Φ and its derivatives from tables, and which edges of cells are in reach.

In marker coordinates z = x + iy, in sides, with black as 0 and white as 1, a marker on an endless white
ground seen under a Gaussian of standard deviation σ separates (`skyherd.markers.blur_model`):

    T(y, x) = 1 - Σ_r Σ_c E_r(y) B_rc E_c(x),   E_c(x) = Φ((x - e_c) / σ) - Φ((x - e_{c+1}) / σ),

with B_rc = 1 where the cell is black and e the cells' edges. Summed by edges instead of cells, a row of cells
is `Σ_c B_c E_c(x) = B_f + Σ_e (B_e - B_{e-1}) Φ((x - e) / σ)`, in which only edges within `REACH_SIGMAS` of x
count: those further left are passed, up to the cell f, and those further right are not reached. Most pixels
have an edge or two in reach.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from scipy.special import ndtr

from skyherd.jobs.compilation import INLINE

REACH_SIGMAS = 5
"""Edges of cells further from a pixel than this many standard deviations of the blur count as passed or as
not reached. Chosen: Φ is within 3e-7 of its limits there, and its second derivative within 8e-6."""

NODES_PER_SIGMA = 64
"""Tabulated values of Φ and φ to one standard deviation. Derived: the series about the nearest node leaves
`(1/128)³ / 6` of the third derivative: 3e-8 of Φ and 1e-7 of φ, the rounding of single precision."""

MIDDLE_NODE = REACH_SIGMAS * NODES_PER_SIGMA + 2
"""Index of Φ(0) and φ(0) in their tables. Derived, with two entries beyond the reach on either side: places
in reach are rounded, by 1/200 of a standard deviation in the sharpest blur (`design_matrix.SIGMA_LIMITS`)."""

_NODES = (np.arange(2 * MIDDLE_NODE + 1) - MIDDLE_NODE) / NODES_PER_SIGMA
_STEP = ndtr(_NODES).astype(np.float32)
_BELL = (np.exp(-(_NODES**2) / 2) / math.sqrt(2 * math.pi)).astype(np.float32)
_ZERO, _HALF, _ONE = (np.float32(number) for number in (0, 0.5, 1))
_REACH, _NODE_WIDTH = np.float32(REACH_SIGMAS), np.float32(1 / NODES_PER_SIGMA)
_RATE = np.float32(NODES_PER_SIGMA)


@njit(**INLINE)
def _node(place: Any) -> tuple[Any, Any, Any]:
    """Return the tables' entry nearest to a place in standard deviations, its place, and its distance."""
    node = np.uintp(place * _RATE + np.float32(MIDDLE_NODE + 0.5))
    there = np.float32(np.intp(node) - MIDDLE_NODE) * _NODE_WIDTH
    return node, there, place - there


@njit(**INLINE)
def step(place: Any) -> Any:
    """Φ at a place in standard deviations."""
    if not place < _REACH:
        return _ONE
    if place <= -_REACH:
        return _ZERO
    node, there, off = _node(place)
    return _STEP[node] + _BELL[node] * off * (_ONE - _HALF * there * off)


@njit(**INLINE)
def step_and_bell(place: Any) -> tuple[Any, Any]:
    """Φ and φ at a place in reach, standard deviations."""
    node, there, off = _node(place)
    bell = _BELL[node]
    value = _STEP[node] + bell * off * (_ONE - _HALF * there * off)
    return value, bell * (_ONE - off * (there - _HALF * (there * there - _ONE) * off))


@njit(**INLINE)
def edges_in_reach(position: Any, reach: Any, edges: int) -> tuple[Any, Any]:
    """Return the first edge of cells along one axis within reach of a position, and the first beyond.

    Edge k has cell k on its left, where cells 0 and n + 1 are the ground on either side.

    Args:
        position: in cells, from the first edge of the marker.
        reach: in cells.
        edges: how many there are, n + 1.
    """
    first = min(max(int(position - reach + _ONE), 0), edges)
    end = max(min(int(position + reach + _ONE), edges), first)
    return np.uintp(first), np.uintp(end)
