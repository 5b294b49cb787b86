"""What all markers of an image have in common: the plane that they lie on, and whether light is even.

Both are hypotheses that are tested on all markers together, which is more precise than on one marker.
They are tested on the markers that look like a print and have all their cells right. Smooth
ground that was taken for a marker can be fitted as well as one, and would put all headings off by half of
their standard deviation.
"""

from collections.abc import Callable

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray
from skyherd.vision.photometric.design_matrix import BLACK, LEAN, LIGHT, MIDDLE_GREY, SQUEEZE, UNKNOWNS
from skyherd.vision.photometric.fit_result import print_contrasts, weighted_median
from skyherd.vision.photometric.least_squares import LeastSquaresSolution
from skyherd.vision.photometric.local_homography import LocalHomographies
from skyherd.vision.photometric.plane import Plane, fit_plane, fit_plane_to_all

MIN_PIXELS_FOR_PLANE = 2 * UNKNOWNS
"""Markers with fewer pixels do not count for the plane, since their noise is not known. Chosen: half of the
pixels are then degrees of freedom."""

MIN_PRINT_SHARE = 0.6
"""Fits whose print contrast is below this share of the median one are not counted as prints. Chosen loosely:
the final test is `skyherd.vision.photometric.verify.MIN_PRINT_SHARE`, 0.75."""

UNEVEN_SIGMAS = 8.0
"""Light counts as uneven once the markers' mean chi-squared exceeds its expectation by so many of its
standard deviations. Chosen: chance does not reach it; a smaller value frees two unknowns a marker without
need."""


OWN_PLANES = Plane(shared=False)
"""The plane of markers that share none: each has its own squeeze and lean."""

LEAN_STD = 0.1
"""Expected size of a marker's own lean, where no plane says what it is: the standard deviation of each of its
two components, by which the marker's image grows along one side's length. Chosen: that of a marker seen from
four sides away at a tilt of 25 degrees; a larger one lets small markers lean by their noise."""


def hold_common_unknowns(
    solution: LeastSquaresSolution,
    start: LocalHomographies,
    middle: complex,
    right: BoolArray,
    plane: Plane,
    *,
    alone: bool,
    settling: bool,
) -> tuple[LeastSquaresSolution, Plane]:
    """Return the solution with the unknowns held that the markers share, and the plane of the markers.

    Light is held at even where that explains the pixels, and squeezes and leans at those of the plane. Where
    no plane explains the squeezes, each marker has its own, and its own lean, which is expected to be small.

    Args:
        solution: with every unknown free.
        start: homographies about which it is linear.
        middle: centre of the image, u + iv, px.
        right: (N,) which markers have all their cells right, as far as that is known.
        plane: of the step before.
        alone: whether each marker has a plane of its own in any case.
        settling: whether a step was taken before, so that a plane of most of the markers means something.
    """
    inliers = _print_inliers(solution, right)
    even = solution.constrained(LIGHT, np.zeros((right.size, 2)))
    solution = solution if _is_uneven(solution, even, inliers) else even
    if alone:
        return on_own_planes(solution, start, LEAN_STD), OWN_PLANES
    return on_common_plane(solution, start, middle, inliers, plane, most=settling)


def _print_inliers(solution: LeastSquaresSolution, right: BoolArray) -> BoolArray:
    """Which of N fits decide on what all markers of an image share; all of them, if none is `right`.

    Left out is what is not fitted yet, is covered in part, or may be ground that was taken for a marker:
    most ground is paler than a print.
    """
    if not right.any():
        return np.ones_like(right)
    contrasts = solution.contrasts()
    prints = print_contrasts(solution.values[:, BLACK] + MIDDLE_GREY, contrasts)
    weights = right * solution.pixels * (contrasts / solution.noise_stds()) ** 2
    return right & (prints > MIN_PRINT_SHARE * weighted_median(prints, weights))


