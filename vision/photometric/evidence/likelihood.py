"""Log odds that a quadrilateral shows a marker, against everything else that it may show.

Its readings (`readings`) are explained by the marker's pattern under variable light (`pattern_fit`). Of
overexposed images patterns are clipped, bits under glare do not count, and edges of shadows (`shade`) and
lines (`lines`) across a candidate are removed, where that raises its odds. With L_k the likelihood of marker
and quarter turn k among the 4 D of a dictionary, the log odds are

    log L_k - log 4D - log Σ_j o_j L_j

over four kinds of other hypotheses j, with prior odds o_j against a marker: other codes; the same grid with
bits of any colour, each by chance; a square of another grid with the bits that it shows, at `2^-bits` (both
in `random_bits`); a dark square with a light rectangle (`rectangles`). The number of hypotheses tried, 4 D,
is part of the odds, so that one threshold serves all dictionaries.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import border_cells, cells_per_side, dictionary_size
from skyherd.vision.grey import Image
from skyherd.vision.photometric.evidence.lines import without_line
from skyherd.vision.photometric.evidence.pattern_fit import (
    fit_cards,
    fit_patterns,
    whiteness,
)
from skyherd.vision.photometric.evidence.random_bits import (
    SPOILT_CELLS,
    Drawn,
    log_bits,
    log_grids,
    resolved_shares,
)
from skyherd.vision.photometric.evidence.readings import (
    BLURS_CELLS,
    Readings,
    black_cells,
    draw_codes,
    exposed,
    nearest_codes,
)
from skyherd.vision.photometric.evidence.rectangles import log_rectangles
from skyherd.vision.photometric.evidence.shade import without_shade
from skyherd.vision.row_record import RowRecord

BITS_ODDS, RECTANGLES_ODDS, GRIDS_ODDS = 0.05, 0.03, 0.05
"""Prior odds of each kind of clutter against a marker. Chosen."""

MIN_LOG_ODDS, ROBUST_LOG_ODDS, LIKE_LOG_ODDS = 8.2, 1.8, 1.2
"""Log odds from which on a candidate is accepted, 3,600 to 1, and what two kinds of further evidence add: a
robust fit, by which its pixels agree on a pose, and another marker of like size in the image. All bits of
4X4_50 must be readable without these, 13 of 16 with the first, 12 with both. Chosen with other seeds than
those of the tables: `docs/conditions.md` has recall and clutter at other values."""

CLEAR_LOG_ODDS, MAX_DOUBT = 9.0, 0.27
"""Log odds from which on nothing that may lie on a candidate is looked for. Where a dictionary has too few
bits for these or those above, the most that an image can show less the second. Chosen: sharp markers in
even light have more, also with two wrong bits of 36."""

CANDIDATES_AT_ONCE = 128
"""Candidates whose readings and patterns are in memory together. Chosen: they take 10 MB, however many
candidates a page of text has."""

MAX_CONTRADICTION, MIN_LOCAL_RANGE = 0.07, 0.15
"""Largest share of cells that their neighbours may contradict, and the range among neighbours, as share of
the marker's, from which they count. Chosen: between what blur or glare changes and a shaded half."""

HOPELESS = 1.0
"""Log odds below which the remaining hypotheses are not compared. Chosen: no candidate recovers from it."""

MIN_CELL_CORRELATION = 0.65
"""Smallest correlation of a candidate's cells with a code's for a comparison of hypotheses. Measured:
accepted markers have 0.73 or more under odd conditions (tuning seeds), and those that are worth another fit
0.68; half of the clutter on photographs has less. Chosen below these."""

CLEAR_CELL_CORRELATION = 0.9
"""Correlation from which on a candidate is compared with all hypotheses, whatever wide cards leave of it: on
a dark robot with a narrow card, they explain nothing. Measured: 568 of 668 such candidates on black robots
with margins of 0.2 cells have it, and of 2,200 that wide cards leave without hope on photographs 43."""

FIRST_CODES, FIRST_LOG_ODDS, MAX_FIRST_STD = 2, (3.0, 1.0), 0.25
"""Number of codes that are compared first, without narrow cards; the log odds against the other code and
against bits by chance, and the noise, share of the readings' range, beyond which nothing else is compared.
Chosen: far from markers, which have 30, 5 and 0.13 unless something lies on them. It spares nine tenths of
the time on a photograph of clutter."""

