"""Gaussian estimates in information form, and the choice of the unknowns that the data support.

Information Λ (n, n) and b (n,) represents the quadratic form `½ xᵀ Λ x - bᵀ x`. Its minimum is the estimate
x̂ = Λ⁻¹ b with covariance Λ⁻¹. Information from independent data is additive. An unknown is either free or
held at zero. With the unknowns a already free, freeing the group g lowers the chi-squared by

    b̃ᵀ S⁻¹ b̃,   S = Λ_gg - Λ_ga Λ_aa⁻¹ Λ_ag,   b̃ = b_g - Λ_ga Λ_aa⁻¹ b_a,

where S is the Schur complement of Λ_aa.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyherd.geometry import Array, inverse


class Estimate(NamedTuple):
    """Gaussian estimate of n unknowns: its mean (n,) and covariance (n, n)."""

    mean: Array
    covariance: Array


@dataclass(frozen=True)
class Information:
    """Information on n unknowns: the matrix Λ (n, n), positive semidefinite, and the vector b (n,).

    `scaled` and `total` also take a stack of K such: Λ (K, n, n) and b (K, n).
    """

    matrix: Array
    vector: Array

    @classmethod
    def zero(cls, count: int) -> "Information":
        """Return no information on `count` unknowns."""
        return cls(np.zeros((count, count)), np.zeros(count))

    @classmethod
    def prior(cls, deviations: Array) -> "Information":
        """Return information on independent unknowns of mean zero with standard deviations (n,)."""
        return cls(np.diag(deviations**-2.0), np.zeros(deviations.size))

    def __add__(self, other: "Information") -> "Information":
        """Return the sum of both, for independent data."""
        return Information(self.matrix + other.matrix, self.vector + other.vector)

    def __sub__(self, other: "Information") -> "Information":
        """Return this without `other`, which is part of it."""
        return Information(self.matrix - other.matrix, self.vector - other.vector)

    def scaled(self, factor: float | Array) -> "Information":
        """Return the same estimate with its covariance divided by `factor`, or by one (K,) of each."""
        factor = np.asarray(factor)[..., None]
        return Information(factor[..., None] * self.matrix, factor * self.vector)

    def total(self) -> "Information":
        """Return the sum of a stack of information from independent data."""
        return Information(self.matrix.sum(axis=0), self.vector.sum(axis=0))

    def marginal(self, count: int) -> "Information":
        """Return information on the first `count` unknowns, without further information on the others.

        Its covariance is the corresponding block of this one's, by the Schur complement.

        Raises:
            numpy.linalg.LinAlgError: this has no information on some of the others.
        """
        across = self.matrix[count:, :count]
        gain = np.linalg.solve(self.matrix[count:, count:], across).T
        return Information(
            self.matrix[:count, :count] - gain @ across,
            self.vector[:count] - gain @ self.vector[count:],
        )

    def joined(self, others: "Information") -> "Information":
        """Return information on these unknowns followed by `others`, which are independent."""
        count, size = self.vector.size, self.vector.size + others.vector.size
        matrix = np.zeros((size, size))
        matrix[:count, :count], matrix[count:, count:] = self.matrix, others.matrix
        return Information(matrix, np.concatenate([self.vector, others.vector]))

    def diffused(self, variances: Array) -> "Information":
        """Return the information left after each unknown has changed at random with variances (n,).

        The mean stays, and the variances are added to the covariance: the prediction step of a Kalman filter.
        """
        mean, covariance = self.estimate()
        matrix = inverse(covariance + np.diag(variances))
        return Information(matrix, matrix @ mean)

    def estimate(self) -> Estimate:
        """Return the estimate with every unknown free.

        Raises:
            numpy.linalg.LinAlgError: this has no information on some unknown.
        """
        covariance = inverse(self.matrix)
        return Estimate(covariance @ self.vector, covariance)

    def constrained_mean(self, free: Sequence[int]) -> Array:
        """Return the estimated values (n,) with all but the `free` unknowns held at zero."""
        mean = np.zeros_like(self.vector)
        if free:
            mean[free] = np.linalg.solve(self.matrix[np.ix_(free, free)], self.vector[free])
        return mean

    def significant(
        self, groups: Mapping[str, Sequence[int]], *, after: Mapping[str, str], threshold: float
    ) -> list[int]:
        """Return the unknowns of the groups that each lower the chi-squared by at least `threshold`.

        Groups are freed one at a time, the one with the largest decrease first (forward selection).

        Args:
            groups: unknowns by name of the group.
            after: by name of a group, the group that must be free before it is considered.
            threshold: minimum decrease of the chi-squared.
        """
        free: list[int] = []
        # S and b̃ of all unknowns, n rows of n + 1; lists, since arrays take longer for so few numbers.
        reduced = [[*row, b] for row, b in zip(self.matrix.tolist(), self.vector.tolist(), strict=True)]
        waiting = dict(groups)
        while waiting:
            candidates = {name: group for name, group in waiting.items() if after.get(name) not in waiting}
            falls = {name: _chi_squared_fall(reduced, group) for name, group in candidates.items()}
            best = max(falls, key=falls.__getitem__)
            if falls[best] < threshold:
                break
            for k in waiting.pop(best):
                free.append(k)
                reduced = _eliminated(reduced, k)
        return free


def _chi_squared_fall(reduced: list[list[float]], group: Sequence[int]) -> float:
    """Return b̃ᵀ S⁻¹ b̃ of a group: the sum of b̃² / S of its unknowns, which are freed one after the other."""
    part, fall = [[reduced[row][column] for column in (*group, -1)] for row in group], 0.0
    while part:
        (pivot, *first), *others = part
        fall += first[-1] ** 2 / pivot
        part = [[x - across / pivot * y for x, y in zip(row, first, strict=True)] for across, *row in others]
    return fall


def _eliminated(reduced: list[list[float]], k: int) -> list[list[float]]:
    """Return S and b̃, n rows of n + 1, after unknown k is freed, which eliminates it from the others."""
    pivot = [value / reduced[k][k] for value in reduced[k]]
    return [[value - row[k] * share for value, share in zip(row, pivot, strict=True)] for row in reduced]
