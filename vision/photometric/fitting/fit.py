"""Markers fitted to pixels, as well as the noise allows.

Each step is a Gauss-Newton step in all of a marker's unknowns at once
(`design_matrix`). Two hypotheses are tried on all markers of the image together,
since they are then better tested than on one marker: that light does not change over the markers, and that
the anisotropies are those of one plane (`plane`). Where they hold, the unknowns
concerned are held, which leaves fewer to be estimated. The error after a step is of third order in the step,
so that one step is enough from a good prediction. The covariance is `σ_n² (JᵀJ)⁻¹`, with the standard
deviation of the noise σ_n from the residuals themselves.
"""

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.native.library import library
from skyherd.vision.native.records import UNKNOWNS, FitConstants, FitRequest
from skyherd.vision.photometric.fitting import (
    blur_ellipses,
    common_unknowns,
    correlated_noise,
    design_matrix,
    least_squares,
)
from skyherd.vision.photometric.fitting.appearance import MarkerAppearances, appearances_of
from skyherd.vision.photometric.fitting.correlated_noise import BOX_PX, MAX_MARKERS, box_ratios
from skyherd.vision.photometric.fitting.design_matrix import ANISOTROPY, KEYSTONE, DesignMatrices
from skyherd.vision.photometric.fitting.fit_result import MAX_LOG_BLUR, FitResults, pose_influences
from skyherd.vision.photometric.fitting.least_squares import LeastSquaresSolution
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane, plane_limits

MAX_STEPS = 6
"""Most steps from the place at which a quadrilateral was found. Chosen: what has not settled by then is
refused."""

MAX_STEPS_FROM_PREDICTION = 12
"""Most steps from a predicted place. Chosen larger, since a robot that turned otherwise than predicted lies
far from it, and steps are cut to `MAX_STEP`."""

SETTLED_PX = 0.08
"""A marker has settled once a step moves its sides by no more than this times the cube root of the noise in
grey levels. Derived: as `∫ T' T'' = 0` over an edge, a step s leaves an error in proportion to s³, and the
noise one in proportion to itself. A smaller limit costs more steps, a larger one leaves part of the step."""

SETTLED_PERSPECTIVE_PX = 0.002
"""A marker has not settled while the plane's last change moves one of its corners by more than this. Chosen:
about the standard deviation of the position of a marker of 20 px (`photometric_accuracy.toml`)."""

USUAL_NOISE = 3.0
"""Assumed standard deviation of a pixel, grey levels, until a camera's is known. Chosen; it decides when a
fit has settled and how texture is weighted, and is replaced after the first image with markers."""

MAX_STEP = 0.15
"""Steps are cut to this length, in marker sides, radians and logarithms of scale alike. Chosen: the model is
linear only over about one cell."""

MIN_STEP = 1e-12
"""Length below which a step counts as this long when it is compared with `MAX_STEP`; a step of zero would
divide by zero."""

OFF_CELL = 0.25
"""A cell has the wrong colour if its mean residual exceeds this share of the contrast. Chosen: a cell of the
wrong colour leaves about half of it under a blur of 0.4 cells, and more under less."""

OUTLIER_SHARE, OUTLIER_SIGMAS = 0.25, 6.0
"""A pixel whose residual exceeds both this share of the contrast and this many standard deviations of the
noise shows something other than the marker. Chosen: wrong poses and blurs leave less once a fit is near."""


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
        pixels = DesignMatrices(image, rows, start.take(rows), appearances.take(rows))
        self._grams[rows], self._counts[rows] = pixels.gram_matrices(), pixels.counts
        self._part_of[rows] = len(self._parts)
        self._parts.append(pixels)

    def solution(self) -> LeastSquaresSolution:
        """Return the least-squares solution for all N markers, with every unknown free."""
        return LeastSquaresSolution.of_grams(self._grams, self._counts)

    def cell_residuals(
        self, rows: IntArray, solution: LeastSquaresSolution, n_cells: int
    ) -> tuple[Array, Array]:
        """Return what a solution of all N markers leaves of the pixels of the markers `rows` (R,).

        Returns:
            The mean residual over each cell (R, n, n), and the largest absolute residual of a pixel (R,),
            both in grey levels.
        """
        means, peaks = np.empty((self._counts.size, n_cells, n_cells)), np.empty(self._counts.size)
        for pixels in self._latest_parts(rows):
            means[pixels.rows], peaks[pixels.rows] = pixels.cell_residuals(
                solution.values[pixels.rows], n_cells
            )
        return means[rows], peaks[rows]

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
    image: Image,
    dictionary: str,
    ids: IntArray,
    homographies: LocalHomographies,
    sigma_px: float | Array,
    plane: Plane,
    noise: float = USUAL_NOISE,
    max_steps: int = MAX_STEPS,
    *,
    alone: bool = False,
    streak_px2: complex | None = None,
) -> tuple[FitResults, Plane]:
    """Fit markers `ids` (N,) that lie near `homographies`: a pixel or two, or a tenth of a side, away.

    Nothing is refused here. A fit that went wrong shows it by its residuals, which
    `skyherd.vision.photometric.verify` judges.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        ids: (N,) marker ids, at least one.
        homographies: N of them, where to begin.
        sigma_px: standard deviation of the blur of lens and pixel together, as far as it is known: of all
            markers, or (N,) of each.
        plane: of the markers, as far as it is known. If it is not, their own perspectives are where they
            begin.
        noise: standard deviation of a pixel, grey levels, as far as it is known.
        max_steps: most steps taken; a marker that has settled takes no more.
        alone: whether each marker has a plane of its own, also if one would explain them all.
        streak_px2: by how much the blur differs along the image's axes, the Q of `blur_ellipses`, px²; None
            for round blur.

    Returns:
        The results, in the order of `ids`, and the plane that they put the markers on.
    """
    blurs = homographies.blurs(sigma_px)
    appearances = appearances_of(dictionary, ids, blurs, plane, noise, streak_px2)
    request = fit_request(image, homographies, appearances, noise, max_steps, alone=alone)
    found = plane.record()
    fits, cell_means = library().fit_markers(request, found)
    return FitResults.of_records(ids, fits, cell_means, blurs), Plane.of_record(found)


