"""Log odds that a quadrilateral shows a marker, against everything else that it may show.

A candidate's square, and the white zone of one cell around it, are read in `PARTS` x `PARTS` parts of each
cell. The model of the readings y at places (x, y), in sides from the centre, under a pattern of whiteness w
(0 to 1, blurred) is

    y = b + c w + (g x + h y) + (p x + q y) w [+ d (1 - s)] + e,    e ~ (1 - a) N(0, s²) + a / range,

so that the light may change along the marker, as a sum and as a factor, parts may be outliers (glare, salt,
a pen line, a cover), and the ground beyond a narrow card (share 1 - s) has a level of its own. The levels and
the noise s are fitted to each hypothesis by expectation maximisation, so that the contrast is that of the
marker itself. A cell counts as `min(MAX_READINGS, px² / PX2_PER_READING)` independent readings.

With L_k the likelihood of marker and quarter turn k among the 4 D of a dictionary, the log odds are

    log L_k - log 4D - log Σ_j o_j L_j

over four kinds of other hypotheses j, with prior odds o_j against a marker: other codes; the same grid with
bits of any colour, each by chance; a dark square with a light rectangle; a square of another grid with the
bits that it shows, at `2^-bits`. The number of hypotheses tried, 4 D, is part of the odds, so that one
threshold serves all dictionaries.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from skyherd.geometry import UNIFORM_VARIANCE, Array, BoolArray, IntArray
from skyherd.markers.blur_model import gather
from skyherd.markers.dictionary import border_cells, cells_per_side, dictionary_size, marker_cells
from skyherd.vision.blurred_cells import standardised
from skyherd.vision.grey import Image, block_means
from skyherd.vision.row_record import RowRecord

PARTS = 3
"""Parts of a cell along its side. Chosen: two miss edges that lie within a cell, four take twice the time."""

MAX_READINGS, PX2_PER_READING = 3.0, 4.0
"""Independent readings of a cell at most, and pixels for each. Chosen: errors of a model are alike over a
cell, so that more pixels do not add evidence in proportion."""

CARD_OUTLIERS, ZONE_OUTLIERS = 0.04, 0.3
"""Prior probability that a part is an outlier, on the marker and in the zone around it. Chosen: the zone is
often cut, narrow or covered."""

SPOILT_CELLS = 0.02
"""Prior probability that a cell shows the other colour, as under glare, a cover or where ink is worn. Chosen:
a marker of 36 bits then keeps enough evidence with two such cells, and one of 16 bits does not with one."""

FIRST_ZONE_SHARE = 0.2
"""Weight of the parts around the marker in the first step of a fit. Chosen: a dark ground beyond a narrow
card then does not draw the levels."""

OUTLIER_RANGE = 3.0
"""Range of outliers, in units of the readings' range. Chosen: saturated glare beside a dark marker."""

BLURS_CELLS = (
    (0.1, 0.1),
    (0.22, 0.22),
    (0.36, 0.36),
    (0.52, 0.52),
    (0.72, 0.72),
    (0.15, 0.5),
    (0.5, 0.15),
    (0.3, 0.8),
    (0.8, 0.3),
)
"""Blurs (along the rows, along the columns) under which patterns are drawn, standard deviations in cells.
Chosen: geometric between a sharp edge and the largest blur that is accepted; then streaks of motion."""

RESOLVED_CELLS = 0.5
"""Blur, cells, up to which the bits of a marker are independent of each other. Chosen: contrast at the finest
pattern, `exp(-π² σ² / 2)`, is then 0.3. Beyond it the number of independent bits falls with the blur along
each axis. Measured: without it, one in 700 blurred squares of 16 px with text passes for one of the 587
markers of 36h11."""

SHARPEST_CELLS = 0.1
"""Blur of a card's outline, cells. Chosen: that of the sharpest patterns."""

CELL_BLURS = (0.2, 0.5)
"""Blurs under which whole cells are compared with all markers, before some of them are drawn in parts."""

USUAL_STD, USUAL_STD_PARTS = 0.06, 30.0
"""Prior of the noise, in units of the readings' range, and the number of parts that it counts for. Chosen."""

GRADIENT_STD = 0.35
"""Prior standard deviation of the light's changes along a side, in units of the range. Chosen."""

MAX_CODES, MAX_RECTANGLES, RECTANGLE_STEP, ITERATIONS = 6, 12, 0.25, 7
"""Hypotheses that are fitted of each kind, the grid of rectangles in cells, and steps of a fit. Chosen."""

