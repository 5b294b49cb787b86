"""Measurement of candidates: fit, verify, refit, once, in this order.

1. *Fit* the known pattern to the pixels: coarse first, then at full size with the blur that was found.
2. *Verify*: a fit whose residual is noise, and every cell right, is a photometric measurement (`verify`).
3. *Weigh* the rest: the log odds that each is a marker, by its readings at its edges (`evidence.likelihood`).
4. *Refit* what may be a marker: to its visible pixels, on the plane that markers show which nothing covers;
   then with a perspective of its own; and all under a streak of motion if the image has one.
5. *Decide* about the rest by their log odds: a marker beyond doubt is reported though no fit explains its
   pixels. It is measured by a robust fit, or by its edges where that disagrees with them. A robust fit is
   evidence too, and so is another marker of like size in the image: with either lower log odds suffice.
   `FitResults.qualities` says how a marker was measured. This step also accepts markers whose fit was refused
   for its blur.

Markers without a white card are fitted to the ground around them, in step 2 and in step 5 (`cards`).

A verified fit is not asked for its likelihood, which would change little. Measured: of 1978 verified markers
on photographs one has hopeless log odds. Of 30,000 shapes that are no markers two are accepted
(`benchmarks/clutter.py`).
"""

from dataclasses import replace
from functools import partial

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.markers.dictionary import cells_per_side, code_distance
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
from skyherd.vision.photometric.cards import refit_without_cards
from skyherd.vision.photometric.covered import refit_covered
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.fit import USUAL_NOISE, image_middle
from skyherd.vision.photometric.fitting.fit_result import FitResults, replaced, weighted_median
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import MIN_MARKERS_ON_PLANE, Plane
from skyherd.vision.photometric.image_noise import Noises, image_noise
from skyherd.vision.photometric.likely import decide, weigh
from skyherd.vision.photometric.refine import (
    START_SIGMA_PX,
    STEPS_PER_ROUND,
    fit_all_sizes,
    fit_any_blur,
    is_promising,
    with_streak,
    with_usual_blur,
)
from skyherd.vision.photometric.state import CameraState
from skyherd.vision.photometric.verify import (
    MAX_BLUR_CELLS,
    MIN_MARKER_CONTRAST,
    STRONG_DISTANCE,
    bits_are_right,
    may_be_occluded,
    verified,
)
from skyherd.vision.search.decode import DecodedQuads
from skyherd.vision.search.edges import fit_edges

COARSE_CELL_PX = 8.0
"""Side of a cell from which on markers are fitted in a shrunk image at first, until their blur and bits are
known. Chosen: cells then have 4 to 8 px; a larger value costs time with its square, at half of it bits of
sharpened images are lost."""

GREY_LEVELS = 256.0
"""Grey levels, so that `noise / GREY_LEVELS` is below 1 and ranks fits of one quality."""

NO_SIDES_PX = np.zeros(0)
"""Sides of other markers where none are known."""

MIN_REFIT_LOG_ODDS = 0.0
"""Log odds below which what is not verified is not refitted. Derived: something else is then more likely. A
refit masks what it does not explain, and would also explain a light rectangle as marker 17. Measured: of 641
refits on photographs and under odd conditions (both dictionaries) one marker of curled paper has less."""


