"""Drawn patterns fitted to readings: light, ground, outliers and noise of each hypothesis.

The model of the readings y at places (x, y), in sides from the centre, under a pattern of whiteness w (0 to
1, blurred) is

    y = b + c w + (g x + h y) + (p x + q y) w [+ d r] + e,    e ~ (1 - a) N(0, s²) + a / range.

Light may change along the marker, as a sum and as a factor. Parts may be outliers with probability a: salt, a
pen line, a cover. Parts that glare saturates do not count. The ground beyond a narrow card, whose share of a
part is r, has a level of its own. Levels and noise s are fitted to each hypothesis by expectation
maximisation. The contrast c is therefore that of the marker itself.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.markers.blur_model import gather
from skyherd.vision.photometric.readings import MIN_CONTRAST, PARTS, Readings, on_marker, part_places

CARD_OUTLIERS, ZONE_OUTLIERS = 0.04, 0.3
"""Prior probability that a part is an outlier, on the marker and in the zone around it. Chosen: the zone is
often cut, narrow or covered."""

OUTLIER_RANGE = 3.0
"""Range of outliers, in units of the readings' range. Chosen: saturated glare beside a dark marker."""

FIRST_ZONE_SHARE = 0.2
"""Weight of the parts around the marker in the first step of a fit. Chosen: a dark ground beyond a narrow
card then does not draw the levels."""

USUAL_STD, USUAL_STD_PARTS = 0.06, 30.0
"""Prior of the noise, in units of the readings' range, and the number of parts that it counts for. Chosen."""

FIRST_STD = 5 * USUAL_STD
"""Noise in the first step, in units of the range. Chosen: large, so that no part is an outlier yet."""

GRADIENT_STD = 0.35
"""Prior standard deviation of the light's changes along a side, in units of the range. Chosen."""

LOG_CONTRAST_STD = 0.5
"""Prior standard deviation of the logarithm by which a contrast falls short of the range that it should
explain. Chosen: a marker of half the contrast of what lies over it, as under glare, loses one unit of log
odds."""

ROUNDING_STD = 0.3
"""Standard deviation of rounding to grey levels. Derived: `1 / sqrt(12)`."""

ITERATIONS = 7
"""Steps of expectation maximisation. Chosen: outliers have settled by then."""

CARD_WIDTHS_CELLS, NARROW_ODDS, OUTLINE_BLUR_CELLS = (0.15, 0.4, 0.7), 0.1, 0.1
"""Widths of narrow white cards, the prior probability of a narrow card, and the blur of its outline, cells.
Chosen."""

RIDGE = 1e-6
"""Part of the normal matrix's diagonal that keeps it from being singular."""

SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Places of the products of (1, x, y) with (1, x, y) among the six different ones."""


@dataclass(frozen=True)
class PatternFits:
    """Fits of K patterns to each of N candidates.

    Attributes:
        logs: (N, K) log likelihoods, with the priors of light and contrast; -inf without contrast.
        levels: (N, K, 6) b, c, g, h, p, q, grey levels.
        stds: (N, K) noise, in units of the candidate's range.
        outliers: (N, K, parts) probability that a part is an outlier.
    """

    logs: Array
    levels: Array
    stds: Array
    outliers: Array


@dataclass(frozen=True)
class Columns:
    """Columns of the model at the places of all parts.

    Attributes:
        places: (parts, 3) of 1, x and y.
        squares: (parts, 6) their products.
        outlier_priors: (parts,) prior probabilities of an outlier.
    """

    places: Array
    squares: Array
    outlier_priors: Array


@lru_cache(maxsize=16)
def columns_of(n_cells: int) -> Columns:
    """Return the columns for markers of n cells a side."""
    at = part_places(n_cells) / n_cells - 0.5
    x, y = (part.ravel() for part in np.meshgrid(at, at))
    ones = np.ones_like(x)
    return Columns(
        np.column_stack([ones, x, y]),
        np.column_stack([ones, x, y, x * x, x * y, y * y]),
        np.where(on_marker(n_cells), CARD_OUTLIERS, ZONE_OUTLIERS),
    )


def fit_patterns(
    readings: Readings, white: Array, ground: Array | None = None, *, any_contrast: bool = False
) -> PatternFits:
    """Fit levels and noise to patterns by expectation maximisation.

    Args:
        readings: of N candidates.
        white: (N, K, parts) whiteness of K patterns for each.
        ground: (N or 1, 1, parts) share of a ground with a level of its own; none if left out.
        any_contrast: whether the contrast need not explain the range of the readings.
    """
    columns, on_card = columns_of(readings.n_cells), on_marker(readings.n_cells)
    y = readings.levels[:, None] / readings.scales[:, None, None]
    rounding = (ROUNDING_STD / readings.scales)[:, None]
    seen = readings.seen[:, None]
    share = np.broadcast_to(np.where(on_card, 1.0, FIRST_ZONE_SHARE) * seen, white.shape)
    std = np.full(white.shape[:2], FIRST_STD)
    for _ in range(ITERATIONS):
        normal, right = _normal_equations(columns, share, white, y, ground)
        ridge = (std / GRADIENT_STD) ** 2 * PARTS**2
        for column in range(6):
            normal[..., column, column] += ridge if column % 3 else RIDGE
        levels = np.linalg.solve(normal, right[..., None])[..., 0]
        light, factor = levels[..., :3] @ columns.places.T, levels[..., 3:6] @ columns.places.T
        errors = y - light - white * factor - (0.0 if ground is None else levels[..., 6:] * ground)
        used = share[..., on_card]
        spread = (used * errors[..., on_card] ** 2).sum(axis=-1)
        variance = (USUAL_STD_PARTS * USUAL_STD**2 + spread) / (USUAL_STD_PARTS + used.sum(axis=-1))
        std = np.sqrt(variance + rounding**2)
        bell, density = densities(errors, std[..., None], columns.outlier_priors)
        share = seen * bell / density
    logs = readings.weights[:, None] * (seen * np.log(density)).sum(axis=-1)
    logs -= 0.5 * np.square(levels[..., [1, 2, 4, 5]] / GRADIENT_STD).sum(axis=-1)
    grey = levels[..., [0, 3, 1, 2, 4, 5]] * readings.scales[:, None, None]
    if not any_contrast:
        short = np.log(np.maximum(grey[..., 1], MIN_CONTRAST) / readings.ranges[:, None])
        logs -= 0.5 * np.square(np.minimum(short, 0.0) / LOG_CONTRAST_STD)
    return PatternFits(np.where(grey[..., 1] >= MIN_CONTRAST, logs, -np.inf), grey, std, 1 - share)


def _normal_equations(
    columns: Columns, share: Array, white: Array, y: Array, ground: Array | None
) -> tuple[Array, Array]:
    """Return the weighted normal matrices (N, K, 6 or 7, …) and right sides of b, g, h, c, p, q and d."""
    size = 6 if ground is None else 7
    normal, right = np.zeros((*white.shape[:2], size, size)), np.zeros((*white.shape[:2], size))
    shaded = share * white
    places, squares = columns.places, columns.squares
    normal[..., :3, :3] = (share @ squares)[..., SYMMETRIC]
    normal[..., :3, 3:6] = normal[..., 3:6, :3] = (shaded @ squares)[..., SYMMETRIC]
    normal[..., 3:6, 3:6] = ((shaded * white) @ squares)[..., SYMMETRIC]
    right[..., :3], right[..., 3:6] = (share * y) @ places, (shaded * y) @ places
    if ground is not None:
        own = share * ground
        normal[..., 6, :3] = normal[..., :3, 6] = own @ places
        normal[..., 6, 3:6] = normal[..., 3:6, 6] = (own * white) @ places
        normal[..., 6, 6] = (own * ground).sum(axis=-1) + RIDGE
        right[..., 6] = (own * y).sum(axis=-1)
    return normal, right


def densities(errors: Array, std: Array, outlier_priors: Array) -> tuple[Array, Array]:
    """Return the density of errors, in units of the range, as inliers, and with the outliers'."""
    bell = np.exp(errors**2 * (-0.5 / std**2)) * ((1 - outlier_priors) / (std * math.sqrt(2 * math.pi)))
    return bell, bell + outlier_priors / OUTLIER_RANGE


def fit_cards(readings: Readings, white: Array) -> PatternFits:
    """Fit as `fit_patterns`, to markers whose white zone may be narrow, so that the ground shows.

    The width of each candidate's card is the one with which its likeliest pattern is likeliest.
    """
    wide = fit_patterns(readings, white)
    grounds = [_ground(readings.n_cells, width) for width in CARD_WIDTHS_CELLS]
    likeliest = white[np.arange(len(white)), wide.logs.argmax(axis=1)][:, None]
    by_width = [fit_patterns(readings, likeliest, ground[None, None]).logs[:, 0] for ground in grounds]
    chosen = np.stack(grounds)[np.argmax(by_width, axis=0)][:, None]
    narrow = fit_patterns(readings, white, chosen)
    logs = narrow.logs + math.log(NARROW_ODDS)
    better = logs > wide.logs
    return PatternFits(
        np.logaddexp(wide.logs + math.log(1 - NARROW_ODDS), logs),
        np.where(better[..., None], narrow.levels, wide.levels),
        np.where(better, narrow.stds, wide.stds),
        np.where(better[..., None], narrow.outliers, wide.outliers),
    )


@lru_cache(maxsize=64)
def _ground(n_cells: int, width_cells: float) -> Array:
    """Return the share (parts,) of the ground beyond a card whose white zone is `width_cells` wide."""
    ends = np.array([-width_cells, n_cells + width_cells])
    card = gather(part_places(n_cells), ends, OUTLINE_BLUR_CELLS)[:, 0]
    return np.asarray((1 - card[:, None] * card).ravel())


def whiteness(readings: Readings, fits: PatternFits, best: IntArray) -> tuple[Array, Array]:
    """Return readings as whiteness (N, parts) by the levels of the fits `best` (N,), and their contrasts."""
    x, y = columns_of(readings.n_cells).places[:, 1:].T
    level = fits.levels[np.arange(len(best)), best]
    contrast = np.maximum(level[:, 1:2] + level[:, 4:5] * x + level[:, 5:6] * y, MIN_CONTRAST)
    black = level[:, 0:1] + level[:, 2:3] * x + level[:, 3:4] * y
    return (readings.levels - black) / contrast, contrast
