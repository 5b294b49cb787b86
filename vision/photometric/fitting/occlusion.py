"""Markers that are covered in part, fitted to those of their pixels that are visible.

Ordinary least squares uses every pixel, so that a neighbour's card over a corner, a leaf or a cable pulls at
the pose. Here pixels whose residual exceeds a limit are left out, not averaged in, and the others are fitted
again. The limit falls from half the contrast, which no noise reaches, to `INLIER_SIGMAS` standard deviations
of the noise and what the model of the blur leaves along edges: pixels that no pose explains are left out
first, and by the time that pixels along the edges count, the pose is nearly right (graduated non-convexity:
Blake and Zisserman, Visual Reconstruction, 1987).

The plane on which covered markers lie is that of others, since what covers them affects their anisotropies.
Without others it is found from them once each has settled by itself (`settled`).

A bit of which not half is seen counts as wrong, so that no bit is ever guessed.
"""

from dataclasses import replace

import numpy as np

from skyherd.geometry import Array
from skyherd.markers.dictionary import border_cells
from skyherd.vision.grey import Image
from skyherd.vision.native.library import library
from skyherd.vision.native.records import VisibleConstants, VisibleRequest
from skyherd.vision.photometric.fitting.appearance import appearances_of
from skyherd.vision.photometric.fitting.fit import fit_request
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.plane import Plane

INLIER_SIGMAS = 4.0
"""Residual beyond which a pixel is left out in the last rounds, standard deviations of the noise. Derived:
one pixel in 16000 of a normal distribution exceeds it. At half of it one in 22 would be left out, which makes
the noise look smaller; at twice as much faint covers would count."""

PIXEL_SHARE = 0.057
"""Largest difference between an edge seen by square pixels and under the normal blur of equal variance by
which it is modelled, as a share of the contrast. Derived: `Φ(x / σ) - (x + 1/2)` is largest at
0.23 px. With a lens's blur it falls faster than with the fourth power of the two together. It matters in
shrunk images, whose pixels have little noise and next to no blur of a lens: pixels along the edges, which
tell the pose, would be left out as covered, more on one side than on the other. Measured on markers of 1500
px of which a disc covers 2 %: 0.01 to 0.05 px off without, 0.002 with it."""

LIMIT_FACTOR = 0.5
"""Factor by which the limit falls in each round. Chosen: nearer to 1 takes more rounds, nearer to 0 leaves
out edges before the pose is right."""

FINAL_ROUNDS = 3
"""Rounds after the limit has reached its last value. Chosen: one in which the pixels are chosen, and two in
which those in a margin about the others are left out as well."""

MARGIN_SIGMAS = 2.0
"""In the last rounds pixels are left out too that are so near to one beyond the limit, standard deviations of
the blur: a cover's blurred edge goes on below the limit, and pulls. Measured on markers of 30 px of which a
disc covers 5 %: headings have a NEES of 1.9 without a margin, and of 1.2 with this one."""

COVER_SHARE, MIN_COVER_PX = 0.25, 16
"""Residual, as a share of the contrast, and number of pixels with it, from which on something covers a
marker. Measured: a disc over 2 % of a marker of 30 px leaves more. A drawing that was shrunk without a filter
leaves 6 to 12 such pixels along the edges of a marker of 70 px, and more than 4 standard deviations of the
noise at a hundred; with a margin about those its centre was a tenth to a third less accurate, since what lies
beside an edge tells most of the pose."""

MIN_CLEAR_SHARE = 0.2
"""Share of a cell's pixels that must lie beyond the margins for its bit to be known. Chosen: five pixels of a
marker of 30 px, whose mean is known to a twentieth of the contrast at noise 10."""

MIN_VISIBLE_SHARE = 0.5
"""Share of a cell's pixels that must be visible, and explained, for its bit to be known. Chosen: most of the
cell; less would let a bit be guessed from its edge."""


def fit_visible(
    image: Image,
    dictionary: str,
    fits: FitResults,
    sigma_px: float | Array,
    plane: Plane,
    noise: float,
    *,
    settled: bool = False,
) -> tuple[FitResults, Plane]:
    """Return the same markers, fitted to those of their pixels that agree on a pose, and their plane.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        fits: of N markers, at least one, to all their pixels.
        sigma_px: standard deviation of the blur of lens and pixel together: of all markers, or (N,) of each.
        plane: of the image's markers, on which all of these lie. If it is not shared, each marker has an
            anisotropy of its own, and a keystone that is expected near zero (`KEYSTONE_STD`).
        noise: standard deviation of a pixel, grey levels.
        settled: whether `fits` are those to the visible pixels, each on its own. Their plane is then found:
            pixels that are covered would affect it.

    Returns:
        The new results. A hidden cell of the black border leaves no residual; a hidden cell with a bit leaves
        as much as a wrong one, so that a marker with a hidden bit is never verified. And the plane: that
        which was given, or which was found.
    """
    sigmas_px = np.array(np.broadcast_to(sigma_px, (fits.ids.size,)), dtype=float)
    blurs = fits.homographies.blurs(sigmas_px)
    appearances = appearances_of(dictionary, fits.ids, blurs, plane, noise, surroundings=fits.surroundings)
    appearances = replace(appearances, black_ratios=fits.blacks / fits.contrasts)
    request = VisibleRequest(
        markers=fit_request(image, fits.homographies, appearances, noise),
        constants=visible_constants(),
        blacks=np.ascontiguousarray(fits.blacks),
        contrasts=np.ascontiguousarray(fits.contrasts),
        sigmas_px=sigmas_px,
        border=border_cells(dictionary),
        settled=settled,
    )
    record = plane.record()
    fitted = FitResults.of_records(fits.ids, *library().fit_visible(request, record), blurs)
    return fitted, Plane.of_record(record)


def visible_constants() -> VisibleConstants:
    """Return the constants of the fit to visible pixels for the compiled library."""
    return VisibleConstants(
        inlier_sigmas=INLIER_SIGMAS,
        pixel_share=PIXEL_SHARE,
        limit_factor=LIMIT_FACTOR,
        margin_sigmas=MARGIN_SIGMAS,
        cover_share=COVER_SHARE,
        min_visible_share=MIN_VISIBLE_SHARE,
        min_clear_share=MIN_CLEAR_SHARE,
        final_rounds=FINAL_ROUNDS,
        min_cover_px=MIN_COVER_PX,
    )
