"""Bits by chance, as what a candidate may show instead of a marker: on its own grid, and on other grids."""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.blur_model import gather
from skyherd.markers.dictionary import border_cells
from skyherd.vision.native.pattern_records import PARTS
from skyherd.vision.photometric.evidence.pattern_fit import columns_of, densities, fit_cards
from skyherd.vision.photometric.evidence.readings import (
    BLURS_CELLS,
    Readings,
    cell_edges,
    cell_shares,
    exposed,
    part_places,
)

SPOILT_CELLS = 0.02
"""Prior probability that a cell shows the other colour, as under glare, a cover or where ink is worn. Chosen:
a marker of 36 bits then keeps enough evidence with two such cells, and one of 16 bits does not with one."""

RESOLVED_CELLS = 0.5
"""Blur, cells, up to which the bits of a marker are independent of each other. Chosen: contrast at the finest
pattern, `exp(-π² σ² / 2)`, is then 0.3. Beyond it the number of independent bits falls with the blur along
each axis. Measured: without it, one in 700 blurred squares of 16 px with text passes for one of the 587
markers of 36h11."""

OTHER_GRIDS = (3, 4, 5, 6, 7, 8)
"""Bits along the side of other grids. Chosen: those of common dictionaries."""


@dataclass(frozen=True)
class Drawn:
    """A pattern of each of N candidates.

    Attributes:
        white: (N, parts) whiteness, 0 to 1, before the image clips.
        blurs: (N,) numbers of its blurs in `BLURS_CELLS`.
        clips: (N,) whether the image clips.
    """

    white: Array
    blurs: IntArray
    clips: BoolArray


def log_bits(
    readings: Readings, white: Array, shares: Array, drawn: Drawn, stds: Array, dictionary: str
) -> Array:
    """Return the log likelihood ratio (N,) of the patterns' bits to bits by chance.

    Args:
        readings: of N candidates.
        white: (N, parts) whiteness that is read.
        shares: (N, parts) contrasts, share of the readings' range.
        drawn: the patterns.
        stds: (N,) noise, share of the readings' range.
        dictionary: of the markers.
    """
    n, border = readings.n_cells, border_cells(dictionary)
    clips = drawn.clips[:, None]
    response = np.where(clips, *(_cell_responses(n, clips=clip)[drawn.blurs] for clip in (True, False)))
    flipped = drawn.white + response * np.where(drawn.white > 0.5, -1, 1)
    priors, std = columns_of(n).outlier_priors, stds[:, None]
    inner = np.s_[:, 1 + border : -1 - border, 1 + border : -1 - border]
    own, other = (
        readings.weights[:, None, None]
        * (readings.seen * np.log(densities((white - exposed(pattern, clips)) * shares, std, priors)[1]))
        .reshape(-1, n + 2, PARTS, n + 2, PARTS)
        .sum(axis=(2, 4))[inner]
        for pattern in (drawn.white, flipped)
    )
    spoilt = np.logaddexp(math.log(1 - SPOILT_CELLS) + own, math.log(SPOILT_CELLS) + other)
    return np.asarray((spoilt + math.log(2) - np.logaddexp(own, other)).sum(axis=(1, 2)))


@lru_cache(maxsize=64)
def _cell_responses(n_cells: int, *, clips: bool) -> Array:
    """Return how much (blurs, parts) the colour of a part's own cell changes it before the image clips."""
    rows, places = np.arange(PARTS * (n_cells + 2)), part_places(n_cells)
    own = []
    for blur in BLURS_CELLS:
        axes = []
        for value in blur:
            edges = cell_edges(n_cells, n_cells, value, clips=clips)
            ends = [2 * edges[0] - edges[1]], [2 * edges[-1] - edges[-2]]
            axes.append(gather(places, np.concatenate([ends[0], edges, ends[1]]), value)[rows, rows // PARTS])
        own.append((axes[1][:, None] * axes[0]).ravel())
    return np.stack(own)


@lru_cache(maxsize=1)
def resolved_shares() -> Array:
    """Return the share (blurs,) of the bits that are independent of their neighbours under a blur."""
    return np.array([math.prod(min(1.0, RESOLVED_CELLS / value) for value in blur) for blur in BLURS_CELLS])


def log_grids(
    readings: Readings, whiteness: Array, blur: tuple[float, float], dictionary: str, *, clips: bool
) -> Array:
    """Return the log likelihoods (N,) of squares of other grids, each with the bits that readings show.

    They are summed over the grids, each weighted by the chance of its bits, `2^-bits`.
    """
    n = readings.n_cells
    side = PARTS * (n + 2)
    inside = whiteness.reshape(-1, side, side)[:, PARTS:-PARTS, PARTS:-PARTS].astype(np.float32)
    others = [bits for bits in OTHER_GRIDS if border_cells(dictionary) > 1 or bits != n - 2]
    drawn = []
    for bits in others:
        size = (bits + 2, bits + 2)
        black = np.stack([cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in inside]) < 0.5
        black[:, [0, -1]] = black[:, :, [0, -1]] = True
        along, down = (cell_shares(bits + 2, n, value, clips=clips) for value in blur)
        drawn.append(exposed(1 - down @ black.astype(float) @ along.T, clips).reshape(len(inside), -1))
    fits = fit_cards(readings, np.stack(drawn, axis=1))
    costs = -math.log(2) * np.square(others)
    return np.asarray(np.logaddexp.reduce(fits.logs + costs, axis=1))
