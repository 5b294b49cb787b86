"""The fit of markers in NumPy, step by step: the reference for the compiled one."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from skyherd.geometry import SQUARE_CORNERS
from skyherd.markers.dictionary import cells_per_side
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.appearance import appearances_of
from skyherd.vision.photometric.fitting.blur_ellipses import second_derivative_maps
from skyherd.vision.photometric.fitting.common_unknowns import (
    KEYSTONE_STD,
    MIN_PIXELS_FOR_PLANE,
    MIN_PRINT_SHARE,
    NEAR_PLANE,
    NO_PERSPECTIVE,
    OWN_PLANES,
    found_anisotropies,
    keystones,
    steps_to,
    with_common_tone,
    with_even_light,
    with_keystones,
)
from skyherd.vision.photometric.fitting.design_matrix import (
    ANISOTROPY,
    BLACK,
    KEYSTONE,
    MIDDLE_GREY,
    DesignMatrices,
)
from skyherd.vision.photometric.fitting.fit import (
    MAX_STEPS,
    OFF_CELL,
    SETTLED_PERSPECTIVE_PX,
    SETTLED_PX,
    USUAL_NOISE,
    PixelSamples,
    image_middle,
    stepped,
)
from skyherd.vision.photometric.fitting.fit_result import fit_results_of, print_contrasts, weighted_median
from skyherd.vision.photometric.fitting.least_squares import LeastSquaresSolution
from skyherd.vision.photometric.fitting.plane import (
    MIN_MARKERS_ON_PLANE,
    MIN_SHARE_ON_PLANE,
    Plane,
    fit_plane,
)
from skyherd.vision.photometric.fitting.streak_evidence import StreakEvidence


def fit_markers(
    image,
    dictionary,
    ids,
    homographies,
    sigma_px,
    plane,
    noise=USUAL_NOISE,
    max_steps=MAX_STEPS,
    *,
    alone=False,
    streak_px2=None,
):
    """Return what the function of this name in `skyherd.vision.photometric.fitting.fit` does."""
    middle = image_middle(image)
    sides_px = homographies.sides_px()
    blurs = homographies.blurs(sigma_px)
    appearances = appearances_of(dictionary, ids, blurs, plane, noise, streak_px2)
    samples, n_cells = PixelSamples(ids.size), cells_per_side(dictionary)
    if plane.shared and plane != Plane():
        homographies = replace(homographies, perspectives=plane.perspectives(homographies.centers - middle))
    start = homographies
    rows, right = np.arange(ids.size), np.ones(ids.size, dtype=bool)
    for number in range(1, max_steps + 1):
        start = homographies if rows.size == ids.size else start.put(rows, homographies.take(rows))
        samples.read(image, rows, start, appearances)
        solution = samples.solution()
        if number > 1:  # before, a start that is a pixel off may leave as much as a wrong cell
            means, _ = samples.cell_residuals(rows, solution, n_cells)
            right[rows] = _cells_are_right(means, solution.contrasts()[rows])
        solution, plane = hold_common_unknowns(
            solution, start, middle, right, plane, alone=alone, settling=number > 1
        )
        appearances = replace(
            appearances,
            black_ratios=(solution.values[:, BLACK] + MIDDLE_GREY) / solution.contrasts(),
            round_in_image=plane != Plane() or streak_px2 is not None,
        )
        homographies, moved_px = stepped(solution, start)
        if plane.shared:
            homographies = replace(
                homographies, perspectives=plane.perspectives(homographies.centers - middle)
            )
        bent_px = np.abs(homographies.perspectives - start.perspectives) * sides_px**2 / 2
        unsettled = (moved_px > SETTLED_PX * np.cbrt(noise)) | (bent_px > SETTLED_PERSPECTIVE_PX)
        rows = np.flatnonzero(unsettled & (right | (number < max_steps / 2)))
        if not rows.size:
            break
    residuals = samples.cell_residuals(np.arange(ids.size), solution, n_cells)
    variances = plane.variances(homographies.centers - middle) if plane.shared else np.zeros(ids.size)
    correlation = samples.variance_ratios(right, solution, homographies)
    results = fit_results_of(
        ids, solution, homographies, residuals, moved_px, blurs, variances, correlation=correlation
    )
    return results, plane


def fit_freely(image, homographies, appearances, max_steps, settled_px):
    """Fit markers with all eight numbers of each homography free, as `free_fit.c` does.

    Returns the homographies, the solution, the largest residuals (N,), and ratios (N, 2) of variances and
    their numbers of boxes (N,).
    """
    rows, everyone = np.arange(len(homographies)), np.ones(len(homographies), dtype=bool)
    samples, n_cells = PixelSamples(rows.size), appearances.cells.shape[1] - 2
    for _ in range(max_steps):
        start = homographies
        samples.read(image, rows, start, appearances)
        solution = with_common_tone(with_even_light(samples.solution(), everyone), everyone)
        homographies, _ = stepped(solution, start)
        moved = np.abs(homographies.images(SQUARE_CORNERS) - start.images(SQUARE_CORNERS))
        if moved.max() < settled_px:
            break
    ratios, boxes = samples.variance_ratios(everyone, solution, homographies)
    _, peaks = samples.cell_residuals(rows, solution, n_cells)
    return homographies, solution, peaks, ratios, boxes


def _cells_are_right(cell_means, contrasts):
    """Return which of N fits leave every cell the colour it should have."""
    return np.asarray(np.abs(cell_means).max(axis=(1, 2)) < OFF_CELL * contrasts)


def hold_common_unknowns(solution, start, middle, right, plane, *, alone, settling):
    """Return the solution with the unknowns held that the markers share, and the plane of the markers."""
    inliers = print_inliers(solution, right)
    solution = with_common_tone(with_even_light(solution, inliers), inliers)
    if alone:
        return on_own_planes(solution, start, NO_PERSPECTIVE, KEYSTONE_STD), OWN_PLANES
    return hold_on_plane(solution, start, middle, inliers, plane, settling=settling)


def hold_on_plane(solution, start, middle, inliers, plane, *, settling):
    """Return the solution on the plane of the inliers, and this; near it where it is not that of all."""
    points = start.centers - middle
    before = plane.perspectives(points) if plane.shared else NO_PERSPECTIVE
    held = with_keystones(solution, start, before)
    seen = found_anisotropies(held, start)
    plane = common_plane(held, points, seen, inliers, most=settling)
    if not plane.shared:
        near = near_plane(plane, points, seen, inliers)
        perspectives = np.where(near, plane.perspectives(points), NO_PERSPECTIVE)
        return on_own_planes(solution, start, perspectives, np.where(near, 0.0, KEYSTONE_STD)), plane
    solution = with_keystones(solution, start, plane.perspectives(points))
    return solution.constrained(ANISOTROPY, steps_to(plane.anisotropies(points), solution, start)), plane


def print_inliers(solution, right):
    """Return which of N fits decide on what all markers of an image share; all of them, if none is right."""
    if not right.any():
        return np.ones_like(right)
    contrasts = solution.contrasts()
    prints = print_contrasts(solution.values[:, BLACK] + MIDDLE_GREY, contrasts)
    weights = right * solution.pixels * (contrasts / solution.noise_stds()) ** 2
    return right & (prints > MIN_PRINT_SHARE * weighted_median(prints, weights))


def on_own_planes(solution, start, perspectives, keystone_stds):
    """Return the solution with free anisotropies, and keystones expected about those of perspectives."""
    noise_stds = with_keystones(solution, start, perspectives).noise_stds()
    variances = (keystone_stds * solution.contrasts() / noise_stds) ** 2
    return solution.expected(KEYSTONE, keystones(solution, start, perspectives), variances)


def common_plane(solution, points, anisotropies, inliers, *, most):
    """Return the plane of the inliers' anisotropies (N,) at image points (N,)."""
    spread = solution.inverse_normals[:, ANISOTROPY, ANISOTROPY].mean(axis=1)
    counted = (spread > 0) & (solution.pixels > MIN_PIXELS_FOR_PLANE) & inliers
    variances = np.where(counted, spread, np.inf) * (solution.noise_stds() / solution.contrasts()) ** 2
    return fit_plane(points, anisotropies, variances, most=most)


