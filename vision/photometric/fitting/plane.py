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
each marker keeps its own. The perspective of a marker at p is `h = λ / (1 - λ̄·p)`.

Three hypotheses are compared (`vision/native/plane_fit.c`): a camera that looks straight down (no
unknowns), one anisotropy common to all (α), and a tilted plane (α and λ). The next one is accepted where the
chi-squared falls by more than `SIGNIFICANT`. If more than `EXCESS` of it a degree of freedom is left in the
end, no plane explains the anisotropies. Some markers may lie on something else or be covered in part. If a
plane of most markers is enough, the tenth of them that lies farthest off is left out until a plane explains
the rest, of which `MIN_SHARE_ON_PLANE` must remain.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from skyherd.geometry import ComplexArray
from skyherd.vision.native.records import PLANE, PlaneLimits

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

    @classmethod
    def of_record(cls, record: npt.NDArray[np.void]) -> "Plane":
        """Return the plane of a record (1,) of `PLANE`."""
        anisotropy, perspective, covariance, shared = record[0].tolist()
        return cls(anisotropy, perspective, bool(shared), np.array(covariance))

    def record(self) -> npt.NDArray[np.void]:
        """Return the plane as a record (1,) of `PLANE`."""
        return np.array([(self.anisotropy, self.perspective, self.covariance, self.shared)], dtype=PLANE)

    def scaled(self, factor: float) -> "Plane":
        """Return the plane in an image enlarged by a factor: its perspective is a reciprocal length."""
        units = np.array([1.0, 1 / factor])
        return replace(
            self, perspective=self.perspective / factor, covariance=self.covariance * np.outer(units, units)
        )

    def anisotropies(self, points: ComplexArray) -> ComplexArray:
        """Return the anisotropies ε (N,) of markers at image points (N,), px from the image's centre."""
        a, h = self.anisotropy, self.perspective
        top = a * (1 - points * np.conj(h) / 2) - points * h / 2
        return np.asarray(top / (1 - points.conj() * h / 2 - points.conj() * np.conj(h) * a / 2))


def anisotropy_design_matrix(points: ComplexArray) -> ComplexArray:
    """Return the columns (N, 2) of α and λ in the anisotropies at image points (N,), to first order."""
    design = np.ones((points.size, 2), dtype=complex)
    design[:, 1] = -points / 2
    return design


def plane_limits() -> PlaneLimits:
    """Return the limits of a plane for the compiled library."""
    return PlaneLimits(
        significant=SIGNIFICANT,
        excess=EXCESS,
        converged=CONVERGED,
        ridge=PERSPECTIVE_RIDGE,
        min_share=MIN_SHARE_ON_PLANE,
        min_markers=MIN_MARKERS_ON_PLANE,
        max_rounds=MAX_ROUNDS,
    )
