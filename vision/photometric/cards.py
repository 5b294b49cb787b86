"""Markers without a white card: their fits to the ground around them.

A fit takes the ground around a marker for white. If a marker was cut out along its black border, such a fit
moves the outline: on light grey its corners are 0.1 to 0.6 px off. The marker is therefore fitted again with
the level and the texture of the ground as unknowns (`fitting.surroundings`). The other markers of the image
are fitted along, since they show the plane.

Two kinds of markers are fitted to ground, both of which are accepted without it:

- Verified markers with darker pixels beside them, by `MIN_DARKENING` and more than chance. The fit to ground
  is preferred if it halves the residual. It also is if it explains the image down to its noise and lowers the
  chi-squared by `SIGNIFICANT`, which chance does once in 22,000 times.
- Likely markers (step 5 of `measure`) whose outline is weaker than their contrast. The fit to ground is
  preferred if it is verified and has found a level that agrees with the outline.

In either case the ground must be darker than white, and more so (`LEVEL_TEXTURES`) if the fit leaves more
than the noise of the image.
"""

import numpy as np

from skyherd.geometry import Array, BoolArray
from skyherd.markers.dictionary import code_distance
from skyherd.vision.grey import Image
from skyherd.vision.photometric.fitting.common_unknowns import OWN_PLANES
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.fitting.surroundings import Surroundings
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.refine import SIGNIFICANT, START_SIGMA_PX, fit_any_blur, with_usual_blur
from skyherd.vision.photometric.verify import NOISE_FACTOR, verified

MIN_DARKENING, MIN_DARKENING_SHARE, DARKENING_SIGMAS = 0.01, 0.35, 4.0
"""Smallest darkening beside a verified marker that is fitted to ground: mean residual as a share of the
contrast, of the root mean square residual, and in its standard deviations. Measured on ground that is darker
than white by an eighth of the contrast: 0.015 to 0.055 and 0.5 to 1.3 from 14 px on. On photographs 10 of
2,348 markers are fitted to ground for it, and keep their cards."""

MAX_RESIDUAL_RATIO = 0.5
"""Largest ratio of residuals, of a fit to ground over that of a fit to a card, that decides where both exceed
the noise. Measured: 0.1 to 0.42 on plates."""

LEVEL_TEXTURES, NOISE_LEVEL_TEXTURES, MAX_LEVEL_RATIO = 3.0, 0.4, 12.0
"""Limits of the darkening of the ground: in standard deviations of its texture, at least, of fits that leave
more than the noise or replace a verified one, and of others; and over the mean residual beside the marker, at
most. Derived: a frame that is dark over a share p has `sqrt(p / (1 - p))` of the first: nine tenths of it, or
a seventh, are dark. Measured: small black squares at the corners of markers have up to 0.9 of it, shadows
across markers 1.8, and cards of a quarter cell about 2; plates have 10 or more, grass 5, and very rough
ground 0.5. The last is 2 to 8 on plates, and up to 20 for halos of sharpening."""

MAX_OUTLINE_RATIO = 3.0
"""Largest ratio of the darkening that a fit to ground has found over what the outline brightens less than
the contrast. Derived: the ratio is 1 without blur and noise, and blur makes it smaller. Measured: 4 for a
reflection on a photograph."""


def fit_to_ground(
    image: Image,
    dictionary: str,
    fits: FitResults,
    levels: Array,
    others: FitResults,
    plane: Plane,
    noise: float,
) -> tuple[FitResults, Plane]:
    """Return markers (N,), at least one, fitted without cards, and the plane of these and others (M,).

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        fits: where the fits begin.
        levels: (N,) of the ground to begin with, less white and over the contrast.
        others: markers on cards, which are fitted along for the plane.
        plane: of the markers, as far as it is known.
        noise: standard deviation of a pixel, grey levels.
    """
    count, both = fits.ids.size, fits.joined(others)
    around = Surroundings.of_ground(levels).joined(others.surroundings)
    given = both.ids, both.homographies, with_usual_blur(both), plane, noise
    fitted, plane = fit_any_blur(image, dictionary, *given, alone=not plane.shared, surroundings=around)
    return fitted.take(np.arange(count)), plane