OTHER_GRIDS = (3, 4, 5, 6, 7, 8)
"""Bits along the side of other grids."""

BITS_ODDS, RECTANGLES_ODDS, GRIDS_ODDS = 0.05, 0.03, 0.05
"""Prior odds of each kind of clutter against a marker. Chosen."""

MIN_LOG_ODDS, MAX_DOUBT = 9.0, 0.6
"""A candidate is accepted from the first log odds on, or where a dictionary has too few bits for that, if it
falls short of the most that an image can show by the second at most. Measured: `benchmarks/clutter.py`."""

MAX_CONTRADICTION, MIN_LOCAL_RANGE = 0.07, 0.15
"""Largest share of cells that their neighbours may contradict, and the range among neighbours, as share of
the marker's, from which they count. Chosen: between what blur or glare changes and a shaded half."""

CARD_WIDTHS_CELLS, NARROW_ODDS = (0.15, 0.4, 0.7), 0.1
"""Widths of narrow white cards, in cells, and the prior probability of a narrow card. Chosen."""

QUANTILES = (0.05, 0.95)
"""Between these quantiles of all readings lies their range. Chosen: without the tails of noise and glare."""

CARD_QUANTILES, LOG_CONTRAST_STD = (0.1, 0.9), 0.5
"""Between these quantiles of the readings on the card lies the range that a marker's contrast explains, and
the prior standard deviation of the logarithm by which it may fall short. Chosen: a marker of half the
contrast of what lies over it, as under glare, loses one unit of log odds."""

MIN_CONTRAST = 4.0
"""Smallest contrast of a marker, grey levels. Chosen: below it the rounding of grey levels shows as bits."""

ROUNDING_STD = 0.3
"""Standard deviation of rounding to grey levels: `1 / sqrt(12)`."""

HOPELESS = 1.0
"""Log odds below which the remaining hypotheses are not compared. Chosen: no candidate recovers from it."""

FIRST_CODES, FIRST_LOG_ODDS, MAX_FIRST_STD = 2, (3.0, 1.0), 0.25
"""Number of codes that are compared first, without narrow cards; the log odds against the other code and
against bits by chance, and the noise, share of the readings' range, beyond which nothing else is compared.
Chosen: far from markers, which have 30, 5 and 0.13 unless something lies on them. It spares nine tenths of
the time on a photograph of clutter."""

MIN_STD, MIN_UNEXPLAINED = 1e-6, 1e-3
"""Smallest standard deviation that readings are divided by, and smallest part of a rectangle's square that
the ground does not explain."""


Array32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class MarkerOdds(RowRecord):
    """Evidence for N candidates.

    Attributes:
        ids: (N,) the likeliest marker of each.
        turns: (N,) quarter turns: corner `turns` of the candidate is the marker's first.
        log_odds: (N,) natural logarithms of the odds that it is that marker.
        against: (N, 4) log odds against other codes, bits by chance, light rectangles, other grids alone;
            infinite where others made them needless.
        blacks: (N,) grey level of black at the centre.
        contrasts: (N,) grey levels from black to white.
        noise_stds: (N,) standard deviation of the readings' errors, share of their range.
        outlier_shares: (N,) share of the marker's parts that are outliers.
    """

    ids: IntArray
    turns: IntArray
    log_odds: Array
    against: Array
    blacks: Array
    contrasts: Array
    noise_stds: Array
    outlier_shares: Array


@dataclass(frozen=True)
class _Fits:
    """Models fitted to K hypotheses of N candidates; all (N, K, ...)."""

    logs: Array
    levels: Array
    stds: Array
    outliers: Array


def min_log_odds(dictionary: str) -> float:
    """Return the log odds from which on a candidate is accepted as a marker of a dictionary.

    An image that shows every bit beyond doubt has the log odds `n log 2 - log 4D - log BITS_ODDS` against
    bits by chance, with n bits and D markers: 8.8 for 4X4_50, 20 for 36h11. No image has more, and clutter
    that happens to have a marker's bits has as much.
    """
    bits = (cells_per_side(dictionary) - 2 * border_cells(dictionary)) ** 2
    most = bits * math.log(2) - math.log(4 * dictionary_size(dictionary)) - math.log(BITS_ODDS)
    return min(MIN_LOG_ODDS, most - MAX_DOUBT)


