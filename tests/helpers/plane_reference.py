"""The fit of a plane in NumPy, the reference for the compiled one."""

import math
from dataclasses import replace

import numpy as np

from skyherd.geometry import Array, ComplexArray
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import (
    CONVERGED,
    EXCESS,
    MAX_ROUNDS,
    MIN_MARKERS_ON_PLANE,
    MIN_SHARE_ON_PLANE,
    PERSPECTIVE_RIDGE,
    SIGNIFICANT,
    Plane,
    anisotropy_design_matrix,
)


def perspectives_at(plane: Plane, points: ComplexArray) -> ComplexArray:
    """Return the perspectives h (N,), 1/px, of markers at image points (N,): `λ / (1 - λ·p)`."""
    return np.asarray(plane.perspective / (1 - (np.conj(plane.perspective) * points).real))


def on_plane(homographies: LocalHomographies, plane: Plane, middle: complex) -> LocalHomographies:
    """Return homographies with the perspectives of a plane, if it is shared."""
    if not plane.shared:
        return homographies
    return replace(homographies, perspectives=perspectives_at(plane, homographies.centers - middle))


def variances_at(plane: Plane, points: ComplexArray) -> Array:
    """Return the variances (N,) of each component of the anisotropies at image points (N,)."""
    design = anisotropy_design_matrix(points)
    return np.asarray(((design @ plane.covariance) * design.conj()).sum(axis=1).real)


def fit_plane_to_all(points: ComplexArray, anisotropies: ComplexArray, variances: Array) -> Plane:
    """Return the plane of `fit_plane` in `plane_fit.c` if all markers must lie on it."""
    if not np.isfinite(variances).any():
        return Plane()
    best, least = Plane(), _chi_squared(Plane(), points, anisotropies, variances)
    per_freedom = least / (2 * points.size)
    if _linear_fall(points, anisotropies, variances) <= SIGNIFICANT:
        return replace(best, shared=per_freedom <= EXCESS)
    for unknowns in (2, 4):
        if 2 * points.size <= unknowns:
            break
        plane = _solve(points, anisotropies, variances, tilted=unknowns == 4)
        chi_squared = _chi_squared(plane, points, anisotropies, variances)
        excess = max(chi_squared / (2 * points.size - unknowns), 1.0)
        if least - chi_squared > SIGNIFICANT * excess:
            best, least, per_freedom = plane, chi_squared, excess
    return replace(best, shared=per_freedom <= EXCESS)


def fit_plane(points: ComplexArray, anisotropies: ComplexArray, variances: Array) -> Plane:
    """Return the plane of `fit_plane` in `plane_fit.c` if most markers are enough."""
    kept = np.flatnonzero(np.isfinite(variances))
    least = max(math.ceil(MIN_SHARE_ON_PLANE * kept.size), MIN_MARKERS_ON_PLANE)
    first = plane = fit_plane_to_all(points, anisotropies, variances)
    while not plane.shared and kept.size > least:
        off = np.abs(anisotropies - plane.anisotropies(points))[kept] ** 2 / variances[kept]
        kept = kept[np.argsort(off)[: max(least, kept.size - math.ceil(kept.size / 10))]]
        plane = fit_plane_to_all(points[kept], anisotropies[kept], variances[kept])
    return plane if plane.shared else first


def _chi_squared(plane: Plane, points: ComplexArray, anisotropies: ComplexArray, variances: Array) -> float:
    return float(np.sum(np.abs(anisotropies - plane.anisotropies(points)) ** 2 / variances))


def _linear_fall(points: ComplexArray, anisotropies: ComplexArray, variances: Array) -> float:
    """Return the first-order decrease of the chi-squared with both α and λ."""
    weighted, normal = _normal_equations(points, variances)
    (a, h), ((aa, ah), (_, hh)) = (weighted @ anisotropies).tolist(), normal.tolist()
    fall = abs(a) ** 2 * hh.real + abs(h) ** 2 * aa.real - 2 * (a.conjugate() * ah * h).real
    return float(fall / (aa.real * hh.real - abs(ah) ** 2))


def _normal_equations(points: ComplexArray, variances: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return the weighted columns (2, N) of α and λ, and their normal matrix (2, 2)."""
    design = anisotropy_design_matrix(points)
    weighted = design.conj().T / variances
    normal = weighted @ design
    diagonal = np.arange(2)
    normal[diagonal, diagonal] += PERSPECTIVE_RIDGE * (normal[0, 0].real + normal[1, 1].real)
    return weighted, normal


def _solve(points: ComplexArray, anisotropies: ComplexArray, variances: Array, *, tilted: bool) -> Plane:
    """Solve least squares in α, and in λ if `tilted`; second-order terms are those of the last round."""
    unknowns = 1 + tilted
    weighted, normal = _normal_equations(points, variances)
    covariance = np.zeros((2, 2), dtype=complex)
    covariance[:unknowns, :unknowns] = np.linalg.inv(normal[:unknowns, :unknowns])
    plane = Plane()
    for _ in range(MAX_ROUNDS):
        a, h = plane.anisotropy, plane.perspective
        second = (a * points * np.conj(h) - anisotropies * points.conj() * (h + np.conj(h) * a)) / 2
        solution = covariance @ (weighted @ (anisotropies + second))
        plane = Plane(complex(solution[0]), complex(solution[1]))
        if abs(plane.anisotropy) > 1 or abs(plane.perspective) * np.abs(points).max() > 1:
            # Mirrored, or with a horizon among the markers: no camera sees a plane like this.
            return Plane()
        if abs(plane.anisotropy - a) + abs(plane.perspective - h) * np.abs(points).max() < CONVERGED:
            break
    return replace(plane, covariance=covariance)
