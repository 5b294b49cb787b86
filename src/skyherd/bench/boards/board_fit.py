r"""Fit of a board to one detector's result in one image, and leave-one-out residuals.

A homography maps the board to points q of the image. Polynomials of q in u and in v, of one degree for both,
model the lens: with degree 3, radial distortion k1 and tangential distortion. The remaining error of the
observed corners is linear in the polynomials' coefficients, so that leaving a marker out needs no new fit.
With the hat matrix H of least squares and the residuals e of all corners, the residuals of marker m against
the fit to all others are (I - H_mm)^-1 e_m. For noise of variance σ² they have the covariance
σ² (I - H_mm)^-1. Standardised residuals, (I - H_mm)^-1/2 e_m, have variance σ² again, both for noise of
corners and of the whole marker. They are reported: the error of the detector without that of the fit.

Outliers, markers far from the prediction of the others, are excluded from the fit and evaluated against it.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from skyherd.bench.photographs.sightings import Sightings
from skyherd.geometry import MEDIAN_PER_SIGMA, Array, BoolArray, IntArray, apply_homography
from skyherd.markers.dictionary import pose_of_corners

RANSAC_SIDES = 0.25
"""Inlier distance of a corner to the first homography, in marker sides. Chosen: a wrong id is off by at least
a side; a lens bends the board by less."""

OUTLIER_SIGMAS = 8.0
"""Residual, in robust standard deviations, above which a marker is an outlier. Chosen: far above any noise,
so that merely inaccurate markers stay."""

ROUNDS = 3
"""Number of fits, each without the outliers of the previous one."""

SPARE_MARKERS = 2
"""Markers needed beyond those whose corners equal the number of polynomial terms."""

MAX_LEVERAGE = 0.95
"""Largest eigenvalue of H_mm at which a marker is evaluated; above it, the others barely determine its
position."""

STEP = 1e-3
"""Step of the finite differences of a fit's derivatives, in marker sides. Chosen: the map is smooth over many
sides, so that the error is of the order of the step's square, and that of rounding 1e-10."""


@dataclass(frozen=True)
class BoardFit:
    """A board in an image, as one detector saw it.

    Attributes:
        ids: (M,) of the markers, each once.
        rows: (M,) their rows in arrays of the board's markers.
        residuals_px: (M, 4, 2) observed corners less the homography of the nominal ones.
        jacobians: (M, 4, 2, 2) of homography and lens: px per marker side on the board.
        predicted_px: (M, 4, 2) the homography of the nominal corners.
        basis: (M, 4, P) the polynomials at the corners, orthonormal over the fitted markers.
        fitted: (M,) True for markers that take part in the fit.
        covariances: (M, 3, 3) that the detector reports.
    """

    ids: IntArray
    rows: IntArray
    residuals_px: Array
    jacobians: Array
    predicted_px: Array
    basis: Array
    fitted: BoolArray
    covariances: Array

    def raw(self, board_error: Array | None = None) -> Array:
        """Return the residuals (M, 4, 2), px, of the fit to all fitted markers.

        Args:
            board_error: (K, 4, 2) displacement of the corners on the board, in marker sides.
        """
        left = self.residuals_px
        if board_error is not None:
            left = left - np.einsum("mcij,mcj->mci", self.jacobians, board_error[self.rows])
        basis = self.basis[self.fitted].reshape(-1, self.basis.shape[2])
        coefficients = basis.T @ left[self.fitted].reshape(-1, 2)
        return np.asarray(left - self.basis @ coefficients)

    def standardised(self, board_error: Array | None = None) -> Array:
        """Return standardised residuals (M, 4, 2), px, each marker against the fit to all others.

        They are NaN if the others do not determine the marker's position.
        """
        return np.asarray(self._whitening @ self.raw(board_error))

    def left_out(self) -> Array:
        """Return leave-one-out residuals (F, 4, 2), px, of the fitted markers.

        They include the errors of the fit to the others; NaN if the others do not determine the marker's
        position.
        """
        return np.asarray((self._whitening @ self._whitening @ self.raw())[self.fitted])

    @cached_property
    def _whitening(self) -> Array:
        """(I - H_mm)^-1/2 of fitted markers, (I + G_mm)^-1/2 of others, (M, 4, 4)."""
        values, vectors = np.linalg.eigh(self.basis @ self.basis.swapaxes(1, 2))
        signed = np.where(self.fitted[:, None], -values, values)
        scales = np.where(signed > -MAX_LEVERAGE, 1 + signed, np.nan) ** -0.5
        return np.asarray((vectors * scales[:, None]) @ vectors.swapaxes(1, 2))