SHADED_LOG_ODDS = 3.0, -1.0
"""The same log odds from which on edges of shadows are looked for. Measured: 92 % of the markers of 4X4_50
have them under an edge to 0.3 of the light (tuning seeds), and 10 % of the clutter of a contest table. Those
above leave 71 and 7 %."""

MAX_SHADOW_EDGES = 2
"""Edges of shadows across a candidate that are removed, one after the other. Chosen: the slat of a blind has
two; a third finds a tenth more markers under a blind, and takes as long as each of the others."""

CROSSED_LOG_ODDS, MAX_LINES = (3.0, -12.0), 2
"""The same log odds from which on lines are looked for, and how many are removed. Chosen: three wrong bits of
16 have -7; two lines leave most cells visible. Measured on photographs: it takes 1 % of the time."""


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
        ceilings: (N,) log odds that it would have at most, by its blur, with every bit beyond doubt.
    """

    ids: IntArray
    turns: IntArray
    log_odds: Array
    against: Array
    blacks: Array
    contrasts: Array
    noise_stds: Array
    outlier_shares: Array
    ceilings: Array


def most_log_odds(dictionary: str) -> float:
    """Return the log odds of an image that shows every bit beyond doubt; no image has more.

    With n bits and D markers, against bits by chance, they are `n log 2 (1 - a) - log 4D - log BITS_ODDS`,
    with a the probability `SPOILT_CELLS`: 8.5 for 4X4_50 and 19.5 for 36h11. Clutter with the bits of a
    marker has as much.
    """
    return _most_log_odds(dictionary, 1.0)


def _most_log_odds(dictionary: str, resolved_share: float) -> float:
    """Return the most log odds with a share of the bits independent; see `most_log_odds`."""
    bits = resolved_share * (cells_per_side(dictionary) - 2 * border_cells(dictionary)) ** 2
    tried = math.log(4 * dictionary_size(dictionary))
    return bits * math.log(2 * (1 - SPOILT_CELLS)) - tried - math.log(BITS_ODDS)


def min_log_odds(
    dictionary: str, *, robust: bool | BoolArray = False, has_like: bool | BoolArray = False
) -> Array:
    """Return the log odds () or (N,) from which on candidates are accepted as markers of a dictionary.

    Args:
        dictionary: of the markers.
        robust: () or (N,) whether a robust fit measures the candidate.
        has_like: () or (N,) whether the image has another marker of like size.
    """
    evidence = ROBUST_LOG_ODDS * np.asarray(robust) + LIKE_LOG_ODDS * np.asarray(has_like)
    return np.minimum(MIN_LOG_ODDS - evidence, clear_log_odds(dictionary))


def clear_log_odds(dictionary: str) -> float:
    """Return the log odds from which on a candidate is clear: nothing that may lie on it is looked for."""
    return min(CLEAR_LOG_ODDS, most_log_odds(dictionary) - MAX_DOUBT)


def marker_odds(image: Image, corners_px: Array, dictionary: str) -> MarkerOdds:
    """Return the evidence for the likeliest marker of each of N candidates.

    Candidates with bits beyond the image's edges have none.

    Args:
        image: grey, (height, width).
        corners_px: (N, 4, 2) corners, px, clockwise as seen, beginning with any of the four.
        dictionary: of the markers.
    """
    odds = no_odds(np.zeros(len(corners_px), dtype=np.int64))
    whole = np.flatnonzero(_bits_in_image(image, corners_px, dictionary))
    for begin in range(0, whole.size, CANDIDATES_AT_ONCE):
        rows = whole[begin : begin + CANDIDATES_AT_ONCE]
        odds = odds.put(rows, _odds_in_image(image, corners_px[rows], dictionary))
    return odds


def _bits_in_image(image: Image, corners_px: Array, dictionary: str) -> BoolArray:
    """Return which squares (N, 4, 2), px, have all bits in the image."""
    inner = 1 - 2 * border_cells(dictionary) / cells_per_side(dictionary)
    middles_px = corners_px.mean(axis=1, keepdims=True)
    bits_px = middles_px + inner * (corners_px - middles_px)
    limits_px = np.array(image.shape[::-1]) - 0.5
    return np.asarray(((bits_px >= -0.5) & (bits_px <= limits_px)).all(axis=(1, 2)))


def _odds_in_image(image: Image, corners_px: Array, dictionary: str) -> MarkerOdds:
    """Return the evidence for the likeliest marker of each of N candidates, at least one, in the image."""
    readings = Readings.read(image, corners_px, cells_per_side(dictionary))
    odds = _odds_of_readings(readings.all_seen(), dictionary)
    # Bright parts are white cells or glare: the explanation with the greater odds counts.
    rows = np.flatnonzero((readings.seen < 1).any(axis=1))
    if rows.size:
        odds = _greater(odds, rows, _odds_of_readings(readings.take(rows), dictionary))
    odds = _without(odds, readings, dictionary, without_shade, SHADED_LOG_ODDS, MAX_SHADOW_EDGES)
    return _without(odds, readings, dictionary, without_line, CROSSED_LOG_ODDS, MAX_LINES)


def _without(
    odds: MarkerOdds,
    readings: Readings,
    dictionary: str,
    remove: Callable[[Readings, str], tuple[Readings, BoolArray]],
    least: tuple[float, float],
    most: int,
) -> MarkerOdds:
    """Return odds, those of doubtful candidates without what lies on them where these are greater.

    A candidate so blurred that no bits could make it a marker is left as it is: most letters of a page are.

    Args:
        odds: of N candidates so far.
        readings: of the candidates.
        dictionary: of the markers.
        remove: returns readings without one edge or line, and which candidates have one.
        least: log odds against another code and bits by chance from which on it is called.
        most: number of edges or lines that are removed, one after the other.
    """
    rows, clear = np.arange(len(readings.levels)), readings
    for _ in range(most):
        so_far = odds.take(rows)
        doubtful = so_far.log_odds < clear_log_odds(dictionary)
        doubtful &= so_far.ceilings >= min_log_odds(dictionary, robust=True)
        rows, clear = _only(rows, clear, doubtful & _is_hopeful(so_far, least))
        if not rows.size:
            break
        clear, has_one = remove(clear, dictionary)
        rows, clear = _only(rows, clear, has_one)
        if not rows.size:
            break
        odds = _greater(odds, rows, _odds_of_readings(clear, dictionary))
    return odds


def _greater(odds: MarkerOdds, rows: IntArray, others: MarkerOdds) -> MarkerOdds:
    """Return odds, those at indices `rows` (M,) replaced by others (M,) where these are greater."""
    better = others.log_odds > odds.log_odds[rows]
    return odds.put(rows[better], others.take(better))


def _only(rows: IntArray, readings: Readings, mask: BoolArray) -> tuple[IntArray, Readings]:
    """Return the rows (M,) and readings of a mask (N,)."""
    return rows[mask], readings.take(mask)


def _odds_of_readings(readings: Readings, dictionary: str) -> MarkerOdds:
    """Return the evidence for the likeliest marker of each of N candidates, by its readings."""
    codes, correlations = nearest_codes(readings, dictionary)
    odds, alike = no_odds(codes[:, 0]), np.flatnonzero(correlations >= MIN_CELL_CORRELATION)
    if not alike.size:
        return odds
    first = _odds_of_codes(readings.take(alike), codes[alike, :FIRST_CODES], dictionary, first=True)
    is_likely = _is_hopeful(first) | (correlations[alike] >= CLEAR_CELL_CORRELATION)
    odds, likely = odds.put(alike, first), alike[is_likely]
    if not likely.size:
        return odds
    return odds.put(likely, _odds_of_codes(readings.take(likely), codes[likely], dictionary))


def no_odds(codes: IntArray) -> MarkerOdds:
    """Return the record of N candidates that are compared with no hypothesis; it names `codes` (N,)."""
    count, (ids, turns) = len(codes), np.divmod(codes, 4)
    never, nothing = np.full(count, -np.inf), np.zeros(count)
    against = np.full((count, 4), -np.inf)
    return MarkerOdds(ids, turns, never, against, nothing, nothing, np.full(count, np.inf), nothing, never)


def _is_hopeful(odds: MarkerOdds, least: tuple[float, float] = FIRST_LOG_ODDS) -> BoolArray:
    """Return which candidates (N,) are worth the comparison with all hypotheses."""
    hopeful = (odds.against[:, :2] > least).all(axis=1)
    return np.asarray(hopeful & (odds.noise_stds < MAX_FIRST_STD))


def log_likelihoods(image: Image, corners_px: Array, ids: IntArray, dictionary: str) -> Array:
    """Return the log likelihoods (N,) of the readings for markers at corners (N, 4, 2) in their own order.

    They compare several poses of one marker.
    """
    if not len(corners_px):
        return np.zeros(0)
    readings = Readings.read(image, corners_px, cells_per_side(dictionary))
    _, clips, drawn = draw_codes(readings, 4 * ids[:, None], dictionary)
    return np.asarray(fit_cards(readings, exposed(drawn, clips[..., None])).logs[:, 0])


def _odds_of_codes(
    readings: Readings, codes: IntArray, dictionary: str, *, first: bool = False
) -> MarkerOdds:
    """Return the evidence for the likeliest of K codes (N, K).

    At first, wide cards alone are fitted and compared with bits by chance alone; the log odds are then -inf.
    """
    rows, tried = np.arange(len(codes)), math.log(4 * dictionary_size(dictionary))
    blurs, clipped, drawn = draw_codes(readings, codes, dictionary)
    fits = (fit_patterns if first else fit_cards)(readings, exposed(drawn, clipped[..., None]))
    best = np.argmax(fits.logs, axis=1)
    code, blur, clips, pattern, std = (
        values[rows, best] for values in (codes, blurs, clipped, drawn, fits.stds)
    )
    seen = np.isfinite(fits.logs[rows, best])
    logs = np.where(seen, fits.logs[rows, best], 0.0)
    against = np.full((len(codes), 4), np.inf)
    others = fits.logs.copy()
    others[rows, best] = -np.inf
    against[:, 0] = logs - np.logaddexp.reduce(others, axis=1)
    white, contrasts = whiteness(readings, fits, best)
    shares = contrasts / readings.scales[:, None]
    bits = log_bits(readings, white, shares, Drawn(pattern, blur, clips), std, dictionary)
    against[:, 1] = resolved_shares()[blur] * bits - tried - math.log(BITS_ODDS)
    log_odds = np.full(len(codes), -np.inf)
    if not first:
        wrong_shares = _contradictions(readings, black_cells(dictionary)[code] < 0.5)
        is_possible = seen & (wrong_shares <= MAX_CONTRADICTION)
        hopeful = is_possible & (against.min(axis=1) > HOPELESS)
        for number, clip in np.unique(np.column_stack([blur, clips])[hopeful], axis=0):
            few = np.flatnonzero(hopeful & (blur == number) & (clips == clip))
            these, spread = readings.take(few), BLURS_CELLS[number]
            rectangles = log_rectangles(these, spread, clips=bool(clip)) + math.log(RECTANGLES_ODDS)
            grids = log_grids(these, white[few], spread, dictionary, clips=bool(clip))
            against[few, 2] = logs[few] - tried - rectangles
            against[few, 3] = logs[few] - tried - grids - math.log(GRIDS_ODDS)
        log_odds = np.where(is_possible, -np.logaddexp.reduce(-against, axis=1), -np.inf)
    against[~seen] = -np.inf
    ids, turns = np.divmod(code, 4)
    outliers = fits.outlier_shares[rows, best]
    blacks, levels = fits.levels[rows, best, :2].T
    ceilings = _ceilings(dictionary)[blur]
    return MarkerOdds(ids, turns, log_odds, against, blacks, levels, std, outliers, ceilings)


def _contradictions(readings: Readings, white: BoolArray) -> Array:
    """Return the share (N,) of cells that their neighbours show in another colour than codes (N, n, n) have.

    Corners of the border do not count: there robots have the bolts that hold their card.

    Under a hard shadow a code can explain the lit half and take all of the shaded half for black. Each cell
    is therefore also compared with the darkest and brightest of the cells around it, where these differ.
    """
    cells = readings.cells
    around = np.lib.stride_tricks.sliding_window_view(cells, (3, 3), axis=(1, 2))
    dark, bright = around.min(axis=(3, 4)), around.max(axis=(3, 4))
    differ = bright - dark > MIN_LOCAL_RANGE * readings.ranges[:, None, None]
    differ &= readings.cells_seen[:, 1:-1, 1:-1] > 0.5
    wrong = (cells[:, 1:-1, 1:-1] > (dark + bright) / 2) != white
    wrong[:, :: white.shape[1] - 1, :: white.shape[2] - 1] = False
    return np.asarray((wrong & differ).mean(axis=(1, 2)))


@lru_cache(maxsize=16)
def _ceilings(dictionary: str) -> Array:
    """Return the most log odds (blurs,) under a blur; see `most_log_odds`."""
    return np.array([_most_log_odds(dictionary, share) for share in resolved_shares()])