def measure_candidates(
    image: Image,
    dictionary: str,
    state: CameraState,
    quads_px: Array,
    candidates: DecodedQuads,
    known_plane: Plane = OWN_PLANES,
    known_sides_px: Array = NO_SIDES_PX,
) -> SearchPass:
    """Return candidates fitted, verified and decided about, with the quadrilaterals that they are from.

    `known_plane` is that of other markers of the image, as far as they show it, and `known_sides_px` (M,) are
    their sides. Without an accepted marker the plane stays that of the state.
    """
    if not candidates.ids.size:
        return SearchPass.empty(dictionary, state.plane, quads_px)
    start = LocalHomographies.of_corners(candidates.corners_px)
    start = on_plane(start, state.plane, image_middle(image))
    fits, plane = _fit(image, dictionary, state, candidates.ids, start)
    fits, good, plane, weighed = verify_and_refit(
        image, dictionary, fits, plane, start, candidates.corners_px, known_plane, known_sides_px
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
    known_sides_px: Array = NO_SIDES_PX,
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
        known_sides_px: (M,) sides of other markers of the image, px.

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
    noises = Noises(noise, floor, _usual_noise(fits, clear, noise))
    if np.count_nonzero(clear) >= MIN_MARKERS_ON_PLANE:
        is_all = (clear == good).all()
        known_plane = plane if is_all else _plane_of(image, dictionary, fits.take(clear), plane, floor)
    if good.all():  # as in most images of a video: nothing to weigh
        fits, good, _ = refit_covered(image, dictionary, fits, good, is_covered, known_plane, noises)
        return *with_streak(image, dictionary, fits, good, plane, good), nothing_weighed()
    rest = np.flatnonzero(~good)
    edges = fit_edges(image, corners_px[rest], cells_per_side(dictionary))
    odds = weigh(image, dictionary, edges, fits.take(rest).corners_px)
    weighed = Weighed(rest, edges, odds)
    log_odds, worth = fits.log_odds.copy(), good.copy()
    log_odds[rest], worth[rest] = odds.log_odds, odds.log_odds > MIN_REFIT_LOG_ODDS
    fits = replace(fits, log_odds=log_odds)
    covered = worth & is_covered
    fits, good, known_plane = refit_covered(image, dictionary, fits, good, covered, known_plane, noises)
    if plane.shared:
        fits, good = _refit_off_plane(image, dictionary, fits, good, start, worth, noises)
    fits, good, plane = with_streak(image, dictionary, fits, good, plane, worth)
    known = plane, known_plane, known_sides_px
    fits, good, plane = decide(image, dictionary, fits, good, weighed, *known, noises)
    return fits, good, plane, weighed


def _usual_noise(fits: FitResults, mask: BoolArray, least: float) -> float:
    """Return the noise that fits of a mask (N,) leave in the median, grey levels, at least `least`."""
    return max(least, weighted_median(fits.noise_stds, fits.pixels * mask)) if mask.any() else least


def _refit_off_plane(
    image: Image,
    dictionary: str,
    fits: FitResults,
    good: BoolArray,
    start: LocalHomographies,
    worth: BoolArray,
    noises: Noises,
) -> tuple[FitResults, BoolArray]:
    """Refit what is not verified on the common plane, and worth it, each by itself; return which are good."""
    legible = (fits.contrasts >= MIN_MARKER_CONTRAST) & (fits.blurs_cells <= MAX_BLUR_CELLS)
    rows = np.flatnonzero(~good & worth & legible)
    if not rows.size:
        return fits, good
    alone = fit_alone(image, dictionary, fits.ids[rows], start.take(rows), noises.verified)
    is_good = verified(alone, noises.image, code_distance(dictionary))
    return replaced(fits, good, rows[is_good], alone.take(is_good))


def fit_alone(
    image: Image, dictionary: str, ids: IntArray, start: LocalHomographies, noise: float
) -> FitResults:
    """Fit markers (N,), each by itself, that begin at given places; `noise` is a pixel's, grey levels."""
    return fit_any_blur(image, dictionary, ids, start, START_SIGMA_PX, Plane(), noise, alone=True)[0]


def _plane_of(image: Image, dictionary: str, fits: FitResults, plane: Plane, noise: float) -> Plane:
    """Return the plane of these fits alone; `plane` is that of them and others."""
    given = fits.ids, fits.homographies, with_usual_blur(fits), plane, noise, STEPS_PER_ROUND
    return fit_all_sizes(image, dictionary, *given, surroundings=fits.surroundings)[1]
