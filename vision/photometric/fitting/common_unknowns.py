"""Unknowns that all markers of an image share: their plane, uneven light, a bend of the tone curve.

These are hypotheses that are tested on all markers together, which is more precise than on one marker.
They are tested on the markers that look like a print and have all their cells right. Smooth
ground that was taken for a marker can be fitted as well as one, and would put all headings off by half of
their standard deviation.

A fit of markers tests them in `vision/native/common_unknowns.c`. The functions here are for rarer fits, to
chosen pixels (`occlusion`) or with all unknowns free.
"""

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray
from skyherd.vision.native.records import UNKNOWNS
from skyherd.vision.photometric.fitting.design_matrix import (
    ANISOTROPY,
    KEYSTONE,
    LIGHT,
    TONE,
)
from skyherd.vision.photometric.fitting.fit_result import weighted_median
from skyherd.vision.photometric.fitting.least_squares import LeastSquaresSolution
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import (
    Plane,
)

MIN_PIXELS_FOR_PLANE = 2 * UNKNOWNS
"""Markers with fewer pixels do not count for the plane, since their noise is not known. Chosen: half of the
pixels are then degrees of freedom."""

MIN_PRINT_SHARE = 0.6
"""Fits whose print contrast is below this share of the median one are not counted as prints. Chosen loosely:
the final test is `skyherd.vision.photometric.verify.MIN_PRINT_SHARE`, 0.75."""

FREE_SIGMAS = 8.0
"""Light counts as uneven, and the tone curve as bent, once the markers' mean chi-squared exceeds its
expectation by so many of its standard deviations. Chosen: chance does not reach it; a smaller value frees
unknowns of each marker without need."""

MIN_MARKERS_FOR_TONE, MAX_TONE = 4, 2.0
"""The tone curve counts as bent only if so many markers show it, and if the bend is positive and below the
second number. Derived: a camera's gamma of 1 / 2.2 bends by 1.1 to 1.5, and never below the straight line.
Chosen: ground that looks like one marker under some curve must not choose the curve; three may be chance."""

OWN_PLANES = Plane(shared=False)
"""The plane of markers that share none: each has its own anisotropy and keystone."""

NO_PERSPECTIVE = 0j
"""The perspective of a marker without keystone, 1/px."""

KEYSTONE_STD = 0.1
"""Expected size of a marker's own keystone, where no plane says what it is: the standard deviation of each of
its two components, by which the marker's image grows along one side's length. Chosen: that of a marker seen
from four sides away at a tilt of 25 degrees; with a larger one, small markers take keystones from their
noise."""

NEAR_PLANE = 0.02
"""Markers whose anisotropies lie within this of a plane have its keystone, if most of an image's
markers do. A plane does not explain them exactly where a lens bends it or processing feigns anisotropies.
Measured on photographs of boards: anisotropies are 0.002 to 0.005 off, and the keystones found differ from
the plane's by their noise, 0.004 to 0.014. Held there, corners are off by 0.056, 0.124 and 0.140 px on three
boards where free keystones give 0.084, 0.137 and 0.153 px."""


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
    steps = start.keystones_to(np.broadcast_to(np.asarray(perspectives, dtype=complex), start.centers.shape))
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
