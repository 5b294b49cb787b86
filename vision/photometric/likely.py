"""Markers that no fit verifies: their evidence, and their measurement where it suffices.

A candidate is weighed at the pose by its edges, or at that of its fit. A likely marker is measured by a fit
to the ground around it, a robust fit, or its edges.
"""

from dataclasses import replace

import numpy as np

from skyherd.geometry import Array, BoolArray
from skyherd.markers.dictionary import border_cells, cells_per_side, code_distance, sides_of_corners
from skyherd.messages import Quality
from skyherd.vision.grey import Image
from skyherd.vision.photometric.candidates import Weighed
from skyherd.vision.photometric.cards import MAX_OUTLINE_RATIO, are_on_ground, fit_to_ground
from skyherd.vision.photometric.covered import fit_visible_pixels
from skyherd.vision.photometric.evidence.likelihood import (
    MarkerOdds,
    clear_log_odds,
    log_likelihoods,
    marker_odds,
    min_log_odds,
)
from skyherd.vision.photometric.fitting.fit_result import FitResults, replaced
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.image_noise import Noises
from skyherd.vision.photometric.verify import MAX_KEYSTONE, MIN_MARKER_CONTRAST, STRONG_DISTANCE, verified
from skyherd.vision.search.edges import EdgeFits, fit_edges

CORNER_STD_PX = 0.5
"""Standard deviation of a corner by its edges against one by a fit, px. Chosen: half a pixel of blur and
processing. A fit's pose costs `d² / 2 CORNER_STD_PX²` of log odds for each corner that is d px off."""

MIN_OUTLINE_SHARE = 0.15
"""Smallest brightening outwards from a marker's sides, as a share of its contrast. Chosen: half as much again
as is needed. Measured on 1,440 drawings of markers within black borders 2 to 13 cells wide: none is accepted,
five with 0.1, and 175 without this rule. Of 144 markers of 20 to 50 px without a margin, on ground brighter
than their black by 0.08 to 0.2, 114 are found, with 0.25 ten. On photographs no candidate depends on it."""

CHI2_MEDIAN, MIN_VARIANCE = 0.455, 1e-9
"""Median of the chi-squared distribution with one degree of freedom, and the least variance that is divided
by."""

MAX_POSE_COST = 15.0
"""A fit that costs more has found another place than the edges. Chosen: 1.4 px at each corner."""

MAX_LOG_LOSS = 2.0
"""Log likelihood by which a robust fit may explain the readings worse than the edges. Chosen: both then
explain them as well, and the fit is more precise. Measured under odd conditions (4X4_50, tuning seeds): with
0 ten of 1,848 markers are not found; with 5 fits under edges of shadows are 0.09 instead of 0.05 px off."""

MAX_SIDE_RATIO = 1.5
"""Largest ratio of the sides of two markers of like size. Chosen: the markers of a team have one size, and a
tilted camera sees neighbours about as large as each other."""

MAX_UNEXPLAINED_SHARE = 0.5
"""Largest share of bits that a robust fit may leave unexplained. Measured under glare over markers of 48 px:
centres of fits that leave 0.3 to 0.5 are 0.007 px off, by the edges 0.031 px; beyond 0.5, 0.037 and 0.026."""


def weigh(image: Image, dictionary: str, edges: EdgeFits, fitted_px: Array) -> MarkerOdds:
    """Return the evidence at the poses by edges or fits; hopeless where there is no outline."""
    odds = _best_odds(image, dictionary, edges.corners_px, fitted_px)
    has_outline = edges.rises >= MIN_OUTLINE_SHARE * odds.contrasts
    return replace(odds, log_odds=np.where(has_outline, odds.log_odds, -np.inf))


def are_likely(image: Image, dictionary: str, fits: FitResults) -> BoolArray:
    """Return which fits (N,) show their own marker beyond doubt, by the log odds at the edges beside them."""
    corners_px = fits.corners_px
    odds = weigh(image, dictionary, fit_edges(image, corners_px, cells_per_side(dictionary)), corners_px)
    is_own = (odds.ids == fits.ids) & (odds.turns == 0)
    return np.asarray(is_own & (odds.log_odds >= clear_log_odds(dictionary)))


