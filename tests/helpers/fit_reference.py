"""The fit of markers in NumPy, step by step: the reference for the compiled one."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from tests.helpers.design_matrix_reference import (
    MIDDLE_GREY,
    DesignMatrices,
    second_derivative_maps,
    taken,
)
from tests.helpers.homography_reference import keystones_to, moved
from tests.helpers.least_squares_reference import LeastSquaresSolution
from tests.helpers.plane_reference import (
    fit_plane,
    fit_plane_to_all,
    on_plane,
    perspectives_at,
    variances_at,
)

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, ComplexArray, IntArray
from skyherd.markers.dictionary import cells_per_side
from skyherd.messages import Quality
from skyherd.vision.grey import Image
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting import design_matrix
from skyherd.vision.photometric.fitting.appearance import MarkerAppearances, appearances_of
from skyherd.vision.photometric.fitting.common_unknowns import (
    FREE_SIGMAS,
    KEYSTONE_STD,
    MAX_TONE,
    MIN_MARKERS_FOR_TONE,
    MIN_PIXELS_FOR_PLANE,
    MIN_PRINT_SHARE,
    NEAR_PLANE,
    OWN_PLANES,
)
from skyherd.vision.photometric.fitting.correlated_noise import BOX_PX, KEPT_SHARE, MAX_MARKERS
from skyherd.vision.photometric.fitting.design_matrix import (
    ANISOTROPY,
    BLACK,
    BLUR,
    CONTRAST,
    GROUND,
    KEYSTONE,
    LIGHT,
    TONE,
)
from skyherd.vision.photometric.fitting.fit import (
    MAX_STEP,
    MAX_STEPS,
    MIN_STEP,
    OFF_CELL,
    SETTLED_PERSPECTIVE_PX,
    SETTLED_PX,
    USUAL_NOISE,
    image_middle,
)
from skyherd.vision.photometric.fitting.fit_result import (
    MAX_LOG_BLUR,
    FitResults,
    print_contrasts,
    weighted_median,
)
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import MIN_MARKERS_ON_PLANE, MIN_SHARE_ON_PLANE, Plane
from skyherd.vision.photometric.fitting.streak_evidence import StreakEvidence
from skyherd.vision.photometric.fitting.surroundings import Surroundings

NO_PERSPECTIVE = 0j
"""The perspective of a marker without keystone, 1/px."""


class PixelSamples:
    """The pixels last read of each of N markers, as design matrices and their Gram matrices.

    A fit reads again only the markers that still move. The Gram matrices of the others stay, so that one
    solution covers all N markers in every step.
    """

    def __init__(self, count: int) -> None:
        self._grams, self._counts = np.empty((count, UNKNOWNS + 1, UNKNOWNS + 1)), np.empty(count)
        self._parts: list[DesignMatrices] = []
        self._part_of = np.empty(count, dtype=np.int64)

    def read(
        self,
        image: Image,
        rows: IntArray,
        start: LocalHomographies,
        appearances: MarkerAppearances,
    ) -> None:
        """Read the pixels of the markers `rows` (R,) again.

        Args:
            image: grey, (height, width).
            rows: indices of the markers to be read.
            start: homographies of all N markers, about which the model is linear.
            appearances: of all N markers.
        """
        pixels = DesignMatrices(image, rows, start.take(rows), taken(appearances, rows))
        self._grams[rows], self._counts[rows] = pixels.gram_matrices(), pixels.counts
        self._part_of[rows] = len(self._parts)
        self._parts.append(pixels)

    def solution(self) -> LeastSquaresSolution:
        """Return the least-squares solution for all N markers, with every unknown free."""
        return LeastSquaresSolution.of_grams(self._grams, self._counts)

    def cell_residuals(
        self, rows: IntArray, solution: LeastSquaresSolution, n_cells: int
    ) -> tuple[Array, Array, Array]:
        """Return what a solution of all N markers leaves of the pixels of the markers `rows` (R,).

        Returns:
            The mean residual over each cell (R, n, n), the largest absolute residual of a pixel (R,), and the
            mean residual of the pixels beside the marker (R,), in grey levels.
        """
        means = np.empty((self._counts.size, n_cells, n_cells))
        peaks, besides = np.empty((2, self._counts.size))
        for pixels in self._latest_parts(rows):
            here = pixels.rows
            means[here], peaks[here], besides[here] = pixels.cell_residuals(solution.values[here], n_cells)
        return means[rows], peaks[rows], besides[rows]

    def learned(
        self, surroundings: Surroundings, solution: LeastSquaresSolution, noise: float
    ) -> Surroundings:
        """Return the surroundings of all N markers after a solution; those of bare ones change."""
        levels, textures = surroundings.levels.copy(), surroundings.textures.copy()
        for pixels in self._latest_parts(np.flatnonzero(surroundings.is_bare())):
            bare = surroundings.is_bare()[pixels.rows]
            here, values = pixels.rows[bare], solution.values[pixels.rows]
            levels[here] = (values[:, GROUND] / solution.contrasts()[pixels.rows]).clip(-1, 1)[bare]
            textures[here] = pixels.ground_textures(values, noise)[bare]
        return Surroundings(levels, textures)

    def variance_ratios(
        self, right: BoolArray, solution: LeastSquaresSolution, homographies: LocalHomographies
    ) -> tuple[Array, Array]:
        """Return how correlated noise changes the variances of some of the markers that are `right` (N,).

        Returns:
            The ratios (N, 2) of positions and of headings, and the numbers (N,) of boxes that they are of, 0
            for markers that were not looked at (`correlated_noise`).
        """
        rows = np.flatnonzero(right)[:: max(1, -(-np.count_nonzero(right) // MAX_MARKERS))]
        ratios, numbers = np.ones((right.size, 2)), np.zeros(right.size)
        if not rows.size:
            return ratios, numbers
        influences, maps = pose_influences(solution, homographies)
        variances = (influences * maps).sum(axis=2) * (solution.noise_stds() ** 2)[:, None]
        for pixels in self._latest_parts(rows):
            picked = np.flatnonzero(np.isin(pixels.rows, rows))
            here = pixels.rows[picked]
            small, large, boxes = pixels.squared_box_sums(
                solution.values[pixels.rows], influences[pixels.rows], picked, BOX_PX
            )
            ratios[here], numbers[here] = box_ratios(small, large, variances[here]), boxes
        return ratios, numbers

    def _latest_parts(self, rows: IntArray) -> list[DesignMatrices]:
        """Return the parts that hold the latest pixels of the markers `rows`, in the order of reading."""
        return [self._parts[part] for part in np.unique(self._part_of[rows])]


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
    surroundings=None,
):
    """Return what the function of this name in `skyherd.vision.photometric.fitting.fit` does."""
    middle = image_middle(image)
    sides_px = homographies.sides_px()
    blurs = homographies.blurs(sigma_px)
    appearances = appearances_of(dictionary, ids, blurs, plane, noise, streak_px2, surroundings)
    samples, n_cells = PixelSamples(ids.size), cells_per_side(dictionary)
    if plane.shared and plane != Plane():
        homographies = replace(
            homographies, perspectives=perspectives_at(plane, homographies.centers - middle)
        )
    start = homographies
    rows, right = np.arange(ids.size), np.ones(ids.size, dtype=bool)
    for number in range(1, max_steps + 1):
        start = homographies if rows.size == ids.size else start.put(rows, homographies.take(rows))
        samples.read(image, rows, start, appearances)
        solution = samples.solution()
        if number > 1:  # before, a start that is a pixel off may leave as much as a wrong cell
            means, _, _ = samples.cell_residuals(rows, solution, n_cells)
            right[rows] = _cells_are_right(means, solution.contrasts()[rows])
        solution, plane = hold_common_unknowns(
            solution, start, middle, right, plane, alone=alone, settling=number > 1
        )
        appearances = replace(
            appearances,
            black_ratios=(solution.values[:, BLACK] + MIDDLE_GREY) / solution.contrasts(),
            round_in_image=plane != Plane() or streak_px2 is not None,
        )
        around = samples.learned(appearances.surroundings, solution, noise)
        changed = np.abs(appearances.surroundings.textures - around.textures) > noise
        appearances = replace(appearances, surroundings=around)
        homographies, moved_px = stepped(solution, start)
        homographies = on_plane(homographies, plane, middle)
        bent_px = np.abs(homographies.perspectives - start.perspectives) * sides_px**2 / 2
        unsettled = (moved_px > SETTLED_PX * np.cbrt(noise)) | (bent_px > SETTLED_PERSPECTIVE_PX) | changed
        rows = np.flatnonzero(unsettled & (right | (number < max_steps / 2)))
        if not rows.size:
            break
    residuals = samples.cell_residuals(np.arange(ids.size), solution, n_cells)
    variances = variances_at(plane, homographies.centers - middle) if plane.shared else np.zeros(ids.size)
    correlation = samples.variance_ratios(right, solution, homographies)
    results = fit_results_of(
        ids, solution, homographies, residuals, moved_px, blurs, variances, correlation=correlation
    )
    return replace(results, surroundings=appearances.surroundings), plane


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
        shifts = np.abs(homographies.images(SQUARE_CORNERS) - start.images(SQUARE_CORNERS))
        if shifts.max() < settled_px:
            break
    ratios, boxes = samples.variance_ratios(everyone, solution, homographies)
    _, peaks, _ = samples.cell_residuals(rows, solution, n_cells)
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
    before = perspectives_at(plane, points) if plane.shared else NO_PERSPECTIVE
    held = with_keystones(solution, start, before)
    seen = found_anisotropies(held, start)
    plane = common_plane(held, points, seen, inliers, most=settling)
    if not plane.shared:
        near = near_plane(plane, points, seen, inliers)
        perspectives = np.where(near, perspectives_at(plane, points), NO_PERSPECTIVE)
        return on_own_planes(solution, start, perspectives, np.where(near, 0.0, KEYSTONE_STD)), plane
    solution = with_keystones(solution, start, perspectives_at(plane, points))
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
    return (fit_plane if most else fit_plane_to_all)(points, anisotropies, variances)


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


def with_even_light(solution: LeastSquaresSolution, inliers: BoolArray) -> LeastSquaresSolution:
    """Return the solution with the change of light held at zero, unless the inliers' pixels contradict it."""
    held = solution.constrained(LIGHT, np.zeros((inliers.size, len(LIGHT))))
    return solution if _tells_more(solution, held, len(LIGHT), inliers) else held


