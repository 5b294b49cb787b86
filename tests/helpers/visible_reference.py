"""The fit of markers to their visible pixels in NumPy: the reference for the compiled one."""

from dataclasses import replace

import cv2
import numpy as np
from tests.helpers.design_matrix_reference import MIDDLE_GREY, DesignMatrices
from tests.helpers.fit_reference import (
    NO_PERSPECTIVE,
    fit_results_of,
    hold_on_plane,
    on_own_planes,
    stepped,
    steps_to,
    with_common_tone,
    with_keystones,
)
from tests.helpers.fit_stages import stages
from tests.helpers.least_squares_reference import LeastSquaresSolution
from tests.helpers.plane_reference import on_plane, perspectives_at, variances_at

from skyherd.geometry import UNIFORM_VARIANCE
from skyherd.markers.dictionary import border_cells, cells_per_side
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting import occlusion
from skyherd.vision.photometric.fitting.appearance import appearances_of
from skyherd.vision.photometric.fitting.common_unknowns import KEYSTONE_STD
from skyherd.vision.photometric.fitting.design_matrix import ANISOTROPY, BLACK, CONTRAST, POSE
from skyherd.vision.photometric.fitting.fit import image_middle


def fit_visible(image, dictionary, fits, sigma_px, plane, noise, *, settled=False):
    """Return what the function of this name in `skyherd.vision.photometric.fitting.occlusion` does."""
    n_cells, middle = cells_per_side(dictionary), image_middle(image)
    blurs = fits.homographies.blurs(sigma_px)
    appearances = appearances_of(dictionary, fits.ids, blurs, plane, noise)
    appearances = replace(appearances, black_ratios=fits.blacks / fits.contrasts)
    rows, homographies = np.arange(fits.ids.size), on_plane(fits.homographies, plane, middle)
    values = np.zeros((rows.size, UNKNOWNS))
    values[:, BLACK], values[:, CONTRAST] = fits.blacks - MIDDLE_GREY, fits.contrasts
    everyone = np.ones(rows.size, dtype=bool)
    margins_px = occlusion.MARGIN_SIGMAS * np.broadcast_to(sigma_px, rows.shape)
    edges = occlusion.PIXEL_SHARE * (UNIFORM_VARIANCE / np.square(sigma_px)) ** 2 * fits.contrasts
    rounds = occlusion.FINAL_ROUNDS if settled else _rounds(fits.contrasts, noise)
    limits = occlusion.INLIER_SIGMAS * noise + edges if settled else fits.contrasts / 2
    for number in range(rounds):
        values[:, POSE] = 0.0  # the last round's step was taken
        pixels = DesignMatrices(image, rows, homographies, appearances)
        with_margins = number > rounds - occlusion.FINAL_ROUNDS
        used = _used(pixels, values, limits, margins_px if with_margins else 0 * margins_px)
        pixels.leave_out(~used)
        before = np.concatenate([[0], np.cumsum(pixels.columns[:, BLACK] > 0)])
        counts = np.diff(before[pixels.bounds])
        solution = LeastSquaresSolution.of_grams(pixels.gram_matrices().astype(float), counts)
        solution = with_common_tone(solution, everyone)
        if settled:
            solution, plane = hold_on_plane(solution, homographies, middle, everyone, plane, settling=True)
        else:
            solution = _held(solution, homographies, middle, plane)
        values = solution.values.copy()
        homographies, moved_px = stepped(solution, homographies)
        homographies = on_plane(homographies, plane, middle)
        last_limits = occlusion.INLIER_SIGMAS * np.minimum(noise, solution.noise_stds()) + edges
        limits = np.maximum(occlusion.LIMIT_FACTOR * limits, last_limits)
        shares = _visible_shares(pixels, n_cells)
        if not with_margins:
            seen = shares
    means, peaks, besides = pixels.cell_residuals(solution.values, n_cells)
    support = np.minimum(seen, shares * occlusion.MIN_VISIBLE_SHARE / occlusion.MIN_CLEAR_SHARE)
    border, has_bit = border_cells(dictionary), np.zeros((n_cells, n_cells))
    has_bit[border:-border, border:-border] = 1.0
    hidden = has_bit * solution.contrasts()[:, None, None]
    means = np.where(support < occlusion.MIN_VISIBLE_SHARE, hidden, means)
    variances = variances_at(plane, homographies.centers - middle) if plane.shared else np.zeros(rows.size)
    fitted = fit_results_of(
        fits.ids, solution, homographies, (means, peaks, besides), moved_px, blurs, variances
    )
    return fitted, plane


def _rounds(contrasts, noise):
    """Return rounds until the limit has fallen to its last value, and the final ones."""
    falls = np.log(occlusion.INLIER_SIGMAS * noise / (contrasts.max() / 2)) / np.log(occlusion.LIMIT_FACTOR)
    return int(np.ceil(max(falls, 0.0))) + occlusion.FINAL_ROUNDS


def _used(pixels, values, limits, margins_px):
    """Return which pixels (P,) are within the limits, and further than a margin from those beyond."""
    residuals = np.abs(pixels.residuals(values))
    used = residuals < np.repeat(limits, pixels.counts)
    covers = residuals > np.repeat(occlusion.COVER_SHARE * values[:, CONTRAST], pixels.counts)
    for row, (begin, end) in enumerate(zip(pixels.bounds[:-1], pixels.bounds[1:], strict=True)):
        out = ~used[begin:end]
        if margins_px[row] > 0 and covers[begin:end].sum() >= occlusion.MIN_COVER_PX and out.any():
            v, u = (pixels.pixels[begin:end] - pixels.pixels[begin:end].min(axis=0)).T
            is_away = np.ones((v.max() + 1, u.max() + 1), dtype=np.uint8)
            is_away[v[out], u[out]] = 0
            distances_px = cv2.distanceTransform(is_away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            used[begin:end] = distances_px[v, u] > margins_px[row]
    return used


def _visible_shares(pixels, n_cells):
    """Return the share (N, n, n) of each cell's pixels that is used; 0 for a cell off the image."""
    nothing = np.zeros((pixels.rows.size, UNKNOWNS), dtype=np.float32)
    _, used, read, _, _ = stages().cell_sums(pixels._data, nothing, n_cells)
    return used / np.maximum(read, 1)


def _held(solution, start, middle, plane):
    """Return the solution at the plane; with free anisotropies and keystones near zero if none is shared."""
    if not plane.shared:
        return on_own_planes(solution, start, NO_PERSPECTIVE, KEYSTONE_STD)
    points = start.centers - middle
    solution = with_keystones(solution, start, perspectives_at(plane, points))
    return solution.constrained(ANISOTROPY, steps_to(plane.anisotropies(points), solution, start))
