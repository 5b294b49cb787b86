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
from functools import cache, lru_cache

import numpy as np

from skyherd.geometry import Array, IntArray
from skyherd.markers.blur_model import gather
from skyherd.vision.native.library import library
from skyherd.vision.native.pattern_records import PatternConstants, PatternRequest
from skyherd.vision.native.records import Floats
from skyherd.vision.photometric.evidence.readings import MIN_CONTRAST, Readings, on_marker, part_places

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

CARD_WIDTHS_CELLS, NARROW_ODDS, OUTLINE_BLUR_CELLS = (0.0, 0.15, 0.4, 0.7), 0.1, 0.1
"""Widths of narrow white cards, the prior probability of a narrow card, and the blur of its outline, cells.
Chosen. A card of no width is a marker cut out along its black. Measured on 216 markers of 4X4_50 of 20 to
50 px, cut out so and laid on grey levels of 80, 110 and 150: 212 are found, and 159 without that width."""

RIDGE = 1e-6
"""Part of the normal matrix's diagonal that keeps it from being singular."""


@dataclass(frozen=True)
class PatternFits:
    """Fits of K patterns to each of N candidates.

    Attributes:
        logs: (N, K) log likelihoods, with the priors of light and contrast; -inf without contrast.
        levels: (N, K, 6) b, c, g, h, p, q, grey levels.
        stds: (N, K) noise, in units of the candidate's range.
        outlier_shares: (N, K) share of the parts on the marker that are outliers.
    """

    logs: Array
    levels: Array
    stds: Array
    outlier_shares: Array


@dataclass(frozen=True)
class Columns:
    """Columns of the model at the places of all parts.

    Attributes:
        places: (parts, 3) of 1, x and y.
        outlier_priors: (parts,) prior probabilities of an outlier.
    """

    places: Array
    outlier_priors: Array


@lru_cache(maxsize=16)
def columns_of(n_cells: int) -> Columns:
    """Return the columns for markers of n cells a side."""
    at = part_places(n_cells) / n_cells - 0.5
    x, y = (part.ravel() for part in np.meshgrid(at, at))
    ones = np.ones_like(x)
    priors = np.where(on_marker(n_cells), CARD_OUTLIERS, ZONE_OUTLIERS)
    return Columns(np.column_stack([ones, x, y]), priors)


def fit_patterns(
    readings: Readings, white: Array | Floats, ground: Array | None = None, *, any_contrast: bool = False
) -> PatternFits:
    """Fit levels and noise to patterns by expectation maximisation (`vision/native/pattern_fit.c`).

    Args:
        readings: of N candidates.
        white: (N, K, parts) whiteness of K patterns for each.
        ground: (N or 1, parts) share of a ground with a level of its own; none if left out.
        any_contrast: whether the contrast need not explain the range of the readings.
    """
    request = PatternRequest(
        levels=np.asarray(readings.levels, dtype=np.float32),
        seen=np.asarray(readings.seen, dtype=np.float32),
        scales=readings.scales,
        weights=readings.weights,
        ranges=readings.ranges,
        patterns=np.ascontiguousarray(white, dtype=np.float32),
        grounds=None if ground is None else np.ascontiguousarray(ground, dtype=np.float32),
        constants=pattern_constants(),
        n_cells=readings.n_cells,
        any_contrast=any_contrast,
    )
    fits = library().fit_patterns(request)
    return PatternFits(fits["logs"], fits["levels"], fits["stds"], fits["outlier_shares"])


@cache
def pattern_constants() -> PatternConstants:
    """Return the constants of the compiled fit."""
    return PatternConstants(
        card_outliers=CARD_OUTLIERS,
        zone_outliers=ZONE_OUTLIERS,
        outlier_range=OUTLIER_RANGE,
        first_zone_share=FIRST_ZONE_SHARE,
        usual_std=USUAL_STD,
        usual_std_parts=USUAL_STD_PARTS,
        first_std=FIRST_STD,
        gradient_std=GRADIENT_STD,
        log_contrast_std=LOG_CONTRAST_STD,
        rounding_std=ROUNDING_STD,
        ridge=RIDGE,
        min_contrast=MIN_CONTRAST,
        iterations=ITERATIONS,
    )


def densities(errors: Array, std: Array, outlier_priors: Array) -> tuple[Array, Array]:
    """Return the density of errors, in units of the range, as inliers, and with the outliers'."""
    bell = np.exp(errors**2 * (-0.5 / std**2)) * ((1 - outlier_priors) / (std * math.sqrt(2 * math.pi)))
    return bell, bell + outlier_priors / OUTLIER_RANGE


def fit_cards(readings: Readings, white: Array | Floats) -> PatternFits:
    """Fit as `fit_patterns`, to markers whose white zone may be narrow, so that the ground shows.

    The width of each candidate's card is the one with which its likeliest pattern is likeliest.
    """
    wide = fit_patterns(readings, white)
    grounds = narrow_grounds(readings.n_cells)
    likeliest = white[np.arange(len(white)), wide.logs.argmax(axis=1)][:, None]
    by_width = [fit_patterns(readings, likeliest, ground[None]).logs[:, 0] for ground in grounds]
    chosen = np.stack(grounds)[np.argmax(by_width, axis=0)]
    narrow = fit_patterns(readings, white, chosen)
    logs = narrow.logs + math.log(NARROW_ODDS)
    better = logs > wide.logs
    return PatternFits(
        np.logaddexp(wide.logs + math.log(1 - NARROW_ODDS), logs),
        np.where(better[..., None], narrow.levels, wide.levels),
        np.where(better, narrow.stds, wide.stds),
        np.where(better, narrow.outlier_shares, wide.outlier_shares),
    )


def narrow_grounds(n_cells: int) -> list[Array]:
    """Return the shares (parts,) of the ground beyond each width of a narrow card, that of no width first."""
    return [_ground(n_cells, width) for width in CARD_WIDTHS_CELLS]


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