def with_common_tone(solution: LeastSquaresSolution, inliers: BoolArray) -> LeastSquaresSolution:
    """Return the solution with the bend of the tone curve held at zero, or at one share of each contrast.

    The curve is the camera's, so that the share is taken over all inliers (N,): the median, weighted by how
    well each marker tells it. It counts only if several markers tell it, and if it is such as a camera's.
    """
    straight = solution.constrained(TONE, np.zeros((inliers.size, 1)))
    if np.count_nonzero(inliers) < MIN_MARKERS_FOR_TONE or not _tells_more(solution, straight, 1, inliers):
        return straight
    contrasts, tone = solution.contrasts(), TONE[0]
    variances = solution.inverse_normals[:, tone, tone] * (solution.noise_stds() / contrasts) ** 2
    share = weighted_median(solution.values[:, tone] / contrasts, inliers / variances)
    return solution.constrained(TONE, share * contrasts[:, None]) if 0 < share < MAX_TONE else straight


def _tells_more(
    solution: LeastSquaresSolution, held: LeastSquaresSolution, unknowns: int, inliers: BoolArray
) -> bool:
    """Return whether the pixels of the inliers speak against holding so many unknowns.

    The growth of the sum of squares over the variance of the noise is a chi-squared of expectation k and
    variance 2 k, with k the number of unknowns. Its mean over the inliers decides.
    """
    growth = held.residual_squares - solution.residual_squares
    chi_squared = (growth / solution.noise_stds() ** 2 / unknowns)[inliers]
    limit = 1 + FREE_SIGMAS * np.sqrt(2 / unknowns / chi_squared.size)
    return bool(chi_squared.mean() > limit)