def marker_odds(image: Image, corners_px: Array, dictionary: str) -> MarkerOdds:
    """Return the evidence for the likeliest marker of each of N candidates.

    Args:
        image: grey, (height, width).
        corners_px: (N, 4, 2) corners, px, clockwise as seen, beginning with any of the four.
        dictionary: of the markers.
    """
    n = cells_per_side(dictionary)
    if not len(corners_px):
        none = np.zeros(0, dtype=np.int64)
        return MarkerOdds(none, none, np.zeros(0), np.zeros((0, 4)), *([np.zeros(0)] * 4))
    samples = _Samples.read(image, corners_px, n)
    nearest = _nearest_codes(samples.readings, dictionary)
    odds = _odds_of_codes(samples, nearest[:, :FIRST_CODES], dictionary, first=True)
    hopeful = (odds.against[:, :2] > FIRST_LOG_ODDS).all(axis=1) & (odds.noise_stds < MAX_FIRST_STD)
    likely = np.flatnonzero(hopeful)
    if not likely.size:
        return odds
    return odds.put(likely, _odds_of_codes(samples.take(likely), nearest[likely], dictionary))


def log_likelihoods(image: Image, corners_px: Array, dictionary: str) -> Array:
    """Return the log likelihood (N,) of the readings at N poses, of the likeliest marker at each.

    Poses of one marker compare by it.
    """
    if not len(corners_px):
        return np.zeros(0)
    samples = _Samples.read(image, corners_px, cells_per_side(dictionary))
    nearest = _nearest_codes(samples.readings, dictionary)[:, :FIRST_CODES]
    _, drawn = _drawn(samples.readings, nearest, dictionary)
    return np.asarray(_fit_cards(samples, drawn).logs.max(axis=1))


def _odds_of_codes(
    samples: "_Samples", codes: IntArray, dictionary: str, *, first: bool = False
) -> MarkerOdds:
    """Return the evidence for the likeliest of K codes (N, K).

    At first, wide cards alone are fitted and compared with bits by chance alone; the log odds are then -inf.
    """
    n, rows = samples.n_cells, np.arange(len(codes))
    blurs, drawn = _drawn(samples.readings, codes, dictionary)
    fits = _fit(samples, drawn) if first else _fit_cards(samples, drawn)
    best = np.argmax(fits.logs, axis=1)
    logs, blur, pattern = fits.logs[rows, best], blurs[rows, best], drawn[rows, best]
    seen = np.isfinite(logs)
    mine = np.where(seen, logs, 0.0) - math.log(4 * dictionary_size(dictionary))
    against = np.full((len(codes), 4), np.inf)
    whiteness, contrasts = _whiteness(samples.readings, fits, best, n)
    bits = _log_bits(
        samples, whiteness - pattern, contrasts, pattern, blur, fits.stds[rows, best], dictionary
    )
    against[:, 1] = (
        _resolved_shares()[blur] * bits - math.log(4 * dictionary_size(dictionary)) - math.log(BITS_ODDS)
    )
    others = fits.logs.copy()
    others[rows, best] = -np.inf
    against[:, 0] = np.where(seen, logs, 0.0) - np.logaddexp.reduce(others, axis=1)
    log_odds = np.full(len(codes), -np.inf)
    if not first:
        hopeful = seen & (against.min(axis=1) > HOPELESS)
        for number in np.unique(blur[hopeful]):
            few = np.flatnonzero(hopeful & (blur == number))
            these, spread = samples.take(few), BLURS_CELLS[number]
            against[few, 2] = mine[few] - _log_rectangles(these, spread)
            against[few, 3] = mine[few] - _log_grids(these, whiteness[few], spread, dictionary)
        log_odds = np.where(seen, -np.logaddexp.reduce(-against, axis=1), -np.inf)
        white = _codes(dictionary)[0][codes[rows, best]] < 0.5
        log_odds[_contradictions(samples, white) > MAX_CONTRADICTION] = -np.inf
    against[~seen] = -np.inf
    ids, turns = np.divmod(codes[rows, best], 4)
    outliers = fits.outliers[rows, best][:, _design(n).on_card].mean(axis=1)
    blacks, contrasts = fits.levels[rows, best, :2].T
    return MarkerOdds(ids, turns, log_odds, against, blacks, contrasts, fits.stds[rows, best], outliers)


