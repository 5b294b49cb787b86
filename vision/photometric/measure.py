"""Measurement of candidates: fit, verify, refit, once, in this order.

1. *Fit* the known pattern to the pixels: coarse first, then at full size with the blur that was found.
2. *Verify*: a fit whose residual is noise, and every cell right, is a photometric measurement (`verify`).
3. *Weigh* the rest: the log odds that each is a marker, by its readings at its edges (`evidence.likelihood`).
4. *Refit* what may be a marker: to its visible pixels, on the plane that markers show which nothing covers;
   then with a perspective of its own; and all under a streak of motion if the image has one.
5. *Decide* about the rest by their log odds: a marker beyond doubt is reported though no fit explains its
   pixels. It is measured by a robust fit, or by its edges where that disagrees with them. A robust fit is
   evidence too, and with one lower log odds suffice. `FitResults.qualities` says which. This step also
   accepts markers whose fit was refused for its blur.

Markers without a white card are fitted to the ground around them, in step 2 and in step 5 (`cards`).

A verified fit is not asked for its likelihood, which would change little. Measured: of 1978 verified markers
on photographs one has hopeless log odds. Of 30,000 shapes that are no markers two are accepted
(`benchmarks/clutter.py`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, IntArray, to_points
from skyherd.markers.dictionary import border_cells, cells_per_side, code_distance
from skyherd.messages import Quality
from skyherd.vision.grey import Image
from skyherd.vision.photometric.candidates import (
    SearchPass,
    Weighed,
    may_be_cut,
    non_maximum_suppression,
    nothing_weighed,
    on_plane,
    within_better,
)
from skyherd.vision.photometric.cards import (
    MAX_OUTLINE_RATIO,
    are_on_ground,
    fit_to_ground,
    refit_without_cards,
)
from skyherd.vision.photometric.evidence.likelihood import (
    MarkerOdds,
    log_likelihoods,
    marker_odds,
    min_log_odds,
    min_robust_log_odds,
)
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.fit import USUAL_NOISE, image_middle
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import MIN_MARKERS_ON_PLANE, Plane
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.refine import (
    START_SIGMA_PX,
    STEPS_PER_ROUND,
    fit_all_sizes,
    fit_any_blur,
    fit_visible_all_sizes,
    is_promising,
    with_streak,
    with_usual_blur,
)
from skyherd.vision.photometric.state import CameraState
from skyherd.vision.photometric.verify import (
    MAX_BLUR_CELLS,
    MAX_KEYSTONE,
    MIN_MARKER_CONTRAST,
    STRONG_DISTANCE,
    bits_are_right,
    may_be_occluded,
    residual_is_noise,
    verified,
)
from skyherd.vision.search.decode import DecodedQuads
from skyherd.vision.search.edges import EdgeFits, fit_edges

COARSE_CELL_PX = 8.0
"""Side of a cell from which on markers are fitted in a shrunk image at first, until their blur and bits are
known. Chosen: cells then have 4 to 8 px; a larger value costs time with its square, at half of it bits of
sharpened images are lost."""

CORNER_STD_PX = 0.5
"""Standard deviation of a corner by its edges against one by a fit, px. Chosen: half a pixel of blur and
processing. A fit's pose costs `d² / 2 CORNER_STD_PX²` of log odds for each corner that is d px off."""

MIN_OUTLINE_SHARE = 0.15
"""Smallest brightening outwards from a marker's sides, as a share of its contrast. Chosen: half as much again
as is needed. Measured on 1,440 drawings of markers within black borders 2 to 13 cells wide: none is accepted,
five with 0.1, and 175 without this rule. Of 144 markers of 20 to 50 px without a margin, on ground brighter
than their black by 0.08 to 0.2, 114 are found, with 0.25 ten. On photographs no candidate depends on it."""

GREY_LEVELS = 256.0
"""Grey levels, so that `noise / GREY_LEVELS` is below 1 and ranks fits of one quality."""

CHI2_MEDIAN, MIN_VARIANCE = 0.455, 1e-9
"""Median of the chi-squared distribution with one degree of freedom, and the least variance that is divided
by."""