def refit_without_cards(
    image: Image, dictionary: str, fits: FitResults, good: BoolArray, plane: Plane
) -> tuple[FitResults, Plane]:
    """Return fits in which those of verified markers (N,) without cards are fits to ground, and the plane."""
    rows = np.flatnonzero(good & _are_darker_beside(fits))
    if not rows.size:
        return fits, plane
    asked, noise = fits.take(rows), image_noise(image)
    each = refit_each_without_card(image, dictionary, asked, asked.homographies, noise)
    rows = rows[each.surroundings.is_bare()]
    if not rows.size:
        return fits, plane
    bare = each.take(each.surroundings.is_bare())
    others = fits.take(np.setdiff1d(np.flatnonzero(good), rows))
    new, new_plane = fit_to_ground(image, dictionary, bare, bare.surroundings.levels, others, plane, noise)
    is_good = verified(new, noise, code_distance(dictionary))
    if not is_good.any():
        return fits, plane
    return fits.put(rows[is_good], new.take(is_good)), new_plane


def refit_each_without_card(
    image: Image, dictionary: str, fits: FitResults, start: LocalHomographies, noise: float
) -> FitResults:
    """Return fits of detected markers (N,), each by itself, with fits to ground of those without cards.

    A fit to a card may have left its marker on dark ground, so that these begin where the marker was found.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        fits: of the markers, each by itself, to cards.
        start: (N,) where the markers were found.
        noise: standard deviation of a pixel, grey levels.
    """
    distance = code_distance(dictionary)
    was_good = verified(fits, noise, distance)
    rows = np.flatnonzero(_are_darker_beside(fits) | ~was_good)
    if not rows.size:
        return fits
    old, ground = fits.take(rows), Surroundings.of_ground(np.zeros(rows.size))
    given = old.ids, start.take(rows), START_SIGMA_PX, OWN_PLANES, noise
    new, _ = fit_any_blur(image, dictionary, *given, alone=True, surroundings=ground)
    better = np.where(was_good[rows], _are_explained(old, new, noise), are_on_ground(new, noise))
    better &= verified(new, noise, distance)
    return fits.put(rows[better], new.take(better))


def are_on_ground(fits: FitResults, noise: float) -> BoolArray:
    """Return which fits to ground (N,) of likely markers have found darker ground.

    It must be darker by more if a fit leaves more than `noise`, a pixel's standard deviation, grey levels.
    """
    only_noise = fits.noise_stds <= NOISE_FACTOR * noise
    textures = np.where(only_noise, NOISE_LEVEL_TEXTURES, LEVEL_TEXTURES) * fits.surroundings.textures
    return np.asarray(_darkening(fits) > textures)


def _are_darker_beside(fits: FitResults) -> BoolArray:
    """Return which markers (N,) on cards leave darker pixels beside them than chance does."""
    beside = np.maximum(fits.pixels - fits.homographies.sides_px() ** 2, 1.0)
    shares = np.maximum(MIN_DARKENING_SHARE, DARKENING_SIGMAS / np.sqrt(beside))
    darker = -fits.besides > np.maximum(MIN_DARKENING * fits.contrasts, shares * fits.noise_stds)
    return np.asarray(darker & ~fits.surroundings.is_bare())


def _are_explained(old: FitResults, new: FitResults, noise: float) -> BoolArray:
    """Return which markers (N,) are explained better by darker ground around them than by a card."""
    ratios = new.noise_stds / old.noise_stds
    fall = -2 * new.pixels * np.log(ratios)
    to_noise = (new.noise_stds <= NOISE_FACTOR * noise) & (fall > SIGNIFICANT)
    darkening = _darkening(new)
    is_plain = darkening > LEVEL_TEXTURES * new.surroundings.textures
    is_seen = darkening < -MAX_LEVEL_RATIO * old.besides
    return np.asarray(is_plain & is_seen & (to_noise | (ratios <= MAX_RESIDUAL_RATIO)))


def _darkening(fits: FitResults) -> Array:
    """Return by how much (N,) the ground around markers is darker than white, grey levels."""
    return np.asarray(-fits.surroundings.levels * fits.contrasts)