def fit_board(corners: dict[int, Array], seen: Sightings, degree: int) -> BoardFit | None:
    """Fit a board to the detections in an image; None with too few, or without a board.

    Ids that are not on the board, or that were found several times, are left out.

    Args:
        corners: (4, 2) of each marker by id, in marker sides.
        seen: detections.
        degree: degree of the polynomials.
    """
    rows_of = {marker_id: row for row, marker_id in enumerate(corners)}
    ids, first, count = np.unique(seen.ids, return_index=True, return_counts=True)
    known = (count == 1) & np.isin(ids, list(rows_of))
    ids, first = ids[known], first[known]
    needed = -(-terms(degree) // 4) + SPARE_MARKERS
    if ids.size < needed:
        return None
    nominal = np.array([corners[int(marker_id)] for marker_id in ids])
    observed = seen.corners_px[first]
    side = float(np.median(pose_of_corners(observed)[2]))
    homography = _find_homography(nominal, observed, RANSAC_SIDES * side)
    if homography is None:
        return None
    predicted = apply_homography(homography, nominal)
    residuals = observed - predicted
    frame = _Frame.around(predicted)
    basis = frame.monomials(predicted, degree)
    fitted = np.hypot(*residuals.mean(axis=1).T) < side
    for _ in range(ROUNDS):
        if fitted.sum() < needed:
            return None
        _, upper = np.linalg.qr(basis[fitted].reshape(-1, basis.shape[2]))
        made = BoardFit(
            ids=ids,
            rows=np.array([rows_of[int(marker_id)] for marker_id in ids]),
            residuals_px=residuals,
            jacobians=np.zeros((*residuals.shape, 2)),
            predicted_px=predicted,
            basis=np.linalg.solve(upper.T, basis.reshape(-1, len(upper)).T).T.reshape(basis.shape),
            fitted=fitted,
            covariances=seen.covariances[first],
        )
        before, fitted = fitted, _inliers(made.standardised())
        if (before == fitted).all():
            break
    return replace(made, jacobians=_jacobians(homography, frame, basis, made, nominal, degree))


def _find_homography(nominal: Array, observed_px: Array, reach_px: float) -> Array | None:
    """Find the homography (3, 3) with most corners within the inlier distance; None without one."""
    found: Any = cv2.findHomography(nominal.reshape(-1, 2), observed_px.reshape(-1, 2), cv2.RANSAC, reach_px)[
        0
    ]
    return None if found is None else np.asarray(found, dtype=float)


def terms(degree: int) -> int:
    """Return the number of monomials in two variables up to a degree."""
    return (degree + 1) * (degree + 2) // 2


def robust_sigma(values: Array) -> float:
    """Return the standard deviation of zero-mean normal values of this median magnitude, without NaNs."""
    known = values[np.isfinite(values)]
    return float(np.median(np.abs(known)) / MEDIAN_PER_SIGMA) if known.size else float("nan")


def _inliers(standardised: Array) -> BoolArray:
    worst = np.nan_to_num(np.abs(standardised).max(axis=(1, 2)))
    return np.asarray(worst < OUTLIER_SIGMAS * robust_sigma(standardised))


@dataclass(frozen=True)
class _Frame:
    """Shift and scale that normalise the points of an image to the unit square about 0."""

    middle_px: Array
    reach_px: float

    @staticmethod
    def around(points_px: Array) -> "_Frame":
        low, high = points_px.min(axis=(0, 1)), points_px.max(axis=(0, 1))
        return _Frame((low + high) / 2, float((high - low).max()) / 2)

    def monomials(self, points_px: Array, degree: int) -> Array:
        """Return all monomials (..., P) up to a degree of points (..., 2)."""
        inside = ((points_px - self.middle_px) / self.reach_px)[..., None]
        ones = np.ones((*points_px.shape, 1))
        powers = np.concatenate([ones, *np.repeat(inside[None], degree, axis=0)], axis=-1).cumprod(axis=-1)
        orders = [(i, k - i) for k in range(degree + 1) for i in range(k + 1)]
        of_u, of_v = np.array(orders).T
        return np.asarray(powers[..., 0, of_u] * powers[..., 1, of_v])


def _jacobians(
    homography: Array,
    frame: _Frame,
    basis: Array,
    fit: BoardFit,
    nominal: Array,
    degree: int,
) -> Array:
    """Return derivatives (M, 4, 2, 2) of the images of board points (M, 4, 2), by central differences."""
    columns = basis.shape[2]
    known = basis[fit.fitted].reshape(-1, columns), fit.residuals_px[fit.fitted].reshape(-1, 2)
    coefficients = np.linalg.lstsq(*known, rcond=None)[0]
    shifts = STEP * np.concatenate([np.eye(2), -np.eye(2)])
    images = apply_homography(homography, nominal[..., None, :] + shifts)
    images = images + frame.monomials(images, degree) @ coefficients
    return np.asarray((images[..., :2, :] - images[..., 2:, :]).swapaxes(2, 3) / (2 * STEP))
