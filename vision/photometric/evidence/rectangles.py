"""Light rectangles in a dark square, as what a candidate may show instead of a marker.

All rectangles whose edges lie on a grid are equally probable. Those that explain the readings best, by least
squares, are fitted as the patterns of markers are, on wide and on narrow cards.
"""

import math
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.markers.blur_model import normal_cdf
from skyherd.vision.native.library import library
from skyherd.vision.photometric.evidence.pattern_fit import NARROW_ODDS, fit_patterns, narrow_grounds
from skyherd.vision.photometric.evidence.readings import (
    MIN_CONTRAST,
    Readings,
    cell_shares,
    exposed,
    part_places,
)

MAX_RECTANGLES, RECTANGLE_STEP = 12, 0.25
"""Light rectangles that are fitted, and the grid of their edges in cells. Chosen: finer edges are blurred.
Measured with edges on a grid of 1/16 for the best one: on large images of clutter no false positive of eight
less, and under odd conditions 5 of 1,920 markers of 4X4_50 more are lost."""

MIN_UNEXPLAINED = 1e-3
"""Smallest part of a rectangle's square that the ground does not explain; it is divided by."""


def log_rectangles(readings: Readings, blurs_cells: tuple[float, float], *, clips: bool) -> Array:
    """Return the log likelihoods (N,) of light rectangles in a dark square, by the best of them.

    Args:
        readings: of N candidates.
        blurs_cells: blurs of the image along x and y.
        clips: whether the image clips.
    """
    drawn = _rectangles(readings.n_cells, blurs_cells, clips)
    images = readings.levels.reshape(-1, *drawn.ground.shape)
    for part in drawn.basis:
        images = images - (images * part).sum(axis=(1, 2), keepdims=True) * part
    sums = np.ascontiguousarray(drawn.down @ images @ drawn.along.T)
    best = library().best_rectangles(sums, drawn.unexplained, MAX_RECTANGLES)
    rows, columns = np.divmod(best, len(drawn.unexplained))
    low, high = _stretches(len(drawn.along))
    along, down = drawn.along[low] - drawn.along[high], drawn.down[low] - drawn.down[high]
    white = (down[rows][..., :, None] * along[columns][..., None, :]).reshape(*best.shape, -1)
    logs = _log_fits(readings, white, drawn.ground.ravel(), clips=clips)
    return np.asarray(np.logaddexp.reduce(logs, axis=1) - math.log(drawn.unexplained.size))


@dataclass(frozen=True)
class _Rectangles:
    """All rectangles with edges on the grid, in a square on a ground, under a blur.

    Attributes:
        along, down: (E, side) steps at each edge along either axis. A rectangle is the product of a stretch
            along each, which is the difference of two steps.
        ground: (side, side) whiteness of the square's surroundings.
        basis: orthonormal planes (side, side) of a constant level and of the ground.
        unexplained: (S, S) squares of the rectangles that the basis does not explain.
    """

    along: Array
    down: Array
    ground: Array
    basis: tuple[Array, ...]
    unexplained: Array


@lru_cache(maxsize=64)
def _rectangles(n_cells: int, blurs_cells: tuple[float, float], clips: bool) -> _Rectangles:
    """Return the rectangles in a square of n cells under blurs along x and y."""
    edges = np.arange(0.5, n_cells - 0.49, RECTANGLE_STEP)
    along, down = (normal_cdf((part_places(n_cells)[None] - edges[:, None]) / blur) for blur in blurs_cells)
    columns, rows = (cell_shares(1, n_cells, blur, clips=clips)[:, 0] for blur in blurs_cells)
    ground = 1 - rows[:, None] * columns
    other = ground - ground.mean()
    basis = np.full(ground.shape, 1 / len(ground)), other / np.linalg.norm(other)
    low, high = _stretches(edges.size)
    squares = [np.square(steps[low] - steps[high]).sum(axis=1) for steps in (down, along)]
    explained = sum(_over_rectangles(down @ part @ along.T) ** 2 for part in basis)
    unexplained = np.maximum(np.multiply.outer(*squares) - explained, MIN_UNEXPLAINED)
    return _Rectangles(along, down, ground, basis, unexplained)


@lru_cache(maxsize=16)
def _stretches(edges: int) -> tuple[IntArray, IntArray]:
    """Return the first and last edges (S,) of all stretches of two steps of the grid or more."""
    low, high = np.triu_indices(edges, k=2)
    return low, high


def _over_rectangles(sums: Array) -> Array:
    """Return sums (..., S, S) over rectangles, by those (..., E, E) beyond pairs of edges."""
    low, high = _stretches(sums.shape[-1])
    rows = sums[..., low, :] - sums[..., high, :]
    return np.asarray(rows[..., low] - rows[..., high])


def _log_fits(readings: Readings, drawn: Array, ground: Array, *, clips: bool) -> Array:
    """Return the log likelihoods (N, K) of rectangles (N, K, parts) on wide or narrow cards.

    The square's surroundings, `ground` (parts,), have a level of their own, also without a card. On a narrow
    card there are two: the card's is measured, and the one beyond it is fitted.
    """
    fit = partial(fit_patterns, readings, any_contrast=True)
    wide = fit(exposed(drawn, clips), exposed(ground[None], clips))
    best = np.arange(len(drawn)), wide.logs.argmax(axis=1)
    black, contrast = wide.levels[best][:, 0], np.maximum(wide.levels[best][:, 1], MIN_CONTRAST)
    no_card, *cards = narrow_grounds(readings.n_cells)
    narrow = [fit(exposed(drawn + ground, clips), no_card[None]).logs]
    for beyond in cards:
        card = np.maximum(ground - beyond, 0.0)
        whiteness = (readings.levels - black[:, None]) @ card / (contrast * (ground @ card))
        on_card = drawn + whiteness[:, None, None] * ground
        narrow.append(fit(exposed(on_card, clips), beyond[None]).logs)
    logs = np.logaddexp.reduce(narrow, axis=0) + math.log(NARROW_ODDS / len(narrow))
    return np.asarray(np.logaddexp(wide.logs + math.log(1 - NARROW_ODDS), logs))