MIN_REFIT_LOG_ODDS = 0.0
"""Log odds below which what is not verified is not refitted. Derived: something else is then more likely. A
refit masks what it does not explain, and would also explain a light rectangle as marker 17. Measured: of 641
refits on photographs and under odd conditions (both dictionaries) one marker of curled paper has less."""

MAX_RATIO_TO_CLEAR = 2.0
"""Largest residual of a fit to visible pixels that replaces a verified fit, over that of clear markers.
Measured: 0.8 to 0.9 under covers and dead rows, up to 1.7 under pen lines, and 27 or more in thresholded
images."""

MAX_POSE_COST = 15.0
"""A fit that costs more has found another place than the edges. Chosen: 1.4 px at each corner."""

MAX_LOG_LOSS = 2.0
"""Log likelihood by which a robust fit may explain the readings worse than the edges. Chosen: both then
explain them as well, and the fit is more precise. Measured under odd conditions (4X4_50, tuning seeds): with
0 ten of 1,848 markers are not found; with 5 fits under edges of shadows are 0.09 instead of 0.05 px off."""

MAX_UNEXPLAINED_SHARE = 0.5
"""Largest share of bits that a robust fit may leave unexplained. Measured under glare over markers of 48 px:
centres of fits that leave 0.3 to 0.5 are 0.007 px off, by the edges 0.031 px; beyond 0.5, 0.037 and 0.026."""


def measure_candidates(
    image: Image,
    dictionary: str,
    state: CameraState,
    quads_px: Array,
    candidates: DecodedQuads,
    known_plane: Plane = OWN_PLANES,
) -> SearchPass:
    """Return candidates fitted, verified and decided about, with the quadrilaterals that they are from.

    `known_plane` is that of other markers of the image, as far as they show it. Without an accepted marker
    the plane stays that of the state.
    """
    if not candidates.ids.size:
        return SearchPass.empty(dictionary, state.plane, quads_px)
    start = LocalHomographies.of_corners(candidates.corners_px)
    start = on_plane(start, state.plane, image_middle(image))
    fits, plane = _fit(image, dictionary, state, candidates.ids, start)
    fits, good, plane, weighed = verify_and_refit(
        image, dictionary, fits, plane, start, candidates.corners_px, known_plane
    )
    parts = np.zeros(good.size, dtype=bool)
    if code_distance(dictionary) < STRONG_DISTANCE:
        seen_plane = plane if np.count_nonzero(good) >= MIN_MARKERS_ON_PLANE else known_plane
        parts = good & may_be_cut(fits.homographies, seen_plane, image.shape[::-1])
        good = good & ~parts
    found = fits.take(good)
    shapes, merits = found.homographies, found.qualities - found.noise_stds / GREY_LEVELS
    good, sides_px = good.copy(), shapes.sides_px()
    inside = within_better(found.ids, shapes.centers, sides_px, found.qualities == Quality.PHOTOMETRIC)
    good[good] = ~inside & non_maximum_suppression(found.ids, shapes.centers, sides_px, merits)
    plane = plane if good.any() else state.plane
    return SearchPass(quads_px, candidates, candidates, fits, good, plane, weighed, parts)


def _fit(
    image: Image, dictionary: str, state: CameraState, ids: IntArray, start: LocalHomographies
) -> tuple[FitResults, Plane]:
    """Fit candidates coarsely, then those that are promising finely, and return the plane that they lie on.

    Where no plane explains the known markers, a few others are not asked for one.
    """
    sigma_px, noise = state.sigma_px or START_SIGMA_PX, state.noise or USUAL_NOISE
    fit = partial(fit_any_blur, image, dictionary, alone=not state.plane.shared)
    coarse_px = COARSE_CELL_PX * cells_per_side(dictionary)
    fits, plane = fit(ids, start, sigma_px, state.plane, noise, max_side_px=coarse_px)
    promising = np.flatnonzero(is_promising(fits))
    if not promising.size:
        return fits, state.plane
    coarse = fits.take(promising)
    right = bits_are_right(coarse, code_distance(dictionary))
    if right.any():
        noise = weighted_median(coarse.noise_stds, coarse.pixels * right)
    fine, plane = fit(coarse.ids, coarse.homographies, with_usual_blur(coarse), plane, noise)
    return fits.put(promising, fine), plane if right.any() else state.plane


