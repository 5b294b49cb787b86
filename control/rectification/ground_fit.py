"""Fit of the map to the ground to the squares of one image, given prior information on the camera.

The method is robust least squares by Gauss-Newton steps. The data of a square are its side, relative to an
unknown common side, and the two components of its anisotropy. Sides and anisotropies have separate noise
levels. Both are estimated from the residuals of the fit of all unknowns, since markers of different size or
height affect the sides alone. Outliers are down-weighted (an M-estimator). Insignificant unknowns are held at
zero (`skyherd.control.rectification.information`).
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from skyherd.control.rectification.ground_map import (
    ANISOTROPY,
    CAMERA,
    CENTER,
    FOCAL,
    LENS,
    PERSPECTIVE,
    UNKNOWNS,
    GroundMap,
    local_maps,
)
from skyherd.control.rectification.information import Information
from skyherd.control.rectification.square_shapes import Squares
from skyherd.geometry import Array

PRIOR: Array = np.array([0.1, 0.1, 0.2, 0.03, 0.03, 0.15, 0.15, 1.0, 0.2, 0.2])
"""Standard deviations (10,) of the unknowns over all cameras, in the order of `ground_map`. Chosen: they
include fisheyes, and tilts of 16 degrees at the usual focal length (|λ| = tan(tilt) / f)."""

CAMERA_PRIOR, TILT_PRIOR = (Information.prior(part) for part in (PRIOR[:CAMERA], PRIOR[CAMERA:]))
"""Information of `PRIOR` on the camera's unknowns (8,) and on the tilt of one image (2,)."""

GROUPS = {
    "anisotropy": ANISOTROPY,
    "tilt": [*PERSPECTIVE, *FOCAL],
    "lens": LENS[:1],
    "second lens": LENS[1:2],
    "third lens": LENS[2:],
    "center": CENTER,
}
"""Unknowns that are freed together, by name."""

AFTER = {"second lens": "lens", "third lens": "second lens", "center": "lens"}
"""Prerequisite group by name of a group: further lens coefficients and a centre require a lens."""

SIGNIFICANT = 20.0
"""Minimum decrease of the chi-squared that frees a group of unknowns. Derived: noise alone reaches it for two
unknowns once in 20 000 fits (e^{-20 / 2} = 4.5e-5)."""

OUTLIER = 3.0
"""Outlier threshold of a residual d, standard deviations; outliers are weighted by 1 / d². Chosen: one in 170
000 Gaussian residuals exceeds it (chi-squared of three, over 27)."""

ROUNDS, SETTLED = 5, 3e-4
"""Maximum number of Gauss-Newton steps, and change of a prediction that ends them. Derived: the remaining
error is about the square of a step, 1e-7, below any detector's accuracy."""

DIFFERENCE = 1e-6
"""Step of the numerical derivatives. Chosen: the error of a forward difference is about the step itself, and
rounding adds 1e-16 / 1e-6 = 1e-10."""

STEPS: Array = np.concatenate([np.zeros((1, UNKNOWNS)), DIFFERENCE * np.eye(UNKNOWNS)])
"""Steps (11, 10) for numerical derivatives: no step, and one of each unknown."""

LIMIT = 5.0
"""Gating threshold of the fit: maximum of an unknown, in standard deviations of `PRIOR`. Chosen: beyond any
camera; a fit outside the gate is of invalid squares and is rejected."""

MIN_VARIANCE_FACTOR = 1e-8
"""Minimum variance factor without reported covariances. Chosen: corners of 1e-5 px; it avoids a division by
zero for data without noise."""

MIN_DEVIATION = 1e-12
"""Minimum divisor for residuals, standard deviations. Chosen: it only avoids a division by zero."""

SIDES, ANISOTROPIES = 0, 1
"""Rows of the two kinds of data: logarithms of sides, and anisotropies."""


@dataclass(frozen=True)
class NoiseStatistics:
    """Residual statistics of the noise of the data, by kind: row `SIDES`, row `ANISOTROPIES`.

    Attributes:
        squares: (2,) sums of squared residuals over their variances.
        freedoms: (2,) their degrees of freedom.
    """

    squares: Array
    freedoms: Array

    def variance_factors(self, *, reported: bool) -> Array:
        """Return the ratios (2,) of estimated to assumed variances.

        They are at least 1 if the detector reported covariances, which are then the minimum noise.
        """
        return np.maximum(self.squares / self.freedoms, 1.0 if reported else MIN_VARIANCE_FACTOR)

    def accumulated(self, other: "NoiseStatistics", memory: float = 1.0) -> "NoiseStatistics":
        """Return these statistics, weighted by `memory`, plus those of another image."""
        return NoiseStatistics(memory * self.squares + other.squares, memory * self.freedoms + other.freedoms)


@dataclass(frozen=True)
class GroundFit:
    """Result of a fit to one image.

    Attributes:
        ground_map: the map, including the prior information on the camera.
        significant: indices of the unknowns that the data support.
        image: information on all unknowns from this image alone.
        noises: statistics of the residuals of this image alone.
    """

    ground_map: GroundMap
    significant: frozenset[int]
    image: Information
    noises: NoiseStatistics


