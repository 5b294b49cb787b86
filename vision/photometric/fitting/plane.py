"""The plane that the markers of an image share, found from the anisotropy of each.

Seen by a camera whose axis is tilted or whose pixels are oblong, squares become parallelograms that shrink
towards the horizon. With image points p = u + iv from the image's centre, the plane's map to the image is
`p = A q / (1 + l·q)` up to a similarity, with an A of anisotropy α. A marker at p is then anisotropic, in
image axes (`local_homography`), by

    ε(p) = (α (1 - p λ̄ / 2) - p λ / 2) / (1 - p̄ λ / 2 - p̄ λ̄ α / 2) ≈ α - p λ / 2,

with the line λ̄·p = 1 as horizon. The two complex numbers α and λ are all that a tilt, an aspect and a skew
do to the markers of an image, whatever the camera is: they follow by least squares, without a focal length,
without the sizes of the markers and without their corners.

The plane matters to each marker's fit in two ways. It replaces two unknowns a marker by two numbers an image,
which makes headings more precise. And it says how blur that is round in the image lies in a marker's
coordinates; neglecting that costs 0.002 px at a tilt of 15 degrees. Where no plane explains the anisotropies,
each marker keeps its own.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from skyherd.geometry import Array, ComplexArray
from skyherd.vision.native.library import library

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
the tilt is small, 0.1 at 15 degrees. Measured at 70 degrees: 8 rounds leave anisotropies off by up to 6.5e-4,
which is more than their noise, and 30 leave none."""

CONVERGED = 1e-7
"""Change of the anisotropies in one round below which the iteration ends. Chosen far below the accuracy to
which anisotropies are known, 1e-4 and more."""

PERSPECTIVE_RIDGE = 1e-12
"""Share of the normal matrix's trace that is added to its diagonal. Markers that all lie in one place say
nothing about a perspective, and then leave it at zero. Chosen above the rounding of double precision."""


@dataclass(frozen=True)
class Plane:
    """The plane of an image's markers; both numbers are zero for a camera that looks straight down.

    Attributes:
        anisotropy: α, the anisotropy at the image's centre.
        perspective: λ, 1/px; the horizon is the line λ̄·p = 1.
        shared: False where the markers do not lie as on one plane, so that each has its own anisotropy.
        covariance: (2, 2) of α and λ, for one of their two components each.
    """

    anisotropy: complex = 0j
    perspective: complex = 0j
    shared: bool = True
    covariance: ComplexArray = field(default_factory=lambda: np.zeros((2, 2), dtype=complex), compare=False)

    def anisotropies(self, points: ComplexArray) -> ComplexArray:
        """Return the anisotropies ε (N,) of markers at image points (N,), px from the image's centre."""
        a, h = self.anisotropy, self.perspective
        top = a * (1 - points * np.conj(h) / 2) - points * h / 2
        return np.asarray(top / (1 - points.conj() * h / 2 - points.conj() * np.conj(h) * a / 2))

    def variances(self, points: ComplexArray) -> Array:
        """Return the variances (N,) of each component of the anisotropies at image points (N,)."""
        design = anisotropy_design_matrix(points)
        return np.asarray(((design @ self.covariance) * design.conj()).sum(axis=1).real)

    def perspectives(self, points: ComplexArray) -> ComplexArray:
        """Return the perspectives h (N,), 1/px, of markers at image points (N,): `λ / (1 - λ·p)`."""
        return np.asarray(self.perspective / (1 - (np.conj(self.perspective) * points).real))


def anisotropy_design_matrix(points: ComplexArray) -> ComplexArray:
    """Return the columns (N, 2) of α and λ in the anisotropies at image points (N,), to first order."""
    design = np.ones((points.size, 2), dtype=complex)
    design[:, 1] = -points / 2
    return design


def fit_plane(points: ComplexArray, anisotropies: ComplexArray, variances: Array) -> Plane:
    """Return the simplest plane that explains the anisotropies of most markers, (N,), at image points (N,).

    Some markers may lie on something else or be covered in part. While no plane explains the rest, the tenth
    of them that lies farthest off is left out. If none explains
    `MIN_SHARE_ON_PLANE` of the markers, the result has `shared` False. Arguments are those of
    `fit_plane_to_all`.
    """
    kept = np.flatnonzero(np.isfinite(variances))
    least = max(math.ceil(MIN_SHARE_ON_PLANE * kept.size), MIN_MARKERS_ON_PLANE)
    first = plane = fit_plane_to_all(points, anisotropies, variances)
    while not plane.shared and kept.size > least:
        off = np.abs(anisotropies - plane.anisotropies(points))[kept] ** 2 / variances[kept]
        kept = kept[np.argsort(off)[: max(least, kept.size - math.ceil(kept.size / 10))]]
        plane = fit_plane_to_all(points[kept], anisotropies[kept], variances[kept])
    return plane if plane.shared else first


def fit_plane_to_all(points: ComplexArray, anisotropies: ComplexArray, variances: Array) -> Plane:
    """Return the simplest plane that explains all anisotropies (N,) observed at image points (N,).

    Three hypotheses are compared: a camera that looks straight down (no unknowns), one anisotropy common to
    all (α), and a tilted plane (α and λ). The next one is accepted where the chi-squared falls by more than
    `SIGNIFICANT`. If more than `EXCESS` of it a degree of freedom is left in the end, no plane explains the
    anisotropies, and the result has `shared` False.

    Args:
        points: (N,) centres of the markers, px from the image's centre.
        anisotropies: (N,) anisotropies in image axes.
        variances: (N,) of each of the anisotropies' two components; infinite for markers without information.
            Errors that they leave out are estimated from the fit itself.
    """
    if not np.isfinite(variances).any():
        return Plane()
    limits = np.array([SIGNIFICANT, EXCESS, CONVERGED, PERSPECTIVE_RIDGE])
    points, anisotropies = np.ascontiguousarray(points), np.ascontiguousarray(anisotropies)
    given = points, anisotropies, np.ascontiguousarray(variances)
    return Plane(*library().fit_plane(*given, limits, MAX_ROUNDS))