def verify_and_refit(
    image: Image,
    dictionary: str,
    fits: FitResults,
    plane: Plane,
    start: LocalHomographies,
    corners_px: Array,
    known_plane: Plane = OWN_PLANES,
) -> tuple[FitResults, BoolArray, Plane, Weighed]:
    """Verify fits, refit those that are not verified, and decide about the rest by likelihood.

    A fit that is refused for its blur is not refitted alone: of several fits the one with the least blur
    would pass, which has the largest error.

    Args:
        image: that was fitted, grey, (height, width).
        dictionary: of the markers.
        fits: of N markers.
        plane: that they lie on.
        start: (N,) where the fits began.
        corners_px: (N, 4, 2) corners of the markers' quadrilaterals, px.
        known_plane: of other markers of the image; it counts if these fits are too few to show theirs.

    Returns:
        The measurements, which of them (N,) are accepted, the plane, and the evidence for those that were not
        verified at first.
    """
    noise = image_noise(image)
    good = verified(fits, noise, code_distance(dictionary))
    fits, plane = refit_without_cards(image, dictionary, fits, good, plane)
    floor = _usual_noise(fits, good, noise)
    is_covered = may_be_occluded(fits, floor)
    clear = good & ~is_covered
    noises = _Noises(noise, floor, _usual_noise(fits, clear, noise))
    if np.count_nonzero(clear) >= MIN_MARKERS_ON_PLANE:
        is_all = (clear == good).all()
        known_plane = plane if is_all else _plane_of(image, dictionary, fits.take(clear), plane, floor)
    if good.all():  # as in most images of a video: nothing to weigh
        fits, good, _ = _refit_covered(image, dictionary, fits, good, is_covered, known_plane, noises)
        return *with_streak(image, dictionary, fits, good, plane, good), nothing_weighed()
    rest = np.flatnonzero(~good)
    edges = fit_edges(image, corners_px[rest], cells_per_side(dictionary))
    odds = _weighed(image, dictionary, edges, _corners(fits.take(rest)))
    weighed = Weighed(rest, edges, odds)
    log_odds, worth = fits.log_odds.copy(), good.copy()
    log_odds[rest], worth[rest] = odds.log_odds, odds.log_odds > MIN_REFIT_LOG_ODDS
    fits = replace(fits, log_odds=log_odds)
    covered = worth & is_covered
    fits, good, known_plane = _refit_covered(image, dictionary, fits, good, covered, known_plane, noises)
    if plane.shared:
        fits, good = _refit_off_plane(image, dictionary, fits, good, start, worth, noises)
    fits, good, plane = with_streak(image, dictionary, fits, good, plane, worth)
    likely = np.flatnonzero(~good[rest] & (odds.log_odds >= min_robust_log_odds(dictionary)))
    if likely.size:
        given = rest[likely], odds.take(likely), edges.take(likely).turned(odds.turns[likely])
        fits, good, plane = _decide(image, dictionary, fits, good, *given, plane, known_plane, noises)
    return fits, good, plane, weighed


def _decide(
    image: Image,
    dictionary: str,
    fits: FitResults,
    good: BoolArray,
    rows: IntArray,
    odds: MarkerOdds,
    edges: EdgeFits,
    plane: Plane,
    known_plane: Plane,
    noises: "_Noises",
) -> tuple[FitResults, BoolArray, Plane]:
    """Accept likely markers, those at indices `rows` (K,), by a fit to ground, a robust fit or their edges.

    Returned are the fits, which (N,) are accepted, and the plane.
    """
    read = replace(fits.take(rows), ids=odds.ids, blacks=odds.blacks, contrasts=odds.contrasts)
    ground, on_ground, plane = _on_ground(
        image, dictionary, read, edges, fits.take(good), plane, noises.image
    )
    fits, good = _replaced(fits, good, rows[on_ground], ground)
    others = np.flatnonzero(~on_ground)
    if not others.size:
        return fits, good, plane
    read, edges = read.take(others), edges.take(others)
    measured = _measured(image, dictionary, read, known_plane, noises.verified, edges)
    is_beyond_doubt = odds.log_odds[others] >= min_log_odds(dictionary)
    accepted = is_beyond_doubt | (measured.qualities == Quality.ROBUST)
    if code_distance(dictionary) < STRONG_DISTANCE:
        accepted &= np.abs(measured.homographies.keystones()) <= MAX_KEYSTONE
    return *_replaced(fits, good, rows[others[accepted]], measured.take(accepted)), plane


