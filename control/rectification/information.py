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
    """Information on n unknowns: the matrix Λ (n, n), positive semidefinite, and the vector b (n,)."""

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

    def scaled(self, factor: float) -> "Information":
        """Return the same estimate with its covariance divided by `factor`."""
        return Information(factor * self.matrix, factor * self.vector)

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
        # S and b̃ of all unknowns, (n, n + 1); freeing unknown k eliminates it from the others.
        reduced = np.concatenate([self.matrix, self.vector[:, None]], axis=1)
        waiting = dict(groups)
        while waiting:
            candidates = {name: group for name, group in waiting.items() if after.get(name) not in waiting}
            falls = {name: _chi_squared_fall(reduced, group) for name, group in candidates.items()}
            best = max(falls, key=falls.__getitem__)
            if falls[best] < threshold:
                break
            for k in waiting.pop(best):
                free.append(k)
                reduced = reduced - np.outer(reduced[:, k], reduced[k] / reduced[k, k])
        return free


def _chi_squared_fall(reduced: Array, group: Sequence[int]) -> float:
    """Return b̃ᵀ S⁻¹ b̃ of a group, from S and b̃ (n, n + 1) of all unknowns."""
    vector = reduced[group, -1]
    if len(group) == 1:
        return float(vector[0] ** 2 / reduced[group[0], group[0]])
    return float(vector @ np.linalg.solve(reduced[group][:, group], vector))
