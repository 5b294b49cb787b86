"""The plane that the markers of an image share, from how each of them is squeezed.

Seen by a camera whose pixels are oblong or whose axis is tilted, squares become parallelograms that shrink
towards the horizon. With image points p = u + iv from the image's centre, the plane's map to the image is,
but for a similarity, `p = A q / (1 + l·q)` with A squeezing by α; a marker at p is then squeezed by

    ε(p) = (α (1 - p λ̄ / 2) - p λ / 2) / (1 - p̄ λ / 2 - p̄ λ̄ α / 2) ≈ α - p λ / 2,

with the line λ̄·p = 1 as horizon. α and λ are all that a tilt, an aspect and a skew do to a marker, whatever
the camera is; no focal length enters.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.geometry import Array, ComplexArray

SIGNIFICANT = 14.0
"""Fall of a chi-squared by which two more unknowns must earn their place: chance has it once in 1000."""

EXCESS = 6.0
"""Chi-squared a degree of freedom beyond which markers do not lie on one plane. Texture that blurs into small
cards may double it."""

ROUNDS, SOLVED = 8, 1e-7
"""Each round leaves half of |λ p| or less of what the one before did: 0.1 at a tilt of 15 degrees."""

DIAGONAL = ([0, 1], [0, 1])


@dataclass(frozen=True)
class Plane:
    """Squeeze α at the image's centre, and horizon λ, 1/px; both zero for a camera that looks straight down.

    `shared` is false where markers do not lie as on one plane: each is then squeezed in its own way.
    `covariance` (2, 2) is that of α and λ, for one of their two components.
    """

    squeeze: complex = 0j
    horizon: complex = 0j
    shared: bool = True
    covariance: ComplexArray = field(default_factory=lambda: np.zeros((2, 2), dtype=complex), compare=False)

    def squeezes(self, points: ComplexArray) -> ComplexArray:
        """ε (N,) of markers at image points (N,) from the image's centre."""
        a, h = self.squeeze, self.horizon
        top = a * (1 - points * np.conj(h) / 2) - points * h / 2
        return np.asarray(top / (1 - points.conj() * h / 2 - points.conj() * np.conj(h) * a / 2))

    def variances(self, points: ComplexArray) -> Array:
        """Variances (N,) of each component of the squeezes at image points (N,), by how α and λ are known."""
        columns = _columns(points)
        return np.asarray(np.einsum("ni,ij,nj->n", columns, self.covariance, columns.conj()).real)

    def horizons(self, points: ComplexArray) -> ComplexArray:
        """Horizons h (N,) of `Shapes` for markers at image points (N,): `λ / (1 - λ·p)`."""
        return np.asarray(self.horizon / (1 - (np.conj(self.horizon) * points).real))


def fit_plane(points: ComplexArray, squeezes: ComplexArray, variances: Array) -> Plane:
    """The simplest plane that explains the squeezes (N,) seen at image points (N,).

    A camera that looks straight down is given up for one squeeze common to all, and that for a tilted plane,
    where the chi-squared falls by more than `SIGNIFICANT`; if more than `EXCESS` of it a degree of freedom
    is left, no plane explains the squeezes and each marker is squeezed in its own way. `variances` (N,) are
    those of each of the squeezes' two components, infinite for markers that tell nothing; what they leave out
    is taken from the fit itself.
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
    """By how much the chi-squared falls, to first order, with both α and λ."""
    weighted, normal = _normal_equations(points, variances)
    (a, h), ((aa, ah), (_, hh)) = (weighted @ squeezes).tolist(), normal.tolist()
    fall = abs(a) ** 2 * hh.real + abs(h) ** 2 * aa.real - 2 * (a.conjugate() * ah * h).real
    return float(fall / (aa.real * hh.real - abs(ah) ** 2))


def _normal_equations(points: ComplexArray, variances: Array) -> tuple[ComplexArray, ComplexArray]:
    """Weighted columns (2, N) of α and λ, and their normal matrix (2, 2)."""
    columns = _columns(points)
    weighted = columns.conj().T / variances
    normal = weighted @ columns
    # Markers in one place tell no horizon: a grain of ridge keeps it at zero.
    normal[DIAGONAL] += 1e-12 * (normal[0, 0].real + normal[1, 1].real)
    return weighted, normal


def _solve(points: ComplexArray, squeezes: ComplexArray, variances: Array, *, tilted: bool) -> Plane:
    """Weighted least squares in α, and in λ if `tilted`; second-order terms are the last round's."""
    unknowns = 1 + tilted
    weighted, normal = _normal_equations(points, variances)
    covariance = np.zeros((2, 2), dtype=complex)
    covariance[:unknowns, :unknowns] = np.linalg.inv(normal[:unknowns, :unknowns])
    plane = Plane()
    for _ in range(ROUNDS):
        a, h = plane.squeeze, plane.horizon
        second = (a * points * np.conj(h) - squeezes * points.conj() * (h + np.conj(h) * a)) / 2
        solution = covariance @ (weighted @ (squeezes + second))
        plane = Plane(complex(solution[0]), complex(solution[1]))
        if abs(plane.squeeze) > 1 or abs(plane.horizon) * np.abs(points).max() > 1:
            # Turned over, or a horizon among the markers: no camera sees a plane so.
            return Plane()
        if abs(plane.squeeze - a) + abs(plane.horizon - h) * np.abs(points).max() < SOLVED:
            break
    return replace(plane, covariance=covariance)


def _columns(points: ComplexArray) -> ComplexArray:
    """What α and λ do to the squeezes at image points (N,), to first order: (N, 2)."""
    columns = np.ones((points.size, 2), dtype=complex)
    columns[:, 1] = -points / 2
    return columns