@dataclass(frozen=True)
class _Noises:
    """Standard deviations of a pixel, grey levels.

    Attributes:
        image: of the image, from its pixels' differences.
        verified: left by verified fits in the median, at least that of the image.
        clear: the same of verified fits without outliers.
    """

    image: float
    verified: float
    clear: float


def _usual_noise(fits: FitResults, mask: BoolArray, least: float) -> float:
    """Return the noise that fits of a mask (N,) leave in the median, grey levels, at least `least`."""
    return max(least, weighted_median(fits.noise_stds, fits.pixels * mask)) if mask.any() else least


def _refit_covered(
    image: Image,
    dictionary: str,
    fits: FitResults,
    good: BoolArray,
    is_covered: BoolArray,
    known_plane: Plane,
    noises: _Noises,
) -> tuple[FitResults, BoolArray, Plane]:
    """Refit covered markers, a mask (N,), to their visible pixels, on the plane that others show.

    Returned are the fits, which (N,) are verified, and the plane, known or found. Outliers along all edges,
    as of thresholded images, cover nothing: a verified fit is replaced only if the other leaves little more
    than clear markers do.
    """
    rows = np.flatnonzero(is_covered)
    if not rows.size:
        return fits, good, known_plane
    most = np.full(rows.size, noises.verified)
    most[good[rows]] = min(noises.verified, MAX_RATIO_TO_CLEAR * noises.clear)

    def is_explained(visible: FitResults) -> BoolArray:
        is_right = verified(visible, noises.image, code_distance(dictionary))
        return np.asarray(is_right & residual_is_noise(visible, most))

    there = fits.take(rows)
    visible, is_good, plane = _fit_visible(
        image, dictionary, there, known_plane, noises.verified, is_explained
    )
    return *_replaced(fits, good, rows[is_good], visible.take(is_good)), plane


def _refit_off_plane(
    image: Image,
    dictionary: str,
    fits: FitResults,
    good: BoolArray,
    start: LocalHomographies,
    worth: BoolArray,
    noises: _Noises,
) -> tuple[FitResults, BoolArray]:
    """Refit what is not verified on the common plane, and worth it, each by itself; return which are good."""
    legible = (fits.contrasts >= MIN_MARKER_CONTRAST) & (fits.blurs_cells <= MAX_BLUR_CELLS)
    rows = np.flatnonzero(~good & worth & legible)
    if not rows.size:
        return fits, good
    alone = fit_alone(image, dictionary, fits.ids[rows], start.take(rows), noises.verified)
    is_good = verified(alone, noises.image, code_distance(dictionary))
    return _replaced(fits, good, rows[is_good], alone.take(is_good))


def fit_alone(
    image: Image, dictionary: str, ids: IntArray, start: LocalHomographies, noise: float
) -> FitResults:
    """Fit markers (N,), each by itself, that begin at given places; `noise` is a pixel's, grey levels."""
    return fit_any_blur(image, dictionary, ids, start, START_SIGMA_PX, Plane(), noise, alone=True)[0]


def _plane_of(image: Image, dictionary: str, fits: FitResults, plane: Plane, noise: float) -> Plane:
    """Return the plane of these fits alone; `plane` is that of them and others."""
    given = fits.ids, fits.homographies, with_usual_blur(fits), plane, noise, STEPS_PER_ROUND
    return fit_all_sizes(image, dictionary, *given, surroundings=fits.surroundings)[1]