def with_keystones(
    solution: LeastSquaresSolution, start: LocalHomographies, perspectives: ComplexArray | complex
) -> LeastSquaresSolution:
    """Return the solution with keystones held at those of perspectives (N,), or one for all, 1/px."""
    return solution.constrained(KEYSTONE, keystones(solution, start, perspectives))


def keystones(
    solution: LeastSquaresSolution, start: LocalHomographies, perspectives: ComplexArray | complex
) -> Array:
    """Return values (N, 2) of the unknowns `KEYSTONE` for perspectives (N,), or one for all, 1/px."""
    steps = keystones_to(start, np.broadcast_to(np.asarray(perspectives, dtype=complex), start.centers.shape))
    return _components(steps) * solution.contrasts()[:, None]


def steps_to(anisotropies: ComplexArray, solution: LeastSquaresSolution, start: LocalHomographies) -> Array:
    """Return values (N, 2) of the unknowns `ANISOTROPY` for anisotropies (N,) in image axes."""
    steps = (anisotropies * start.similarities.conj() - start.anisotropies) / start.similarities
    return _components(steps) * solution.contrasts()[:, None]


def found_anisotropies(solution: LeastSquaresSolution, start: LocalHomographies) -> ComplexArray:
    """Anisotropies (N,) in image axes that a solution gives."""
    found = solution.values[:, ANISOTROPY] @ np.array([1, 1j]) / solution.contrasts()
    return np.asarray((start.anisotropies + start.similarities * found) / start.similarities.conj())