def near_plane(plane, points, anisotropies, inliers):
    """Return which markers (N,) lie near a plane; none unless most inliers do."""
    near = np.abs(anisotropies - plane.anisotropies(points)) < NEAR_PLANE
    enough = max(MIN_MARKERS_ON_PLANE, MIN_SHARE_ON_PLANE * np.count_nonzero(inliers))
    return near & (np.count_nonzero(near & inliers) >= enough)


def streak_evidence(image, dictionary, fits, plane, noise, streak_px2):
    """Return what the function of this name in `skyherd.vision.photometric.fitting.streak_evidence` does."""
    shapes, count = fits.homographies, fits.ids.size
    appearances = appearances_of(dictionary, fits.ids, shapes.blurs(fits.sigmas_px), plane, noise, streak_px2)
    appearances = replace(appearances, black_ratios=fits.blacks / np.maximum(fits.contrasts, 1.0))
    drawn = DesignMatrices(image, np.arange(count), shapes, appearances)
    solution = LeastSquaresSolution.of_grams(drawn.gram_matrices().astype(float), drawn.counts)
    maps = second_derivative_maps(shapes) * solution.contrasts()[:, None, None]
    products, squares = np.empty((count, UNKNOWNS + 1, 2)), np.empty((count, 2, 2))
    for number, (begin, end) in enumerate(pairwise(drawn.bounds.tolist())):
        bends, columns = drawn.bends[begin:end] @ maps[number], drawn.columns[begin:end].astype(float)
        products[number], squares[number] = columns.T @ bends, bends.T @ bends
    by_columns, by_pixels = products[:, :UNKNOWNS], products[:, UNKNOWNS]
    across = by_columns.transpose(0, 2, 1)
    variances = solution.noise_stds() ** 2
    informations = squares - across @ solution.inverse_normals @ by_columns
    scores = by_pixels - (across @ solution.values[..., None])[..., 0]
    return StreakEvidence(informations / variances[:, None, None], scores / variances[:, None])
