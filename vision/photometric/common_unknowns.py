"""What all markers of an image have in common: the plane that they lie on, and whether light is even.

Both are hypotheses that are tested on all markers together, which is more precise than on one marker.
They are tested on the markers that look like a print and have all their cells right. Smooth
ground that was taken for a marker can be fitted as well as one, and would put all headings off by half of
their standard deviation.
"""

import numpy as np

from skyherd.geometry import Array, BoolArray
from skyherd.vision.photometric.design_matrix import BLACK, LIGHT, MIDDLE_GREY, SQUEEZE, UNKNOWNS
from skyherd.vision.photometric.fit_result import print_contrasts, weighted_median
from skyherd.vision.photometric.least_squares import LeastSquaresSolution
from skyherd.vision.photometric.local_homography import LocalHomographies
from skyherd.vision.photometric.plane import Plane, fit_plane

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


def hold_common_unknowns(
    solution: LeastSquaresSolution, start: LocalHomographies, middle: complex, right: BoolArray
) -> tuple[LeastSquaresSolution, Plane]:
    """Return the solution with the unknowns held that the markers share, and the plane of the markers.

    Light is held at even where that explains the pixels, and the squeezes at those of the plane.

    Args:
        solution: with every unknown free.
        start: homographies about which it is linear.
        middle: centre of the image, u + iv, px.
        right: (N,) which markers have all their cells right, as far as that is known.
    """
    inliers = _print_inliers(solution, right)
    even = solution.constrained(LIGHT, np.zeros((right.size, 2)))
    solution = solution if _is_uneven(solution, even, inliers) else even
    plane, squeezes = common_plane(solution, start, middle, inliers)
    return solution.constrained(SQUEEZE, squeezes), plane


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


def common_plane(
    solution: LeastSquaresSolution, homographies: LocalHomographies, middle: complex, inliers: BoolArray
) -> tuple[Plane, Array]:
    """Return the plane that the inliers lie on, and the steps of squeeze that put every marker on it.

    Args:
        solution: with the squeezes free.
        homographies: about which it is linear.
        middle: centre of the image, u + iv, px.
        inliers: (N,) which markers the plane is fitted to.

    Returns:
        The plane, and values (N, 2) for the unknowns `SQUEEZE`. If no plane explains the squeezes, the values
        are those of the solution itself.
    """
    contrasts = solution.contrasts()
    found = solution.values[:, SQUEEZE] @ np.array([1, 1j]) / contrasts
    spread = solution.inverse_normals[:, SQUEEZE, SQUEEZE].mean(axis=1)
    counted = (spread > 0) & (solution.pixels > MIN_PIXELS_FOR_PLANE) & inliers
    spread = np.where(counted, spread, np.inf)
    points = homographies.centers - middle
    squeezes = (homographies.squeezes + homographies.arms * found) / homographies.arms.conj()
    plane = fit_plane(points, squeezes, spread * (solution.noise_stds() / contrasts) ** 2)
    if plane.shared:
        on_plane = plane.squeezes(points) * homographies.arms.conj()
        found = (on_plane - homographies.squeezes) / homographies.arms
    return plane, np.stack([found.real, found.imag], axis=1) * contrasts[:, None]
