"""The plane that the markers of an image share, found from how each of them is squeezed.

Seen by a camera whose axis is tilted or whose pixels are oblong, squares become parallelograms that shrink
towards the horizon. With image points p = u + iv from the image's centre, the plane's map to the image is,
but for a similarity, `p = A q / (1 + l·q)` with A squeezing by α; a marker at p is then squeezed, in image
axes (`local_homography`), by

    ε(p) = (α (1 - p λ̄ / 2) - p λ / 2) / (1 - p̄ λ / 2 - p̄ λ̄ α / 2) ≈ α - p λ / 2,

with the line λ̄·p = 1 as horizon. The two complex numbers α and λ are all that a tilt, an aspect and a skew
do to the markers of an image, whatever the camera is: they follow by least squares, without a focal length,
without the sizes of the markers and without their corners.

The plane matters to each marker's fit in two ways. It replaces two unknowns a marker by two numbers an image,
which makes headings more precise. And it says how blur that is round in the image lies in a marker's
coordinates; neglecting that costs 0.002 px at a tilt of 15 degrees. Where no plane explains the squeezes,
each marker keeps its own.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.geometry import Array, ComplexArray

SIGNIFICANT = 14.0
"""Fall of the chi-squared by which two more unknowns must earn their place. Derived: chance reaches
`exp(-14 / 2)` = 0.0009, once in 1000 images. Half of it lets noise tilt one image in 30; twice as much
ignores small tilts."""

EXCESS = 6.0
"""Chi-squared a degree of freedom beyond which markers do not lie on one plane. Chosen: texture that blurs
into small cards may double the chi-squared of markers that do lie on one."""

MIN_SHARE_ON_PLANE, MIN_MARKERS_ON_PLANE = 2 / 3, 4
"""Smallest share and number of markers that a common plane must explain. Chosen: most of them, and one marker
more than the three with which a plane's four unknowns leave two degrees of freedom."""

MAX_ROUNDS = 40
"""Most rounds of the plane's iteration. Each leaves half of |λ p| or less of what the one before did while
the tilt is small, 0.1 at 15 degrees. Measured at 70 degrees: 8 rounds leave squeezes off by up to 6.5e-4,
which is more than their noise, and 30 leave none."""

CONVERGED = 1e-7
"""Change of the squeezes in one round below which the iteration ends. Chosen far below the accuracy to which
squeezes are known, 1e-4 and more."""

HORIZON_RIDGE = 1e-12
"""Share of the normal matrix's trace that is added to its diagonal, so that markers that all lie in one
place, which say nothing about a horizon, leave it at zero. Chosen above the rounding of double precision."""


@dataclass(frozen=True)
class Plane:
    """The plane of an image's markers; squeeze and horizon are zero for a camera that looks straight down.

    Attributes:
        squeeze: α, the squeeze at the image's centre.
        horizon: λ, 1/px.
        shared: False where the markers do not lie as on one plane, so that each has its own squeeze.
        covariance: (2, 2) of α and λ, for one of their two components each.
    """

    squeeze: complex = 0j
    horizon: complex = 0j
    shared: bool = True
    covariance: ComplexArray = field(default_factory=lambda: np.zeros((2, 2), dtype=complex), compare=False)

    def squeezes(self, points: ComplexArray) -> ComplexArray:
        """Return the squeezes ε (N,) of markers at image points (N,), px from the image's centre."""
        a, h = self.squeeze, self.horizon
        top = a * (1 - points * np.conj(h) / 2) - points * h / 2
        return np.asarray(top / (1 - points.conj() * h / 2 - points.conj() * np.conj(h) * a / 2))

    def variances(self, points: ComplexArray) -> Array:
        """Return the variances (N,) of each component of the squeezes at image points (N,)."""
        design = squeeze_design_matrix(points)
        return np.asarray(((design @ self.covariance) * design.conj()).sum(axis=1).real)

    def horizons(self, points: ComplexArray) -> ComplexArray:
        """Return the horizons h (N,) of `LocalHomographies` at image points (N,): `λ / (1 - λ·p)`, 1/px."""
        return np.asarray(self.horizon / (1 - (np.conj(self.horizon) * points).real))


def squeeze_design_matrix(points: ComplexArray) -> ComplexArray:
    """Return the columns (N, 2) of α and λ in the squeezes at image points (N,): to first order 1, -p / 2."""
    design = np.ones((points.size, 2), dtype=complex)
    design[:, 1] = -points / 2
    return design