def _components(steps: ComplexArray) -> Array:
    """Real and imaginary parts (N, 2) of complex steps (N,)."""
    return np.stack([steps.real, steps.imag], axis=1)


def stepped(
    solution: LeastSquaresSolution, homographies: LocalHomographies
) -> tuple[LocalHomographies, Array]:
    """Return the homographies moved by the solution's step, cut to `MAX_STEP`.

    Also returned is how far the uncut step moves the middles of the sides (N,), px.
    """
    steps = solution.values / solution.contrasts()[:, None]
    shift = steps[:, design_matrix.RIGHT] + 1j * steps[:, design_matrix.DOWN]
    grow = steps[:, design_matrix.GROW] + 1j * steps[:, design_matrix.TURN]
    anisotropy, keystone = (steps[:, pair] @ np.array([1, 1j]) for pair in (ANISOTROPY, KEYSTONE))
    size = np.sqrt(
        np.abs(shift) ** 2 + (np.abs(grow) ** 2 + np.abs(anisotropy) ** 2) / 4 + np.abs(keystone) ** 2 / 16
    )
    cut = np.minimum(1.0, MAX_STEP / np.maximum(size, MIN_STEP))
    after = moved(homographies, cut * shift, cut * grow, cut * anisotropy, cut * keystone)
    return after, size * homographies.sides_px()


