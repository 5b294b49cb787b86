"""The map to the ground fitted to the squares of one image, given what was learned of the camera before.

Robust least squares by Gauss-Newton steps. The data of a square are its side, relative to one common side
that is not known, and the two components of its squeeze. Sides and squeezes have a noise each, estimated from
the residuals of the fit of all unknowns, since markers that differ in size or height spoil the sides alone.
Unknowns that explain nothing are held at zero (`skyherd.control.rectification.information`).
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
"""Standard deviations (10,) of the unknowns over all cameras, in their order in `ground_map`. Chosen:
wide enough for fisheyes, and for tilts of 16 degrees at the usual focal length (|λ| = tan(tilt) / f); `LIMIT`
says how far beyond a fit is refused."""

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
"""By name of a group, the group that must be free before: further coefficients, and a centre, mean something
for a lens only."""

SIGNIFICANT = 20.0
"""Fall of the chi-squared that a group of unknowns must bring to be freed. Derived: noise alone brings it to
a group of two unknowns once in 20 000 fits (e^{-20 / 2} = 4.5e-5)."""

OUTLIER = 3.0
"""Squares whose residual d exceeds so many standard deviations weigh less, in proportion to 1 / d². Chosen:
of squares with Gaussian residuals one in 170 000 does (chi-squared of three, over 27), so that the others
keep their full weight."""

ROUNDS, SETTLED = 5, 3e-4
"""Gauss-Newton steps end once no prediction moves by more than `SETTLED`, or after `ROUNDS` steps. Derived:
the error left is about the square of a step, 1e-7, which no detector measures."""

DIFFERENCE = 1e-6
"""Step of the numerical derivatives. Chosen: the error of a forward difference is about the step itself, and
rounding adds 1e-16 / 1e-6 = 1e-10."""

STEPS: Array = np.concatenate([np.zeros((1, UNKNOWNS)), DIFFERENCE * np.eye(UNKNOWNS)])
"""(11, 10) steps for numerical derivatives: no step, and one of each unknown."""

LIMIT = 5.0
"""Greatest value of an unknown, in standard deviations of `PRIOR`. Chosen: no camera is farther off; a fit
beyond is of squares that are none."""

MIN_VARIANCE_FACTOR = 1e-8
"""Lower limit of the factor on variances that no detector reports. Chosen: corners of 1e-5 px, exact for all
purposes; it avoids a division by zero for data without noise."""

MIN_DEVIATION = 1e-12
"""Residuals are divided by at least so many standard deviations. Chosen: it only avoids a division by
zero."""

SIDES, ANISOTROPIES = 0, 1
"""Rows of the two kinds of data: logarithms of sides, and squeezes."""


@dataclass(frozen=True)
class NoiseStatistics:
    """What residuals say of the noise of the data, by kind: row `SIDES`, row `ANISOTROPIES`.

    Attributes:
        squares: (2,) sums of squared residuals over their variances.
        freedoms: (2,) their degrees of freedom.
    """

    squares: Array
    freedoms: Array

    def variance_factors(self, *, reported: bool) -> Array:
        """Factors (2,) by which the true variances exceed the assumed ones.

        They are at least 1 where the detector reported covariances, which then is the least noise there is.
        """
        return np.maximum(self.squares / self.freedoms, 1.0 if reported else MIN_VARIANCE_FACTOR)

    def accumulated(self, other: "NoiseStatistics", memory: float = 1.0) -> "NoiseStatistics":
        """These statistics, weighted by `memory`, together with those of another image."""
        return NoiseStatistics(memory * self.squares + other.squares, memory * self.freedoms + other.freedoms)


@dataclass(frozen=True)
class GroundFit:
    """The result of a fit to one image.

    Attributes:
        ground_map: the map, with the camera's former information taken into account.
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
    """The data of N squares less what the unknowns predict, to first order.

    Sides and squeezes are rows of M = 2 N numbers each: a squeeze has two, a side one and a zero.

    Attributes:
        at: (10,) values of the unknowns.
        residuals: (2, M) data less predictions.
        jacobian: (2, M, 10) derivatives of the predictions.
        weights: (M,) inverse variances, lowered for outliers.
    """

    at: Array
    residuals: Array
    jacobian: Array
    weights: Array

    @classmethod
    def of(cls, squares: Squares, unknowns: Array, robust: Array) -> "_Linearization":
        """At given unknowns (10,), with weights (N,) of the squares."""
        maps = local_maps(unknowns + STEPS, squares.points)
        weights = robust / squares.variances
        shares = weights / weights.sum()
        # The side on the ground is whatever fits best, so that sides count as they differ from their mean.
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

    def information(self) -> list[Information]:
        """Information on the unknowns from sides, and from squeezes, for variance factors of 1."""
        weighted = self.jacobian.transpose(0, 2, 1) * self.weights
        vectors = weighted @ (self.residuals + self.jacobian @ self.at)[..., None]
        return [Information(*parts) for parts in zip(weighted @ self.jacobian, vectors[..., 0], strict=True)]

    def residuals_at(self, unknowns: Array) -> Array:
        """Residuals (2, M) at other values (10,) of the unknowns."""
        return self.residuals - self.jacobian @ (unknowns - self.at)


