"""Looks at an image: which quadrilaterals it has, which of them resemble markers, and which are markers."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, IntArray, to_points
from skyherd.markers.dictionary import cells_per_side, code_distance
from skyherd.vision.grey import Image
from skyherd.vision.photometric.acceptance import accepted
from skyherd.vision.photometric.fitting.fit import USUAL_NOISE, image_middle
from skyherd.vision.photometric.fitting.fit_result import FitResults, no_fit_results, weighted_median
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.image_estimates import ImageEstimates
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.places import best_of_each_place, elsewhere, on_plane
from skyherd.vision.photometric.streaks import with_streak
from skyherd.vision.photometric.unknown_blur import (
    START_SIGMA_PX,
    fit_any_blur,
    is_promising,
    with_usual_blur,
)
from skyherd.vision.photometric.verify import bits_are_right, verified
from skyherd.vision.search.decode import MIN_CORRELATION, DecodedQuads, decode_quads, no_decoded_quads
from skyherd.vision.search.quads import find_quads
from skyherd.vision.search.second_look import find_overlooked_quads

CLEAR_CORRELATION = 0.8
"""Smallest correlation of a quadrilateral's cells with a marker's at the second look. Measured: markers that
only the second look finds have 0.83 to 0.99; at 0.6 photographs of clutter take twice the time, for fits of
squares of a few pixels."""

PALE_SHARE = 0.3
"""While markers are known in an image, candidates whose cells show less than this share of the unit's usual
print contrast are not fitted. Measured: markers of 8 to 30 px at noise up to 10 show 0.79 or more, those that
are blurred three times as much as the others 0.36, and 95 % of the dark patches of ground that resemble
markers 0.29 or less, which took a quarter of the detector's time in missions."""

COARSE_CELL_PX = 8.0
"""Side of a cell from which on markers are fitted in a shrunk image at first, until their blur and bits are
known. Chosen: cells then have 4 to 8 px; a larger value costs time with its square, at half of it bits of
sharpened images are lost."""


@dataclass(frozen=True)
class Look:
    """What one look at an image saw.

    Attributes:
        quads_px: (Q, 4, 2) corners of all quadrilaterals that were found, px.
        candidates: the N of them that resemble a marker, the best of each place.
        fits: of the N candidates, in their order.
        good: (N,) which fits are verified, and the best of each place.
    """

    quads_px: Array
    candidates: DecodedQuads
    fits: FitResults
    good: BoolArray

    @property
    def found(self) -> FitResults:
        """The fits that are good."""
        return self.fits.take(self.good)

    @classmethod
    def of_nothing(cls, dictionary: str) -> "Look":
        """Return a look that saw no quadrilateral; `dictionary` is that of the markers."""
        nothing = np.zeros(0, dtype=bool)
        return cls(np.zeros((0, 4, 2)), no_decoded_quads(), no_fit_results(dictionary), nothing)

    def joined(self, other: "Look") -> "Look":
        """Return a look that saw what this one did, followed by what the other did."""
        return Look(
            np.concatenate([self.quads_px, other.quads_px]),
            self.candidates.joined(other.candidates),
            self.fits.joined(other.fits),
            np.concatenate([self.good, other.good]),
        )


def look_twice(
    image: Image, dictionary: str, known: ImageEstimates, followed: LocalHomographies
) -> tuple[Look, Look]:
    """Return the look at a whole image, and the second one at where the first finds nothing.

    Markers of the second look must be printed like those of the first, and do not change the plane that
    these lie on.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        known: what is known of the unit's images; its plane becomes that of what is found.
        followed: markers that are known already, and are not looked at.
    """
    first = look_at_quads(image, dictionary, known, find_quads(image), followed, MIN_CORRELATION)
    found, plane = first.found, known.plane
    there = followed.joined(found.homographies)
    quads = find_overlooked_quads(image, to_points(there.images(SQUARE_CORNERS)), dictionary)
    second = look_at_quads(image, dictionary, known, quads, there, CLEAR_CORRELATION)
    if not (first.good.any() and second.good.any()):
        return first, second
    known.plane = plane
    alike = verified(found.joined(second.found), image_noise(image), code_distance(dictionary))
    good = second.good.copy()
    good[good] = alike[found.ids.size :]
    return first, replace(second, good=good)


def look_at_quads(
    image: Image,
    dictionary: str,
    known: ImageEstimates,
    quads: Array,
    there: LocalHomographies,
    min_correlation: float,
) -> Look:
    """Return what is seen where quadrilaterals are, but for where markers are known to be.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        known: what is known of the unit's images; its plane becomes that of what is found.
        quads: (N, 4, 2) corners, px, clockwise as seen, beginning with any of the four.
        there: the markers that are known.
        min_correlation: of a quadrilateral's cells with those of the marker that it resembles most.
    """
    quads = quads[elsewhere(quads, there)]
    decoded = decode_quads(image, quads, dictionary, known.sigma_px or START_SIGMA_PX)
    if len(there) and known.print_contrast is not None:
        decoded = decoded.take(decoded.print_contrasts >= PALE_SHARE * known.print_contrast)
    start = LocalHomographies.of_corners(decoded.corners_px)
    best = best_of_each_place(decoded.ids, start.centers, start.sides_px(), decoded.correlations)
    best &= decoded.correlations >= min_correlation
    return look_at_candidates(image, dictionary, known, quads, decoded.take(best))


def look_at_candidates(
    image: Image, dictionary: str, known: ImageEstimates, quads: Array, candidates: DecodedQuads
) -> Look:
    """Return candidates fitted and verified, with all quadrilaterals (Q, 4, 2) that they were chosen from.

    The plane that they lie on is known then.
    """
    if not candidates.ids.size:
        return replace(Look.of_nothing(dictionary), quads_px=quads)
    start = LocalHomographies.of_corners(candidates.corners_px)
    start = on_plane(start, known.plane, image_middle(image))
    fits, known.plane = _fit_quads(image, dictionary, known, candidates.ids, start)
    fits, good = accepted(image, dictionary, fits, known.plane, start)
    fits, good, known.plane = with_streak(image, dictionary, fits, good, known.plane)
    found = fits.take(good)
    shapes = found.homographies
    good = good.copy()
    good[good] = best_of_each_place(found.ids, shapes.centers, shapes.sides_px(), -found.noise_stds)
    return Look(quads, candidates, fits, good)


def _fit_quads(
    image: Image, dictionary: str, known: ImageEstimates, ids: IntArray, start: LocalHomographies
) -> tuple[FitResults, Plane]:
    """Fits of what quadrilaterals may show, coarse ones at first, and the plane that they lie on.

    Where no plane explains the markers that are known, a few others are not asked for one.
    """
    sigma_px, noise = known.sigma_px or START_SIGMA_PX, known.noise or USUAL_NOISE
    fit = partial(fit_any_blur, image, dictionary, alone=not known.plane.shared)
    coarse_px = COARSE_CELL_PX * cells_per_side(dictionary)
    fits, plane = fit(ids, start, sigma_px, known.plane, noise, max_side_px=coarse_px)
    promising = np.flatnonzero(is_promising(fits))
    if not promising.size:
        return fits, known.plane
    coarse = fits.take(promising)
    right = bits_are_right(coarse, code_distance(dictionary))
    if right.any():
        noise = weighted_median(coarse.noise_stds, coarse.pixels * right)
    fine, plane = fit(coarse.ids, coarse.homographies, with_usual_blur(coarse), plane, noise)
    return fits.put(promising, fine), plane if right.any() else known.plane