def _fit_visible(
    image: Image,
    dictionary: str,
    fits: FitResults,
    known_plane: Plane,
    noise: float,
    is_accepted: Callable[[FitResults], BoolArray],
) -> tuple[FitResults, BoolArray, Plane]:
    """Return fits to the visible pixels, on the known plane or, where that is not accepted, off it.

    If no plane is known, the accepted fits are fitted again on their own one, if they are enough to show it.
    Returned with the fits are which of them (N,) are accepted, and the plane, known or found.
    """
    fit = partial(fit_visible_all_sizes, image, dictionary, noise=noise)
    sigmas_px = with_usual_blur(fits)
    visible, _ = fit(fits, sigmas_px, known_plane)
    accepted = is_accepted(visible)
    off, rows = np.flatnonzero(~accepted), np.flatnonzero(accepted)
    if known_plane.shared and off.size:
        visible = visible.put(off, fit(fits.take(off), sigmas_px[off], OWN_PLANES)[0])
        return visible, is_accepted(visible), known_plane
    if known_plane.shared or rows.size < MIN_MARKERS_ON_PLANE:
        return visible, accepted, known_plane
    together, plane = fit(visible.take(rows), sigmas_px[rows], OWN_PLANES, settled=True)
    on_plane = visible.put(rows, together)
    kept = is_accepted(on_plane)
    return visible.put(np.flatnonzero(kept), on_plane.take(kept)), accepted | kept, plane


def _weighed(image: Image, dictionary: str, edges: EdgeFits, fitted_px: Array) -> MarkerOdds:
    """Return the evidence at the poses by edges or fits; hopeless where there is no outline."""
    odds = _best_odds(image, dictionary, edges.corners_px, fitted_px)
    has_outline = edges.rises >= MIN_OUTLINE_SHARE * odds.contrasts
    return replace(odds, log_odds=np.where(has_outline, odds.log_odds, -np.inf))


def are_likely(image: Image, dictionary: str, fits: FitResults) -> BoolArray:
    """Return which fits (N,) show their own marker beyond doubt, by the log odds at the edges beside them."""
    corners_px = _corners(fits)
    odds = _weighed(image, dictionary, fit_edges(image, corners_px, cells_per_side(dictionary)), corners_px)
    is_own = (odds.ids == fits.ids) & (odds.turns == 0)
    return np.asarray(is_own & (odds.log_odds >= min_log_odds(dictionary)))


def _best_odds(image: Image, dictionary: str, edges_px: Array, fitted_px: Array) -> MarkerOdds:
    """Return the evidence at the pose by the edges, or by the fit if it is greater in spite of its distance.

    The edges have no part in the pattern, so that clutter cannot be bent to resemble a marker. A fit to
    clutter can, and pays for each corner that it moves.
    """
    odds = marker_odds(image, edges_px, dictionary)
    costs = _pose_costs(fitted_px, edges_px)
    rows = np.flatnonzero((odds.log_odds < min_log_odds(dictionary)) & (costs < MAX_POSE_COST))
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
    near = _pose_costs(_corners(fits), edges.corners_px) < MAX_POSE_COST
    start = by_edges.put(np.flatnonzero(near), fits.take(near))
    logs = log_likelihoods(image, edges.corners_px, fits.ids, dictionary)

    def is_robust(visible: FitResults) -> BoolArray:
        return np.asarray(
            (log_likelihoods(image, _corners(visible), fits.ids, dictionary) > logs - MAX_LOG_LOSS)
            & (_unexplained_shares(visible, dictionary) <= MAX_UNEXPLAINED_SHARE)
            & np.isfinite(visible.covariances).all(axis=(1, 2))
            & (visible.contrasts > 0)
        )

    visible, robust_mask, _ = _fit_visible(image, dictionary, start, known_plane, noise, is_robust)
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


def _corners(fits: FitResults) -> Array:
    """Return corners (N, 4, 2), px, of fitted markers."""
    return to_points(fits.homographies.images(SQUARE_CORNERS))


def _replaced(
    fits: FitResults, good: BoolArray, rows: IntArray, others: FitResults
) -> tuple[FitResults, BoolArray]:
    """Return fits with those at indices `rows` replaced, which are then good."""
    good = good.copy()
    good[rows] = True
    return fits.put(rows, others), good