def fit_ground(
    squares: Squares,
    *,
    camera: Information,
    start: Array,
    noises: NoiseStatistics,
    trusted: Collection[int],
) -> GroundFit | None:
    """Fit the map to the squares of one image; None where the fit is one that no camera has.

    Args:
        squares: of one image, at least one.
        camera: information on the camera's unknowns (8,).
        start: (10,) values of the unknowns to begin with.
        noises: statistics of the images before.
        trusted: indices of the unknowns that may be freed, if they are significant.
    """
    before = camera.joined(Information.prior(PRIOR[CAMERA:]))
    unknowns, robust = start, np.ones(len(squares))
    factors = noises.variance_factors(reported=squares.reported)
    for _ in range(ROUNDS):
        lines = _Linearization.of(squares, unknowns, robust)
        parts = lines.information()
        full, covariance = (before + _combined(parts, factors)).estimate()
        here = _noise_statistics(lines, full, parts=parts, factors=factors, covariance=covariance)
        factors = noises.accumulated(here).variance_factors(reported=squares.reported)
        image = _combined(parts, factors)
        everything = before + image
        significant = everything.significant(GROUPS, after=AFTER, threshold=SIGNIFICANT)
        unknowns = everything.constrained_mean([k for k in significant if k in trusted])
        if not (np.abs(unknowns) < LIMIT * PRIOR).all():
            return None
        if np.abs(lines.jacobian @ (unknowns - lines.at)).max() < SETTLED:
            break
        robust = _robust_weights(lines.residuals_at(full), squares.variances, factors)
    # Of a camera that is not ideal, an unknown that is held at zero may well have another value.
    covariance = everything.estimate().covariance if unknowns.any() else np.zeros((UNKNOWNS, UNKNOWNS))
    return GroundFit(
        ground_map=GroundMap(unknowns, covariance),
        significant=frozenset(significant),
        image=image,
        noises=here,
    )


def _combined(parts: list[Information], factors: Array) -> Information:
    """Information from sides and squeezes together, by their variance factors (2,)."""
    return parts[SIDES].scaled(1 / factors[SIDES]) + parts[ANISOTROPIES].scaled(1 / factors[ANISOTROPIES])


def _noise_statistics(
    lines: _Linearization, full: Array, *, parts: list[Information], factors: Array, covariance: Array
) -> NoiseStatistics:
    """Squared residuals at the estimate (10,) with all unknowns free, and their degrees of freedom.

    A kind of data with information Λ spends tr(Λ C) degrees of freedom on an estimate with covariance C.
    """
    squares = (lines.residuals_at(full) ** 2 * lines.weights).sum(axis=1)
    numbers = np.array([lines.weights.size / 2 - 1, lines.weights.size])
    fitted = [
        float(np.sum(part.scaled(1 / factor).matrix * covariance))
        for part, factor in zip(parts, factors, strict=True)
    ]
    return NoiseStatistics(squares, np.maximum(numbers - fitted, 0.0))


def _robust_weights(residuals: Array, variances: Array, factors: Array) -> Array:
    """Weights (N,), at most 1, of squares with residuals (2, M): `(OUTLIER / d)²` for large d."""
    squares = (residuals**2).reshape(2, -1, 2).sum(axis=2) / variances
    distance = np.sqrt((squares / factors[:, None]).sum(axis=0) / 3)
    return np.asarray(np.minimum(1.0, OUTLIER / np.maximum(distance, MIN_DEVIATION)) ** 2)
