"""Light rectangles in a dark square, as what a candidate may show instead of a marker.

All rectangles whose edges lie on a grid are equally probable. Those that explain the readings best, by least
squares, are fitted as the patterns of markers are, on wide and on narrow cards.
"""

import math
from functools import lru_cache, partial

import numpy as np

from skyherd.geometry import Array
from skyherd.markers.blur_model import normal_cdf
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
    n = readings.n_cells
    along, down = (_stretches(n, value) for value in blurs_cells)
    square = [cell_shares(1, n, value, clips=clips)[:, 0] for value in blurs_cells]
    ground = 1 - square[1][:, None] * square[0]
    side, other = len(ground), ground - ground.mean()
    images = readings.levels.reshape(-1, side, side)
    basis = [np.full(ground.shape, 1 / side), other / np.linalg.norm(other)]
    for part in basis:
        images = images - (images * part).sum(axis=(1, 2), keepdims=True) * part
    own = np.multiply.outer((down**2).sum(axis=1), (along**2).sum(axis=1))
    left = own - sum((down @ part @ along.T) ** 2 for part in basis)
    gain = np.maximum(down @ images @ along.T, 0) ** 2 / np.maximum(left, MIN_UNEXPLAINED)
    best = np.argpartition(-gain.reshape(len(images), -1), MAX_RECTANGLES, axis=1)[:, :MAX_RECTANGLES]
    rows, columns = np.divmod(best, len(along))
    drawn = (down[rows][..., :, None] * along[columns][..., None, :]).reshape(*best.shape, -1)
    logs = _log_fits(readings, drawn, ground.ravel(), clips=clips)
    return np.asarray(np.logaddexp.reduce(logs, axis=1) - math.log(gain[0].size))


def _log_fits(readings: Readings, drawn: Array, ground: Array, *, clips: bool) -> Array:
    """Return the log likelihoods (N, K) of rectangles (N, K, parts) on wide or narrow cards.

    The square's surroundings, `ground` (parts,), have a level of their own. On a narrow card there are two:
    the card's is measured, and the one beyond it is fitted.
    """
    fit = partial(fit_patterns, readings, any_contrast=True)
    wide = fit(exposed(drawn, clips), exposed(ground[None], clips))
    best = np.arange(len(drawn)), wide.logs.argmax(axis=1)
    black, contrast = wide.levels[best][:, 0], np.maximum(wide.levels[best][:, 1], MIN_CONTRAST)
    narrow = []
    for beyond in narrow_grounds(readings.n_cells):
        card = np.maximum(ground - beyond, 0.0)
        whiteness = (readings.levels @ (card / card.sum()) - black) / contrast
        on_card = drawn + whiteness[:, None, None] * ground
        narrow.append(fit(exposed(on_card, clips), beyond[None]).logs)
    logs = np.logaddexp.reduce(narrow, axis=0) + math.log(NARROW_ODDS / len(narrow))
    return np.asarray(np.logaddexp(wide.logs + math.log(1 - NARROW_ODDS), logs))


@lru_cache(maxsize=64)
def _stretches(n_cells: int, blur_cells: float) -> Array:
    """Return shares (S, side) of all stretches along an axis that a light rectangle may cover."""
    edges = np.arange(0.5, n_cells - 0.49, RECTANGLE_STEP)
    steps = normal_cdf((part_places(n_cells)[None] - edges[:, None]) / blur_cells)
    low, high = np.triu_indices(edges.size, k=2)
    return np.asarray(steps[low] - steps[high])