def fit_results_of(
    ids: IntArray,
    solution: LeastSquaresSolution,
    homographies: LocalHomographies,
    cell_residuals: tuple[Array, Array, Array],
    moved_px: Array,
    blurs: Array,
    anisotropy_variances: Array,
    correlation: tuple[Array, Array] | None = None,
) -> FitResults:
    """Return the results of N markers from the solution of the fit's last step.

    Args:
        ids: (N,) marker ids.
        solution: of the last step.
        homographies: after the last step.
        cell_residuals: as `PixelSamples.cell_residuals` returns them.
        moved_px: (N,) how far the last step moved the middles of the sides.
        blurs: (N,) standard deviations of the blurs that were assumed, in marker sides.
        anisotropy_variances: (N,) variances of each component of the anisotropies that were held.
        correlation: as `PixelSamples.variance_ratios` returns it; not known if left out.
    """
    cell_means, peaks, besides = cell_residuals
    variance_ratios, boxes = correlation or (np.ones((ids.size, 2)), np.zeros(ids.size))
    log_blurs = solution.values[:, BLUR] / solution.contrasts()
    found = np.clip(log_blurs, -MAX_LOG_BLUR, MAX_LOG_BLUR)
    return FitResults(
        ids=ids,
        homographies=homographies,
        covariances=_covariances(solution, homographies, anisotropy_variances),
        blacks=solution.values[:, BLACK] + MIDDLE_GREY,
        contrasts=solution.values[:, CONTRAST],
        noise_stds=solution.noise_stds(),
        log_blurs=log_blurs,
        blurs_cells=blurs * cell_means.shape[1],
        sigmas_px=blurs * np.exp(found) / homographies.blurs(1.0),
        pixels=solution.pixels,
        cell_means=cell_means,
        peaks=peaks,
        moved_px=moved_px,
        variance_ratios=variance_ratios,
        boxes=boxes,
        qualities=np.full(ids.size, Quality.PHOTOMETRIC.value),
        surroundings=Surroundings.of_cards(ids.size),
        besides=besides,
        log_odds=np.full(ids.size, np.nan),
    )


def _covariances(
    solution: LeastSquaresSolution, homographies: LocalHomographies, anisotropy_variances: Array
) -> Array:
    """Covariances (N, 3, 3) of (u, v, heading) if noise is independent from pixel to pixel.

    A shear that is held at the plane's value varies as the plane does.
    """
    influences, maps = pose_influences(solution, homographies)
    covariances = influences @ maps.transpose(0, 2, 1) * (solution.noise_stds() ** 2)[:, None, None]
    covariances[:, 2, 2] += maps[:, 2, ANISOTROPY[1]] ** 2 * solution.contrasts() ** 2 * anisotropy_variances
    return np.asarray(covariances)


def pose_influences(solution: LeastSquaresSolution, homographies: LocalHomographies) -> tuple[Array, Array]:
    """Return how (u, v, heading) change with each column's product with the pixels, and with each unknown.

    Both are (N, 3, 15): P C and P, with C the inverse normal matrices. A step moves the centre by
    `m d + k d̄` and turns forward by `Re((m + k) / (m - k)) (θ - e_shear)`; steps are unknowns over contrast.
    """
    right = homographies.similarities + homographies.anisotropies
    down = 1j * (homographies.similarities - homographies.anisotropies)
    turn = (right / (homographies.similarities - homographies.anisotropies)).real
    maps = np.zeros((len(homographies), 3, UNKNOWNS))
    for column, axis in ((design_matrix.RIGHT, right), (design_matrix.DOWN, down)):
        maps[:, 0, column], maps[:, 1, column] = axis.real, axis.imag
    maps[:, 2, design_matrix.TURN], maps[:, 2, ANISOTROPY[1]] = turn, -turn
    maps /= solution.contrasts()[:, None, None]
    return maps @ solution.inverse_normals, maps


def box_ratios(small: Array, large: Array, variances: Array) -> Array:
    """Return the ratios (N, 2), of positions and of headings, to the variances of independent noise.

    Args:
        small: (N, 3) sums, over boxes of `BOX_PX` pixels, of the squared sums s, for u, v and heading.
        large: (N, 3) the same over boxes of twice as many pixels.
        variances: (N, 3) of u, v and heading, if noise is independent.
    """
    ratios = (2 * large - small) / (KEPT_SHARE * variances)
    return np.stack([ratios[:, :2].mean(axis=1), ratios[:, 2]], axis=1)