def _is_uneven(solution: LeastSquaresSolution, even: LeastSquaresSolution, inliers: BoolArray) -> bool:
    """Whether light changes over the markers, by the mean of their chi-squared of two degrees of freedom."""
    growth = even.residual_squares - solution.residual_squares
    chi_squared = (growth / solution.noise_stds() ** 2 / 2)[inliers]
    return bool(chi_squared.mean() > 1 + UNEVEN_SIGMAS / np.sqrt(chi_squared.size))


def on_common_plane(
    solution: LeastSquaresSolution,
    start: LocalHomographies,
    middle: complex,
    inliers: BoolArray,
    plane: Plane,
    *,
    most: bool = False,
    lean_std: float = LEAN_STD,
) -> tuple[LeastSquaresSolution, Plane]:
    """Return the solution with squeezes and leans held at those of the plane that the inliers lie on.

    Where no plane explains the squeezes they are left free, and the leans are expected about zero.

    Args:
        solution: with squeezes and leans free.
        start: homographies about which it is linear.
        middle: centre of the image, u + iv, px.
        inliers: (N,) which markers the plane is fitted to.
        plane: of the step before, which says how markers lean while their squeezes are compared.
        most: whether a plane is enough that explains most of the inliers, not all.
        lean_std: expected size of a lean where no plane says what it is; 0 holds it at zero.

    Returns:
        The solution, and the plane.
    """
    leaning = solution.constrained(LEAN, _leans(solution, start, plane, middle))
    plane, squeezes = _common_plane(leaning, start, middle, inliers, fit_plane if most else fit_plane_to_all)
    if not plane.shared:
        return on_own_planes(solution, start, lean_std), plane
    leaning = solution.constrained(LEAN, _leans(solution, start, plane, middle))
    return leaning.constrained(SQUEEZE, squeezes), plane


def on_own_planes(
    solution: LeastSquaresSolution, start: LocalHomographies, lean_std: float
) -> LeastSquaresSolution:
    """Return the solution with the squeezes free and the leans expected about zero.

    Args:
        solution: with squeezes and leans free.
        start: homographies about which it is linear.
        lean_std: expected size of each of a lean's components; 0 holds it at zero.
    """
    level = _leans(solution, start, OWN_PLANES, 0j)
    noise_stds = solution.constrained(LEAN, level).noise_stds()
    return solution.expected(LEAN, level, (lean_std * solution.contrasts() / noise_stds) ** 2)


def _leans(solution: LeastSquaresSolution, start: LocalHomographies, plane: Plane, middle: complex) -> Array:
    """Values (N, 2) of the unknowns `LEAN` at which markers lean as the plane, or not at all without one."""
    horizons = plane.horizons(start.centers - middle) if plane.shared else np.zeros(len(start), dtype=complex)
    steps = start.leans_to(horizons)
    return np.stack([steps.real, steps.imag], axis=1) * solution.contrasts()[:, None]


def _common_plane(
    solution: LeastSquaresSolution,
    homographies: LocalHomographies,
    middle: complex,
    inliers: BoolArray,
    fit: Callable[[ComplexArray, ComplexArray, Array], Plane],
) -> tuple[Plane, Array]:
    """The plane that the inliers lie on, and the steps of squeeze (N, 2) that put every marker on it.

    The steps are values for the unknowns `SQUEEZE`; they mean nothing if the plane is not shared.
    """
    contrasts = solution.contrasts()
    found = solution.values[:, SQUEEZE] @ np.array([1, 1j]) / contrasts
    spread = solution.inverse_normals[:, SQUEEZE, SQUEEZE].mean(axis=1)
    counted = (spread > 0) & (solution.pixels > MIN_PIXELS_FOR_PLANE) & inliers
    spread = np.where(counted, spread, np.inf)
    points = homographies.centers - middle
    squeezes = (homographies.squeezes + homographies.arms * found) / homographies.arms.conj()
    plane = fit(points, squeezes, spread * (solution.noise_stds() / contrasts) ** 2)
    if plane.shared:
        on_plane = plane.squeezes(points) * homographies.arms.conj()
        found = (on_plane - homographies.squeezes) / homographies.arms
    return plane, np.stack([found.real, found.imag], axis=1) * contrasts[:, None]