def fit_plane(points: ComplexArray, squeezes: ComplexArray, variances: Array) -> Plane:
    """Return the simplest plane that explains the squeezes of most markers, (N,), at image points (N,).

    If no plane explains all of them, the tenth of the markers that lies farthest off is left out, and so on
    until one does, since some may lie on something else or be covered in part. If none explains
    `MIN_SHARE_ON_PLANE` of the markers, the result has `shared` False. Arguments are those of
    `fit_plane_to_all`.
    """
    kept = np.flatnonzero(np.isfinite(variances))
    least = max(math.ceil(MIN_SHARE_ON_PLANE * kept.size), MIN_MARKERS_ON_PLANE)
    first = plane = fit_plane_to_all(points, squeezes, variances)
    while not plane.shared and kept.size > least:
        off = np.abs(squeezes - plane.squeezes(points))[kept] ** 2 / variances[kept]
        kept = kept[np.argsort(off)[: max(least, kept.size - math.ceil(kept.size / 10))]]
        plane = fit_plane_to_all(points[kept], squeezes[kept], variances[kept])
    return plane if plane.shared else first


def fit_plane_to_all(points: ComplexArray, squeezes: ComplexArray, variances: Array) -> Plane:
    """Return the simplest plane that explains all squeezes (N,) observed at image points (N,).

    Three hypotheses are compared: a camera that looks straight down (no unknowns), one squeeze common to all
    (α), and a tilted plane (α and λ). The next one is accepted where the chi-squared falls by more than
    `SIGNIFICANT`. If more than `EXCESS` of it a degree of freedom is left in the end, no plane explains the
    squeezes, and the result has `shared` False.

    Args:
        points: (N,) centres of the markers, px from the image's centre.
        squeezes: (N,) squeezes in image axes.
        variances: (N,) of each of the squeezes' two components; infinite for markers without information.
            Errors that they leave out are estimated from the fit itself.
    """
    if not np.isfinite(variances).any():
        return Plane()
    best, least = Plane(), _chi_squared(Plane(), points, squeezes, variances)
    per_freedom = least / (2 * points.size)
    if _linear_fall(points, squeezes, variances) <= SIGNIFICANT:
        return replace(best, shared=per_freedom <= EXCESS)
    for unknowns in (2, 4):
        if 2 * points.size <= unknowns:
            break
        plane = _solve(points, squeezes, variances, tilted=unknowns == 4)
        chi_squared = _chi_squared(plane, points, squeezes, variances)
        excess = max(chi_squared / (2 * points.size - unknowns), 1.0)
        if least - chi_squared > SIGNIFICANT * excess:
            best, least, per_freedom = plane, chi_squared, excess
    return replace(best, shared=per_freedom <= EXCESS)


def _chi_squared(plane: Plane, points: ComplexArray, squeezes: ComplexArray, variances: Array) -> float:
    return float(np.sum(np.abs(squeezes - plane.squeezes(points)) ** 2 / variances))


def _linear_fall(points: ComplexArray, squeezes: ComplexArray, variances: Array) -> float:
    """By how much the chi-squared falls with both α and λ, to first order."""
    weighted, normal = _normal_equations(points, variances)
    (a, h), ((aa, ah), (_, hh)) = (weighted @ squeezes).tolist(), normal.tolist()
    fall = abs(a) ** 2 * hh.real + abs(h) ** 2 * aa.real - 2 * (a.conjugate() * ah * h).real
    return float(fall / (aa.real * hh.real - abs(ah) ** 2))


def _normal_equations(points: ComplexArray, variances: Array) -> tuple[ComplexArray, ComplexArray]:
    """Weighted columns (2, N) of α and λ, and their normal matrix (2, 2)."""
    design = squeeze_design_matrix(points)
    weighted = design.conj().T / variances
    normal = weighted @ design
    diagonal = np.arange(2)
    normal[diagonal, diagonal] += HORIZON_RIDGE * (normal[0, 0].real + normal[1, 1].real)
    return weighted, normal


def _solve(points: ComplexArray, squeezes: ComplexArray, variances: Array, *, tilted: bool) -> Plane:
    """Weighted least squares in α, and in λ if `tilted`; terms of second order are the last round's."""
    unknowns = 1 + tilted
    weighted, normal = _normal_equations(points, variances)
    covariance = np.zeros((2, 2), dtype=complex)
    covariance[:unknowns, :unknowns] = np.linalg.inv(normal[:unknowns, :unknowns])
    plane = Plane()
    for _ in range(MAX_ROUNDS):
        a, h = plane.squeeze, plane.horizon
        second = (a * points * np.conj(h) - squeezes * points.conj() * (h + np.conj(h) * a)) / 2
        solution = covariance @ (weighted @ (squeezes + second))
        plane = Plane(complex(solution[0]), complex(solution[1]))
        if abs(plane.squeeze) > 1 or abs(plane.horizon) * np.abs(points).max() > 1:
            # Mirrored, or with a horizon among the markers: no camera sees a plane like this.
            return Plane()
        if abs(plane.squeeze - a) + abs(plane.horizon - h) * np.abs(points).max() < CONVERGED:
            break
    return replace(plane, covariance=covariance)