def _best_odds(image: Image, dictionary: str, edges_px: Array, fitted_px: Array) -> MarkerOdds:
    """Return the evidence at the pose by the edges, or by the fit if it is greater in spite of its distance.

    The edges have no part in the pattern, so that clutter cannot be bent to resemble a marker. A fit to
    clutter can, and pays for each corner that it moves.
    """
    odds = marker_odds(image, edges_px, dictionary)
    costs = _pose_costs(fitted_px, edges_px)
    rows = np.flatnonzero((odds.log_odds < clear_log_odds(dictionary)) & (costs < MAX_POSE_COST))
    if not rows.size:
        return odds
    fitted = marker_odds(image, fitted_px[rows], dictionary)
    fitted = replace(fitted, log_odds=fitted.log_odds - costs[rows])
    better = fitted.log_odds > odds.log_odds[rows]
    return odds.put(rows[better], fitted.take(better))


def _pose_costs(fitted_px: Array, edges_px: Array) -> Array:
    """Return log odds (N,) that the distance of fitted corners from those by the edges costs."""
    square = (np.nan_to_num(fitted_px - edges_px, nan=np.inf) ** 2).sum(axis=(1, 2))
    return np.asarray(square / (2 * CORNER_STD_PX**2))


def decide(
    image: Image,
    dictionary: str,
    fits: FitResults,
    good: BoolArray,
    weighed: Weighed,
    plane: Plane,
    known_plane: Plane,
    known_sides_px: Array,
    noises: Noises,
) -> tuple[FitResults, BoolArray, Plane]:
    """Accept likely markers by a fit to ground, a robust fit or their edges.

    Args:
        image: that was fitted, grey, (height, width).
        dictionary: of the markers.
        fits: of N candidates.
        good: (N,) which are accepted already.
        weighed: evidence for M of the others, with their rows among the fits.
        plane: that the markers lie on.
        known_plane: that of other markers of the image.
        known_sides_px: (M,) sides of other markers of the image, px.
        noises: of the image.

    Returns:
        The fits, which of them (N,) are accepted, and the plane.
    """
    others_px = np.concatenate([known_sides_px, fits.take(good).homographies.sides_px()])
    has_like = _have_like(dictionary, weighed, others_px)
    least = min_log_odds(dictionary, robust=True, has_like=has_like)
    likely = np.flatnonzero(~good[weighed.rows] & (weighed.odds.log_odds >= least))
    if not likely.size:
        return fits, good, plane
    weighed, has_like = weighed.take(likely), has_like[likely]
    rows, odds = weighed.rows, weighed.odds
    edges = weighed.edges.turned(odds.turns)
    read = replace(fits.take(rows), ids=odds.ids, blacks=odds.blacks, contrasts=odds.contrasts)
    ground, on_ground, plane = _on_ground(
        image, dictionary, read, edges, fits.take(good), plane, noises.image
    )
    fits, good = replaced(fits, good, rows[on_ground], ground)
    others = np.flatnonzero(~on_ground)
    if not others.size:
        return fits, good, plane
    read, edges = read.take(others), edges.take(others)
    measured = _measured(image, dictionary, read, known_plane, noises.verified, edges)
    is_robust = measured.qualities == Quality.ROBUST
    least = min_log_odds(dictionary, robust=is_robust, has_like=has_like[others])
    accepted = odds.log_odds[others] >= least
    if code_distance(dictionary) < STRONG_DISTANCE:
        accepted &= np.abs(measured.homographies.keystones()) <= MAX_KEYSTONE
    return *replaced(fits, good, rows[others[accepted]], measured.take(accepted)), plane


def _have_like(dictionary: str, weighed: Weighed, others_px: Array) -> BoolArray:
    """Return the mask (N,) of candidates for which the image has another marker of like size.

    Such are the accepted markers, with sides `others_px` (M,), and the clear ones of the candidates.
    """
    sides_px = sides_of_corners(weighed.edges.corners_px)
    is_clear = weighed.odds.log_odds >= clear_log_odds(dictionary)
    ratios = sides_px[:, None] / np.concatenate([others_px, sides_px[is_clear]])
    return np.asarray((np.maximum(ratios, 1 / ratios) <= MAX_SIDE_RATIO).any(axis=1))


