"""Markers fitted to pixels, as well as the noise allows.

Each step is a Gauss-Newton step in all of a marker's unknowns at once (`design_matrix`). Three hypotheses
are tried on all markers of the image together, since they are then better tested than on one marker
(`common_unknowns`): that light does not change over the markers, that they share a tone curve, and that the
anisotropies are those of one plane (`plane`). Where they hold, the unknowns concerned are held, which leaves
fewer to be estimated. The error after a step is of third order in the step, so that one step is enough from
a good prediction. The compiled fit is `vision/native/marker_fit.c`, and its least squares `least_squares.c`.
The covariance is `σ_n² (JᵀJ)⁻¹`, with the standard deviation of the noise σ_n from the residuals themselves.

All columns of a marker's model, together with its pixels, make one matrix of inner products. The solution x
with every unknown free also gives the solution in which some of them, h, are held at values x_h = v,

    x' = x - C_xh C_hh⁻¹ (x_h - v),   C' = C - C_xh C_hh⁻¹ C_hx,

with C the inverse normal matrix; the sum of squares grows by `(x_h - v)ᵀ C_hh⁻¹ (x_h - v)`. With `C_hh + P`
in place of C_hh, the unknowns are not held, but expected at v with variances P. One Gram matrix a marker thus
answers every question that is asked by holding unknowns (is the light even? do the anisotropies belong to one
plane?) without looking at the pixels again.
"""

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.native.library import library
from skyherd.vision.native.records import FitConstants, FitRequest
from skyherd.vision.photometric.fitting import common_unknowns, correlated_noise, design_matrix
from skyherd.vision.photometric.fitting.appearance import MarkerAppearances, appearances_of
from skyherd.vision.photometric.fitting.fit_result import MAX_LOG_BLUR, FitResults
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane, plane_limits
from skyherd.vision.photometric.fitting.surroundings import Surroundings

GROUND_RIDGE = 3e-4
"""Added to the ground's diagonal element of the normal matrix, since there may be no ground to be seen: a
prior of standard deviation `1 / sqrt(3e-4)` = 58 times the noise about the card's white. Derived from that
deviation, which is chosen: a smaller ridge lets an unseen ground take any value."""

RIDGE = 1e-9
"""Added to the other diagonal elements of the normal matrix, so that a column of zeros (no contrast) makes no
singular matrix. Chosen far below the element of any column that is not zero, which it leaves as it is."""

SINGLE_PRECISION = 3e-6
"""Relative error of the sums in a Gram matrix, at most. Each diagonal element is raised by this share, so
that two columns that are equal to within rounding make no singular matrix."""

MIN_SQUARES = 1e-9
"""Smallest sum of squared residuals, grey levels squared, which keeps the noise of a perfect fit positive.
Chosen far below the rounding noise of a single pixel, 1/12."""

MIN_CONTRAST = 4.0
"""Smallest contrast, grey levels, that steps are divided by. Chosen: there is nothing to be fitted below it,
and a marker counts only from `skyherd.vision.photometric.verify.MIN_MARKER_CONTRAST` on."""

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
    surroundings: Surroundings | None = None,
) -> tuple[FitResults, Plane]:
    """Fit markers `ids` (N,) that lie near `homographies`: a pixel or two, or a tenth of a side, away.

    This is one fit at full size under given blurs: the reference of `refine.fit_any_blur`, which repeats it.
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
        streak_px2: by how much the blur differs along the image's axes, the Q of `design_matrix`, px²; None
            for round blur.
        surroundings: of the markers; white cards if left out.

    Returns:
        The results, in the order of `ids`, and the plane that they put the markers on.
    """
    blurs = homographies.blurs(sigma_px)
    appearances = appearances_of(dictionary, ids, blurs, plane, noise, streak_px2, surroundings)
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
        ground_ridge=GROUND_RIDGE,
        ridge=RIDGE,
        single_precision=SINGLE_PRECISION,
        min_squares=MIN_SQUARES,
        min_contrast=MIN_CONTRAST,
        max_growth=design_matrix.MAX_GROWTH,
        min_sigma=design_matrix.SIGMA_LIMITS[0],
        max_sigma=design_matrix.SIGMA_LIMITS[1],
        steep_anisotropy=design_matrix.STEEP_ANISOTROPY,
        min_variance_px2=design_matrix.MIN_VARIANCE_PX2,
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
