"""The least-squares fit of a plane to anisotropies, and the choice of the simplest one (`fitting.plane`)."""

from typing import Any

import numpy as np
from numba import boolean, complex128, float64, int64, njit
from numba.core.types import Tuple

from skyherd.jobs.compilation import FLAGS, PARTS, readonly

_POINTS, _VARIANCES = readonly(complex128, 1), readonly(float64, 1)


@njit(**PARTS)
def _chi_squared(a: Any, h: Any, points: Any, anisotropies: Any, variances: Any) -> Any:
    """Return the sum of the squared residuals of anisotropies from a plane α, λ, over their variances."""
    total = 0.0
    for row in range(points.size):
        p = points[row]
        top = a * (1 - p * h.conjugate() / 2) - p * h / 2
        off = anisotropies[row] - top / (1 - p.conjugate() * h / 2 - p.conjugate() * h.conjugate() * a / 2)
        total += (off.real**2 + off.imag**2) / variances[row]
    return total


@njit(**PARTS)
def _normal_matrix(points: Any, variances: Any, ridge: Any) -> Any:
    """Elements αα, αλ and λλ of the normal matrix of the columns 1 and -p / 2, with a ridge."""
    aa, ah, hh = 0.0, 0j, 0.0
    for row in range(points.size):
        p, weight = points[row], 1 / variances[row]
        aa += weight
        ah -= weight * p / 2
        hh += weight * (p.real**2 + p.imag**2) / 4
    raised = ridge * (aa + hh)
    return aa + raised, ah, hh + raised


@njit(**PARTS)
def _copy(matrix: Any, into: Any) -> None:
    """Copy a (2, 2) matrix; NumPy's way to say so takes four seconds to compile."""
    for i in range(2):
        for j in range(2):
            into[i, j] = matrix[i, j]


@njit(**PARTS)
def _solve(
    points: Any, anisotropies: Any, variances: Any, tilted: Any, covariance: Any, limits: Any, max_rounds: Any
) -> Any:
    """Return the plane α, λ, with λ free if `tilted`; zero where the iteration diverges."""
    aa, ah, hh = _normal_matrix(points, variances, limits[3])
    covariance[:] = 0
    if tilted:
        determinant = aa * hh - (ah.real**2 + ah.imag**2)
        covariance[0, 0], covariance[1, 1] = hh / determinant, aa / determinant
        covariance[0, 1], covariance[1, 0] = -ah / determinant, -ah.conjugate() / determinant
    else:
        covariance[0, 0] = 1 / aa
    farthest_px = 0.0
    for row in range(points.size):
        farthest_px = max(farthest_px, abs(points[row]))
    a, h = 0j, 0j
    for _ in range(max_rounds):
        right_a, right_h = 0j, 0j
        for row in range(points.size):
            p, e = points[row], anisotropies[row]
            second = (a * p * h.conjugate() - e * p.conjugate() * (h + h.conjugate() * a)) / 2
            weighted = (e + second) / variances[row]
            right_a += weighted
            right_h -= weighted * p.conjugate() / 2
        new_a = covariance[0, 0] * right_a + covariance[0, 1] * right_h
        new_h = covariance[1, 0] * right_a + covariance[1, 1] * right_h
        change = abs(new_a - a) + abs(new_h - h) * farthest_px
        a, h = new_a, new_h
        if abs(a) > 1 or abs(h) * farthest_px > 1:
            covariance[:] = 0
            return 0j, 0j
        if change < limits[2]:
            break
    return a, h


@njit(
    Tuple((complex128, complex128, boolean))(
        _POINTS, _POINTS, _VARIANCES, readonly(float64, 1), int64, complex128[:, ::1]
    ),
    **FLAGS,
)
def fit_plane_to_all(
    points: Any, anisotropies: Any, variances: Any, limits: Any, max_rounds: Any, covariance: Any
) -> Any:
    """Return α, λ of the simplest plane and whether it explains the anisotropies; see `plane`.

    Args:
        points: (N,) centres of the markers, px from the image's centre.
        anisotropies: (N,) in image axes.
        variances: (N,) of each of the anisotropies' components, of which one at least is finite.
        limits: (4,) `SIGNIFICANT`, `EXCESS`, `CONVERGED` and `PERSPECTIVE_RIDGE` of `plane`.
        max_rounds: most rounds of the iteration.
        covariance: (2, 2) result: of α and λ.
    """
    significant, excess = limits[0], limits[1]
    freedom = 2 * points.size
    best_a, best_h = 0j, 0j
    covariance[:] = 0
    least = _chi_squared(best_a, best_h, points, anisotropies, variances)
    per_freedom = least / freedom
    aa, ah, hh = _normal_matrix(points, variances, limits[3])
    a, h = 0j, 0j
    for row in range(points.size):
        weighted = anisotropies[row] / variances[row]
        a += weighted
        h -= weighted * points[row].conjugate() / 2
    cross = 2 * (a.conjugate() * ah * h).real
    fall = (a.real**2 + a.imag**2) * hh + (h.real**2 + h.imag**2) * aa - cross
    if fall / (aa * hh - (ah.real**2 + ah.imag**2)) <= significant:
        return best_a, best_h, per_freedom <= excess
    own = np.empty((2, 2), dtype=np.complex128)
    for unknowns in (2, 4):
        if freedom <= unknowns:
            break
        a, h = _solve(points, anisotropies, variances, unknowns == 4, own, limits, max_rounds)
        chi_squared = _chi_squared(a, h, points, anisotropies, variances)
        scatter = max(chi_squared / (freedom - unknowns), 1.0)
        if least - chi_squared > significant * scatter:
            best_a, best_h, least, per_freedom = a, h, chi_squared, scatter
            _copy(own, covariance)
    return best_a, best_h, per_freedom <= excess
