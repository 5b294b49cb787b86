"""Images that were taken while the camera moved: markers fitted again under the streak that it makes of them.

A camera that moves straight makes the same streak of every point. As long as blur is taken as round,
headings are off by what a streak feigns, and their covariances do not say so. Whether there is a streak is
asked of the fits of a few markers, together, since it is then better told than by one. Only if there is one,
markers are fitted again under an elliptic blur. A camera that turns, or a marker that moves by itself, makes
other streaks of different markers; these are fitted under the streak that they have in common.
"""

import numpy as np

from skyherd.geometry import BoolArray, IntArray
from skyherd.markers.dictionary import code_distance
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.fitting.streak_evidence import streak_evidence
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.scales import MAX_SIDE_PX
from skyherd.vision.photometric.unknown_blur import fit_any_blur, is_promising, with_usual_blur
from skyherd.vision.photometric.verify import verified

MAX_MARKERS, MAX_PIXELS = 4, 3000
"""So many markers at most, of so many pixels together, are asked whether there is a streak. Chosen: a streak
that turns a heading by its standard deviation raises the chi-squared of each marker by more than one, so
that four tell it; more of them take time in every image."""

SIGNIFICANT = 20.0
"""Fall of the chi-squared from which on there is a streak. Derived: chance reaches `exp(-20 / 2)`, once in
22000 images."""

MIN_STREAK_PX2 = 0.02
"""Smallest streak, px², that markers are fitted again for. Chosen: that of 0.7 px; less turns no heading by
its noise, and lenses have as much."""

MAX_ROUNDS, SETTLED_SHARE = 4, 0.05
"""Markers are fitted under a streak so often at most, until it changes by less than this share. Chosen: what
is left is of second order in the change."""


def with_streak(
    image: Image, dictionary: str, fits: FitResults, good: BoolArray, plane: Plane
) -> tuple[FitResults, BoolArray, Plane]:
    """Return fits under the streak that the image has; the same, as they are, if it has none.

    Args:
        image: that was fitted, grey, (height, width).
        dictionary: of the markers.
        fits: of N markers under round blur.
        good: (N,) which of them are verified; these tell whether there is a streak.
        plane: that they lie on.

    Returns:
        The fits, which of them (N,) are verified, and the plane.
    """
    rows = _telling(fits, good)
    if not rows.size:
        return fits, good, plane
    noise = weighted_median(fits.noise_stds, fits.pixels * good)
    few = _few(fits, rows)
    evidence = streak_evidence(image, dictionary, fits.take(few), plane, noise, 0j)
    if evidence.significance() < SIGNIFICANT or abs(evidence.change_px2()) < MIN_STREAK_PX2:
        return fits, good, plane
    promising = np.flatnonzero(is_promising(fits))
    streak_px2, old = 0j, fits.take(promising)
    new, new_plane, telling = old, plane, np.flatnonzero(np.isin(promising, rows))
    for _ in range(MAX_ROUNDS):
        evidence = streak_evidence(image, dictionary, new.take(telling), new_plane, noise, streak_px2)
        change = evidence.change_px2()
        if abs(change) < SETTLED_SHARE * abs(streak_px2):
            break
        streak_px2 += change
        new, new_plane = fit_any_blur(
            image,
            dictionary,
            new.ids,
            new.homographies,
            with_usual_blur(new),
            new_plane,
            noise,
            streak_px2=streak_px2,
        )
    if np.median(new.noise_stds[telling] / old.noise_stds[telling]) > 1:
        return fits, good, plane
    is_good = verified(new, image_noise(image), code_distance(dictionary))
    good = good.copy()
    good[promising[is_good]] = True
    return fits.put(promising[is_good], new.take(is_good)), good, new_plane


def _telling(fits: FitResults, good: BoolArray) -> IntArray:
    """Indices of the fits that tell of a streak: verified ones that are fitted in the image's own pixels."""
    return np.flatnonzero(good & (fits.homographies.sides_px() <= MAX_SIDE_PX))


def _few(fits: FitResults, rows: IntArray) -> IntArray:
    """Those of the fits at indices `rows`, at least one, that are asked in every image."""
    few = rows[:: max(1, -(-rows.size // MAX_MARKERS))]
    return few[: max(1, int((np.cumsum(fits.pixels[few]) <= MAX_PIXELS).sum()))]