@dataclass(frozen=True)
class _Linearization:
    """Data of N squares minus the predictions of the unknowns, to first order.

    Sides and anisotropies are rows of M = 2 N numbers each: an anisotropy has two, a side one and a zero.

    Attributes:
        at: (10,) values of the unknowns.
        residuals: (2, M) data minus predictions.
        jacobian: (2, M, 10) derivatives of the predictions.
        weights: (M,) inverse variances, lowered for outliers.
    """

    at: Array
    residuals: Array
    jacobian: Array
    weights: Array

    @classmethod
    def of(cls, squares: Squares, unknowns: Array, robust: Array) -> "_Linearization":
        """Linearize at given unknowns (10,), with robust weights (N,) of the squares."""
        maps = local_maps(unknowns + STEPS, squares.points)
        weights = robust / squares.variances
        shares = weights / weights.sum()
        # The common side is unknown: log sides count relative to their weighted mean.
        sides, scales = squares.log_sides, maps.log_scales()
        predicted, seen = np.zeros((2, 1 + UNKNOWNS, 2 * len(squares))), np.zeros((2, 2 * len(squares)))
        predicted[SIDES, :, ::2], seen[SIDES, ::2] = (
            scales - (scales @ shares)[:, None],
            sides - sides @ shares,
        )
        predicted[ANISOTROPIES], seen[ANISOTROPIES] = (
            maps.anisotropies().view(float),
            squares.anisotropies.view(float),
        )
        jacobian = (predicted[:, 1:] - predicted[:, :1]) / DIFFERENCE
        return cls(
            at=unknowns,
            residuals=seen - predicted[:, 0],
            jacobian=jacobian.transpose(0, 2, 1),
            weights=np.repeat(weights, 2),
        )

    def information(self) -> Information:
        """Return information on the unknowns, from sides and from anisotropies, for variance factors of 1."""
        weighted = self.jacobian.transpose(0, 2, 1) * self.weights
        vectors = weighted @ (self.residuals + self.jacobian @ self.at)[..., None]
        return Information(weighted @ self.jacobian, vectors[..., 0])

    def residuals_at(self, unknowns: Array) -> Array:
        """Return residuals (2, M) at other values (10,) of the unknowns."""
        return self.residuals - self.jacobian @ (unknowns - self.at)


def fit_ground(
    squares: Squares,
    *,
    camera: Information,
    start: Array,
    noises: NoiseStatistics,
    trusted: Collection[int],
) -> GroundFit | None:
    """Fit the map to the squares of one image; return None if the result is outside the gate `LIMIT`.

    Args:
        squares: of one image, at least one.
        camera: information on the camera's unknowns (8,).
        start: (10,) initial values of the unknowns.
        noises: statistics of the previous images.
        trusted: indices of the unknowns that may be freed if they are significant.
    """
    before = camera.joined(TILT_PRIOR)
    unknowns, robust = start, np.ones(len(squares))
    factors = noises.variance_factors(reported=squares.reported)
    for _ in range(ROUNDS):
        lines = _Linearization.of(squares, unknowns, robust)
        parts = lines.information()
        scaled = parts.scaled(1 / factors)
        full, covariance = (before + scaled.total()).estimate()
        here = _noise_statistics(lines, full, parts=scaled, covariance=covariance)
        factors = noises.accumulated(here).variance_factors(reported=squares.reported)
        image = parts.scaled(1 / factors).total()
        everything = before + image
        significant = everything.significant(GROUPS, after=AFTER, threshold=SIGNIFICANT)
        unknowns = everything.constrained_mean([k for k in significant if k in trusted])
        if not (np.abs(unknowns) < LIMIT * PRIOR).all():
            return None
        if np.abs(lines.jacobian @ (unknowns - lines.at)).max() < SETTLED:
            break
        robust = _robust_weights(lines.residuals_at(full), squares.variances, factors)
    # With a real camera an unknown held at zero is still uncertain.
    covariance = everything.estimate().covariance if unknowns.any() else np.zeros((UNKNOWNS, UNKNOWNS))
    return GroundFit(
        ground_map=GroundMap(unknowns, covariance),
        significant=frozenset(significant),
        image=image,
        noises=here,
    )


def _noise_statistics(
    lines: _Linearization, full: Array, *, parts: Information, covariance: Array
) -> NoiseStatistics:
    """Return squared residuals at the estimate (10,) with all unknowns free, and their degrees of freedom.

    A kind of data with information Λ uses tr(Λ C) degrees of freedom for an estimate with covariance C.
    """
    squares = (lines.residuals_at(full) ** 2 * lines.weights).sum(axis=1)
    numbers = np.array([lines.weights.size / 2 - 1, lines.weights.size])
    fitted = (parts.matrix * covariance).sum(axis=(1, 2))
    return NoiseStatistics(squares, np.maximum(numbers - fitted, 0.0))


def _robust_weights(residuals: Array, variances: Array, factors: Array) -> Array:
    """Return outlier weights (N,), at most 1, for residuals (2, M): `(OUTLIER / d)²` for large d."""
    squares = (residuals**2).reshape(2, -1, 2).sum(axis=2) / variances
    distance = np.sqrt((squares / factors[:, None]).sum(axis=0) / 3)
    return np.asarray(np.minimum(1.0, OUTLIER / np.maximum(distance, MIN_DEVIATION)) ** 2)
