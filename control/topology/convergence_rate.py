"""Convergence rate of a topology: the linearised rate of the paper's law, from the template alone.

With Algorithm 1 the goals of unit j are linear in the image points: `rho = -(I - P_j) p`. P_j projects onto
`span{1, p'}` over the robots of S_j^c. Summed over units, and without speed limits,

    dp/dt = -k L p,    L = Σ_j (I - P_j).

This keeps similarities of the template (eigenvalue 0, twice) and damps all other modes, the slowest one at
the rate `k λ_3(L)`. Robots are unicycles, but turning is fast in comparison.
"""

from collections.abc import Iterable

import numpy as np

from skyherd.geometry import Array, ComplexArray, IntArray
from skyherd.messages.checks import check_vectors


def laplacian(points: ComplexArray, sets: Iterable[IntArray]) -> ComplexArray:
    """Return L (N, N) for template points (N,) and sets of rows; sets of fewer than two are ignored."""
    check_vectors("laplacian", points=points)
    matrix = np.zeros((points.size, points.size), dtype=np.complex128)
    for rows in sets:
        check_vectors("laplacian", sets=rows)
        if rows.size < 2:
            continue
        basis = np.stack(
            [np.ones(rows.size, dtype=np.complex128), points[rows] - points[rows].mean()], axis=1
        )
        basis /= np.linalg.norm(basis, axis=0)
        matrix[np.ix_(rows, rows)] += np.eye(rows.size) - basis @ basis.conj().T
    return matrix


def slowest_rate(points: ComplexArray, sets: Iterable[IntArray]) -> float:
    """Return λ_3(L), the rate of the slowest mode in units of the gain k; 0 if the shape is undetermined."""
    check_vectors("slowest_rate", points=points)
    if points.size < 3:
        return 1.0
    return max(float(np.linalg.eigvalsh(laplacian(points, sets))[2]), 0.0)


def pair_rates(points: ComplexArray, fixed: IntArray, moving: IntArray, pairs: IntArray) -> Array:
    """Return the rates (C,) at which two units agree if they share each of the candidate pairs (C, 2).

    For two sets that share two robots the slowest mode of L has the closed form

        λ = 1 - sqrt(ρ(N_j N_k)),    N = I - (P restricted to the pair),

    since eigenvalues of a sum of two projectors are `1 ± cos θ` of their principal angles. P restricted to
    the pair is its 2 x 2 block of the fit's hat matrix, `1/n + z_a conj(z_b) / Σ|z|²`. It is the pair's
    *leverage* in each unit's fit.

    Args:
        points: (N,) template points of all robots.
        fixed: rows of the neighbour's set, which contains every pair.
        moving: rows of the deciding unit's set without its pair; a pair is added to it.
        pairs: (C, 2) rows.
    """
    theirs = _complements(points, fixed, pairs, 0)
    ours = _complements(points, moving, pairs, 2)
    product = theirs @ ours
    half_trace = np.einsum("cii->c", product).real / 2
    determinant = np.linalg.det(product).real
    # Larger eigenvalue of a 2 x 2 matrix: tr / 2 + sqrt((tr / 2)² - det).
    radius = half_trace + np.sqrt(np.maximum(half_trace**2 - determinant, 0.0))
    return np.asarray(1 - np.sqrt(np.clip(radius, 0.0, 1.0)))


def _complements(points: ComplexArray, rows: IntArray, pairs: IntArray, joining: int) -> ComplexArray:
    """Return N (C, 2, 2) of each pair in the fit of the robots `rows`.

    `joining` is 2 if the pair is added to the rows, and 0 if the rows contain it.
    """
    origin = points[pairs].mean()  # near the points, so that sums of squares keep their digits
    z, z_pair = points[rows] - origin, points[pairs] - origin
    count = rows.size + joining
    total, squares = z.sum(), np.vdot(z, z).real
    if joining:
        total = total + z_pair.sum(axis=1)
        squares = squares + (np.abs(z_pair) ** 2).sum(axis=1)
    mean = np.broadcast_to(total / count, len(pairs))
    spread = squares - count * np.abs(mean) ** 2
    centred = z_pair - mean[:, None]
    safe = np.where(spread > 0, spread, 1.0)
    hat = 1 / count + centred[:, :, None] * centred[:, None, :].conj() / safe[..., None, None]
    return np.asarray(np.eye(2) - hat)