def fit_request(
    image: Image,
    homographies: LocalHomographies,
    appearances: MarkerAppearances,
    noise: float,
    max_steps: int = MAX_STEPS,
    *,
    alone: bool = False,
) -> FitRequest:
    """Return the arguments of the compiled fit of N markers; see `fit_markers`."""
    return FitRequest(
        image=np.ascontiguousarray(image),
        start=homographies.records(),
        appearances=appearances.records(),
        cells=appearances.cells,
        constants=fit_constants(),
        texture=appearances.texture,
        noise=noise,
        max_steps=max_steps,
        alone=alone,
        streak_px2=appearances.streak_px2,
    )


def fit_constants() -> FitConstants:
    """Return the constants of the fit for the compiled library."""
    return FitConstants(
        ground_ridge=least_squares.GROUND_RIDGE,
        ridge=least_squares.RIDGE,
        single_precision=least_squares.SINGLE_PRECISION,
        min_squares=least_squares.MIN_SQUARES,
        min_contrast=least_squares.MIN_CONTRAST,
        max_growth=design_matrix.MAX_GROWTH,
        min_sigma=design_matrix.SIGMA_LIMITS[0],
        max_sigma=design_matrix.SIGMA_LIMITS[1],
        steep_anisotropy=blur_ellipses.STEEP_ANISOTROPY,
        min_variance_px2=blur_ellipses.MIN_VARIANCE_PX2,
        min_print_share=common_unknowns.MIN_PRINT_SHARE,
        free_sigmas=common_unknowns.FREE_SIGMAS,
        max_tone=common_unknowns.MAX_TONE,
        keystone_std=common_unknowns.KEYSTONE_STD,
        near_plane=common_unknowns.NEAR_PLANE,
        max_step=MAX_STEP,
        min_step=MIN_STEP,
        settled_px=SETTLED_PX,
        settled_perspective_px=SETTLED_PERSPECTIVE_PX,
        off_cell=OFF_CELL,
        max_log_blur=MAX_LOG_BLUR,
        kept_share=correlated_noise.KEPT_SHARE,
        plane=plane_limits(),
        min_markers_for_tone=common_unknowns.MIN_MARKERS_FOR_TONE,
        min_pixels_for_plane=common_unknowns.MIN_PIXELS_FOR_PLANE,
        box_px=correlated_noise.BOX_PX,
        max_box_markers=correlated_noise.MAX_MARKERS,
    )


def image_middle(image: Image) -> complex:
    """Return the centre of an image (height, width), u + iv, px: the origin of `Plane`'s points."""
    return complex(image.shape[1] - 1, image.shape[0] - 1) / 2


def has_outlier_pixels(peaks: Array, contrasts: Array, noise_stds: Array) -> BoolArray:
    """Return which of N fits (N,) leave much more of some pixel than noise does: something may cover it.

    Args:
        peaks: (N,) largest absolute residual of a pixel, grey levels.
        contrasts: (N,) grey levels from black to white.
        noise_stds: (N,) standard deviations of the noise, grey levels.
    """
    return np.asarray(peaks > np.maximum(OUTLIER_SHARE * contrasts, OUTLIER_SIGMAS * noise_stds))


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
    moved = homographies.moved(cut * shift, cut * grow, cut * anisotropy, cut * keystone)
    return moved, size * homographies.sides_px()
