"""Markers that are covered in part, fitted to those of their pixels that are visible.

Ordinary least squares uses every pixel, so that a neighbour's card over a corner, a leaf or a cable pulls at
the pose. Here pixels whose residual exceeds a limit are left out, not averaged in, and the others are fitted
again. The limit falls from half the contrast, which no noise reaches, to `INLIER_SIGMAS` standard deviations
of the noise and what the model of the blur leaves along edges: pixels that no pose explains are left out
first, and by the time that pixels along the edges count, the pose is nearly right (graduated non-convexity:
Blake and Zisserman, Visual Reconstruction, 1987).

A bit of which not half is seen counts as wrong, so that no bit is ever guessed.
"""

from dataclasses import replace

import numpy as np

from skyherd.geometry import UNIFORM_VARIANCE, Array
from skyherd.markers.dictionary import border_cells, cells_per_side
from skyherd.vision.grey import Image
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.appearance import appearances_of
from skyherd.vision.photometric.fitting.common_unknowns import on_common_plane, with_common_tone
from skyherd.vision.photometric.fitting.design_matrix import BLACK, CONTRAST, MIDDLE_GREY, POSE
from skyherd.vision.photometric.fitting.fit import PixelSamples, image_middle, stepped
from skyherd.vision.photometric.fitting.fit_result import FitResults, fit_results_of
from skyherd.vision.photometric.fitting.plane import Plane

INLIER_SIGMAS = 4.0
"""Residual beyond which a pixel is left out in the last rounds, standard deviations of the noise. Derived:
one pixel in 16000 of a normal distribution exceeds it. At half of it one in 22 would be left out, which makes
the noise look smaller; at twice as much faint covers would count."""

PIXEL_SHARE = 0.057
"""Largest difference between an edge seen by square pixels and under the normal blur of equal variance by
which it is modelled, as a share of the contrast. Derived: `Φ(x / σ) - (x + 1/2)` is largest at
0.23 px. With a lens's blur it falls faster than with the fourth power of the two together."""

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

MIN_CLEAR_SHARE = 0.2
"""Share of a cell's pixels that must lie beyond the margins for its bit to be known. Chosen: five pixels of a
marker of 30 px, whose mean is known to a twentieth of the contrast at noise 10."""

MIN_VISIBLE_SHARE = 0.5
"""Share of a cell's pixels that must be visible, and explained, for its bit to be known. Chosen: most of the
cell; less would let a bit be guessed from its edge."""


def fit_visible(
    image: Image, dictionary: str, fits: FitResults, sigma_px: float | Array, plane: Plane, noise: float
) -> FitResults:
    """Return the same markers, fitted to those of their pixels that agree on a pose.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        fits: of N markers, at least one, to all their pixels.
        sigma_px: standard deviation of the blur of lens and pixel together: of all markers, or (N,) of each.
        plane: of all the image's markers, from which blur in marker coordinates follows. The anisotropies of
            the covered markers are found from themselves, since what covers them may have affected the plane.
        noise: standard deviation of a pixel, grey levels.

    Returns:
        The new results. A hidden cell of the black border leaves no residual; a hidden cell with a bit leaves
        as much as a wrong one, so that a marker with a hidden bit is never verified.
    """
    n_cells, middle = cells_per_side(dictionary), image_middle(image)
    blurs = fits.homographies.blurs(sigma_px)
    appearances = appearances_of(dictionary, fits.ids, blurs, plane, noise)
    appearances = replace(appearances, black_ratios=fits.blacks / fits.contrasts)
    perspectives = plane.perspectives(fits.homographies.centers - middle)
    rows, homographies = np.arange(fits.ids.size), replace(fits.homographies, perspectives=perspectives)
    values = np.zeros((rows.size, UNKNOWNS))
    values[:, BLACK], values[:, CONTRAST] = fits.blacks - MIDDLE_GREY, fits.contrasts
    samples = PixelSamples(rows.size)
    limits = fits.contrasts / 2
    edge_misfits = _edge_misfits(sigma_px) * fits.contrasts
    rounds = _rounds(fits.contrasts, noise)
    margin_px = MARGIN_SIGMAS * np.broadcast_to(sigma_px, (rows.size,))
    for number in range(rounds):
        margins = margin_px if number > rounds - FINAL_ROUNDS else None
        values[:, POSE] = 0.0  # the last round's step was taken
        samples.read(
            image, rows, homographies, appearances, inlier_limits=(values, limits), margin_px=margins
        )
        if margins is None:
            seen = samples.cell_support(rows, n_cells)
        everyone = np.ones(rows.size, dtype=bool)
        solution = with_common_tone(samples.solution(), everyone)
        solution, plane = on_common_plane(solution, homographies, middle, plane)
        values = solution.values.copy()
        homographies, moved_px = stepped(solution, homographies)
        homographies = replace(homographies, perspectives=plane.perspectives(homographies.centers - middle))
        last_limits = INLIER_SIGMAS * np.minimum(noise, solution.noise_stds()) + edge_misfits
        limits = np.maximum(LIMIT_FACTOR * limits, last_limits)
    means, peaks = samples.cell_residuals(rows, solution, n_cells)
    means = _hidden_bits_as_wrong(
        means,
        np.minimum(seen, samples.cell_support(rows, n_cells) * MIN_VISIBLE_SHARE / MIN_CLEAR_SHARE),
        solution.contrasts(),
        border_cells(dictionary),
    )
    variances = plane.variances(homographies.centers - middle) if plane.shared else np.zeros(rows.size)
    return fit_results_of(fits.ids, solution, homographies, (means, peaks), moved_px, blurs, variances)


def _edge_misfits(sigma_px: float | Array) -> Array:
    """Return what the model of the blur (N,) leaves along edges at most, as a share of the contrast.

    It matters in shrunk images, whose pixels have little noise and next to no blur of a lens: pixels along
    the edges, which tell the pose, would be left out as covered, more on one side than on the other.
    Measured on markers of 1500 px of which a disc covers 2 %: 0.01 to 0.05 px off without, 0.002 with it.
    """
    return np.asarray(PIXEL_SHARE * (UNIFORM_VARIANCE / np.square(sigma_px)) ** 2)


def _rounds(contrasts: Array, noise: float) -> int:
    """Return rounds until the limit has fallen to its last value, and `FINAL_ROUNDS` more."""
    falls = np.log(INLIER_SIGMAS * noise / (contrasts.max() / 2)) / np.log(LIMIT_FACTOR)
    return int(np.ceil(max(falls, 0.0))) + FINAL_ROUNDS


def _hidden_bits_as_wrong(cell_means: Array, support: Array, contrasts: Array, border: int) -> Array:
    """Return mean residuals (N, n, n), in which a cell with too little support leaves the whole contrast.

    That holds for cells with a bit; hidden cells of the border leave zero.
    """
    has_bit = np.zeros(support.shape[1:])
    has_bit[border:-border, border:-border] = 1.0
    return np.where(support < MIN_VISIBLE_SHARE, has_bit * contrasts[:, None, None], cell_means)