@dataclass(frozen=True)
class _Samples:
    """Readings of N candidates.

    Attributes:
        n_cells: cells along a marker's side.
        readings: (N, parts) grey levels of markers and white zones.
        weights: (N,) independent readings that a part counts as.
        scales: (N,) range of the readings, grey levels.
        ranges: (N,) range on the card that a marker's contrast should explain, grey levels.
    """

    n_cells: int
    readings: Array
    weights: Array
    scales: Array
    ranges: Array

    @classmethod
    def read(cls, image: Image, corners_px: Array, n_cells: int) -> "_Samples":
        """Return the readings at corners (N, 4, 2), px."""
        readings = _readings(image, corners_px, n_cells)
        on_card = readings[:, _design(n_cells).on_card]
        scales, ranges = (
            np.maximum(np.ptp(np.quantile(values, ends, axis=1), axis=0), MIN_CONTRAST)
            for values, ends in ((readings, QUANTILES), (on_card, CARD_QUANTILES))
        )
        return cls(n_cells, readings, _weights(corners_px, n_cells), scales, ranges)

    def take(self, rows: IntArray) -> "_Samples":
        """Return the readings of some candidates."""
        return _Samples(
            self.n_cells, self.readings[rows], self.weights[rows], self.scales[rows], self.ranges[rows]
        )


def _weights(corners_px: Array, n_cells: int) -> Array:
    """Return independent readings (N,) that a part counts as."""
    one, two = corners_px[:, 2] - corners_px[:, 0], corners_px[:, 3] - corners_px[:, 1]
    cell_px2 = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2 / n_cells**2
    return np.asarray(np.minimum(MAX_READINGS, cell_px2 / PX2_PER_READING) / PARTS**2)


def _places(n_cells: int, per_part: int = 1) -> Array:
    """Return `per_part` places in each part along an axis, in cells from the marker's edge."""
    parts = PARTS * per_part
    return (np.arange(parts * (n_cells + 2)) + 0.5) / parts - 1


def _readings(image: Image, corners_px: Array, n_cells: int) -> Array:
    """Return grey levels (N, parts) of all parts of markers and white zones.

    Large markers are read in a shrunk image, so that a part is the mean over its pixels.
    """
    sides_px = np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=1), axis=2).mean(axis=1)
    part_px = sides_px / (n_cells * PARTS)
    octaves = np.maximum(np.floor(np.log2(np.maximum(part_px, 1e-3) / 1.5)), 0).astype(int)
    out = np.empty((len(corners_px), (PARTS * (n_cells + 2)) ** 2))
    for octave in np.unique(octaves):
        rows, shrink = np.flatnonzero(octaves == octave), 2 ** int(octave)
        small = image if shrink == 1 else block_means(image, shrink)
        corners = (corners_px[rows] - (shrink - 1) / 2) / shrink
        out[rows] = _sampled(small, corners, n_cells, 2 if part_px[rows].max() / shrink > 0.9 else 1)
    return out


