"""The map to the ground from one image's squares and from what was known of the camera before.

Robust least squares, by Gauss and Newton: of each square its side, beside a common one that is not known,
and the two components of its squeeze. Sides and squeezes have a noise each, told by what the fit of all
unknowns leaves, since markers that differ in size or height spoil the sides alone. Unknowns that explain
nothing are held at zero (`skyherd.control.rectification.information`).
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from skyherd.control.rectification.ground_map import (
    CAMERA,
    CENTER,
    FOCAL,
    HORIZON,
    LENS,
    SQUEEZE,
    UNKNOWNS,
    GroundMap,
    local_maps,
)
from skyherd.control.rectification.information import Information
from skyherd.control.rectification.square_shapes import Squares
from skyherd.geometry import Array

PRIOR: Array = np.array([0.1, 0.1, 0.2, 0.03, 0.03, 0.15, 0.15, 1.0, 0.2, 0.2])
"""Standard deviations of the unknowns over all cameras there are."""

GROUPS = {
    "squeeze": SQUEEZE,
    "tilt": [*HORIZON, *FOCAL],
    "lens": LENS[:1],
    "second lens": LENS[1:2],
    "third lens": LENS[2:],
    "center": CENTER,
}
AFTER = {"second lens": "lens", "third lens": "second lens", "center": "lens"}
"""More coefficients, and a centre, say something of a lens only."""

SIGNIFICANT = 20.0
"""Fall of chi-squared that a group must bring: of two unknowns, chance has it once in 20 000."""

OUTLIER = 3.0
"""Squares whose residual d is more than so many deviations weigh less, in proportion to 1 / d²."""

ROUNDS, SETTLED = 5, 3e-4
"""Fits end once no prediction moves by more than this, or after so many rounds. Of a step, about its square
is left: 1e-7."""

DIFFERENCE = 1e-6
"""Step of the numerical derivatives: they are right to about as much."""

STEPS: Array = np.concatenate([np.zeros((1, UNKNOWNS)), DIFFERENCE * np.eye(UNKNOWNS)])
"""No step (10,), and one of each unknown."""

LIMIT = 5.0
"""No camera is farther than so many deviations from the usual."""

SIDES, SQUEEZES = 0, 1


@dataclass(frozen=True)
class Noises:
    """Sums (2,) of squared residuals over variances, and how many numbers they are of: sides, squeezes."""

    squares: Array
    freedoms: Array

    def excess(self, *, told: bool) -> Array:
        """Variance (2,) over what the detector says; at least one if it does say."""
        return np.maximum(self.squares / self.freedoms, 1.0 if told else 1e-8)

    def and_then(self, other: "Noises", memory: float = 1.0) -> "Noises":
        """And those of another image, these counting in part."""
        return Noises(memory * self.squares + other.squares, memory * self.freedoms + other.freedoms)


@dataclass(frozen=True)
class GroundFit:
    """What an image says of the map, with what was known before.

    Attributes:
        ground_map: the map.
        earned: unknowns that have earned their place.
        image: evidence of the image alone.
        noises: of the image alone.
    """

    ground_map: GroundMap
    earned: frozenset[int]
    image: Information
    noises: Noises


@dataclass(frozen=True)
class _Lines:
    """What is seen of squares against what unknowns (10,) predict, to first order around them.

    Sides and squeezes are rows of M = 2 N numbers each, a squeeze having two, a side one and a zero.

    Attributes:
        at: (10,) the unknowns.
        residuals: (2, M).
        slopes: (2, M, 10) of the predictions.
        weights: (M,) by the detector's variances.
    """

    at: Array
    residuals: Array
    slopes: Array
    weights: Array

    @classmethod
    def of(cls, squares: Squares, unknowns: Array, robust: Array) -> "_Lines":
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
        predicted[SQUEEZES], seen[SQUEEZES] = maps.squeezes().view(float), squares.squeezes.view(float)
        slopes = (predicted[:, 1:] - predicted[:, :1]) / DIFFERENCE
        return cls(unknowns, seen - predicted[:, 0], slopes.transpose(0, 2, 1), np.repeat(weights, 2))

    def evidence(self) -> list[Information]:
        """Of sides and of squeezes, on the unknowns."""
        weighted = self.slopes.transpose(0, 2, 1) * self.weights
        vectors = weighted @ (self.residuals + self.slopes @ self.at)[..., None]
        return [Information(*parts) for parts in zip(weighted @ self.slopes, vectors[..., 0], strict=True)]

    def left(self, unknowns: Array) -> Array:
        """Residuals (2, M) with other unknowns."""
        return self.residuals - self.slopes @ (unknowns - self.at)


def fit_ground(
    squares: Squares, camera: Information, start: Array, noises: Noises, trusted: Collection[int]
) -> GroundFit | None:
    """Fit the map to squares; None where no camera would see them so.

    Args:
        squares: of one image, at least one.
        camera: evidence on the camera's unknowns (8,).
        start: unknowns (10,) to begin with.
        noises: of the images before.
        trusted: unknowns that may be let loose, if they earn it.
    """
    before = camera.followed_by(Information.prior(PRIOR[CAMERA:]))
    unknowns, robust = start, np.ones(len(squares))
    excess = noises.excess(told=squares.told)
    for _ in range(ROUNDS):
        lines = _Lines.of(squares, unknowns, robust)
        parts = lines.evidence()
        everything = before + _joined(parts, excess)
        full, covariance = everything.all_loose()
        here = _noises(lines, full, [p.times(1 / e) for p, e in zip(parts, excess, strict=True)], covariance)
        excess = noises.and_then(here).excess(told=squares.told)
        image = _joined(parts, excess)
        everything = before + image
        earned = everything.earned(GROUPS, AFTER, SIGNIFICANT)
        unknowns = everything.solved([k for k in earned if k in trusted])
        if not (np.abs(unknowns) < LIMIT * PRIOR).all():
            return None
        if np.abs(lines.slopes @ (unknowns - lines.at)).max() < SETTLED:
            break
        robust = _robust(lines.left(full), squares.variances, excess)
    # Of a camera that is not ideal, what is held at zero may well be something too.
    covariance = everything.all_loose()[1] if unknowns.any() else np.zeros((UNKNOWNS, UNKNOWNS))
    return GroundFit(GroundMap(unknowns, covariance), frozenset(earned), image, here)


def _joined(parts: list[Information], excess: Array) -> Information:
    """Sides and squeezes together, by their noise."""
    return parts[SIDES].times(1 / excess[SIDES]) + parts[SQUEEZES].times(1 / excess[SQUEEZES])


def _noises(lines: _Lines, full: Array, parts: list[Information], covariance: Array) -> Noises:
    """Squares of what all unknowns together leave, and how many numbers they leave free."""
    squares = (lines.left(full) ** 2 * lines.weights).sum(axis=1)
    numbers = np.array([lines.weights.size / 2 - 1, lines.weights.size])
    fitted = [float(np.sum(part.information * covariance)) for part in parts]
    return Noises(squares, np.maximum(numbers - fitted, 0.0))


def _robust(left: Array, variances: Array, excess: Array) -> Array:
    """Weights (N,) by residuals (2, M) over their deviations."""
    squares = (left**2).reshape(2, -1, 2).sum(axis=2) / variances
    distance = np.sqrt((squares / excess[:, None]).sum(axis=0) / 3)
    return np.asarray(np.minimum(1.0, OUTLIER / np.maximum(distance, 1e-12)) ** 2)
