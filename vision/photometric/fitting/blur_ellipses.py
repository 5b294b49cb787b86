"""Blur that differs along its directions, in the coordinates of markers: of a steep tilt, or of a streak.

Blur of the image's covariance S is `A⁻¹ S A⁻ᵀ` in the coordinates of a marker that the image shows by the
affine map A. With complex numbers, A z = m z + k z̄, and S of mean variance σ² and a part without trace,
Q = (S_uu - S_vv) / 2 + i S_uv, the blur of z has

    E z² = (2 m̄² Q + 2 k² Q̄ - 4 m̄ k σ²) / D²,   E |z|² = (2 (|m|² + |k|²) σ² - 4 Re(m̄ k̄ Q)) / D²,

with D = |m|² - |k|². An image taken while the camera moves straight by L px in the direction φ has
`Q = L² / 24 e^{2iφ}`.
"""

import numpy as np

from skyherd.geometry import Array, BoolArray, ComplexArray
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies

STEEP_ANISOTROPY = 0.1
"""Anisotropy from which on a marker's blur is drawn as an ellipse and not as what an anisotropy changes of
round blur to first order. Derived: the second order is half of the square of twice the anisotropy, 2 % of the
blur's part of the image here; it is that of a tilt of 35 degrees."""

MIN_VARIANCE_PX2 = 0.25**2
"""Variance that is left of a blur across a streak, at least. Chosen: a little less than that of a square
pixel, 1/12."""


def is_steep(homographies: LocalHomographies) -> BoolArray:
    """Return which of N markers are so anisotropic that their blur is to be drawn as an ellipse."""
    return np.asarray(
        np.abs(homographies.anisotropies) > STEEP_ANISOTROPY * np.abs(homographies.similarities)
    )


def possible_streaks(streak_px2: complex, sigmas_px: Array) -> ComplexArray:
    """Return the streaks (N,) that images of blurs (N,), px, can have: no more than leaves some blur across.

    Args:
        streak_px2: Q of the image, px².
        sigmas_px: (N,) roots of the mean variances of the whole blurs.
    """
    most = np.maximum(sigmas_px**2 - MIN_VARIANCE_PX2, 0.0)
    return np.asarray(streak_px2 * np.minimum(1.0, most / max(abs(streak_px2), 1e-12)))


def blur_tables(homographies: LocalHomographies, sigmas: Array, streak_px2: complex) -> Array:
    """Return the blurs of N markers in their coordinates, (N, 6), in sides squared.

    Args:
        homographies: of the markers.
        sigmas: (N,) roots of the mean variances, in sides, as of `LocalHomographies.blurs`.
        streak_px2: Q of the image, px²; it is cut where a blur has no room for it (`possible_streaks`).

    Returns:
        Variances along x and y and covariance, and by how much each changes with the logarithm of `sigmas`.
    """
    sigmas_px = sigmas / homographies.blurs(1.0)
    squares = sigmas**2
    round_table = _table(-2 * squares * homographies.blur_anisotropies(), squares)
    streaks = possible_streaks(streak_px2, sigmas_px)
    return np.hstack([round_table + _table(*_moments(homographies, streaks)), 2 * round_table])


def second_derivative_maps(homographies: LocalHomographies) -> Array:
    """Return how T_xx, T_xy and T_yy of N markers make up the derivatives of T by the parts of Q, (N, 3, 2).

    A change dS of the blur changes T by `(dS_xx T_xx + dS_yy T_yy) / 2 + dS_xy T_xy`, in sides.
    """
    ones = np.ones(len(homographies), dtype=complex)
    tables = np.stack([_table(*_moments(homographies, part * ones)) for part in (1, 1j)], axis=-1)
    return np.asarray(tables[:, [0, 2, 1]] * np.array([0.5, 1.0, 0.5])[:, None])


def _moments(homographies: LocalHomographies, streaks: ComplexArray) -> tuple[ComplexArray, Array]:
    """Return halves of E z² (N,) and E |z|² (N,) that streaks Q (N,), px², add in marker coordinates."""
    m, k, areas = homographies.similarities, homographies.anisotropies, homographies.sides_px() ** 2
    squared = (m.conj() ** 2 * streaks + k**2 * streaks.conj()) / areas**2
    return squared, -2 * (m.conj() * k.conj() * streaks).real / areas**2


def _table(half_squared: ComplexArray, half_absolute: Array) -> Array:
    """Return variances along x and y, and covariance, (N, 3), of half of E z² and of E |z|²."""
    return np.stack(
        [half_absolute + half_squared.real, half_absolute - half_squared.real, half_squared.imag], axis=1
    )