def _sampled(image: Image, corners_px: Array, n_cells: int, fine: int) -> Array:
    at = _places(n_cells, fine) / n_cells
    x, y = np.meshgrid(at, at)
    z = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    u, v, w = (_unit_square_homographies(corners_px) @ z).transpose(1, 0, 2)
    w = np.where(np.abs(w) < MIN_STD, MIN_STD, w)
    u, v = (np.clip(part / w, -1e4, 3e4).astype(np.float32) for part in (u, v))
    side = PARTS * (n_cells + 2)
    grey = np.empty(u.shape, dtype=np.float32)
    step = max(1, 30000 // u.shape[1] * 1)
    for low in range(0, len(u), step):
        part = slice(low, low + step)
        grey[part] = cv2.remap(image, u[part], v[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    means = grey.reshape(-1, side, fine, side, fine).mean(axis=(2, 4), dtype=float)
    return np.asarray(means.reshape(len(u), -1))


def _unit_square_homographies(corners_px: Array) -> Array:
    """Return homographies (N, 3, 3) from the unit square to corners (N, 4, 2)."""
    p0, p1, p2, p3 = corners_px.transpose(1, 0, 2)
    a, b, c = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = np.where(np.abs(area) < MIN_STD, MIN_STD, area)
    g = (c[:, 0] * b[:, 1] - c[:, 1] * b[:, 0]) / area
    h = (a[:, 0] * c[:, 1] - a[:, 1] * c[:, 0]) / area
    rows = [p1 - p0 + g[:, None] * p1, p3 - p0 + h[:, None] * p3, p0]
    top = np.stack(rows, axis=2)
    return np.concatenate([top, np.stack([g, h, np.ones_like(g)], axis=1)[:, None]], axis=1)


@lru_cache(maxsize=16)
def _codes(dictionary: str) -> tuple[Array32, Array32]:
    """Return black cells (4 D, n, n) of all markers in all turns, and their blurred whiteness, standardised.

    Row 4 i + t is marker i turned by t quarters; the second is (blurs x 4 D, n²).
    """
    n = cells_per_side(dictionary)
    cells = np.stack([marker_cells(dictionary, i) for i in range(dictionary_size(dictionary))])
    turned = np.stack([np.rot90(cells, -turn, axes=(1, 2)) for turn in range(4)], axis=1).reshape(-1, n, n)
    black = (~turned).astype(np.float32)
    middles, blurred = np.arange(n, dtype=float) + 0.5, []
    for blur in CELL_BLURS:
        sigma = math.hypot(blur, UNIFORM_VARIANCE**0.5)
        gathered = gather(middles, np.arange(n + 1.0), sigma).astype(np.float32)
        blurred.append(standardised(-(gathered @ black @ gathered.T).reshape(len(black), -1)))
    return black, np.asarray(np.concatenate(blurred), dtype=np.float32)


def _nearest_codes(readings: Array, dictionary: str) -> IntArray:
    """Return the codes (N, K) whose cells resemble readings (N, parts) most, the likeliest first."""
    n = cells_per_side(dictionary)
    cells = readings.reshape(-1, n + 2, PARTS, n + 2, PARTS).mean(axis=(2, 4))[:, 1:-1, 1:-1]
    _, alike = _codes(dictionary)
    match = standardised(cells.reshape(len(cells), -1).astype(np.float32)) @ alike.T
    match = match.reshape(len(cells), len(CELL_BLURS), -1).max(axis=1)
    few = np.argpartition(-match, MAX_CODES - 1, axis=1)[:, :MAX_CODES]
    order = np.argsort(-np.take_along_axis(match, few, axis=1), axis=1)
    return np.asarray(np.take_along_axis(few, order, axis=1))


@lru_cache(maxsize=16)
def _gathers(n_cells: int) -> tuple[Array, Array]:
    """Return weights (blurs, side, n) of a row's cells at its parts, along the rows and along the columns."""
    both = [
        np.stack([gather(_places(n_cells), np.arange(n_cells + 1.0), blur[axis]) for blur in BLURS_CELLS])
        for axis in (0, 1)
    ]
    return both[0], both[1]


def _drawn(readings: Array, codes: IntArray, dictionary: str) -> tuple[IntArray, Array]:
    """Return the blur (N, K) under which each code (N, K) resembles the readings most, and its whiteness."""
    n = cells_per_side(dictionary)
    black, (along, down) = _codes(dictionary)[0][codes], _gathers(n)
    rows = np.einsum("bsj,nkij->nkbis", along.astype(np.float32), black)
    drawn = 1 - np.einsum("bri,nkbis->nkbrs", down.astype(np.float32), rows, optimize=True)
    drawn = drawn.reshape(*codes.shape, len(BLURS_CELLS), -1)
    centred = drawn - drawn.mean(axis=-1, keepdims=True)
    seen = standardised(readings.astype(np.float32))
    alike = np.einsum("nkbr,nr->nkb", centred, seen) / np.linalg.norm(centred, axis=-1)
    blurs = alike.argmax(axis=-1)
    chosen = np.take_along_axis(drawn, blurs[..., None, None], axis=2)[:, :, 0]
    return blurs, np.asarray(chosen, dtype=float)


@dataclass(frozen=True)
class _Design:
    """Columns of the model at the places of all parts.

    Attributes:
        squares: (parts, 6) products of (1, x, y).
        places: (parts, 3) of 1, x and y.
        outlier_priors: (parts,) prior probabilities of an outlier.
        on_card: (parts,) whether the part is on the marker.
    """

    squares: Array
    places: Array
    outlier_priors: Array
    on_card: BoolArray


@lru_cache(maxsize=16)
def _design(n_cells: int) -> _Design:
    x, y = (part.ravel() for part in np.meshgrid(*2 * [_places(n_cells) / n_cells - 0.5]))
    zone = np.pad(np.zeros((n_cells, n_cells)), 1, constant_values=1.0)
    prior = np.kron(CARD_OUTLIERS + (ZONE_OUTLIERS - CARD_OUTLIERS) * zone, np.ones((PARTS, PARTS))).ravel()
    ones = np.ones_like(x)
    return _Design(
        np.column_stack([ones, x, y, x * x, x * y, y * y]),
        np.column_stack([ones, x, y]),
        np.asarray(prior, dtype=float),
        prior < ZONE_OUTLIERS,
    )


@lru_cache(maxsize=64)
def _ground(n_cells: int, width_cells: float, blur: float) -> Array:
    """Return share (parts,) of the ground beyond a card whose white zone is `width_cells` wide."""
    card = gather(_places(n_cells), np.array([-width_cells, n_cells + width_cells]), blur)[:, 0]
    return np.asarray((1 - card[:, None] * card).ravel())


SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Where the products of (1, x, y) with (1, x, y) are among the six different ones."""


def _fit(
    samples: _Samples, white: Array, ground: Array | None = None, *, any_contrast: bool = False
) -> _Fits:
    """Fit levels and noise to patterns by expectation maximisation.

    Args:
        samples: of N candidates.
        white: (N, K, parts) whiteness of K patterns for each.
        ground: (N or 1, 1, parts) share of a ground with a level of its own; none if left out.
        any_contrast: whether the contrast need not explain the range of the readings.
    """
    design, readings, scales = _design(samples.n_cells), samples.readings, samples.scales
    count, hypotheses, _ = white.shape
    white = white.astype(float)
    y = readings[:, None] / scales[:, None, None]
    size = 6 if ground is None else 7
    products = (None, white, white * white)
    share = np.broadcast_to(np.where(design.on_card, 1.0, FIRST_ZONE_SHARE), white.shape)
    std = np.full((count, hypotheses), USUAL_STD * 5)
    prior = design.outlier_priors
    normal = np.zeros((count, hypotheses, size, size))
    right = np.zeros((count, hypotheses, size))
    rounding = (ROUNDING_STD / scales)[:, None]
    stray = prior / OUTLIER_RANGE
    for _ in range(ITERATIONS):
        for power, product in enumerate(products):
            block = (share if product is None else share * product) @ design.squares
            square = block[..., SYMMETRIC]
            if power == 0:
                normal[..., :3, :3] = square
            elif power == 1:
                normal[..., :3, 3:6] = normal[..., 3:6, :3] = square
            else:
                normal[..., 3:6, 3:6] = square
        weighted = share * y
        right[..., :3], right[..., 3:6] = weighted @ design.places, (weighted * white) @ design.places
        if ground is not None:
            own = share * ground
            normal[..., 6, :3] = normal[..., :3, 6] = own @ design.places
            normal[..., 6, 3:6] = normal[..., 3:6, 6] = (own * white) @ design.places
            normal[..., 6, 6] = (own * ground).sum(axis=-1) + 1e-6
            right[..., 6] = (own * y).sum(axis=-1)
        ridge = (std / GRADIENT_STD) ** 2 * PARTS**2
        penalised = normal.copy()
        for column in range(6):
            penalised[..., column, column] += ridge if column % 3 else 1e-6
        levels = np.linalg.solve(penalised, right[..., None])[..., 0]
        errors = y - levels[..., :3] @ design.places.T - white * (levels[..., 3:6] @ design.places.T)
        if ground is not None:
            errors -= levels[..., 6:] * ground
        square = errors * errors
        on_card = share[..., design.on_card]
        total, spread = on_card.sum(axis=-1), (on_card * square[..., design.on_card]).sum(axis=-1)
        variance = (USUAL_STD_PARTS * USUAL_STD**2 + spread) / (USUAL_STD_PARTS + total)
        std = np.sqrt(variance + rounding**2)
        bell = np.exp(square * (-0.5 / std[..., None] ** 2))
        bell *= (1 - prior) / (std[..., None] * math.sqrt(2 * math.pi))
        density = bell + stray
        share = bell / density
    logs = samples.weights[:, None] * np.log(density).sum(axis=-1)
    gradients = levels[..., [1, 2, 4, 5]]
    logs -= 0.5 * ((gradients / GRADIENT_STD) ** 2).sum(axis=-1)
    contrasts = levels[..., 3] * scales[:, None]
    if not any_contrast:
        short = np.log(np.maximum(contrasts, MIN_CONTRAST) / samples.ranges[:, None])
        logs -= 0.5 * (np.minimum(short, 0.0) / LOG_CONTRAST_STD) ** 2
    logs = np.where(contrasts >= MIN_CONTRAST, logs, -np.inf)
    reordered = levels[..., [0, 3, 1, 2, 4, 5]] * scales[:, None, None]
    return _Fits(logs, reordered, std, 1 - share)


def _fit_cards(samples: _Samples, white: Array) -> _Fits:
    """Fit as `_fit`, to markers whose white zone may be narrow, so that the ground shows.

    The width of each candidate's card is the one with which its likeliest pattern is likeliest.
    """
    wide = _fit(samples, white)
    grounds = [_ground(samples.n_cells, width, SHARPEST_CELLS) for width in CARD_WIDTHS_CELLS]
    rows = np.arange(len(white))
    likeliest = white[rows, wide.logs.argmax(axis=1)][:, None]
    by_width = [_fit(samples, likeliest, ground[None, None]).logs[:, 0] for ground in grounds]
    chosen = np.stack(grounds)[np.argmax(by_width, axis=0)][:, None]
    narrow = _fit(samples, white, chosen)
    logs = narrow.logs + math.log(NARROW_ODDS)
    better = logs > wide.logs
    return _Fits(
        np.logaddexp(wide.logs + math.log(1 - NARROW_ODDS), logs),
        np.where(better[..., None], narrow.levels, wide.levels),
        np.where(better, narrow.stds, wide.stds),
        np.where(better[..., None], narrow.outliers, wide.outliers),
    )


def _contradictions(samples: _Samples, white: BoolArray) -> Array:
    """Return the share (N,) of cells that their neighbours show in another colour than codes (N, n, n) have.

    Under a hard shadow a code can explain the lit half and take all of the shaded half for black. Each cell
    is therefore also compared with the darkest and brightest of the cells around it, where these differ.
    """
    n = samples.n_cells
    cells = samples.readings.reshape(-1, n + 2, PARTS, n + 2, PARTS).mean(axis=(2, 4))
    around = np.lib.stride_tricks.sliding_window_view(cells, (3, 3), axis=(1, 2))
    dark, bright = around.min(axis=(3, 4)), around.max(axis=(3, 4))
    differ = bright - dark > MIN_LOCAL_RANGE * samples.ranges[:, None, None]
    wrong = (cells[:, 1:-1, 1:-1] > (dark + bright) / 2) != white
    return np.asarray((wrong & differ).mean(axis=(1, 2)))


def _whiteness(readings: Array, fits: _Fits, best: IntArray, n_cells: int) -> tuple[Array, Array]:
    """Return readings as whiteness (N, parts) by the levels of the best fits, and contrasts (N, parts)."""
    x, y = _design(n_cells).places[:, 1:].T
    level = fits.levels[np.arange(len(best)), best]
    contrast = np.maximum(level[:, 1:2] + level[:, 4:5] * x + level[:, 5:6] * y, MIN_CONTRAST)
    black = level[:, 0:1] + level[:, 2:3] * x + level[:, 3:4] * y
    return (readings - black) / contrast, contrast


@lru_cache(maxsize=64)
def _cell_responses(n_cells: int) -> Array:
    """By how much (blurs, parts) the colour of a part's own cell changes it."""
    rows = np.arange(PARTS * (n_cells + 2))
    own = [
        [gather(_places(n_cells), np.arange(-1.0, n_cells + 2), value)[rows, rows // PARTS] for value in blur]
        for blur in BLURS_CELLS
    ]
    return np.stack([(down[:, None] * along).ravel() for along, down in own])


def _log_density(errors: Array, std: Array, prior: Array) -> Array:
    bell = (1 - prior) * np.exp(-0.5 * (errors / std) ** 2) / (std * math.sqrt(2 * math.pi))
    return np.asarray(np.log(bell + prior / OUTLIER_RANGE))


@lru_cache(maxsize=1)
def _resolved_shares() -> Array:
    """Return share (blurs,) of the bits that are independent of their neighbours under a blur."""
    return np.array([math.prod(min(1.0, RESOLVED_CELLS / value) for value in blur) for blur in BLURS_CELLS])


def _log_bits(
    samples: _Samples,
    errors: Array,
    contrasts: Array,
    patterns: Array,
    blur: IntArray,
    stds: Array,
    dictionary: str,
) -> Array:
    """Return the log likelihood ratio (N,) of the patterns' bits to bits by chance.

    Args:
        samples: of N candidates.
        errors: (N, parts) of the whiteness.
        contrasts: (N, parts) grey levels.
        patterns: (N, parts) whiteness.
        blur: (N,) numbers of the blurs.
        stds: (N,) noise, share of the readings' range.
        dictionary: of the markers.
    """
    n, border = samples.n_cells, border_cells(dictionary)
    flip = _cell_responses(n)[blur] * np.where(patterns > 0.5, -1, 1)
    prior, std = _design(n).outlier_priors, stds[:, None]
    inner = np.s_[:, 1 + border : -1 - border, 1 + border : -1 - border]
    shares = contrasts / samples.scales[:, None]
    own, other = (
        samples.weights[:, None, None]
        * _log_density(part * shares, std, prior)
        .reshape(-1, n + 2, PARTS, n + 2, PARTS)
        .sum(axis=(2, 4))[inner]
        for part in (errors, errors - flip)
    )
    spoilt = np.logaddexp(math.log(1 - SPOILT_CELLS) + own, math.log(SPOILT_CELLS) + other)
    return np.asarray((spoilt + math.log(2) - np.logaddexp(own, other)).sum(axis=(1, 2)))


@lru_cache(maxsize=64)
def _stretches(n_cells: int, blur: float) -> Array:
    """Return shares (S, side) of all stretches along an axis that a light rectangle may cover."""
    edges = np.arange(0.5, n_cells - 0.49, RECTANGLE_STEP)
    steps = ndtr((_places(n_cells)[None] - edges[:, None]) / blur)
    low, high = np.triu_indices(edges.size, k=2)
    return np.asarray(steps[low] - steps[high])


def _log_rectangles(samples: _Samples, blur: tuple[float, float]) -> Array:
    """Return the log posterior (N,) of light rectangles in a dark square, by the best of them."""
    n = samples.n_cells
    along, down = (_stretches(n, value) for value in blur)
    square = [gather(_places(n), np.array([0.0, n]), value)[:, 0] for value in blur]
    ground = 1 - square[1][:, None] * square[0]
    side, other = len(ground), ground - ground.mean()
    images = samples.readings.reshape(-1, side, side)
    basis = [np.full(ground.shape, 1 / side), other / np.linalg.norm(other)]
    for part in basis:
        images = images - (images * part).sum(axis=(1, 2), keepdims=True) * part
    own = np.multiply.outer((down**2).sum(axis=1), (along**2).sum(axis=1))
    left = own - sum((down @ part @ along.T) ** 2 for part in basis)
    gain = np.maximum(down @ images @ along.T, 0) ** 2 / np.maximum(left, MIN_UNEXPLAINED)
    number = gain[0].size
    best = np.argpartition(-gain.reshape(len(images), -1), MAX_RECTANGLES, axis=1)[:, :MAX_RECTANGLES]
    rows, columns = np.divmod(best, len(along))
    drawn = (down[rows][..., :, None] * along[columns][..., None, :]).reshape(*best.shape, -1)
    fits = _fit(samples, drawn, ground.reshape(1, 1, -1), any_contrast=True)
    return np.asarray(np.logaddexp.reduce(fits.logs, axis=1) + math.log(RECTANGLES_ODDS / number))


def _log_grids(samples: _Samples, whiteness: Array, blur: tuple[float, float], dictionary: str) -> Array:
    """Return the log posterior (N,) of squares of other grids, with the bits that readings show."""
    n = samples.n_cells
    side = PARTS * (n + 2)
    inside = whiteness.reshape(-1, side, side)[:, PARTS:-PARTS, PARTS:-PARTS].astype(np.float32)
    others = [bits for bits in OTHER_GRIDS if border_cells(dictionary) > 1 or bits != n - 2]
    drawn = []
    for bits in others:
        size = (bits + 2, bits + 2)
        black = np.stack([cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in inside]) < 0.5
        black[:, [0, -1]] = black[:, :, [0, -1]] = True
        along, down = (gather(_places(n), np.linspace(0, n, bits + 3), value) for value in blur)
        drawn.append((1 - down @ black.astype(float) @ along.T).reshape(len(inside), -1))
    fits = _fit_cards(samples, np.stack(drawn, axis=1))
    costs = -math.log(2) * np.square(others)
    return np.asarray(np.logaddexp.reduce(fits.logs + costs, axis=1) + math.log(GRIDS_ODDS))