def _on_ground(
    image: Image,
    dictionary: str,
    fits: FitResults,
    edges: EdgeFits,
    others: FitResults,
    plane: Plane,
    noise: float,
) -> tuple[FitResults, BoolArray, Plane]:
    """Return verified fits to ground of those of likely markers (N,) that have no card.

    Also returned are the mask (N,) of these, and the plane.
    """
    shares = edges.rises / np.maximum(fits.contrasts, MIN_MARKER_CONTRAST)
    mask = shares < 1
    if not mask.any():
        return fits.take(mask), mask, plane
    start = _by_edges(fits, edges).take(mask)
    new, new_plane = fit_to_ground(image, dictionary, start, shares[mask] - 1, others, plane, noise)
    new = replace(new, log_odds=start.log_odds)
    is_good = new.surroundings.levels > MAX_OUTLINE_RATIO * (shares[mask] - 1)
    is_good &= are_on_ground(new, noise) & verified(new, noise, code_distance(dictionary))
    mask[mask] = is_good
    return new.take(is_good), mask, new_plane if is_good.any() else plane


def _measured(
    image: Image, dictionary: str, fits: FitResults, known_plane: Plane, noise: float, edges: EdgeFits
) -> FitResults:
    """Measure accepted markers by the robust fit or the edges: the pose that explains the readings better."""
    by_edges = _by_edges(fits, edges)
    near = _pose_costs(fits.corners_px, edges.corners_px) < MAX_POSE_COST
    start = by_edges.put(np.flatnonzero(near), fits.take(near))
    logs = log_likelihoods(image, edges.corners_px, fits.ids, dictionary)

    def is_robust(visible: FitResults) -> BoolArray:
        return np.asarray(
            (log_likelihoods(image, visible.corners_px, fits.ids, dictionary) > logs - MAX_LOG_LOSS)
            & (_unexplained_shares(visible, dictionary) <= MAX_UNEXPLAINED_SHARE)
            & np.isfinite(visible.covariances).all(axis=(1, 2))
            & (visible.contrasts > 0)
        )

    visible, robust_mask, _ = fit_visible_pixels(image, dictionary, start, known_plane, noise, is_robust)
    robust = np.flatnonzero(robust_mask)
    if not robust.size:
        return by_edges
    fitted = visible.take(robust)
    measured = replace(
        fitted,
        covariances=_structure_factors(fitted)[:, None, None] * fitted.covariances,
        qualities=np.full(robust.size, Quality.ROBUST.value),
        log_odds=fits.log_odds[robust],
    )
    return by_edges.put(robust, measured)


def _unexplained_shares(fits: FitResults, dictionary: str) -> Array:
    """Return shares (N,) of the cells with a bit that a robust fit leaves unexplained."""
    border = border_cells(dictionary)
    bits = np.abs(fits.cell_means[:, border:-border, border:-border])
    return np.asarray((bits > fits.contrasts[:, None, None] / 2).mean(axis=(1, 2)))


def _structure_factors(fits: FitResults) -> Array:
    """Return the factors (N,) by which residuals that are alike over a cell increase a pose's variances.

    Independent noise leaves cell means of variance `σ² / pixels of a cell`. Shade, halos and interlacing
    leave more, and a pose varies with them as with noise of that much greater variance.
    """
    cells = np.square(fits.cell_means)
    by_noise = fits.noise_stds**2 * cells.shape[1] * cells.shape[2] / np.maximum(fits.pixels, 1.0)
    measured = np.median(cells, axis=(1, 2)) / CHI2_MEDIAN
    return np.asarray(np.maximum(1.0, measured / np.maximum(by_noise, MIN_VARIANCE)))


def _by_edges(fits: FitResults, edges: EdgeFits) -> FitResults:
    """Return fits with the poses and covariances of the markers' edges."""
    return replace(
        fits,
        homographies=LocalHomographies.of_quads(edges.corners_px),
        covariances=edges.variances[:, :, None] * np.eye(3),
        qualities=np.full(fits.ids.size, Quality.CORNERS.value),
        boxes=np.zeros(fits.ids.size),
    )
